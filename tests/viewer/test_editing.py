"""The editing half of the window without a display: strokes, jobs, previews, words, turns."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatview.edit.document import Document
from splatview.edit.operations import OPERATIONS, Select
from splatview.edit.operations.appearance import Opacity
from splatview.edit.operations.crop import RemoveCrop
from splatview.edit.operations.transform import Transform
from splatview.edit.selectors import Brush, Everything, Polygon, Rectangle
from splatview.scene import InputError, look_at
from splatview.scene.edits import PALETTE_SHIFT, PREVIEW, SELECTED, Adjustment, Crop
from splatview.scene.progress import NO_PROGRESS, Progress
from splatview.viewer.commands import COMMANDS
from splatview.viewer.editing.gizmos import angles_of, quat_from_matrix, quat_of
from splatview.viewer.editing.session import Editing, EditSession
from splatview.viewer.editing.tool_state import Stroke, mode_of
from splatview.viewer.editing.tools import place_of
from splatview.viewer.palette import matching
from splatview.viewer.panels import select
from splatview.viewer.panels.crops import outline

CAMERA = look_at((0, 0, -4), (0, 0, 0), up=(0, -1, 0), width=200, height=100)


@pytest.fixture
def session(random_gaussians) -> EditSession:
    return EditSession(document=Document(random_gaussians(300)))


def finish(session: EditSession) -> None:
    limit = time.monotonic() + 200
    while session.job is not None:
        assert time.monotonic() < limit, "the job does not end"
        session.advance()
        time.sleep(0.001)


def stroke(tool, *points) -> Stroke:
    made = Stroke(tool=tool, mode="set", radius=5)
    for point in points:
        made.corner(*point) if tool == "polygon" else made.to(*point)
    return made


# ---- strokes


def test_a_drag_becomes_a_rectangle_of_its_ends():
    operation = stroke("rectangle", (10, 20), (50, 5), (90, 80)).operation(CAMERA, "front")
    assert operation is not None
    assert isinstance(operation.by, Rectangle)
    corners = (operation.by.x0, operation.by.y0, operation.by.x1, operation.by.y1)
    assert (*corners, operation.by.depth) == (10, 20, 90, 80, "front")


@pytest.mark.parametrize("tool", ["rectangle", "lasso"])
def test_a_click_with_a_tool_that_is_dragged_selects_nothing(tool):
    assert stroke(tool, (10, 20), (11, 20)).operation(CAMERA, "through") is None


def test_a_click_with_the_brush_paints_a_spot():
    operation = stroke("brush", (10, 20)).operation(CAMERA, "through")
    assert operation is not None
    assert isinstance(operation.by, Brush)
    assert (operation.by.points, operation.by.radius) == (((10, 20),), 5)


def test_a_slow_hand_adds_no_points_to_a_path():
    path = stroke("brush", (10, 20), (10.5, 20), (11, 20), (13, 20))
    assert path.points == [(10, 20), (13, 20)]


def test_a_polygon_closes_at_its_first_corner():
    outline = stroke("polygon", (10, 10), (90, 10), (50, 80))
    assert not outline.corner(40, 60)
    assert outline.corner(12, 11)
    operation = outline.operation(CAMERA, "through")
    assert operation is not None
    assert isinstance(operation.by, Polygon)
    assert operation.by.points == ((10, 10), (90, 10), (50, 80), (40, 60))
    assert stroke("polygon", (10, 10), (90, 10)).operation(CAMERA, "through") is None


def test_keys_say_what_becomes_of_the_selection():
    modes = [mode_of(shift=shift, ctrl=ctrl) for shift in (False, True) for ctrl in (False, True)]
    assert modes == ["set", "remove", "add", "intersect"]


# ---- the desk


def test_edits_are_told_of_and_mistakes_too(session):
    assert session.apply(OPERATIONS["select_all"]())
    assert session.news is not None and "300" in session.news
    assert session.apply(OPERATIONS["delete"]())
    assert session.document.counts.deleted == 300
    session.undo()
    assert session.document.counts.selected == 300
    session.redo()
    session.redo()
    assert session.news == "Nothing to redo"
    assert not session.apply(RemoveCrop(index=3))
    assert session.problem is not None and "0 crops" in session.problem


def test_what_has_no_memory_is_refused_and_final_steps_are_told_of(random_gaussians):
    session = EditSession(document=Document(random_gaussians(300), budget=20_000))
    assert session.apply(OPERATIONS["select_all"]())
    assert not session.apply(OPERATIONS["duplicate"]())
    assert session.problem is not None and "editing has 20 KiB left" in session.problem
    assert len(session.gaussians) == 300
    session.document.budget = 10
    session.apply(OPERATIONS["hide"]())
    session.advance()
    assert session.news == "Hide 300 splats; undo has used up its memory: the oldest steps (1) are final now"
    session.jump(0)
    assert session.problem == "the oldest steps (1) can no longer be undone"
    session.news = None
    session.advance()
    assert session.news is None


def test_slow_work_runs_aside_and_nothing_changes_beneath_it(session):
    go_on = threading.Event()

    def work(progress: Progress) -> int:
        progress.step(0.5)
        go_on.wait(200)
        return 7

    results: list[int] = []
    session.start("Counting", work, results.append)
    assert session.job is not None
    session.undo()
    assert session.problem is not None and "Counting" in session.problem
    assert not session.apply(OPERATIONS["select_all"]())
    go_on.set()
    finish(session)
    assert results == [7]
    assert session.document.counts.selected == 0


def test_slow_operations_are_applied_when_they_are_planned(session):
    session.apply_slowly(Select(by=Everything()), "Selecting")
    finish(session)
    assert session.document.counts.selected == 300


def test_a_cancelled_job_changes_nothing(session):
    started = threading.Event()

    def work(progress: Progress) -> None:
        started.set()
        while True:
            progress.step(0.1)
            time.sleep(0.001)

    session.start("Waiting", work, lambda _: pytest.fail("it was cancelled"))
    started.wait(200)
    assert session.job is not None
    session.job.cancel()
    finish(session)
    assert session.news is not None and "cancelled" in session.news


@pytest.mark.parametrize("yields", ["no", "silently"])
def test_escape_ends_what_nobody_asked_for_after_what_the_user_began(app, session, yields):
    def work(progress: Progress) -> None:
        while True:
            progress.step(0.1)
            time.sleep(0.001)

    editing = app.feature(Editing)
    editing.session = session
    session.take_tool("rectangle")
    session.start("Waiting", work, lambda _: pytest.fail("it was cancelled"), yields=yields)
    job = session.job
    assert editing.cancel(app) and job is not None
    assert (job.cancelled, session.tool) == ((True, "rectangle") if yields == "no" else (False, "none"))
    if job.cancelled:
        finish(session)
    assert editing.cancel(app)
    assert job.cancelled and session.tool == "none"
    finish(session)
    assert not editing.cancel(app), "nothing is left to end"


@pytest.mark.parametrize(
    ("error", "words"), [(InputError("no such file"), "no such file"), (KeyError("x"), "inside the program")]
)
def test_a_failing_job_is_told_of(session, error, words):
    def work(progress: Progress) -> None:
        raise error

    session.start("Trying", work, lambda _: pytest.fail("it failed"))
    finish(session)
    assert session.problem is not None and words in session.problem


def test_a_preview_is_no_step_until_it_is_kept(session):
    session.preview("look", Opacity(value=0.5, scope="scene"))
    assert session.edits.adjusts and session.forms.previewing == "look"
    assert session.document.history.position == 0
    session.cancel_preview()
    assert session.document.history.position == 0 and session.forms.previewing == ""
    session.preview("look", Opacity(value=0.5, scope="scene"))
    session.commit_preview()
    assert [step.title for step in session.document.history.done] == ["Opacity x 0.5: 300 splats"]


def test_an_undone_preview_leaves_no_buttons_and_the_tint_is_back(session):
    session.apply(OPERATIONS["select_all"]())
    session.preview("look", Opacity(value=0.5))
    assert not session.highlight.flags & SELECTED
    session.undo()
    session.advance()
    assert session.forms.previewing == "" and session.highlight.flags & SELECTED


def test_a_highlight_is_shown_until_the_next_edit_and_is_no_edit(session):
    mask = np.arange(300) < 7
    before = session.document.marks.copy()
    session.preview_mask = mask
    lit = session.edits
    assert np.count_nonzero(lit.marks & PREVIEW) == 7
    assert lit is session.edits, "made once"
    np.testing.assert_array_equal(session.document.marks, before)
    session.apply(OPERATIONS["select_all"]())
    assert not (session.edits.marks & PREVIEW).any()
    assert session.preview_mask is None


def test_a_picked_splat_is_where_its_adjustment_put_it(session):
    session.apply(Transform(scope="scene", translation=(1, 2, 3)))
    expected = session.gaussians.means[4] + (1, 2, 3)
    np.testing.assert_allclose(place_of(session.gaussians, session.edits, 4), expected, rtol=1e-6)


# ---- words and turns


def test_commands_are_found_by_their_words_and_keys():
    assert matching("brush")[0].id == "tool_brush"
    assert matching("invert sel")[0].id == "select_inverse"
    assert matching("ctrl+z")[0].id == "undo"
    assert matching("undo")[0].id == "undo"
    assert {command.id for command in matching("")} == set(COMMANDS)
    assert not matching("no such thing at all")
    assert [command.id for command in matching("floater")] == ["find_clusters", "section_clean"]
    assert not matching("fltr"), "letters with others between them are no word"
    assert matching("lenses")[0].id == "toggle_lenses"
    assert matching("add box")[0].id == "add_box"
    assert matching("reset lay")[0].id == "reset_panels"


degrees = st.floats(-179, 179)


@given(degrees, st.floats(-89, 89), degrees)
def test_angles_come_back(x, y, z):
    np.testing.assert_allclose(angles_of(quat_of((x, y, z))), (x, y, z), atol=1e-6)


@given(degrees, degrees, degrees)
def test_quaternions_of_matrices_turn_alike(x, y, z):
    R = Adjustment(rotation=quat_of((x, y, z))).R
    np.testing.assert_allclose(Adjustment(rotation=quat_from_matrix(R)).R, R, atol=1e-12)


def test_straight_up_is_an_angle_too():
    quat = quat_of((30, 90, 0))
    np.testing.assert_allclose(
        Adjustment(rotation=quat_of(angles_of(quat))).R, Adjustment(rotation=quat).R, atol=1e-6
    )


def test_outlines_lie_on_the_crops_surface():
    box = Crop(centre=(1, 2, 3), half_extents=(1, 2, 0.5), rotation=quat_of((20, 30, 40)))
    edges = np.concatenate(outline(box))
    assert len(outline(box)) == 12
    unit = box.unit_from_world
    own = edges @ unit[:, :3].T + unit[:, 3]
    np.testing.assert_allclose(np.abs(own), 1, atol=1e-9)
    ball = Crop(shape="sphere", centre=(1, 2, 3), half_extents=(1, 2, 0.5))
    unit = ball.unit_from_world
    own = np.concatenate(outline(ball)) @ unit[:, :3].T + unit[:, 3]
    np.testing.assert_allclose(np.linalg.norm(own, axis=1), 1, atol=1e-9)


def test_a_histogram_under_way_is_of_the_edits_that_it_began_with(session, monkeypatch):
    works, seen = [], []
    monkeypatch.setattr(session, "start", lambda title, work, done, **_: works.append(work))
    monkeypatch.setattr(
        select,
        "attribute_values",
        lambda name, gaussians, edits, tools: seen.append(edits) or np.zeros(len(gaussians), np.float32),
    )
    select.measure(session)
    assert session.apply(Opacity(value=0.5, scope="scene"))  # the job gives way, and is not waited for
    works[0](NO_PROGRESS)
    assert (session.document.marks >> PALETTE_SHIFT).max() == 1
    assert (seen[0].marks >> PALETTE_SHIFT).max() < len(seen[0].palette) == 1
