"""How much of a pixel's error float32 cannot help: alphas that sit on a cut, and depths that tie.

A renderer in single precision may find an alpha just below 1/255 where float64 finds it just above, or
two splats in the other order. Neither is wrong; both change the pixel by a step rather than by rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.background import background_colours
from splatview.scene.projection import Footprints, project
from splatview.scene.reference import alphas, composite, splats_reaching

RELATIVE_SLACK = 1e-4
"""Alphas and depths this close, relative to their size, count as equal: some roundings of float32, which a
footprint whose axes cancel multiplies."""


@dataclass(frozen=True, kw_only=True)
class Ambiguity:
    """What at one pixel could go either way."""

    on_cut: int
    """Splats whose alpha is within the slack of the cut."""
    depth_ties: int
    """Neighbours in depth order, both seen here, whose depths are within the slack."""
    swing: float
    """How far the pixel's largest channel moves between the choices (0 to 1 is black to white)."""


def ambiguity_at(
    footprints: Footprints, x: int, y: int, settings: RenderSettings, *, slack: float = RELATIVE_SLACK
) -> Ambiguity:
    """Evaluates pixel (x, y) with the cut moved either way by `slack` and with tied depths swapped.

    The background of the settings must be a colour: what is behind this pixel."""
    px, py = np.array([x + 0.5]), np.array([y + 0.5])
    which = splats_reaching(footprints, px[0], px[0], py[0], py[0])
    model = settings.model
    if model.alpha_cut > 0:
        lenient = replace(settings, model=replace(model, alpha_cut=model.alpha_cut * (1 - slack)))
        strict = replace(settings, model=replace(model, alpha_cut=model.alpha_cut * (1 + slack)))
    else:
        lenient = strict = settings
    alpha = alphas(footprints, which, px, py, lenient)[:, 0]
    on_cut = int(np.sum((alpha > 0) & (alpha < strict.model.alpha_cut)))

    seen = which[alpha > 0]
    depths = footprints.depths[seen]
    ties = np.diff(depths) <= slack * np.abs(depths[1:])
    # Each run of ties back to front: the other extreme of what rounding may make of it.
    runs = np.concatenate([[0], np.cumsum(~ties)]) if len(seen) else np.zeros(0, dtype=np.int64)
    swapped = seen[np.lexsort((-np.arange(len(seen)), runs))]

    pictures = [
        _pixel(footprints, order, px, py, variant)
        for variant in (lenient, strict)
        for order in (seen, swapped)
    ]
    return Ambiguity(on_cut=on_cut, depth_ties=int(ties.sum()), swing=float(np.ptp(pictures, axis=0).max()))


def unexplained_pixels(
    image: np.ndarray,
    reference: np.ndarray,
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings,
    *,
    bound: float,
) -> tuple[list[tuple[int, int]], int]:
    """Pixels (x, y) that differ by more than `bound` though nothing is ambiguous there, and how many more.

    `image` and `reference` are (H, W, 3 or 4); the second number counts pixels beyond the bound whose
    excess is within the swing that cuts and ties allow.
    """
    error = np.abs(image[..., :3].astype(np.float64) - reference[..., :3]).max(axis=2)
    rows, columns = np.nonzero(~(error <= bound))
    if not len(rows):
        return [], 0
    # With a lower cut, or splats whose peak is just below it would be culled before they are looked at.
    lenient = replace(settings.model, alpha_cut=settings.model.alpha_cut * (1 - RELATIVE_SLACK))
    footprints = project(gaussians, camera, replace(settings, model=lenient))
    behind = np.broadcast_to(
        background_colours(settings.background, camera), (camera.height, camera.width, 3)
    )
    unexplained: list[tuple[int, int]] = []
    for x, y in zip(columns.tolist(), rows.tolist(), strict=True):
        r, g, b = behind[y, x].tolist()
        swing = ambiguity_at(footprints, x, y, replace(settings, background=(r, g, b))).swing
        if not error[y, x] <= bound + swing:
            unexplained.append((x, y))
    return unexplained, len(rows) - len(unexplained)


def _pixel(
    footprints: Footprints, order: np.ndarray, x: np.ndarray, y: np.ndarray, settings: RenderSettings
) -> np.ndarray:
    colour, transmittance = composite(footprints, order, x, y, settings)
    return (colour + transmittance[:, None] * np.asarray(settings.background))[0]
