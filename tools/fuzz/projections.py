"""What each projection makes of splats, in one form, and whether it is what the float64 one says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import moderngl
import numpy as np
from patterns import Block

from splatview.raster import Frame, Parameters, Workspace, draw_frame, parameters_of
from splatview.raster.gradients import differentiate
from splatview.raster.project import BLUE, CONIC_SCALE, LOG2_OPACITY, RED, X_REST, A, C, X
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.scene_buffers import placement_of
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians
from splatview.scene.projection import FLOAT32_MAX, project

EPS = float(np.finfo(np.float32).eps)

STEPS = 4.0
"""Roundings of float32 by which inputs are moved to see what they decide, and how far they move a result."""

SENSITIVITY = 12.0
"""A result may be off by so many times what those roundings change it by: two trials find some, not all. One
splat was off by 9 times, of 11 million before pinholes and 27 million before lenses."""

OVERFLOWING = 0.05
"""Share of float32's largest number beyond which sums may overflow or not by the order of their terms."""

LARGEST_EXTENT = 1e15
"""px, of a footprint: of longer ones the thin side, relative to the long one, has a square near the smallest
numbers that have all their digits. Where subnormal numbers count as 0, as in llvmpipe's fragment stage, which
projects for old OpenGL, antialiasing is 0.2 to 0.6 % off from 3e15 px on."""

MEAN_PX, RELATIVE, COLOUR = 2e-3, 2e-4, 2e-5
"""What float32 may lose anyway: px; of conic and opacity; of a colour, in units of its coefficients."""


@dataclass(frozen=True, eq=False)
class Projected:
    """N splats as a projection sees them. Rows of splats that are not visible mean nothing."""

    visible: np.ndarray
    """(N,) bool"""
    means2d: np.ndarray
    """(N, 2) px"""
    conics: np.ndarray
    """(N, 3) 1/px: a, b, c"""
    opacities: np.ndarray
    """(N,)"""
    colours: np.ndarray
    """(N, 3)"""
    finite: bool = True
    """No NaN or infinity in any record of a visible splat, nor in the picture, nor in gradients."""


Projection = Callable[[Block], Projected]


def by_reference(gaussians: Gaussians, block: Block) -> tuple[Projected, np.ndarray]:
    """In float64; and the half extents (N, 2) px."""
    footprints = project(gaussians, block.camera, block.settings)
    n, at = len(gaussians), footprints.indices
    visible = np.zeros(n, bool)
    visible[at] = True
    columns = []
    for values in (
        *(footprints.means2d, footprints.conic_factors, footprints.opacities[:, None], footprints.colours),
        footprints.half_extents,
    ):
        column = np.full((n, values.shape[1]), np.nan)
        column[at] = values
        columns.append(column)
    means2d, conics, opacities, colours, extents = columns
    return Projected(visible, means2d, conics, opacities[:, 0], colours), extents


class GLProjection:
    """That of the `quads` renderer, which `tiles` shares, or of the one for old OpenGL; pictures as well."""

    def __init__(self, ctx: moderngl.Context, *, legacy: bool) -> None:
        self._renderer = QuadsGL33Renderer(ctx) if legacy else QuadsRenderer(ctx)
        self._legacy = legacy

    def __call__(self, block: Block) -> Projected:
        renderer: Any = self._renderer
        n = len(block.gaussians)
        image = renderer.render(FrameRequest(block.gaussians, block.camera, block.settings))
        if self._legacy:
            textures = renderer._projection._textures
            rows = [np.frombuffer(t.read(), np.float32).reshape(-1, 4)[:n] for t in textures]
            # A culled splat's texels stay 0, and no conic is.
            visible = rows[0][:, 2] != 0
        else:
            projector = renderer._projector
            records = np.frombuffer(projector.records.read(), np.float32).reshape(-1, 3, 4)[:n]
            rows = [records[:, field] for field in range(3)]
            visible = np.frombuffer(projector.depth_keys.read(), np.uint32)[:n] != 0xFFFFFFFF
        shapes, bounds, colours = rows
        finite = np.isfinite(image).all() and all(np.isfinite(row[visible]).all() for row in rows)
        return Projected(
            visible=visible,
            means2d=shapes[:, :2],
            conics=np.concatenate([shapes[:, 2:], bounds[:, :1]], axis=1),
            opacities=colours[:, 3],
            colours=colours[:, :3],
            finite=bool(finite),
        )

    def release(self) -> None:
        self._renderer.close()


class CpuProjection:
    """That of the numba kernels, in float32 records; with `backward`, gradients of any loss as well."""

    def __init__(self, *, backward: bool = False, threads: int | None = None) -> None:
        self._backward, self._threads = backward, threads
        self._workspace = Workspace()

    def __call__(self, block: Block) -> Projected:
        frame = self._frame(block, parameters_of(block.gaussians))
        visible = np.zeros(len(block.gaussians), bool)
        for start, stop in frame.runs:
            visible[frame.visible[start:stop]] = True
        records = frame.records
        finite = np.isfinite(frame.image).all() and np.isfinite(records[visible][:, : BLUE + 3]).all()
        # Rows of splats that are not visible hold anything.
        with np.errstate(over="ignore", invalid="ignore"):
            result = Projected(
                visible=visible,
                means2d=records[:, X : X + 2].astype(np.float64) + records[:, X_REST : X_REST + 2],
                conics=records[:, A : C + 1] / CONIC_SCALE,
                opacities=np.exp2(records[:, LOG2_OPACITY].astype(np.float64)),
                colours=records[:, RED : BLUE + 1].copy(),
                finite=bool(finite),
            )
        if self._backward:
            result = replace(result, finite=result.finite and self._has_finite_gradients(block))
        return result

    def _frame(self, block: Block, splats: Parameters) -> Frame:
        return draw_frame(splats, block.camera, block.settings, self._workspace, threads=self._threads)

    def _has_finite_gradients(self, block: Block) -> bool:
        splats = parameters_of(_bounded(block.gaussians))
        frame = self._frame(block, splats)
        d_image = np.random.default_rng(0).normal(size=frame.image.shape).astype(np.float32)
        gradients = differentiate(splats, frame, d_image)
        arrays: list[Any] = [*gradients.parameters, gradients.means2d, gradients.abs_means2d, gradients.pose]
        return all(np.isfinite(array).all() for array in arrays)


def _bounded(gaussians: Gaussians) -> Gaussians:
    """The same with finite harmonics of at most 1e4: a colour of 1e38 beside another has derivatives that are
    larger than any number."""
    sh = gaussians.sh
    with np.errstate(invalid="ignore"):
        return replace(gaussians, sh=np.where(np.isfinite(sh), np.clip(sh, -1e4, 1e4), sh))


@dataclass(frozen=True, eq=False)
class Truth:
    """What a projection may say about a block."""

    reference: Projected
    must_show: np.ndarray
    """(N,) bool: within the picture, whatever float32 rounds."""
    must_cull: np.ndarray
    """(N,) bool: ill, behind, or too faint, whatever float32 rounds."""
    tolerances: tuple[np.ndarray, ...]
    """(N, 2), (N, 3), (N,), (N, 3): of the fields of `Projected` in order; at least 0, inf where free."""

    @property
    def undecided(self) -> int:
        """Splats that rounding decides, and those beside the picture."""
        return int(np.count_nonzero(~self.must_show & ~self.must_cull))


def truth_of(block: Block, seed: int) -> Truth:
    """By the reference on the splats as they are, and twice on splats that differ by roundings."""
    reference, extents = by_reference(block.gaussians, block)
    size = (block.camera.width, block.camera.height)
    shown, culled = _within(reference, extents, size), ~reference.visible
    spread = [np.zeros_like(values) for values in _values(reference)]
    rng = np.random.default_rng(seed)
    for way in (1.0, -1.0):
        moved, moved_extents = by_reference(_moved(block, rng, way), block)
        shown &= _within(moved, moved_extents, size)
        culled &= ~moved.visible
        with np.errstate(invalid="ignore"):
            for total, values, exact in zip(spread, _values(moved), _values(reference), strict=True):
                np.maximum(total, np.abs(values - exact), out=total)
    # Where a cut decides: with all a little in favour of being seen, and the other way round.
    at = np.flatnonzero(culled)
    favoured, _ = by_reference(_favoured(block.gaussians.take(at), block), block)
    culled[at[favoured.visible]] = False
    with np.errstate(invalid="ignore"):
        shown &= reference.opacities * (1 - RELATIVE) >= block.settings.model.alpha_cut
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        sums = np.abs(block.gaussians.sh).astype(np.float64).sum(axis=(1, 2))
        # NaN fails here: what has it is culled for certain.
        free = sums > OVERFLOWING * FLOAT32_MAX
        free |= (extents > LARGEST_EXTENT).any(axis=1)
        # Of culled ones there is no extent: by the longest axis at their depth.
        largest = np.exp(block.gaussians.log_scales.max(axis=1).astype(np.float64))
        depth = (block.gaussians.means - block.camera.eye) @ block.camera.forward
        pixels = largest * max(block.camera.fx, block.camera.fy) / depth
        free |= (largest <= FLOAT32_MAX) & (pixels > LARGEST_EXTENT)
        a, b, c = np.abs(reference.conics).T
        least = (
            MEAN_PX + RELATIVE * np.abs(reference.means2d),
            # b stands beside c in the form: q = (a·dx + b·dy)² + (c·dy)².
            RELATIVE * np.stack([a, b + c, c], axis=1),
            RELATIVE * reference.opacities,
            np.repeat(COLOUR * (1 + sums)[:, None], 3, axis=1),
        )
        tolerances = tuple(base + SENSITIVITY * total for base, total in zip(least, spread, strict=True))
    return Truth(reference, shown & ~free, culled & ~free, tolerances)


def wrong_rows(projected: Projected, truth: Truth) -> dict[str, np.ndarray]:
    """Indices of splats that the projection is wrong about, by what is wrong; empty arrays are left out."""
    both = projected.visible & truth.reference.visible
    found = {
        "not shown": truth.must_show & ~projected.visible,
        "not culled": truth.must_cull & projected.visible,
    }
    names = ("mean", "conic", "opacity", "colour")
    for name, values, exact, tolerance in zip(
        names, _values(projected), _values(truth.reference), truth.tolerances, strict=True
    ):
        with np.errstate(invalid="ignore"):
            off = np.abs(values - exact) > tolerance
        found[name] = both & truth.must_show & (off if off.ndim == 1 else off.any(axis=1))
    return {name: np.flatnonzero(rows) for name, rows in found.items() if rows.any()}


def _values(projected: Projected) -> tuple[np.ndarray, ...]:
    return (projected.means2d, projected.conics, projected.opacities, projected.colours)


def _within(projected: Projected, extents: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Whether the footprint's box holds a pixel centre of the picture for certain."""
    with np.errstate(invalid="ignore", over="ignore"):
        low, high = projected.means2d - extents + 0.05, projected.means2d + extents - 0.05
        reaches = (low <= np.array(size) - 0.5) & (high >= 0.5)
    return projected.visible & reaches.all(axis=1)


def _moved(block: Block, rng: np.random.Generator, way: float) -> Gaussians:
    """The splats with every attribute a few roundings off, as float32 arithmetic sees them.

    `way` 1: somewhat further, larger and more opaque, -1: the opposite, so that both sides of a cut are seen.
    """
    gaussians = block.gaussians
    amount = STEPS * EPS

    with np.errstate(over="ignore", invalid="ignore"):
        quats = gaussians.quats.astype(np.float64)
        largest = np.abs(quats).max(axis=1, keepdims=True)
        some = rng.normal(size=quats.shape)
        return replace(
            gaussians,
            means=gaussians.means + way * _shift(gaussians, block),
            quats=np.where(
                largest < 2e-30,
                quats * (1 + amount * some),
                quats + amount * largest * some,
            ).astype(np.float32),
            log_scales=_by_ulps(gaussians.log_scales, way * amount),
            opacity_logits=_by_ulps(gaussians.opacity_logits, way * amount),
        )


def _favoured(gaussians: Gaussians, block: Block) -> Gaussians:
    """The splats a few roundings further away, and as much more opaque as an opacity may be off."""
    with np.errstate(over="ignore", invalid="ignore"):
        return replace(
            gaussians,
            means=gaussians.means + _shift(gaussians, block),
            opacity_logits=(gaussians.opacity_logits.astype(np.float64) + RELATIVE).astype(np.float32),
        )


def _shift(gaussians: Gaussians, block: Block) -> np.ndarray:
    """(N, 3) float64: away from the camera by the roundings of positions."""
    means = gaussians.means.astype(np.float64)
    away = np.abs(means - block.camera.eye).max(axis=1, keepdims=True)
    # Positions are kept relative to a centre, whose distance rounds too.
    centre = placement_of(block.gaussians.means).centre
    away = away + np.abs(means - centre).max(axis=1, keepdims=True)
    return np.where(block.camera.forward >= 0, 1, -1) * STEPS * EPS * away


def _by_ulps(values: np.ndarray, amount: float) -> np.ndarray:
    """Moved by `amount`, absolute and relative."""
    exact = values.astype(np.float64)
    return (exact + amount * (1 + np.abs(exact))).astype(np.float32)
