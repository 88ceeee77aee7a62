"""What editing asks of the rasteriser: the splat in front, contributions, pictures, all of edited scenes."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.edit.document import Document
from splatview.edit.operations import operation_from_json
from splatview.renderers.cpu import CpuRenderer
from splatview.scene import Gaussians, RenderSettings, look_at
from splatview.scene.edits import bake
from splatview.scene.reference import render

CAMERA = look_at((0, 0, -4), (0, 0, 0), up=(0, -1, 0), width=64, height=48)


@pytest.fixture
def document() -> Document:
    """Three opaque balls one behind the other, and a faint one in front of all."""
    depths = np.array([1.0, 0.0, -1.0, -2.0])
    return Document(
        Gaussians(
            means=np.stack([np.zeros(4), np.zeros(4), depths], axis=1).astype(np.float32),
            quats=np.tile(np.array([1, 0, 0, 0], np.float32), (4, 1)),
            log_scales=np.full((4, 3), np.log(0.3), np.float32),
            opacity_logits=np.array([6, 6, 6, -3], np.float32),
            sh=np.random.default_rng(0).normal(0, 0.5, (4, 1, 3)).astype(np.float32),
        ),
        tools=CpuRenderer(),
    )


def do(document: Document, *steps: dict) -> None:
    for step in steps:
        document.apply(operation_from_json(step))


def centre(document: Document) -> int:
    front = document.tools.dominant_splats(document.gaussians, CAMERA, document.edits)
    assert front.shape == (48, 64)
    assert front.dtype == np.int32
    assert front[0, 0] == -1
    return int(front[24, 32])


def pick(index: int) -> dict:
    return {"op": "select", "by": {"kind": "runs", "runs": [[index, 1]]}}


def test_the_splat_in_front_is_the_surface_not_the_haze(document):
    assert centre(document) == 2
    do(document, pick(2), {"op": "hide"})
    assert centre(document) == 1
    do(document, pick(1), {"op": "delete"})
    assert centre(document) == 0
    do(document, {"op": "show"})
    assert centre(document) == 2
    do(document, {"op": "add_crop", "crop": {"half_extents": [1, 1, 0.5], "centre": [0, 0, 1]}})
    assert centre(document) == 0


def test_moved_splats_are_where_they_were_moved_to(document):
    do(document, pick(0), {"op": "transform", "translation": [0, 0, -2.5]})
    assert centre(document) == 0


def test_contributions_are_shares_of_the_picture(document):
    do(document, pick(1), {"op": "delete"})
    worth = document.tools.contributions(document.gaussians, [CAMERA, CAMERA], document.edits)
    assert worth.shape == (4,)
    assert worth.dtype == np.float64
    alpha = render(bake(document.gaussians, document.edits), CAMERA, RenderSettings())[..., 3]
    assert worth.sum() == pytest.approx(2 * alpha.sum(), rel=1e-3)
    assert worth[1] == 0
    assert worth[2] > worth[0] > 0
    assert worth[3] > 0


def test_pictures_are_those_of_the_baked_scene(document):
    do(
        document,
        pick(1),
        {"op": "transform", "translation": [0.5, 0, 0]},
        {"op": "grade", "grade": {"contrast": 2}},
    )
    picture = document.tools.picture(document.gaussians, CAMERA, document.edits)
    truth = render(bake(document.gaussians, document.edits), CAMERA, RenderSettings())
    assert np.abs(picture - truth).max() < 1e-4


def test_selecting_the_front_leaves_what_is_behind(document):
    region = {"x0": 0, "y0": 0, "x1": 64, "y1": 48, "depth": "front"}
    camera = {name: getattr(CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    camera["world_to_camera"] = CAMERA.world_to_camera.tolist()
    do(document, {"op": "select", "by": {"kind": "rectangle", "camera": camera, **region}})
    assert document.counts.selected < 4
    assert document.selected.mask[2]
    assert not document.selected.mask[0]
