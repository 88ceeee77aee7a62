"""What a user does with a window that trains, run by `conftest.drive` in a process of its own.

usage: training_drives.py NAME RESULT.json OPTIONS.json CAPTURE

`splatview train CAPTURE -o toy.ply` is run in the working directory, with the command-line options that
OPTIONS names under "train".
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from drives import Hand, pose, without_frame_limit
from imgui_bundle import ImVec2, hello_imgui

from splatview.cli import train
from splatview.cli import train as train_window
from splatview.edit.operations import Select
from splatview.edit.tools import NoTools
from splatview.raster.compiling import niceness
from splatview.scene import InputError
from splatview.scene.edits import SceneEdits
from splatview.trainer.editing import CUT_STEPS
from splatview.trainer.effects import SCENES
from splatview.trainer.run import TrainingRun
from splatview.viewer import app as window
from splatview.viewer import dialogs as file_dialogs
from splatview.viewer.app import ATTENDED_SECONDS
from splatview.viewer.editing.session import Editing, EditSession, session_of
from splatview.viewer.overlays import PHOTO_SIZE, pyramids
from splatview.viewer.state import AppState
from splatview.viewer.training.live import LiveTraining


def training_of(app: AppState) -> LiveTraining:
    return app.feature(LiveTraining)


def seen(hand: Hand, beyond: int = 0) -> int:
    """Waits until the view shows a snapshot of a step after `beyond`, and returns its step."""
    training = training_of(hand.app)
    hand.wait(lambda: training.shown is not None and training.shown.iteration > beyond, "a snapshot")
    assert training.shown is not None
    return training.shown.iteration


def last_seen(hand: Hand) -> None:
    """Waits until the view shows the scene as the trainer has left it; for one that stands."""
    training = training_of(hand.app)
    hand.wait(
        lambda: training.shown is not None and training.shown.iteration == training.status.iteration,
        "the last snapshot",
    )


def height(hand: Hand, item: str) -> float:
    """Where an item stands in its window, pixels from the top."""
    return hand.ctx.item_info(item).rect_full.min.y


def steps(hand: Hand, count: int) -> None:
    training = training_of(hand.app)
    goal = training.status.iteration + count
    hand.wait(lambda: training.status.iteration >= goal, f"{count} steps")


def all_of_it(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Watch, pause, change a setting, step, go on, compare, fly, export, stop: by mouse and keys."""
    file_dialogs.has_native_dialogs = lambda: False
    app.prefer(smooth=False)
    ctx, training = hand.ctx, training_of(app)
    hand.wait(lambda: app.is_open, "the first snapshot")
    found["scene"] = app.scene.name if app.is_open else None
    found["first_eye"] = pose(app)["eye"]
    heights = found["heights"] = [height(hand, "//Training/Recipe")]
    found["shown"] = [seen(hand), seen(hand, training.status.iteration)]
    found["splats_shown"] = app.stats.splats if app.stats else None

    ctx.item_click("//Training/###pause")
    hand.wait(lambda: training.status.state == "paused", "the pause")
    at = training.status.iteration
    hand.wait(lambda: training.shown is not None and training.shown.iteration == at, "the last snapshot")
    hand.wait(lambda: not app.waiting, "the picture")
    picture = hand.picture()
    drawn = app.stats.drawn
    time.sleep(0.3)
    hand.frames(10)
    found["paused_at"] = [at, training.status.iteration]
    heights.append(height(hand, "//Training/Recipe"))
    found["drawn_in_pause"] = app.stats.drawn - drawn
    found["picture_mean"] = float(picture[..., :3].mean())

    found["niceness"] = [niceness(), training.thread.post(lambda _: niceness()).result(200)]
    pacing = hello_imgui.get_runner_params().fps_idling
    found["attended"] = pacing.time_active_after_last_event

    before = training.status.settings
    ctx.item_open("//Training/Recipe")
    ctx.item_input_value("//Training/##Max splats", 1234)
    hand.frames(3)
    ctx.item_click("//Training/##Max splats/+")
    hand.wait(lambda: training.status.settings.max_splats == 2234, "the setting")
    found["max_splats"] = [before.max_splats, training.status.settings.max_splats]

    ctx.item_click("//Training/###step")
    hand.wait(lambda: training.status.iteration == at + 1, "one step")
    hand.frames(5)
    found["stepped_to"] = training.status.iteration
    hand.press("Period")
    hand.wait(lambda: training.status.iteration == at + 2, "one more step")

    hand.press("Space")
    hand.wait(lambda: training.status.state == "training", "training to go on")
    steps(hand, 20)
    heights.append(height(hand, "//Training/Recipe"))

    hand.strip("Compare")
    hand.wait(lambda: training.comparer.latest is not None, "the comparison")
    ctx.item_click("//Compare/###next")
    hand.wait(
        lambda: (
            training.comparer.latest is not None
            and training.comparer.latest.request.shot is training.photos[1].shot
        ),
        "the next photo",
    )
    made = training.comparer.latest
    assert made is not None
    found["compared"] = [list(made.photo.shape), list(made.render.shape), made.psnr]
    hand.strip("Curves")
    ctx.item_click("//Curves/seconds")
    hand.frames(3)
    found["by_seconds"] = training.by_seconds

    ctx.item_close("//Training/Recipe")
    ctx.item_open("//Training/Photos")
    ctx.item_click("//Training/Go to this camera")
    hand.frames(4)
    found["at_photo"] = [app.camera.eye.tolist(), training.photos[1].camera.eye.tolist()]
    ctx.item_click("//Training/Measure")
    hand.wait(lambda: training.status.evaluation is not None, "the scores")
    found["scores"] = training.scores
    window.ATTENDED_SECONDS = ATTENDED_SECONDS
    found["software"] = hand.is_software()
    if found["software"]:  # a window on a GPU takes nothing of the cores
        hand.wait(lambda: pacing.time_active_after_last_event == 0, "the window to leave the cores alone")
        found["unattended_fps"] = pacing.fps_idle
        ctx.mouse_move("//Training/###pause")
        hand.wait(lambda: pacing.time_active_after_last_event > 0, "the window to wake")
    without_frame_limit()

    shown = seen(hand)
    hand.press("F3")
    hand.hold("W", 0.3)
    hand.press("F2")
    found["flown"] = pose(app)["eye"]
    seen(hand, shown)
    hand.press("2")
    hand.frames(3)
    found["mode"] = app.mode
    hand.press("1")
    hand.press("F12")
    hand.wait(lambda: any("Picture saved" in line for line in hand.said), "the screenshot")

    ctx.item_click("//Training/###export")
    hand.frames(4)
    ctx.key_chars_replace_enter(str(Path.cwd() / "exported.ply"))
    hand.wait(lambda: Path("exported.ply").exists(), "the export")
    hand.wait(lambda: any("exported.ply" in line for line in hand.said), "word of it")
    ctx.item_click("//Training/###stop")
    hand.wait(lambda: training.status.saved_at is not None, "scene and checkpoint")
    found["saved"] = [training.status.saved_at, training.status.iteration, training.status.state]
    found["files"] = sorted(path.name for path in Path().iterdir())


def breaks(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """The trainer fails, and is tried again."""
    training = training_of(app)
    seen(hand)

    def fail(*arguments: Any) -> Any:
        raise FloatingPointError("a step went wrong")

    trainer = training.thread.post(lambda session: session.trainer).result(200)
    vars(trainer)["step"] = fail
    hand.wait(lambda: app.problem is not None, "the dialog")
    hand.frames(5)
    found["problem"] = app.problem
    found["state"] = training.status.state
    last_seen(hand)
    found["scene_stays"] = app.is_open and len(app.scene.gaussians) == training.status.gaussians
    found["picture_mean"] = float(hand.picture()[..., :3].mean())
    hand.ctx.item_click("//That did not work/OK")
    hand.frames(3)
    del vars(trainer)["step"]
    at = training.status.iteration
    hand.ctx.item_click("//Training/###pause")
    hand.wait(lambda: training.status.iteration > at + 3, "steps after the failure")
    found["went_on"] = training.status.state


def plugin_fails(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """The user's loss fails: it is told, training stops, and the window lives."""
    training = training_of(app)
    hand.wait(lambda: app.problem is not None, "the dialog")
    hand.frames(5)
    found["problem"], found["state"] = app.problem, training.status.state
    found["iteration"] = training.status.iteration
    hand.ctx.item_click("//That did not work/OK")
    last_seen(hand)
    found["scene_stays"] = app.is_open and len(app.scene.gaussians) == training.status.gaussians
    found["problem_after"] = app.problem


def closes(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """The window is closed in the middle of training, by Ctrl-C if `signal` is asked for."""
    seen(hand, 5)
    found["state"] = training_of(app).status.state
    found["iteration"] = training_of(app).status.iteration
    if options.get("signal"):
        os.kill(os.getpid(), signal.SIGINT)
        hand.wait(lambda: app.quitting, "the window to heed it")


def leaves_out(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """A photo of a wrong pose is named, and marked in the list and beside the scene."""
    training = training_of(app)
    hand.wait(lambda: bool(training.status.left_out), "a photo to be left out")
    found["left_out"] = sorted(training.status.left_out)
    index = next(i for i, photo in enumerate(training.photos) if photo.name in training.status.left_out)
    hand.strip("Compare")
    ctx = hand.ctx
    while training.photo_index != index:
        ctx.item_click("//Compare/###next")
        hand.frames(2)
    hand.wait(lambda: training.comparer.latest is not None, "the comparison")
    ctx.item_close("//Training/Recipe")
    ctx.item_open("//Training/Photos")
    ctx.item_click("//Training/Measure")  # which scrolls to the list
    hand.frames(5)
    hand.shoot(options.get("shot"))
    found["told"] = [message.text for message in app.messages if "photos left out" in message.text]


def masks(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """A photo before which something passes is marked in the list, and dark there beside the scene."""
    training = training_of(app)
    hand.wait(lambda: bool(training.status.in_part), "a photo to be masked in part")
    found["in_part"] = sorted(training.status.in_part)
    index = next(i for i, photo in enumerate(training.photos) if photo.name in training.status.in_part)
    hand.strip("Compare")
    ctx = hand.ctx
    while training.photo_index != index:
        ctx.item_click("//Compare/###next")
        hand.frames(2)

    def is_dark() -> bool:
        latest = training.comparer.latest
        return latest is not None and latest.request.in_part is training.status.in_part[found["in_part"][0]]

    hand.wait(is_dark, "the comparison")
    latest = training.comparer.latest
    assert latest is not None
    found["photo"] = latest.photo.astype(int).tolist()
    ctx.item_close("//Training/Recipe")
    ctx.item_open("//Training/Photos")
    ctx.item_click("//Training/Measure")  # which scrolls to the list
    hand.frames(5)
    hand.shoot(options.get("shot"))
    found["told"] = [message.text for message in app.messages if "transients masked" in message.text]


def elsewhere(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Another scene is opened while training goes on, and the training shown again; then it ends."""
    training = training_of(app)
    app.prefer(smooth=False)
    seen(hand)
    hand.drop(options["other"])
    hand.wait(lambda: app.is_open and app.scene.name == "other.ply", "the other scene")
    steps(hand, 10)
    hand.frames(10)
    found["other_stays"] = app.scene.name if app.is_open else None
    hand.frames(2)
    hand.ctx.item_click("//Training/Show the training")
    hand.wait(lambda: training.followed_by(app), "the training's scene")
    found["back"] = [seen(hand), app.scene.name if app.is_open else None]

    index = next(i for i, photo in enumerate(training.photos) if photo.held_out)
    found["clicked"] = click_frustum(app, hand, index)
    end_after(training, 100)
    hand.wait(lambda: training.status.state == "done", "the end")
    hand.wait(lambda: training.status.saved_at is not None and not training.status.activity, "saving")
    found["progress"] = training.status.progress
    last_seen(hand)
    answer = training.thread.post(lambda session: session.trainer.splats.arrays.means.copy())
    assert training.shown is not None
    found["shown_is_trained"] = bool(np.array_equal(answer.result(200), training.shown.gaussians.means))


def end_after(training: LiveTraining, count: int) -> None:
    """Has the run end so many steps later, counted where nobody steps meanwhile."""
    training.thread.post(
        lambda run: run.trainer.change(iterations=run.trainer.counters.iteration + count)
    ).result(200)


def select_rectangle(app: AppState, hand: Hand) -> EditSession:
    """Selects what a rectangle over the middle of the view covers, by mouse."""
    hand.press("R")
    hand.drag(130, 90, over=(0.4, 0.45))
    hand.wait(
        lambda: (session := session_of(app)) is not None and session.document.counts.selected > 0,
        "a selection",
    )
    session = session_of(app)
    assert session is not None
    return session


def edits_a_later_scene(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Deletes splats of the first of several shorter scenes, which is shown while the second is trained."""
    training = training_of(app)
    app.prefer(smooth=False)
    seen(hand)

    def shorten(run: TrainingRun) -> int:
        """Scenes end so many steps from now, however many have been taken before a snapshot was shown."""
        steps = run.trainer.counters.iteration + options["steps"]
        run.trainer.change(shorter=(steps, run.trainer.settings.max_splats))
        return steps

    steps = found["steps"] = training.thread.post(shorten).result(200)
    hand.wait(lambda: training.status.scene == 2, "the second scene")
    hand.ctx.item_click("//Training/###pause")
    hand.wait(lambda: training.status.state == "paused", "the pause")
    found["paused_in"] = [training.status.scene, training.status.iteration]
    hand.wait(
        lambda: training.shown is not None and training.shown.iteration >= steps,
        "the first scene as it ended",
    )
    session = select_rectangle(app, hand)
    assert training.shown is not None
    held, found["shown_at"] = training.shown, training.shown.iteration
    selected = held.ids[session.document.selected.indices]
    found["before"], found["selected"] = len(held.ids), len(selected)
    hand.shoot(options.get("selected"))
    hand.press("Delete")
    hand.wait(lambda: training.shown is not held, "the snapshot without them")
    found["after"], found["still_there"] = (
        len(training.shown.ids),
        int(np.isin(selected, training.shown.ids).sum()),
    )
    hand.press("Escape")
    hand.wait(lambda: training.status.state == "done", "the end")  # nothing to go on with
    seen(hand)
    found["reports"] = next(one.why for one in training.thread.effects if one.name == SCENES)
    found["ended_at"] = [training.status.scene, training.status.iteration, training.status.progress]
    found["at_the_end"] = [len(training.shown.ids), int(np.isin(selected, training.shown.ids).sum())]
    hand.wait(lambda: not app.waiting, "the picture")
    hand.shoot(options.get("ended"))


def edits(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Select and delete, cut and let nothing grow, while training goes on; and take the rules back."""
    ctx, training = hand.ctx, training_of(app)
    app.prefer(smooth=False)
    seen(hand, 60)
    session = select_rectangle(app, hand)
    assert training.shown is not None
    held, rectangle = training.shown, session.document.history.done[-1].operation
    assert isinstance(rectangle, Select)
    splats = session.document.selected.indices
    steps(hand, 20)
    hand.frames(5)
    found["held"] = training.shown is held
    hand.page("Edit")
    hand.wait(lambda: not app.waiting, "the picture")
    hand.shoot(options.get("selected"))
    hand.press("Delete")
    hand.wait(lambda: training.shown is not held, "the snapshot without them")
    now = training.shown
    found["still_there"] = int(np.isin(held.ids[splats], now.ids).sum())
    found["deleted"] = len(splats)
    edited = SceneEdits(marks=np.zeros(len(now.ids), np.uint32))
    # Not those born since: a quick trainer fills the gap again before anybody looks.
    older = np.isin(now.ids, held.ids)
    found["in_rectangle"] = int((rectangle.by.mask(now.gaussians, edited, NoTools()) & older).sum())
    found["tool"] = session.tool if (session := session_of(app)) else None
    hand.press("Escape")
    seen(hand, now.iteration)

    crop(app, hand, "Add box", options["growth"])
    hand.shoot(options.get("growth_box"))
    ctx.item_click("//Edit/Crop/No growth inside")
    hand.wait(lambda: len(training.status.settings.no_growth) == 1, "the rule")
    first = training.thread.post(lambda session: session.trainer.splats.next_id).result(200)
    ctx.item_click("//Edit/###let go")
    hand.wait(
        lambda: training.shown is not None and int((training.shown.ids >= first).sum()) >= 50,
        "splats born since",
    )
    region = training.status.settings.no_growth[0]
    found["born"] = int((training.shown.ids >= first).sum())
    inner = replace(region, half_extents=tuple(0.8 * half for half in region.half_extents))
    is_inside, is_new = inner.contains(training.shown.gaussians.means), training.shown.ids >= first
    found["born_inside"] = int(is_inside[is_new].sum())
    found["share_inside"] = float(is_inside[~is_new].mean())

    crop(app, hand, "Add sphere", options["cut"])
    ctx.item_click("//Edit/Crop/Cut away in training")
    hand.wait(lambda: len(training.status.settings.cut) == 1, "the rule")
    hand.wait(lambda: session_of(app) is None, "the view to go on")
    seen(hand, training.status.iteration + 60)
    training.thread.pause()
    hand.wait(lambda: training.status.state == "paused", "the pause")
    while training.status.iteration % CUT_STEPS:  # in between splats move out, until the next look
        at = training.status.iteration
        training.thread.step_once()
        hand.wait(lambda at=at: training.status.iteration == at + 1, "a step")
    last_seen(hand)
    (sphere,) = training.status.settings.cut[0]
    outside = training.shown.gaussians.means[~sphere.contains(training.shown.gaussians.means)]
    found["left"] = len(training.shown.ids)
    found["outside"] = len(outside)
    training.thread.save_checkpoint(Path("rules.safetensors")).result(200)
    ctx.mouse_move("//Edit/Rules of the training/cut 0/###remove")
    hand.frames(3)
    found["pointed"] = len(app.feature(Editing).outlined)
    hand.shoot(options.get("rules"))
    hand.press("H")
    hand.frames(3)
    found["panels_hidden"] = len(app.feature(Editing).outlined)
    hand.press("H")
    hand.frames(3)
    ctx.item_click("//Edit/Rules of the training/cut 0/###remove")
    ctx.item_click("//Edit/Rules of the training/no_growth 0/###remove")
    hand.wait(lambda: not (training.status.settings.cut or training.status.settings.no_growth), "no rules")
    training.thread.resume()
    steps(hand, 5)
    found["failure"] = training.status.failure


def crop(app: AppState, hand: Hand, button: str, half: float) -> None:
    """Holds the view and adds a crop of this half size."""
    ctx = hand.ctx
    hand.page("Edit")
    ctx.item_click("//Edit/###hold")
    hand.wait(lambda: session_of(app) is not None, "the desk")
    hand.frames(3)
    ctx.item_open("//Edit/Crop")
    ctx.item_click(f"//Edit/Crop/{button}")
    hand.wait(lambda: bool((session := session_of(app)) and session.document.crops), "the crop")
    hand.frames(3)
    for number in range(3):
        ctx.item_input_value(f"//Edit/Crop/##Half size/$${number}", half)
        hand.frames(2)


def click_frustum(app: AppState, hand: Hand, index: int) -> list[int]:
    """Looks at the cameras from afar and above, where none is before another, and clicks on one: its index,
    and the one that was gone to."""
    training = training_of(app)
    hand.press("Shift+Y")
    hand.settle()
    hand.press("F")
    view = app.view
    app.post(lambda app: app.steer(replace(view, distance=6 * view.distance)))
    hand.frames(3)
    assert app.is_open
    drawn = dict(pyramids(training.cameras, app.camera, PHOTO_SIZE * app.scene.radius))
    corner = hand.ctx.window_info("//View").rect_full.min
    x, y = drawn[index][0][0]  # where its eye is
    hand.ctx.mouse_teleport_to_pos(ImVec2(corner.x + float(x), corner.y + float(y)))
    hand.frames(2)
    hand.ctx.mouse_click(0)
    hand.frames(3)
    return [index, app.camera_index]


def main() -> int:
    name, result, given, capture = sys.argv[1:]
    found: dict[str, Any] = {}
    options = json.loads(given)

    def act(app: AppState, ctx: Any) -> None:
        hand = Hand(app, ctx)
        hand.draw_little()
        try:
            functions[name](app, hand, options, found)
        finally:
            found["messages"] = hand.said

    parsed = train.make_parser().parse([capture, "-o", "toy.ply", *options.get("train", [])])
    assert parsed is not None
    without_frame_limit()
    try:
        code = train_window.train_in_window(
            parsed,
            time.perf_counter(),
            lambda run: "",
            drive=act,
            size=tuple(options.get("size", (800, 500))),
        )
    except InputError as error:
        found["error"], code = str(error), 0
    Path(result).write_text(json.dumps(found))
    return code


functions: dict[str, Callable[[AppState, Hand, dict[str, Any], dict[str, Any]], None]] = {
    function.__name__: function
    for function in (
        all_of_it,
        breaks,
        plugin_fails,
        closes,
        elsewhere,
        leaves_out,
        masks,
        edits,
        edits_a_later_scene,
    )
}


if __name__ == "__main__":
    sys.exit(main())
