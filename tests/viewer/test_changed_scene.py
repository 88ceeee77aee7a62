"""What looks at the open scene follows edits: its values, its number of splats, where they are."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.edit.operations import OPERATIONS, Select
from splatview.edit.operations.cleanup import Repair
from splatview.edit.operations.merge_split import Merge
from splatview.edit.operations.transform import Transform
from splatview.edit.selectors import Everything, IndexRuns
from splatview.scene import Gaussians, RenderSettings
from splatview.scene.edits import HIDDEN
from splatview.scene.formats import save_scene
from splatview.scene.framing import robust_bounds
from splatview.viewer.commands import ACTIONS
from splatview.viewer.editing import session as changed_scene
from splatview.viewer.editing.files import add_files
from splatview.viewer.editing.session import Desk, continue_editing, followed
from splatview.viewer.loading import Examination
from splatview.viewer.open import bounds, open_paths
from splatview.viewer.panels.edit import orient
from splatview.viewer.state import Core


@pytest.fixture
def open_scene(core: Core, tmp_path: Path, wait_for_loading) -> Callable[[Gaussians], Desk]:
    def make(gaussians: Gaussians) -> Desk:
        save_scene(gaussians, tmp_path / "a.ply")
        open_paths(core, [tmp_path / "a.ply"])
        wait_for_loading(core)
        continue_editing(core)
        assert core.desk is not None
        return core.desk

    return make


def settle(core: Core) -> None:
    """Frames until all has followed."""
    limit = time.monotonic() + 60
    desk = core.desk
    assert desk is not None
    while True:
        continue_editing(core)
        assert time.monotonic() < limit, "it never comes to rest"
        if core.examining is None and desk.job is None and desk.loaded is desk.gaussians:
            return
        time.sleep(0.001)


def padded(gaussians: Gaussians, degree: int) -> Gaussians:
    """With zeros for the bands that it has not."""
    sh = np.zeros((len(gaussians), (degree + 1) ** 2, 3), np.float32)
    sh[:, : gaussians.sh.shape[1]] = gaussians.sh
    return replace(gaussians, sh=sh)


def test_copies_are_part_of_the_open_scene_and_undoing_takes_them_out(
    core, open_scene, random_gaussians
) -> None:
    desk = open_scene(random_gaussians(40))
    opened = core.scene.gaussians
    desk.apply(Select(by=Everything()))
    desk.apply(OPERATIONS["duplicate"]())
    settle(core)
    assert core.scene.gaussians is desk.gaussians
    assert len(core.scene.gaussians) == 80
    assert len(core.edits.marks) == 80
    desk.undo()
    settle(core)
    np.testing.assert_array_equal(core.scene.gaussians.means, opened.means)


def test_until_the_picture_has_the_copies_all_is_as_before(core, open_scene, random_gaussians) -> None:
    desk = open_scene(random_gaussians(40))
    assert len(core.edits.marks) == 40
    desk.apply(Select(by=Everything()))
    assert len(core.edits.marks) == 40
    desk.apply(OPERATIONS["duplicate"]())
    assert (len(core.scene.gaussians), len(core.edits.marks)) == (40, 40)
    settle(core)


def hidden_by_a_shortcut(core: Core) -> list[int]:
    """How many splats are hidden of how many, when it is known which."""
    limit = time.monotonic() + 60
    while True:
        edits = core.accuracy.edits(core)
        assert edits is not None
        if not core.accuracy.waiting and edits is core.accuracy.edits(core):
            return [int(np.count_nonzero(edits.marks & HIDDEN)), len(edits.marks)]
        assert time.monotonic() < limit, "it is never known"
        time.sleep(0.001)


def test_a_shortcut_hides_its_share_of_the_changed_scene(core, open_scene, random_gaussians) -> None:
    """What failed: marks of 80 splats hidden by the ranking of 40."""
    desk = open_scene(random_gaussians(40))
    core.accuracy._kept = 0.5
    core.accuracy.edits(core)
    assert hidden_by_a_shortcut(core) == [20, 40]
    desk.apply(Select(by=Everything()))
    desk.apply(OPERATIONS["duplicate"]())
    assert hidden_by_a_shortcut(core) == [20, 40]
    settle(core)
    assert len(core.accuracy.edits(core).marks) == 80, "nothing is hidden yet, and nobody waits"
    assert hidden_by_a_shortcut(core) == [40, 80]
    desk.undo()
    settle(core)
    assert hidden_by_a_shortcut(core) == [20, 40]


def test_health_is_that_of_the_repaired_scene(core, open_scene, random_gaussians) -> None:
    ill = random_gaussians(40)
    ill.quats[:3] = 0
    desk = open_scene(ill)
    core.examination.join(30)

    def ill_splats() -> dict[str, int]:
        return {found.name: found.count for found in core.examination.findings if found.count}

    name = next(name for name, count in ill_splats().items() if "quat" in name and count == 3)
    desk.apply(Repair(finding=name))
    assert name in ill_splats(), "as it was, until the changed scene has been looked through"
    settle(core)
    assert name not in ill_splats()
    desk.undo()
    settle(core)
    assert ill_splats()[name] == 3


def test_of_many_steps_in_a_row_the_last_is_looked_through(
    core, open_scene, random_gaussians, monkeypatch
) -> None:
    desk = open_scene(random_gaussians(40))
    looked_through: list[int] = []

    class Slow(Examination):
        def __init__(self, gaussians: Gaussians):
            assert core.examining is None or core.examining.done, "one at a time"
            looked_through.append(len(gaussians))
            super().__init__(gaussians)

        def _run(self) -> None:
            time.sleep(0.2)
            super()._run()

    monkeypatch.setattr(changed_scene, "Examination", Slow)
    desk.apply(Select(by=Everything()))
    for _ in range(4):  # a copy each, of the copies before
        desk.apply(OPERATIONS["duplicate"]())
        for _ in range(3):
            continue_editing(core)
    assert len(core.scene.gaussians) == 200
    settle(core)
    assert looked_through == [80, 200]
    assert core.examination.gaussians is core.scene.gaussians


def test_bands_that_a_merged_file_brings_are_switched_on(
    core, open_scene, random_gaussians, tmp_path
) -> None:
    flat = random_gaussians(40, sh_degree=0)
    desk = open_scene(padded(flat, 3))
    assert core.settings.sh_degree == 0
    save_scene(random_gaussians(20, sh_degree=3, seed=1), tmp_path / "b.ply")
    desk.apply(Merge(path=str(tmp_path / "b.ply")))
    settle(core)
    assert core.settings.sh_degree is None
    assert core.scene.settings.sh_degree is None
    desk.undo()
    settle(core)
    assert core.settings.sh_degree == 0


def test_what_the_user_has_set_stays() -> None:
    before, after = RenderSettings(sh_degree=0), RenderSettings(early_stop=0.0)
    mine = replace(before, sh_degree=1, model=replace(before.model, antialiased=True))
    now = followed(mine, before, after)
    assert (now.sh_degree, now.early_stop, now.model.antialiased) == (1, 0.0, True)
    near = replace(before, model=replace(before.model, near=1.0))
    called_for = replace(after, model=replace(after.model, antialiased=True))
    assert followed(near, before, called_for).model == replace(called_for.model, near=1.0)


def test_files_are_added_to_an_edited_scene_as_steps(
    core, open_scene, random_gaussians, tmp_path, wait_for_loading
) -> None:
    desk = open_scene(random_gaussians(40))
    paths = [tmp_path / "b.ply", tmp_path / "c.ply"]
    for path, splats in zip(paths, (5, 6), strict=True):
        save_scene(random_gaussians(splats), path)
    desk.apply(Select(by=Everything()))
    add_files(core, paths)
    settle(core)
    assert core.desk is desk
    assert len(core.scene.gaussians) == 51
    assert len(desk.document.history.done) == 3
    desk.document.jump(0)
    settle(core)
    add_files(core, paths[:1])
    wait_for_loading(core)
    assert core.desk is not desk, "nothing is edited: opened afresh"
    assert len(core.scene.gaussians) == 45


def test_a_file_that_cannot_be_read_ends_adding(core, open_scene, random_gaussians, tmp_path) -> None:
    desk = open_scene(random_gaussians(40))
    desk.apply(Select(by=Everything()))
    save_scene(random_gaussians(5), tmp_path / "b.ply")
    add_files(core, [tmp_path / "b.ply", tmp_path / "none.ply", tmp_path / "b.ply"])
    settle(core)
    assert "none.ply" in core.problem
    assert len(core.scene.gaussians) == 45


# ---- where the splats are


def test_without_edits_the_bounds_are_those_of_the_scene(core, open_scene, random_gaussians) -> None:
    assert bounds(core) is None
    desk = open_scene(random_gaussians(400))
    opened = bounds(core)
    assert opened is not None
    np.testing.assert_allclose(opened[0], core.scene.centre, atol=1e-9)
    assert bounds(core, selected=True) is None
    desk.apply(Select(by=Everything()))
    desk.apply(OPERATIONS["delete"]())
    assert bounds(core) is None


def test_bounds_follow_what_is_moved_and_leave_out_what_is_deleted(
    core, open_scene, random_gaussians
) -> None:
    desk = open_scene(random_gaussians(400))
    before = bounds(core)
    means = core.scene.gaussians.means
    half = np.zeros(400, bool)
    half[:200] = True
    desk.apply(Select(by=IndexRuns.of(half)))
    desk.apply(Transform(translation=(100.0, 0.0, 0.0)))
    selected, everything = bounds(core, selected=True), bounds(core)
    assert before is not None and selected is not None and everything is not None
    expected = robust_bounds(means[:200].astype(np.float64) + np.array([100, 0, 0]))[0]
    np.testing.assert_allclose(selected[0], expected, atol=1e-4)
    assert everything[1] > 40, "both halves"
    desk.apply(OPERATIONS["delete"]())
    left = bounds(core)
    assert left is not None
    np.testing.assert_allclose(left[0], robust_bounds(means[200:])[0], atol=1e-4)


def test_framing_shows_the_selection_else_everything(core, open_scene, random_gaussians) -> None:
    desk = open_scene(random_gaussians(400))
    ACTIONS["frame_selection"](core)
    np.testing.assert_allclose(core.destination.target, core.scene.centre, atol=1e-9)
    desk.apply(Select(by=Everything()))
    desk.apply(Transform(translation=(0.0, 50.0, 0.0)))
    moved = core.scene.centre + np.array([0, 50, 0])
    for action in ("frame_selection", "frame_all"):
        ACTIONS[action](core)
        np.testing.assert_allclose(core.destination.target, moved, atol=1e-4)
    orient(core, (0.0, 0.0, 1.0))
    middle = bounds(core)
    assert middle is not None
    np.testing.assert_allclose(middle[0], moved, atol=0.3)
