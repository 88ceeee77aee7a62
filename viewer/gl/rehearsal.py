"""A small picture with the effects of one that is wanted: drawn in a process of its own, it leaves the
programs and kernels that they need compiled, in the caches on disk.

    python -m splatview.viewer.gl.rehearsal < PICKLED_REHEARSAL

In a process, since compilers hold Python's lock: numba nearly all the time, moderngl while a driver compiles.
In a thread of the window's process both would stop its frames as if they worked in them. And drivers finish
their work at the first draw, so a picture is drawn.
"""

from __future__ import annotations

import os
import pickle
import sys
import time
from dataclasses import dataclass, field, replace

import moderngl
import numpy as np

from ...scene import Camera, Gaussians, RenderSettings
from ...scene.adjustment import IDENTITY
from ...scene.background import Panorama
from ...scene.crop import Crop
from ...scene.edits import SceneEdits
from ...scene.framing import frame_camera
from .frame import VisualMode
from .overlay import Overlay
from .variants import Variant, Variants, load

SPLATS = 64

SIZE = (48, 32)
"""Pixels."""

LINGER = 1.0
"""Seconds: drivers write their caches in threads of their own, which Mesa ends with the process, done or
not."""

NICENESS = 5
"""The window comes first."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Rehearsal:
    """What is drawn, and by what."""

    renderer: str
    """"quads", "tiles" or "cpu"."""
    gaussians: Gaussians
    camera: Camera
    settings: RenderSettings
    mode: VisualMode = "splats"
    edits: SceneEdits | None = None
    overlay: Overlay | None = None
    variants: frozenset[Variant] = field(default_factory=frozenset)
    """Programs that must have been compiled in the end."""
    gl_version: tuple[int, int] | None = None
    """Of a hidden window that is drawn in; None: without one."""


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


def rehearsal_of(
    renderer: str,
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings,
    *,
    mode: VisualMode = "splats",
    edits: SceneEdits | None = None,
    overlay: Overlay | None = None,
    variants: frozenset[Variant] = frozenset(),
    gl_version: tuple[int, int] | None = None,
) -> Rehearsal:
    """Of the picture that these would give: few splats and pixels, with the same effects."""
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
    return Rehearsal(
        renderer=renderer,
        gaussians=few,
        camera=replace(camera.resized(*SIZE), world_to_camera=placed.world_to_camera),
        settings=settings,
        mode=mode,
        edits=edits,
        overlay=overlay,
        variants=variants,
        gl_version=gl_version,
    )


def perform(rehearsal: Rehearsal) -> None:
    if rehearsal.renderer == "cpu":
        draw_by_cpu(rehearsal)
    else:
        draw_by_gl(rehearsal)


def draw_by_cpu(rehearsal: Rehearsal) -> None:
    from ... import raster
    from .tinting import tinted

    edits = rehearsal.edits
    if edits is not None:
        lit = replace(edits, marks=np.full_like(edits.marks, edits.flags))
        tinted(lit, rehearsal.overlay or Overlay())
    raster.render(rehearsal.gaussians, rehearsal.camera, rehearsal.settings, edits=edits)


def draw_by_gl(rehearsal: Rehearsal) -> None:
    from . import make_renderer

    ctx = hidden_context(rehearsal.gl_version)
    variants = Variants(ctx)
    renderer = make_renderer(ctx, rehearsal.renderer, variants)
    renderer.render(
        rehearsal.gaussians,
        rehearsal.camera,
        rehearsal.settings,
        mode=rehearsal.mode,
        edits=rehearsal.edits,
        overlay=rehearsal.overlay,
    )
    # So few splats may be stored otherwise than the scene they stand for.
    for variant in rehearsal.variants - variants.made:
        load(ctx, variant)
    ctx.finish()
    time.sleep(LINGER)
    ctx.release()


def hidden_context(version: tuple[int, int] | None) -> moderngl.Context:
    """As the window has it, so that the driver takes one for the other; None: without a window."""
    from .context import create_headless_context

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
