"""The CPU rasteriser's picture, whatever the threads, bands and early stops that it is made with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatview import raster
from splatview.scene import RenderSettings, look_at, reference


def test_opaque_layers_end_early_and_stay_within_the_bound(random_gaussians):
    scene = random_gaussians(3000, sh_degree=0, seed=11)
    scene = replace(
        scene, opacity_logits=np.full(3000, 6, np.float32), log_scales=np.full((3000, 3), -1.5, np.float32)
    )
    camera = look_at((0, 0, -3), (0, 0, 0), width=100, height=70)
    settings = RenderSettings(background=(5.0, 5.0, 5.0))
    workspace = raster.Workspace()
    exact = raster.draw_frame(raster.parameters_of(scene), camera, settings, workspace, early_stop=0.0).image
    assert np.abs(raster.render(scene, camera, settings) - exact).max() <= 5e-5
    assert np.abs(exact - reference.render(scene, camera, settings)).max() <= 1e-4


def test_any_number_of_threads_gives_the_same_bits(random_gaussians):
    scene = random_gaussians(5000, sh_degree=1)
    camera = look_at((0, 0, -3), (0, 0, 0), width=150, height=111)
    pictures = [raster.render(scene, camera, threads=threads) for threads in (1, 2, 3, 8)]
    assert all(np.array_equal(picture, pictures[0]) for picture in pictures)


def test_bands_do_not_show(random_gaussians, monkeypatch):
    """A picture of more pairs than fit is drawn band by band."""
    scene = random_gaussians(2000, sh_degree=0)
    camera = look_at((0, 0, -3), (0, 0, 0), width=150, height=111)
    whole = raster.render(scene, camera)
    monkeypatch.setattr("splatview.raster.frame.MAX_LISTED_PAIRS", 500)
    frame = raster.draw_frame(
        raster.parameters_of(scene), camera, RenderSettings(), raster.Workspace(), threads=2
    )
    assert len(frame.bins.bands) > 5
    assert np.array_equal(frame.image, whole)
