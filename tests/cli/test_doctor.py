"""What `splatview doctor` finds: renderers that draw, and what is missing where they do not."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.cli import doctor
from splatview.renderers.request import FrameRequest
from splatview.scene import reference


class Drawing:
    """A renderer that draws the right picture, of the views that `blank` does not count."""

    def __init__(self, blank: tuple[int, ...], value: float) -> None:
        self._blank, self._value, self._drawn = blank, value, 0

    def render(self, request: FrameRequest) -> np.ndarray:
        self._drawn += 1
        assert request.gaussians is not None
        picture = reference.render(request.gaussians, request.camera, request.settings)
        return np.full_like(picture, self._value) if self._drawn in self._blank else picture


@pytest.mark.parametrize(
    ("blank", "value", "works"),
    [((), 0.0, True), ((1,), 0.0, False), ((2,), 0.0, False), ((2,), np.nan, False)],
)
def test_a_renderer_works_if_it_draws_two_views(monkeypatch, blank, value, works):
    monkeypatch.setattr(doctor, "make_headless", lambda name: Drawing(blank, value))
    found = doctor.tried("tiles")
    assert found["works"] is works
    assert ("within" in found["why"]) is works


def findings(**gl: object) -> dict:
    found = {
        "works": True,
        "renderer": "llvmpipe",
        "version": "4.5",
        "compute": True,
        "software": True,
        "lacking": None,
        "unused_gpu": None,
        "float16_blending": "rounds",
        "background_compiling": {"works": True, "why": "it does"},
    }
    return {
        "splatview": "1",
        "python": "3",
        "system": "s",
        "cores": 1,
        "display": "none",
        "libraries": dict.fromkeys(name for name, _ in doctor.LIBRARIES),
        "gl": {**found, **gl},
        "renderers": {},
        "auto": {"renderer": "cpu", "why": "because"},
    }


def test_what_is_missing_is_named_and_what_falls_back():
    assert "\nmissing " not in doctor.as_text(findings())
    text = doctor.as_text(findings(compute=False, lacking="OpenGL is 3.3, 4.3 is needed"))
    assert "missing    OpenGL is 3.3, 4.3 is needed: quads takes its OpenGL 3.3 path, tiles cannot" in text
    assert "missing    do this" in doctor.as_text(findings(unused_gpu="do this"))


def test_only_training_needs_torch():
    (line,) = (line for line in doctor.as_text(findings()).splitlines() if line.startswith("torch"))
    assert "missing; only for training" in line
    (line,) = (line for line in doctor.as_text(findings()).splitlines() if line.startswith("safetensors"))
    assert "MISSING: pip install safetensors" in line
