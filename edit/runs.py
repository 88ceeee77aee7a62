"""Sets of splats, kept small: what the history stores instead of masks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .loops import marks as kernels


@dataclass(frozen=True, eq=False)
class SplatSet:
    """Some of N splats: as runs, or where those would take more room, one bit a splat.

    Never more than N / 8 bytes, so the history of a scene has a bound that does not depend on how
    scattered the selections are.
    """

    size: int
    """N."""
    count: int
    """How many are in the set."""
    stored: np.ndarray
    """(R, 2) int32 start and count, or (ceil(N / 8),) uint8 bits, lowest first."""

    @classmethod
    def of_runs(cls, runs: np.ndarray, size: int) -> SplatSet:
        """`runs` (R, 2) int32, ascending and apart."""
        count = int(runs[:, 1].sum(dtype=np.int64))
        if runs.nbytes <= (size + 7) // 8:
            return cls(size, count, runs)
        mask = np.zeros(size, bool)
        kernels.fill_mask(runs, mask)
        return cls(size, count, np.packbits(mask, bitorder="little"))

    @classmethod
    def of_mask(cls, mask: np.ndarray) -> SplatSet:
        """`mask` (N,) bool."""
        return cls.of_runs(kernels.mask_runs(np.ascontiguousarray(mask, bool)), len(mask))

    @classmethod
    def of_flags(cls, marks: np.ndarray, care: int, value: int) -> SplatSet:
        """Those whose flags within `care` are exactly `value`."""
        return cls.of_runs(kernels.flag_runs(marks, care, value), len(marks))

    @property
    def runs(self) -> np.ndarray:
        """(R, 2) int32."""
        return self.stored if self.stored.ndim == 2 else kernels.mask_runs(self.mask)

    @property
    def mask(self) -> np.ndarray:
        """(N,) bool."""
        if self.stored.ndim == 1:
            return np.unpackbits(self.stored, count=self.size, bitorder="little").view(bool)
        mask = np.zeros(self.size, bool)
        kernels.fill_mask(self.stored, mask)
        return mask

    @property
    def indices(self) -> np.ndarray:
        """(count,) int64, ascending."""
        return np.flatnonzero(self.mask)

    @property
    def span(self) -> tuple[int, int]:
        """(start, stop) that holds all of it; (0, 0) if it is empty."""
        runs = self.runs
        return (int(runs[0, 0]), int(runs[-1].sum())) if len(runs) else (0, 0)

    @property
    def nbytes(self) -> int:
        return self.stored.nbytes

    def __len__(self) -> int:
        return self.count
