"""A command of the window: something that the user can ask for by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from splatview.viewer.state import AppState


@dataclass(frozen=True, kw_only=True)
class Command:
    """One thing that the user can ask for by name."""

    id: str
    title: str
    """Description for the palette, tooltips and the help page."""
    group: str
    """Heading on the help page."""
    run: Callable[[AppState], object]
    shows: Callable[[AppState], object] | None = None
    """What the palette runs of a command that also hides: who asks for a thing by name wants to see it."""
    keys: tuple[str, ...] = ()
    """Keys as the user reads them: "F", "Ctrl+Shift+O". Any of them runs the command."""
    menu: str = ""
    """Title in a menu, where `title` would be too long."""
    words: tuple[str, ...] = ()
    """What else people call it: the palette puts it first where one of them is all that is typed."""
    tip: str = ""
    """What it does and why, in one sentence."""
    lacks: Callable[[AppState], str] = lambda app: ""
    """What must be there first, as a sentence; "" where it can be done. Menus and buttons are grey without it
    and say so; keys and the palette run the command all the same, which then says why it does nothing."""
    checked: Callable[[AppState], bool] = lambda app: False
    """Whether menus show it as chosen."""
    when: Callable[[AppState], bool] = lambda app: True
    """Whether its keys are its own now: a key may have one meaning in training and one in a sequence."""


def needs(check: Callable[[AppState], bool], otherwise: str) -> Callable[[AppState], str]:
    """`Command.lacks` of what can be done where `check` holds."""
    return lambda app: "" if check(app) else otherwise
