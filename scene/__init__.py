"""What a splat scene is: arrays, cameras, the image model and its float64 truth. numpy only."""

from splatview.scene.camera import Camera, look_at, look_at_matrix
from splatview.scene.errors import InputError
from splatview.scene.gaussians import Gaussians, concatenate
from splatview.scene.image_model import TEXTBOOK, ImageModel, RenderSettings
from splatview.scene.lens import Lens

__all__ = [
    "TEXTBOOK",
    "Camera",
    "Gaussians",
    "ImageModel",
    "InputError",
    "Lens",
    "RenderSettings",
    "concatenate",
    "look_at",
    "look_at_matrix",
]
