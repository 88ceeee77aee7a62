"""The Accuracy panel as a person uses it, in a real window."""

from __future__ import annotations

import pytest

from splatview.scene.formats import save_scene


@pytest.fixture
def scene(tmp_path, random_gaussians):
    path = tmp_path / "ball.ply"
    save_scene(random_gaussians(2500, seed=4), path)
    return path


@pytest.mark.parametrize("renderer", ["cpu", pytest.param("quads", marks=pytest.mark.slow)])
def test_measure_then_a_click_then_exact_again(drive, scene, tmp_path, renderer):
    found = drive(
        "prices",
        scene,
        script="accuracy_drives.py",
        environ={"SPLATVIEW_CACHE_DIR": str(tmp_path / "cache")},
        renderer=renderer,
        size=[520, 360],
        rounds=3 if renderer == "cpu" else 1,
    )
    first, *rungs = found["rungs"]
    assert first[:2] == ["renderer", renderer] and first[2] > 60, "the baseline is all but the truth"
    (views,) = found["elsewhere"]
    assert (views > 0) == (renderer == "quads"), "the CPU prices what moves by itself"
    names = {(knob, value) for knob, value, *_ in rungs}
    assert {("sh-degree", "0"), ("early-stop", "1e-2"), ("resolution", "1/2")} <= names
    assert all(error > 0 and ratio > 0 for _, _, _, error, ratio in rungs) and found["noise"] > 0
    degrees = {value: psnr for knob, value, psnr, *_ in rungs if knob == "sh-degree"}
    assert degrees["0"] < degrees["1"] < degrees["2"] < first[2]
    assert found["progress"][0] < found["progress"][1] <= 1 and found["evaluations"] > 0

    knob, value = found["mark"]
    assert found["by_mark"] == [{knob: value}, {}], "by a click on its mark, and back by another"
    assert found["choices"] == {"sh-degree": "0"} and found["differs"] > 0.05
    assert found["shown_is_coarse"] < 2e-3, "the window draws by the shortcut"
    psnr, largest, noticed = found["compared"]
    assert abs(psnr - degrees["0"]) < 1 and largest == pytest.approx(found["differs"], rel=0.05)
    assert 0 < noticed < 1
    assert found["line"][1] > found["line"][0] + 0.03 and found["eye_moved"] == 0, "the line, not the eye"
    assert found["back"] < 2e-3 and found["choices_after"] == {}, "exact again"
    assert ("keep", "25") in names and ("attributes", "8-bit-sh") not in names, "loaded anew: not priced here"
    for name, least in (("keep", 0.1), ("attributes", 1e-4)):
        from_wanted, from_exact = found[name]
        assert from_wanted < 4e-3 and from_exact > least, name
        assert found[f"{name} back"] < 2e-3, name
    assert found["prices_kept"], "a cancelled measurement takes nothing away"


@pytest.mark.parametrize("renderer", [pytest.param("cpu", marks=pytest.mark.slow), "quads"])
def test_a_budget_makes_moving_pictures_coarser_and_rest_exact(drive, scene, tmp_path, renderer):
    found = drive(
        "governor",
        scene,
        script="accuracy_drives.py",
        environ={"SPLATVIEW_CACHE_DIR": str(tmp_path / "cache")},
        renderer=renderer,
        size=[520, 360],
        frames=5,
        share=0.02,  # out of reach of any chance: the quickest step is taken
        patience=2.0 if renderer == "cpu" else 0.0,
    )
    assert found["moving_size"][0] < found["exact_size"][0] or "of the splats" in found["badge"]
    assert found["badge"] and not found["badge_at_rest"]
    assert found["final_size"] == found["exact_size"]
    if renderer == "quads":
        assert found["resting_sizes"][2] == found["exact_size"], "within two frames of rest"
