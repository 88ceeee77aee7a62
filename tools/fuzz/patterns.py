"""Splats whose attributes hold every kind of float32, drawn by a seed: each slot of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from splatview.scene import Camera, Gaussians, ImageModel, RenderSettings, look_at
from splatview.scene.image_model import MIN_QUAT_COMPONENT
from splatview.scene.lens import Lens
from splatview.scene.sh import SH_C0

NEAR, ALPHA_CUT, MAX_ALPHA = 0.01, 1 / 255, 0.99
"""Of the image model; where splats are put one number around them."""

SPECIAL_BITS = np.array(
    [
        *(0x00000000, 0x80000000, 0x00000001, 0x80000001, 0x007FFFFF, 0x807FFFFF),  # ±0, subnormals
        *(0x00800000, 0x80800000, 0x3F800000, 0xBF800000, 0x7F7FFFFF, 0xFF7FFFFF),  # least, ±1, greatest
        *(0x7F800000, 0xFF800000, 0x7FC00000, 0xFFC00000, 0x7F800001, 0xFFBFFFFF),  # ±inf, NaN, signalling
        *(0x7FFFFFFF, 0xFFFFFFFF, 0x5F3504F3, 0xDF3504F3, 0x1F3504F3, 0x9F3504F3),  # NaN; squares at the ends
    ],
    np.uint32,
)


def _logit(opacity: float) -> float:
    return math.log(opacity / (1 - opacity))


THRESHOLDS = {
    "mean": (NEAR, -NEAR, 2 * NEAR, 1e6, 1e7, 1e18, 1e19, 3.4028235e38),
    "quat": (MIN_QUAT_COMPONENT, -MIN_QUAT_COMPONENT, 1e-25, 1e-19, 1e19, 1e25, 3.4028235e38),
    "scale": (
        *(math.log(3.4028235e38), math.log(1.17549435e-38), -103.97, -30.0, 30.0, 44.0, 43.6, 40.0),
        *(0.5 * math.log(3.4e38) - math.log(5000.0), -4.0, 2.0),
    ),
    "opacity": (_logit(ALPHA_CUT), _logit(MAX_ALPHA), 17.0, -17.0, 88.7, -88.7, 104.0, -104.0, 100.0, -100.0),
    "sh": (-0.5 / SH_C0, 0.5 / SH_C0, 0.0, 1e18, -1e18, 3.4028235e38, -3.4028235e38, 1e-30),
}
"""Numbers at which a renderer decides, by attribute; tried with up to three steps of float32 to each side."""

SIZE = 16
"""Pixels a side of the pictures."""

RAYS = ("pinhole", "parallel", "lens")
"""How a block is seen."""

LENSES = (
    Lens(model="SIMPLE_RADIAL", parameters=(0.3,)),
    Lens(model="OPENCV", parameters=(-0.2, 0.05, 0.001, -0.002)),
    Lens(model="OPENCV_FISHEYE", parameters=(0.03, -0.01, 0.002, 0.0)),
    Lens(model="FULL_OPENCV", parameters=(0.1, 0.02, 0.001, 0.002, 0.01, 0.2, 0.03, 0.001)),
    Lens(model="FOV", parameters=(0.9,)),
    Lens(model="DIVISION", parameters=(0.1,)),
    Lens(model="EUCM", parameters=(0.6, 1.3)),
    Lens(model="THIN_PRISM_FISHEYE", parameters=(0.02, -0.01, 0.001, -0.001, 0.002, 0.0, 0.001, -0.001)),
)


@dataclass(frozen=True, eq=False)
class Block:
    """Splats to project, and how."""

    gaussians: Gaussians
    camera: Camera
    settings: RenderSettings


def block_of(seed: int, count: int, *, rays: str = "pinhole") -> Block:
    """The splats of one seed: of all SH degrees, seen by several cameras, antialiased or not. Whatever the
    `rays` (one of `RAYS`), they are the same."""
    rng = np.random.default_rng(seed)
    degree = int(rng.integers(0, 4))
    camera, where = _camera(int(rng.integers(0, 4)))
    means = rng.normal(size=(count, 3)) * (1, 1, 0.8) + where
    quats = rng.normal(size=(count, 4))
    log_scales = rng.normal(-3.0, 1.0, size=(count, 3))
    logits = rng.normal(0.5, 2.5, size=count)
    sh = rng.normal(0, 0.4, size=(count, (degree + 1) ** 2, 3))
    columns = {
        "mean": means.astype(np.float32),
        "quat": quats.astype(np.float32),
        "scale": log_scales.astype(np.float32),
        "opacity": logits.astype(np.float32)[:, None],
        "sh": sh.astype(np.float32).reshape(count, -1),
    }
    for name, column in columns.items():
        # A third of the splats has something odd in each attribute; some in all of its slots.
        for share, whole in ((0.25, False), (0.05, True)):
            rows = np.flatnonzero(rng.random(count) < share)
            slots = rng.integers(0, column.shape[1], len(rows))
            odd = _odd(rng, name, len(rows))
            if whole:
                column[rows] = odd[:, None]
            else:
                column[rows, slots] = odd
    gaussians = Gaussians(
        means=columns["mean"],
        quats=columns["quat"],
        log_scales=columns["scale"],
        opacity_logits=np.ascontiguousarray(columns["opacity"][:, 0]),
        sh=columns["sh"].reshape(count, -1, 3),
    )
    if rays == "parallel":
        # So many px a unit as show most of the splats.
        camera = replace(camera, orthographic=True, fx=4.0, fy=4.0, cx=SIZE / 2)
    elif rays == "lens":
        camera = replace(camera, lens=LENSES[seed // 4 % len(LENSES)])
    model = ImageModel(antialiased=bool(rng.integers(0, 2)))
    return Block(gaussians, camera, RenderSettings(model=model, blend="float32"))


def _camera(number: int) -> tuple[Camera, np.ndarray]:
    """A camera and what it looks at."""
    here = np.array([0.0, 0.0, 2.0])
    if number == 0:
        # At the origin and straight, so that depths are positions to the bit.
        return _straight(focal=20.0, cx=SIZE / 2), here
    if number == 1:
        return _straight(focal=300.0, cx=-20.0), here
    shift = np.zeros(3) if number == 2 else np.array([3e5, -2e6, 1e6])
    eye = here + shift + np.array([1, -2, 3])
    return look_at(eye, here + shift, fov_y=50, width=SIZE, height=SIZE), here + shift


def _straight(*, focal: float, cx: float) -> Camera:
    values = {"width": SIZE, "height": SIZE, "fx": focal, "fy": focal, "cx": cx, "cy": SIZE / 2}
    return Camera(**values, world_to_camera=np.eye(4))  # pyright: ignore[reportArgumentType]


def _odd(rng: np.random.Generator, name: str, count: int) -> np.ndarray:
    """(count,) float32: special patterns, numbers around thresholds, and any bits at all."""
    bits = rng.integers(0, 1 << 32, count, dtype=np.uint32)
    kind = rng.random(count)
    special = SPECIAL_BITS[rng.integers(0, len(SPECIAL_BITS), count)]
    near = np.array(THRESHOLDS[name], np.float64).astype(np.float32)
    close = near[rng.integers(0, len(near), count)].view(np.int32) + rng.integers(-3, 4, count).astype(
        np.int32
    )
    bits = np.where(kind < 0.4, special, np.where(kind < 0.75, close.view(np.uint32), bits))
    return bits.view(np.float32)
