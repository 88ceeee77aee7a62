"""What a training computes only where its capture calls for it, and says so."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from splatview.raster.gradients import differentiate
from splatview.scene import ImageModel, look_at
from splatview.scene.captures import Capture
from splatview.scene.captures.capture import Photo, PhotoStatistics, Pixels
from splatview.scene.effects.appearance import antialiasing
from splatview.scene.formats import load_scene
from splatview.trainer.effects import (
    COVERED,
    FAR,
    FEW_PHOTOS,
    FROZEN,
    LONGEST,
    MORE_PHOTOS,
    OUTLIERS,
    PASSING,
    SCALE_RATIO,
    SCENES,
    SKY,
    SURROUND,
    TRANSIENTS,
    WITHHELD,
    Antialiased,
    capture_effects,
    model_for,
    scale_ratio,
    with_easing,
)
from splatview.trainer.recipe import automatic_regularisation
from splatview.trainer.run import Outputs, TrainingRun
from splatview.trainer.settings import TrainSettings
from splatview.trainer.strategies.mcmc import LEAST_REG
from splatview.trainer.strategies.ops import raise_sh_degree


def capture(distances: list[float], *, width: int = 40, **statistics) -> Capture:
    """Of a ball of points at the origin, seen from these distances."""
    photos = []
    for index, distance in enumerate(distances):
        angle = 2 * np.pi * index / len(distances)
        eye = (distance * np.cos(angle), 0, distance * np.sin(angle))
        camera = look_at(eye, (0, 0, 0), width=width, height=width, fov_y=60)
        pixels = Pixels(image=np.zeros((width, width, 3), np.uint8), mask=None)
        photos.append(
            Photo(
                name=f"{index}.png", camera=camera, held_out=index == 0, pixels=lambda pixels=pixels: pixels
            )
        )
    points = np.random.default_rng(0).normal(scale=0.1, size=(100, 3))
    return Capture(
        name="ball",
        photos=tuple(photos),
        points=points,
        point_colours=np.zeros((100, 3), np.uint8),
        statistics=PhotoStatistics(**statistics),
    )


def told(capture: Capture, antialiased: Antialiased = "auto", **settings) -> dict[str, tuple[bool, str]]:
    chosen = TrainSettings(model=model_for(capture, antialiased), **settings)
    return {one.name: (one.in_force, one.why) for one in capture_effects(capture, chosen, antialiased)}


def test_photos_of_one_scale_train_the_usual_model():
    ring = capture([2.0, 2.1, 1.9, 2.0, 2.2, 2.0])
    assert scale_ratio(ring) == pytest.approx(2.2 / 1.9, rel=0.05)
    assert model_for(ring, "auto") == ImageModel()
    on, why = told(ring)["antialiased opacity"]
    assert not on and "1.2 times apart, less than 3" in why
    assert told(ring, "on")["antialiased opacity"][0]


def test_photos_of_different_scales_train_antialiased():
    near_and_far = capture([2.0, 8.0] * 4)
    assert scale_ratio(near_and_far) == pytest.approx(4, rel=0.1)
    assert scale_ratio(near_and_far) > SCALE_RATIO
    assert model_for(near_and_far, "auto") == ImageModel(antialiased=True, blur=0.1)
    assert model_for(near_and_far, "off") == ImageModel()
    on, why = told(near_and_far)["antialiased opacity"]
    assert on and "times apart, 3 or more; kernel 0.1 px²" in why


def test_a_capture_without_visible_points_has_no_scales():
    blind = replace(capture([2.0] * 4), points=np.full((9, 3), 1e3))
    assert scale_ratio(blind) == 1


def test_each_effect_names_its_evidence():
    plain = told(capture([2.0] * 4))
    assert plain["masks"] == (False, "0 of 4 photos have a mask")
    assert plain["lens distortion"] == (False, "all 4 cameras are pinholes")
    assert plain["background"] == (False, "0 of 4 photos have transparency; black is behind the scene")
    assert not plain[SURROUND][0] and "a background is asked for" in plain[SURROUND][1]
    assert not plain["exposure of each photo"][0] and not plain["shading of each photo"][0]
    assert plain["SH bands"][1].startswith("band 1 from 3%, 2 from 7%, 3 from 10%")
    assert told(capture([2.0] * 4), sh_degree=0)["SH bands"][0] is False
    assert not plain[WITHHELD][0] and plain[WITHHELD][1].startswith("none: photos or time are few")

    assert not plain[FAR][0] and plain[FAR][1].startswith("all move alike: photos are few")
    near = told(capture([2.0] * 4), far_from=1.0)[FAR]
    assert near == (False, "no point is farther than 2.32 units from the middle of the cameras")
    is_on, why = told(capture([2.0] * 4), far_from=0.3)[FAR]
    assert is_on and why.startswith("from 0.696 units from the middle of the cameras on, where ")
    is_on, why = told(replace(capture([2.0] * 4), guessed=True), far_from=0.3)[FAR]
    assert is_on and why.startswith("from 0.3 times the distance on at which most splats begin")

    rich = told(
        capture([2.0] * 4, masks=2, hidden=0.125, lenses=3, displacement=12.3, transparent=1),
        exposure="on",
        shading="on",
    )
    assert {name for name, (on, _) in rich.items() if on} == set(rich) - {
        "antialiased opacity",
        WITHHELD,
        MORE_PHOTOS,
        SKY,
        SURROUND,
        COVERED,
        FEW_PHOTOS,
        OUTLIERS,
        PASSING,
        TRANSIENTS,
        FROZEN,
        FAR,
        SCENES,
    }
    assert "12.50% of all pixels" in rich["masks"][1]
    assert "3 of 4 photos have a lens that moves points by up to 12.3 px" in rich["lens distortion"][1]
    assert "1 of 4 photos have transparency, laid over 0, 0, 0" in rich["background"][1]
    assert "their opacity is part of the loss" in rich["background"][1]

    cut = told(capture([2.0] * 4, masks=4, cut_out=True, transparent=4))["masks"]
    assert cut == (True, "4 of 4 photos have a mask: what they hide is empty, as in transparent photos")
    assert told(capture([2.0] * 4, cut_out=True, transparent=4))["masks"][0] is False

    weak = told(capture([2.0] * 4, lenses_left_out=4, displacement=0.03))
    assert weak["lens distortion"] == (
        False,
        "lenses move no point by more than 0.03 px, of 0.05 that could show: photos are used as they are",
    )


def test_bands_that_are_locked_are_neither_stored_nor_computed_nor_optimised(make_trainer, monkeypatch):
    trainer = make_trainer(iterations=100, sh_degree=2, sh_every=0.1)
    computed: list[int] = []

    def watched(parameters, frame, d_image, **options):
        gradients = differentiate(parameters, frame, d_image, **options)
        computed.append(gradients.parameters.sh.shape[1])
        return gradients

    monkeypatch.setattr("splatview.trainer.functional.differentiate", watched)
    stored = []
    while not trainer.done:
        trainer.step(0.0)
        shapes = {
            group.sh.shape[1]
            for group in (trainer.splats.arrays, trainer.optimizer.first, trainer.optimizer.second)
        }
        assert len(shapes) == 1
        stored.append(shapes.pop())
    assert [stored.count(count) for count in (1, 4, 9)] == [10, 10, 80]
    assert computed == stored


def test_a_new_band_begins_as_if_it_had_been_there_all_the_time(make_trainer):
    """Bit for bit: what is not stored before would have been zeros."""
    ours = make_trainer(iterations=60, sh_degree=1, sh_every=0.5, threads=1)
    theirs = make_trainer(iterations=60, sh_degree=1, sh_every=0.5, threads=1)
    raise_sh_degree(theirs.splats, theirs.optimizer, 1)
    theirs.render_settings = replace(theirs.render_settings, sh_degree=0)
    while not ours.done:
        if ours.progress >= 0.5:
            theirs.render_settings = replace(theirs.render_settings, sh_degree=None)
        ours.step(0.0)
        theirs.step(0.0)
    for mine, other in zip(ours.splats.arrays, theirs.splats.arrays, strict=True):
        np.testing.assert_array_equal(mine, other)


def test_effects_are_in_the_metrics_and_in_the_scene(make_trainer, views, tmp_path):
    outputs = Outputs(
        scene=tmp_path / "s.ply",
        checkpoint=tmp_path / "s.safetensors",
        metrics=tmp_path / "m.jsonl",
        pictures=tmp_path / "p",
    )
    trainer = make_trainer(iterations=100, model=ImageModel(antialiased=True, blur=0.1))
    effects = capture_effects(capture([2.0, 8.0] * 4), trainer.settings, "auto")
    notes: list[str] = []
    training_run = TrainingRun(
        trainer, views[:1], outputs, started=0.0, eval_every=100, effects=effects, on_note=notes.append
    )
    assert training_run.run() and training_run.final_evaluation() is not None
    assert outputs.metrics is not None
    lines = [json.loads(line) for line in outputs.metrics.read_text().splitlines()]
    assert [("effects" in line, line["iteration"]) for line in lines] == [(True, 50), (True, 100)]
    ended = {effect["name"]: effect for effect in lines[1]["effects"]}
    assert not ended[PASSING]["on"] and ended[PASSING]["why"] == "none is in front"
    said = {effect["name"]: effect for effect in lines[0]["effects"]}
    assert said["antialiased opacity"]["on"] is True
    assert "differ in exposure by" in said["exposure of each photo"]["why"]
    assert notes == [f"exposure of each photo off: {said['exposure of each photo']['why']}"]
    assert antialiasing(load_scene(outputs.scene).comments)[:2] == (True, 0.1)


@pytest.mark.parametrize("blur", [0.1, 0.3])
def test_files_say_how_their_scene_was_trained(make_trainer, blur):
    trainer = make_trainer(iterations=10, model=ImageModel(antialiased=True, blur=blur))
    assert antialiasing(trainer.snapshot().comments)[:2] == (True, blur)
    assert antialiasing(make_trainer(iterations=10).snapshot().comments)[:2] == (False, 0.3)


def run_that_tells(trainer, effects, folder) -> tuple[TrainingRun, list[str]]:
    """A whole run with these effects, and what it has noted."""
    outputs = Outputs(
        scene=folder / "s.ply", checkpoint=folder / "s.safetensors", metrics=None, pictures=folder / "p"
    )
    notes: list[str] = []
    training_run = TrainingRun(
        trainer, [], outputs, started=0.0, eval_every=100, effects=effects, on_note=notes.append
    )
    assert training_run.run()
    return training_run, notes


def test_rules_for_few_photos_are_told_and_so_is_their_easing(make_trainer, tmp_path):
    ring = capture([2.0] * 5)
    on, why = told(ring, dropout=0.2, max_aspect=6.0, opacity_reg=0.1, scale_reg=0.05)[FEW_PHOTOS]
    assert on and "4 photos to train on: mean opacity and scale weigh 0.1 and 0.05" in why
    assert "up to 20% of the splats" in why and "6 times as long as wide" in why
    assert not told(ring)[FEW_PHOTOS][0]

    trainer = make_trainer(iterations=30, dropout=0.2, full_reg_loss=10.0)
    effects = capture_effects(ring, trainer.settings, "auto")
    training_run, notes = run_that_tells(trainer, effects, tmp_path)
    assert 0 < trainer.need_of_reg <= 0.25, "photos are met far better than asked"
    (note,) = (note for note in notes if FEW_PHOTOS in note)
    assert note.endswith("; eased to 25%, as the scene meets them")
    assert note == f"{FEW_PHOTOS}: {training_run.effects[-1].why}"
    assert with_easing(training_run.effects, 1.0)[-1] == effects[-1], "back to all of it"


@pytest.mark.parametrize(("loss", "photos"), [(0.0, 3), (9.0, 1)])
def test_more_photos_of_a_step_are_told(make_trainer, tmp_path, loss, photos):
    ring = capture([2.0] * 5)
    on, why = told(ring)[MORE_PHOTOS]
    assert not on and why.startswith("1 all along")
    trainer = make_trainer(iterations=30, growth_batch=3, growth_loss=loss)
    effects = capture_effects(ring, trainer.settings, "auto")
    (before,) = (effect for effect in effects if effect.name == MORE_PHOTOS)
    assert not before.on and before.why.endswith(f"met with a loss above {loss:g}")
    training_run, notes = run_that_tells(trainer, effects, tmp_path)
    (after,) = (effect for effect in training_run.effects if effect.name == MORE_PHOTOS)
    met = f"as photos are met with a loss of {trainer.state['growth_by']:.3f}"
    assert after.on == (photos > 1) and after.why.endswith(met)
    lines = [note for note in notes if MORE_PHOTOS in note]
    assert lines == [f"{MORE_PHOTOS}: 3 while splats grow, {met}; --batch 1 takes no more"][: int(after.on)]


@pytest.mark.parametrize("weight", [0.1, 0.01])
def test_faint_splats_are_told(make_trainer, tmp_path, weight):
    ring = capture([2.0] * 5)
    trainer = make_trainer(iterations=30, opacity_reg=weight, scale_reg=weight, full_reg_opacity=0.06)
    trainer.state["median_opacity"] = 0.05
    effects = capture_effects(ring, trainer.settings, "auto")
    training_run, notes = run_that_tells(trainer, effects, tmp_path)
    (note,) = (note for note in notes if FEW_PHOTOS in note)
    assert note.endswith("; opacity weighs 50% as much or less, as half of the splats are faint")
    eased = "; eased to 50%, as the scene meets them" if weight > LEAST_REG else ""
    both = with_easing(training_run.effects, 0.5, 0.25)[-1].why
    assert both.startswith(f"{effects[-1].why}{eased}; opacity weighs 25%")
    assert with_easing(with_easing(effects, 0.5, 0.25), 1.0)[-1] == effects[-1]


def test_what_photos_show_of_their_pixels_is_told() -> None:
    ring = capture([2.0] * 20)  # 19 to train on

    def told_of(covered: float, **settings) -> tuple[bool, str]:
        effects = capture_effects(ring, TrainSettings(**settings), "auto", covered)
        (found,) = (one for one in effects if one.name == COVERED)
        return found.on, found.why

    weight = automatic_regularisation(19, 0.064)
    assert told_of(0.064, opacity_reg=weight, scale_reg=weight) == (
        True,
        f"photos show something in 6.4% of their pixels, so mean opacity and scale weigh {weight:.2g} and"
        f" {weight:.2g}",
    )
    whole = automatic_regularisation(19)
    assert told_of(1.0, opacity_reg=whole, scale_reg=whole) == (
        False,
        "photos show something in 100.0% of their pixels",
    )
    on, why = told_of(0.064, opacity_reg=0.5, scale_reg=0.5)
    assert not on and why.endswith("; mean opacity and scale weigh as asked for")
    on, why = told_of(0.064, strategy="classic", opacity_reg=weight, scale_reg=weight)
    assert not on and why.endswith("6.4% of their pixels, which this strategy does not go by")


@pytest.mark.parametrize(
    ("limit", "is_on", "begins", "ends"),
    [
        (0.5, True, "none is longer than 0.5 of its distance", "from aside show"),
        (0.05, True, "none is longer than 0.05 of its distance", "reach there as haze"),
        (0.2, True, "none is longer than 0.2 of its distance", "a camera that shows it"),
        (math.inf, False, "of any length", "as asked for"),
    ],
)
def test_how_long_splats_may_be_is_told(limit: float, is_on: bool, begins: str, ends: str):
    on, why = told(capture([2.0] * 4), max_size=limit)[LONGEST]
    assert on == is_on and why.startswith(begins) and why.endswith(ends)


def test_a_loss_that_wavers_is_told_once(make_trainer, tmp_path):
    trainer = make_trainer(iterations=30, dropout=0.2, full_reg_loss=10.0)
    outputs = Outputs(
        scene=tmp_path / "s.ply", checkpoint=tmp_path / "s.safetensors", metrics=None, pictures=tmp_path / "p"
    )
    notes: list[str] = []
    effects = capture_effects(capture([2.0] * 5), trainer.settings, "auto")
    run = TrainingRun(trainer, [], outputs, started=0.0, effects=effects, on_note=notes.append)
    for loss in (1e3, 1.0, 1e3, 1.0):
        trainer.state["photo_loss"] = loss
        run.step()
        assert ("eased" in run.effects[-1].why) == (loss < 10)
    assert len([note for note in notes if FEW_PHOTOS in note]) == 1
