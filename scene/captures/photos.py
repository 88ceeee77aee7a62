"""A photo's file to the pixels that are trained on: decoded, perhaps undistorted, masked and downscaled."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from ..errors import InputError
from .capture import LensUse, Pixels
from .orientation import as_posed, stored_size
from .posed import Shot
from .resample import area_averaged, pixels_that_see, undistorted, wholly_valid

MASK_THRESHOLD = 128
"""Of 255: darker pixels of a mask are ignored. Masks saved as JPEG have no clean black."""


@dataclass(frozen=True, eq=False)
class Decoded:
    rgb: np.ndarray
    """(H, W, 3) uint8."""
    is_transparent: bool
    """It was laid over the background somewhere."""


def image_size(path: Path) -> tuple[int, int]:
    """Width and height by the file's header, as the pixels are stored. Raises InputError."""
    try:
        with Image.open(path) as image:
            return stored_size(image)
    except Exception as error:
        raise _undecodable(path, error) from None


def downscaled_size(width: int, height: int, downscale: int) -> tuple[int, int]:
    return width // downscale, height // downscale


def read_pixels(
    shot: Shot, downscale: int, background: tuple[float, float, float], lens: LensUse
) -> tuple[Pixels, bool]:
    """The photo as it is trained on, and whether any of the background shows in it. Raises InputError."""
    # Numbers out of all bounds put a pixel nowhere, which is no pixel of the photo. Here, as each thread that
    # reads has its own state of errors.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return _read_pixels(shot, downscale, background, lens)


def _read_pixels(
    shot: Shot, downscale: int, background: tuple[float, float, float], lens: LensUse
) -> tuple[Pixels, bool]:
    size = shot.camera.width, shot.camera.height
    decoded = _decode(shot.path, size, background)
    _check_size(shot.path, decoded.rgb, *size)
    image, mask = decoded.rgb, None
    if shot.mask is not None:
        mask = _decode_mask(shot.mask, size)
        _check_size(shot.mask, mask, *size)
    if shot.camera.lens is not None and lens == "undistort":
        # The mask goes along as a fourth channel: all of a pixel's sources must be white for it to count.
        channels = [image] if mask is None else [image, np.where(mask, 255, 0).astype(np.uint8)[..., None]]
        image, valid = undistorted(np.concatenate(channels, axis=2), shot.camera)
        if mask is not None:
            valid &= image[..., 3] == 255
        image, mask = image[..., :3], valid
    width, height = downscaled_size(*size, downscale)
    image = np.ascontiguousarray(area_averaged(image, width, height))
    image.flags.writeable = False
    if mask is not None:
        mask = wholly_valid(mask, width, height)
    if shot.camera.lens is not None and lens == "through":
        seen = pixels_that_see(shot.camera.resized(width, height))
        mask = seen if mask is None or seen is None else mask & seen
    if mask is not None:
        mask.flags.writeable = False
        mask = None if mask.all() else mask
    return Pixels(image=image, mask=mask), decoded.is_transparent


def _decode(path: Path, size: tuple[int, int], background: tuple[float, float, float]) -> Decoded:
    try:
        with Image.open(path) as file:
            _check_header(path, file, size)
            image = as_posed(file, size)
            if image.mode in ("I", "I;16", "I;16B", "I;16L", "F"):
                return Decoded(_deep_grey(np.asarray(image)), False)
            if not (image.mode in ("RGBA", "LA", "PA", "RGBa", "La") or "transparency" in image.info):
                return Decoded(np.array(image.convert("RGB")), False)
            rgba = np.array(image.convert("RGBA"))
    except InputError:
        raise
    except Exception as error:
        raise _undecodable(path, error) from None
    opacity = rgba[..., 3:].astype(np.float32) / 255
    over = rgba[..., :3] * opacity + np.array(background, dtype=np.float32) * 255 * (1 - opacity)
    return Decoded((over + 0.5).astype(np.uint8), bool((opacity < 1).any()))


def _deep_grey(values: np.ndarray) -> np.ndarray:
    """16-bit grey, of which Pillow would only keep what fits in 8 bits, to RGB."""
    grey = np.clip(values.astype(np.float64) / 257 + 0.5, 0, 255.5).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def _decode_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    try:
        with Image.open(path) as file:
            _check_header(path, file, size)
            image = as_posed(file, size)
            if "A" in image.getbands() and image.getextrema()[-1] != (255, 255):
                # Cut-outs: what is transparent is ignored, whatever colour lies under it.
                return np.asarray(image.getchannel("A")) >= MASK_THRESHOLD
            return np.asarray(image.convert("L")) >= MASK_THRESHOLD
    except InputError:
        raise
    except Exception as error:
        raise _undecodable(path, error) from None


def _undecodable(path: Path, error: Exception) -> InputError:
    # Decoders of damaged files raise nearly anything: OSError, SyntaxError, struct.error, ValueError...
    reason = str(error).partition("\n")[0].replace(str(path), "file").replace(repr(str(path)), "file")
    return InputError(f"{path}: is no readable image ({reason}); replace it or take it out of the capture")


def _check_header(path: Path, image: Image.Image, size: tuple[int, int]) -> None:
    """That the file says to have the pixels that its camera has, before memory is taken for them.

    A damaged header of some bytes may promise a gigabyte.
    """
    stored = stored_size(image)
    if size not in (stored, stored[::-1]):
        raise _wrong_size(path, stored, size)


def _check_size(path: Path, image: np.ndarray, width: int, height: int) -> None:
    if image.shape[:2] != (height, width):
        raise _wrong_size(path, (image.shape[1], image.shape[0]), (width, height))


def _wrong_size(path: Path, found: tuple[int, int], wanted: tuple[int, int]) -> InputError:
    return InputError(
        f"{path}: is {found[0]}x{found[1]} pixels, but its camera says {wanted[0]}x{wanted[1]}; "
        "use the images that the poses were found with"
    )
