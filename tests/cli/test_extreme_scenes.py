"""Numbers out of all bounds are scenes as any: no library's warning is between our lines."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from splatview.cli.main import main
from splatview.renderers.gl.uniforms import view_uniforms
from splatview.scene import Gaussians, RenderSettings, look_at
from splatview.scene.formats import save_scene
from splatview.scene.formats.cameras import camera_values
from splatview.scene.gaussians import ARRAYS

EXTREME = (3.4e38, -3.4e38, np.inf, -np.inf, np.nan, 1e-45, 0.0)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, random_gaussians) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    rng = np.random.default_rng(0)
    scene: Gaussians = random_gaussians(40, sh_degree=1)
    arrays = {name: getattr(scene, name).copy() for name in ARRAYS}
    for values in arrays.values():
        values[:30] = rng.choice(EXTREME, values[:30].shape)
    save_scene(Gaussians(**arrays), "s.ply")
    camera = look_at((0, 0, -4), (0, 0, 0), width=16, height=16)
    Path("c.json").write_text(json.dumps(camera_values(camera)))
    steps = [
        {"op": "select", "by": {"kind": "range", "attribute": "volume", "low": 0}},
        {"op": "grow", "distance": 0.5},
        {"op": "transform", "scope": "scene", "scale": 1e9, "translation": [1e15, 0, 0]},
        {"op": "size", "value": 1e9, "scope": "scene"},
        {"op": "repair", "finding": "needles"},
        {"op": "prune", "by": {"kind": "giants"}, "threshold": 1e9},
    ]
    Path("r.json").write_text(json.dumps({"splatview_recipe": 1, "steps": steps}))
    return tmp_path


@pytest.mark.parametrize(
    "argv",
    [
        "info s.ply",
        "render s.ply -o o.npy --size 16x16 --renderer reference",
        "render s.ply -o o.png --camera c.json --renderer cpu",
        "render s.ply -o o.png --size 16x16 --eye 1e39,0,0 --target 0,0,0 --renderer cpu",
        "edit s.ply --recipe r.json --dry-run",
        "convert s.ply o.ply",
        "bill s.ply --size 16x16",
    ],
)
def test_no_warning_of_a_library_is_printed(place, capsys, argv):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert main(argv.split()) == 0
    out, err = capsys.readouterr()
    assert "Warning" not in out + err


def test_an_eye_beyond_float32_makes_uniforms_without_a_warning():
    camera = look_at((1e39, 0, 0), (0, 0, 0), width=16, height=16)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        view_uniforms(camera, RenderSettings(), np.zeros(3))
