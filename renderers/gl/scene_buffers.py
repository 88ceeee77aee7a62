"""A scene on the GPU: one storage buffer an attribute, in pages that respect the driver's limits."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from functools import partial
from weakref import WeakKeyDictionary

import moderngl
import numpy as np

from splatview.renderers.depth_colours import Middle, sample_step
from splatview.renderers.gl.context import reserve
from splatview.scene import Gaussians
from splatview.scene.attribute_formats import FORMATS, Attributes, half, sh_levels, stored_quats
from splatview.scene.effects.sh_bands import degree_in_use, own_degrees, used_sh_degree
from splatview.scene.gaussians import SH_COEFFICIENTS
from splatview.scene.projection import sigmoid

# Spherical harmonics as ``quads/harmonics.glsl`` reads them: all splats alike, or each by its own
# degree.


DEGREE_BITS = 2
"""A place is a word: where a splat's coefficients begin, counted in words, times four, plus its degree."""


@dataclass(frozen=True, eq=False, kw_only=True)
class StoredHarmonics:
    """Which coefficients of a scene are uploaded."""

    sh_degree: int
    """Of the highest band uploaded."""
    in_use: int
    """Of the highest band that is not all zero."""
    own_degrees: np.ndarray | None
    """(N,) uint8, the degree of each splat; None: all have `sh_degree`."""

    def lacks(self, sh_degree: int) -> bool:
        """Whether a picture of that degree needs bands that were not uploaded."""
        return self.sh_degree < min(sh_degree, self.in_use)

    def of(self, part: slice) -> np.ndarray:
        """(n,) uint8: the degrees of some splats, whose `part` has a start and a stop."""
        if self.own_degrees is None:
            return np.full(part.stop - part.start, self.sh_degree, np.uint8)
        return self.own_degrees[part]


def stored_harmonics(gaussians: Gaussians, *, every_band: bool) -> StoredHarmonics:
    """What is uploaded of a scene: the bands that can be seen or, `every_band`, all that are not zero.

    Bands that the census leaves out are uploaded only when somebody asks for them: see `Renderer`.
    """
    in_use = degree_in_use(gaussians.sh)
    degree = in_use if every_band or not in_use else min(in_use, used_sh_degree(gaussians))
    kept = gaussians.sh[:, : SH_COEFFICIENTS[degree]]
    return StoredHarmonics(sh_degree=degree, in_use=in_use, own_degrees=own_degrees(kept))


def sh_bytes(coefficients: int, attributes: Attributes) -> int:
    """Bytes of a splat's harmonics; whole words of 4."""
    if attributes == "float32":
        return coefficients * 12
    if attributes == "float16":
        return -(-coefficients * 3 // 2) * 4
    return 8 + -(-(coefficients - 1) * 3 // 4) * 4


def sh_words(sh: np.ndarray, attributes: Attributes) -> np.ndarray:
    """(n, K, 3) float32 as the shader reads it: (n, words) uint32. 8-bit: the constant band and the step in
    float16, then a signed byte a number."""
    n, numbers = len(sh), sh.shape[1] * 3
    if attributes == "float32":
        return np.ascontiguousarray(sh).reshape(n, numbers).view(np.uint32)
    packed = np.zeros((n, sh_bytes(sh.shape[1], attributes)), np.uint8)
    if attributes == "float16":
        packed[:, : numbers * 2] = half(sh).reshape(n, numbers).view(np.uint8)
        return packed.view(np.uint32)
    levels, steps = sh_levels(sh)
    packed[:, :6] = half(np.ascontiguousarray(sh[:, 0])).view(np.uint8)
    packed[:, 6:8] = steps[:, None].view(np.uint8)
    packed[:, 8 : 8 + numbers - 3] = levels.reshape(n, numbers - 3).view(np.uint8)
    return packed.view(np.uint32)


def words_by_degree(attributes: Attributes) -> np.ndarray:
    """(4,) int64: words of a splat's harmonics at each degree."""
    return np.array([sh_bytes(coefficients, attributes) // 4 for coefficients in SH_COEFFICIENTS])


def places(degrees: np.ndarray, attributes: Attributes, start: int) -> np.ndarray:
    """(n + 1,) uint32: the places of n splats whose words follow each other from word `start` of a page on,
    and that of one after the last."""
    starts = np.full(len(degrees) + 1, start, np.int64)
    starts[1:] += np.cumsum(words_by_degree(attributes)[degrees])
    return (starts << DEGREE_BITS | np.append(degrees, 0)).astype(np.uint32)


def own_words(sh: np.ndarray, degrees: np.ndarray, attributes: Attributes) -> np.ndarray:
    """(words,) uint32: of sh (n, K, 3), what each splat has by its own degree, one splat after the other.
    Beyond that it has zeros, in which some words end."""
    words = sh_words(sh, attributes)
    return words[np.arange(words.shape[1]) < words_by_degree(attributes)[degrees][:, None]]


FAR_FROM_ORIGIN = 4.0
"""Positions are stored relative to a centre once it lies this many scene radii from the origin; nearer
scenes keep their float32 values to the bit."""

REST_OF_SIZE = 5e-4
"""A splat that float32 moves by more than this share of its longest axis, a standard deviation, is drawn
differently by up to 3e-4 of its alpha (the steepest slope of a Gaussian is 0.61 a deviation)..."""

WIDE_SHARE = 0.01
"""... and where so many are, positions keep what float32 leaves over. A few that training lost far away do
not make a scene wide."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Placement:
    centre: np.ndarray
    """(3,) float64, world units: what positions are relative to."""
    median: np.ndarray
    """(3,) float64: median of the finite means."""
    radius: float
    """World units: half the splats lie within it of `median`; for colour ranges, not for culling."""
    wide: bool
    """Whether the scene reaches so far that no one centre keeps its digits in float32."""

    def split(self, means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`means` (N, 3) relative to the centre in float32, and what that leaves over, also in float32."""
        return _split(means, self.centre)


def _split(means: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    with np.errstate(over="ignore", invalid="ignore"):
        exact = means.astype(np.float64) - centre
        high = exact.astype(np.float32)
        rest = (exact - high).astype(np.float32)
    # What is not finite is culled by its position.
    return high, np.where(np.isfinite(rest), rest, np.float32(0))


def _is_wide(means: np.ndarray, log_scales: np.ndarray, centre: np.ndarray) -> bool:
    _, rest = _split(means, centre)
    if not rest.any():
        return False
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.exp(log_scales.astype(np.float64).max(axis=1))
        return bool((np.abs(rest).max(axis=1) > REST_OF_SIZE * sizes).mean() > WIDE_SHARE)


def placement_of(means: np.ndarray, log_scales: np.ndarray | None = None) -> Placement:
    """Of splats at `means` (N, 3); it is wide only where their `log_scales` (N, 3) say so."""
    middle = Middle.of(means)
    if middle is None:
        return Placement(centre=np.zeros(3), median=np.zeros(3), radius=1.0, wide=False)
    median, radius = middle.median, middle.radius
    far = not np.abs(median).max() <= FAR_FROM_ORIGIN * radius
    # On a coarse grid of float32 numbers, what lies near the centre keeps its digits relative to it.
    step = 2.0 ** np.floor(np.log2(radius)) if 0 < radius < np.inf else 0.0
    centre = np.round(median / step) * step if step > 0 else median
    centre = centre if far else np.zeros(3)  # guard: relative positions := centre = np.zeros(3)
    wide = False
    if log_scales is not None:
        some = slice(None, None, sample_step(len(means)))
        wide = _is_wide(means[some], log_scales[some], centre)  # guard: digits beyond float32
    return Placement(centre=centre, median=median, radius=radius or 1.0, wide=wide)


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


def finite_box(means: np.ndarray) -> np.ndarray:
    """(2, 3) float64: least and greatest finite coordinates of means (N, 3); a point where there are none."""
    with np.errstate(invalid="ignore"):
        if len(means):
            box = np.stack([means.min(axis=0), means.max(axis=0)]).astype(np.float64)
            if np.isfinite(box).all():
                return box
        finite = means[np.isfinite(means).all(axis=1)]
    if not len(finite):
        return np.zeros((2, 3))
    return np.stack([finite.min(axis=0), finite.max(axis=0)]).astype(np.float64)


@dataclass(frozen=True, eq=False, kw_only=True)
class UploadPlan:
    """What must be known of a scene before it is uploaded, and needs no OpenGL to be found out."""

    harmonics: StoredHarmonics
    """Those that are uploaded."""
    placement: Placement
    box: np.ndarray
    """Of `finite_box`."""


_plans: WeakKeyDictionary[Gaussians, dict[bool, UploadPlan]] = WeakKeyDictionary()


def upload_plan(gaussians: Gaussians, *, every_band: bool = False) -> UploadPlan:
    """The plan of a scene, found once, as its arrays never change. A thread that calls it first spares the
    one of the OpenGL context the better half of the upload's time on the processor.

    `every_band`: bands that cannot be seen are in it too, which is sooner decided. Who does not ask for that
    gets the plan without them, or the one that there is.
    """
    kept = _plans.setdefault(gaussians, {})
    known = kept.get(every_band) or (None if every_band else kept.get(True))
    if known is None:
        other = kept.get(not every_band)
        known = kept[every_band] = UploadPlan(
            harmonics=stored_harmonics(gaussians, every_band=every_band),
            placement=other.placement if other else placement_of(gaussians.means, gaussians.log_scales),
            box=other.box if other else finite_box(gaussians.means),
        )
    return known


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
    is the largest size of a buffer in bytes.

    Raises:
        InputError: there is not enough graphics memory.
    """
    n = len(gaussians)
    found = upload_plan(gaussians, every_band=every_band)
    harmonics, placement = found.harmonics, found.placement
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
    page: Page, gaussians: Gaussians, part: slice, harmonics: StoredHarmonics, attributes: Attributes, at: int
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
