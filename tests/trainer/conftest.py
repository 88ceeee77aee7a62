"""A small capture with known truth: views of a scene of random splats, with noise points as SfM gives."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatview.raster import Parameters, render
from splatview.scene import Camera, Gaussians, RenderSettings, look_at
from splatview.scene.captures.capture import Capture, Photo, Pixels
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.initialisation import initial_parameters
from splatview.trainer.settings import TrainSettings
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews

VIEWS = 20
EXTENT = 3.0


def capture_of(
    views: Sequence[TrainView], points: np.ndarray, colours: np.ndarray, *, guessed: bool = False
) -> Capture:
    """The capture of these photos, none held out, with points (P, 3) and colours (P, 3) uint8."""
    photos = tuple(
        Photo(
            name=view.camera.name or f"{row}.png",
            camera=view.camera,
            held_out=False,
            pixels=lambda view=view: Pixels(image=view.pixels, mask=None),
        )
        for row, view in enumerate(views)
    )
    return Capture(name="photos", photos=photos, points=points, point_colours=colours, guessed=guessed)


def whole_and_resumed(another: Callable[[], Trainer], path: Path) -> tuple[Trainer, Trainer]:
    """A run of 90 steps, and an equal one that was saved after 40 and resumed, whose splats are the same."""
    whole, part = another(), another()
    for _ in range(40):
        whole.step()
        part.step()
    save_checkpoint(part, path)
    resumed = another()
    restore(resumed, load_checkpoint(path))
    for _ in range(50):
        whole.step()
        resumed.step()
    for ours, theirs in zip(whole.splats.arrays, resumed.splats.arrays, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    return whole, resumed


@pytest.fixture(scope="session")
def truth() -> Gaussians:
    """60 opaque, mid-sized splats in a unit ball."""
    rng = np.random.default_rng(3)
    count = 60
    return Gaussians(
        means=rng.uniform(-0.6, 0.6, size=(count, 3)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=rng.normal(-2.0, 0.4, size=(count, 3)).astype(np.float32),
        opacity_logits=np.full(count, 2.0, np.float32),
        sh=rng.normal(scale=1.0, size=(count, 1, 3)).astype(np.float32),
    )


@pytest.fixture(scope="session")
def views(truth: Gaussians) -> list[TrainView]:
    """Photos of it, 48x40, from a ring."""
    made = []
    for view in range(VIEWS):
        angle = 2 * math.pi * view / VIEWS
        eye = (2.5 * math.cos(angle), 0.8, 2.5 * math.sin(angle))
        camera = look_at(eye, (0, 0, 0), width=48, height=40)
        named = Camera(
            width=48,
            height=40,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
            world_to_camera=camera.world_to_camera,
            name=f"view_{view}.png",
        )
        picture = render(truth, named, RenderSettings(background=(0.2, 0.2, 0.2)))[..., :3]
        made.append(TrainView(named, (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)))
    return made


@pytest.fixture(scope="session")
def points(truth: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Points near the splats' middles, and grey colours."""
    noise = np.random.default_rng(4).normal(scale=0.05, size=truth.means.shape)
    return truth.means.astype(np.float64) + noise, np.full(truth.means.shape, 128, np.uint8)


@pytest.fixture
def start(points: tuple[np.ndarray, np.ndarray]) -> Parameters:
    return initial_parameters(*points, EXTENT)


@pytest.fixture
def make_trainer(views: list[TrainView], start: Parameters) -> Callable[..., Trainer]:
    """`make_trainer(iterations=.., threads=.., **settings)`: a trainer of all photos but the first."""

    def make(*, threads: int = 2, **settings) -> Trainer:
        options = {"iterations": 200, "max_splats": 300, "background": (0.2, 0.2, 0.2), **settings}
        chosen = TrainSettings(**options)
        return Trainer(TrainViews(views[1:], chosen.seed), start, EXTENT, chosen, threads=threads)

    return make


@pytest.fixture
def capture_folder(tmp_path: Path, views: list[TrainView], points: tuple[np.ndarray, np.ndarray]) -> Path:
    """The same as a COLMAP text model with images on disk."""
    folder = tmp_path / "toy"
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (folder / "images").mkdir()
    camera = views[0].camera
    (model / "cameras.txt").write_text(
        f"1 PINHOLE {camera.width} {camera.height} {camera.fx} {camera.fy} {camera.cx} {camera.cy}\n"
    )
    lines = []
    for number, view in enumerate(views, start=1):
        w, x, y, z = quaternion(view.camera.R_camera_world)
        tx, ty, tz = view.camera.t_camera_world
        lines += [f"{number} {w} {x} {y} {z} {tx} {ty} {tz} 1 {view.camera.name}", ""]
        Image.fromarray(view.pixels).save(folder / "images" / view.camera.name)
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    (model / "points3D.txt").write_text(
        "".join(
            f"{number} {x} {y} {z} {r} {g} {b} 0.5\n"
            for number, ((x, y, z), (r, g, b)) in enumerate(zip(*points, strict=True), start=1)
        )
    )
    return folder


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """wxyz of a rotation matrix, by the largest eigenvector of Bar-Itzhack's matrix (2000)."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r.trace()],
        ]
    )
    x, y, z, w = np.linalg.eigh(k)[1][:, -1]
    return np.array([w, x, y, z])
