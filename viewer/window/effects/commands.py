"""What the Effects panel asks for, run between two frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..core import Core


def measure(core: Core) -> None:
    """Begins to price the effects in the view that is seen."""
    core.effects.measure(core)


def cancel(core: Core) -> None:
    core.effects.cancel()


def switch(core: Core, name: str, on: bool) -> None:
    core.effects.switch(core, name, on)


def as_called_for(core: Core) -> None:
    core.effects.as_called_for(core)
