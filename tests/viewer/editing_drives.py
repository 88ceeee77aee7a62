"""Cleaning up a scene in a real window; run by `conftest.drive` like the functions of `drives`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import drives
import numpy as np
from drives import Hand, pose
from imgui_bundle import ImVec2, imgui

from splatview.scene.edits import SELECTED, bake
from splatview.viewer.editing import files, saving
from splatview.viewer.editing.files import Restoring
from splatview.viewer.editing.gizmos import angles_of, guizmo
from splatview.viewer.editing.session import Editing, session_of
from splatview.viewer.editing.transform import pivot
from splatview.viewer.state import AppState


def open_section(hand: Hand, title: str) -> None:
    """Of the Edit page, which shuts the others."""
    hand.page("Edit")
    hand.ctx.item_open(title)
    hand.frames(3)


def settle(hand: Hand) -> None:
    hand.settle()
    hand.wait(lambda: (session := session_of(hand.app)) is not None and session.job is None, "the job")
    hand.frames(2)
    session = session_of(hand.app)
    assert session is not None
    hand.wait(lambda: session.loaded in (None, session.gaussians), "the changed scene")


def counts(app: AppState) -> dict[str, int]:
    session = session_of(app)
    assert session is not None
    now = session.document.counts
    return {"selected": now.selected, "deleted": now.deleted, "kept": now.kept}


def clean_up(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Box-select, add with the brush, delete, undo, crop by numbers, prune with preview, export, reopen."""
    settle(hand)
    app.prefer(smooth=False)
    session = session_of(app)
    assert session is not None
    found["before"] = counts(app)
    seen = hand.picture()

    hand.press("R")
    hand.drag(110, 90, over=(0.35, 0.35))
    settle(hand)
    found["box"] = counts(app)
    marks = session.document.marks.copy()
    hand.press("C")
    hand.point(0.62, 0.62)
    hand.ctx.key_down(imgui.Key.mod_shift)
    hand.drag(60, 20, over=(0.62, 0.62))
    hand.ctx.key_up(imgui.Key.mod_shift)
    settle(hand)
    found["brush"] = counts(app)
    found["brush_kept_the_box"] = bool(
        ((session.document.marks & marks & SELECTED) == (marks & SELECTED)).all()
    )
    hand.press("Escape")

    hand.press("Delete")
    settle(hand)
    found["deleted"] = counts(app)
    found["change_by_deleting"] = float(np.abs(hand.picture_of_edits() - seen).max())
    hand.press("Ctrl+Z")
    settle(hand)
    found["undone"] = counts(app)
    found["change_after_undo"] = float(np.abs(hand.picture_of_edits() - seen).max())
    hand.press("Ctrl+Y")
    settle(hand)

    open_section(hand, "Crop")
    hand.ctx.item_click("Crop/Add box")
    settle(hand)
    box = session.document.crops[0]
    for number, value in enumerate(options["half_extents"]):
        hand.ctx.item_input_value(f"Crop/##Half size/$${number}", float(value))
        hand.frames(2)
    settle(hand)
    found["crop"] = list(session.document.crops[0].half_extents)
    found["crop_steps"] = session.document.history.position
    found["crop_moved"] = session.document.crops[0].centre != box.centre
    found["exported_after_crop"] = len(bake(session.document.gaussians, session.document.edits, hidden=True))

    open_section(hand, "Clean up")
    hand.ctx.item_click("Clean up/detectors/###clusters")
    settle(hand)
    hand.ctx.item_input_value("Clean up/##Threshold", float(options["threshold"]))
    settle(hand)
    found["floaters"] = session.forms.clean.count
    found["lit_up"] = session.preview_mask is not None
    if session.forms.clean.price is None:  # else measured already
        hand.ctx.item_click("Clean up/What would it cost?")
        settle(hand)
    cost = session.forms.clean.price
    found["price"] = None if cost is None else [cost.mean, cost.worst, cost.count]
    hand.shoot(options.get("panel"))
    hand.ctx.item_click(f"Clean up/Delete {session.forms.clean.count:,}")
    settle(hand)
    found["pruned"] = counts(app)
    found["titles"] = [step.title for step in session.document.history.done]

    out, recipe = Path(options["out"]), Path(options["recipe"])
    hand.on_gl_thread(lambda: saving.write(app, out))
    settle(hand)
    hand.on_gl_thread(lambda: files.save_recipe_to(app, recipe))
    found["journal_left"] = len(list(Path(options["journals"]).glob("*")))
    hand.drop(str(out))
    hand.wait(lambda: session_of(app) not in (None, session), "the saved scene to open")
    settle(hand)
    found["reopened"] = counts(app)


def leave_edits(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Deletes something and closes the window without exporting."""
    settle(hand)
    hand.press("R")
    hand.drag(120, 100, over=(0.4, 0.4))
    settle(hand)
    hand.press("Delete")
    settle(hand)
    found["deleted"] = counts(app)


def restore_edits(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Takes the offer to go on with them."""
    settle(hand)
    found["offered"] = app.dialog
    hand.ctx.set_ref("//Unsaved edits")
    hand.ctx.item_click("**/Restore")
    hand.wait(
        lambda: app.feature(Restoring).journal is None and app.loading is None, "the scene to come back"
    )
    settle(hand)
    hand.wait(
        lambda: (session := session_of(app)) is not None and session.document.history.position > 0,
        "the steps",
    )
    found["restored"] = counts(app)


def by_words(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """The palette finds commands; sliders preview, apply and cancel."""
    settle(hand)
    session = session_of(app)
    assert session is not None
    hand.press("Ctrl+P")
    hand.frames(3)
    hand.ctx.key_chars("select all")
    hand.frames(3)
    hand.ctx.key_press(imgui.Key.enter)
    settle(hand)
    found["selected"] = counts(app)["selected"]
    found["palette_shut"] = app.dialog is None

    open_section(hand, "Colour & opacity")
    seen = hand.picture_of_edits()
    hand.ctx.item_input_value("Colour & opacity/##Brightness", 0.25)
    settle(hand)
    found["previewed"] = session.document.previewed is not None
    found["brighter"] = float((hand.picture_of_edits() - seen)[..., :3].mean())
    hand.ctx.item_click("Colour & opacity/Cancel##look")
    settle(hand)
    found["cancelled"] = float(np.abs(hand.picture_of_edits() - seen).max())
    hand.ctx.item_input_value("Colour & opacity/##Saturation", 0.0)
    settle(hand)
    hand.ctx.item_click("Colour & opacity/Apply##look")
    settle(hand)
    grey = hand.picture_of_edits()[..., :3]
    found["colourfulness"] = float((grey.max(axis=-1) - grey.min(axis=-1)).max())

    session.forms.how = "set"
    hand.frames(2)
    hand.ctx.item_input_value("Colour & opacity/##Opacity", 0.25)
    settle(hand)
    hand.ctx.item_click("Colour & opacity/Apply##look")
    settle(hand)
    found["opacity_row"] = list(session.document.palette[-1].opacity)
    hand.press("Ctrl+Z")
    settle(hand)

    open_section(hand, "Transform")
    hand.ctx.item_input_value("Transform/##Rotation/$$1", 30.0)
    settle(hand)
    hand.ctx.item_click("Transform/Apply##Transform")
    settle(hand)
    rotation = session.document.palette[-1].rotation
    found["turned"] = [round(float(v), 6) for v in rotation]
    found["history"] = [step.title for step in session.document.history.done]

    hand.press("Ctrl+Z")
    hand.press("Ctrl+Z")
    settle(hand)
    found["back"] = float(np.abs(hand.picture_of_edits() - seen).max())


def health(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """The Health report: prices of repairs, a repair, its undo, and a click that selects."""
    settle(hand)
    session = session_of(app)
    assert session is not None
    hand.wait(lambda: app.examination is not None and app.examination.done, "the health check")
    hand.page("Scene")
    hand.frames(3)
    seen = hand.picture_of_edits()
    hand.ctx.item_click("**/What would repairs cost?")
    settle(hand)
    found["prices"] = {name: [price.mean, price.worst] for name, price in session.forms.health.prices.items()}
    found["untouched"] = session.document.history.position == 0
    hand.frames(3)
    hand.shoot(options.get("panel"))
    hand.frames(3)
    hand.ctx.item_click("**/Repair##rods")
    settle(hand)
    found["titles"] = [step.title for step in session.document.history.done]
    found["changed"] = float(np.abs(hand.picture_of_edits() - seen).max())
    hand.wait(lambda: app.feature(Editing).examining is None, "the health of the repaired scene")
    assert app.examination is not None
    found["left"] = {finding.name: finding.count for finding in app.examination.findings}
    hand.press("Ctrl+Z")
    settle(hand)
    hand.wait(lambda: app.feature(Editing).examining is None, "the health of the scene as it was")
    hand.frames(2)
    found["undone"] = float(np.abs(hand.picture_of_edits() - seen).max())
    hand.page("Scene")
    hand.ctx.item_click("**/Select##rods")
    settle(hand)
    found["selected"] = counts(app)["selected"]


def find_handle(hand: Hand, kind: str) -> tuple[float, float]:
    """Points at the handle that ImGuizmo calls `kind`, which lies somewhere about what is to be moved: in
    which direction on the screen (a unit vector)."""
    view, camera, session = hand.ctx.window_info("//View").rect_full, hand.app.camera, session_of(hand.app)
    assert session is not None
    in_hand = (
        session.document.crops[session.forms.crop].centre if session.handles == "Crop" else pivot(session)
    )
    x, y, z = camera.world_to_camera[:3] @ (*in_hand, 1.0)
    middle = view.min + (view.max - view.min) * ImVec2(
        float(camera.fx * x / z + camera.cx) / camera.width,
        float(camera.fy * y / z + camera.cy) / camera.height,
    )
    for direction in np.linspace(0, 2 * np.pi, 16, endpoint=False):
        for radius in range(32, 120, 8):
            right, down = float(np.cos(direction)), float(np.sin(direction))
            hand.ctx.mouse_teleport_to_pos(middle + ImVec2(radius * right, radius * down))
            hand.frames(2)
            if guizmo.is_over() and guizmo.get_hovered_handle_type().name == kind:
                return right, down
    raise AssertionError(f"no handle {kind} about {middle}")


def drag_handle(hand: Hand, kind: str) -> None:
    """Those that scale outwards."""
    right, down = find_handle(hand, kind)
    hand.frames(3)
    to = ImVec2(20 * right, 20 * down) if "scale" in kind else ImVec2(35, -25)
    hand.ctx.mouse_drag_with_delta(to, 0)
    settle(hand)


def by_handles(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Moves and turns by the handles on the picture, then moves a crop; what else the mouse does stays."""
    settle(hand)
    app.prefer(smooth=False)
    session = session_of(app)
    assert session is not None

    def done() -> Any:
        """The transform that the last drag was."""
        return session.document.history.done[-1].operation

    hand.press("Ctrl+A")
    settle(hand)
    found["camera"] = [pose(app)]
    hand.ctx.item_click("//View/tool Move")
    drag_handle(hand, "mt_move_x")
    found["moved"] = done().translation
    hand.shoot(options.get("panel"))
    hand.press("Shift+2")
    drag_handle(hand, "mt_rotate_y")
    found["turned"] = angles_of(done().rotation)
    hand.press("Shift+3")
    drag_handle(hand, "mt_scale_x")
    found["scaled"] = done().scale
    hand.press("Escape")

    open_section(hand, "Crop")
    hand.ctx.item_click("Crop/Add box")
    settle(hand)
    start = session.document.crops[0].centre
    drag_handle(hand, "mt_move_x")
    found["crop_moved"] = np.subtract(session.document.crops[0].centre, start).tolist()
    found["camera"].append(pose(app))
    found["history"] = [step.title for step in session.document.history.done]

    find_handle(hand, "mt_move_x")
    hand.ctx.mouse_drag_with_delta(ImVec2(-35, 25), 1)
    hand.frames(3)
    found["camera"].append(pose(app))
    find_handle(hand, "mt_move_x")
    hand.ctx.mouse_wheel_y(1)
    hand.frames(3)
    found["camera"].append(pose(app))
    hand.drag(300, 0, over=(0.2, 0.5))
    found["camera"].append(pose(app))
    found["steps"] = session.document.history.position


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
