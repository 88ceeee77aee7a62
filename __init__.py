"""3D Gaussian splats from scripts and notebooks: read, render, edit, train, write; see docs/python.md.

Names are imported when they are first used, so that `import splatview` takes milliseconds and needs neither
numba nor torch.
"""

from __future__ import annotations

TYPE_CHECKING = False
"""What type checkers take for true; its module is not imported, as nothing takes care of Ctrl-C before the
command has begun."""

if TYPE_CHECKING:
    from typing import Any

    from splatview.edit.recipe import Recipe as Recipe
    from splatview.edit.recipe import load_recipe as load_recipe
    from splatview.renderers.conversion import Conversion as Conversion
    from splatview.renderers.conversion import convert as convert
    from splatview.renderers.headless import make_headless as make_headless
    from splatview.renderers.scripting import apply_recipe as apply_recipe
    from splatview.renderers.scripting import render as render
    from splatview.scene import Camera as Camera
    from splatview.scene import Gaussians as Gaussians
    from splatview.scene import ImageModel as ImageModel
    from splatview.scene import InputError as InputError
    from splatview.scene import RenderSettings as RenderSettings
    from splatview.scene import concatenate as concatenate
    from splatview.scene import look_at as look_at
    from splatview.scene.formats import load_cameras as load_cameras
    from splatview.scene.formats import load_scene as load_scene
    from splatview.scene.formats import save_scene as save_scene
    from splatview.scene.framing import frame_camera as frame_camera
    from splatview.trainer.counters import PluginError as PluginError
    from splatview.trainer.setup import TrainedScene as TrainedScene
    from splatview.trainer.setup import train as train

MODULE_OF = {
    "Camera": "scene",
    "Conversion": "renderers.conversion",
    "Gaussians": "scene",
    "ImageModel": "scene",
    "InputError": "scene",
    "PluginError": "trainer.counters",
    "Recipe": "edit.recipe",
    "RenderSettings": "scene",
    "TrainedScene": "trainer.setup",
    "apply_recipe": "renderers.scripting",
    "concatenate": "scene",
    "convert": "renderers.conversion",
    "frame_camera": "scene.framing",
    "load_cameras": "scene.formats",
    "load_recipe": "edit.recipe",
    "load_scene": "scene.formats",
    "look_at": "scene",
    "make_headless": "renderers.headless",
    "render": "renderers.scripting",
    "save_scene": "scene.formats",
    "train": "trainer.setup",
}
"""Public name -> module of splatview that has it."""


def __getattr__(name: str) -> Any:
    if name not in MODULE_OF:
        raise AttributeError(f"module 'splatview' has no attribute {name!r}")
    from importlib import import_module

    value = globals()[name] = getattr(import_module(f"splatview.{MODULE_OF[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *MODULE_OF})
