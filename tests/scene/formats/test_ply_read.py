"""What the .ply reader accepts: layouts, orders, types, other elements; progress and cancelling."""

from __future__ import annotations

import os
import struct
import threading
import time
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import Gaussians, ImageModel, InputError
from splatview.scene.effects.overrides import settings_for
from splatview.scene.formats import load_scene, ply_body, save_scene
from splatview.scene.progress import Cancelled, Progress

FORMS = ("binary_little_endian", "binary_big_endian", "ascii")


def load_bytes(tmp_path, data: bytes) -> Gaussians:
    path = tmp_path / "scene.ply"
    path.write_bytes(data)
    return load_scene(path)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("degree", range(4))
def test_every_degree_and_format(tmp_path, random_gaussians, columns_of, make_ply, assert_same, form, degree):
    scene = random_gaussians(37, sh_degree=degree)
    assert_same(load_bytes(tmp_path, make_ply(columns_of(scene), form=form)), scene)


@pytest.mark.parametrize("form", FORMS)
def test_properties_in_any_order_of_mixed_types_with_extras(
    tmp_path, random_gaussians, columns_of, make_ply, assert_same, rng, form
):
    scene = random_gaussians(50, sh_degree=2)
    columns = columns_of(scene)
    columns["rot_2"] = columns["rot_2"].astype(np.float64)
    columns["red"] = rng.integers(0, 256, 50, dtype=np.uint8)
    columns["label"] = rng.integers(-(2**31), 2**31 - 1, 50, dtype=np.int32)
    columns["weight"] = rng.normal(size=50)
    names = list(columns)
    rng.shuffle(names)
    loaded = load_bytes(tmp_path, make_ply({name: columns[name] for name in names}, form=form))
    assert set(loaded.extras) == {"red", "label", "weight"}
    for name, values in loaded.extras.items():
        assert values.dtype == columns[name].dtype and np.array_equal(values, columns[name])
    object.__setattr__(loaded, "extras", {})
    assert_same(loaded, scene)


@pytest.mark.parametrize("form", FORMS)
def test_double_positions_stay_double(tmp_path, random_gaussians, columns_of, make_ply, form):
    columns = columns_of(random_gaussians(20))
    for name in "xyz":
        columns[name] = columns[name].astype(np.float64) + 4e6 + 1 / 3
    loaded = load_bytes(tmp_path, make_ply(columns, form=form))
    assert loaded.means.dtype == np.float64
    assert np.array_equal(loaded.means, np.stack([columns[name] for name in "xyz"], axis=1))


def test_all_double_gives_float32_but_for_positions(tmp_path, random_gaussians, columns_of, make_ply):
    scene = random_gaussians(20, sh_degree=1)
    columns = {name: values.astype(np.float64) for name, values in columns_of(scene).items()}
    loaded = load_bytes(tmp_path, make_ply(columns))
    assert np.array_equal(loaded.means, scene.means.astype(np.float64))
    assert loaded.sh.tobytes() == scene.sh.tobytes()


def test_the_filter_of_mip_splatting_is_applied_once(tmp_path, random_gaussians, columns_of, make_ply, rng):
    scene = random_gaussians(64)
    logits = scene.opacity_logits.copy()
    logits[:3] = [np.inf, -np.inf, 100]
    scene = replace(scene, opacity_logits=logits)
    filters = rng.uniform(1e-3, 1, 64).astype(np.float32)
    filters[4:8] = [0, -0.5, np.nan, 1e-30]
    data = make_ply(columns_of(scene) | {"filter_3D": filters}, comments=("of Mip-Splatting",))
    loaded = load_bytes(tmp_path, data)
    assert loaded.extras == {} and loaded.comments[:2] == ("SplatRenderMode: mip", "of Mip-Splatting")
    assert settings_for(loaded).model == ImageModel(blur=0.1, antialiased=True)
    # The formulas of their renderer, as they stand there.
    scales = np.exp(scene.log_scales.astype(np.float64))
    with np.errstate(over="ignore"):
        opacity = 1 / (1 + np.exp(-logits.astype(np.float64)))
    wide = np.sqrt(scales**2 + filters.astype(np.float64)[:, None] ** 2)
    faded = opacity * np.sqrt((scales**2).prod(axis=1) / (wide**2).prod(axis=1))
    with np.errstate(over="ignore"):
        np.testing.assert_allclose(np.exp(loaded.log_scales.astype(np.float64)), wide, rtol=1e-6)
        stored = 1 / (1 + np.exp(-loaded.opacity_logits.astype(np.float64)))
    np.testing.assert_allclose(stored, faded, rtol=1e-5)
    assert loaded.log_scales[4].tobytes() == scene.log_scales[4].tobytes(), "no filter, no rounding"
    assert loaded.opacity_logits[4] == logits[4]
    save_scene(loaded, tmp_path / "saved.ply")
    again = load_scene(tmp_path / "saved.ply")
    assert again.comments == loaded.comments
    for name in ("log_scales", "opacity_logits"):
        assert getattr(again, name).tobytes() == getattr(loaded, name).tobytes()
    classic = load_bytes(tmp_path, data.replace(b"comment of Mip-Splatting", b"comment antialiased 0"))
    assert not settings_for(classic).model.antialiased, "the file's own word counts"


def test_normals_of_zero_vanish_and_others_stay(tmp_path, random_gaussians, columns_of, make_ply):
    columns = columns_of(random_gaussians(5))
    columns |= {name: np.zeros(5, np.float32) for name in ("nx", "ny", "nz")}
    assert load_bytes(tmp_path, make_ply(columns)).extras == {}
    columns["ny"] = np.array([0, 0, -0.0, 0, 0], np.float32)
    assert set(load_bytes(tmp_path, make_ply(columns)).extras) == {"nx", "ny", "nz"}


def test_two_scales_become_thin_discs(tmp_path, random_gaussians, columns_of, make_ply):
    columns = columns_of(random_gaussians(5))
    del columns["scale_2"]
    loaded = load_bytes(tmp_path, make_ply(columns))
    smaller = loaded.log_scales[:, :2].min(axis=1)
    assert np.allclose(loaded.log_scales[:, 2], smaller - np.log(1000), atol=1e-5)
    assert any("two scales" in comment for comment in loaded.comments)
    assert settings_for(loaded).model == ImageModel().with_footprint("disc")
    # Saved with a third scale, it still says what it is, once.
    again = tmp_path / "again.ply"
    save_scene(loaded, again)
    assert load_scene(again).comments == loaded.comments
    assert settings_for(load_scene(again)).model.footprint == "disc"


@pytest.mark.parametrize("eol", ["\n", "\r\n"])
@pytest.mark.parametrize("form", FORMS)
def test_line_ends_comments_and_other_encodings(
    tmp_path, random_gaussians, columns_of, make_ply, assert_same, form, eol
):
    scene = random_gaussians(3)
    comments = ("Grüße", "end_header", "element vertex 7", "")
    loaded = load_bytes(tmp_path, make_ply(columns_of(scene), form=form, eol=eol, comments=comments))
    assert_same(loaded, scene)
    assert loaded.comments == comments


def test_names_and_blank_lines_that_plyfile_refuses(
    tmp_path, random_gaussians, columns_of, make_ply, assert_same
):
    scene = random_gaussians(3)
    extra = {"größe": np.arange(3, dtype=np.uint8)}
    data = make_ply({**columns_of(scene), **extra}).replace(b"element", b"\n \t\nelement", 1)
    loaded = load_bytes(tmp_path, data)
    assert loaded.extras.keys() == {r"gr\xf6\xdfe"}
    save_scene(loaded, tmp_path / "again.ply")
    assert_same(load_scene(tmp_path / "again.ply"), loaded)


def test_whole_numbers_with_a_point_in_ascii(tmp_path, random_gaussians, columns_of, make_ply):
    columns = {**columns_of(random_gaussians(3)), "label": np.array([1, 250, 3], np.uint8)}
    data = make_ply(columns, form="ascii").replace(b" 250\n", b" 250.0\n")
    assert load_bytes(tmp_path, data).extras["label"].tolist() == [1, 250, 3]


def test_obj_info_is_kept_as_a_comment(tmp_path, random_gaussians, columns_of, make_ply):
    data = make_ply(columns_of(random_gaussians(3))).replace(b"element", b"obj_info made by hand\nelement", 1)
    assert load_bytes(tmp_path, data).comments == ("obj_info made by hand",)


FACES = "element face 3\nproperty list uchar int vertex_indices\nproperty float quality"


def faces(form: str) -> bytes:
    if form == "ascii":
        return b"3 0 1 2 0.5\n0 0.25\n1 7 1.5\n"
    order = "<" if form == "binary_little_endian" else ">"
    return (
        struct.pack(f"{order}B3if", 3, 0, 1, 2, 0.5)
        + struct.pack(f"{order}Bf", 0, 0.25)
        + struct.pack(f"{order}Bif", 1, 7, 1.5)
    )


@pytest.mark.parametrize("form", FORMS)
def test_other_elements_before_and_after(tmp_path, random_gaussians, columns_of, make_ply, assert_same, form):
    scene = random_gaussians(30)
    plain = "element tag 2\nproperty short id\nproperty double when"
    order = "<" if form == "binary_little_endian" else ">"
    body = b"1 2.5\n3 4.5\n" if form == "ascii" else struct.pack(f"{order}hdhd", 1, 2.5, 3, 4.5)
    data = make_ply(
        columns_of(scene),
        form=form,
        before=(f"{plain}\n{FACES}", body + faces(form)),
        after=("element junk 9\nproperty float x", b"not even complete"),
    )
    assert_same(load_bytes(tmp_path, data), scene)


@pytest.mark.parametrize("form", FORMS)
def test_lists_within_the_splats_are_left_out(
    tmp_path, random_gaussians, columns_of, make_ply, assert_same, rng, form
):
    n = 5000  # more than are walked at once
    scene = random_gaussians(n, sh_degree=0)
    columns = columns_of(scene)
    head, tail = dict(list(columns.items())[:5]), dict(list(columns.items())[5:])
    counts = rng.integers(0, 4, n)
    header = make_ply(columns, form=form).split(b"end_header\n")[0]
    split_at = f"property float {next(iter(tail))}\n".encode()
    before, after = header.split(split_at)
    header = before + b"property list uchar ushort neighbours\n" + split_at + after + b"end_header\n"
    order = "<" if form == "binary_little_endian" else ">"
    rows = []
    for i in range(n):
        first = [float(values[i]) for values in head.values()]
        last = [float(values[i]) for values in tail.values()]
        items = [9] * counts[i]
        if form == "ascii":
            rows.append(" ".join(map(str, [*first, counts[i], *items, *last])).encode() + b"\n")
        else:
            layout = f"{order}{len(first)}fB{counts[i]}H{len(last)}f"
            rows.append(struct.pack(layout, *first, counts[i], *items, *last))
    loaded = load_bytes(tmp_path, header + b"".join(rows))
    assert loaded.extras == {}
    assert_same(loaded, scene)


def test_no_splats(tmp_path, random_gaussians, columns_of, make_ply):
    for form in FORMS:
        assert len(load_bytes(tmp_path, make_ply(columns_of(random_gaussians(0)), form=form))) == 0


def test_nan_and_infinity_open(tmp_path, random_gaussians, columns_of, make_ply, assert_same):
    scene = random_gaussians(4)
    scene.means[1, 2], scene.quats[0, 0], scene.sh[3, 5, 1] = np.nan, np.inf, -np.inf
    for form in FORMS:
        loaded = load_bytes(tmp_path, make_ply(columns_of(scene), form=form))
        assert np.array_equal(loaded.means, scene.means, equal_nan=True)
        assert np.array_equal(loaded.sh, scene.sh) and np.array_equal(loaded.quats, scene.quats)


def test_many_chunks(tmp_path, random_gaussians, columns_of, make_ply, assert_same, monkeypatch):
    monkeypatch.setattr(ply_body, "CHUNK_BYTES", 5000)
    scene = random_gaussians(301)
    for form in FORMS:
        assert_same(load_bytes(tmp_path, make_ply(columns_of(scene), form=form)), scene)


@pytest.fixture
def large_file(tmp_path, random_gaussians, columns_of, make_ply):
    path = tmp_path / "large.ply"
    path.write_bytes(make_ply(columns_of(random_gaussians(40_000))))
    return path


def test_progress_rises_to_one(large_file):
    shares: list[float] = []
    load_scene(large_file, progress=Progress(report=shares.append))
    assert len(shares) > 5
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_progress_never_falls_where_rows_are_walked(tmp_path, random_gaussians, columns_of, make_ply):
    data = make_ply(columns_of(random_gaussians(9000, sh_degree=0)))
    # A list of no items behind every row: its length is one more byte of zero.
    head, _, body = data.partition(b"end_header\n")
    rows = np.frombuffer(body, np.uint8).reshape(9000, -1)
    body = np.pad(rows, ((0, 0), (0, 1))).tobytes()
    path = tmp_path / "scene.ply"
    path.write_bytes(head + b"property list uchar int tags\nend_header\n" + body)
    shares: list[float] = []
    assert len(load_scene(path, progress=Progress(report=shares.append))) == 9000
    assert len(shares) > 3 and shares == sorted(shares) and shares[-1] == 1.0


def test_cancel_is_heard_in_a_body_of_blank_lines(tmp_path, random_gaussians, columns_of, make_ply):
    head = make_ply(columns_of(random_gaussians(1)), form="ascii").partition(b"end_header\n")[0]
    path = tmp_path / "scene.ply"
    path.write_bytes(head + b"end_header\n" + b"\n" * 20_000)
    with pytest.raises(Cancelled):
        load_scene(path, progress=Progress(cancelled=lambda: True))
    with pytest.raises(InputError, match="truncated"):
        load_scene(path)


def test_cancel_stops_at_the_next_piece(large_file):
    shares: list[float] = []
    with pytest.raises(Cancelled):
        load_scene(large_file, progress=Progress(report=shares.append, cancelled=lambda: len(shares) >= 2))
    assert len(shares) == 2


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_cancel_is_heard_while_skipping(tmp_path, random_gaussians, columns_of, make_ply, form):
    count = 20_000
    row = b"1 5\n" if form == "ascii" else struct.pack("<Bi", 1, 5)
    block = f"element face {count}\nproperty list uchar int vertex_indices"
    path = tmp_path / "scene.ply"
    path.write_bytes(make_ply(columns_of(random_gaussians(3)), form=form, before=(block, row * count)))
    asked = []
    with pytest.raises(Cancelled):
        load_scene(path, progress=Progress(cancelled=lambda: asked.append(1) or len(asked) > 2))
    assert len(asked) == 3


def test_a_file_cut_while_it_is_read_is_an_input_error(large_file):
    def cut(share: float) -> None:
        os.truncate(large_file, 100_000)

    with pytest.raises(InputError, match=r"large\.ply.*cut while it was read"):
        load_scene(large_file, progress=Progress(report=cut))


def test_loads_in_two_threads_at_once(large_file, assert_same):
    scenes: list[Gaussians] = []
    threads = [threading.Thread(target=lambda: scenes.append(load_scene(large_file))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert_same(*scenes)


def test_memory_stays_below_two_and_a_half_scenes(large_file):
    tracemalloc.start()
    try:
        scene = load_scene(large_file)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # The arrays, one piece of the file, and its header.
    assert peak < scene.nbytes + 4 * ply_body.CHUNK_BYTES


def test_trained_scenes_open(data_file):
    for name, count, degree in (("train-1000", 1000, 3), ("skull", 94_936, 3), ("playbot_lod0", 500_000, 2)):
        scene = load_scene(data_file(f"scenes/{name}.ply"))
        assert (len(scene), scene.sh_degree) == (count, degree)
        assert np.isfinite(scene.means).all()


def test_a_pipe_is_refused_without_waiting(tmp_path):
    path = tmp_path / "pipe.ply"
    os.mkfifo(path)
    began = time.monotonic()
    with pytest.raises(InputError, match="pipe"):
        load_scene(path)
    assert time.monotonic() - began < 10
