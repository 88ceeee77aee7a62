"""Steps that cannot be done are refused in one line that names the field, and change nothing."""

from __future__ import annotations

import pytest

from splatview.edit.document import Document
from splatview.edit.operations import operation_from_json
from splatview.scene import InputError

WRONG = [
    ({"op": "transform", "scale": 0}, "scale must be above 0"),
    ({"op": "transform", "scale": float("nan")}, "scale must be a finite number"),
    ({"op": "transform", "scale": "2"}, 'scale must be a number, not "2"'),
    ({"op": "transform", "scale": True}, "scale must be a number"),
    ({"op": "transform", "scale": 10**400}, "scale must be a finite number"),
    ({"op": "transform", "rotation": [0, 0, 0, 0]}, "rotation must be a quaternion"),
    ({"op": "transform", "translation": [1, 2]}, "translation must be a list of 3, not of 2"),
    ({"op": "transform", "translation": [1, 2, None]}, r"translation\[2\] must be a number"),
    ({"op": "transform", "pivot": [1e300, 0, 0]}, "pivot must be three numbers of at most"),
    ({"op": "transform", "scope": "all"}, "scope must be one of selection, scene"),
    ({"op": "transform", "speed": 1}, 'unknown key "speed"; known here: scope'),
    ({"op": "explode"}, 'unknown operation "explode"'),
    ({"op": ["delete"]}, "unknown operation"),
    ({}, "unknown operation null"),
    ([], "a step must be an object"),
    ({"op": "select"}, "by is missing"),
    ({"op": "select", "by": {}}, "by must be an object with a kind"),
    ({"op": "select", "by": {"kind": "cone"}}, 'by: unknown kind "cone"'),
    ({"op": "select", "by": {"kind": "sphere", "radius": 1}}, "by: centre is missing"),
    (
        {"op": "select", "by": {"kind": "sphere", "centre": [0, 0, 0], "radius": -1}},
        "by: radius must be above 0",
    ),
    ({"op": "select", "by": {"kind": "all"}, "mode": "xor"}, "mode must be one of"),
    ({"op": "select", "by": {"kind": "rectangle", "camera": {"width": 1}}}, "by: camera: height is missing"),
    ({"op": "add_crop", "crop": {"half_extents": [1, 0, 1]}}, "crop: half_extents must be above 0"),
    ({"op": "add_crop", "crop": {"shape": "cone"}}, "crop: shape must be one of box, sphere"),
    ({"op": "add_crop", "crop": 3}, "crop: must be an object"),
    ({"op": "change_crop", "index": -1, "crop": {}}, "index must be at least 0"),
    ({"op": "change_crop", "index": 0.5, "crop": {}}, "index must be a whole number"),
    ({"op": "remove_crop", "index": 3}, "index 3: there are 0 crops"),
    ({"op": "enable_crop", "index": 0, "enabled": 1}, "enabled must be true or false"),
    ({"op": "opacity", "value": 1.5, "how": "set"}, "value must be in 0 to 1 to set"),
    ({"op": "size", "value": 0}, "value must be in 1e-9 to 1e9"),
    ({"op": "grade", "grade": {"contrast": -1}}, "grade: contrast must be in 0 to 10"),
    ({"op": "grade", "grade": {"black": 0.5, "white": 0.5}}, "grade: white must be at least"),
    ({"op": "orient", "up": [0, 0, 0]}, "up must not be 0, 0, 0"),
    ({"op": "ground", "points": [[0, 0, 0], [1, 1, 1], [2, 2, 2]]}, "points must not lie on one line"),
    ({"op": "grow"}, "give either distance or neighbours"),
    ({"op": "grow", "distance": 0}, "distance must be above 0"),
    ({"op": "prune", "by": {"kind": "needles"}}, "threshold is missing"),
    ({"op": "prune", "by": {"kind": "rectangle"}, "threshold": 1}, 'by: unknown kind "rectangle"'),
    ({"op": "decimate", "keep": 0}, "keep must be at least 1"),
    ({"op": "repair", "finding": "ugly"}, "finding must be one of"),
    ({"op": "merge", "path": ""}, "path must name a file"),
    ({"op": "split", "path": 7}, "path must be a text"),
    ({"op": "split", "path": "\ud800.ply"}, "path has characters that are none"),
    ({"op": "merge", "path": "~nobody/" + 300 * "x"}, "cannot be read|no such file"),
]


@pytest.mark.parametrize(("step", "message"), WRONG, ids=lambda value: str(value)[:40])
def test_wrong_steps_are_refused_in_one_line(edit_helpers, step, message):
    document = Document(edit_helpers.make_scene(30))
    before = edit_helpers.everything(document)
    with pytest.raises(InputError, match=message) as error:
        document.apply(operation_from_json(step))
    assert "\n" not in str(error.value)
    assert edit_helpers.everything(document) == before
