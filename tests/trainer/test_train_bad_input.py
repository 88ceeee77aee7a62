"""Whatever is wrong with a capture or an output, `splatview train` says it in one line and exits with 2."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from splatview.cli import train_setup
from splatview.cli.main import main
from splatview.scene.formats import load_scene
from splatview.trainer import run as session

Damage = Callable[[Path], None]


@pytest.fixture
def complaint(capture_folder: Path, tmp_path: Path, capsys, monkeypatch) -> Callable[..., str]:
    """`complaint(damage, options...)`: what training on the damaged capture says, which is one line."""
    monkeypatch.chdir(tmp_path)

    def train(damage: Damage = lambda folder: None, *options: str) -> str:
        damage(capture_folder)
        assert main(["train", str(capture_folder), "--headless", "--iterations", "5", *options]) == 2
        printed = capsys.readouterr()
        lines = printed.err.strip().splitlines()
        assert lines[-1].startswith("splatview: ") and len(lines) == 1, printed.err
        assert printed.out == ""
        assert not list(tmp_path.glob("*.ply")), "a scene was written all the same"
        return lines[0]

    return train


def model(folder: Path, name: str) -> Path:
    return folder / "sparse" / "0" / name


def edited(name: str, old: str, new: str) -> Damage:
    def damage(folder: Path) -> None:
        text = model(folder, name).read_text()
        assert old in text
        model(folder, name).write_text(text.replace(old, new, 1))

    return damage


def cut(name: str, share: float) -> Damage:
    def damage(folder: Path) -> None:
        path = model(folder, name) if name.endswith(".txt") else folder / "images" / name
        data = path.read_bytes()
        path.write_bytes(data[: int(len(data) * share)])

    return damage


def emptied(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.mkdir()


def without_photos(folder: Path) -> None:
    shutil.rmtree(folder / "images")


def without_poses(folder: Path) -> None:
    model(folder, "images.txt").write_text("# none\n")


def with_one_photo(folder: Path) -> None:
    for photo in sorted((folder / "images").iterdir())[1:]:
        photo.unlink()


def with_a_wider_photo(folder: Path) -> None:
    Image.new("RGB", (96, 40)).save(folder / "images" / "view_4.png")


def with_a_narrower_mask(folder: Path) -> None:
    (folder / "masks").mkdir()
    Image.new("L", (24, 40)).save(folder / "masks" / "view_4.png.png")


def with_black_masks(folder: Path) -> None:
    (folder / "masks").mkdir()
    for photo in (folder / "images").iterdir():
        Image.new("L", (48, 40)).save(folder / "masks" / photo.name)


def with_json(text: str) -> Damage:
    def damage(folder: Path) -> None:
        emptied(folder)
        (folder / "transforms.json").write_text(text)

    return damage


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (emptied, "holds no capture"),
        (shutil.rmtree, "no such folder"),
        (without_photos, "none of its 20 photos is in"),
        (without_poses, "holds no images"),
        (with_one_photo, "only one photo (view_0.png) is left"),
        (with_a_wider_photo, "view_4.png: is 96x40 pixels, but its camera says 48x40"),
        (with_a_narrower_mask, "view_4.png.png: is 24x40 pixels, but its camera says 48x40"),
        (with_black_masks, "masks leave nothing"),
        (cut("view_7.png", 0.5), "view_7.png: is no readable image"),
        (cut("view_7.png", 0), "view_7.png: is no readable image"),
        (cut("cameras.txt", 0.5), "cameras.txt: "),
        (cut("images.txt", 0.41), "images.txt: "),
        (cut("points3D.txt", 0.501), "points3D.txt: "),
        (edited("cameras.txt", "PINHOLE", "SPHERE"), "SPHERE"),
        (edited("cameras.txt", "1 PINHOLE", "2 PINHOLE"), "not in cameras.txt"),
        (edited("images.txt", "1 ", "1 nan "), "images.txt: "),
        (with_json('{"frames": [{"file_path":'), "not JSON"),
        (with_json('{"frames": []}'), "names no photos"),
        (with_json('{"camera_model": "EQUIRECTANGULAR"}'), "the list 'frames' is missing"),
    ],
)
def test_captures(complaint: Callable[..., str], damage: Damage, message: str) -> None:
    assert message in complaint(damage)


def with_cameras_that_face_away(folder: Path) -> None:
    """Turned about by half a turn around their y axes: R' = diag(-1, 1, -1)·R."""
    path = model(folder, "images.txt")
    lines = []
    for line in path.read_text().splitlines():
        words = line.split()
        if words:
            w, x, y, z, tx, ty, tz = map(float, words[1:8])
            words[1:8] = map(repr, (-y, z, w, -x, -tx, ty, -tz))
        lines.append(" ".join(words))
    path.write_text("\n".join(lines) + "\n")


def test_cameras_that_face_away(capture_folder: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    with_cameras_that_face_away(capture_folder)
    assert main(["train", str(capture_folder), "--headless", "--iterations", "500"]) == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("splatview: training has stopped, as none of its 17 photos shows a splat")
    assert not (tmp_path / "toy.ply").exists()


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_numbers_out_of_all_bounds_bring_no_warnings_of_numpy(capture_folder: Path, tmp_path: Path) -> None:
    """World units 10¹⁰ times smaller, and points at the far end of what is kept."""
    for name, place in (("images.txt", slice(5, 8)), ("points3D.txt", slice(1, 4))):
        lines = [line.split() for line in model(capture_folder, name).read_text().splitlines()]
        for words in filter(None, lines):
            words[place] = [repr(float(word) * 1e10) for word in words[place]]
        model(capture_folder, name).write_text("\n".join(map(" ".join, lines)) + "\n")
    with open(model(capture_folder, "points3D.txt"), "a") as file:
        file.write("998 9e11 -9e11 9e11 1 2 3 0.5\n999 9e11 -9e11 1e308 1 2 3 0.5\n")
    options = ["--iterations", "60", "--exposure", "on", "-o", str(tmp_path / "toy.ply")]
    assert main(["train", str(capture_folder), "--headless", *options]) == 0


def test_photos_that_are_no_panoramas(complaint: Callable[..., str], capture_folder: Path) -> None:
    def damage(folder: Path) -> None:
        shutil.rmtree(folder / "sparse")
        pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"
        frames = [f'{{"file_path": "images/view_{i}.png", "transform_matrix": {pose}}}' for i in range(3)]
        (folder / "transforms.json").write_text(
            f'{{"camera_model": "EQUIRECTANGULAR", "fl_x": 30, "frames": [{", ".join(frames)}]}}'
        )

    message = complaint(damage)
    assert (
        "view_0.png: is" in message and "a panorama that goes all the way round is twice as wide" in message
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-o", "nowhere/toy.ply"), "nowhere does not exist; make it first"),
        (("-o", "."), "saved as .ply"),
        (("-o", "/dev/full"), "saved as .ply"),
        (("--metrics", "."), "is a folder"),
        (("--metrics", "nowhere/m.jsonl"), "cannot be written"),
        (("--metrics", "m" * 300), "cannot be written"),
        (("--resume", "missing.safetensors"), "no such file"),
        (("--batch", "0"), "at least 1"),
        (("--demo",), "name the folder of a capture, or --demo"),
    ],
)
def test_options(complaint: Callable[..., str], options: tuple[str, ...], message: str) -> None:
    assert message in complaint(lambda folder: None, *options)


@pytest.mark.skipif(os.name != "posix", reason="named pipes")
@pytest.mark.parametrize("option", ["-o", "--metrics", "--resume"])
def test_a_pipe_that_nobody_else_has_open_is_not_waited_for(
    complaint: Callable[..., str], tmp_path: Path, option: str
) -> None:
    pipe = tmp_path / ("pipe.PLY" if option == "-o" else "pipe")
    os.mkfifo(pipe)
    message = complaint(lambda folder: None, option, str(pipe))
    assert str(pipe) in message and ("is a device or a pipe" in message or option == "--metrics")


@pytest.mark.skipif(os.name != "posix", reason="named pipes")
def test_metrics_go_into_a_pipe_that_is_read(capture_folder: Path, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    options = ["--iterations", "5", "--metrics", str(pipe), "-o", str(tmp_path / "toy.ply")]
    assert main(["train", str(capture_folder), "--headless", *options]) == 0
    assert json.loads(os.read(reader, 1 << 16))["iteration"] == 5
    os.close(reader)


@pytest.mark.parametrize(
    "content",
    [b"notes of mine\n", b"[1]\n", b'{"a": 1}\n', b"\xff\n", b"7", b"[" * 10**5],
    ids=["text", "list", "object", "bytes", "number", "deep"],
)
def test_metrics_are_not_added_to_another_file(
    complaint: Callable[..., str], tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / "notes.txt"
    path.write_bytes(content)
    assert "notes.txt: is no file of metrics" in complaint(lambda folder: None, "--metrics", str(path))
    assert path.read_bytes() == content


def test_metrics_are_added_to_an_empty_file_and_to_metrics(capture_folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "m.jsonl"
    path.touch()
    options = ["--iterations", "2", "--metrics", str(path), "-o", str(tmp_path / "toy.ply")]
    for runs in (1, 2):
        assert main(["train", str(capture_folder), "--headless", *options]) == 0
        assert len(path.read_text().splitlines()) == runs


def test_a_checkpoint_that_may_not_be_read(
    complaint: Callable[..., str], tmp_path: Path, monkeypatch
) -> None:
    path = tmp_path / "locked.safetensors"
    path.touch()
    call = os.open

    def refuse(name: object, *arguments: Any, **options: Any) -> int:
        if str(name) == str(path):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return call(name, *arguments, **options)  # pyright: ignore

    monkeypatch.setattr(os, "open", refuse)
    message = complaint(lambda folder: None, "--resume", str(path))
    assert message == f"splatview: {path}: may not be read; check its permissions"


def test_neither_capture_nor_demo(capsys) -> None:
    assert main(["train", "--headless"]) == 2
    assert "name the folder of a capture, or --demo" in capsys.readouterr().err


def test_a_disk_too_full_for_the_run(complaint: Callable[..., str], monkeypatch) -> None:
    monkeypatch.setattr(
        train_setup.shutil, "disk_usage", lambda folder: shutil._ntuple_diskusage(1, 1, 10**5)
    )
    message = complaint()
    assert "the disk has 0.1 MB left, and up to 2,000 splats with their checkpoint need 3.3 MB" in message


def test_a_disk_that_fills_up_while_training(
    capture_folder: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    """No write into the output's folder succeeds after the check: the scene goes where there is room."""
    output, refuge = tmp_path / "full" / "toy.ply", tmp_path / "refuge"
    output.parent.mkdir()
    refuge.mkdir()
    monkeypatch.setattr(session.tempfile, "tempdir", str(refuge))
    fsync = os.fsync

    def full(descriptor: int) -> None:
        if Path(os.readlink(f"/proc/self/fd/{descriptor}")).parent == output.parent:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    options = ["--iterations", "5", "--eval-every", "2", "-o", str(output), "--metrics", "/dev/full"]
    assert main(["train", str(capture_folder), "--headless", *options]) == 2
    *notes, last = capsys.readouterr().err.strip().splitlines()
    assert any("no checkpoint written" in note and "No space left" in note for note in notes)
    assert any("/dev/full: a line could not be written" in note for note in notes)
    assert "toy.ply: cannot be written: No space left on device; the trained scene is saved as" in last
    assert len(load_scene(last.rpartition(" ")[2])) == 60
    assert list(output.parent.iterdir()) == []


def test_what_is_left_out_is_named_and_the_rest_trained(
    capture_folder: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    (capture_folder / "images" / "view_3.png").unlink()
    points = model(capture_folder, "points3D.txt")
    points.write_text("99 nan 0 0 1 2 3 0.5\n" + points.read_text())
    (capture_folder / "masks").mkdir()
    mask = np.zeros((40, 48), np.uint8)
    Image.fromarray(mask).save(capture_folder / "masks" / "view_5.png.png")
    mask[:20] = 255
    Image.fromarray(mask).save(capture_folder / "masks" / "view_6.png.png")
    assert main(["train", str(capture_folder), "--headless", "--iterations", "5"]) == 0
    printed = capsys.readouterr().err
    assert "1 of 20 photos are not in" in printed and "view_3.png" in printed
    assert "1 photos are left out, for their masks hide all of them: view_5.png" in printed
    assert "1 of 61 points are not finite, or out of all bounds, and left out" in printed
    assert len(load_scene(tmp_path / "toy.ply")) == 60


def test_it_is_so_in_a_process_of_its_own(capture_folder: Path, tmp_path: Path) -> None:
    with_a_wider_photo(capture_folder)
    command = [sys.executable, "-c", "import sys; from splatview.cli.main import main; sys.exit(main())"]
    done = subprocess.run(
        [*command, "train", str(capture_folder), "--headless"], capture_output=True, cwd=tmp_path, check=False
    )
    assert done.returncode == 2 and done.stdout == b"" and done.stderr.count(b"\n") == 1
