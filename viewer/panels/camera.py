"""Sections on the camera: navigation, position, lens, bookmarks, camera lists."""

from __future__ import annotations

import math
from dataclasses import replace

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from splatview.scene.errors import printable
from splatview.viewer import save as saving
from splatview.viewer.camera import (
    UP_NAMES,
    delete_bookmark,
    go_to_bookmark,
    go_to_camera,
    rename_bookmark,
    set_up,
    toggle_lenses,
    toggle_orthographic,
    up_name,
)
from splatview.viewer.commands import NAVIGATION_MODES, keys_of, navigate
from splatview.viewer.depth_of_field import DepthOfField, focus_by_click, is_pinhole
from splatview.viewer.navigation import AXIS_NAMES
from splatview.viewer.panels import widgets
from splatview.viewer.preferences import RANGES
from splatview.viewer.state import AppState

APERTURES = (0.001, 0.5)
"""Range of the aperture's slider, in distances to the turning point."""

FOCUS_RANGE = (0.02, 50.0)
"""Range of the focus slider, in distances to the turning point."""


def show_lens(app: AppState) -> None:
    lens = app.feature(DepthOfField)
    on = widgets.checkbox(
        "Depth of field",
        lens.on,
        "Blurs what is not in focus, as a lens does, while the view rests.",
    )
    if on is not None:
        lens.on = on
    if not lens.on:
        return
    share = widgets.slider(
        "Aperture",
        lens.share,
        *APERTURES,
        "The lens's diameter over the distance to the point that the view turns about: wider blurs more.",
        form="%.3f",
        logarithmic=True,
    )
    if share is not None:
        lens.share = share
    focus = widgets.slider(
        "Focus",
        lens.focus or app.view.distance,
        FOCUS_RANGE[0] * app.view.distance,
        FOCUS_RANGE[1] * app.view.distance,
        "The distance that is sharp, world units.",
        form="%.4g",
        logarithmic=True,
    )
    if focus is not None:
        lens.focus = focus
    widgets.button(
        "Focus by click",
        "What you click on in the picture next becomes sharp.",
        lambda: app.post(focus_by_click),
    )
    widgets.beside("On turning point")
    widgets.button(
        "On turning point", "Keeps sharp what the view turns about.", lambda: setattr(lens, "focus", None)
    )
    if lens.picking:
        widgets.note("Click what shall be sharp.")
    elif not is_pinhole(app.camera):
        widgets.note("Only pinhole cameras have one: not through a lens that distorts, nor orthographic.")
    elif lens.badge:
        widgets.note(lens.badge)
    imgui.spacing()


NAVIGATION_NAMES = {"orbit": "Orbit", "fly": "Fly", "trackball": "Trackball"}


def show(app: AppState) -> None:
    mode = widgets.combo(
        "Navigation",
        app.preferences.navigation,
        NAVIGATION_MODES,
        "How drags move the eye: about a point with the horizon level (orbit), from where it is (fly), "
        "or turning the scene like a ball (trackball).",
        [NAVIGATION_NAMES[m] for m in NAVIGATION_MODES],
    )
    if mode is not None:
        app.post(navigate, mode)
    up = up_name(app.view)
    choices = list(UP_NAMES) if up else [*UP_NAMES, "oblique"]
    chosen = widgets.combo(
        "Up",
        up or "oblique",
        choices,
        f"The axis that orbiting turns about, mostly -Y; {keys_of('next_up')} tries the next, "
        f"{keys_of('up_from_view')} takes what is up in the picture.",
    )
    if chosen is not None and chosen != "oblique":
        app.post(set_up, chosen)
    fov = widgets.slider(
        "Field of view",
        app.view.lens.fov_y,
        *RANGES["fov_y"],
        "Vertical angle of the picture in degrees; small is a long lens.",
        form="%.0f°",
    )
    if fov is not None:
        app.prefer(fov_y=fov)
    rays(app)
    axis_buttons(app)
    widgets.command_button(app, "Whole scene", "frame_all")
    imgui.same_line()
    widgets.command_button(app, "Level", "level")

    position(app)
    widgets.command_button(app, "Copy", "copy_camera")
    widgets.beside("Paste")
    widgets.command_button(app, "Paste", "paste_camera")
    widgets.beside("Save...")
    widgets.button(
        "Save...", "Writes the camera as JSON, for `splatview render --camera`.", lambda: ask_where(app)
    )
    widgets.beside("Load...")
    widgets.command_button(app, "Load...", "open_cameras")


def rays(app: AppState) -> None:
    parallel = widgets.checkbox(
        "Orthographic",
        app.destination.lens.orthographic,
        "Shows equal lengths as equal, however far away, by parallel rays "
        f"({keys_of('toggle_orthographic')}).",
    )
    if parallel is not None:
        app.post(toggle_orthographic)
    if any(camera.lens is not None for camera in app.cameras):
        through = widgets.checkbox(
            "Camera lenses",
            app.through_lenses,
            f"Shows the views of loaded cameras through their lenses ({keys_of('toggle_lenses')}).",
        )
        if through is not None:
            app.post(toggle_lenses)


def speeds(app: AppState) -> None:
    preferences = app.preferences
    speed = widgets.slider(
        "Flying speed",
        preferences.fly_speed,
        *RANGES["fly_speed"],
        "Factor on a speed that suits the scene's size; the wheel changes it while flying.",
        form="%.2f x",
        logarithmic=True,
    )
    if speed is not None:
        app.prefer(fly_speed=speed)
    turning = widgets.slider(
        "Mouse speed",
        preferences.mouse_speed,
        *RANGES["mouse_speed"],
        "How far a drag turns.",
        form="%.2f x",
        logarithmic=True,
    )
    if turning is not None:
        app.prefer(mouse_speed=turning)
    smooth = widgets.checkbox(
        "Smooth jumps", preferences.smooth, "Shows the way from one view to the next, so you stay oriented."
    )
    if smooth is not None:
        app.prefer(smooth=smooth)
    inverted = widgets.checkbox(
        "Invert wheel", preferences.invert_wheel, "Turning the wheel towards you then comes nearer."
    )
    if inverted is not None:
        app.prefer(invert_wheel=inverted)


def axis_buttons(app: AppState) -> None:
    spacing = imgui.get_style().item_spacing.x
    width = (imgui.get_content_region_avail().x - 5 * spacing) / 6
    for i, name in enumerate(AXIS_NAMES):
        if i:
            imgui.same_line()
        widgets.command_button(app, name, f"look_from_{name}", width=width)


def position(app: AppState) -> None:
    view = app.view
    # To a thousandth of what is looked at: more digits would not fit their fields.
    decimals = min(max(math.ceil(3 - math.log10(view.distance)), 0), 6)
    form = f"%.{decimals}f"
    for name, value, tip in (
        ("Eye", view.eye, "Where the eye is, world units."),
        ("Target", view.target, "The point that orbiting turns about: double-click a surface to move it."),
    ):
        widgets.label(name, tip, share=widgets.VECTOR_LABEL_SHARE)
        changed, typed = imgui.input_float3(
            f"##{name}", [float(v) for v in value], form, imgui.InputTextFlags_.enter_returns_true
        )
        widgets.tooltip(f"{tip[:-1]}; new coordinates and Enter move the view without turning it.")
        if changed:
            moved = view.target + (typed - value)
            app.go_to(replace(view, target=moved))
    widgets.fact("Distance", f"{view.distance:.5g}", "From the eye to the target, world units.")


def ask_where(app: AppState) -> None:
    app.choose_files(
        "Save the camera",
        lambda paths: app.post(saving.save_current_camera, paths[0]),
        kind="save_camera",
        name=f"{saving.picture_stem(app)}.camera.json",
    )


def show_bookmarks(app: AppState) -> None:
    imgui.push_id("bookmarks")
    widgets.command_button(app, "Bookmark this view", "add_bookmark")
    if not app.bookmarks:
        widgets.note(f"None yet. {keys_of('add_bookmark')} keeps the present view, beside the scene's file.")
    for index, bookmark in enumerate(app.bookmarks):
        bookmark_row(app, index, bookmark.name)
    imgui.pop_id()


def show_cameras(app: AppState) -> None:
    """The loaded cameras."""
    imgui.push_id("cameras")
    if app.cameras:
        cameras(app)
    else:
        widgets.note("A cameras.json, a COLMAP model or a saved camera: drop it on the window, or")
        widgets.command_button(app, "Load...", "open_cameras")
    imgui.pop_id()


def bookmark_row(app: AppState, index: int, name: str) -> None:
    imgui.push_id(index)
    style = imgui.get_style()
    signs = (icons.ICON_FA_PEN, icons.ICON_FA_TRASH)
    buttons = sum(
        imgui.calc_text_size(sign).x + 2 * style.frame_padding.x + style.item_spacing.x for sign in signs
    )
    width = max(imgui.get_content_region_avail().x - buttons, imgui.get_font_size())
    if imgui.selectable(widgets.item(name, index), index == app.bookmark_index, 0, (width, 0))[0]:
        app.post(go_to_bookmark, index)
    widgets.tooltip("Go to this view")
    imgui.same_line()
    if imgui.small_button(icons.ICON_FA_PEN):
        imgui.open_popup("rename")
    widgets.tooltip("Rename")
    imgui.same_line()
    if imgui.small_button(icons.ICON_FA_TRASH):
        app.post(delete_bookmark, index)
    widgets.tooltip("Delete this bookmark")
    if imgui.begin_popup("rename"):
        if imgui.is_window_appearing():
            imgui.set_keyboard_focus_here()
        imgui.set_next_item_width(imgui.get_font_size() * 14)
        done, text = imgui.input_text("##name", printable(name), imgui.InputTextFlags_.enter_returns_true)
        if done:
            app.post(rename_bookmark, index, text)
            imgui.close_current_popup()
        imgui.end_popup()
    imgui.pop_id()


def cameras(app: AppState) -> None:
    widgets.command_button(app, "Previous", "previous_camera")
    imgui.same_line()
    widgets.command_button(app, "Next", "next_camera")
    imgui.same_line()
    changed, shown = imgui.checkbox("In the view", app.preferences.show_cameras)
    widgets.tooltip("Draws each camera as a small pyramid that opens the way it looks.")
    if changed:
        app.prefer(show_cameras=shown)
    clipper = imgui.ListClipper()
    clipper.begin(len(app.cameras))
    while clipper.step():
        for index in range(clipper.display_start, clipper.display_end):
            camera = app.cameras[index]
            text = widgets.item(camera.name or f"Camera {index + 1}", index)
            if imgui.selectable(text, index == app.camera_index)[0]:
                app.post(go_to_camera, index)
            widgets.tooltip(f"{camera.width} x {camera.height} px")
