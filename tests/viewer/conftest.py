"""A picture that draws nothing, a core to steer without a window, and a display for real windows."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from screen import Screen, screen

from splatview.raster import render
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, InputError
from splatview.scene.attribute_formats import Attributes
from splatview.scene.captures.demo import demo_capture
from splatview.scene.captures.nerfstudio import save_capture
from splatview.viewer.app import window_state
from splatview.viewer.open import continue_loading
from splatview.viewer.picture import Picture
from splatview.viewer.preferences import Preferences
from splatview.viewer.state import AppState


class RecordingPicture:
    """Remembers what it was given; `too_big` scenes do not fit."""

    name, backend = "recording", "quads"
    busy = False
    is_current = True
    draws_anywhere = False
    budget_ms = None
    sharp = False
    status = note = ""
    texture: Any = None
    stats: Any = None
    threads: int | None = None
    cores: float | None = None

    def __init__(self) -> None:
        self.loaded: list[Gaussians] = []
        self.too_big: int | None = None

    def load_steps(
        self, gaussians: Gaussians, attributes: Attributes = "float32"
    ) -> Generator[float, None, None]:
        yield 0.5
        if self.too_big is not None and len(gaussians) >= self.too_big:
            raise InputError("the GPU's memory does not hold it")
        self.loaded.append(gaussians)

    def draw(self, request: FrameRequest) -> None: ...

    def read(self, request: FrameRequest) -> np.ndarray:
        camera = request.camera
        image = np.zeros((camera.height, camera.width, 4), np.float32)
        image[..., 0] = np.linspace(-0.5, 1.5, camera.width)
        return image

    def wait(self, seconds: float) -> None: ...

    def forget_order(self) -> None: ...

    def unsupported(self, request: FrameRequest) -> str | None:
        return None

    def take_problem(self) -> str | None:
        return None

    def close(self) -> None: ...


@pytest.fixture
def app(tmp_path, monkeypatch) -> AppState:
    """A window's state with motions switched off, its settings in a folder of the test's own."""
    monkeypatch.setenv("SPLATVIEW_CONFIG_DIR", str(tmp_path / "config"))
    made = window_state(preferences=Preferences(smooth=False))
    made.picture = cast(Picture, RecordingPicture())
    made.picture_size = (320, 200)
    return made


@pytest.fixture
def wait_for_loading() -> Callable[[AppState], None]:
    """Runs the part of the frame loop that loading needs until it is over."""

    def wait(app: AppState) -> None:
        limit = time.monotonic() + 200
        while app.loading is not None:
            assert time.monotonic() < limit, "loading does not end"
            app.loading.join(0.01)
            continue_loading(app)
            app.run_posted()

    return wait


@pytest.fixture(scope="session")
def make_screen() -> Callable[..., AbstractContextManager[Screen]]:
    """`with make_screen("1600x1000") as screen`: an X server of its own, without a monitor."""

    @contextmanager
    def make(size: str = "1000x700") -> Iterator[Screen]:
        with ExitStack() as stack:
            try:
                made = stack.enter_context(screen(size))
            except FileNotFoundError as error:
                pytest.skip(str(error))
            except OSError as error:
                pytest.skip(f"Xvfb does not start here: {error}")
            yield made

    return make


@pytest.fixture(scope="session")
def display(make_screen) -> Iterator[str]:
    """A screen without a monitor: the value for DISPLAY."""
    with make_screen() as made:
        yield made.display


class Launcher:
    """Runs scripts of this folder in processes of their own; by `launcher.py` where forking is safe."""

    def __init__(self) -> None:
        self._server: subprocess.Popen[str] | None = None

    def run(self, argv: list[str], *, env: dict[str, str], cwd: Path, seconds: float) -> tuple[int, str]:
        """Exit code, negative for a signal, and all output. Raises `subprocess.TimeoutExpired`."""
        if sys.platform != "linux":
            done = subprocess.run(
                [sys.executable, *argv],
                env=env,
                cwd=cwd,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=seconds,
                check=False,
            )
            return done.returncode, done.stdout
        server = self._started()
        assert server.stdin is not None and server.stdout is not None
        output = cwd / "output.txt"
        job = {"argv": argv, "env": env, "cwd": str(cwd), "output": str(output)}
        server.stdin.write(json.dumps(job) + "\n")
        server.stdin.flush()
        pid = int(server.stdout.readline())
        late = threading.Event()
        clock = threading.Timer(seconds, lambda: (late.set(), os.kill(pid, signal.SIGKILL)))
        clock.start()
        try:
            status = int(server.stdout.readline())
        except BaseException:  # the test was given up: nobody would read how the process ended
            os.kill(pid, signal.SIGKILL)
            self.close()
            self._server = None
            raise
        finally:
            clock.cancel()
        if late.is_set():
            raise subprocess.TimeoutExpired(argv, seconds, output.read_bytes())
        return os.waitstatus_to_exitcode(status), output.read_text(errors="replace")

    def _started(self) -> subprocess.Popen[str]:
        if self._server is None:
            self._server = subprocess.Popen(
                [sys.executable, str(Path(__file__).with_name("launcher.py"))],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        return self._server

    def close(self) -> None:
        if self._server is not None:
            assert self._server.stdin is not None
            self._server.stdin.close()
            self._server.wait()


@pytest.fixture(scope="session")
def launcher() -> Iterator[Launcher]:
    made = Launcher()
    yield made
    made.close()


@pytest.fixture
def drive(display, launcher, tmp_path) -> Callable[..., dict[str, Any]]:
    """`drive("name", *paths, **options)`: runs a function of `drives.py`, or of another `script` here, on a
    real window in a process of its own and returns what it found out."""
    return driving(display, launcher, tmp_path)


@pytest.fixture(scope="module")
def drive_once(display, launcher, tmp_path_factory) -> Callable[..., dict[str, Any]]:
    """`drive` for a module whose tests share what one window found out."""
    return driving(display, launcher, tmp_path_factory.mktemp("drive"))


@pytest.fixture(scope="session")
def capture(tmp_path_factory) -> Path:
    """Ten small photos of the demo scene in a folder."""
    folder = tmp_path_factory.mktemp("captures") / "pond"
    save_capture(demo_capture(render, photos=10, width=96, height=72, splats=4000), folder)
    return folder


def driving(display: str, launcher: Launcher, tmp_path: Path) -> Callable[..., dict[str, Any]]:
    def run(
        name: str,
        *paths: Path,
        script: str = "drives.py",
        environ: dict[str, str] | None = None,
        seconds: float = 280,
        **options: Any,
    ) -> dict[str, Any]:
        result = tmp_path / f"{name}.json"
        environment = dict(
            os.environ,
            DISPLAY=display,
            SPLATVIEW_CONFIG_DIR=str(tmp_path / "config"),
            LIBGL_ALWAYS_SOFTWARE="1",
        )
        environment.update(environ or {})
        environment.pop("WAYLAND_DISPLAY", None)
        program = str(Path(__file__).with_name(script))
        argv = [program, name, str(result), json.dumps(options), *map(str, paths)]
        code, output = launcher.run(argv, env=environment, cwd=tmp_path, seconds=seconds)
        assert code == 0, f"{name} ended with {code}:\n{output[-4000:]}"
        assert result.exists(), output[-4000:]
        return json.loads(result.read_text()) | {"output": output}

    return run
