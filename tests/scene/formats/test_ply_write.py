"""Saving: bit exact, in the usual layout, wholly or not at all."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from splatview.scene import Gaussians, InputError
from splatview.scene.formats import load_scene, save_scene

# Any 32 bits are a float32, signalling NaN and payloads included.
any_bits = st.integers(0, 2**32 - 1)


def floats(shape: tuple[int, ...]) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.uint32, shape, elements=any_bits).map(lambda bits: bits.view(np.float32))


@st.composite
def scenes(draw: st.DrawFn) -> Gaussians:
    n = draw(st.integers(0, 6))
    k = draw(st.sampled_from([1, 4, 9, 16]))
    means = draw(floats((n, 3)))
    if draw(st.booleans()):
        means = draw(hnp.arrays(np.uint64, (n, 3), elements=st.integers(0, 2**64 - 1))).view(np.float64)
    types = st.sampled_from([np.uint8, np.int16, np.int32, np.uint32])
    names = st.lists(st.sampled_from(["red", "label", "nx", "t"]), unique=True, max_size=3)
    extras = {name: np.arange(n).astype(draw(types)) for name in draw(names)}
    text = st.text(st.characters(codec="utf-8", exclude_characters="\r\n\x85"), max_size=20)
    comments = draw(st.lists(text.map(str.strip), max_size=3))
    return Gaussians(
        means=means,
        quats=draw(floats((n, 4))),
        log_scales=draw(floats((n, 3))),
        opacity_logits=draw(floats((n,))),
        sh=draw(floats((n, k, 3))),
        comments=tuple(comments),
        extras=extras,
    )


@given(scene=scenes())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_round_trip_is_bit_exact(tmp_path, assert_same, scene):
    path = tmp_path / "scene.ply"
    save_scene(scene, path)
    loaded = load_scene(path)
    if "nx" in scene.extras:
        # Normals come as three: the writer gives the other two as zeros.
        scene = replace(
            scene, extras={**dict.fromkeys(("ny", "nz"), np.zeros(len(scene), "f4")), **scene.extras}
        )
        if not scene.extras["nx"].any():
            scene = replace(
                scene, extras={k: v for k, v in scene.extras.items() if k not in ("nx", "ny", "nz")}
            )
    assert_same(loaded, scene)
    assert loaded.comments == scene.comments
    assert os.listdir(tmp_path) == ["scene.ply"]


def test_layout_is_the_trainers(tmp_path, random_gaussians, columns_of):
    scene = replace(
        random_gaussians(10),
        comments=("one", "obj_info two"),
        extras={"label": np.arange(10, dtype=np.uint8)},
    )
    save_scene(scene, tmp_path / "scene.ply")
    file = plyfile.PlyData.read(tmp_path / "scene.ply")
    assert (file.byte_order, file.text, file.comments, file.obj_info) == ("<", False, ["one"], ["two"])
    expected = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3))]
    expected += [*(f"f_rest_{i}" for i in range(45)), "opacity", *(f"scale_{i}" for i in range(3))]
    expected += [*(f"rot_{i}" for i in range(4)), "label"]
    assert [prop.name for prop in file["vertex"].properties] == expected
    for name, values in columns_of(scene).items():
        assert np.array_equal(file["vertex"][name], values)
    assert not file["vertex"]["nx"].any()


def test_files_of_plyfile_open(tmp_path, random_gaussians, columns_of, assert_same):
    scene = random_gaussians(10)
    columns = columns_of(scene)
    table = np.empty(10, dtype=[(name, "f4") for name in columns])
    for name, values in columns.items():
        table[name] = values
    for text, order in ((False, "<"), (False, ">"), (True, "=")):
        element = plyfile.PlyElement.describe(table, "vertex")
        plyfile.PlyData([element], text=text, byte_order=order).write(tmp_path / "scene.ply")
        assert_same(load_scene(tmp_path / "scene.ply"), scene)


def test_comment_cannot_bring_header_lines(tmp_path, random_gaussians):
    scene = replace(random_gaussians(2), comments=("a\nelement vertex 9\r\nend_header",))
    save_scene(scene, tmp_path / "scene.ply")
    loaded = load_scene(tmp_path / "scene.ply")
    assert len(loaded) == 2 and loaded.comments == ("a", "element vertex 9", "end_header")


@pytest.mark.parametrize(
    ("extras", "message"),
    [
        ({"label": np.arange(2)}, "int64"),
        ({"f_dc_0": np.zeros(2, np.float32)}, "f_dc_0"),
        ({"f_rest_99": np.zeros(2, np.float32)}, "f_rest_99"),
        ({"two words": np.zeros(2, np.float32)}, "two words"),
        ({"": np.zeros(2, np.float32)}, "one ASCII word"),
        ({"größe": np.zeros(2, np.float32)}, "one ASCII word"),
    ],
)
def test_extras_that_ply_cannot_hold(tmp_path, random_gaussians, extras, message):
    with pytest.raises(InputError, match=message):
        save_scene(replace(random_gaussians(2), extras=extras), tmp_path / "scene.ply")
    assert os.listdir(tmp_path) == []


def test_unknown_suffix(tmp_path, random_gaussians):
    for name in ("scene.obj", "scene", "scene.ksplat"):
        with pytest.raises(InputError, match=name):
            save_scene(random_gaussians(2), tmp_path / name)


def test_folder_and_missing_folder(tmp_path, random_gaussians):
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        save_scene(random_gaussians(2), tmp_path / "folder.ply")
    with pytest.raises(InputError, match="does not exist"):
        save_scene(random_gaussians(2), tmp_path / "nowhere" / "scene.ply")


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_failure_leaves_the_old_file_and_nothing_else(tmp_path, random_gaussians, monkeypatch, step):
    path = tmp_path / "scene.ply"
    path.write_bytes(b"old")

    def refuse(*args, **kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(*((os, "fsync") if step == "fsync" else (Path, "replace")), refuse)
    with pytest.raises(InputError, match=r"scene\.ply: cannot be written: No space left"):
        save_scene(random_gaussians(100), path)
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["scene.ply"]


def test_a_write_that_fails_midway_leaves_the_old_file(tmp_path, random_gaussians):
    resource = pytest.importorskip("resource")
    path = tmp_path / "scene.ply"
    path.write_bytes(b"old")
    scene = random_gaussians(20_000)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, before[1]))
    try:
        with pytest.raises(InputError, match=r"scene\.ply: cannot be written: File too large"):
            save_scene(scene, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["scene.ply"]


def test_interrupt_leaves_the_old_file_and_nothing_else(tmp_path, random_gaussians, monkeypatch):
    path = tmp_path / "scene.ply"
    path.write_bytes(b"old")

    def interrupt(descriptor: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        save_scene(random_gaussians(2), path)
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["scene.ply"]


def test_links_and_permissions_stay(tmp_path, random_gaussians):
    real, link = tmp_path / "real.ply", tmp_path / "link.ply"
    real.write_bytes(b"old")
    real.chmod(0o640)
    link.symlink_to(real)
    save_scene(random_gaussians(2), link)
    assert link.is_symlink() and len(load_scene(real)) == 2
    assert real.stat().st_mode & 0o777 == 0o640


def test_a_pipe_is_not_replaced(tmp_path, random_gaussians):
    os.mkfifo(tmp_path / "pipe.ply")
    with pytest.raises(InputError, match="pipe"):
        save_scene(random_gaussians(2), tmp_path / "pipe.ply")
    assert os.listdir(tmp_path) == ["pipe.ply"]
