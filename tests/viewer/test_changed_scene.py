"""What looks at the open scene follows edits: its values, its number of splats, where they are."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.edit.operations import OPERATIONS, Select
from splatview.edit.operations.appearance import ColourGrade, Grade
from splatview.edit.operations.cleanup import Repair
from splatview.edit.operations.merge_split import Merge
from splatview.edit.operations.transform import Transform
from splatview.edit.selectors import Everything, IndexRuns
from splatview.scene import Gaussians, ImageModel, RenderSettings
from splatview.scene.edits import HIDDEN
from splatview.scene.effects.overrides import followed, settings_for
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.framing import robust_bounds
from splatview.viewer.camera import bounds
from splatview.viewer.commands import COMMANDS
from splatview.viewer.editing import saving
from splatview.viewer.editing import session as changed_scene
from splatview.viewer.editing.files import import_files
from splatview.viewer.editing.scene_files import rows
from splatview.viewer.editing.session import Editing, EditSession, session_of
from splatview.viewer.loading import Examination
from splatview.viewer.open import open_paths
from splatview.viewer.panels.edit import orient
from splatview.viewer.quality.effects import Effects
from splatview.viewer.quality.state import Accuracy
from splatview.viewer.state import AppState


@pytest.fixture
def open_scene(app: AppState, tmp_path: Path, wait_for_loading) -> Callable[[Gaussians], EditSession]:
    def make(gaussians: Gaussians) -> EditSession:
        save_scene(gaussians, tmp_path / "a.ply")
        open_paths(app, [tmp_path / "a.ply"])
        wait_for_loading(app)
        app.feature(Editing).before_frame(app)
        session = session_of(app)
        assert session is not None
        return session

    return make


def settle(app: AppState) -> None:
    """Frames until all has followed."""
    limit = time.monotonic() + 200
    session = session_of(app)
    assert session is not None
    while True:
        app.feature(Editing).before_frame(app)
        assert time.monotonic() < limit, "it never comes to rest"
        if (
            app.feature(Editing).examining is None
            and session.job is None
            and session.loaded is session.gaussians
        ):
            return
        time.sleep(0.001)


def padded(gaussians: Gaussians, degree: int) -> Gaussians:
    """With zeros for the bands that it has not."""
    sh = np.zeros((len(gaussians), (degree + 1) ** 2, 3), np.float32)
    sh[:, : gaussians.sh.shape[1]] = gaussians.sh
    return replace(gaussians, sh=sh)


def test_copies_are_part_of_the_open_scene_and_undoing_takes_them_out(
    app, open_scene, random_gaussians
) -> None:
    session = open_scene(random_gaussians(40))
    opened = app.scene.gaussians
    session.apply(Select(by=Everything()))
    session.apply(OPERATIONS["duplicate"]())
    settle(app)
    assert app.scene.gaussians is session.gaussians
    assert len(app.scene.gaussians) == 80
    assert len(app.edits.marks) == 80
    session.undo()
    settle(app)
    np.testing.assert_array_equal(app.scene.gaussians.means, opened.means)


def test_until_the_picture_has_the_copies_all_is_as_before(app, open_scene, random_gaussians) -> None:
    session = open_scene(random_gaussians(40))
    assert len(app.edits.marks) == 40
    session.apply(Select(by=Everything()))
    assert len(app.edits.marks) == 40
    session.apply(OPERATIONS["duplicate"]())
    assert (len(app.scene.gaussians), len(app.edits.marks)) == (40, 40)
    settle(app)


def hidden_by_a_shortcut(app: AppState) -> list[int]:
    """How many splats are hidden of how many, when it is known which."""
    limit = time.monotonic() + 200
    while True:
        edits = app.feature(Accuracy).next_frame(app).edits
        assert edits is not None
        if not app.feature(Accuracy).busy(app) and edits is app.feature(Accuracy).next_frame(app).edits:
            return [int(np.count_nonzero(edits.marks & HIDDEN)), len(edits.marks)]
        assert time.monotonic() < limit, "it is never known"
        time.sleep(0.001)


def test_a_shortcut_hides_its_share_of_the_changed_scene(app, open_scene, random_gaussians) -> None:
    """What failed: marks of 80 splats hidden by the ranking of 40."""
    session = open_scene(random_gaussians(40))
    app.feature(Accuracy).choices["keep"] = "50"
    app.feature(Accuracy).next_frame(app)
    assert hidden_by_a_shortcut(app) == [20, 40]
    session.apply(Select(by=Everything()))
    session.apply(OPERATIONS["duplicate"]())
    assert hidden_by_a_shortcut(app) == [20, 40]
    settle(app)
    assert len(app.feature(Accuracy).next_frame(app).edits.marks) == 80, (
        "nothing is hidden yet, and nobody waits"
    )
    assert hidden_by_a_shortcut(app) == [40, 80]
    session.undo()
    settle(app)
    assert hidden_by_a_shortcut(app) == [20, 40]


def test_health_is_that_of_the_repaired_scene(app, open_scene, random_gaussians) -> None:
    ill = random_gaussians(40)
    ill.quats[:3] = 0
    session = open_scene(ill)
    app.examination.join(200)

    def invalid_splats() -> dict[str, int]:
        return {found.name: found.count for found in app.examination.findings if found.count}

    name = next(name for name, count in invalid_splats().items() if "quat" in name and count == 3)
    session.apply(Repair(finding=name))
    assert name in invalid_splats(), "as it was, until the changed scene has been looked through"
    settle(app)
    assert name not in invalid_splats()
    session.undo()
    settle(app)
    assert invalid_splats()[name] == 3


def test_of_many_steps_in_a_row_the_last_is_looked_through(
    app, open_scene, random_gaussians, monkeypatch
) -> None:
    session = open_scene(random_gaussians(40))
    looked_through: list[int] = []
    all_done = threading.Event()

    class Slow(Examination):
        def __init__(self, gaussians: Gaussians):
            assert app.feature(Editing).examining is None or app.feature(Editing).examining.done, (
                "one at a time"
            )
            looked_through.append(len(gaussians))
            super().__init__(gaussians)

        def _run(self) -> None:
            assert all_done.wait(200)
            super()._run()

    monkeypatch.setattr(changed_scene, "Examination", Slow)
    session.apply(Select(by=Everything()))
    for _ in range(4):  # a copy each, of the copies before
        session.apply(OPERATIONS["duplicate"]())
        for _ in range(3):
            app.feature(Editing).before_frame(app)
    assert len(app.scene.gaussians) == 200
    all_done.set()
    settle(app)
    assert looked_through == [80, 200]
    assert app.examination.gaussians is app.scene.gaussians


def test_bands_that_a_merged_file_brings_are_switched_on(app, open_scene, random_gaussians, tmp_path) -> None:
    flat = random_gaussians(40, sh_degree=0)
    session = open_scene(padded(flat, 3))
    assert app.settings.sh_degree == 0
    save_scene(random_gaussians(20, sh_degree=3, seed=1), tmp_path / "b.ply")
    session.apply(Merge(path=str(tmp_path / "b.ply")))
    settle(app)
    assert app.settings.sh_degree is None
    assert app.scene.settings.sh_degree is None
    session.undo()
    settle(app)
    assert app.settings.sh_degree == 0


def test_settings_and_receipt_follow_a_colour_grade(app, open_scene, random_gaussians) -> None:
    scene = random_gaussians(40)
    sh = scene.sh.copy()
    sh[:, 1:] *= np.float32(1e-3)
    session = open_scene(replace(scene, sh=sh))
    app.examination.join()
    app.feature(Editing).before_frame(app)
    assert (app.settings.sh_degree, app.settings.early_stop) == (0, None)
    strong = ColourGrade(grade=Grade(contrast=10.0, saturation=4.0))
    session.apply(strong)
    app.feature(Editing).before_frame(app)
    expected = settings_for(app.scene.gaussians, palette=app.edits.palette)
    assert app.settings.sh_degree == expected.sh_degree != 0
    assert app.settings.early_stop == expected.early_stop is not None
    receipt = {effect.name: effect for effect in app.feature(Effects).receipt(app)}
    assert receipt["SH band 1"].on and receipt["SH band 1"].forced is None
    assert "as far as without the colour grade" in receipt["SH band 1"].why
    assert receipt["light behind opaque pixels"].on
    session.undo()
    app.feature(Editing).before_frame(app)
    assert (app.settings.sh_degree, app.settings.early_stop) == (0, None)
    app.settings = replace(app.settings, sh_degree=2)
    session.redo()
    app.feature(Editing).before_frame(app)
    assert app.settings.sh_degree == 2, "the user's word counts"


def test_settings_follow_a_file_that_is_read_again(app, open_scene, random_gaussians) -> None:
    open_scene(random_gaussians(40, sh_degree=0))
    open_scene(padded(random_gaussians(40, sh_degree=0), 3))
    assert app.settings.sh_degree == 0
    open_scene(random_gaussians(40))
    assert app.settings.sh_degree is None


def test_what_the_user_has_set_stays() -> None:
    before, after = RenderSettings(sh_degree=0), RenderSettings(early_stop=0.0)
    mine = replace(before, sh_degree=1, model=replace(before.model, antialiased=True))
    now = followed(mine, before, after)
    assert (now.sh_degree, now.early_stop, now.model.antialiased) == (1, 0.0, True)
    near = replace(before, model=replace(before.model, near=1.0))
    called_for = replace(after, model=replace(after.model, antialiased=True))
    assert followed(near, before, called_for).model == replace(called_for.model, near=1.0)
    assert followed(before, before, near).model.near == 1.0, "one that the scene calls for is not the user's"


def test_what_the_user_goes_up_to_stays_before_the_near_plane(app, open_scene, random_gaussians) -> None:
    open_scene(replace(random_gaussians(40), comments=("near plane 1.5",)))
    assert app.settings.model.near == app.called_for.model.near == 1.5
    for distance, near in ((8.0, 1.5), (2.0, 1.0), (0.001, ImageModel().near)):
        app.view = replace(app.view, distance=distance)
        assert app.seen_settings.model.near == pytest.approx(near)
    app.settings = replace(app.settings, model=replace(app.settings.model, near=1.75))
    assert app.seen_settings == app.settings, "one's own looks inside"


def test_imported_files_are_steps_and_rows(app, open_scene, random_gaussians, tmp_path) -> None:
    session = open_scene(random_gaussians(40))
    view = app.view
    paths = [tmp_path / "b.ply", tmp_path / "c.ply"]
    for path, splats in zip(paths, (5, 6), strict=True):
        save_scene(random_gaussians(splats), path)
    import_files(app, paths)
    settle(app)
    assert session_of(app) is session and app.view is view
    assert len(app.scene.gaussians) == 51
    assert [row.splats for row in rows(app)] == [40, 5, 6]
    assert session.active_file is session.document.files[2]
    assert app.preferences.recent[:2] == (str(paths[1]), str(paths[0]))
    session.undo()
    settle(app)
    assert [row.splats for row in rows(app)] == [40, 5] and session.active_file is None
    assert session.subject != "file"


def test_a_file_that_cannot_be_read_ends_the_import(app, open_scene, random_gaussians, tmp_path) -> None:
    session = open_scene(random_gaussians(40))
    session.apply(Select(by=Everything()))
    save_scene(random_gaussians(5), tmp_path / "b.ply")
    import_files(app, [tmp_path / "b.ply", tmp_path / "none.ply", tmp_path / "b.ply"])
    settle(app)
    assert "none.ply" in app.problem
    assert len(app.scene.gaussians) == 45


# ---- where the splats are


def test_without_edits_the_bounds_are_those_of_the_scene(app, open_scene, random_gaussians) -> None:
    assert bounds(app) is None
    session = open_scene(random_gaussians(400))
    opened = bounds(app)
    assert opened is not None
    np.testing.assert_allclose(opened[0], app.scene.centre, atol=1e-9)
    assert bounds(app, selected=True) is None
    session.apply(Select(by=Everything()))
    session.apply(OPERATIONS["delete"]())
    assert bounds(app) is None


def test_bounds_follow_what_is_moved_and_leave_out_what_is_deleted(app, open_scene, random_gaussians) -> None:
    session = open_scene(random_gaussians(400))
    before = bounds(app)
    means = app.scene.gaussians.means
    half = np.zeros(400, bool)
    half[:200] = True
    session.apply(Select(by=IndexRuns.of(half)))
    session.apply(Transform(translation=(100.0, 0.0, 0.0)))
    selected, everything = bounds(app, selected=True), bounds(app)
    assert before is not None and selected is not None and everything is not None
    expected = robust_bounds(means[:200].astype(np.float64) + np.array([100, 0, 0]))[0]
    np.testing.assert_allclose(selected[0], expected, atol=1e-4)
    assert everything[1] > 40, "both halves"
    session.apply(OPERATIONS["delete"]())
    left = bounds(app)
    assert left is not None
    np.testing.assert_allclose(left[0], robust_bounds(means[200:])[0], atol=1e-4)


@pytest.mark.parametrize("shape", ["box", "sphere"])
def test_a_new_crop_fits_what_is_shown(app, open_scene, random_gaussians, shape) -> None:
    scene = random_gaussians(2000)
    means = scene.means * np.array([1, 0.2, 0], np.float32) + np.array([5, 0, 0], np.float32)
    means[:20] += 1000  # floaters
    session = open_scene(replace(scene, means=means))
    COMMANDS[f"add_{shape}"].run(app)
    (crop,) = session.document.crops
    np.testing.assert_allclose(crop.centre, (5, 0, 0), atol=0.8)
    half = np.array(crop.half_extents)
    # Of means within 1 of the middle; floaters make it 2.5 times as wide as the middle ones at most.
    assert (half > 0).all() and half.max() < 2.9
    assert half[1] < 0.6 if shape == "box" else (half == half[0]).all()
    inside = session.document.cropped_in()
    assert inside[20:].mean() > 0.99 and not inside[:20].any(), "all of it, and no floaters"


def test_framing_shows_the_selection_else_everything(app, open_scene, random_gaussians) -> None:
    session = open_scene(random_gaussians(400))
    COMMANDS["frame_selection"].run(app)
    np.testing.assert_allclose(app.destination.target, app.scene.centre, atol=1e-9)
    session.apply(Select(by=Everything()))
    session.apply(Transform(translation=(0.0, 50.0, 0.0)))
    moved = app.scene.centre + np.array([0, 50, 0])
    for action in ("frame_selection", "frame_all"):
        COMMANDS[action].run(app)
        np.testing.assert_allclose(app.destination.target, moved, atol=1e-4)
    orient(app, (0.0, 0.0, 1.0))
    middle = bounds(app)
    assert middle is not None
    np.testing.assert_allclose(middle[0], moved, atol=0.3)


@pytest.mark.parametrize(
    ("suffix", "said", "saved"), [("ply", "every number", True), ("spz", " dB, ", False)]
)
def test_saving_tells_what_comes_back(app, open_scene, random_gaussians, tmp_path, suffix, said, saved):
    session = open_scene(random_gaussians(40, sh_degree=1))
    session.apply(OPERATIONS["select_all"]())
    saving.write(app, tmp_path / f"out.{suffix}")
    while session.job is not None:
        session.advance()
    assert session.news.startswith("Saved 40 splats") and said in session.news
    assert session.document.history.modified is not saved
    lost = any("fewer bits" in message.text for message in app.messages)
    assert lost is not saved and len(load_scene(tmp_path / f"out.{suffix}")) == 40
