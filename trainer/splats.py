"""The parameters of a scene in training, as a module of torch over the arrays that the kernels work on."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from splatview.raster import Parameters
from splatview.scene import Gaussians
from splatview.scene.gaussians import SH_COEFFICIENTS


class Splats(nn.Module):
    """N splats in training: five parameters, float32, in the shapes of `scene.Gaussians`.

    Each parameter shares its memory with a numpy array, see `arrays`, which kernels read and write.
    `rasterize(*splats.parameters(), camera)` draws them. What changes their number replaces the parameters,
    see `strategies.ops`; take them from the module anew after that.
    """

    means: nn.Parameter
    quats: nn.Parameter
    log_scales: nn.Parameter
    opacity_logits: nn.Parameter
    sh: nn.Parameter

    def __init__(self, parameters: Parameters, ids: np.ndarray | None = None, next_id: int = 0) -> None:
        """`parameters` are shared where they are float32, contiguous and writable, else copied. `ids` (N,)
        int64 are the splats' numbers, all below `next_id`; None: from `next_id` on.

        Raises:
            ValueError: `ids` are not as many as there are splats.
        """
        super().__init__()
        self.ids = np.empty(0, np.int64)
        """(N,) int64: numbers of the splats. A splat keeps its number as long as it lives and no number is
        given twice, so that what was chosen on an earlier snapshot can still be found. Replaced, never
        written to: snapshots hold it too."""
        self.next_id = next_id
        self.replace(parameters, self.new_ids(len(parameters.means)) if ids is None else ids)

    def __len__(self) -> int:
        return len(self.means)

    @property
    def arrays(self) -> Parameters:
        """The parameters as numpy arrays in the same memory. What is written there is in the parameters, and
        no gradient knows of it."""
        return Parameters(*(self._parameters[name].detach().numpy() for name in Parameters._fields))  # pyright: ignore

    @property
    def sh_degree(self) -> int:
        """The highest SH degree in training."""
        return SH_COEFFICIENTS.index(self.sh.shape[1])

    def replace(self, parameters: Parameters, ids: np.ndarray) -> None:
        """Other arrays, shared as in the constructor, in the places of the present ones."""
        if len(ids) != len(parameters.means):
            raise ValueError(f"ids must be {len(parameters.means)} numbers, got {len(ids)}")
        for name, array in parameters._asdict().items():
            owned = np.require(array, np.float32, ("C", "ALIGNED", "WRITEABLE"))
            self.register_parameter(name, nn.Parameter(torch.from_numpy(owned)))
        self.ids = ids

    def new_ids(self, count: int) -> np.ndarray:
        """(count,) int64: numbers that no splat has had."""
        ids = np.arange(self.next_id, self.next_id + count, dtype=np.int64)
        self.next_id += count
        return ids

    def renumber(self, indices: np.ndarray) -> None:
        """The splats at `indices`, distinct integers, are new ones in the places of old."""
        ids = self.ids.copy()
        ids[indices] = self.new_ids(len(indices))
        self.ids = ids

    def snapshot(self, comments: tuple[str, ...] = ()) -> Gaussians:
        """A copy that no later step changes."""
        arrays = {name: array.copy() for name, array in self.arrays._asdict().items()}
        return Gaussians(**arrays, comments=comments)


def copied(parameters: Parameters) -> Parameters:
    """The same in memory of their own."""
    return Parameters(*(array.copy() for array in parameters))
