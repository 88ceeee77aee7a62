"""What every operation is: data that says what to do, and a plan of what that alters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from ..changes import Change
from ..json_form import from_json, to_json
from ..watch import UNWATCHED, Watch

if TYPE_CHECKING:
    from ..document import Document


@dataclass(frozen=True, kw_only=True)
class Operation(ABC):
    """One kind of editing, with the numbers that it needs.

    Raises:
        ValueError: a number makes no sense; the message names the field.
    """

    op: ClassVar[str]
    """Its name in a recipe."""
    summary: ClassVar[str]
    """One sentence for people who look for it."""

    @abstractmethod
    def plan(self, document: Document, watch: Watch = UNWATCHED) -> Change:
        """What it alters, as the document stands. Alters nothing itself.

        Raises:
            InputError: it cannot be done here.
        """

    def to_json(self) -> dict[str, Any]:
        return {"op": self.op, **to_json(self)}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Self:
        """`data` without its key ``op``. Raises InputError that names the field."""
        return from_json(cls, data)
