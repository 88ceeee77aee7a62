"""Spherical harmonics as ``quads/harmonics.glsl`` reads them: all splats alike, or each by its own degree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scene.effects import degree_in_use, own_degrees, used_sh_degree
from ...scene.gaussians import SH_COEFFICIENTS, Gaussians
from ...scene.stored import Attributes, half, sh_levels

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
