"""What training moves: a scene's parameters with Adam's two averages beside each."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from splatview.edit.kernels.kdtree import nearest
from splatview.raster import Parameters
from splatview.scene import Gaussians, ImageModel, InputError
from splatview.scene.gaussians import SH_COEFFICIENTS
from splatview.scene.image_model import BLUR
from splatview.scene.sh import SH_C0


@dataclass(eq=False)
class Splats:
    """N splats in training, all arrays float32 and changed in place by the optimiser only."""

    parameters: Parameters
    first: Parameters
    """Adam's running average of the gradient, in the shapes of `parameters`."""
    second: Parameters
    """Adam's running average of the squared gradient."""
    ids: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    """(N,) int64: numbers of the splats. A splat keeps its number as long as it lives and no number is given
    twice, so that what was chosen on an earlier snapshot can still be found. From 0 on where left out."""
    next_id: int = 0

    def __post_init__(self) -> None:
        if len(self.ids) == 0:
            self.ids = np.arange(self.next_id, self.next_id + len(self), dtype=np.int64)
            self.next_id += len(self)
        if len(self.ids) != len(self):
            raise ValueError(f"ids must be {len(self)} numbers, got {len(self.ids)}")

    def __len__(self) -> int:
        return len(self.parameters.means)

    @property
    def sh_degree(self) -> int:
        """The highest SH degree in training."""
        return SH_COEFFICIENTS.index(self.parameters.sh.shape[1])

    def take(self, indices: np.ndarray) -> Splats:
        """The splats at `indices` (integers or a mask), copied, averages included."""
        groups = [Parameters(*(array[indices] for array in group)) for group in self._groups()]
        return Splats(groups[0], groups[1], groups[2], self.ids[indices], self.next_id)

    def joined(self, parameters: Parameters) -> Splats:
        """These and new splats behind them, whose averages are 0."""
        zeros = Parameters(*(np.zeros_like(array) for array in parameters))
        others = (parameters, zeros, zeros)
        groups = [
            Parameters(*(np.concatenate(pair) for pair in zip(group, other, strict=True)))
            for group, other in zip(self._groups(), others, strict=True)
        ]
        behind = self.next_id + len(parameters.means)
        ids = np.concatenate([self.ids, np.arange(self.next_id, behind, dtype=np.int64)])
        return Splats(groups[0], groups[1], groups[2], ids, behind)

    def renumber(self, indices: np.ndarray) -> None:
        """The splats at `indices`, distinct integers, are new ones in the places of old: in place."""
        self.ids = self.ids.copy()  # earlier snapshots hold the other
        self.ids[indices] = np.arange(self.next_id, self.next_id + len(indices))
        self.next_id += len(indices)

    def with_sh_degree(self, degree: int) -> Splats:
        """The same with coefficients up to `degree`; new ones are 0."""
        missing = SH_COEFFICIENTS[degree] - self.parameters.sh.shape[1]
        if missing == 0:
            return self
        groups = [
            group._replace(sh=np.pad(group.sh, ((0, 0), (0, missing), (0, 0)))) for group in self._groups()
        ]
        return Splats(groups[0], groups[1], groups[2], self.ids, self.next_id)

    def snapshot(self, comments: tuple[str, ...] = ()) -> Gaussians:
        """A copy that no later step changes."""
        arrays = {name: array.copy() for name, array in self.parameters._asdict().items()}
        return Gaussians(**arrays, comments=comments)

    def _groups(self) -> tuple[Parameters, Parameters, Parameters]:
        return self.parameters, self.first, self.second


def fresh(parameters: Parameters) -> Splats:
    """Splats that no step has moved yet; the arrays are copied."""
    zeros = [Parameters(*(np.zeros_like(array) for array in parameters)) for _ in range(2)]
    return Splats(Parameters(*(array.copy() for array in parameters)), zeros[0], zeros[1])


def mean_square_distance(points: np.ndarray, *, neighbours: int = 3) -> np.ndarray:
    """(N,) float64: the mean squared distance of each of points (N, 3) to its nearest others.

    Points all finite. Where there are fewer others, the mean is over those; a lone point has 0.
    """
    neighbours = min(neighbours, len(points) - 1)
    if neighbours < 1:
        return np.zeros(len(points))
    _, distances = nearest(points, neighbours)
    return np.square(distances).mean(axis=1)


INITIAL_OPACITY = 0.1
"""Kerbl et al. 2023: faint enough that what is behind a splat is trained too."""

LEAST_SQUARE_DISTANCE = 1e-7
"""In units of the scene's extent squared: points that coincide get splats of some size all the same."""


def initial_parameters(
    points: np.ndarray,
    colours: np.ndarray,
    extent: float,
    *,
    opacity: float = INITIAL_OPACITY,
    scale: float = 1.0,
    limit: int | None = None,
    seed: int = 0,
) -> Parameters:
    """Round splats at points (N, 3), of colours (N, 3) uint8, degree 0, float32.

    Their standard deviation is `scale` times the root of the mean squared distance to the three nearest
    neighbours. Points that are not finite are left out, and of more than `limit` points a sample is used.

    Raises:
        InputError: no point is left.
    """
    usable = np.isfinite(points).all(axis=1)
    points, colours = points[usable], colours[usable]
    if len(points) == 0:
        raise InputError("the capture has no usable 3D points to begin with")
    if limit is not None and len(points) > limit:
        sample = np.sort(np.random.default_rng(seed).choice(len(points), limit, replace=False))
        points, colours = points[sample], colours[sample]
    squares = mean_square_distance(points)
    squares = np.clip(squares, LEAST_SQUARE_DISTANCE * extent**2, extent**2)
    log_scales = 0.5 * np.log(squares) + math.log(scale)
    count = len(points)
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1
    return Parameters(
        means=np.ascontiguousarray(points, np.float32),
        quats=quats,
        log_scales=np.repeat(log_scales.astype(np.float32)[:, None], 3, axis=1),
        opacity_logits=np.full(count, math.log(opacity / (1 - opacity)), np.float32),
        sh=((colours.astype(np.float32) / 255 - 0.5) / SH_C0)[:, None, :].copy(),
    )


def comments_for(model: ImageModel) -> tuple[str, ...]:
    """The tags that `scene.effects.antialiasing` and other viewers understand; none for the usual model."""
    if not model.antialiased:
        return ()
    return ("antialiased 1",) if model.blur == BLUR else ("SplatRenderMode: mip",)
