"""Training in a thread: what is published, what can be asked for, and what survives."""

from __future__ import annotations

import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatview.raster.compiling import niceness
from splatview.scene import InputError
from splatview.scene.formats import load_scene
from splatview.trainer import background as threads
from splatview.trainer import run as sessions
from splatview.trainer.background import BackgroundTraining, Status, pace_of
from splatview.trainer.checkpoint import load_checkpoint
from splatview.trainer.evaluate import Evaluation
from splatview.trainer.run import Outputs, Stopwatch, TrainingRun
from splatview.trainer.settings import TrainSettings


@pytest.fixture
def make_session(make_trainer, views, tmp_path) -> Callable[..., TrainingRun]:
    """`make_session(eval_every=.., iterations=.., ...)`: a session that writes into `tmp_path`."""

    def make(*, eval_every: int | None = 1000, **settings: Any) -> TrainingRun:
        outputs = Outputs(
            scene=tmp_path / "toy.ply",
            checkpoint=tmp_path / "toy.checkpoint.safetensors",
            metrics=tmp_path / "m.jsonl",
            pictures=tmp_path / "pictures",
        )
        trainer = make_trainer(**settings)
        return TrainingRun(trainer, views[:1], outputs, started=time.perf_counter(), eval_every=eval_every)

    return make


@pytest.fixture
def begin(make_session) -> Iterator[Callable[..., BackgroundTraining]]:
    """`begin(**settings)`: a thread that trains; it is ended after the test."""
    begun: list[BackgroundTraining] = []

    def start(*, training_run: TrainingRun | None = None, **settings: Any) -> BackgroundTraining:
        options = {
            name: settings.pop(name) for name in ("share", "cores", "snapshot_seconds") if name in settings
        }
        thread = BackgroundTraining(
            training_run or make_session(**{"iterations": 100_000, **settings}), **options
        )
        thread.begin()
        begun.append(thread)
        return thread

    yield start
    for thread in begun:
        thread.close()


def wait(condition: Callable[[], Any], what: str, seconds: float = 200) -> None:
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit, f"waited in vain for {what}"
        time.sleep(0.002)


def settled(thread: BackgroundTraining) -> None:
    """Everything posted so far has been done."""
    thread.post(lambda training_run: None).result(200)


def test_snapshots_are_those_of_their_steps_and_the_last_is_the_trainers_state(
    begin, make_session, monkeypatch
) -> None:
    monkeypatch.setattr(threads, "PUBLISH_SHARE", 1e9)  # as often as they are taken
    settings = {"iterations": 60, "refine_from": 0.0, "least_refine_steps": 5}
    run = make_session(**settings)
    take_step, seen, thread_of = run.step, [], []

    def step() -> Any:
        """Every seventh waits until what was published has been taken: else a quick trainer is through before
        anybody has looked."""
        if run.trainer.counters.iteration % 7 == 0:
            wait(lambda: thread_of and not thread_of[0]._slot, "somebody who looks")
        return take_step()

    run.step = step
    thread = begin(training_run=run, snapshot_seconds=0.0)
    thread_of.append(thread)
    while thread.status.state != "done":
        snapshot = thread.take_snapshot()
        if snapshot is not None:
            seen.append(snapshot)
    wait(lambda: thread.status.saved_at == 60, "saving")
    last = thread.take_snapshot()
    seen += [last] if last is not None else []
    assert seen[0].iteration == 0 and seen[-1].iteration == 60
    assert all(a.iteration < b.iteration for a, b in pairwise(seen))
    assert len(seen) > 5 and thread.published >= len(seen)
    trainer = thread.post(lambda training_run: training_run.trainer).result()
    np.testing.assert_array_equal(seen[-1].gaussians.means, trainer.splats.arrays.means)
    np.testing.assert_array_equal(seen[-1].ids, trainer.splats.ids)

    # The same run without a thread goes through the same scenes.
    again = make_session(**settings).trainer
    wanted = {snapshot.iteration: snapshot for snapshot in seen}
    while not again.done:
        again.step()
        if (snapshot := wanted.get(again.counters.iteration)) is not None:
            np.testing.assert_array_equal(snapshot.gaussians.sh, again.splats.arrays.sh)
            np.testing.assert_array_equal(snapshot.ids, again.splats.ids)


def test_a_slot_holds_the_latest_only(begin) -> None:
    thread = begin(snapshot_seconds=0.0)
    wait(lambda: thread.status.iteration > 3, "steps")
    assert thread.published == 1, "none is made while the first waits to be taken"
    thread.pause()
    settled(thread)
    snapshot = thread.take_snapshot()
    assert snapshot is not None and snapshot.iteration == thread.status.iteration, "the first is overtaken"
    assert thread.take_snapshot() is None


def test_snapshots_are_made_as_often_as_asked_for(begin) -> None:
    thread = begin(snapshot_seconds=None)
    thread.take_snapshot()
    wait(lambda: thread.status.iteration > 20, "steps")
    assert thread.take_snapshot() is None, "off"
    thread.show_now()
    settled(thread)
    assert thread.take_snapshot() is not None
    thread.snapshot_seconds = 0.0
    wait(lambda: thread.take_snapshot() is not None, "a snapshot")


def test_a_pause_stands_still_and_costs_no_time(begin, monkeypatch) -> None:
    pauses, clock = [0.0], time.perf_counter
    monkeypatch.setattr(sessions.time, "perf_counter", lambda: clock() + pauses[0])
    thread = begin()
    wait(lambda: thread.status.iteration > 3, "steps")
    thread.pause()
    settled(thread)
    at = thread.status
    assert at.state == "paused" and at.rate == 0
    time.sleep(0.15)
    settled(thread)
    assert thread.status.iteration == at.iteration
    seconds = thread.post(lambda training_run: training_run.seconds).result()
    pauses[0] += 1000.0
    assert thread.post(lambda training_run: training_run.seconds).result() == seconds

    thread.step_once()
    thread.step_once()
    wait(lambda: thread.status.iteration == at.iteration + 2, "two steps")
    settled(thread)
    pauses[0] += 1000.0
    settled(thread)
    assert thread.status.iteration == at.iteration + 2 and thread.status.state == "paused"
    assert seconds < thread.status.seconds < seconds + 1000, "the steps count, the pauses do not"

    thread.resume()
    wait(lambda: thread.status.iteration > at.iteration + 5, "more steps")
    assert thread.status.state == "training"


def test_a_stopwatch_leaves_pauses_out(monkeypatch) -> None:
    now = [100.0]
    monkeypatch.setattr(sessions.time, "perf_counter", lambda: now[0])
    watch = Stopwatch(90.0)
    assert watch.seconds == 10
    watch.pause()
    now[0] = 150.0
    watch.pause()
    assert watch.seconds == 10
    watch.resume()
    watch.resume()
    now[0] = 151.0
    assert watch.seconds == 11


def test_commands_run_between_steps_and_their_failures_are_told(begin) -> None:
    thread = begin()
    counted, told = thread.post(lambda run: (len(run.trainer.splats), thread.status.gaussians)).result(200)
    assert counted == told

    def fail(training_run: TrainingRun) -> None:
        raise InputError("no such thing")

    answer = thread.post(fail)
    with pytest.raises(InputError):
        answer.result(200)
    assert thread.take_notes() == ["no such thing"]
    at = thread.status.iteration
    wait(lambda: thread.status.iteration > at + 2, "training to go on")


@pytest.mark.parametrize("strategy", ["mcmc", "classic"])
def test_a_command_that_changes_the_scene_is_seen_at_once_even_in_a_pause(begin, strategy) -> None:
    thread = begin(strategy=strategy, refine_from=0.0, refine_until=1.0)
    wait(lambda: thread.status.iteration > 2, "steps")
    thread.pause()
    settled(thread)
    before = thread.take_snapshot()
    assert before is not None
    gone = before.ids[::2]
    assert thread.post(lambda training_run: training_run.trainer.delete(gone), changes=True).result(
        60
    ) == len(gone)
    after = thread.take_snapshot()
    assert after is not None and after.iteration == before.iteration
    np.testing.assert_array_equal(after.ids, before.ids[1::2])
    np.testing.assert_array_equal(after.gaussians.means, before.gaussians.means[1::2])
    assert thread.status.gaussians == len(after.ids)
    thread.step_once()
    wait(lambda: thread.status.iteration == before.iteration + 1, "a step with fewer splats")

    assert thread.post(lambda training_run: training_run.trainer.delete(gone)).result(200) == 0, (
        "they are gone"
    )
    with pytest.raises(InputError, match="no splat"):
        thread.post(lambda training_run: training_run.trainer.delete(training_run.trainer.splats.ids)).result(
            60
        )


def test_settings_change_between_steps(begin) -> None:
    thread = begin(max_splats=300)
    thread.change(max_splats=400, means_rate=1e-3).result(200)
    assert thread.status.settings.max_splats == 400
    trainer = thread.post(lambda training_run: training_run.trainer).result(200)
    assert trainer.strategy.settings == trainer.settings
    for wrong in ({"max_splats": 0}, {"strategy": "classic"}, {"sh_degree": 7}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            thread.change(**wrong).result(200)
    assert len(thread.take_notes()) == 3
    assert thread.status.settings.max_splats == 400


def test_a_failure_is_told_and_the_scene_stays(begin, make_session, capsys) -> None:
    training_run = make_session(iterations=100_000)
    step = training_run.trainer.step

    def breaks(seconds: float | None = None):
        if training_run.trainer.counters.iteration == 5:
            raise FloatingPointError("it broke")
        return step(seconds)

    training_run.trainer.step = breaks
    thread = begin(training_run=training_run)
    wait(lambda: thread.status.state == "failed", "the failure")
    assert thread.status.failure == "FloatingPointError: it broke"
    assert thread.status.iteration == 5
    assert "it broke" in capsys.readouterr().err
    settled(thread)
    snapshot = thread.take_snapshot()
    assert snapshot is not None and snapshot.iteration == 5

    training_run.trainer.step = step
    thread.resume()
    wait(lambda: thread.status.iteration > 7, "another try")
    assert thread.status.failure is None


def test_a_snapshot_without_memory_stops_the_run_and_not_the_thread(
    begin, make_session, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(threads, "PUBLISH_SHARE", 1e9)
    training_run = make_session(iterations=100_000)
    snapshot = training_run.trainer.snapshot
    thread = begin(training_run=training_run, snapshot_seconds=0.0)
    wait(lambda: thread.status.iteration > 3, "steps")

    def exhausted() -> None:
        raise MemoryError("no room for a snapshot")

    training_run.trainer.snapshot = exhausted
    thread.take_snapshot()
    wait(lambda: thread.status.state == "failed", "the failure")
    settled(thread)
    assert thread.status.failure == "MemoryError: no room for a snapshot"
    assert "no room for a snapshot" in capsys.readouterr().err
    training_run.trainer.snapshot = snapshot
    reached = thread.status.iteration
    thread.resume()
    wait(lambda: thread.status.iteration > reached + 2, "another try")
    thread.close()
    assert len(load_scene(tmp_path / "toy.ply")) > 0


def test_closing_saves_what_was_trained(begin, tmp_path) -> None:
    thread = begin()
    wait(lambda: thread.status.iteration > 3, "steps")
    thread.close()
    status = thread.status
    checkpoint = load_checkpoint(tmp_path / "toy.checkpoint.safetensors")
    assert checkpoint.counters.iteration == status.iteration == status.saved_at
    scene = load_scene(tmp_path / "toy.ply")
    np.testing.assert_array_equal(scene.means, checkpoint.parameters.means)
    thread.close()  # once more does nothing


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has priorities of threads")
def test_a_maker_that_gives_way_afterwards_takes_nothing_from_the_training(make_session) -> None:
    own, made = niceness(), []

    def window() -> None:
        thread = BackgroundTraining(make_session(iterations=100_000))
        os.setpriority(os.PRIO_PROCESS, 0, own + 3)
        thread.begin()
        made.append(thread)

    maker = threading.Thread(target=window)
    maker.start()
    maker.join()
    found = made[0].post(lambda training_run: niceness()).result(200)
    made[0].close()
    assert found == own


def test_closing_before_the_first_step_writes_nothing(make_session, tmp_path) -> None:
    thread = BackgroundTraining(make_session())
    thread.close()
    assert not (tmp_path / "toy.ply").exists()


def test_closing_after_a_failure_saves_the_scene_but_not_the_checkpoint(
    begin, make_session, tmp_path
) -> None:
    training_run = make_session(iterations=100_000)
    thread = begin(training_run=training_run)
    wait(lambda: thread.status.iteration > 3, "steps")
    thread.stop()
    settled(thread)
    saved = (tmp_path / "toy.checkpoint.safetensors").read_bytes()
    thread.resume()
    at = thread.status.iteration
    wait(lambda: thread.status.iteration > at, "steps")
    training_run.trainer.step = None  # what is not callable fails
    wait(lambda: thread.status.state == "failed", "the failure")
    (tmp_path / "toy.ply").unlink()
    thread.close()
    assert (tmp_path / "toy.ply").exists()
    assert (tmp_path / "toy.checkpoint.safetensors").read_bytes() == saved


def test_a_scene_that_cannot_be_saved_when_closing_is_kept_elsewhere(begin, tmp_path, monkeypatch) -> None:
    thread = begin()
    wait(lambda: thread.status.iteration > 3, "steps")
    monkeypatch.setattr(sessions.tempfile, "tempdir", str(tmp_path))
    save = sessions.save_scene

    def full(scene, path) -> None:
        if Path(path) == thread.outputs.scene:
            raise InputError(f"{path}: cannot be written: No space left on device")
        save(scene, path)

    monkeypatch.setattr(sessions, "save_scene", full)
    with pytest.raises(InputError, match="No space left") as caught:
        thread.close()
    assert len(load_scene(Path(str(caught.value).rpartition(" ")[2]))) > 0


def test_a_whole_run_writes_what_a_run_without_a_window_writes(begin, tmp_path) -> None:
    thread = begin(iterations=60, eval_every=20)
    wait(lambda: thread.status.saved_at == 60 and not thread.status.activity, "the end")
    settled(thread)
    assert thread.status.state == "done" and thread.status.progress == 1
    assert load_checkpoint(tmp_path / "toy.checkpoint.safetensors").counters.iteration == 60
    assert list((tmp_path / "pictures").glob("*.png"))
    lines = [json.loads(line) for line in (tmp_path / "m.jsonl").read_text().splitlines()]
    assert [line["iteration"] for line in lines if "psnr" in line] == [20, 40, 60]
    iteration, psnr = thread.evaluations.read("iteration", "psnr")
    assert iteration.tolist() == [20, 40, 60]
    assert psnr.tolist() == [line["psnr"] for line in lines if "psnr" in line]
    iteration, seconds, loss = thread.history.read("iteration", "seconds", "loss")
    assert iteration.tolist() == list(range(1, 61))
    assert (np.diff(seconds) > 0).all() and np.isfinite(loss).all()

    thread.resume()
    settled(thread)
    assert any("longer" in note for note in thread.take_notes())
    thread.change(iterations=80).result(200)
    thread.resume()
    wait(lambda: thread.status.iteration == 80, "a longer run")


def test_a_run_that_is_over_already_writes_its_scene_and_takes_no_step(begin, make_session, tmp_path) -> None:
    session = make_session(iterations=5)
    while not session.trainer.done:
        session.trainer.step(0.0)
    thread = begin(training_run=session)
    wait(lambda: thread.status.saved_at == 5 and not thread.status.activity, "the scene")
    assert thread.status.state == "done" and thread.status.iteration == 5
    assert len(load_scene(tmp_path / "toy.ply")) == 60 and list((tmp_path / "pictures").glob("*.png"))


def test_exports_and_checkpoints_on_request(begin, tmp_path) -> None:
    thread = begin()
    wait(lambda: thread.status.iteration > 1, "steps")
    thread.pause()
    scene = load_scene(thread.export(tmp_path / "now.ply").result(200))
    snapshot = thread.take_snapshot()
    assert snapshot is not None
    np.testing.assert_array_equal(scene.means, snapshot.gaussians.means)
    path = thread.save_checkpoint(tmp_path / "now.safetensors").result(200)
    assert load_checkpoint(path).counters.iteration == snapshot.iteration
    with pytest.raises(InputError):
        thread.export(tmp_path / "nowhere" / "now.ply").result(200)
    notes = thread.take_notes()
    assert any("now.ply" in note for note in notes) and "nowhere" in notes[-1]
    assert thread.evaluate().result(200) is thread.status.evaluation


def test_time_left() -> None:
    def left(**changes: Any) -> float | None:
        return replace(status, **changes).seconds_left

    status = Status(
        state="training",
        settings=TrainSettings(iterations=1000),
        iteration=400,
        progress=0.4,
        seconds=60.0,
        gaussians=10,
        sh_degree=0,
        loss=math.nan,
    )
    assert left() is None, "the pace is not known"
    assert left(rate=10.0) == 60
    minutes = TrainSettings(iterations=None, minutes=2.0)
    assert left(settings=minutes) == 60
    assert left(settings=minutes, seconds=200.0) == 0
    assert left(settings=TrainSettings(iterations=1000, minutes=2.0), rate=100.0) == 6
    several = TrainSettings(iterations=1000, minutes=10.0, ensemble=3)
    assert left(settings=several, progress=0.25) == 180, "of all scenes"


@pytest.mark.parametrize(
    ("share", "cores", "threads", "duty"),
    [
        (1.0, 2, 2, 1.0),
        (0.5, 2, 1, 1.0),
        (0.75, 2, 2, 0.75),
        (0.25, 2, 1, 0.5),
        (0.7, 10, 7, 1.0),
        (0.0, 4, 1, 0.08),
        (2.0, 3, 3, 1.0),
    ],
)
def test_shares_become_threads_and_sleep(share, cores, threads, duty) -> None:
    assert pace_of(share, cores) == (threads, pytest.approx(duty))


def test_a_small_share_sleeps_between_steps(begin) -> None:
    """The thread itself is asleep for what it does not have; measured by its own clock of processor time."""
    thread = begin(share=0.1, cores=1)
    wait(lambda: thread.status.iteration > 2, "steps")

    def busy(training_run: TrainingRun) -> tuple[float, float]:
        return time.thread_time(), time.perf_counter()

    cpu, wall = thread.post(busy).result(200)
    at = thread.status.iteration
    wait(lambda: thread.status.iteration >= at + 10, "ten steps, and what it slept after them")
    cpu_later, wall_later = thread.post(busy).result(200)
    assert cpu_later - cpu < 0.5 * (wall_later - wall)


def test_many_held_out_photos_are_measured_in_part_on_the_way_and_all_in_the_end(
    make_session, begin, views, monkeypatch, tmp_path
):
    """Curves are of the same photos to the end, and of all photos where the user has said how often."""
    monkeypatch.setattr(sessions, "MOST_WATCHED", 2)
    monkeypatch.setattr(sessions, "EVALUATE_EVERY", 10)
    monkeypatch.setattr(sessions, "EVALUATION_SHARE", np.inf)

    def lines(eval_every: int | None) -> list[dict[str, Any]]:
        (tmp_path / "m.jsonl").unlink(missing_ok=True)
        run = make_session(eval_every=eval_every, iterations=30)
        run = TrainingRun(
            run.trainer, views[:3], run.outputs, started=time.perf_counter(), eval_every=eval_every
        )
        assert [view.camera.name for view in run.watched] == [views[0].camera.name, views[2].camera.name]
        thread = begin(training_run=run)
        wait(lambda: thread.status.saved_at == 30 and not thread.status.activity, "the end")
        settled(thread)
        told = [json.loads(line) for line in (tmp_path / "m.jsonl").read_text().splitlines()]
        last = run.evaluation
        assert last is not None and [score.name for score in last.scores] == [
            v.camera.name for v in views[:3]
        ]
        (curve,) = thread.evaluations.read("psnr")
        assert curve[-1] == pytest.approx((last.scores[0].psnr + last.scores[2].psnr) / 2)
        assert told[-1]["psnr"] == last.psnr and len(told[-1]["stages"]) > 3
        return told

    assert [(line["iteration"], line["held_out"]) for line in lines(None)] == [(10, 2), (20, 2), (30, 3)]
    assert [(line["iteration"], line["held_out"]) for line in lines(10)] == [(10, 3), (20, 3), (30, 3)]


@pytest.mark.parametrize(("asked", "expected"), [(None, 1), (10, 3)])
def test_evaluations_that_nobody_asked_for_take_little_of_the_time(
    make_session, monkeypatch, asked, expected
):
    """Large photos take seconds to measure: after the first, the next waits until its share of time is there;
    where the user has said how often, that holds."""
    monkeypatch.setattr(sessions, "EVALUATE_EVERY", 10)
    session = make_session(eval_every=asked, iterations=1000)
    measured = []

    def costly(views: object) -> Evaluation:
        measured.append(session.trainer.counters.iteration)
        session._evaluated, session._evaluation_cost = time.perf_counter(), 1000.0
        return Evaluation(())

    session.evaluate = costly
    for _ in range(30):
        session.step()
    assert measured == [10, 20, 30][:expected]
