"""Drawing a case with a renderer, and comparing what came out with what must."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from splatview.measure.hard_cases.case import HardCase
from splatview.measure.metrics import psnr
from splatview.scene import Camera, Gaussians, RenderSettings, reference
from splatview.scene.background import background_colours
from splatview.scene.projection import Footprints, project
from splatview.scene.reference import alphas, composite, splats_reaching

Precision = Literal["float16", "float32"]

LARGEST: dict[str, float] = {"float16": 65504.0, "float32": float(np.finfo(np.float32).max)}
"""Brighter colours cannot be told; they must come out finite."""

UNCHANGED = {"float16": 1e-3, "float32": 1e-5}
"""Pictures that differ by no more than this are the same: positions may be relative to another centre."""

Draw = Callable[[Gaussians, Camera, RenderSettings], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class CaseRenderer:
    """A renderer as the catalogue sees it, handed in."""

    name: str
    blend: Precision
    draw: Draw
    """(scene, camera, settings) -> (H, W, 4), any float."""


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """One picture of a case beside the truth, and what is wrong with it."""

    case: HardCase
    renderer: str
    settings: str
    """Name of the case's settings, and the precision of blending."""
    camera: int
    error: float
    """The largest of the pixels that count, see `error_of`."""
    bound: float
    not_finite: int
    """Numbers of the picture that are NaN or infinite."""
    excluded: int
    """Pixels beyond the bound where an alpha sits on a cut or depths tie."""
    failures: tuple[str, ...]
    image: np.ndarray
    truth: np.ndarray


@dataclass(frozen=True, kw_only=True)
class CaseResult:
    """A case, a renderer and settings: the worst of all cameras."""

    case: HardCase
    renderer: str
    settings: str
    error: float
    bound: float
    not_finite: int
    excluded: int
    failures: tuple[str, ...]
    """What is wrong, one short sentence each; nothing where the case passed."""

    @property
    def passed(self) -> bool:
        return not self.failures


def run_case(case: HardCase, renderer: CaseRenderer) -> list[CaseResult]:
    """One result for each of the case's settings."""
    results = []
    for name in case.settings:
        drawn = [draw_case(case, renderer, name, index) for index in range(len(case.cameras))]
        failures = [failure for one in drawn for failure in one.failures]
        failures += not_seen(case, renderer, name)
        results.append(
            CaseResult(
                case=case,
                renderer=renderer.name,
                settings=settings_name(name, renderer),
                error=float(np.max([one.error for one in drawn])),
                bound=drawn[0].bound,
                not_finite=sum(one.not_finite for one in drawn),
                excluded=sum(one.excluded for one in drawn),
                failures=tuple(dict.fromkeys(failures)),
            )
        )
    return results


def draw_case(case: HardCase, renderer: CaseRenderer, settings_of: str, index: int) -> Drawn:
    """One picture, all that can be said of it alone, and whether what must be culled is."""
    view = case.cameras[index]
    settings = settings_for(case, settings_of, renderer)
    scene, truth = scene_of(case), truth_of(case, settings_of, index)
    image = renderer.draw(scene, view, settings)
    bound = case.bound if renderer.blend == "float32" else case.bound_float16
    failures: list[str] = []
    not_finite, excluded, error = 0, 0, math.nan
    if image.shape != truth.shape:
        failures.append(f"the picture is {image.shape}, not {truth.shape}")
    else:
        not_finite = int(np.sum(~np.isfinite(image)))
        error, excluded = _error(case, image, truth, view, settings, bound, renderer.blend)
        if not_finite:
            failures.append(f"{not_finite} numbers are NaN or infinite")
        if not error <= bound:
            failures.append(f"error {error:.2g}")
        if excluded > case.most_excluded:
            failures.append(
                f"{excluded} pixels beyond the bound on a cut or tie, {case.most_excluded} allowed"
            )
        failures += _culling(case, renderer, settings, view, image)
        failures += _sameness(case, renderer, settings, index, image)
    return Drawn(
        case=case,
        renderer=renderer.name,
        settings=settings_name(settings_of, renderer),
        camera=index,
        error=error,
        bound=bound,
        not_finite=not_finite,
        excluded=excluded,
        failures=tuple(failures),
        image=image,
        truth=truth,
    )


def not_seen(case: HardCase, renderer: CaseRenderer, settings_of: str) -> list[str]:
    """A sentence for each splat that must show and does not in any of the pictures."""
    settings = settings_for(case, settings_of, renderer)
    missing = []
    for splat in case.visible:
        rest = without(case, (splat,))
        change = max(
            float(
                error_of(
                    renderer.draw(rest, view, settings), renderer.draw(scene_of(case), view, settings)
                ).max()
            )
            for view in case.cameras
        )
        # The reference differs by `visible_by`; half of it is left to rounding.
        if not change >= case.visible_by / 2:
            missing.append(f"splat {splat} does not show")
    return missing


def error_of(image: np.ndarray, truth: np.ndarray, blend: Precision = "float32") -> np.ndarray:
    """(H, W): each pixel's largest difference over its channels, relative where the truth is beyond ±1.

    Truths beyond what `blend` can hold count as the largest number that it can; NaN stays NaN.
    """
    largest = LARGEST[blend]
    held = np.clip(truth.astype(np.float64), -largest, largest)
    with np.errstate(invalid="ignore"):
        return (np.abs(image.astype(np.float64) - held) / np.maximum(np.abs(held), 1.0)).max(axis=2)


def settings_for(case: HardCase, name: str, renderer: CaseRenderer) -> RenderSettings:
    return replace(case.settings[name], blend=renderer.blend)


def settings_name(name: str, renderer: CaseRenderer) -> str:
    return f"{name}, {renderer.blend}"


@lru_cache(maxsize=256)
def scene_of(case: HardCase) -> Gaussians:
    """The case's scene; the same object every time, so that renderers load it once."""
    return case.build()


@lru_cache(maxsize=256)
def without(case: HardCase, indices: tuple[int, ...]) -> Gaussians:
    """The case's scene without the splats at `indices`."""
    kept = np.ones(len(scene_of(case)), np.bool_)
    kept[list(indices)] = False
    return scene_of(case).take(np.flatnonzero(kept))


@lru_cache(maxsize=1024)
def truth_of(case: HardCase, settings_of: str, index: int) -> np.ndarray:
    """(H, W, 4) float64, by the reference."""
    return reference.render(scene_of(case), case.cameras[index], case.settings[settings_of])


@lru_cache(maxsize=64)
def _twin(case: HardCase) -> Gaussians | None:
    return case.same.build() if case.same else None


def _error(
    case: HardCase,
    image: np.ndarray,
    truth: np.ndarray,
    view: Camera,
    settings: RenderSettings,
    bound: float,
    blend: Precision,
) -> tuple[float, int]:
    """The largest error of the pixels that count, and how many do not."""
    errors = error_of(image, truth, blend)
    if bool((errors <= bound).all()) or case.most_excluded == 0:
        return float(errors.max()), 0
    unexplained, explained = unexplained_pixels(image, truth, scene_of(case), view, settings, bound=bound)
    beyond = ~(errors <= bound)
    counted = ~beyond
    for x, y in unexplained:
        counted[y, x] = True
    return float(errors[counted].max(initial=0.0)), explained


def _culling(
    case: HardCase, renderer: CaseRenderer, settings: RenderSettings, view: Camera, image: np.ndarray
) -> list[str]:
    if not case.culled:
        return []
    rest = renderer.draw(without(case, case.culled), view, settings)
    change = float(error_of(rest, image).max())
    if change <= UNCHANGED[renderer.blend]:
        return []
    return [f"what must be culled changes the picture by {change:.2g}"]


def _sameness(
    case: HardCase, renderer: CaseRenderer, settings: RenderSettings, index: int, image: np.ndarray
) -> list[str]:
    twin = _twin(case)
    if twin is None or case.same is None:
        return []
    quality = psnr(image, renderer.draw(twin, case.same.cameras[index], settings))
    return [] if quality >= case.same.psnr else [f"{quality:.1f} dB against the same at the origin"]


# ---- How much of a pixel's error float32 cannot help: alphas that sit on a cut, and depths that tie.
#
# A renderer in single precision may find an alpha just below 1/255 where float64 finds it just above, or
# two splats in the other order. Neither is wrong; both change the pixel by a step rather than by rounding.

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
