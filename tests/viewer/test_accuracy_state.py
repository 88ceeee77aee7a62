"""What a measurement does when the scene changes under it."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest

from splatview.measure.knobs import Plan
from splatview.scene import look_at
from splatview.scene.progress import Cancelled
from splatview.viewer.quality.measurement import WindowScene
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
