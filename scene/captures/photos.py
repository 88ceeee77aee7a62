"""A photo's file to the pixels that are trained on: decoded, perhaps undistorted, masked and downscaled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image

from splatview.scene.captures.capture import LensUse, MaskUse, Pixels, PosedPhoto
from splatview.scene.captures.resample import (
    ROWS_AT_ONCE,
    area_averaged,
    face_of,
    pixels_that_see,
    undistorted,
    wholly_valid,
)
from splatview.scene.errors import InputError
from splatview.scene.formats.io import open_image

# ---- Which way up a photo is: cameras store pixels as the sensor lies, and note in EXIF how they were held.
#
# Poses are found on the stored pixels: COLMAP does not turn photos (so that those of one camera share its
# lens however it was held; its issue 2104), nor do the programs that build on it. Some others turn them
# first; their cameras are then of the turned photo's size.


_TO_UPRIGHT = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
"""By EXIF's number (CIPA DC-008, "Orientation"); 1 is upright already."""

_TO_STORED = _TO_UPRIGHT | {6: Image.Transpose.ROTATE_90, 8: Image.Transpose.ROTATE_270}

_SIDEWAYS = (5, 6, 7, 8)


def stored_size(image: Image.Image) -> tuple[int, int]:
    """Width and height of the pixels as they are stored, of an image that is open but not decoded."""
    width, height = image.size
    return (
        (height, width)
        if _is_turned_by_pillow(image) and _orientation(image) in _SIDEWAYS
        else (width, height)
    )


LEAST_FACTOR = 1.05
"""Between a photo and a copy. What differs by less may be a photo whose lens was taken out and one where it
was not, which no factor makes alike; taking out a lens that changes more does not change both ways alike."""


def are_copies(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether two sizes, px, differ by one factor, LEAST_FACTOR or more; to a pixel each way, for it is
    rounded up or down."""
    small, large = sorted((one, other))
    if not min(small) >= 2:
        return False
    least = max(big / (little + 1) for little, big in zip(small, large, strict=True))
    most = min(big / (little - 1) for little, big in zip(small, large, strict=True))
    return least < most and large[0] >= LEAST_FACTOR * small[0]


def as_posed(image: Image.Image, size: tuple[int, int]) -> Image.Image:
    """The image as it is stored, or, where only that is (width, height) `size`, the way up that EXIF says.

    `image` is open but not decoded. The result may be of another size still.
    """
    orientation, turned = _orientation(image), _is_turned_by_pillow(image)
    image.load()
    if orientation not in _TO_UPRIGHT:
        return image
    other = image.transpose((_TO_STORED if turned else _TO_UPRIGHT)[orientation])
    stored, upright = (other, image) if turned else (image, other)
    return upright if stored.size != size and upright.size == size else stored


def _is_turned_by_pillow(image: Image.Image) -> bool:
    """Pillow turns TIFFs as it decodes them, and nothing else."""
    return image.format == "TIFF"


def _orientation(image: Image.Image) -> int:
    try:
        return int(image.getexif().get(ExifTags.Base.Orientation, 1))
    except Exception:
        # Damaged EXIF raises nearly anything, and leaves the pixels whole.
        return 1


MASK_THRESHOLD = 128
"""Of 255: darker pixels of a mask are ignored. Masks saved as JPEG have no clean black."""


@dataclass(frozen=True, eq=False)
class Decoded:
    rgb: np.ndarray
    """(H, W, 3) uint8, laid over the background where it is transparent."""
    alpha: np.ndarray | None = None
    """(H, W) uint8; None where it is opaque everywhere."""
    smaller: int = 1
    """By what the decoder has made it smaller each way, edges rounded up."""


def image_size(path: Path) -> tuple[int, int]:
    """Width and height by the file's header, as the pixels are stored. Raises InputError."""
    try:
        with open_image(path) as image:
            return stored_size(image)
    except Exception as error:
        raise _undecodable(path, error) from None


def downscaled_size(width: int, height: int, downscale: int) -> tuple[int, int]:
    return width // downscale, height // downscale


def read_pixels(
    entry: PosedPhoto,
    downscale: int,
    background: tuple[float, float, float],
    lens: LensUse,
    masks: MaskUse = "ignore",
) -> Pixels:
    """The photo as it is trained on. Raises InputError."""
    return read_file([entry], downscale, background, lens, masks)[0]


def read_file(
    entries: Sequence[PosedPhoto],
    downscale: int,
    background: tuple[float, float, float],
    lens: LensUse,
    masks: MaskUse = "ignore",
) -> list[Pixels]:
    """The photos of one file as they are trained on: one, or faces of a panorama. Raises InputError."""
    # Numbers out of all bounds put a pixel nowhere, which is no pixel of the photo. Here, as each thread that
    # reads has its own state of errors.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if entries[0].face is not None:
            return _read_faces(entries, downscale, background, masks)
        return [_read_pixels(entry, downscale, background, lens, masks) for entry in entries]


@dataclass(frozen=True, eq=False)
class Shown:
    """What a file shows, with its mask."""

    image: np.ndarray
    """(H, W, 3) uint8."""
    alpha: np.ndarray | None
    """(H, W) uint8; None where it is opaque everywhere."""
    mask: np.ndarray | None
    """(h, w) bool, of the whole file's size: which pixels count; None where all do, or masks cut out."""
    smaller: int
    """By what `image` is smaller each way, edges rounded up."""


def _shown(
    entry: PosedPhoto,
    size: tuple[int, int],
    background: tuple[float, float, float],
    masks: MaskUse,
    smaller: int,
) -> Shown:
    """Of a file of (width, height) `size`, which may be `smaller` by that much. Raises InputError."""
    cuts = masks == "cut-out" and entry.mask is not None
    # Masks are of the whole photo's pixels.
    decoded = _decode(entry.path, size, background, 1 if cuts else smaller)
    image, alpha = decoded.rgb, decoded.alpha
    mask = None if entry.mask is None else _decode_mask(entry.mask, size)
    if cuts and mask is not None:
        (image, alpha), mask = _cut_out(image, alpha, mask, background), None
    return Shown(image, alpha, mask, decoded.smaller)


def _read_pixels(
    entry: PosedPhoto,
    downscale: int,
    background: tuple[float, float, float],
    lens: LensUse,
    masks: MaskUse,
) -> Pixels:
    size = entry.camera.width, entry.camera.height
    undistorts = entry.camera.lens is not None and lens == "undistort"
    # At most as much smaller by the decoder as by averaging after it, which cuts off less. At half the size,
    # averages of 2x2 differ from averages of all of 4x4 by 42 and 46 dB (photos of `miku` and `banana`), of
    # 4x4 by 45 and 52; by quarters and 2x2 it is 39 and 37. A photo of 12 megapixels takes 0.035 s of a
    # processor in place of 0.16. Lenses are of the whole photo's pixels.
    shown = _shown(entry, size, background, masks, 1 if undistorts else math.isqrt(downscale))
    image, alpha, mask = shown.image, shown.alpha, shown.mask
    if undistorts:
        # The mask goes along as a fourth channel: all of a pixel's sources must be white for it to count.
        image, valid = undistorted(_with_mask(image, mask), entry.camera)
        if mask is not None:
            valid &= image[..., 3] == 255
        if alpha is not None:
            alpha = undistorted(alpha[..., None], entry.camera)[0][..., 0]
        image, mask = image[..., :3], valid
    width, height = downscaled_size(*size, downscale)
    extent = size[0] / shown.smaller, size[1] / shown.smaller
    image = area_averaged(image, width, height, extent)
    if alpha is not None:
        alpha = area_averaged(alpha[..., None], width, height)[..., 0]
    if mask is not None:
        mask = wholly_valid(mask, width, height)
    if entry.camera.lens is not None and lens == "through":
        seen = pixels_that_see(entry.camera.resized(width, height))
        mask = seen if mask is None or seen is None else mask & seen
    return _pixels(image, mask, alpha)


def _read_faces(
    entries: Sequence[PosedPhoto],
    downscale: int,
    background: tuple[float, float, float],
    masks: MaskUse,
) -> list[Pixels]:
    """Faces of one panorama, cut from it at a whole number of times their final size."""
    first = entries[0]
    shown = _shown(first, image_size(first.path), background, masks, math.isqrt(downscale))
    mask = shown.mask
    if mask is not None and shown.smaller > 1:
        mask = wholly_valid(mask, shown.image.shape[1], shown.image.shape[0])
    channels = _with_mask(shown.image, mask)
    found = []
    for entry in entries:
        face, size = entry.face or "", entry.camera.width
        side, _ = downscaled_size(size, size, downscale)
        larger = side * max(round(size / shown.smaller / side), 1)
        image, alpha, valid = face_of(channels, face, larger), shown.alpha, None
        if mask is not None:
            valid = wholly_valid(image[..., 3] == 255, side, side)
        if alpha is not None:
            alpha = area_averaged(face_of(alpha[..., None], face, larger), side, side)[..., 0]
        found.append(_pixels(area_averaged(image[..., :3], side, side), valid, alpha))
    return found


def _with_mask(image: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """(H, W, 3) uint8, or (H, W, 4) with the mask (H, W), 255 where it is true."""
    if mask is None:
        return image
    return np.concatenate([image, np.where(mask, 255, 0).astype(np.uint8)[..., None]], axis=2)


def _pixels(image: np.ndarray, mask: np.ndarray | None, alpha: np.ndarray | None) -> Pixels:
    image = np.ascontiguousarray(image)
    alpha = None if alpha is None else np.ascontiguousarray(alpha)
    mask = None if mask is None or mask.all() else mask
    for array in (image, mask, alpha):
        if array is not None:
            array.flags.writeable = False
    return Pixels(image=image, mask=mask, alpha=alpha)


def _cut_out(
    image: np.ndarray, alpha: np.ndarray | None, mask: np.ndarray, background: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray | None]:
    """The photo, written over with the background where the mask (H, W) is false, and its opacity."""
    if mask.all():
        return image, alpha
    empty, behind = ~mask, (np.array(background) * 255 + 0.5).astype(np.uint8)
    # Colour by colour: 0.04 s of a processor in place of 0.3 (np.where over all) for 5184x3888 px.
    for colour in range(3):
        image[..., colour][empty] = behind[colour]
    return image, mask * np.uint8(255) if alpha is None else np.where(mask, alpha, 0).astype(np.uint8)


def _decode(
    path: Path, size: tuple[int, int], background: tuple[float, float, float], smaller: int = 1
) -> Decoded:
    """The file's pixels. A JPEG of the (width, height) `size` is decoded at once at a half, a quarter or an
    eighth of it, where it may be `smaller` by that much."""
    scale = 1
    try:
        with open_image(path) as file:
            _check_header(path, file, size)
            if file.format == "JPEG" and file.size == size:
                file.draft(None, (size[0] // smaller, size[1] // smaller))
                scale, size = round(size[0] / file.size[0]), file.size
            image = as_posed(file, size)
            _check_size(path, image.size, size)
            if image.mode in ("I", "I;16", "I;16B", "I;16L", "F"):
                return Decoded(_deep_grey(np.asarray(image)))
            if not (image.mode in ("RGBA", "LA", "PA", "RGBa", "La") or "transparency" in image.info):
                return Decoded(
                    np.array(image if image.mode == "RGB" else image.convert("RGB")), smaller=scale
                )
            rgba = np.array(image.convert("RGBA"))
    except Exception as error:
        raise _undecodable(path, error) from None
    rgb = np.empty((*rgba.shape[:2], 3), np.uint8)
    behind = np.array(background, dtype=np.float32) * 255
    # By rows: as a whole, the float32 of a photo would be 20 times its file's pixels. Colour by colour: numpy
    # takes 3.3 times as long for all of a pixel beside one another (800x800 px, in turn on an AMD EPYC).
    for top in range(0, len(rgba), ROWS_AT_ONCE):
        rows = slice(top, top + ROWS_AT_ONCE)
        opacity = rgba[rows, :, 3].astype(np.float32) / 255
        rest = 1 - opacity
        for colour in range(3):
            rgb[rows, :, colour] = rgba[rows, :, colour] * opacity + behind[colour] * rest + np.float32(0.5)
    alpha = rgba[..., 3]
    return Decoded(rgb, alpha.copy() if (alpha < 255).any() else None)


def _deep_grey(values: np.ndarray) -> np.ndarray:
    """16-bit grey, of which Pillow would only keep what fits in 8 bits, to RGB. Floats of at most 1 are
    shares of white."""
    levels = 255.0 if values.dtype.kind == "f" and values.max(initial=0) <= 1 else 1 / 257
    rgb = np.empty((*values.shape, 3), np.uint8)
    for top in range(0, len(values), ROWS_AT_ONCE):
        rows = slice(top, top + ROWS_AT_ONCE)
        rgb[rows] = np.clip(values[rows, :, None].astype(np.float64) * levels + 0.5, 0, 255.5)
    return rgb


def _decode_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    try:
        with open_image(path) as file:
            stored = stored_size(file)
            if not are_copies(stored, size):
                _check_header(path, file, size)
            image = as_posed(file, size)
            if not are_copies(image.size, size):
                _check_size(path, image.size, size)
            # Cut-outs: what is transparent is ignored, whatever colour lies under it.
            transparent = "A" in image.getbands() and image.getextrema()[-1] != (255, 255)
            shown = image.getchannel("A") if transparent else image.convert("L")
            shown = shown if shown.size == size else shown.resize(size, Image.Resampling.BOX)
            return np.asarray(shown) >= MASK_THRESHOLD
    except Exception as error:
        raise _undecodable(path, error) from None


def _undecodable(path: Path, error: Exception) -> InputError:
    if isinstance(error, InputError):
        return error
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


def _check_size(path: Path, found: tuple[int, int], wanted: tuple[int, int]) -> None:
    if found != wanted:
        raise _wrong_size(path, found, wanted)


def _wrong_size(path: Path, found: tuple[int, int], wanted: tuple[int, int]) -> InputError:
    return InputError(
        f"{path}: is {found[0]}x{found[1]} pixels, but its camera says {wanted[0]}x{wanted[1]}; "
        "use the images that the poses were found with"
    )
