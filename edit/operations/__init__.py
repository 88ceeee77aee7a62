"""What can be done to a scene: one module a family, and the table of all by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...scene import InputError
from ..json_form import quoted
from .combining import Duplicate, Merge, Split
from .cropping import AddCrop, ChangeCrop, DeleteCropped, EnableCrop, RemoveCrop
from .growing import Grow, Shrink
from .looks import ColourGrade, Opacity, Size
from .moving import Ground, Orient, Transform
from .operation import Operation
from .pruning import Decimate, Prune
from .repairing import Repair
from .select import Select, SelectAll, SelectInverse, SelectNone
from .state_flags import Delete, Hide, Isolate, Lock, Show, Unlock

__all__ = [
    "OPERATIONS",
    "AddCrop",
    "ChangeCrop",
    "ColourGrade",
    "Decimate",
    "Delete",
    "DeleteCropped",
    "Duplicate",
    "EnableCrop",
    "Ground",
    "Grow",
    "Hide",
    "Isolate",
    "Lock",
    "Merge",
    "Opacity",
    "Operation",
    "Orient",
    "Prune",
    "RemoveCrop",
    "Repair",
    "Select",
    "SelectAll",
    "SelectInverse",
    "SelectNone",
    "Show",
    "Shrink",
    "Size",
    "Split",
    "Transform",
    "Unlock",
    "operation_from_json",
]

OPERATIONS: dict[str, type[Operation]] = {
    cls.op: cls
    for cls in (
        Select,
        SelectAll,
        SelectNone,
        SelectInverse,
        Grow,
        Shrink,
        Delete,
        Hide,
        Show,
        Lock,
        Unlock,
        Isolate,
        AddCrop,
        ChangeCrop,
        EnableCrop,
        RemoveCrop,
        DeleteCropped,
        Transform,
        Orient,
        Ground,
        Size,
        Opacity,
        ColourGrade,
        Prune,
        Decimate,
        Repair,
        Merge,
        Duplicate,
        Split,
    )
}


def operation_from_json(data: Any) -> Operation:
    """The operation that a step of a recipe describes.

    Raises:
        InputError: there is no such operation, or a field is wrong.
    """
    if not isinstance(data, Mapping):
        raise InputError(f"a step must be an object in braces, not {quoted(data)}")
    rest = dict(data)
    name = rest.pop("op", None)
    if not isinstance(name, str) or name not in OPERATIONS:
        raise InputError(f"unknown operation {quoted(name)}; there are {', '.join(OPERATIONS)}")
    return OPERATIONS[name].from_json(rest)
