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
