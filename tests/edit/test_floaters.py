"""Floaters planted in a scene that the project makes: nearly all are found, and nearly nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.edit.detectors import IsolatedClusters, SparseSplats
from splatview.edit.tools import NoTools
from splatview.scene import Gaussians, concatenate
from splatview.scene.demo import demo_scene
from splatview.scene.edits import DELETED, IDENTITY, PALETTE_SHIFT, Adjustment, SceneEdits, adjusted_means
from splatview.scene.formats import load_scene
from splatview.scene.framing import robust_bounds
from splatview.scene.progress import Cancelled, Progress

SINGLES = 150
CLUSTERS = 30


def plant(scene: Gaussians, *, seed: int = 0) -> tuple[Gaussians, np.ndarray]:
    """The scene with floaters, one by one and in clusters of 3 to 9, at some distance from anything, and
    which splats they are: fainter and larger than the scene's own, as those of training are."""
    rng = np.random.default_rng(seed)
    centre, radius = robust_bounds(scene.means)
    size = float(np.exp(np.median(scene.log_scales.max(axis=1))))
    places, some = [], scene.means[::8]
    while len(places) < SINGLES + CLUSTERS:
        place = centre + rng.uniform(-1.3, 1.3, 3) * radius
        if np.linalg.norm(some - place, axis=1).min() > 0.1 * radius:
            places.append(place)
    means = list(places[:SINGLES])
    for place in places[SINGLES:]:
        means += list(place + rng.normal(0, 2 * size, (rng.integers(3, 10), 3)))
    count = len(means)
    floaters = scene.take(rng.integers(0, len(scene), count))
    floaters = replace(
        floaters,
        means=np.array(means, np.float32),
        log_scales=floaters.log_scales + rng.uniform(0, 1.5, (count, 1)).astype(np.float32),
        opacity_logits=rng.normal(0, 1.5, count).astype(np.float32),
    )
    planted = np.zeros(len(scene) + count, bool)
    planted[len(scene) :] = True
    return concatenate([scene, floaters]), planted


def ring_and_ground(count: int) -> Gaussians:
    """A ring above a piece of ground, both of flat splats that overlap: three in four are the ring's, which
    is denser."""
    rng = np.random.default_rng(1)
    around, about = rng.uniform(0, 2 * np.pi, (2, count))
    width = 1 + 0.3 * np.cos(about)
    ring = np.stack([width * np.cos(around), 0.3 * np.sin(about), width * np.sin(around)], axis=1)
    ground = rng.uniform(-2, 2, (count, 3)) * (1, 0.01, 1) + (0, 0.5, 0)
    on_ground = np.arange(count) % 4 == 0
    sizes = np.where(on_ground, 0.04, 0.02)[:, None] * (1.0, 0.2, 1.0)
    return Gaussians(
        means=np.where(on_ground[:, None], ground, ring).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=np.log(sizes * rng.uniform(0.7, 1.4, (count, 3))).astype(np.float32),
        opacity_logits=rng.normal(2, 1, count).astype(np.float32),
        sh=rng.normal(0, 0.3, (count, 1, 3)).astype(np.float32),
    )


@pytest.fixture(scope="module")
def ring() -> tuple[Gaussians, np.ndarray]:
    return plant(ring_and_ground(30_000))


def no_edits(scene: Gaussians) -> SceneEdits:
    return SceneEdits(marks=np.zeros(len(scene), np.uint32))


def found(scene: Gaussians, edits: SceneEdits | None = None) -> np.ndarray:
    """By both detectors as they come."""
    edits = edits or no_edits(scene)
    masks = [
        kind().mask(kind().scores(scene, edits, NoTools()), kind.threshold)
        for kind in (IsolatedClusters, SparseSplats)
    ]
    return masks[0] | masks[1]


def test_planted_floaters_are_found(ring):
    scene, planted = ring
    flagged = found(scene)
    assert flagged[planted].mean() >= 0.95
    assert flagged[~planted].mean() <= 0.01


def test_in_a_landscape_with_a_coarse_sky():
    scene, planted = plant(demo_scene(splats=30_000))
    flagged = found(scene)
    assert flagged[planted].mean() >= 0.95
    assert flagged[~planted].mean() <= 0.01


@pytest.mark.parametrize("name", ["scenes/playbot_lod0.ply"])
@pytest.mark.slow
def test_in_a_trained_scene(data_file, name):
    scene, planted = plant(load_scene(data_file(name)))
    flagged = found(scene)
    assert flagged[planted].mean() >= 0.95
    assert flagged[~planted].mean() <= 0.01


def test_sparse_splats_are_those_alone(ring):
    scene, planted = ring
    scores = SparseSplats().scores(scene, no_edits(scene), NoTools())
    single = np.flatnonzero(planted)[:SINGLES]
    assert np.median(scores[single]) > SparseSplats.threshold
    assert np.median(scores[~planted]) <= 1


def test_neither_size_nor_place_of_the_scene_matters(ring):
    scene, _ = ring
    edits = no_edits(scene)
    moved = replace(
        edits,
        marks=np.full(len(scene), 1 << PALETTE_SHIFT, np.uint32),
        palette=(IDENTITY, Adjustment(scale=250.0, translation=(1e4, 0.0, -3e3))),
    )
    for detector in (IsolatedClusters(), SparseSplats()):
        here, there = (detector.scores(scene, e, NoTools()) for e in (edits, moved))
        np.testing.assert_allclose(here, there, rtol=1e-3)


def test_what_is_deleted_does_not_count(ring):
    scene, _ = ring
    marks = np.where(np.arange(len(scene)) % 2 == 0, DELETED, 0).astype(np.uint32)
    edits = SceneEdits(marks=marks, flags=DELETED)
    kept = np.flatnonzero(marks == 0)
    alone = scene.take(kept)
    for detector in (IsolatedClusters(), SparseSplats()):
        scores = detector.scores(scene, edits, NoTools())
        assert np.isnan(scores[marks != 0]).all()
        np.testing.assert_allclose(
            scores[kept], detector.scores(alone, no_edits(alone), NoTools()), rtol=1e-5
        )
        assert not detector.mask(scores, detector.threshold)[marks != 0].any()


def test_two_halves_a_gap_apart_are_both_kept_or_one_goes(edit_helpers):
    """The lighter of two clusters scores by how much lighter it is."""
    scene = edit_helpers.make_scene(900)
    means = scene.means * 0.5
    means[800:] += np.array((50, 0, 0), np.float32)
    scene = replace(scene, means=means, opacity_logits=np.zeros(900, np.float32))
    scores = IsolatedClusters(reach=6.0).scores(scene, no_edits(scene), NoTools())
    np.testing.assert_allclose(scores[:800], 1)
    np.testing.assert_allclose(scores[800:], 8)
    assert np.abs(adjusted_means(scene, no_edits(scene))[800:, 0].min()) > 40


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_scenes_of_hardly_anything(edit_helpers, count):
    scene = edit_helpers.make_scene(count)
    for detector in (IsolatedClusters(), SparseSplats()):
        scores = detector.scores(scene, no_edits(scene), NoTools())
        assert scores.shape == (count,)
        if count == 5:
            assert not np.isnan(scores).any()


def test_they_can_be_stopped(ring):
    scene, _ = ring
    for detector in (IsolatedClusters(), SparseSplats()):
        with pytest.raises(Cancelled):
            detector.scores(scene, no_edits(scene), NoTools(), progress=Progress(cancelled=lambda: True))
        shares: list[float] = []
        detector.scores(scene, no_edits(scene), NoTools(), progress=Progress(report=shares.append))
        assert shares == sorted(shares)
        assert shares[-1] == 1
