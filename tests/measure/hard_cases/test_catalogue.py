"""What the catalogue says of itself holds for the reference, and the runner sees what is wrong."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from splatview.measure.hard_cases import CASES, HardCase, find_case
from splatview.measure.hard_cases.case import splats
from splatview.measure.hard_cases.run import CaseRenderer, error_of, run_case, scene_of
from splatview.scene import InputError, reference

THEMES = sorted({case.theme for case in CASES})

TRUTH = CaseRenderer(name="reference", blend="float32", draw=reference.render)


def in_float32(scene, camera, settings) -> np.ndarray:
    return reference.render(scene, camera, settings, dtype=np.float32)


def failures(renderer: CaseRenderer, theme: str) -> list[str]:
    return [
        f"{case.name} ({result.settings}): {'; '.join(result.failures)}"
        for case in CASES
        if case.theme == theme
        for result in run_case(case, renderer)
        if not result.passed
    ]


@pytest.mark.parametrize("theme", THEMES)
def test_the_reference_does_what_the_catalogue_says(theme) -> None:
    """In float64 what must be culled is, and what must stay visible shows, by as much as is said."""
    strict = [
        replace(case, visible_by=2 * case.visible_by, most_excluded=0)
        for case in CASES
        if case.theme == theme
    ]
    for case in strict:
        for result in run_case(case, TRUTH):
            assert result.passed and result.error == 0, f"{case.name}: {result.failures}"


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("theme", THEMES)
def test_the_references_formulas_hold_in_float32(theme) -> None:
    assert not failures(CaseRenderer(name="float32", blend="float32", draw=in_float32), theme)


def test_the_catalogue_is_large_and_its_names_are_its_own() -> None:
    names = Counter(case.name for case in CASES)
    assert len(CASES) >= 60 and max(names.values()) == 1
    stated = [case for case in CASES if case.culled or case.visible or case.same]
    assert sum(bool(case.culled) for case in CASES) >= 30
    assert sum(bool(case.visible) for case in CASES) >= 50
    assert len(stated) >= 90
    for case in CASES:
        count = len(scene_of(case))
        assert case.cameras and case.settings and case.what.endswith(".")
        assert all(0 <= index < count for index in (*case.culled, *case.visible)), case.name
        assert not set(case.culled) & set(case.visible), case.name


def test_a_case_is_the_same_every_time() -> None:
    for case in CASES:
        a, b = case.build(), case.build()
        for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), case.name


def test_unknown_cases_are_named_with_those_that_sound_alike() -> None:
    assert find_case("zero quaternion").name == "zero quaternion"
    with pytest.raises(InputError, match="'zero quaternion'"):
        find_case("quaternion zero")
    with pytest.raises(InputError, match="--list"):
        find_case("xyzzy")


def broken(change) -> CaseRenderer:
    """The reference, and then `change` of its picture."""
    return CaseRenderer(
        name="broken",
        blend="float32",
        draw=lambda scene, camera, settings: change(reference.render(scene, camera, settings), scene),
    )


def only(case: HardCase, renderer: CaseRenderer) -> str:
    return "; ".join(run_case(case, renderer)[0].failures)


def test_the_runner_sees_each_kind_of_failure() -> None:
    def poisoned(image, scene):
        image[3, 4, 1] = np.nan
        return image

    def brighter(image, scene):
        return image + 3e-3

    def counts(image, scene):
        return image + 1e-4 * len(scene)

    case = find_case("zero quaternion")
    assert not only(case, TRUTH)
    assert "1 numbers are NaN" in only(case, broken(poisoned))
    assert "error 0.003" in only(case, broken(brighter))
    assert "what must be culled changes the picture" in only(case, broken(counts))
    assert "the picture is (29, 40, 4)" in only(case, broken(lambda image, scene: image[1:]))
    black = broken(lambda image, scene: image * 0)
    assert "splat 0 does not show" in only(find_case("huge quaternion"), black)

    far = find_case("10⁷ m from the origin")
    near_only = broken(lambda image, scene: image * (0.5 if scene.means.dtype == np.float64 else 1.0))
    assert "dB against the same at the origin" in only(far, near_only)


def nudged(towards: float) -> CaseRenderer:
    """The reference, with every opacity moved by one float32."""

    def draw(scene, camera, settings) -> np.ndarray:
        logits = np.nextafter(scene.opacity_logits, np.float32(towards))
        return reference.render(replace(scene, opacity_logits=logits), camera, settings)

    return CaseRenderer(name="nudged", blend="float32", draw=draw)


def test_pixels_on_a_cut_are_left_out_only_where_the_case_allows_it() -> None:
    case = find_case("peaks on the cut")
    up, down = (run_case(case, nudged(towards))[0] for towards in (np.inf, -np.inf))
    assert up.passed and down.passed
    # One of the two crosses the cut.
    assert sorted([up.excluded, down.excluded]) == [0, 48]
    towards = np.inf if up.excluded else -np.inf
    assert "48 pixels beyond the bound" in only(replace(case, most_excluded=47), nudged(towards))
    assert "error" in only(replace(case, most_excluded=0), nudged(towards))


def test_errors_are_relative_beyond_one() -> None:
    truth = np.full((1, 1, 4), 1e6)
    assert error_of(truth * 1.01, truth)[0, 0] == pytest.approx(0.01)
    assert error_of(np.full((1, 1, 4), 65504.0), truth, "float16")[0, 0] == 0
    assert np.isnan(error_of(truth * np.nan, truth)).all()
    assert error_of(np.full((1, 1, 4), 0.3), np.full((1, 1, 4), 0.1))[0, 0] == pytest.approx(0.2)


def test_the_builder_repeats_what_is_given_once() -> None:
    scene = splats([(0, 0, 1), (0, 0, 2)], scale=(1.0, 2.0, 4.0), logits=[1, 2])
    np.testing.assert_allclose(np.exp(scene.log_scales), [[1, 2, 4], [1, 2, 4]], rtol=1e-6)
    assert scene.opacity_logits.tolist() == [1, 2]
    apart = splats([(0, 0, 1), (0, 0, 2)], scale=[1.0, 3.0])
    np.testing.assert_allclose(np.exp(apart.log_scales), [[1, 1, 1], [3, 3, 3]], rtol=1e-6)
