"""Aids over the picture: ground grid, axes, centres and outlines of splats, the legend of a visual mode."""

from __future__ import annotations

import moderngl
import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from splatview.edit.operations.transform import Transform
from splatview.renderers import MODES
from splatview.renderers.gl.overlay import LineLayer, SplatLayer
from splatview.renderers.request import FrameRequest
from splatview.scene import InputError
from splatview.shaders.colour_maps import MOST_OVERDRAW, colour_map
from splatview.viewer import ground_grid
from splatview.viewer.camera import bounds
from splatview.viewer.editing.session import session_for_edit
from splatview.viewer.navigation import with_up
from splatview.viewer.navigation.controllers import axis
from splatview.viewer.state import AppState, Feature

SECONDS = 0.02
"""For centres and outlines in one frame; what is left is drawn in the next ones."""

SPLATS_OPACITY = 0.8
"""Of centres and outlines over the picture."""

FLOOR = 0.01
"""Quantile of the splats' heights at which the ground lies."""

FLOOR_SAMPLE = 20_000
"""Splats that it is found from."""

LEGEND_COLOURS = 32
"""Steps of a legend's bar."""


class ViewAids(Feature):
    """What is shown over the picture; grid and axes are preferences, the rest is of this window."""

    def __init__(self) -> None:
        self.centres = False
        self.rings = False
        self._lines: LineLayer | None = None
        self._splats: SplatLayer | None = None
        self._floor: tuple[object, np.ndarray] | None = None

    def busy(self, app: AppState) -> bool:
        return (self.centres or self.rings) and self._splats is not None and self._splats.busy

    def draw(self, app: AppState, corner: ImVec2, width: int, height: int, picture: moderngl.Texture) -> None:
        """Draws over the `picture` that is shown at `corner`, of `width` x `height` in ImGui's units."""
        preferences = app.preferences
        low, high = corner, ImVec2(corner.x + width, corner.y + height)
        try:
            if preferences.show_grid or preferences.show_axes:
                self._draw_lines(app, picture, low, high)
            if (self.centres or self.rings) and app.is_open:
                self._draw_splats(app, picture.ctx, low, high)
        except InputError as error:
            self.centres = self.rings = False
            app.prefer(show_grid=False, show_axes=False)
            app.complain(str(error))

    def _draw_lines(self, app: AppState, picture: moderngl.Texture, low: ImVec2, high: ImVec2) -> None:
        camera, radius = app.camera, app.scene.radius if app.is_open else 1.0
        if self._lines is None:
            self._lines = LineLayer(picture.ctx)
        parts = []
        if app.preferences.show_grid:
            parts.append(ground_grid.ground_lines(camera, app.view.up, self.floor(app), radius))
        if app.preferences.show_axes:
            parts.append(ground_grid.axis_lines(camera, 4 * ground_grid.cell_size(radius)))
        self._lines.draw(parts, picture, (camera.width, camera.height))
        imgui.get_window_draw_list().add_image(imgui.ImTextureRef(self._lines.texture.glo), low, high)

    def _draw_splats(self, app: AppState, ctx: moderngl.Context, low: ImVec2, high: ImVec2) -> None:
        gaussians, edits = app.scene.gaussians, app.edits
        if edits is not None and len(edits.marks) != len(gaussians):
            return  # the picture still shows the scene of before
        if self._splats is None:
            self._splats = SplatLayer(ctx)
        request = FrameRequest(gaussians, app.camera, app.seen_settings, edits=edits, highlight=app.highlight)
        self._splats.draw(request, centres=self.centres, rings=self.rings, seconds=SECONDS)
        tint = imgui.get_color_u32(ImVec4(1, 1, 1, SPLATS_OPACITY))
        reference = imgui.ImTextureRef(self._splats.texture.glo)
        imgui.get_window_draw_list().add_image(reference, low, high, ImVec2(0, 0), ImVec2(1, 1), tint)

    def floor(self, app: AppState) -> np.ndarray:
        """(3,) float64, world: a point of the ground below the middle of the scene."""
        up, scene = app.view.up, app.scene
        key = (id(scene.gaussians), up.tobytes(), 0 if app.edits is None else app.edits.palette_version)
        if self._floor is None or self._floor[0] != key:
            found = bounds(app) or (scene.centre, scene.radius)
            means = scene.gaussians.means[:: max(1, len(scene.gaussians) // FLOOR_SAMPLE)]
            with np.errstate(invalid="ignore", over="ignore"):
                offsets = means.astype(np.float64) - scene.centre
                near = offsets[np.linalg.norm(offsets, axis=1) <= scene.radius]
            depth = float(np.quantile(near @ up, FLOOR)) if len(near) else 0.0
            self._floor = key, found[0] + depth * up
        return self._floor[1]

    def close(self, app: AppState) -> None:
        for layer in (self._lines, self._splats):
            if layer is not None:
                layer.close()
        self._lines = self._splats = None


def toggle_grid(app: AppState) -> None:
    app.prefer(show_grid=not app.preferences.show_grid)


def toggle_axes(app: AppState) -> None:
    app.prefer(show_axes=not app.preferences.show_axes)


def toggle_centres(app: AppState) -> None:
    aids = app.feature(ViewAids)
    aids.centres = not aids.centres


def toggle_rings(app: AppState) -> None:
    aids = app.feature(ViewAids)
    aids.rings = not aids.rings


def roll(app: AppState, degrees: float) -> None:
    """Turns the view about its axis to the right, and the up axis with it: the scene turns to the left."""
    view = app.destination
    right, down = view.R_camera_world[:2]
    angle = np.radians(degrees)
    app.go_to(with_up(view, np.sin(angle) * right - np.cos(angle) * down))


def turn_scene(app: AppState, name: str) -> None:
    """A step of editing that turns the whole scene by 90 degrees about the world axis `name`, through the
    middle of what is shown."""
    session, found = session_for_edit(app), bounds(app)
    if session is None or found is None:
        app.tell("Open a scene first")
        return
    x, y, z = (np.sqrt(0.5) * axis(name)).tolist()
    px, py, pz = found[0].tolist()
    rotation = (float(np.sqrt(0.5)), x, y, z)
    session.apply(Transform(scope="scene", rotation=rotation, pivot=(px, py, pz)))


def legend(app: AppState) -> tuple[np.ndarray, list[tuple[float, str]], str] | None:
    """Colours from bottom to top, ticks (share of the height, text) and title of the visual mode's legend;
    None where it has none."""
    mode = MODES[app.mode]
    if mode.depths:
        depths = app.picture.depth_range(app.camera)
        if depths is None:
            return None
        shares = np.linspace(0, 1, 5)
        ticks = [(float(s), f"{depths[0] + s * (depths[1] - depths[0]):.3g}") for s in shares]
        return colour_map("viridis", LEGEND_COLOURS)[::-1], ticks, "Depth, units"
    if mode.flag == "OVERDRAW":
        counts = (0, 1, 7, 31, 127, MOST_OVERDRAW)
        most = np.log2(1 + MOST_OVERDRAW)
        ticks = [(float(np.log2(1 + n) / most), f"{n}" if n < MOST_OVERDRAW else f"{n}+") for n in counts]
        return colour_map("inferno", LEGEND_COLOURS), ticks, "Splats at a pixel"
    return None


def show_legend(app: AppState, right: float, bottom: float, room: float) -> None:
    """Draws the legend with its lower right corner at (`right`, `bottom`), screen units, where `room` in
    height is enough for it."""
    found = legend(app)
    em = imgui.get_font_size()
    if found is None or room < 9 * em:
        return
    colours, ticks, title = found
    height, bar = min(12 * em, room - 4 * em), 0.9 * em
    texts = max(imgui.calc_text_size(text).x for _, text in ticks)
    wide = max(bar + 0.6 * em + texts, imgui.calc_text_size(title).x)
    left, top = right - wide - 0.5 * em, bottom - height - 0.8 * em
    draw = imgui.get_window_draw_list()
    ground = imgui.get_color_u32(ImVec4(0.1, 0.1, 0.11, 0.75))
    draw.add_rect_filled(ImVec2(left - 0.5 * em, top - 1.9 * em), ImVec2(right, bottom), ground, 0.3 * em)
    ink = imgui.get_color_u32(ImVec4(0.9, 0.9, 0.92, 1))
    draw.add_text(ImVec2(left, top - 1.6 * em), ink, title)
    step = height / len(colours)
    for index, (r, g, b) in enumerate(colours.tolist()):
        low = top + height - (index + 1) * step
        fill = imgui.get_color_u32(ImVec4(r, g, b, 1))
        draw.add_rect_filled(ImVec2(left, low), ImVec2(left + bar, low + step + 0.5), fill)
    for share, text in ticks:
        y = top + height * (1 - share)
        draw.add_line(ImVec2(left + bar, y), ImVec2(left + bar + 0.25 * em, y), ink)
        draw.add_text(ImVec2(left + bar + 0.5 * em, y - 0.5 * em), ink, text)
