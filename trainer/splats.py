"""What training moves: a scene's parameters with Adam's two averages beside each."""

from __future__ import annotations

from dataclasses import dataclass

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

    def __len__(self) -> int:
        return len(self.parameters.means)

    @property
    def sh_degree(self) -> int:
        """The highest SH degree in training."""
        return SH_COEFFICIENTS.index(self.parameters.sh.shape[1])

    def take(self, indices: np.ndarray) -> Splats:
        """The splats at `indices` (integers or a mask), copied, averages included."""
        return Splats(*(Parameters(*(array[indices] for array in group)) for group in self._groups()))

    def joined(self, parameters: Parameters) -> Splats:
        """These and new splats behind them, whose averages are 0."""
        zeros = Parameters(*(np.zeros_like(array) for array in parameters))
        others = (parameters, zeros, zeros)
        return Splats(
            *(
                Parameters(*(np.concatenate(pair) for pair in zip(group, other, strict=True)))
                for group, other in zip(self._groups(), others, strict=True)
            )
        )

    def with_sh_degree(self, degree: int) -> Splats:
        """The same with coefficients up to `degree`; new ones are 0."""
        missing = SH_COEFFICIENTS[degree] - self.parameters.sh.shape[1]
        if missing == 0:
            return self
        return Splats(
            *(group._replace(sh=np.pad(group.sh, ((0, 0), (0, missing), (0, 0)))) for group in self._groups())
        )

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
    return Splats(Parameters(*(array.copy() for array in parameters)), *zeros)
