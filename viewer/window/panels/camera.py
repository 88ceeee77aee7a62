"""Where the eye is and how it moves."""

from __future__ import annotations

from dataclasses import replace

from imgui_bundle import imgui

from .. import saving
from ..actions import (
    NAVIGATION_MODES,
    UP_NAMES,
    navigate,
    set_up,
    toggle_lenses,
    toggle_orthographic,
    up_name,
)
from ..core import Core
from ..navigation import AXIS_NAMES
from ..preferences import RANGES
from ..shortcuts import keys_of
from . import lens, widgets

NAVIGATION_NAMES = {"orbit": "Orbit", "fly": "Fly", "trackball": "Trackball"}


def show(core: Core) -> None:
    mode = widgets.combo(
        "Navigation",
        core.preferences.navigation,
        NAVIGATION_MODES,
        "Orbit turns about a point and keeps the horizon level. Fly looks around from where the eye is. "
        "Trackball turns the scene freely like a ball. W A S D E Q move in all of them.",
        [NAVIGATION_NAMES[m] for m in NAVIGATION_MODES],
    )
    if mode is not None:
        core.post(navigate, mode)
    up = up_name(core.view)
    choices = list(UP_NAMES) if up else [*UP_NAMES, "oblique"]
    chosen = widgets.combo(
        "Up",
        up or "oblique",
        choices,
        f"The axis that orbiting turns about. Trained scenes are mostly -Y up; {keys_of('next_up')} tries "
        f"the next, {keys_of('up_from_view')} takes what is up in the picture.",
    )
    if chosen is not None and chosen != "oblique":
        core.post(set_up, chosen)
    fov = widgets.slider(
        "Field of view",
        core.view.lens.fov_y,
        *RANGES["fov_y"],
        "Vertical angle of the picture in degrees. Small is a long lens.",
        form="%.0f°",
    )
    if fov is not None:
        core.prefer(fov_y=fov)
    rays(core)
    speeds(core)

    widgets.section("Look")
    axis_buttons(core)
    widgets.action_button(core, "Whole scene", "frame_all")
    imgui.same_line()
    widgets.action_button(core, "Level", "level")

    widgets.section("Position")
    position(core)
    widgets.action_button(core, "Copy", "copy_camera")
    imgui.same_line()
    widgets.action_button(core, "Paste", "paste_camera")
    imgui.same_line()
    widgets.button(
        "Save...", "Writes the camera as JSON, for `splatview render --camera`.", lambda: ask_where(core)
    )
    imgui.same_line()
    widgets.action_button(core, "Load...", "open_cameras")

    widgets.section("Lens")
    lens.show(core)


def rays(core: Core) -> None:
    parallel = widgets.checkbox(
        "Orthographic",
        core.destination.lens.orthographic,
        f"Parallel rays: equal lengths look equal however far away ({keys_of('toggle_orthographic')}). "
        "The wheel changes the scale.",
    )
    if parallel is not None:
        core.post(toggle_orthographic)
    if any(camera.lens is not None for camera in core.cameras):
        through = widgets.checkbox(
            "Camera lenses",
            core.through_lenses,
            f"Shows the views of loaded cameras through their lenses ({keys_of('toggle_lenses')}).",
        )
        if through is not None:
            core.post(toggle_lenses)


def speeds(core: Core) -> None:
    preferences = core.preferences
    speed = widgets.slider(
        "Flying speed",
        preferences.fly_speed,
        *RANGES["fly_speed"],
        "Factor on a speed that suits the scene's size. The wheel changes it while flying; "
        "Shift is four times as fast, Alt four times as slow.",
        form="%.2f x",
        logarithmic=True,
    )
    if speed is not None:
        core.prefer(fly_speed=speed)
    turning = widgets.slider(
        "Mouse speed",
        preferences.mouse_speed,
        *RANGES["mouse_speed"],
        "How far a drag turns.",
        form="%.2f x",
        logarithmic=True,
    )
    if turning is not None:
        core.prefer(mouse_speed=turning)
    smooth = widgets.checkbox(
        "Smooth jumps", preferences.smooth, "Shows the way from one view to the next, so you stay oriented."
    )
    if smooth is not None:
        core.prefer(smooth=smooth)
    inverted = widgets.checkbox(
        "Invert wheel", preferences.invert_wheel, "Turning the wheel towards you then comes nearer."
    )
    if inverted is not None:
        core.prefer(invert_wheel=inverted)


def axis_buttons(core: Core) -> None:
    spacing = imgui.get_style().item_spacing.x
    width = (imgui.get_content_region_avail().x - 5 * spacing) / 6
    for i, name in enumerate(AXIS_NAMES):
        if i:
            imgui.same_line()
        widgets.action_button(core, name, f"look_from_{name}", width=width)


def position(core: Core) -> None:
    view = core.view
    for name, value, tip in (
        ("Eye", view.eye, "Where the eye is, world units."),
        ("Target", view.target, "The point that orbiting turns about: double-click a surface to move it."),
    ):
        widgets.label(name, tip)
        changed, typed = imgui.input_float3(
            f"##{name}", [float(v) for v in value], "%.4g", imgui.InputTextFlags_.enter_returns_true
        )
        widgets.tooltip(f"{tip} Type new coordinates and press Enter: the view is moved, not turned.")
        if changed:
            moved = view.target + (typed - value)
            core.go_to(replace(view, target=moved))
    widgets.fact("Distance", f"{view.distance:.5g}", "From the eye to the target, world units.")


def ask_where(core: Core) -> None:
    core.choose_files(
        "Save the camera",
        lambda paths: core.post(saving.save_current_camera, paths[0]),
        kind="save_camera",
        name=f"{saving.picture_stem(core)}.camera.json",
    )
