"""Backgrounds and depth of field as a person chooses them, in a real window."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from splatview.scene.formats import save_scene


@pytest.mark.parametrize("renderer", ["cpu", pytest.param("quads", marks=pytest.mark.slow)])
def test_what_is_behind_and_what_is_in_focus(drive, random_gaussians, tmp_path, renderer):
    scene, sky, broken = (tmp_path / name for name in ("ball.ply", "sky.png", "broken.png"))
    save_scene(random_gaussians(400, seed=4), scene)
    ramp = np.linspace(0, 255, 64).astype(np.uint8)
    Image.fromarray(
        np.stack(np.broadcast_arrays(ramp[:32, None], ramp[None], 99), axis=-1).astype(np.uint8)
    ).save(sky)
    broken.write_text("no picture")
    samples = 4
    found = drive(
        "behind_and_before",
        scene,
        script="lens_drives.py",
        renderer=renderer,
        size=[700, 420],
        samples=samples,
        sky=str(sky),
        broken=str(broken),
        saved=str(tmp_path / "saved.png"),
    )
    assert found["gradient"] == [[0.35, 0.53, 0.78], [0.16, 0.15, 0.14], found["up"]]
    assert found["corner"][2] > 0.14
    assert found["panorama"] and found["kept"]
    assert found["remembered"] == ["panorama", str(sky)]
    assert "broken.png: is no picture that can be read" in found["problem"]

    assert 0.3 * found["distance"] < found["focus"] < 1.7 * found["distance"]
    assert found["stayed"]
    assert "of 4 pictures" in found["badge"]
    assert (found["samples"], found["while_moving"], found["again"]) == (samples, 0, samples)
    assert found["error"] < (1e-5 if renderer == "cpu" else 2e-3)  # float16 is shown by quads
    assert found["blurred"] > 0.05
    assert found["idle"] == 0
    assert found["saved_error"] <= 0.5 / 255 + 1e-3
    assert found["closed"] == [0, True, False]
    assert found["by_key"] == [True, False]
