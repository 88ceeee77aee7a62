"""The tint of a selection stands out from the scene that it is seen on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.measure.metrics import hyab, lab, linear
from splatview.raster import render
from splatview.renderers.edit_snapshot import tinted
from splatview.renderers.request import Highlight
from splatview.scene.edits import SELECTED, SceneEdits
from splatview.scene.first_view import first_view
from splatview.scene.formats import load_scene
from splatview.scene.sh import rgb_to_sh
from splatview.viewer.editing.selection_colour import YELLOW, selection_tint


def coloured(gaussians, *colours):
    rgb = np.array(colours)[np.arange(len(gaussians)) % len(colours)]
    return replace(gaussians, sh=rgb_to_sh(rgb).astype(np.float32)[:, None])


@pytest.mark.parametrize(
    ("colours", "yellow"),
    [
        ([(0.5, 0.5, 0.5), (0.1, 0.1, 0.12)], True),
        ([(0.1, 0.3, 0.8), (0.2, 0.5, 0.9)], True),
        ([(0.9, 0.7, 0.2), (0.6, 0.4, 0.1), (0.95, 0.85, 0.45), (0.25, 0.15, 0.03)], False),
    ],
)
def test_yellow_unless_the_scene_is_yellow(random_gaussians, colours, yellow):
    assert (selection_tint(coloured(random_gaussians(300), *colours)) == YELLOW) == yellow


def test_grass_below_a_sky_of_large_splats_is_not_marked_green(random_gaussians):
    meadow = coloured(
        random_gaussians(400), *[(0.2, 0.3, 0.08), (0.3, 0.42, 0.12), (0.42, 0.5, 0.2)] * 6, (0.8, 0.8, 0.82)
    )
    red, green, blue, _ = selection_tint(meadow)
    meadow.log_scales[18::19] = 3.0
    assert selection_tint(meadow)[:3] == (red, green, blue), "however large the few"
    assert not green > max(red, blue)


def test_any_scene_has_a_tint(random_gaussians):
    scene = random_gaussians(50)
    for broken in (
        random_gaussians(0),
        replace(scene, sh=np.full_like(scene.sh, np.nan)),
        replace(scene, log_scales=np.full_like(scene.log_scales, np.inf)),
        replace(scene, opacity_logits=np.full_like(scene.opacity_logits, -np.inf)),
    ):
        assert selection_tint(broken) == YELLOW


def standing_out(scene, tint) -> float:
    """Mean distance of the pixels of a scene that is all selected from the nearest colour of its picture,
    black to white being 100."""
    camera = first_view(scene, 120, 80).camera
    edits = SceneEdits(marks=np.full(len(scene), SELECTED, np.uint32), flags=SELECTED)
    lit = tinted(edits, Highlight(selected=tint))
    plain, selected = render(scene, camera), render(scene, camera, edits=lit)
    covered = plain[..., 3] > 0.5
    there, seen = (lab(linear(np.clip(image[covered][:, :3], 0, 1))) for image in (plain, selected))
    return float(np.mean([hyab(pixel, there).min() for pixel in seen]))


@pytest.mark.parametrize("name", ["scenes/skull.ply", "scenes/biker/biker.spz"])
def test_a_selection_stands_out_from_real_scenes(data_file, name):
    scene = load_scene(data_file(name))
    own, yellow = standing_out(scene, selection_tint(scene)), standing_out(scene, YELLOW)
    print(name, selection_tint(scene), own, yellow)
    assert own > 20 and own >= yellow
