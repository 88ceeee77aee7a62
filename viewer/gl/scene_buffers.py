"""A scene on the GPU: one storage buffer an attribute, in pages that respect the driver's limits."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import moderngl
import numpy as np

from ...scene import Gaussians
from ...scene.gaussians import SH_COEFFICIENTS
from ...scene.projection import sigmoid
from ...scene.stored import FORMATS, Attributes, half, sh_levels, stored_quats
from .placement import Placement, placement_of

GROUP_SIZE = 256
"""Splats a work group projects; pages are whole groups."""

UPLOAD_SLICE = 65_536
"""Splats prepared and uploaded between two steps of `upload_steps`: a few milliseconds of work."""

BYTES_A_SPLAT = (3 + 4 + 4) * 4
"""Positions, quaternions, scales and opacity in float32; spherical harmonics come on top."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Page:
    """Splats `first` to `first + count` of a scene."""

    first: int
    count: int
    positions: moderngl.Buffer
    """count x 3 float32, relative to the scene's centre."""
    quats: moderngl.Buffer
    """count x 4 float32, wxyz, raw; or float16."""
    scales_opacity: moderngl.Buffer
    """count x 4 float32: standard deviations in world units, opacity; activated here, where exp is exact.
    Or float16, the scales as logarithms, whose range they need."""
    sh: moderngl.Buffer
    """count x K x 3 float32, K of the degree in use; or what `sh_words` makes of them."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneBuffers:
    """All pages of a scene; release it before its context goes."""

    splats: int
    placement: Placement
    sh_degree: int
    """Highest degree with a coefficient that is not zero: higher bands are not uploaded."""
    attributes: Attributes
    pages: tuple[Page, ...]

    def flags(self) -> dict[str, float | bool]:
        """Of ``quads/attributes.glsl`` and ``quads/harmonics.glsl``."""
        return {
            "ATTRIBUTES": FORMATS.index(self.attributes),
            "SH_STORED": SH_COEFFICIENTS[self.sh_degree],
            "SH_WORDS": sh_bytes(SH_COEFFICIENTS[self.sh_degree], self.attributes) // 4,
        }

    def release(self) -> None:
        for page in self.pages:
            for buffer in (page.positions, page.quats, page.scales_opacity, page.sh):
                buffer.release()


def storage_limit(ctx: moderngl.Context) -> int:
    """Bytes one storage buffer may have on this driver (128 MiB on Mesa)."""
    return int(ctx.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])


def degree_in_use(sh: np.ndarray) -> int:
    """The lowest degree that shows `sh` (N, K, 3) unchanged: bands that are all zero do not count."""
    for degree in range(SH_COEFFICIENTS.index(sh.shape[1]), 0, -1):
        if sh[:, SH_COEFFICIENTS[degree - 1] :].any():
            return degree
    return 0


def upload_steps(
    ctx: moderngl.Context,
    gaussians: Gaussians,
    *,
    attributes: Attributes = "float32",
    limit: int | None = None,
) -> Generator[float | SceneBuffers, None, None]:
    """Uploads in slices: yields the share done (0 to 1) after each, and last the `SceneBuffers`.

    Closing the generator early releases what it had uploaded. `limit` is bytes a buffer may have.
    """
    n = len(gaussians)
    degree = degree_in_use(gaussians.sh)
    coefficients = SH_COEFFICIENTS[degree]
    placement = placement_of(gaussians.means)
    sh_size = sh_bytes(coefficients, attributes)
    row = 16 if attributes == "float32" else 8
    largest = max(16, sh_size)
    fitting = (limit or storage_limit(ctx)) // largest
    page_size = max(GROUP_SIZE, fitting // GROUP_SIZE * GROUP_SIZE)
    pages: list[Page] = []
    done = False
    try:
        for first in range(0, n, page_size):
            count = min(page_size, n - first)
            page = Page(
                first=first,
                count=count,
                positions=ctx.buffer(reserve=count * 12),
                quats=ctx.buffer(reserve=count * row),
                scales_opacity=ctx.buffer(reserve=count * row),
                sh=ctx.buffer(reserve=count * sh_size),
            )
            pages.append(page)
            for start in range(first, first + count, UPLOAD_SLICE):
                part = slice(start, min(start + UPLOAD_SLICE, first + count))
                _fill(page, gaussians, part, placement.centre, coefficients, attributes)
                yield part.stop / n
        done = True
        yield _scene(n, placement, degree, attributes, pages)
    finally:
        if not done:
            _scene(n, placement, degree, attributes, pages).release()


def _scene(
    splats: int, placement: Placement, sh_degree: int, attributes: Attributes, pages: list[Page]
) -> SceneBuffers:
    return SceneBuffers(
        splats=splats, placement=placement, sh_degree=sh_degree, attributes=attributes, pages=tuple(pages)
    )


def sh_bytes(coefficients: int, attributes: Attributes) -> int:
    """Bytes of a splat's harmonics; whole words of 4."""
    if attributes == "float32":
        return coefficients * 12
    if attributes == "float16":
        return -(-coefficients * 3 // 2) * 4
    return 8 + -(-(coefficients - 1) * 3 // 4) * 4


def sh_words(sh: np.ndarray, attributes: Attributes) -> np.ndarray:
    """(n, K, 3) float32 as the shader reads it: (n, bytes). 8-bit: the constant band and the step in float16,
    then a signed byte a number."""
    n = len(sh)
    words = np.zeros((n, sh_bytes(sh.shape[1], attributes)), np.uint8)
    if attributes == "float16":
        words[:, : sh.shape[1] * 6] = half(sh).reshape(n, -1).view(np.uint8)
        return words
    levels, steps = sh_levels(sh)
    words[:, :6] = half(np.ascontiguousarray(sh[:, 0])).view(np.uint8)
    words[:, 6:8] = steps[:, None].view(np.uint8)
    rest = (sh.shape[1] - 1) * 3
    words[:, 8 : 8 + rest] = levels.reshape(n, rest).view(np.uint8)
    return words


def _fill(
    page: Page,
    gaussians: Gaussians,
    part: slice,
    centre: np.ndarray,
    coefficients: int,
    attributes: Attributes,
) -> None:
    at = part.start - page.first
    with np.errstate(over="ignore", invalid="ignore"):
        positions = (gaussians.means[part].astype(np.float64) - centre).astype(np.float32)
        activated = np.empty((part.stop - part.start, 4), dtype=np.float32)
        scales = gaussians.log_scales[part]
        activated[:, :3] = np.exp(scales) if attributes == "float32" else scales
        activated[:, 3] = sigmoid(gaussians.opacity_logits[part])
    page.positions.write(positions, offset=at * 12)
    sh = np.ascontiguousarray(gaussians.sh[part, :coefficients])
    if attributes != "float32":
        page.quats.write(stored_quats(gaussians.quats[part]), offset=at * 8)
        page.scales_opacity.write(half(activated), offset=at * 8)
        page.sh.write(sh_words(sh, attributes), offset=at * sh_bytes(coefficients, attributes))
        return
    page.quats.write(np.ascontiguousarray(gaussians.quats[part]), offset=at * 16)
    page.scales_opacity.write(activated, offset=at * 16)
    page.sh.write(sh, offset=at * coefficients * 12)
