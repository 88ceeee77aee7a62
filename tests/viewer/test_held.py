"""Edits of what is being trained, without a window: what the trainer is told, and when the view waits."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from splatview.edit.detectors import DETECTORS
from splatview.edit.operations import (
    AddCrop,
    ColourGrade,
    Decimate,
    Delete,
    Hide,
    Prune,
    Select,
    SelectAll,
    Transform,
)
from splatview.edit.operations.appearance import Grade
from splatview.edit.selectors import IndexRuns
from splatview.raster import render
from splatview.scene.captures.demo import demo_capture
from splatview.scene.edits import DELETED, HIDDEN, Crop
from splatview.trainer.background import TrainingThread
from splatview.trainer.run import Outputs, Session
from splatview.trainer.settings import TrainSettings
from splatview.trainer.splats import initial_parameters
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import Shots, shots_of
from splatview.viewer.commands import ACTIONS
from splatview.viewer.editing import commands
from splatview.viewer.editing.session import Desk, continue_editing, put_away
from splatview.viewer.state import Core
from splatview.viewer.training import live_edits as held
from splatview.viewer.training.live import Training, watched_photos

SMALL = Crop(name="small", half_extents=(0.3, 0.3, 0.3), keep="outside")


@pytest.fixture(scope="module")
def capture():
    return demo_capture(render, photos=9, width=48, height=36, splats=1500)


@pytest.fixture
def training(core, capture, tmp_path) -> Iterator[Training]:
    """A training that `core` watches, its first snapshot shown."""
    shots, held_out = Shots(shots_of(capture.train), 0), shots_of(capture.held_out)
    start = initial_parameters(capture.points, capture.point_colours, capture.scene_radius)
    trainer = Trainer(
        shots, start, capture.scene_radius, TrainSettings(iterations=10**6, max_splats=8000), threads=1
    )
    outputs = Outputs(
        scene=tmp_path / "pond.ply",
        checkpoint=tmp_path / "pond.safetensors",
        metrics=None,
        pictures=tmp_path / "pictures",
    )
    session = Session(trainer, held_out, outputs, started=time.perf_counter(), eval_every=10**6)
    thread = TrainingThread(session, cores=4)
    core.training = Training(
        thread=thread,
        name="pond",
        photos=watched_photos(shots.all, held_out),
        settings=trainer.render_settings,
    )
    core.training.start(core)
    until(core, lambda: core.training.shown is not None, "a snapshot")
    yield core.training
    core.training.stop()
    thread.close()


def frame(core: Core) -> None:
    """The parts of the frame loop that editing a training needs."""
    core.run_posted()
    assert core.training is not None
    core.training.advance(core)
    continue_editing(core)


def until(core: Core, condition: Callable[[], Any], what: str) -> None:
    limit = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < limit, f"waited in vain for {what}"
        frame(core)
        time.sleep(0.001)


def desk_of(core: Core) -> Desk:
    desk = held.hold(core)
    assert desk is not None and desk.trainee is not None
    return desk


def choose(desk: Desk, *splats: int) -> None:
    mask = np.zeros(len(desk.gaussians), bool)
    mask[list(splats)] = True
    desk.apply(Select(by=IndexRuns.of(mask)))


def alive(training: Training) -> np.ndarray:
    """Numbers of the splats in the trainer."""
    return training.thread.post(lambda session: session.trainer.splats.ids.copy()).result(60)


def later_steps(core: Core, training: Training, count: int = 15) -> None:
    goal = training.status.iteration + count
    until(core, lambda: training.status.iteration >= goal, "steps")


def test_the_view_waits_while_splats_are_selected_and_goes_on_after(core, training):
    choose(desk_of(core), 3, 4, 5)
    at = training.shown
    later_steps(core, training)
    assert training.shown is at and core.desk is not None
    commands.EDIT_ACTIONS["select_none"](core)
    until(core, lambda: training.shown is not at, "later snapshots")
    assert core.desk is None


def test_a_tool_in_hand_holds_the_view_and_escape_lets_go(core, training):
    ACTIONS["tool_rectangle"](core)
    at = training.shown
    later_steps(core, training)
    assert training.shown is at
    ACTIONS["select_all"](core)
    ACTIONS["cancel"](core)  # the tool
    later_steps(core, training)
    assert training.shown is at, "splats are selected"
    ACTIONS["cancel"](core)
    assert core.desk is None
    until(core, lambda: training.shown is not at, "later snapshots")


def test_a_held_view_waits_with_nothing_in_hand(core, training):
    held.keep_waiting(core)
    at = training.shown
    later_steps(core, training)
    assert training.shown is at
    held.let_go(core)
    until(core, lambda: training.shown is not at, "later snapshots")


def test_deleted_splats_are_deleted_in_the_trainer_by_their_numbers(core, training):
    later_steps(core, training, 120)
    desk = desk_of(core)
    at = training.shown
    choose(desk, *range(10, 40))
    later_steps(core, training, 120)  # some are born, and some die, in the meantime
    doomed = at.ids[10:40]
    before = alive(training)
    training.thread.pause()
    ACTIONS["delete"](core)
    until(core, lambda: training.shown is not at, "the snapshot without them")
    now = alive(training)
    np.testing.assert_array_equal(now, before[~np.isin(before, doomed)])
    assert np.isin(before, doomed).any(), "some were still there"
    np.testing.assert_array_equal(training.shown.ids, now)
    assert training.status.gaussians == len(now)
    until(core, lambda: core.desk is None, "letting go: nothing is in hand")
    assert any("deleted from the training" in message.text for message in core.messages)


def test_tool_and_selection_outlast_a_deletion(core, training):
    training.thread.pause()
    desk = desk_of(core)
    at = training.shown
    ACTIONS["tool_brush"](core)
    desk.brush_radius = 50.0
    choose(desk, 7, 8)
    desk.apply(Hide())
    choose(desk, 1, 2, 3)
    desk.apply(AddCrop(crop=replace(SMALL, half_extents=(1e3, 1e3, 1e3), keep="inside")))
    desk.apply(Delete())
    choose(desk, 5, 6)  # before the trainer has answered
    until(core, lambda: training.shown is not at, "the snapshot without them")
    new = core.desk
    assert new is not None and new is not desk
    assert (new.tool, new.brush_radius) == ("brush", 50.0)
    assert new.trainee.snapshot is training.shown
    np.testing.assert_array_equal(training.shown.ids, np.delete(at.ids, [1, 2, 3]))
    ids = training.shown.ids
    np.testing.assert_array_equal(ids[new.document.selected.indices], at.ids[[5, 6]])
    np.testing.assert_array_equal(ids[(new.document.marks & HIDDEN) > 0], at.ids[[7, 8]])
    assert len(new.document.crops) == 1


def test_what_is_deleted_cannot_be_undone_but_choosing_can(core, training):
    training.thread.pause()
    desk = desk_of(core)
    choose(desk, 1, 2, 3)
    desk.undo()
    assert desk.document.counts.selected == 0
    desk.redo()
    desk.apply(Delete())
    desk.undo()
    assert desk.document.counts.deleted == 3
    assert desk.news == held.NO_WAY_BACK


def test_the_last_splats_stay(core, training):
    desk = desk_of(core)
    before = len(alive(training))
    training.thread.pause()
    desk.apply(SelectAll())
    desk.apply(Delete())
    trainee = desk.trainee
    assert trainee is not None
    until(core, lambda: not trainee.waiting and not desk.document.counts.deleted, "the answer")
    assert len(alive(training)) >= before
    assert any("no splat would be left" in message.text for message in core.messages)
    desk.undo()
    assert desk.document.counts.selected == 0, "steps can be undone again"


def test_clean_up_deletes_in_the_trainer(core, training):
    until(core, lambda: training.shown.iteration > 10, "opacities that differ")
    training.thread.pause()
    desk = desk_of(core)
    at = training.shown
    faint = DETECTORS["faint"]()
    threshold = float(np.median(desk.document.scores(faint)))
    assert desk.apply(Prune(by=faint, threshold=threshold))
    gone = desk.document.counts.deleted
    assert 0 < gone < len(at.ids)
    doomed = at.ids[(desk.document.marks & DELETED) > 0]
    until(core, lambda: training.shown is not at, "the snapshot without them")
    assert not np.isin(doomed, alive(training)).any()


def test_crops_become_rules_that_keep_it_cut(core, training):
    desk = desk_of(core)
    at = training.shown
    inside = SMALL.contains(at.gaussians.means).sum()
    assert inside > 0
    desk.apply(AddCrop(crop=SMALL))
    held.cut_away(core)
    until(core, lambda: training.shown is not at, "the snapshot without it")
    assert not SMALL.contains(training.shown.gaussians.means).any()
    assert training.status.settings.cut == ((SMALL,),)
    until(core, lambda: core.desk is None, "letting go: the crop is a rule, and nothing is in hand")
    later_steps(core, training, 120)
    held.remove_rule(core, "cut", 0)
    until(core, lambda: training.status.settings.cut == (), "the rule to go")


def test_a_crop_can_stop_growth_and_be_a_crop_no_more(core, training):
    desk = desk_of(core)
    desk.apply(AddCrop(crop=replace(SMALL, enabled=False)))
    held.stop_growth(core, 0)
    until(core, lambda: training.status.settings.no_growth, "the rule")
    assert training.status.settings.no_growth == (SMALL,)
    assert desk.document.crops == ()
    held.remove_rule(core, "no_growth", 0)
    until(core, lambda: not training.status.settings.no_growth, "the rule to go")


@pytest.mark.parametrize(
    "operation",
    [
        Transform(scale=2.0, scope="scene"),
        ColourGrade(grade=Grade(tint=0.3), scope="scene"),
        Decimate(keep=5),
    ],
)
def test_what_no_trainer_understands_is_refused(core, training, operation):
    desk = desk_of(core)
    assert not desk.apply(operation)
    assert desk.news == (held.REFUSALS["decimate"] if operation.op == "decimate" else held.AT_REST)
    assert not desk.document.history.steps
    desk.preview("look", operation)
    assert desk.document.previewed is None


@pytest.mark.parametrize("action", ["merge", "split", "save_recipe", "replay_recipe"])
def test_files_of_edits_are_of_scenes_at_rest(core, training, action):
    core.choose_files = lambda *args, **kwargs: pytest.fail("asks for a file")
    ACTIONS[action](core)
    assert core.messages[-1].text == held.AT_REST


def test_a_window_that_closes_says_nothing_of_a_journal(core, training):
    choose(desk_of(core), 1, 2)
    said = len(core.messages)
    assert put_away(core) is None
    assert core.desk is None and len(core.messages) == said
