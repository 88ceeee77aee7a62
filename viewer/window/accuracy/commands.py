"""What the Accuracy panel asks for, run between two frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....scene import InputError

if TYPE_CHECKING:
    from ..core import Core


def measure(core: Core) -> None:
    """Begins to measure the view that is seen."""
    core.accuracy.measure(core)


def cancel(core: Core) -> None:
    core.accuracy.cancel()


def choose(core: Core, knob: str, value: str) -> None:
    """Draws by a shortcut from now on."""
    try:
        core.accuracy.choose(core, knob, value)
    except InputError as error:
        core.complain(str(error))


def leave(core: Core, knob: str) -> None:
    """Takes one shortcut back."""
    core.accuracy.choices.pop(knob, None)


def exact(core: Core) -> None:
    """Takes all shortcuts back."""
    core.accuracy.exact()


def hold(core: Core, budget_ms: float | None) -> None:
    """Holds a frame budget, in ms; None: no longer."""
    core.accuracy.hold(core, budget_ms)
