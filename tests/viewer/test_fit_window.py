"""Nothing in the window is cut off or overlaps, whatever its size and the screen's resolution."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from splatview.scene.formats import save_scene

SIZES = [(1600, 1000), (1280, 800), (1024, 640)]


@pytest.fixture(scope="module")
def large_display(make_screen) -> Iterator[str]:
    """A screen that holds the largest window."""
    with make_screen("1600x1000") as made:
        yield made.display


@pytest.mark.parametrize(
    ("scale", "sizes"),
    [
        (1, SIZES[2:]),
        (2, SIZES[:1]),
        pytest.param(1, SIZES[:2], marks=pytest.mark.slow),
        pytest.param(2, SIZES[1:], marks=pytest.mark.slow),
    ],
)
def test_everything_fits(drive, large_display, tmp_path, random_gaussians, scale, sizes):
    path = tmp_path / "scene.ply"
    save_scene(random_gaussians(500, seed=5), path)
    # Where hello_imgui looks for the scale of the screen, if the system does not tell.
    (tmp_path / "hello_imgui.ini").write_text(f"[DpiAwareParams]\ndpiWindowSizeFactor={scale}\n")
    found = drive(
        "everything_fits",
        path,
        script="fit_drives.py",
        environ={"DISPLAY": large_display},
        seconds=280 * len(sizes),
        sizes=sizes,
        size=(700, 450),
    )
    assert found["scale"] == scale
    assert found["looked"] >= 20 * len(sizes)
    assert found["wrong"] == []
