"""Pictures of scenes, by every backend that there is: `BACKENDS` is the one table of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from splatview.renderers.modes import MODES, VisualMode
from splatview.renderers.request import Capabilities, FrameRequest, FrameStats, Renderer
from splatview.scene import InputError

if TYPE_CHECKING:
    import moderngl

    from splatview.renderers.gl.programs import Variants

__all__ = [
    "BACKENDS",
    "MODES",
    "Backend",
    "Capabilities",
    "FrameRequest",
    "FrameStats",
    "Renderer",
    "VisualMode",
    "automatic_choice",
    "choices",
    "make_renderer",
    "on_this_gl",
]

COMPUTE = 430
"""Version code of the first OpenGL with compute shaders."""


# The modules of backends are imported when they are made: each needs libraries that the others do not.


def _quads(ctx: moderngl.Context, variants: Variants | None) -> Renderer:
    from splatview.renderers.gl.quads import QuadsRenderer

    return QuadsRenderer(ctx, variants=variants)


def _quads_gl33(ctx: moderngl.Context, variants: Variants | None) -> Renderer:
    from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer

    return QuadsGL33Renderer(ctx, variants)


def _tiles(ctx: moderngl.Context, variants: Variants | None) -> Renderer:
    from splatview.renderers.gl.tiles import TilesRenderer

    return TilesRenderer(ctx, variants=variants)


def _cpu(*_: Any) -> Renderer:
    from splatview.renderers.cpu import CpuRenderer

    return CpuRenderer()


def _reference(*_: Any) -> Renderer:
    from splatview.renderers.cpu import ReferenceRenderer

    return ReferenceRenderer()


@dataclass(frozen=True, kw_only=True)
class Backend:
    """One way to draw scenes."""

    name: str
    label: str
    """Name in the window."""
    make: Callable[..., Renderer]
    """(OpenGL context or None, its programs or None) -> renderer."""
    gl_version: int | None = None
    """Version code of the oldest OpenGL that it works with (430 for 4.3); None: it needs none."""
    commands: frozenset[str] = frozenset()
    """Who offers it by name: "render", "window", "ladder", "stability"."""


EVERYWHERE = frozenset({"render", "window", "ladder", "stability"})

BACKENDS: dict[str, Backend] = {
    backend.name: backend
    for backend in (
        Backend(
            name="quads", label="quads (OpenGL 4.3)", make=_quads, gl_version=COMPUTE, commands=EVERYWHERE
        ),
        Backend(
            name="quads-gl33",
            label="quads (OpenGL 3.3)",
            make=_quads_gl33,
            gl_version=330,
            commands=frozenset({"stability"}),
        ),
        Backend(
            name="tiles", label="tiles (OpenGL 4.3)", make=_tiles, gl_version=COMPUTE, commands=EVERYWHERE
        ),
        Backend(name="cpu", label="cpu", make=_cpu, commands=EVERYWHERE),
        Backend(
            name="reference", label="reference", make=_reference, commands=frozenset({"render", "stability"})
        ),
    )
}


def choices(command: str) -> tuple[str, ...]:
    """Names of the backends that `command` offers."""
    return tuple(backend.name for backend in BACKENDS.values() if command in backend.commands)


def on_this_gl(name: str, ctx: moderngl.Context) -> Backend:
    """The backend called `name`, or its twin for an OpenGL without all that it needs."""
    from splatview.renderers.gl.context import has_compute

    return BACKENDS["quads-gl33" if name == "quads" and not has_compute(ctx) else name]


def make_renderer(
    name: str = "quads", ctx: moderngl.Context | None = None, variants: Variants | None = None
) -> Renderer:
    """The renderer called `name`. One by OpenGL draws in `ctx`, by programs from `variants`.

    Raises:
        InputError: the context is too old for it.
    """
    backend = BACKENDS[name] if ctx is None else on_this_gl(name, ctx)
    if backend.gl_version is not None and ctx is None:
        raise ValueError(f"{name} needs an OpenGL context")
    return backend.make(ctx, variants)


def automatic_choice() -> tuple[str, str]:
    """What "auto" takes here without a window, and why."""
    from splatview.renderers.gl.context import create_headless_context, describe, discard

    try:
        ctx = create_headless_context()
    except InputError as error:
        return "cpu", str(error)
    try:
        info = describe(ctx)
        if info.is_software:
            if find_spec("numba") is not None:
                return "cpu", f"OpenGL is only software here ({info.renderer})"
            return "quads", f"OpenGL runs on {info.renderer}"
        from splatview.renderers.gl.renderer_choice import faster

        return faster(ctx)
    finally:
        discard(ctx)
