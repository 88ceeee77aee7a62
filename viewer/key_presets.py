"""Keys and mouse as other programs have them: presets over the table of commands, and what a drag does.

Sources: the shortcut pages of SuperSplat (developer.playcanvas.com/user-manual/supersplat/editor), Blender
(docs.blender.org/manual/en/latest/interface/keymap) and Unreal Engine (viewport controls).
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar, get_args

Preset = Literal["splatview", "supersplat", "blender", "unreal"]
PRESETS: tuple[Preset, ...] = get_args(Preset)
PRESET_NAMES = ("splatview", "SuperSplat", "Blender", "Unreal")

KEYS: dict[Preset, dict[str, str]] = {
    "splatview": {},
    "supersplat": {
        "tool_move": "1",
        "tool_rotate": "2",
        "tool_scale": "3",
        "tool_rectangle": "R",
        "tool_lasso": "L",
        "tool_polygon": "P",
        "tool_brush": "B",
        "tool_flood": "O",
        "tool_colour": "Ctrl+E",
        "larger_brush": "]",
        "smaller_brush": "[",
        "next_depth": "N",
        "lock": "H",
        "unlock": "Shift+H",
        "next_navigation": "V",
        "frame_selection": "F",
        "toggle_grid": "G",
        "toggle_panels": "Tab",
        "export": "Ctrl+Shift+E",
    },
    "blender": {
        "tool_move": "G",
        "tool_rotate": "R",
        "tool_scale": "S",
        "tool_rectangle": "B",
        "tool_brush": "C",
        "select_all": "A Ctrl+A",
        "select_none": "Alt+A Ctrl+Shift+A",
        "delete": "X Delete Backspace",
        "duplicate": "Shift+D",
        "hide": "H",
        "show": "Alt+H",
        "isolate": "Shift+H",
        "frame_all": "Home",
        "frame_selection": "KeypadDecimal F",
        "look_from_+X": "Keypad3",
        "look_from_-X": "Ctrl+Keypad3",
        "look_from_+Y": "Ctrl+Keypad1",
        "look_from_-Y": "Keypad1",
        "look_from_+Z": "Keypad7",
        "look_from_-Z": "Ctrl+Keypad7",
        "toggle_orthographic": "Keypad5",
        "toggle_panels": "N",
        "toggle_palette": "F3 Ctrl+P",
        "add_keyframe": "I Ctrl+K",
    },
    "unreal": {
        "tool_move": "Shift+W",
        "tool_rotate": "Shift+E",
        "tool_scale": "Shift+R",
        "frame_selection": "F",
        "toggle_panels": "F11",
        "hide": "H",
        "show": "Ctrl+H",
        "duplicate": "Ctrl+D",
        "toggle_grid": "G",
    },
}
"""Keys of each preset by the command's id, several with spaces between; other commands keep theirs, unless a
preset has given them away. Unreal's W, E and R take Shift here, since they fly."""

C = TypeVar("C", bound=Any)


def with_preset(defaults: Mapping[str, C], preset: Preset) -> dict[str, C]:
    """The commands by id with the keys of `preset`; a key that it gives to one is taken from all others."""
    given = {id: tuple(keys.split()) for id, keys in KEYS[preset].items() if id in defaults}
    taken = {key for keys in given.values() for key in keys}
    return {
        id: replace(command, keys=given.get(id, tuple(key for key in command.keys if key not in taken)))
        for id, command in defaults.items()
    }


def use(commands: MutableMapping[str, C], defaults: Mapping[str, C], preset: Preset) -> frozenset[str]:
    """Gives `commands`, the table that keys, menus, palette and help read, the keys of `preset`. Returns its
    keys without modifiers, which fly no more."""
    commands.update(with_preset(defaults, preset))
    return frozenset(key for keys in KEYS[preset].values() for key in keys.split() if "+" not in key)


Action = Literal["turn", "orbit", "look", "pan", "zoom", "walk"]
"""What a drag does: "turn" is what the navigation mode says, "walk" goes ahead and turns sideways."""

Button = Literal["left", "middle", "right"]


@dataclass(frozen=True, kw_only=True)
class Drag:
    """A drag with a button and modifiers, of "Shift", "Ctrl", "Alt"."""

    button: Button
    held: frozenset[str] = frozenset()
    action: Action

    @property
    def text(self) -> str:
        return " + ".join([*sorted(self.held), f"{self.button} drag"]).capitalize()


def _drag(text: str, action: Action) -> Drag:
    *held, button = text.split("+")
    assert button in get_args(Button)
    return Drag(button=button, held=frozenset(held), action=action)  # pyright: ignore[reportArgumentType]


MOUSE: dict[Preset, tuple[Drag, ...]] = {
    "splatview": (
        _drag("left", "turn"),
        _drag("Shift+left", "pan"),
        _drag("middle", "pan"),
        _drag("right", "pan"),
    ),
    "supersplat": (
        _drag("left", "turn"),
        _drag("middle", "turn"),
        _drag("Shift+middle", "pan"),
        _drag("Ctrl+middle", "zoom"),
        _drag("right", "pan"),
        _drag("Shift+right", "turn"),
        _drag("Ctrl+right", "turn"),
        _drag("Alt+right", "zoom"),
    ),
    "blender": (
        _drag("middle", "turn"),
        _drag("Shift+middle", "pan"),
        _drag("Ctrl+middle", "zoom"),
        _drag("Alt+left", "turn"),
        _drag("left", "turn"),
    ),
    "unreal": (
        _drag("right", "look"),
        _drag("left", "walk"),
        _drag("middle", "pan"),
        _drag("Alt+left", "orbit"),
        _drag("Alt+middle", "pan"),
        _drag("Alt+right", "zoom"),
    ),
}
"""Drags of each preset. A left drag without modifiers is a tool's while one is in hand."""

ACTION_TEXTS: dict[Action, str] = {
    "turn": "Turn: orbit, look around or roll the ball",
    "orbit": "Orbit about the target",
    "look": "Look around",
    "pan": "Pan: the scene moves with the mouse",
    "zoom": "Nearer and farther",
    "walk": "Go ahead and back, and turn",
}


def action_of(preset: Preset, button: Button, held: frozenset[str]) -> Action | None:
    """What a drag with `button` does; with modifiers that the preset does not know, what it does without."""
    drags: dict[tuple[Button, frozenset[str]], Action] = {}
    for drag in MOUSE[preset]:
        drags[drag.button, drag.held] = drag.action
    found = drags.get((button, held))
    return drags.get((button, frozenset())) if found is None else found
