"""A scene on the GPU: one storage buffer an attribute, in pages that respect the driver's limits."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from functools import partial

import moderngl
import numpy as np

from ...scene import Gaussians
from ...scene.gaussians import SH_COEFFICIENTS
from ...scene.projection import sigmoid
from ...scene.stored import FORMATS, Attributes, half, stored_quats
from .harmonics import StoredHarmonics, own_words, places, sh_words, stored_harmonics, words_by_degree
from .memory import reserve
from .placement import Placement, placement_of

GROUP_SIZE = 256
"""Splats a work group projects; pages are whole groups."""

UPLOAD_SLICE = 65_536
"""Splats prepared and uploaded between two steps of `upload_steps`: a few milliseconds of work."""

MOST_ADDRESSED = 1 << 31
"""Bytes of a buffer that `places` can count through, whatever the driver allows."""

BYTES_A_SPLAT = (3 + 4 + 4) * 4
"""Positions, quaternions, scales and opacity in float32; spherical harmonics come on top."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Page:
    """Splats `first` to `first + count` of a scene."""

    first: int
    count: int
    positions: moderngl.Buffer
    """count x 3 float32, relative to the scene's centre; where it is wide, then count x 3 that float32 left
    over."""
    quats: moderngl.Buffer
    """count x 4 float32, wxyz, raw; or float16."""
    scales_opacity: moderngl.Buffer
    """count x 4 float32: standard deviations in world units, opacity; activated here, where exp is exact.
    Or float16, the scales as logarithms, whose range they need."""
    sh: moderngl.Buffer
    """count x K x 3 float32, K of the scene's degree, or what `sh_words` makes of them. Where splats have
    their own degrees, count `places` first and then the words of each."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneBuffers:
    """All pages of a scene; release it before its context goes."""

    splats: int
    placement: Placement
    harmonics: StoredHarmonics
    attributes: Attributes
    pages: tuple[Page, ...]

    def flags(self) -> dict[str, float | bool]:
        """Of ``quads/attributes.glsl`` and ``quads/harmonics.glsl``."""
        return {
            "ATTRIBUTES": FORMATS.index(self.attributes),
            "SH_WORDS": int(words_by_degree(self.attributes)[self.sh_degree]),
            "OWN_DEGREES": self.harmonics.own_degrees is not None,
            "WIDE": self.placement.wide,
        }

    @property
    def sh_degree(self) -> int:
        """The highest that is uploaded."""
        return self.harmonics.sh_degree

    def release(self) -> None:
        for page in self.pages:
            for buffer in (page.positions, page.quats, page.scales_opacity, page.sh):
                buffer.release()


def storage_limit(ctx: moderngl.Context) -> int:
    """Bytes one storage buffer may have on this driver (128 MiB on Mesa)."""
    return int(ctx.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])


def upload_steps(
    ctx: moderngl.Context,
    gaussians: Gaussians,
    *,
    attributes: Attributes = "float32",
    every_band: bool = False,
    limit: int | None = None,
) -> Generator[float | SceneBuffers, None, None]:
    """Uploads in slices: yields the share done (0 to 1) after each, and last the `SceneBuffers`.

    Closing the generator early releases what it had uploaded. `every_band`: see `stored_harmonics`. `limit`
    is bytes a buffer may have.

    Raises:
        InputError: there is not enough graphics memory.
    """
    n = len(gaussians)
    harmonics = stored_harmonics(gaussians, every_band=every_band)
    placement = placement_of(gaussians.means, gaussians.log_scales)
    words = words_by_degree(attributes)
    row = 16 if attributes == "float32" else 8
    place = 0 if harmonics.own_degrees is None else 4
    position_row = 24 if placement.wide else 12
    largest = max(16, position_row, 4 * int(words[harmonics.sh_degree]) + place)
    fitting = min(limit or storage_limit(ctx), MOST_ADDRESSED) // largest
    page_size = max(GROUP_SIZE, fitting // GROUP_SIZE * GROUP_SIZE)
    pages: list[Page] = []
    done = False
    scene = partial(SceneBuffers, splats=n, placement=placement, harmonics=harmonics, attributes=attributes)
    try:
        for first in range(0, n, page_size):
            count = min(page_size, n - first)
            degrees = harmonics.of(slice(first, first + count))
            sh_size = 4 * int(words[degrees].sum()) + count * place
            sizes = (count * position_row, count * row, count * row, sh_size)
            positions, quats, scales_opacity, sh = reserve(ctx, sizes, f"{n:,} splats")
            page = Page(
                first=first,
                count=count,
                positions=positions,
                quats=quats,
                scales_opacity=scales_opacity,
                sh=sh,
            )
            pages.append(page)
            sh_at = count * place
            for start in range(first, first + count, UPLOAD_SLICE):
                part = slice(start, min(start + UPLOAD_SLICE, first + count))
                _fill(page, gaussians, part, placement, attributes)
                sh_at = _fill_harmonics(page, gaussians, part, harmonics, attributes, sh_at)
                yield part.stop / n
        done = True
        yield scene(pages=tuple(pages))
    finally:
        if not done:
            scene(pages=tuple(pages)).release()


def _fill(
    page: Page, gaussians: Gaussians, part: slice, placement: Placement, attributes: Attributes
) -> None:
    """Writes all but the harmonics of some splats."""
    at = part.start - page.first
    positions, rest = placement.split(gaussians.means[part])
    with np.errstate(over="ignore", invalid="ignore"):
        activated = np.empty((part.stop - part.start, 4), dtype=np.float32)
        scales = gaussians.log_scales[part]
        activated[:, :3] = np.exp(scales) if attributes == "float32" else scales
        activated[:, 3] = sigmoid(gaussians.opacity_logits[part])
    page.positions.write(positions, offset=at * 12)
    if placement.wide:
        page.positions.write(rest, offset=(page.count + at) * 12)
    if attributes == "float32":
        page.quats.write(np.ascontiguousarray(gaussians.quats[part]), offset=at * 16)
        page.scales_opacity.write(activated, offset=at * 16)
        return
    page.quats.write(stored_quats(gaussians.quats[part]), offset=at * 8)
    page.scales_opacity.write(half(activated), offset=at * 8)


def _fill_harmonics(
    page: Page,
    gaussians: Gaussians,
    part: slice,
    harmonics: StoredHarmonics,
    attributes: Attributes,
    at: int,
) -> int:
    """Writes those of some splats from byte `at` of the page on; returns where the next ones begin."""
    sh = gaussians.sh[part, : SH_COEFFICIENTS[harmonics.sh_degree]]
    if harmonics.own_degrees is None:
        words = sh_words(sh, attributes)
    else:
        degrees = harmonics.of(part)
        words = own_words(sh, degrees, attributes)
        own = places(degrees, attributes, at // 4)[:-1]
        page.sh.write(own, offset=(part.start - page.first) * 4)
    page.sh.write(words, offset=at)
    return at + words.nbytes
