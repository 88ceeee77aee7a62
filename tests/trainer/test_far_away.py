"""Captures in map coordinates train as those about the origin do, and all that leaves the trainer says where
in the world the scene is."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from splatview.cli.main import main
from splatview.measure.metrics import psnr
from splatview.raster import render
from splatview.scene import RenderSettings
from splatview.scene.captures import load_capture
from splatview.scene.captures.points import random_points
from splatview.scene.edits import Crop
from splatview.scene.formats import load_scene
from splatview.scene.projection import rotation_matrices
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.run import TrainingRun
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import train_views
from splatview.viewer.training.comparison import ComparisonRequest, compare
from splatview.viewer.training.live import watched_photos

MAP = np.array([500_000.0, 5_400_000.0, 300.0])
"""Metres in a UTM zone."""


def moved(folder: Path, to: Path, offset: np.ndarray) -> Path:
    """A copy of the COLMAP text model in `folder` whose world has its origin elsewhere."""
    shutil.copytree(folder, to)
    images, points = (to / "sparse" / "0" / name for name in ("images.txt", "points3D.txt"))
    lines = []
    for line in images.read_text().splitlines():
        words = line.split()
        if words:
            pose = np.array(words[1:8], float)
            pose[4:] -= rotation_matrices(pose[None, :4])[0] @ offset
            words[1:8] = map(repr, pose.tolist())
        lines.append(" ".join(words))
    images.write_text("\n".join(lines) + "\n")
    rows = [line.split() for line in points.read_text().splitlines()]
    at = [(np.array(row[1:4], float) + offset).tolist() for row in rows]
    points.write_text(
        "".join(
            f"{row[0]} {x!r} {y!r} {z!r} {' '.join(row[4:])}\n"
            for row, (x, y, z) in zip(rows, at, strict=True)
        )
    )
    return to


class Trained(NamedTuple):
    scene: Path
    psnr: float


def train(folder: Path, output: Path, *options: str) -> Trained:
    metrics = output.with_suffix(".jsonl")
    metrics.unlink(missing_ok=True)
    command = ["train", str(folder), "--headless", "-o", str(output), "--metrics", str(metrics)]
    assert main([*command, *options]) == 0
    return Trained(output, json.loads(metrics.read_text().splitlines()[-1])["psnr"])


def test_a_capture_in_map_coordinates_trains_as_well_and_its_scene_is_there(
    capture_folder: Path, tmp_path: Path
) -> None:
    near = train(capture_folder, tmp_path / "near.ply", "--iterations", "150")
    folder = moved(capture_folder, tmp_path / "map", MAP)
    far = train(folder, tmp_path / "far.ply", "--iterations", "150")
    assert far.psnr == pytest.approx(near.psnr, abs=0.2)
    scene = load_scene(far.scene)
    assert load_scene(near.scene).means.dtype == np.float32 and scene.means.dtype == np.float64
    assert np.abs(np.median(scene.means, axis=0) - MAP).max() < 1
    held_out = load_capture(folder).held_out
    settings = RenderSettings(background=(0.2, 0.2, 0.2))  # of the toy's photos
    scores = [
        psnr(render(scene, photo.camera, settings)[..., :3], photo.image() / np.float32(255))
        for photo in held_out
    ]
    assert np.mean(scores) == pytest.approx(far.psnr, abs=1e-3), "the file shows what was trained"


def test_a_run_far_away_resumes_bit_for_bit(capture_folder: Path, tmp_path: Path, monkeypatch) -> None:
    folder = moved(capture_folder, tmp_path / "map", MAP)
    whole = train(folder, tmp_path / "whole.ply", "--iterations", "60")
    step = TrainingRun.step

    def interrupted(self: TrainingRun):
        if self.trainer.counters.iteration == 25:
            raise KeyboardInterrupt
        return step(self)

    part = tmp_path / "part.ply"
    with monkeypatch.context() as patch:
        patch.setattr(TrainingRun, "step", interrupted)
        assert main(["train", str(folder), "--headless", "-o", str(part), "--iterations", "60"]) == 130
    train(folder, part, "--resume", str(tmp_path / "part.checkpoint.safetensors"))
    assert part.read_bytes() == whole.scene.read_bytes()


@pytest.fixture
def far_trainer(make_trainer: Callable[..., Trainer]) -> Callable[..., Trainer]:
    """As `make_trainer`, of a world whose origin is MAP away."""

    def make(**settings) -> Trainer:
        near = make_trainer(**settings)
        return Trainer(near.views, near.splats.arrays, near.extent, near.settings, centre=MAP, threads=2)

    return make


REGION = Crop(shape="box", centre=(-5.0, 0.0, 0.0), half_extents=(5.0, 10.0, 10.0))
"""x below 0."""

REGION_ON_THE_MAP = replace(REGION, centre=(MAP[0] - 5.0, MAP[1], MAP[2]))


@pytest.mark.parametrize("strategy", ["mcmc", "classic"])
def test_edits_while_training_are_in_the_world(far_trainer, make_trainer, strategy: str) -> None:
    options = {"iterations": 60, "strategy": strategy, "refine_from": 0.0, "refine_until": 1.0}
    near = make_trainer(**options, least_refine_steps=5, max_splats=150)
    far = far_trainer(**options, least_refine_steps=5, max_splats=150)
    for trainer, region in ((near, REGION), (far, REGION_ON_THE_MAP)):
        trainer.add_region(region)
        small = replace(region, half_extents=(5.0, 0.2, 10.0), keep="outside")
        assert trainer.crop([small]) > 0
        assert trainer.add_cut([replace(region, half_extents=(5.5, 10.0, 10.0))]) > 0
        while not trainer.done:
            trainer.step()
    assert far.settings.no_growth == (REGION_ON_THE_MAP,)
    np.testing.assert_array_equal(far.splats.ids, near.splats.ids)
    np.testing.assert_array_equal(far.splats.arrays.means, near.splats.arrays.means)
    np.testing.assert_array_equal(far.snapshot().means, near.splats.arrays.means + MAP)


def test_a_checkpoint_without_a_centre_is_moved_to_it(far_trainer, tmp_path: Path) -> None:
    """As written before captures were trained about a centre: its means are in the world."""
    trainer = far_trainer()
    trainer.centre = np.zeros(3)
    world = (trainer.splats.arrays.means + MAP).astype(np.float32)
    trainer.splats.arrays.means[:] = world
    save_checkpoint(trainer, tmp_path / "old.safetensors")
    resumed = far_trainer()
    restore(resumed, load_checkpoint(tmp_path / "old.safetensors"))
    np.testing.assert_array_equal(resumed.snapshot().means, world)


def test_the_window_has_the_photos_cameras_in_the_world(capture_folder: Path, tmp_path: Path) -> None:
    folder = moved(capture_folder, tmp_path / "map", MAP)
    far = train(folder, tmp_path / "far.ply", "--iterations", "40")
    capture = load_capture(folder)
    local = capture.about(capture.centre)
    photos = watched_photos(train_views(local.train), train_views(local.held_out), capture.centre)
    for photo, read in zip(photos, capture.photos, strict=True):
        np.testing.assert_allclose(photo.camera.eye, read.camera.eye, rtol=0, atol=1e-8)
    scene = load_scene(far.scene)
    over = RenderSettings(background=(0.2, 0.2, 0.2))  # of the toy's photos
    scores = [
        compare(ComparisonRequest(shot=photo.shot, gaussians=scene, settings=over, shrink=1, gain=1.0)).psnr
        for photo in photos
        if photo.held_out
    ]
    assert np.mean(scores) == pytest.approx(far.psnr, abs=1e-3)


@pytest.mark.parametrize("offset", [(0, 0, 0), (40, 0, 0), (60, 0, 0), (-7e6, 3.0, 1e-3)])
def test_centres(capture_folder: Path, tmp_path: Path, offset: tuple[float, float, float]) -> None:
    capture = load_capture(moved(capture_folder, tmp_path / "moved", np.array(offset, float)))
    centre, radius = capture.centre, capture.scene_radius
    if np.linalg.norm(offset) < 15 * radius:
        assert not centre.any(), "float32 values stay what they are"
        return
    local = capture.about(centre)
    assert not local.centre.any() and local.scene_radius == pytest.approx(radius)
    means = local.points.astype(np.float32)
    np.testing.assert_array_equal(((means + centre) - centre).astype(np.float32), means)
    for photo, moved_photo in zip(capture.photos, local.photos, strict=True):
        np.testing.assert_allclose(photo.camera.eye - centre, moved_photo.camera.eye, rtol=0, atol=1e-8)


def test_random_points_stand_before_cameras_whose_rotations_are_rounded(views) -> None:
    """In map coordinates a rotation that went through float32 is no inverse of its transpose."""
    cameras = []
    for view in views:
        turned = view.camera.world_to_camera.copy()
        turned[:3, :3] = turned[:3, :3].astype(np.float32)
        turned[:3, :3] = np.diag((-1.0, 1.0, -1.0)) @ turned[:3, :3]  # they look outwards
        cameras.append(replace(view.camera, world_to_camera=turned))
    here, _ = random_points(cameras, count=200)
    there, _ = random_points([camera.about(-MAP) for camera in cameras], count=200)
    np.testing.assert_allclose(there - MAP, here, atol=1e-6)
