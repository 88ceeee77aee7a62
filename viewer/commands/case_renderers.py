"""Every renderer of this program as the catalogue of hard cases takes them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...measure.hard_cases.running import CaseRenderer, Draw, Precision
from ...scene import Camera, Gaussians, RenderSettings

NAMES = ("quads", "quads-gl33", "tiles", "cpu", "reference")
"""As `--renderer` takes them."""

GL_NAMES = ("quads", "quads-gl33", "tiles")


@contextmanager
def case_renderers(names: tuple[str, ...] = NAMES) -> Iterator[list[CaseRenderer]]:
    """Those called `names`, each in every precision that it blends in; freed at the end.

    Raises:
        InputError: one of them needs OpenGL, and there is none.
    """
    made: list[CaseRenderer] = []
    opened: list[Any] = []
    try:
        if any(name in GL_NAMES for name in names):
            made += gl_renderers(names, opened)
        if "cpu" in names:
            made.append(CaseRenderer(name="cpu", blend="float32", draw=draw_by_cpu))
        if "reference" in names:
            made.append(CaseRenderer(name="reference float64", blend="float32", draw=draw_by_reference))
            made.append(
                CaseRenderer(name="reference float32", blend="float32", draw=draw_by_reference_float32)
            )
        yield made
    finally:
        for thing in reversed(opened):
            thing.release()


def gl_renderers(names: tuple[str, ...], opened: list[Any]) -> list[CaseRenderer]:
    """The renderers by OpenGL on a context of their own; what has to be released goes to `opened`."""
    from ..gl.context import create_headless_context
    from ..gl.quads import QuadsRenderer
    from ..gl.quads_legacy import LegacyQuadsRenderer
    from ..gl.tiles import TilesRenderer

    context = create_headless_context()
    opened.append(context)
    kinds: list[tuple[str, Any]] = []
    if "quads" in names and context.version_code >= 430:
        kinds.append(("quads", QuadsRenderer))
    if "quads-gl33" in names or ("quads" in names and context.version_code < 430):
        kinds.append(("quads-gl33", LegacyQuadsRenderer))
    if "tiles" in names and context.version_code >= 430:
        kinds.append(("tiles", TilesRenderer))
    made: list[CaseRenderer] = []
    for name, kind in kinds:
        renderer = kind(context)
        opened.append(renderer)
        # Tiles keep their sums in float32 whatever they are asked for.
        blends: tuple[Precision, ...] = ("float32",) if name == "tiles" else ("float32", "float16")
        made += [CaseRenderer(name=name, blend=blend, draw=drawn_by(renderer)) for blend in blends]
    return made


def describe_gl() -> dict[str, str]:
    """Vendor, renderer and version of the OpenGL that is tested. Raises InputError where there is none."""
    from ..gl.context import create_headless_context, describe

    context = create_headless_context()
    try:
        info = describe(context)
    finally:
        context.release()
    return {"vendor": info.vendor, "renderer": info.renderer, "version": info.version}


def drawn_by(renderer: Any) -> Draw:
    def draw(gaussians: Gaussians, camera: Camera, settings: RenderSettings) -> np.ndarray:
        return renderer.render(gaussians, camera, settings)

    return draw


def draw_by_cpu(gaussians: Gaussians, camera: Camera, settings: RenderSettings) -> np.ndarray:
    from ...raster import render

    return render(gaussians, camera, settings)


def draw_by_reference(gaussians: Gaussians, camera: Camera, settings: RenderSettings) -> np.ndarray:
    from ...scene import reference

    return reference.render(gaussians, camera, settings)


def draw_by_reference_float32(gaussians: Gaussians, camera: Camera, settings: RenderSettings) -> np.ndarray:
    """The reference's formulas in single precision: what no renderer can be blamed for losing."""
    from ...scene import reference

    return reference.render(gaussians, camera, settings, dtype=np.float32)
