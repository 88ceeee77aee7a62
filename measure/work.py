"""The bill: what one picture takes in evaluations, arithmetic and bytes, beside what a NeRF would pay for it.

Operations are counted as hardware vendors count them, a multiply-add as two. The splats' are those of the
image model, tallied below by hand; the NeRF's are those of the network of Mildenhall et al. (2020).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from splatview.scene import Gaussians
from splatview.scene.effects.sh_bands import sh_operations


class Work(Protocol):
    """What a picture asked for, as the rasteriser counts it."""

    @property
    def evaluations(self) -> np.ndarray:
        """(H, W) int, splats blended in each pixel."""
        ...

    @property
    def pixel_splats(self) -> int: ...
    @property
    def pairs(self) -> int: ...
    @property
    def visible(self) -> int: ...
    @property
    def sh_degree(self) -> int: ...


EVALUATION_OPERATIONS = {
    "offset from the mean": 2,
    "quadratic form": 7,
    "exponential, as 2^x by a polynomial": 10,
    "cap and cut": 2,
    "weight, light left": 3,
    "three colours": 6,
}
"""Of one splat in one pixel."""

PROJECTION_OPERATIONS = {
    "to camera axes": 18,
    "rotation from the quaternion": 40,
    "scales, opacity (exponentials)": 40,
    "Jacobian times rotation times axes": 60,
    "covariance, conic, extents": 40,
    "direction to the eye": 12,
}
"""Of one visible splat, without its colour."""

SORT_PASSES, KEY_BYTES = 4, 8
"""A radix sort of 32-bit keys with 32-bit indices reads and writes them once a byte of the key."""

RECORD_BYTES, PAIR_BYTES, PIXEL_BYTES = 64, 4, 16

SAMPLES = 192
"""Network evaluations a pixel: 64 coarse and 128 fine samples of a ray."""

LAYERS, WIDTH = 8, 256
POSITION, DIRECTION = 63, 27
"""Inputs: 3 + 2·3·10 numbers of a position's encoding, 3 + 2·3·4 of a direction's."""

SKIP = 5
"""The layer that sees the position again."""


@dataclass(frozen=True, kw_only=True)
class Bill:
    """Of one view."""

    width: int
    height: int
    splats: int
    visible: int
    pairs: int
    """Of splats and 16x16 tiles: what is sorted into lists."""
    evaluations: int
    """Splats blended, over all pixels."""
    computed: int
    """Alphas that the rasteriser computed: whole blocks of pixels at a time."""
    mean: float
    """Evaluations a pixel..."""
    percentile: float
    """... and the 99th percentile of the pixels."""
    operations: int
    moved: int
    """Bytes read and written."""
    stored: int
    """Bytes of the scene in memory."""
    nerf_operations: int
    nerf_weights: int
    """Bytes, float32."""

    @property
    def pixels(self) -> int:
        return self.width * self.height

    @property
    def ratio(self) -> float:
        """Operations of the NeRF for one of the splats'."""
        return self.nerf_operations / max(self.operations, 1)


def bill_of(gaussians: Gaussians, work: Work) -> Bill:
    """The bill of the picture that `work` was counted in."""
    counts = work.evaluations
    height, width = counts.shape
    evaluations, coefficients = int(counts.sum()), (work.sh_degree + 1) ** 2
    colour = sh_operations(work.sh_degree)
    splat = sum(PROJECTION_OPERATIONS.values()) + colour
    # 11 numbers of shape and opacity, and the coefficients that are summed.
    read = 4 * (11 + 3 * coefficients)
    moved = (
        work.visible * (read + RECORD_BYTES + 2 * SORT_PASSES * KEY_BYTES)
        + work.pairs * (2 * PAIR_BYTES + RECORD_BYTES)
        + counts.size * PIXEL_BYTES
    )
    return Bill(
        width=width,
        height=height,
        splats=len(gaussians),
        visible=work.visible,
        pairs=work.pairs,
        evaluations=evaluations,
        computed=work.pixel_splats,
        mean=float(counts.mean()),
        percentile=float(np.percentile(counts, 99)),
        operations=evaluations * sum(EVALUATION_OPERATIONS.values()) + work.visible * splat,
        moved=moved,
        stored=gaussians.nbytes,
        nerf_operations=2 * multiply_adds() * SAMPLES * counts.size,
        nerf_weights=4 * weights(),
    )


def layers() -> tuple[tuple[int, int], ...]:
    """(inputs, outputs) of the NeRF's layers: eight of 256, then density and a feature, then colour."""
    body = [
        (POSITION if layer == 1 else WIDTH + POSITION * (layer == SKIP + 1), WIDTH)
        for layer in range(1, LAYERS + 1)
    ]
    return (*body, (WIDTH, 1), (WIDTH, WIDTH), (WIDTH + DIRECTION, WIDTH // 2), (WIDTH // 2, 3))


def multiply_adds() -> int:
    """Of one evaluation of the network."""
    return sum(inputs * outputs for inputs, outputs in layers())


def weights() -> int:
    """Numbers of the network, biases included."""
    return sum((inputs + 1) * outputs for inputs, outputs in layers())


def rows(bill: Bill) -> list[tuple[str, str, str]]:
    """(what, splats, NeRF) as a person reads them."""
    return [
        ("evaluations a pixel, mean", f"{bill.mean:.1f} splats", f"{SAMPLES} networks"),
        ("evaluations a pixel, 99th percentile", f"{bill.percentile:.0f} splats", f"{SAMPLES} networks"),
        ("evaluations a picture", short(bill.evaluations), short(SAMPLES * bill.pixels)),
        (
            "operations an evaluation",
            str(sum(EVALUATION_OPERATIONS.values())),
            f"{2 * multiply_adds():,}",
        ),
        ("operations a picture", short(bill.operations), short(bill.nerf_operations)),
        ("splats projected and sorted", short(bill.visible), "none"),
        ("splat and tile pairs in lists", short(bill.pairs), "none"),
        ("bytes moved a picture", f"{short(bill.moved)}B", "the weights, from cache"),
        ("storage", f"{short(bill.stored)}B", f"{short(bill.nerf_weights)}B"),
    ]


def sums(bill: Bill) -> list[str]:
    """Where the numbers come from, a line each."""
    network = " + ".join(f"{inputs}·{outputs}" for inputs, outputs in layers())
    tally = " + ".join(f"{count} ({what})" for what, count in EVALUATION_OPERATIONS.items())
    return [
        f"NeRF, multiply-adds an evaluation: {network} = {multiply_adds():,}",
        f"NeRF, operations: 2 · {multiply_adds():,} · {SAMPLES} samples · {bill.pixels:,} pixels "
        f"= {short(bill.nerf_operations)}",
        f"NeRF, weights: {weights():,} numbers with biases, 4 bytes each = {short(bill.nerf_weights)}B",
        f"Splats, operations an evaluation: {tally} = {sum(EVALUATION_OPERATIONS.values())}",
        f"The same picture costs a NeRF {bill.ratio:,.0f} times the arithmetic; the splats take "
        f"{bill.stored / bill.nerf_weights:,.1f} times the storage.",
    ]


def as_json(bill: Bill) -> dict[str, Any]:
    """Numbers and sums."""
    fields: dict[str, Any] = json.loads(json.dumps(bill.__dict__))
    return {
        **fields,
        "rows": rows(bill),
        "sums": sums(bill),
        "operations_an_evaluation": EVALUATION_OPERATIONS,
        "nerf_multiply_adds": multiply_adds(),
        "nerf_samples": SAMPLES,
        "ratio": bill.ratio,
    }


def short(number: float) -> str:
    """1234567 -> "1.23 M"; a decimal prefix and three digits."""
    for unit, size in (("T", 1e12), ("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if number >= size:
            return f"{number / size:.3g} {unit}"
    return f"{number:.3g} "
