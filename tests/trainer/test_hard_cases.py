"""Hard cases through training: gradients are finite and right, and whole runs survive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.measure.hard_cases import CASES, HardCase, find_case
from splatview.measure.hard_cases.case import neighbours, splats
from splatview.measure.hard_cases.colours import coloured, constant
from splatview.measure.hard_cases.run import scene_of
from splatview.measure.metrics import SSIM_WINDOW
from splatview.raster import Parameters, Workspace, draw_frame, parameters_of
from splatview.raster.gradients import Gradients, differentiate
from splatview.scene import Camera, Gaussians, ImageModel, RenderSettings, reference
from splatview.scene.projection import project
from splatview.trainer.counters import NothingSeen
from splatview.trainer.settings import TrainSettings
from splatview.trainer.strategies.ops import invalid_splats
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews

THEMES = sorted({case.theme for case in CASES})
STEPS = 50

BOUND = 1e-3
"""Of |float32 - float64| / |float64|, the norms being those of an attribute of all splats."""

NEGLIGIBLE = 1e-6
"""An attribute whose gradient is below this share of the largest one's counts as that large: some cancel to
nothing, a round splat's by its quaternion say."""

EARLY_STOP = 1e-7
"""In float32; what it leaves out is far below BOUND."""

CANCELLED = {("peaks just above the cut", "means")}
"""Each splat shows at one pixel, whose centre is its mean: the gradient is 0 but for the rounding of that."""

BESIDE_CUT, BESIDE_CAP = 1e-5, 1e-5
"""Alphas so near an edge, relative to it, may fall on its other side in float32."""


def differentiable(case: HardCase) -> dict[str, RenderSettings]:
    """The case's settings that have gradients."""
    return {
        name: chosen
        for name, chosen in case.settings.items()
        if chosen.model.max_alpha < 1 and chosen.model.footprint == "ellipsoid"
    }


def beside_an_edge(scene: Gaussians, camera: Camera, settings: RenderSettings) -> np.ndarray:
    """(H, W) bool: pixels with an alpha beside the cut or the cap."""
    model = settings.model
    free = replace(settings, model=replace(model, max_alpha=np.inf, alpha_cut=0.0))
    lenient = replace(settings, model=replace(model, alpha_cut=model.alpha_cut * (1 - BESIDE_CUT)))
    footprints = project(scene, camera, lenient)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    alphas = reference.alphas(footprints, np.arange(len(footprints.indices)), x.ravel(), y.ravel(), free)
    beside = np.abs(alphas - model.max_alpha) <= BESIDE_CAP * model.max_alpha
    beside |= np.abs(alphas - model.alpha_cut) <= BESIDE_CUT * model.alpha_cut
    return beside.any(axis=0).reshape(camera.height, camera.width)


def gradients_in(
    dtype: type, scene: Gaussians, camera: Camera, settings: RenderSettings, weights
) -> Gradients:
    parameters = parameters_of(scene)
    if dtype is np.float64:
        with np.errstate(invalid="ignore"):  # NaN may be signalling
            parameters = Parameters(*(array.astype(np.float64) for array in parameters))
    workspace = Workspace()
    stop = 0.0 if dtype is np.float64 else EARLY_STOP
    frame = draw_frame(parameters, camera, settings, workspace, dtype=dtype, early_stop=stop)
    return differentiate(parameters, frame, weights.astype(dtype))


def wrong_gradients(case: HardCase, settings: RenderSettings, camera: Camera) -> list[str]:
    scene = scene_of(case)
    # Exact in float32 too.
    weights = np.random.default_rng(5).normal(size=(camera.height, camera.width, 4)).astype(np.float32)
    weights[beside_an_edge(scene, camera, settings)] = 0
    ours, truth = (
        gradients_in(dtype, scene, camera, settings, weights) for dtype in (np.float32, np.float64)
    )
    wrong = []
    floor = NEGLIGIBLE * max(norm(expected) for expected in truth.parameters)
    for name, found, expected in zip(Parameters._fields, ours.parameters, truth.parameters, strict=True):
        if not (np.isfinite(found).all() and np.isfinite(expected).all()):
            wrong.append(
                f"{name}: {np.sum(~np.isfinite(found))} and {np.sum(~np.isfinite(expected))} not finite"
            )
            continue
        if (case.name, name) in CANCELLED:
            continue
        error, allowed = norm(found - expected), BOUND * max(norm(expected), floor)
        if not error <= allowed:
            wrong.append(f"{name}: {error:.2g}, allowed {allowed:.2g}")
    return wrong


def norm(values: np.ndarray) -> float:
    """As float64, scaled, so that the squares of 1e200 do not overflow."""
    flat = np.abs(values.astype(np.float64))
    largest = float(flat.max(initial=0.0))
    return largest * float(np.linalg.norm(flat / largest)) if 0 < largest < np.inf else largest


@pytest.mark.parametrize("theme", THEMES)
def test_gradients_are_finite_and_those_of_float64(theme) -> None:
    wrong = [
        f"{case.name} ({name}, camera {index}) {what}"
        for case in CASES
        if case.theme == theme
        for name, settings in differentiable(case).items()
        for index, camera in enumerate(case.cameras)
        for what in wrong_gradients(case, settings, camera)
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("value", [1e20, 3e38])
def test_colours_up_to_the_end_of_float32(value: float) -> None:
    case = replace(find_case("SH of 1e30"), build=lambda: coloured(constant(value)))
    settings = next(iter(differentiable(case).values()))
    assert not [what for camera in case.cameras for what in wrong_gradients(case, settings, camera)]
    assert not wrong_run(case, "mcmc")


@pytest.mark.parametrize("depth", [1e-38, 1e-43])
def test_splats_at_the_eye(depth: float) -> None:
    """Where the near plane lets them: the derivative by the position is more than float32 holds."""
    scene = splats([(0.1 * depth, 0.05 * depth, depth), (0.0, 0.0, 2.0)], scale=(depth, 0.4))
    camera = Camera(
        width=32, height=24, fx=30.0, fy=30.0, cx=16.0, cy=12.0, world_to_camera=np.eye(4), name="eye"
    )
    case = replace(find_case("SH of 1e30"), build=lambda: scene, cameras=(camera,))
    assert not wrong_gradients(case, RenderSettings(model=ImageModel(near=1e-44)), camera)


def shot_of(camera: Camera, number: int) -> TrainView:
    """A photo of stripes that no case looks like."""
    small = camera.resized(max(SSIM_WINDOW, camera.width // 2), max(SSIM_WINDOW, camera.height // 2))
    rows, columns = np.mgrid[: small.height, : small.width]
    stripes = 0.5 + 0.5 * np.sin(
        np.stack([rows * 0.7, columns * 0.9, (rows + columns) * 0.5], axis=-1) + number
    )
    return TrainView(replace(small, name=f"{number}.png"), (stripes * 255).astype(np.uint8))


def trainer_of(case: HardCase, strategy: str) -> Trainer:
    scene = scene_of(case)
    scene = replace(scene, means=scene.means.astype(np.float32))
    options = {"strategy": strategy, "model": next(iter(differentiable(case).values())).model}
    settings = TrainSettings(
        iterations=STEPS,
        refine_from=0.1,
        refine_every=0.1,
        refine_until=0.8,
        least_refine_steps=3,
        max_splats=2 * len(scene) + 50,
        sh_every=0.2,
        dropout=0.1,
        **options,
    )
    views = [shot_of(camera, number) for number, camera in enumerate(case.cameras)]
    return Trainer(TrainViews(views, 0), parameters_of(scene), 3.0, settings, threads=1)


def ill_rows(parameters: Parameters) -> np.ndarray:
    """(N,) bool: splats with a number that is not finite."""
    return ~np.all([np.isfinite(array).reshape(len(array), -1).all(axis=1) for array in parameters], axis=0)


OUT_OF_SIGHT = "10¹² m from the origin"
"""Case whose means, in float32 and about no centre, are beside its views: its runs end at once, in a line."""


def wrong_run(case: HardCase, strategy: str) -> list[str]:
    trainer = trainer_of(case, strategy)
    if case.name == OUT_OF_SIGHT:
        with pytest.raises(NothingSeen):
            for _ in range(STEPS):
                trainer.step()
        return []
    ill_from_the_start = set(trainer.splats.ids[ill_rows(trainer.splats.arrays)].tolist())
    wrong = []
    for step in range(STEPS):
        report = trainer.step()
        if not np.isfinite(report.loss):
            return [f"loss {report.loss} at step {step}"]
        ill = set(trainer.splats.ids[ill_rows(trainer.splats.arrays)].tolist())
        if not ill <= ill_from_the_start:
            return [f"splats {sorted(ill - ill_from_the_start)[:5]} are not finite after step {step}"]
    if not trainer.state["refined_at"]:
        wrong.append("density control never ran")
    if not len(trainer.splats):
        wrong.append("no splat is left")
    return wrong


def wrong_runs(theme: str, strategies: tuple[str, ...]) -> list[str]:
    return [
        f"{case.name} ({strategy}): {what}"
        for number, case in enumerate(CASES)
        if case.theme == theme and case.trains
        for strategy in (strategies if len(strategies) > 1 else (("classic", "mcmc")[number % 2],))
        for what in wrong_run(case, strategy)
    ]


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("theme", THEMES)
def test_runs_survive(theme) -> None:
    """Every case by one of the strategies, in turn."""
    wrong = wrong_runs(theme, ("in turn",))
    assert not wrong, "\n".join(wrong)


def test_density_control_takes_out_what_no_picture_shows() -> None:
    """Else it would be copied by its opacity, which says nothing of it."""
    for name in ("NaN means", "infinite SH", "zero quaternion", "log-scale +100", "NaN of every kind"):
        case = find_case(name)
        for strategy in ("classic", "mcmc"):
            trainer = trainer_of(case, strategy)
            before = invalid_splats(trainer.splats.arrays)
            assert before[list(case.culled)].all() and before.sum() == len(case.culled)
            for _ in range(STEPS):
                trainer.step()
            assert not invalid_splats(trainer.splats.arrays).any()
            assert len(trainer.splats) >= 12


def test_what_is_ill_for_training() -> None:
    well = parameters_of(neighbours(3))
    assert not invalid_splats(well).any()
    for name, value in (
        ("means", np.inf),
        ("quats", np.nan),
        ("log_scales", -np.inf),
        ("log_scales", 89.0),
        ("opacity_logits", np.inf),
        ("sh", np.nan),
    ):
        array = getattr(well, name).copy()
        array.reshape(len(array), -1)[5, -1] = value
        assert np.flatnonzero(invalid_splats(well._replace(**{name: array}))).tolist() == [5]
    zeros = well._replace(quats=np.zeros_like(well.quats))
    assert invalid_splats(zeros).all()


@pytest.mark.slow
@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("theme", THEMES)
def test_runs_survive_by_each_strategy(theme) -> None:
    wrong = wrong_runs(theme, ("classic", "mcmc"))
    assert not wrong, "\n".join(wrong)
