"""A photo's file to the pixels that are trained on: decoded, perhaps undistorted, masked and downscaled."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image

from splatview.scene.camera import Camera
from splatview.scene.captures.capture import LensUse, MaskUse, Pixels, PosedPhoto
from splatview.scene.errors import InputError
from splatview.scene.formats.io import open_image
from splatview.scene.lens import FISHEYE_RADIUS, Lens, distort, undistort

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


# ---- Photos through a pinhole and at another size: undistortion and averaging by area.
#
# Where photos are to look as a pinhole would have taken them, their distortion is taken out once, when they
# are loaded. What that costs was measured on pictures of a demo scene, 750x498, taken through a lens that
# shifts pixels by up to 13 (k1 = -0.05) or 40 (k1 = -0.15) and brought back: PSNR against the pinhole's
# picture is 45.3 and 44.2 dB at full size, 49.4 and 48.4 dB after downscaling by 2, 54.7 and 54.0 dB by 4,
# where trained scenes reach 25 to 35 dB; leaving the distortion in gives 26.2 and 21.8 dB. It takes some
# 0.1 s a megapixel on one core, once. What lies outside the pinhole's frame is lost, which is why training
# through the lens is better where a lens bends much.


ROWS_AT_ONCE = 64
"""Rows of an undistorted photo worked on together: bounds the memory for its coordinates."""


def undistorted(image: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The photo as a pinhole of the same size, focal lengths and principal point would have taken it.

    image: (H, W, C) uint8, C <= 4. Returns (H, W, C) uint8, and (H, W) bool: which pixels the photo covers.
    Bilinear. The same focal lengths keep the scale at the centre; what a barrel-shaped photo shows beyond
    the frame is lost, and what it does not reach is False.
    """
    height, width, channels = image.shape
    # A pixel in one 32-bit word: a gather fetches all channels at once, 1.3 times as fast in all.
    words = np.zeros((height, width, 4), dtype=np.uint8)
    words[..., :channels] = image
    flat = words.view(np.uint32).ravel()
    right, down = int(width > 1), width if height > 1 else 0
    out = np.zeros_like(words)
    valid = np.zeros((height, width), dtype=bool)

    def at(indices: np.ndarray) -> np.ndarray:
        return flat.take(indices).view(np.uint8).reshape(-1, 4).astype(np.float32)

    u = (np.arange(width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(height) + 0.5 - camera.cy) / camera.fy
    lens = camera.lens or Lens(model="PINHOLE")
    for top in range(0, height, ROWS_AT_ONCE):
        rows = slice(top, min(top + ROWS_AT_ONCE, height))
        rays = np.stack(np.broadcast_arrays(u[None, :], v[rows, None]), axis=-1)
        there = distort(rays, lens)
        # From pixel centres: 0 is the middle of the first pixel.
        x = there[..., 0] * camera.fx + camera.cx - 0.5
        y = there[..., 1] * camera.fy + camera.cy - 0.5
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        if np.isfinite(lens.valid_radius):
            inside &= np.hypot(rays[..., 0], rays[..., 1]) < lens.valid_radius
        valid[rows] = inside
        x, y = x[inside].astype(np.float32), y[inside].astype(np.float32)
        left = np.clip(x.astype(np.int64), 0, max(width - 2, 0))
        upper = np.clip(y.astype(np.int64), 0, max(height - 2, 0))
        ax, ay = (x - left)[:, None], (y - upper)[:, None]
        first = upper * width + left
        above, below = at(first), at(first + down)
        above += (at(first + right) - above) * ax
        below += (at(first + down + right) - below) * ax
        above += (below - above) * ay
        out[rows][inside] = (above + 0.5).astype(np.uint8)
    return out[..., :channels], valid


def pixels_that_see(camera: Camera) -> np.ndarray | None:
    """(H, W) bool: pixels that the lens shows something at, which corners of a fisheye's picture often are
    not; None where all are."""
    lens = camera.lens
    border = camera.visible_slopes
    if lens is None or not max(map(abs, border)) >= min(lens.valid_radius, FISHEYE_RADIUS):
        return None
    return _pixels_that_see(
        lens, camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
    ).copy()


@lru_cache(maxsize=16)
def _pixels_that_see(
    lens: Lens, width: int, height: int, fx: float, fy: float, cx: float, cy: float
) -> np.ndarray:
    seen = np.empty((height, width), dtype=bool)
    x, y = (np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy
    for top in range(0, height, ROWS_AT_ONCE):
        rows = slice(top, min(top + ROWS_AT_ONCE, height))
        points = np.stack(np.broadcast_arrays(x[None, :], y[rows, None]), axis=-1)
        seen[rows] = np.isfinite(undistort(points, lens)).all(axis=-1)
    return seen


def area_averaged(
    image: np.ndarray, width: int, height: int, extent: tuple[float, float] | None = None
) -> np.ndarray:
    """(H, W, C) uint8 -> (height, width, C) uint8, no larger than it was: each pixel is the mean of the area
    that it covers, pixels of the edge in parts. `extent`: what there is of the image in its pixels (x, y),
    where the last ones reach beyond."""
    if image.shape[:2] == (height, width):
        return image
    x, y = extent or (image.shape[1], image.shape[0])
    factor = image.shape[1] // width
    if image.shape[:2] == (y, x) == (factor * height, factor * width):
        return _averaged_by(factor, image)
    rows = _average_rows(image, height, y)
    columns = _average_rows(np.ascontiguousarray(rows.transpose(1, 0, 2)), width, x)
    return (columns.transpose(1, 0, 2) + 0.5).astype(np.uint8)


def wholly_valid(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W) bool -> (height, width) bool: True where all of the area is."""
    ignored = area_averaged(np.where(mask, 0, 255).astype(np.uint8)[..., None], width, height)[..., 0]
    if mask.shape == (height, width):
        return mask
    # A part below 1/510 of a pixel's area rounds to nothing, as it does in the colour.
    return ignored == 0


def _averaged_by(factor: int, image: np.ndarray) -> np.ndarray:
    """(H, W, C) uint8 -> (H / factor, W / factor, C) uint8, where both are whole: by whole numbers, the same
    as by areas. RGB of 16 megapixels takes 0.05 s in place of 0.15 by a factor of four, grey levels 0.016 in
    place of 0.09. (Dropped: `Image.reduce`, as fast, but a tenth of a level too dark by three.)"""
    rows = image[::factor].astype(np.uint32 if factor > MOST_ROWS else np.uint16)
    for i in range(1, factor):
        rows += image[i::factor]
    sums = rows[:, ::factor].astype(np.uint32)
    for i in range(1, factor):
        sums += rows[:, i::factor]
    return (sums / np.float32(factor**2) + np.float32(0.5)).astype(np.uint8)


def _average_rows(image: np.ndarray, count: int, extent: float) -> np.ndarray:
    """(H, W, C) -> (count, W, C) float32, of the first `extent` rows."""
    height = len(image)
    flat = image.reshape(height, -1)
    out = np.empty((count, flat.shape[1]), dtype=np.float32)
    edges = np.arange(count + 1) * (extent / count)
    for i in range(count):
        first = min(int(edges[i]), height - 1)
        last = min(int(np.ceil(edges[i + 1] - 1e-9)), height)
        covered = np.minimum(np.arange(first, last) + 1, edges[i + 1]) - np.maximum(
            np.arange(first, last), edges[i]
        )
        weights = (covered / covered.sum()).astype(np.float32)
        out[i] = weights @ flat[first:last].astype(np.float32)
    return out.reshape(count, *image.shape[1:])


MOST_ROWS = 257
"""Pixels whose sum 16 bits hold."""

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
    # Numbers out of all bounds put a pixel nowhere, which is no pixel of the photo. Here, as each thread that
    # reads has its own state of errors.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return _read_pixels(entry, downscale, background, lens, masks)


def _read_pixels(
    entry: PosedPhoto,
    downscale: int,
    background: tuple[float, float, float],
    lens: LensUse,
    masks: MaskUse,
) -> Pixels:
    size = entry.camera.width, entry.camera.height
    cuts, undistorts = masks == "cut-out", entry.camera.lens is not None and lens == "undistort"
    # Masks and lenses are of the whole photo's pixels.
    whole = undistorts or (cuts and entry.mask is not None)
    # At most as much smaller by the decoder as by averaging after it, which cuts off less. At half the size,
    # averages of 2x2 differ from averages of all of 4x4 by 42 and 46 dB (photos of `miku` and `banana`), of
    # 4x4 by 45 and 52; by quarters and 2x2 it is 39 and 37. A photo of 12 megapixels takes 0.035 s of a
    # processor in place of 0.16.
    decoded = _decode(entry.path, size, background, 1 if whole else math.isqrt(downscale))
    image, alpha, mask = decoded.rgb, decoded.alpha, None
    if entry.mask is not None:
        mask = _decode_mask(entry.mask, size)
        if cuts:
            image, alpha = _cut_out(image, alpha, mask, background)
            mask = None
    if undistorts:
        # The mask goes along as a fourth channel: all of a pixel's sources must be white for it to count.
        channels = [image] if mask is None else [image, np.where(mask, 255, 0).astype(np.uint8)[..., None]]
        image, valid = undistorted(np.concatenate(channels, axis=2), entry.camera)
        if mask is not None:
            valid &= image[..., 3] == 255
        if alpha is not None:
            alpha = undistorted(alpha[..., None], entry.camera)[0][..., 0]
        image, mask = image[..., :3], valid
    width, height = downscaled_size(*size, downscale)
    extent = size[0] / decoded.smaller, size[1] / decoded.smaller
    image = np.ascontiguousarray(area_averaged(image, width, height, extent))
    image.flags.writeable = False
    if alpha is not None:
        alpha = np.ascontiguousarray(area_averaged(alpha[..., None], width, height)[..., 0])
        alpha.flags.writeable = False
    if mask is not None:
        mask = wholly_valid(mask, width, height)
    if entry.camera.lens is not None and lens == "through":
        seen = pixels_that_see(entry.camera.resized(width, height))
        mask = seen if mask is None or seen is None else mask & seen
    if mask is not None:
        mask.flags.writeable = False
        mask = None if mask.all() else mask
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
