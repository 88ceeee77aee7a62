"""Files searched for by quality or size: what is promised holds, in every format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.edit.document import Document
from splatview.edit.sample_views import sample_cameras
from splatview.raster import render
from splatview.renderers.conversion import Conversion, convert
from splatview.renderers.quality import ranked_by_contribution
from splatview.renderers.rate_distortion import Aim, Judge, Target, parse_target, ranking
from splatview.scene import Camera, InputError
from splatview.scene.effects.overrides import settings_for
from splatview.scene.formats import FORMATS, format_of, load_scene, losses, stored_bytes
from splatview.scene.gaussians import concatenate
from splatview.scene.progress import NO_PROGRESS, Cancelled, Progress

WRITTEN = [known for known in FORMATS.values() if known.write]
SEARCHED = [known for known in WRITTEN if known is not FORMATS["streamed"]]
"""That one is the folder of .sog several times over."""


@pytest.fixture(scope="module")
def scene(random_gaussians):
    scene = random_gaussians(300, sh_degree=2, seed=3)
    return replace(scene, log_scales=scene.log_scales - 1)


@pytest.fixture(scope="module")
def views(scene) -> list[Camera]:
    return sample_cameras(scene, Document(scene).edits, 4, size=96)


@pytest.mark.parametrize(
    ("text", "psnr", "size"),
    [
        ("40dB", 40, None),
        (" 37.5 db ", 37.5, None),
        ("5MB", None, 5_000_000),
        ("800 kB", None, 800_000),
        ("1.5MiB", None, 3 * 2**19),
        ("100B", None, 100),
    ],
)
def test_targets_are_read(text, psnr, size):
    assert parse_target(text) == Target(psnr=psnr, bytes=size)


@pytest.mark.parametrize("text", ["", "40", "dB", "-3dB", "0dB", "nan dB", "5 pc", "0MB", "1e9MB", "999dB"])
def test_what_is_no_target_is_refused(text):
    with pytest.raises(InputError, match="40dB"):
        parse_target(text)


@pytest.mark.parametrize("known", SEARCHED, ids=lambda known: known.suffix)
def test_a_quality_is_reached_by_a_smaller_file(scene, views, tmp_path, known):
    path = tmp_path / f"out{known.suffix}" if not known.folder else tmp_path / "out" / known.suffix[1:]
    finest = convert(scene, path, cameras=views)
    wanted = 0.6 * min(finest.psnr, 50.0)
    found = convert(scene, path, target=Target(psnr=wanted), cameras=views)
    assert found.psnr >= wanted
    assert found.bytes == stored_bytes(path) < (0.9 if known.folder else 0.8) * finest.bytes
    # What is told is what is in the file.
    back = load_scene(path)
    assert len(back) == found.splats
    error = Judge(scene, views).error(back)[0]
    assert -10 * np.log10(error) == pytest.approx(found.psnr, abs=1e-6)


@pytest.mark.parametrize("suffix", ["spz", "sog", "splat", "ply"])
def test_a_size_is_kept_and_used(scene, views, tmp_path, suffix):
    path = tmp_path / f"out.{suffix}"
    finest = convert(scene, path, cameras=views)
    most = int(0.6 * finest.bytes)
    found = convert(scene, path, target=Target(bytes=most), cameras=views)
    assert 0.85 * most < path.stat().st_size <= most
    assert found.psnr > 15
    generous = convert(scene, path, target=Target(bytes=10**9), cameras=views)
    assert generous.splats == len(scene) and generous.psnr >= found.psnr


@pytest.mark.parametrize("target", [Target(psnr=150.0), Target(bytes=60)])
def test_what_cannot_be_met_says_the_best_and_writes_nothing(scene, views, tmp_path, target):
    path = tmp_path / "out.spz"
    path.write_bytes(b"older")
    with pytest.raises(InputError, match=r"spz.*dB.*are asked for; ask for"):
        convert(scene, path, target=target, cameras=views)
    assert path.read_bytes() == b"older" and list(tmp_path.iterdir()) == [path]


def test_a_search_can_be_cancelled(scene, views, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    shares: list[float] = []
    progress = Progress(report=shares.append, cancelled=lambda: bool(shares) and shares[-1] > 0.3)
    with pytest.raises(Cancelled):
        convert(scene, tmp_path / "out.spz", target=Target(psnr=30.0), cameras=views, progress=progress)
    assert shares == sorted(shares) and list(tmp_path.iterdir()) == []


def test_fewer_bands_are_told_and_measured(scene, tmp_path):
    path = tmp_path / "out.ply"
    found: Conversion = convert(scene, path, sh_degree=1)
    assert load_scene(path).sh_degree == 1
    assert 20 < found.psnr < 100 and "above degree 1" in found.lost[0]


def test_those_splats_go_first_that_nobody_sees(scene):
    inside = replace(scene, means=scene.means * np.float32(1e-3), log_scales=scene.log_scales - 9)
    shell = replace(scene, opacity_logits=np.full(len(scene), -9, np.float32))
    both = concatenate([scene, shell, inside])
    order = ranking(both, NO_PROGRESS, skipped=6)
    assert sorted(order) == list(range(len(both)))
    assert np.mean(order[: len(scene)] < len(scene)) > 0.9


@pytest.mark.parametrize("power", [0.7, 1.0, 1.6])
def test_the_aim_closes_in_on_any_rising_curve(power):
    aim, came = Aim(3e-4), []
    for _ in range(7):
        came.append(0.2 * aim.next() ** power)
        aim.note(came[-1])
    assert any(0.97 * 3e-4 < value <= 3e-4 for value in came)


def test_every_knob_makes_a_smaller_file_at_its_coarsest(scene, tmp_path):
    for known in WRITTEN:
        for name, values in known.all_knobs.items():
            sizes = []
            for value in (values[0], values[-1]):
                path = tmp_path / "one" / (known.suffix[1:] if known.folder else f"x{known.suffix}")
                path.parent.mkdir(exist_ok=True)
                knobs = {key: row[-1] for key, row in known.all_knobs.items()} | {name: value}
                assert known.write is not None
                target: Path = path
                known.write(scene, target, NO_PROGRESS, **knobs)
                sizes.append(stored_bytes(target))
                assert len(load_scene(target)) == len(scene) and format_of(target) is known
                for file in sorted(path.parent.rglob("*"), reverse=True):
                    file.rmdir() if file.is_dir() else file.unlink()
            assert sizes[0] < sizes[1], (known.suffix, name)


def test_a_near_plane_is_no_part_of_what_a_file_loses(scene, views):
    """It hides splats from some views; formats without comments name it among what they cannot hold."""
    said = replace(scene, comments=("near plane 2.5",))
    assert np.abs(render(scene, views[0]) - render(said, views[0], settings_for(said))).max() > 0.1
    assert Judge(said, views).error(scene) == (0.0, 0.0)
    ours, theirs = (ranking(one, NO_PROGRESS, skipped=2) for one in (said, scene))
    np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(ranked_by_contribution(said), ranked_by_contribution(scene))
    assert "its near plane" in losses(said, Path("a.spz"))
