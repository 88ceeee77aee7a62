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
from splatview.scene.formats import load_scene
from splatview.trainer.background import BackgroundTraining
from splatview.trainer.editing import CUT_STEPS
from splatview.trainer.initialisation import initial_parameters
from splatview.trainer.run import Outputs, TrainingRun
from splatview.trainer.settings import TrainSettings
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainViews, train_views
from splatview.viewer.commands import COMMANDS
from splatview.viewer.editing.session import Editing, EditSession, session_for_edit, session_of
from splatview.viewer.editing.target import AT_REST, NO_WAY_BACK, REFUSALS
from splatview.viewer.state import AppState
from splatview.viewer.training.live import LiveTraining, watched_photos
from splatview.viewer.training.live_edits import TrainingEdits, frozen_target

SMALL = Crop(name="small", half_extents=(0.3, 0.3, 0.3), keep="outside")


@pytest.fixture(scope="module")
def capture():
    return demo_capture(render, photos=9, width=48, height=36, splats=1500)


@pytest.fixture
def origin(request: pytest.FixtureRequest) -> np.ndarray:
    """Where in the world the capture is."""
    return np.array(getattr(request, "param", (0.0, 0.0, 0.0)))


@pytest.fixture
def training(app, capture, origin, tmp_path) -> Iterator[LiveTraining]:
    """A training that `app` watches, its first snapshot shown."""
    shots, held_out = TrainViews(train_views(capture.train), 0), train_views(capture.held_out)
    start = initial_parameters(capture.points, capture.point_colours, capture.scene_radius)
    settings = TrainSettings(iterations=10**6, max_splats=8000)
    trainer = Trainer(shots, start, capture.scene_radius, settings, centre=origin, threads=1)
    outputs = Outputs(
        scene=tmp_path / "pond.ply",
        checkpoint=tmp_path / "pond.safetensors",
        metrics=None,
        pictures=tmp_path / "pictures",
    )
    session = TrainingRun(trainer, held_out, outputs, started=time.perf_counter(), eval_every=10**6)
    thread = BackgroundTraining(session, cores=4)
    live = LiveTraining(
        thread=thread,
        name="pond",
        photos=watched_photos(shots.all, held_out, origin),
        settings=trainer.render_settings,
    )
    app.add(live)
    live.start(app)
    until(app, lambda: live.shown is not None, "a snapshot")
    yield live
    live.close(app)
    thread.close()


def frame(app: AppState) -> None:
    """The parts of the frame loop that editing a training needs."""
    app.run_posted()
    app.feature(LiveTraining).before_frame(app)
    app.feature(Editing).before_frame(app)


def until(app: AppState, condition: Callable[[], Any], what: str) -> None:
    limit = time.monotonic() + 200
    while not condition():
        assert time.monotonic() < limit, f"waited in vain for {what}"
        frame(app)
        time.sleep(0.001)


def editor(app: AppState) -> TrainingEdits:
    return app.feature(LiveTraining).editor


def frozen_session(app: AppState) -> EditSession:
    session = session_for_edit(app)
    assert session is not None and not session.target.at_rest
    return session


def choose(session: EditSession, *splats: int) -> None:
    mask = np.zeros(len(session.gaussians), bool)
    mask[list(splats)] = True
    session.apply(Select(by=IndexRuns.of(mask)))


def alive(training: LiveTraining) -> np.ndarray:
    """Numbers of the splats in the trainer."""
    return training.thread.post(lambda session: session.trainer.splats.ids.copy()).result(200)


def pause(app: AppState, training: LiveTraining) -> None:
    """Until the view shows the scene of the last step before the pause."""
    training.thread.pause()
    until(app, lambda: training.status.state == "paused", "the pause")
    until(
        app,
        lambda: training.shown is not None and training.shown.iteration == training.status.iteration,
        "the last snapshot",
    )


def later_steps(app: AppState, training: LiveTraining, count: int = 15) -> None:
    goal = training.status.iteration + count
    until(app, lambda: training.status.iteration >= goal, "steps")


def test_the_view_waits_while_splats_are_selected_and_goes_on_after(app, training):
    choose(frozen_session(app), 3, 4, 5)
    at = training.shown
    later_steps(app, training)
    assert training.shown is at and session_of(app) is not None
    COMMANDS["select_none"].run(app)
    until(app, lambda: training.shown is not at, "later snapshots")
    assert session_of(app) is None


def test_a_tool_in_hand_holds_the_view_and_escape_lets_go(app, training):
    COMMANDS["tool_rectangle"].run(app)
    at = training.shown
    later_steps(app, training)
    assert training.shown is at
    COMMANDS["select_all"].run(app)
    COMMANDS["cancel"].run(app)  # the tool
    later_steps(app, training)
    assert training.shown is at, "splats are selected"
    COMMANDS["cancel"].run(app)
    assert session_of(app) is None
    until(app, lambda: training.shown is not at, "later snapshots")


def test_a_held_view_waits_with_nothing_in_hand(app, training):
    editor(app).pin(app)
    at = training.shown
    later_steps(app, training)
    assert training.shown is at
    editor(app).release(app)
    until(app, lambda: training.shown is not at, "later snapshots")


def test_deleted_splats_are_deleted_in_the_trainer_by_their_numbers(app, training):
    later_steps(app, training, 120)
    session = frozen_session(app)
    at = training.shown
    choose(session, *range(10, 40))
    later_steps(app, training, 120)  # some are born, and some die, in the meantime
    to_delete = at.ids[10:40]
    training.thread.pause()
    before = alive(training)
    COMMANDS["delete"].run(app)
    until(app, lambda: training.shown is not at, "the snapshot without them")
    now = alive(training)
    np.testing.assert_array_equal(now, before[~np.isin(before, to_delete)])
    assert np.isin(before, to_delete).any(), "some were still there"
    np.testing.assert_array_equal(training.shown.ids, now)
    assert training.status.gaussians == len(now)
    until(app, lambda: session_of(app) is None, "letting go: nothing is in hand")
    assert any("deleted from the training" in message.text for message in app.messages)


def test_tool_and_selection_outlast_a_deletion(app, training):
    pause(app, training)
    session = frozen_session(app)
    at = training.shown
    COMMANDS["tool_brush"].run(app)
    session.brush_radius = 50.0
    choose(session, 7, 8)
    session.apply(Hide())
    choose(session, 1, 2, 3)
    session.apply(AddCrop(crop=replace(SMALL, half_extents=(1e3, 1e3, 1e3), keep="inside")))
    session.apply(Delete())
    choose(session, 5, 6)  # before the trainer has answered
    until(app, lambda: training.shown is not at, "the snapshot without them")
    new = session_of(app)
    assert new is not None and new is not session
    assert (new.tool, new.brush_radius) == ("brush", 50.0)
    target = frozen_target(new)
    assert target is not None and target.snapshot is training.shown
    np.testing.assert_array_equal(training.shown.ids, np.delete(at.ids, [1, 2, 3]))
    ids = training.shown.ids
    np.testing.assert_array_equal(ids[new.document.selected.indices], at.ids[[5, 6]])
    np.testing.assert_array_equal(ids[(new.document.marks & HIDDEN) > 0], at.ids[[7, 8]])
    assert len(new.document.crops) == 1


def test_what_is_deleted_cannot_be_undone_but_choosing_can(app, training):
    training.thread.pause()
    session = frozen_session(app)
    choose(session, 1, 2, 3)
    session.undo()
    assert session.document.counts.selected == 0
    session.redo()
    session.apply(Delete())
    session.undo()
    assert session.document.counts.deleted == 3
    assert session.news == NO_WAY_BACK


def test_the_last_splats_stay(app, training):
    pause(app, training)
    session = frozen_session(app)
    before = len(alive(training))
    session.apply(SelectAll())
    session.apply(Delete())
    target = frozen_target(session)
    assert target is not None
    until(app, lambda: not target.waiting and not session.document.counts.deleted, "the answer")
    assert len(alive(training)) == before
    assert any("no splat would be left" in message.text for message in app.messages)
    session.undo()
    assert session.document.counts.selected == 0, "steps can be undone again"


def test_clean_up_deletes_in_the_trainer(app, training):
    until(app, lambda: training.shown.iteration > 10, "opacities that differ")
    training.thread.pause()
    session = frozen_session(app)
    at = training.shown
    faint = DETECTORS["faint"]()
    threshold = float(np.median(session.document.scores(faint)))
    assert session.apply(Prune(by=faint, threshold=threshold))
    gone = session.document.counts.deleted
    assert 0 < gone < len(at.ids)
    to_delete = at.ids[(session.document.marks & DELETED) > 0]
    until(app, lambda: training.shown is not at, "the snapshot without them")
    assert not np.isin(to_delete, alive(training)).any()


@pytest.mark.parametrize("origin", [(0, 0, 0), (500_000, 5_400_000, 300)], indirect=True)
def test_crops_become_rules_that_keep_it_cut(app, training, origin, capture, tmp_path):
    assert np.linalg.norm(app.camera.eye - origin) < 5 * capture.scene_radius, "the first view is beside it"
    small = replace(SMALL, centre=tuple(origin.tolist()))
    session = frozen_session(app)
    at = training.shown
    inside = small.contains(at.gaussians.means).sum()
    assert inside > 0
    session.apply(AddCrop(crop=small))
    editor(app).cut_away(app)
    until(app, lambda: training.shown is not at, "the snapshot without it")
    assert not small.contains(training.shown.gaussians.means).any()
    assert training.status.settings.cut == ((small,),)
    until(app, lambda: session_of(app) is None, "letting go: the crop is a rule, and nothing is in hand")
    later_steps(app, training, 120)
    pause(app, training)
    while training.status.iteration % CUT_STEPS:  # in between splats move in, until the next look
        at = training.status.iteration
        training.thread.step_once()
        until(app, lambda at=at: training.status.iteration == at + 1, "a step")
    exported = load_scene(training.thread.export(tmp_path / "export.ply").result(200))
    assert np.abs(np.median(exported.means, axis=0) - origin).max() < 10
    assert not small.contains(exported.means).any()
    editor(app).remove_rule(app, "cut", 0)
    until(app, lambda: training.status.settings.cut == (), "the rule to go")


def test_a_crop_can_stop_growth_and_be_a_crop_no_more(app, training):
    session = frozen_session(app)
    session.apply(AddCrop(crop=replace(SMALL, enabled=False)))
    editor(app).stop_growth(app, 0)
    until(app, lambda: training.status.settings.no_growth, "the rule")
    assert training.status.settings.no_growth == (SMALL,)
    assert session.document.crops == ()
    editor(app).remove_rule(app, "no_growth", 0)
    until(app, lambda: not training.status.settings.no_growth, "the rule to go")


@pytest.mark.parametrize(
    "operation",
    [
        Transform(scale=2.0, scope="scene"),
        ColourGrade(grade=Grade(tint=0.3), scope="scene"),
        Decimate(keep=5),
    ],
)
def test_what_no_trainer_understands_is_refused(app, training, operation):
    session = frozen_session(app)
    assert not session.apply(operation)
    assert session.news == (REFUSALS["decimate"] if operation.op == "decimate" else AT_REST)
    assert not session.document.history.steps
    session.preview("look", operation)
    assert session.document.previewed is None


@pytest.mark.parametrize("action", ["import", "split", "save_recipe", "replay_recipe"])
def test_files_of_edits_are_of_scenes_at_rest(app, training, action):
    app.choose_files = lambda *args, **kwargs: pytest.fail("asks for a file")
    COMMANDS[action].run(app)
    assert app.messages[-1].text == AT_REST


def test_a_window_that_closes_says_nothing_of_a_journal(app, training):
    choose(frozen_session(app), 1, 2)
    said = len(app.messages)
    assert app.feature(Editing).close_session(app) is None
    assert session_of(app) is None and len(app.messages) == said
