"""Which way up a photo is: cameras store pixels as the sensor lies, and note in EXIF how they were held.

Poses are found on the stored pixels: COLMAP does not turn photos (so that those of one camera share its
lens however it was held; its issue 2104), nor do the programs that build on it. Some others turn them
first; their cameras are then of the turned photo's size.
"""

from __future__ import annotations

from PIL import ExifTags, Image

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
