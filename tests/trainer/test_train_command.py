"""`splatview train` as a person runs it, headless, on a COLMAP folder."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatview.cli.main import main
from splatview.scene.formats import load_scene, save_scene
from splatview.trainer import run as session
from splatview.trainer.checkpoint import load_checkpoint


def train(capture: Path, output: Path, *options: str) -> int:
    return main(["train", str(capture), "--headless", "-o", str(output), *options])


def metrics_of(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_run_writes_scene_metrics_table_and_pictures(capture_folder: Path, tmp_path: Path, capsys) -> None:
    output, metrics = tmp_path / "toy.ply", tmp_path / "m.jsonl"
    options = ("--iterations", "120", "--eval-every", "60", "--metrics", str(metrics), "--threads", "2")
    assert train(capture_folder, output, *options) == 0
    lines = metrics_of(metrics)
    assert [line["iteration"] for line in lines] == [50, 60, 100, 120]
    assert all(set(line) >= {"iteration", "seconds", "loss", "gaussians"} for line in lines)
    assert set(lines[-1]["stages"]) >= {"forward", "backward", "loss", "adam", "density"}
    evaluated = [line for line in lines if "psnr" in line]
    assert [line["iteration"] for line in evaluated] == [60, 120] and all("ssim" in e for e in evaluated)
    assert evaluated[1]["psnr"] > evaluated[0]["psnr"]
    scene = load_scene(output)
    assert len(scene) == lines[-1]["gaussians"]
    assert scene.sh_degree == 3
    printed = capsys.readouterr()
    assert "view_0.png" in printed.out and "mean" in printed.out and f"{len(scene):,} splats" in printed.out
    pictures = sorted((tmp_path / "toy-held-out").glob("*.png"))
    assert pictures  # every 8th photo by name is held out
    picture = np.asarray(Image.open(pictures[0]))
    assert picture.shape == (40, 3 * 48, 3)
    photo = np.asarray(Image.open(capture_folder / "images" / pictures[0].name))
    np.testing.assert_array_equal(picture[:, :48], photo)
    difference = np.abs(picture[:, 48:96].astype(int) - photo) * 4
    np.testing.assert_array_equal(picture[:, 96:], np.minimum(difference, 255))


@pytest.mark.parametrize("iterations", ["3", "60"])
def test_scenes_are_in_the_layout_that_other_viewers_read(
    capture_folder: Path, tmp_path: Path, iterations: str
) -> None:
    """62 floats a splat in the order of Kerbl et al. 2023's code, however short the run was."""
    output = tmp_path / "toy.ply"
    assert train(capture_folder, output, "--iterations", iterations) == 0
    header, _, body = output.read_bytes().partition(b"end_header\n")
    names = [*"xyz", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(45))]
    names += ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    rows = np.frombuffer(body, "<f4").reshape(-1, 62)
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    lines += [f"property float {name}" for name in names]
    assert [line for line in header.decode("ascii").splitlines() if line[:7] != "comment"] == lines
    scene = load_scene(output)
    assert scene.sh_degree == 3 and len(scene) == len(rows)
    of = dict(zip(names, rows.T, strict=True))
    np.testing.assert_array_equal(scene.means[:, 1], of["y"])
    np.testing.assert_array_equal(scene.sh[:, 0, 2], of["f_dc_2"])
    np.testing.assert_array_equal(scene.sh[:, 4, 1], of["f_rest_18"])  # channel by channel, 15 each
    np.testing.assert_array_equal(scene.opacity_logits, of["opacity"])
    np.testing.assert_array_equal(scene.quats[:, 0], of["rot_0"])
    assert np.isfinite(rows).all() and not rows[:, 3:6].any()


@pytest.mark.parametrize("name", ["scene/", "scene/lod-meta.json"])
def test_a_folder_is_a_scene_with_its_checkpoint_beside_it(
    capture_folder: Path, tmp_path: Path, name: str
) -> None:
    output = f"{tmp_path}/{name}"
    assert main(["train", str(capture_folder), "--headless", "-o", output, "--iterations", "4"]) == 0
    assert len(load_scene(tmp_path / "scene")) > 0
    names = {path.name for path in tmp_path.iterdir()} - {capture_folder.name}
    assert names == {"scene", "scene-held-out", "scene.checkpoint.safetensors"}
    checkpoint = str(tmp_path / "scene.checkpoint.safetensors")
    resumed = ["--resume", checkpoint, "--iterations", "6", "-o", output]
    assert main(["train", str(capture_folder), "--headless", *resumed]) == 0
    assert load_checkpoint(tmp_path / "scene.checkpoint.safetensors").counters.iteration == 6


def test_equal_seeds_give_equal_files(capture_folder: Path, tmp_path: Path) -> None:
    scenes = []
    for name, seed in (("a", "4"), ("b", "4"), ("c", "5")):
        output = tmp_path / f"{name}.ply"
        assert train(capture_folder, output, "--iterations", "60", "--seed", seed) == 0
        scenes.append(output.read_bytes())
    assert scenes[0] == scenes[1] != scenes[2]


def test_a_run_cut_by_ctrl_c_resumes(capture_folder: Path, tmp_path: Path) -> None:
    output, metrics = tmp_path / "toy.ply", tmp_path / "m.jsonl"
    command = [sys.executable, "-c", "import sys; from splatview.cli.main import main; sys.exit(main())"]
    command += ["train", str(capture_folder), "--headless", "-o", str(output)]
    process = subprocess.Popen([*command, "--metrics", str(metrics)], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 200
    while not (metrics.exists() and metrics.read_text()):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, printed = process.communicate(timeout=90)
    assert process.returncode == 130
    checkpoint = tmp_path / "toy.checkpoint.safetensors"
    assert "--resume" in printed
    reached = load_checkpoint(checkpoint).counters.iteration
    assert 50 <= reached < 30_000
    assert len(load_scene(output)) > 0
    goal = str(reached + 20)
    assert train(capture_folder, output, "--resume", str(checkpoint), "--iterations", goal) == 0
    assert load_checkpoint(checkpoint).counters.iteration == reached + 20


def test_a_run_resumed_half_way_ends_in_the_same_file(
    capture_folder: Path, tmp_path: Path, monkeypatch
) -> None:
    whole, parts = tmp_path / "whole.ply", tmp_path / "parts.ply"
    assert train(capture_folder, whole, "--iterations", "100") == 0

    step = session.TrainingRun.step

    def interrupted(self: session.TrainingRun) -> session.RunProgress:
        if self.trainer.counters.iteration == 40:
            raise KeyboardInterrupt
        return step(self)

    with monkeypatch.context() as patch:
        patch.setattr(session.TrainingRun, "step", interrupted)
        assert train(capture_folder, parts, "--iterations", "100") == 130
    assert parts.read_bytes() != whole.read_bytes()
    assert train(capture_folder, parts, "--resume", str(tmp_path / "parts.checkpoint.safetensors")) == 0
    assert parts.read_bytes() == whole.read_bytes()


def test_a_run_killed_before_its_scene_was_written_writes_it_when_resumed(
    capture_folder: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    whole, killed = tmp_path / "whole.ply", tmp_path / "killed.ply"
    assert train(capture_folder, whole, "--iterations", "20") == 0

    def kill(self: session.TrainingRun) -> None:
        raise SystemExit(137)

    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        patch.setattr(session.TrainingRun, "save_scene", kill)
        train(capture_folder, killed, "--iterations", "20")
    assert not killed.exists()
    resume = ("--resume", str(tmp_path / "killed.checkpoint.safetensors"))
    capsys.readouterr()
    assert train(capture_folder, killed, *resume) == 0
    printed = capsys.readouterr()
    assert "its run is over" in printed.err and "--iterations above 20" in printed.err
    assert "held-out photo" in printed.out and list((tmp_path / "killed-held-out").glob("*.png"))
    assert killed.read_bytes() == whole.read_bytes()
    assert train(capture_folder, killed, *resume, "--iterations", "20") == 2
    assert "its run is over; give --iterations above 20" in capsys.readouterr().err


def test_pictures_of_an_earlier_run_go_and_those_of_others_stay(capture_folder: Path, tmp_path: Path) -> None:
    output, folder = tmp_path / "toy.ply", tmp_path / "toy-held-out"
    assert train(capture_folder, output, "--iterations", "2") == 0
    written = {path.name for path in folder.iterdir()}
    next(folder.iterdir()).rename(folder / "of another capture.png")
    Image.new("RGB", (3, 3)).save(folder / "mine.png")
    (folder / "no picture.png").write_text("mine, too")
    assert train(capture_folder, output, "--iterations", "2") == 0
    assert {path.name for path in folder.iterdir()} == {*written, "mine.png", "no picture.png"}


def test_a_last_look_at_held_out_photos_that_is_cut_costs_nothing_else(
    capture_folder: Path, tmp_path: Path, capsys, monkeypatch
) -> None:
    """The scene is written before, in a run that says how far the look is."""
    output, metrics = tmp_path / "toy.ply", tmp_path / "m.jsonl"
    saved: list[bool] = []

    def cut(*_: object, **__: object) -> None:
        saved.append(output.exists())
        raise KeyboardInterrupt

    monkeypatch.setattr(session, "evaluation_of", cut)
    assert train(capture_folder, output, "--iterations", "20", "--metrics", str(metrics)) == 130
    assert saved == [True] and len(load_scene(output)) > 0
    error = capsys.readouterr().err
    assert "is whole, and was not measured on the held-out photos" in " ".join(error.split())
    (line,) = metrics_of(metrics)
    assert line["iteration"] == 20 and "psnr" not in line and line["stages"]
    monkeypatch.undo()
    assert train(capture_folder, output, "--resume", str(tmp_path / "toy.checkpoint.safetensors")) == 0
    assert "held-out photo" in capsys.readouterr().out and len(metrics_of(metrics)) == 1


def test_minutes_end_a_run(capture_folder: Path, tmp_path: Path) -> None:
    metrics = tmp_path / "m.jsonl"
    assert train(capture_folder, tmp_path / "toy.ply", "--minutes", "0.001", "--metrics", str(metrics)) == 0
    # Starting up takes longer than this budget: one step shows that it is over.
    assert metrics_of(metrics)[-1]["iteration"] <= 1 or len(metrics_of(metrics)) <= 2


def test_what_a_mask_covers_does_not_influence_the_scene(capture_folder: Path, tmp_path: Path) -> None:
    mask = np.full((40, 48), 255, np.uint8)
    mask[8:22, 10:30] = 0

    def trained(name: str, paint: int | None, *, masked: bool) -> bytes:
        folder = tmp_path / name
        shutil.copytree(capture_folder, folder)
        for file in sorted((folder / "images").iterdir()):
            pixels = np.array(Image.open(file))
            if paint is not None:
                pixels[mask == 0] = paint
            Image.fromarray(pixels).save(file)
            if masked:
                (folder / "masks").mkdir(exist_ok=True)
                Image.fromarray(mask).save(folder / "masks" / f"{file.name}.png")
        assert train(folder, tmp_path / f"{name}.ply", "--iterations", "60") == 0
        return (tmp_path / f"{name}.ply").read_bytes()

    clean = trained("clean", None, masked=True)
    assert trained("painted", 255, masked=True) == clean
    assert trained("unmasked", 255, masked=False) != clean


def test_the_recipe_can_be_chosen_and_a_checkpoint_knows_it(capture_folder: Path, tmp_path: Path) -> None:
    output, options = tmp_path / "toy.ply", ("--strategy", "classic", "--abs-grad", "--exposure", "on")
    assert train(capture_folder, output, "--iterations", "40", "--coarse", "0.2:3,0.5:2", *options) == 0
    settings = load_checkpoint(tmp_path / "toy.checkpoint.safetensors").settings
    assert settings.resolution == ((0.2, 3), (0.5, 2))
    assert (settings.strategy, settings.absolute_gradient, settings.exposure) == ("classic", True, "on")
    assert train(capture_folder, output, "--iterations", "2", "--coarse", "none") == 0
    assert load_checkpoint(tmp_path / "toy.checkpoint.safetensors").settings.resolution == ()
    assert train(capture_folder, output, "--iterations", "2", "--coarse", "auto") == 0
    assert load_checkpoint(tmp_path / "toy.checkpoint.safetensors").settings.resolution is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-o", "nowhere/toy.ply"), "does not exist; make it first"),
        (("-o", "toy.png"), "saved as .ply"),
        (("--iterations", "0"), "at least 1"),
        (("--resume", "missing.safetensors"), "no such file"),
        (("--metrics", "nowhere/m.jsonl"), "cannot be written"),
        (("--downscale", "9"), "too small to train"),
        (("--abs-grad",), "add --strategy classic"),
        (("--coarse", "0.3"), "must be like 0.1:4,0.3:2"),
        (("--coarse", "0.3:2,0.1:4"), "must grow"),
        (("--coarse", "0.3:0"), "at least 1"),
    ],
)
def test_mistakes_are_one_line(
    capture_folder: Path, tmp_path: Path, monkeypatch, capsys, options: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["train", str(capture_folder), "--headless", *options]) == 2
    printed = capsys.readouterr().err.strip().splitlines()
    assert printed[-1].startswith("splatview: ") and message in printed[-1]


def test_a_folder_without_a_capture_is_one_line(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    assert main(["train", "empty", "--headless"]) == 2
    assert "empty" in capsys.readouterr().err.strip().splitlines()[-1]


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_found_before_training(capture_folder: Path, tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    assert train(capture_folder, locked / "toy.ply") == 2


def test_a_scene_that_cannot_be_saved_is_kept_elsewhere(
    capture_folder: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    output = tmp_path / "toy.ply"
    monkeypatch.setattr(session.tempfile, "tempdir", str(tmp_path))

    def full_disk(scene, path) -> None:
        if Path(path) == output:
            raise session.InputError(f"{path}: cannot be written: No space left on device")
        save_scene(scene, path)

    monkeypatch.setattr(session, "save_scene", full_disk)
    assert train(capture_folder, output, "--iterations", "20") == 2
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert "No space left" in message
    refuge = Path(message.rpartition(" ")[2])
    assert len(load_scene(refuge)) > 0


def test_a_checkpoint_that_cannot_be_written_is_told_and_training_goes_on(
    capture_folder: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    def full_disk(*arguments) -> None:
        raise session.InputError("no room")

    monkeypatch.setattr(session, "save_checkpoint", full_disk)
    assert train(capture_folder, tmp_path / "toy.ply", "--iterations", "20") == 0
    assert "no checkpoint written: no room" in capsys.readouterr().err
