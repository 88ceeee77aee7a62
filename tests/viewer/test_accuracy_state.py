"""What a measurement does when the scene changes under it."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from splatview.measure.knobs import Plan
from splatview.measure.ladder import Ladder, Measured, Rung
from splatview.renderers.quality import worst_error
from splatview.scene import Camera, RenderSettings, look_at
from splatview.scene.framing import views_around
from splatview.scene.progress import Cancelled
from splatview.viewer.quality.measurement import Measurement, WindowScene
from splatview.viewer.state import AppState

CAMERA = look_at((0, 0, -3), (0, 0, 0), width=24, height=16)


@pytest.fixture
def opened(app, random_gaussians, wait_for_loading, tmp_path) -> AppState:
    from splatview.scene.formats import save_scene
    from splatview.viewer.open import open_paths

    save_scene(random_gaussians(50), tmp_path / "a.ply")
    open_paths(app, [tmp_path / "a.ply"])
    wait_for_loading(app)
    return app


def asked(app: AppState, scene: WindowScene) -> list[str]:
    """How a picture ends that another thread asks for while frames go by."""
    ends: list[str] = []

    def ask() -> None:
        try:
            scene.draw(CAMERA, Plan())
            ends.append("drawn")
        except Cancelled:
            ends.append("cancelled")
        except Exception as error:
            ends.append(repr(error))

    asking = threading.Thread(target=ask)
    asking.start()
    while asking.is_alive():
        app.run_posted()
        asking.join(0.01)
    return ends


def test_a_picture_of_the_open_scene(opened) -> None:
    assert asked(opened, WindowScene(opened, lambda: False, lambda: None)) == ["drawn"]


def test_another_scene_cancels(opened, random_gaussians) -> None:
    scene = WindowScene(opened, lambda: False, lambda: None)
    opened.scene = replace(opened.scene, gaussians=random_gaussians(20))
    assert asked(opened, scene) == ["cancelled"]


def test_a_failure_is_told_only_of_the_open_scene(opened, random_gaussians, monkeypatch) -> None:
    scene = WindowScene(opened, lambda: False, lambda: None)

    def fail(*_, **__):
        raise ValueError("50 marks for a scene of 20 splats")

    monkeypatch.setattr(opened.picture, "read", fail, raising=False)
    assert "50 marks" in asked(opened, scene)[0]

    def overtaken(*_, **__):
        opened.scene = replace(opened.scene, gaussians=random_gaussians(20))
        fail()

    monkeypatch.setattr(opened.picture, "read", overtaken, raising=False)
    assert asked(opened, scene) == ["cancelled"]


def test_shortcuts_are_compared_in_views_from_around_too(opened) -> None:
    """A shortcut that shows nothing in the view measured, and is off by 0.1 and 0.2 elsewhere."""
    errors = {0: 0.0, 1: 0.1, 2: 0.2, 3: 0.1}
    views = views_around(CAMERA, opened.scene.gaussians)
    coarse = Plan(settings=RenderSettings(sh_degree=0))

    def draw(camera: Camera, plan: Plan, *, anew: bool = False) -> tuple[np.ndarray, float]:
        (place,) = (n for n, view in enumerate(views) if view.same_view(camera))
        return np.full((4, 4, 4), 0.5 + errors[place] * (plan is coarse)), 1.0

    scene: Any = SimpleNamespace(name="quads", draw=draw, turned=None)
    rung = Rung(knob="sh-degree", value="0", renderer=scene, plan=coarse, options=())
    one = Measured(rung=rung, psnr=90.0)
    measuring: Any = SimpleNamespace(
        camera=CAMERA,
        gaussians=opened.scene.gaussians,
        cancelled=False,
        _scene=scene,
        _plan=Plan(),
        _seconds=60,
    )
    ladder = Ladder(baseline=one, rungs=(one,), noise=0, views=1, rounds=1, complete=True)
    assert Measurement._look_around(measuring, ladder)
    assert one.elsewhere == pytest.approx([20.0, 13.98, 20.0], abs=0.01)
    assert worst_error(one) == pytest.approx(0.04)
