"""What every selector has in common: names in recipes, bad fields named, the way to JSON and back."""

from __future__ import annotations

import json

import numpy as np
import pytest

from splatview.edit.selectors import SELECTORS, IndexRuns, InvalidSplats
from splatview.edit.selectors.volumes import health_findings
from splatview.edit.serialization import from_json, to_json
from splatview.edit.tools import NoTools
from splatview.scene import InputError, look_at
from splatview.scene.health import check
from splatview.scene.progress import Progress

CAMERA = look_at((0.4, -0.3, -3), (0, 0, 0), up=(0, -1, 0), width=32, height=24)
TRIANGLE = ((3.0, 2.0), (28.5, 4.0), (16.0, 22.25))

EXAMPLES = {
    "rectangle": [{"camera": CAMERA, "x0": 5, "y0": 4.5, "x1": 30, "y1": 20}],
    "polygon": [{"camera": CAMERA, "points": TRIANGLE}],
    "lasso": [{"camera": CAMERA, "points": TRIANGLE, "depth": "front"}],
    "brush": [{"camera": CAMERA, "points": TRIANGLE, "radius": 2.5}],
    "sphere": [{"centre": (0.1, 0, 0), "radius": 0.7}],
    "box": [{"centre": (0, 0, 0), "half_extents": (0.5, 0.6, 0.7), "rotation": (0.6, 0.8, 0, 0)}],
    "flood": [{"seed": 3, "reach": 0.4, "tolerance": 0.5}, {"seed": 3, "tolerance": 1}],
    "colour": [{"rgb": (0.5, 0.4, 0.5), "tolerance": 0.2}],
    "range": [
        {"attribute": "opacity", "low": 0.2, "high": 0.6},
        {"attribute": "contribution", "low": 1.0, "cameras": (CAMERA,)},
    ],
    "health": [{"finding": "needles"}],
    "runs": [{"runs": ((2, 5), (30, 1))}],
    "all": [{}],
}
CASES = [(kind, fields) for kind, several in EXAMPLES.items() for fields in several]


def test_every_selector_has_an_example():
    assert set(EXAMPLES) == set(SELECTORS)


@pytest.mark.parametrize(("kind", "fields"), CASES)
def test_through_json_it_selects_the_same(edit_helpers, edited, reference_tools, kind, fields):
    scene, edits = edit_helpers.make_scene(100), edited.some(100)
    selector = SELECTORS[kind](**fields)
    mask = selector.mask(scene, edits, reference_tools)
    assert mask.shape == (100,)
    assert mask.dtype == bool
    text = json.dumps(to_json(selector), allow_nan=False)
    again = from_json(SELECTORS[kind], json.loads(text))
    assert json.dumps(to_json(again)) == text
    assert (again.mask(scene, edits, reference_tools, progress=Progress()) == mask).all()
    if kind != "health":
        assert mask.any()


@pytest.mark.parametrize(("kind", "fields"), CASES)
def test_an_empty_scene(edit_helpers, edited, reference_tools, kind, fields):
    if kind in ("flood", "runs"):  # which name splats
        with pytest.raises(InputError, match="the scene has 0"):
            SELECTORS[kind](**fields).mask(edit_helpers.make_scene(0), edited.none(0), reference_tools)
    else:
        selector = SELECTORS[kind](**fields)
        assert selector.mask(edit_helpers.make_scene(0), edited.none(0), reference_tools).shape == (0,)


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("kind", "change", "field"),
    [
        ("rectangle", {"camera": {}}, "camera"),
        ("rectangle", {"x0": NAN}, "x0"),
        ("rectangle", {"y1": INF}, "y1"),
        ("rectangle", {"x1": "5"}, "x1"),
        ("rectangle", {"depth": "behind"}, "depth"),
        ("polygon", {"points": ((0.0, 0.0), (1.0, 1.0))}, "points"),
        ("polygon", {"points": 5}, "points"),
        ("lasso", {"points": ((0.0, 0.0), (1.0, NAN), (2.0, 2.0))}, r"points\[1\]\[1\]"),
        ("lasso", {"points": ((0.0, 0.0), (1.0,), (2.0, 2.0))}, r"points\[1\]"),
        ("brush", {"points": ()}, "points"),
        ("brush", {"radius": 0}, "radius"),
        ("brush", {"radius": NAN}, "radius"),
        ("sphere", {"centre": (0, 0)}, "centre"),
        ("sphere", {"centre": (0, NAN, 0)}, r"centre\[1\]"),
        ("sphere", {"radius": -1}, "radius"),
        ("sphere", {"radius": True}, "radius"),
        ("box", {"half_extents": (1, 0, 1)}, "half_extents"),
        ("box", {"half_extents": (1, INF, 1)}, r"half_extents\[1\]"),
        ("box", {"rotation": (1, 1, 0, 0)}, "rotation"),
        ("flood", {"seed": -1}, "seed"),
        ("flood", {"seed": 1.5}, "seed"),
        ("flood", {"tolerance": NAN}, "tolerance"),
        ("flood", {"reach": 0}, "reach"),
        ("flood", {"limit": -1}, "limit"),
        ("colour", {"rgb": (0, 0, NAN)}, r"rgb\[2\]"),
        ("colour", {"tolerance": -0.1}, "tolerance"),
        ("range", {"attribute": "weight"}, "attribute"),
        ("range", {"low": NAN}, "low"),
        ("range", {"high": INF}, "high"),
        ("range", {"low": 2, "high": 1}, "low"),
        ("range", {"point": (1, 2)}, "point"),
        ("range", {"cameras": ({},)}, "cameras"),
        ("health", {"finding": "flu"}, "finding"),
        ("runs", {"runs": ((0, -1),)}, r"runs\[0\] count"),
        ("runs", {"runs": ((0.5, 1),)}, r"runs\[0\] start"),
        ("runs", {"runs": ((1, 2, 3),)}, r"runs\[0\]"),
        ("runs", {"runs": "all"}, "runs"),
    ],
)
def test_a_bad_field_is_named(kind, change, field):
    with pytest.raises(ValueError, match=rf"^{field} "):
        SELECTORS[kind](**{**EXAMPLES[kind][0], **change})


def test_runs_of_a_mask_select_that_mask(edit_helpers, edited, rng):
    for share in (0.0, 0.3, 1.0):
        mask = rng.uniform(size=50) < share
        runs = IndexRuns.of(mask)
        assert (runs.mask(edit_helpers.make_scene(50), edited.none(50), NoTools()) == mask).all()
    with pytest.raises(InputError, match=r"runs\[0\] ends at splat 50, but the scene has 49"):
        runs.mask(edit_helpers.make_scene(49), edited.none(49), NoTools())


@pytest.mark.parametrize("finding", health_findings())
def test_every_finding_can_be_selected(edit_helpers, edited, finding):
    scene = edit_helpers.make_scene(40)
    scene.quats[3] = 0
    scene.means[4] = np.nan
    scene.log_scales[5] = (-9, 2, -9)
    scene.opacity_logits[6] = -99
    mask = InvalidSplats(finding=finding).mask(scene, edited.none(40), NoTools())
    expected = next(found for found in check(scene) if found.name == finding)
    assert np.flatnonzero(mask).tolist() == expected.indices.tolist()
