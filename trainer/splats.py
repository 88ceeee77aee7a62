"""What training moves: a scene's parameters with Adam's two averages beside each."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..raster import Parameters
from ..scene import Gaussians
from ..scene.gaussians import SH_COEFFICIENTS


@dataclass(eq=False)
class Splats:
    """N splats in training, all arrays float32 and changed in place by the optimiser only."""

    parameters: Parameters
    first: Parameters
    """Adam's running average of the gradient, in the shapes of `parameters`."""
    second: Parameters
    """Adam's running average of the squared gradient."""
    ids: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    """(N,) int64: who is who. A splat keeps its number as long as it lives and no number is given twice, so
    that what was chosen on an earlier snapshot can still be found. From 0 on where left out."""
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
        means, quats, log_scales, opacity_logits, sh = (array.copy() for array in self.parameters)
        return Gaussians(
            means=means,
            quats=quats,
            log_scales=log_scales,
            opacity_logits=opacity_logits,
            sh=sh,
            comments=comments,
        )

    def _groups(self) -> tuple[Parameters, Parameters, Parameters]:
        return self.parameters, self.first, self.second


def fresh(parameters: Parameters) -> Splats:
    """Splats that no step has moved yet; the arrays are copied."""
    zeros = [Parameters(*(np.zeros_like(array) for array in parameters)) for _ in range(2)]
    return Splats(Parameters(*(array.copy() for array in parameters)), zeros[0], zeros[1])
