"""Operations on a scene, one module per family, and the table of all by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from splatview.edit.operations.appearance import ColourGrade, Opacity, Size
from splatview.edit.operations.base import Operation
from splatview.edit.operations.cleanup import Decimate, Prune, Repair, SelectDetected
from splatview.edit.operations.crop import AddCrop, ChangeCrop, DeleteCropped, EnableCrop, RemoveCrop
from splatview.edit.operations.files import (
    LockFile,
    PlaceFile,
    RemoveFile,
    RenameFile,
    SelectFile,
    ShowFile,
)
from splatview.edit.operations.flags import Delete, Hide, Isolate, Lock, Show, Unlock
from splatview.edit.operations.merge_split import Duplicate, Merge, Split
from splatview.edit.operations.select import Grow, Select, SelectAll, SelectInverse, SelectNone, Shrink
from splatview.edit.operations.transform import Ground, Orient, Transform
from splatview.edit.serialization import quoted
from splatview.scene import InputError

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
        SelectDetected,
        Prune,
        Decimate,
        Repair,
        Merge,
        Duplicate,
        Split,
        ShowFile,
        LockFile,
        PlaceFile,
        RenameFile,
        RemoveFile,
        SelectFile,
    )
}


def operation_from_json(data: Any) -> Operation:
    """The operation of a step of a recipe.

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
