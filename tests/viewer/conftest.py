"""A picture that draws nothing, a core to steer without a window, and a display for real windows."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, InputError
from splatview.scene.attribute_formats import Attributes
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
        limit = time.monotonic() + 60
        while app.loading is not None:
            assert time.monotonic() < limit, "loading does not end"
            app.loading.join(0.01)
            continue_loading(app)
            app.run_posted()

    return wait


@pytest.fixture(scope="session")
def display() -> Iterator[str]:
    """A screen without a monitor: the value for DISPLAY."""
    program = shutil.which("Xvfb")
    if program is None:
        pytest.skip("Xvfb is not installed (Debian: apt-get install xvfb)")
    ready, write_end = os.pipe()
    server = subprocess.Popen(
        [program, "-displayfd", str(write_end), "-screen", "0", "1000x700x24", "-nolisten", "tcp"],
        pass_fds=[write_end],
        stderr=subprocess.DEVNULL,
    )
    os.close(write_end)
    with os.fdopen(ready) as pipe:
        number = pipe.readline().strip()
    if not number:
        server.wait()
        pytest.skip("Xvfb does not start here")
    yield f":{number}"
    server.terminate()
    server.wait()


@pytest.fixture
def drive(display, tmp_path) -> Callable[..., dict[str, Any]]:
    """`drive("name", *paths, **options)`: runs a function of `drives.py`, or of another `script` here, on a
    real window in a process of its own and returns what it found out."""
    return driving(display, tmp_path)


@pytest.fixture(scope="module")
def drive_once(display, tmp_path_factory) -> Callable[..., dict[str, Any]]:
    """`drive` for a module whose tests share what one window found out."""
    return driving(display, tmp_path_factory.mktemp("drive"))


def driving(display: str, tmp_path: Path) -> Callable[..., dict[str, Any]]:
    def run(
        name: str,
        *paths: Path,
        script: str = "drives.py",
        environ: dict[str, str] | None = None,
        seconds: float = 240,
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
        command = [
            sys.executable,
            str(Path(__file__).with_name(script)),
            name,
            str(result),
            json.dumps(options),
            *map(str, paths),
        ]
        done = subprocess.run(
            command,
            env=environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=seconds,
            check=False,
        )
        output = done.stdout + done.stderr
        assert done.returncode == 0, f"{name} ended with {done.returncode}:\n{output[-4000:]}"
        assert result.exists(), output[-4000:]
        return json.loads(result.read_text()) | {"output": output}

    return run
