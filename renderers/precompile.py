"""Programs and kernels of pictures, compiled in the background before they are needed.

One at a time of the GPU's and one of the CPU's: kernels take many times as long as programs.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import secrets
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import moderngl
import numpy as np

from splatview.renderers import make_renderer
from splatview.renderers.gl.programs import Variant, Variants, load
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import Gaussians
from splatview.scene.background import Panorama
from splatview.scene.edits import IDENTITY, Crop, SceneEdits
from splatview.scene.effects.sh_bands import own_degrees
from splatview.scene.framing import frame_camera

# A small picture with the effects of one that is wanted: drawn in a process of its own, it leaves the
# programs and kernels that they need compiled, in the caches on disk.
#
#     python -m splatview.renderers.precompile < PICKLED_REHEARSAL
#
# In a process, since compilers hold Python's lock: numba nearly all the time, moderngl while a driver
# compiles. In a thread of the window's process both would stop its frames as if they worked in them. And
# drivers finish their work at the first draw, so a picture is drawn.


SPLATS = 64

SIZE = (48, 32)
"""Pixels."""

LINGER = 1.0
"""Seconds: drivers write their caches in threads of their own, which Mesa ends with the process, done or
not."""

NICENESS = 5
"""The window comes first."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PrecompileJob:
    """A small picture, and what must have been compiled for it."""

    backend: str
    """"quads", "tiles" or "cpu"."""
    request: FrameRequest
    variants: frozenset[Variant] = field(default_factory=frozenset)
    """Programs that must have been compiled in the end."""
    gl_version: tuple[int, int] | None = None
    """Version of a hidden window that is drawn in; None: without one."""


def few_splats() -> Gaussians:
    """A scene of its own, of degree 3."""
    rng = np.random.default_rng(1)
    return Gaussians(
        means=rng.uniform(-1, 1, (SPLATS, 3)).astype(np.float32),
        quats=rng.normal(size=(SPLATS, 4)).astype(np.float32),
        log_scales=np.full((SPLATS, 3), -2.0, np.float32),
        opacity_logits=np.zeros(SPLATS, np.float32),
        sh=rng.normal(scale=0.3, size=(SPLATS, 16, 3)).astype(np.float32),
    )


def precompile_job(
    backend: str,
    request: FrameRequest,
    *,
    variants: frozenset[Variant] = frozenset(),
    gl_version: tuple[int, int] | None = None,
) -> PrecompileJob:
    """A job with the effects of `request`, which names its scene, in few splats and pixels."""
    gaussians, settings, edits = request.gaussians, request.settings, request.edits
    assert gaussians is not None
    few = gaussians.take(np.arange(min(len(gaussians), SPLATS)))
    count = len(few)
    rng = np.random.default_rng(0)
    few = replace(
        few,
        means=rng.uniform(-1, 1, (count, 3)).astype(few.means.dtype),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=np.full((count, 3), -2.0, np.float32),
        opacity_logits=np.zeros(count, np.float32),
    )
    if backend == "cpu" and own_degrees(gaussians.sh) is not None:
        sh = few.sh.copy()
        sh[1:, 1:] = 0  # so few must differ in their degrees, too
        sh[0] = 1
        few = replace(few, sh=sh)
    placed = frame_camera(few, *SIZE)
    behind = settings.background
    if isinstance(behind, Panorama):
        settings = replace(settings, background=replace(behind, pixels=behind.pixels[:2, :2]))
    if edits is not None:
        edits = SceneEdits(
            marks=np.zeros(count, np.uint32),
            palette=(IDENTITY, *edits.palette[1:2]),
            crops=(Crop(half_extents=(9.0, 9.0, 9.0)),) if edits.crops_in_force else (),
            flags=edits.flags,
        )
    camera = replace(request.camera.resized(*SIZE), world_to_camera=placed.world_to_camera)
    small = replace(request, gaussians=few, camera=camera, settings=settings, edits=edits, resolution=1.0)
    return PrecompileJob(backend=backend, request=small, variants=variants, gl_version=gl_version)


def perform(job: PrecompileJob) -> None:
    if job.backend == "cpu":
        draw_by_cpu(job.request)
    else:
        draw_by_gl(job)


def draw_by_cpu(request: FrameRequest) -> None:
    """Compiles the kernels of the request's kind, and those that tint marked splats."""
    renderer = make_renderer("cpu")
    renderer.render(replace(request, highlight=None))
    if request.edits is not None:
        edits = request.edits
        lit = replace(edits, marks=np.full_like(edits.marks, edits.flags))
        renderer.render(replace(request, edits=lit, highlight=request.highlight or Highlight()))


def draw_by_gl(job: PrecompileJob) -> None:
    ctx = hidden_context(job.gl_version)
    variants = Variants(ctx)
    make_renderer(job.backend, ctx, variants).render(job.request)
    # So few splats may be stored otherwise than the scene they stand for.
    for variant in job.variants - variants.made:
        load(ctx, variant)
    ctx.finish()
    time.sleep(LINGER)
    ctx.release()


def hidden_context(version: tuple[int, int] | None) -> moderngl.Context:
    """As the window has it, so that the driver takes one for the other; None: without a window."""
    from splatview.renderers.gl.context import create_headless_context

    if version is None:
        return create_headless_context()
    import imgui_bundle  # noqa: F401  (sets which libglfw is used)

    import glfw  # isort: skip

    if not glfw.init():
        raise RuntimeError("no window can be opened")
    glfw.window_hint(glfw.VISIBLE, False)
    glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, version[0])
    glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, version[1])
    glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
    glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)
    window = glfw.create_window(16, 16, "", None, None)
    if not window:
        raise RuntimeError("no second OpenGL context")
    glfw.make_context_current(window)
    return moderngl.create_context()


def main() -> None:
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    perform(pickle.load(sys.stdin.buffer))


if __name__ == "__main__":
    main()


LONGEST = 300.0
"""Seconds after which a precompile job is given up."""

MOST_REMEMBERED = 5000
"""Lines of the file that remembers; then it begins anew."""

STARTER = "from splatview.renderers.precompile import main; main()"


@dataclass(frozen=True)
class _Task:
    keys: frozenset[str]
    title: str
    job: PrecompileJob


class ShaderPrecompiler:
    """Knows by keys what is compiled. All methods may be called from any thread.

    `memory`: a file that keeps the keys of earlier sessions, as caches on disk outlive them. `on_change` is
    called, in another thread, when something has been compiled.
    """

    def __init__(
        self,
        *,
        memory: Path | None = None,
        gl_version: tuple[int, int] | None = None,
        on_change: Callable[[], object] = lambda: None,
        perform: Callable[[PrecompileJob], None] | None = None,
    ) -> None:
        self.gl_version = gl_version
        """Of the windows to draw in; None: without one."""
        self._memory = memory
        self._on_change = on_change
        self._perform = perform or self._in_a_process
        self._change = threading.Condition()
        # Guarded by _change:
        self._done = remembered(memory)
        self._asked: set[str] = set()
        self._titles: dict[bool, str] = {}
        self._problem: str | None = None
        self._ended = False
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._tasks: dict[bool, queue.SimpleQueue[_Task | None]] = {}
        """By whether the CPU draws; each has a thread."""

    def is_done(self, keys: Iterable[str]) -> bool:
        """Whether there is nothing to wait for: all is compiled, or cannot be in the background."""
        with self._change:
            return self._ended or self._done.issuperset(keys)

    def ask(self, keys: Iterable[str], title: str, job: Callable[[], PrecompileJob]) -> None:
        """Has `keys` compiled by a job, unless that has been asked for; `title` tells the user what is
        compiled."""
        with self._change:
            missing = frozenset(keys) - self._done - self._asked
            if not missing or self._ended:
                return
            self._asked |= missing
            task = _Task(missing, title, job())
            by_cpu = task.job.backend == "cpu"
            if by_cpu not in self._tasks:
                self._tasks[by_cpu] = queue.SimpleQueue()
                threading.Thread(
                    target=self._work, args=(by_cpu,), name="splatview-precompile", daemon=True
                ).start()
            self._tasks[by_cpu].put(task)

    def note(self, keys: Iterable[str]) -> None:
        """`keys` have been compiled otherwise."""
        with self._change:
            new = frozenset(keys) - self._done
            self._done |= new
            self._change.notify_all()
        self._remember(new)

    def wait(self, keys: Iterable[str]) -> bool:
        """Returns True when `is_done`, False when all has ended before."""
        keys = frozenset(keys)
        with self._change:
            self._change.wait_for(lambda: self._ended or self._done.issuperset(keys))
            return self._done.issuperset(keys)

    @property
    def title(self) -> str:
        """What is being compiled, or ""."""
        with self._change:
            return ", ".join(self._titles.values())

    def take_problem(self) -> str | None:
        """Why something could not be compiled in the background, once."""
        with self._change:
            problem, self._problem = self._problem, None
            return problem

    def release(self) -> None:
        """Nothing is waited for any more; a process that is at work is ended."""
        with self._change:
            self._ended = True
            self._change.notify_all()
            for process in self._processes:
                process.terminate()
            for tasks in self._tasks.values():
                tasks.put(None)

    def _work(self, by_cpu: bool) -> None:
        while True:
            task = self._tasks[by_cpu].get()
            if task is None or self._ended:
                return
            with self._change:
                self._titles[by_cpu] = task.title
            self._on_change()
            problem: str | None = None
            try:
                self._perform(task.job)
            except Exception as error:
                if self._ended:
                    return
                # What is not compiled ahead is compiled when it is needed: slower, and no harm.
                problem = f"{task.title} cannot be compiled in the background: {error}"
            if problem is None:
                self._remember(task.keys)
            with self._change:
                del self._titles[by_cpu]
                self._problem = problem or self._problem
                self._done |= task.keys
                self._change.notify_all()
            self._on_change()

    def _in_a_process(self, job: PrecompileJob) -> None:
        def started(process: subprocess.Popen[bytes]) -> None:
            with self._change:
                self._processes.add(process)
                if self._ended:
                    process.terminate()

        try:
            in_a_process(job, started)
        finally:
            with self._change:
                self._processes = {process for process in self._processes if process.poll() is None}

    def _remember(self, keys: Iterable[str]) -> None:
        if self._memory is None or not keys:
            return
        with contextlib.suppress(OSError):  # a disk that cannot be written costs only time
            self._memory.parent.mkdir(parents=True, exist_ok=True)
            with self._memory.open("a", encoding="utf8") as file:
                file.writelines(f"{key}\n" for key in sorted(keys))


def remembered(memory: Path | None) -> set[str]:
    """The keys in the file, none where there is none or it has grown too long."""
    if memory is None:
        return set()
    try:
        lines = memory.read_text(encoding="utf8").splitlines()
        if len(lines) > MOST_REMEMBERED:
            memory.unlink()
            return set()
    except (OSError, UnicodeDecodeError):
        return set()
    return set(lines)


def in_a_process(
    job: PrecompileJob, on_start: Callable[[subprocess.Popen[bytes]], object] = lambda process: None
) -> None:
    """Returns when it has been performed.

    Raises:
        RuntimeError: it has not; says what the process said last.
    """
    try:
        process = subprocess.Popen(
            # -P: without it Python runs a numpy.py that lies in the current folder, beside a scene say.
            [sys.executable, "-P", "-c", STARTER],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # no console beside the window
        )
    except OSError as error:
        raise RuntimeError(str(error)) from error
    on_start(process)
    try:
        _, said = process.communicate(pickle.dumps(job), timeout=LONGEST)
    except subprocess.TimeoutExpired as error:
        process.kill()
        process.communicate()
        raise RuntimeError(f"not done after {LONGEST:.0f} s") from error
    if process.returncode != 0:
        lines = said.decode(errors="replace").strip().splitlines()
        raise RuntimeError(lines[-1] if lines else f"exit code {process.returncode}")


WORTH_WHILE = 0.5
"""Of the time that a new program takes: more, and nothing was kept. It is a tenth with Mesa."""


@dataclass(frozen=True, kw_only=True)
class CacheProbe:
    works: bool
    why: str


def probe_cache(ctx: moderngl.Context) -> CacheProbe:
    """Compiles a program here, and one here after another process has compiled it; takes two seconds."""
    few = few_splats()
    request = FrameRequest(few, frame_camera(few, *SIZE))
    variants = Variants(ctx)
    renderer = make_renderer("quads", ctx, variants)
    renderer.render(request)
    known = next(variant for variant in variants.made if "project" in variant.files[-1])
    renderer.close()
    unknown, elsewhere = (never_seen(known) for _ in range(2))
    alone = compile_ms(ctx, unknown)
    try:
        in_a_process(precompile_job("quads", request, variants=frozenset({elsewhere})))
    except RuntimeError as error:
        return CacheProbe(works=False, why=f"a second process cannot draw: {error}")
    after = compile_ms(ctx, elsewhere)
    found = f"a new program takes {alone:.0f} ms, one that another process has compiled {after:.0f} ms"
    return CacheProbe(works=after <= WORTH_WHILE * alone, why=found)


def never_seen(known: Variant) -> Variant:
    """The same program with a number in it that no other has had."""
    return Variant.of(known.files, {**dict(known.flags), "TEXTURE_WIDTH": 2048 + secrets.randbelow(1 << 30)})


def compile_ms(ctx: moderngl.Context, variant: Variant) -> float:
    begun = time.perf_counter()
    load(ctx, variant).release()
    ctx.finish()
    return 1000 * (time.perf_counter() - begun)
