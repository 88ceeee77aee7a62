"""What a splat scene is: arrays, cameras, the image model and its float64 truth. numpy only."""

from .camera import Camera, look_at, look_at_matrix
from .errors import InputError
from .gaussians import Gaussians, concatenate
from .image_model import TEXTBOOK, ImageModel, RenderSettings
from .lens import Lens

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
