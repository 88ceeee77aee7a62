"""Switches of what is drawn over the picture: a section of the panel about the view."""

from __future__ import annotations

from splatview.viewer import view_aids
from splatview.viewer.commands import COMMANDS, keys_of
from splatview.viewer.panels import widgets
from splatview.viewer.state import AppState

SWITCHES = (
    ("Ground grid", "toggle_grid", "The floor of the scene, square to the up axis, seen behind the scene."),
    ("Axes", "toggle_axes", "The world's axes from the origin: x red, y green, z blue."),
    ("Centres", "toggle_centres", "A dot at each splat's centre, over the picture; selected are tinted."),
    ("Rings", "toggle_rings", "The outline of each splat at one standard deviation, over the picture."),
)
"""Label, command and tooltip of each."""


def show(app: AppState) -> None:
    for label, name, tip in SWITCHES:
        command = COMMANDS[name]
        key = keys_of(name)
        changed = widgets.checkbox(label, command.checked(app), f"{tip} ({key})" if key else tip)
        if changed is not None:
            app.post(command.run)
    if app.preferences.show_grid and app.is_open:
        cell = view_aids.ground_grid.cell_size(app.scene.radius)
        widgets.fact("Grid cell", f"{cell:g} units", "Side of a cell, world units.")
