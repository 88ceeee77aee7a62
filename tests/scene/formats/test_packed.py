"""Packed formats: what comes back is within half a step of what was written, and damage is one line."""

from __future__ import annotations

import io
import json
import struct
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.lib.recfunctions import repack_fields
from PIL import Image

from splatview.scene import Gaussians, InputError
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.formats.packing import unit_quats
from splatview.scene.formats.sog_write import save_sog, sog_files
from splatview.scene.formats.spz import SH_BITS
from splatview.scene.gaussians import ARRAYS
from splatview.scene.progress import NO_PROGRESS, Cancelled, Progress
from splatview.scene.projection import rotation_matrices, sigmoid
from splatview.scene.sh import SH_C0

SUFFIXES = (".spz", ".splat", ".compressed.ply", ".sog", ".glb")


def scene(seed: int, degree: int, count: int = 300, spread: float = 3.0) -> Gaussians:
    """Values that every format has in its range, no two means alike; `spread`: of those, world units."""
    rng = np.random.default_rng(seed)
    return Gaussians(
        means=rng.normal(0, spread, (count, 3)).astype(np.float32),
        quats=(rng.normal(size=(count, 4)) * rng.uniform(1e-3, 50, (count, 1))).astype(np.float32),
        log_scales=rng.uniform(-9, 4, (count, 3)).astype(np.float32),
        opacity_logits=rng.uniform(-6, 6, count).astype(np.float32),
        sh=np.concatenate(
            [
                rng.uniform(-1.6, 1.6, (count, 1, 3)),
                rng.uniform(-0.9, 0.9, (count, (degree + 1) ** 2 - 1, 3)),
            ],
            axis=1,
        ).astype(np.float32),
    )


def scenes() -> st.SearchStrategy[Gaussians]:
    counts, spreads = st.integers(1, 300), st.floats(0.5, 100)
    return st.builds(scene, st.integers(0, 2**32 - 1), st.integers(0, 3), counts, spreads)


def any_scene(examples: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Runs a test with so many scenes as `written`."""

    def wrap(test: Callable[..., None]) -> Callable[..., None]:
        quiet = [HealthCheck.function_scoped_fixture]
        return settings(max_examples=examples, suppress_health_check=quiet)(given(written=scenes())(test))

    return wrap


def matched(read: Gaussians, written: Gaussians) -> Gaussians:
    """`read` in the order of `written`: formats have orders of their own."""
    distances = np.abs(read.means[None] - written.means[:, None].astype(np.float32)).sum(axis=2)
    at = distances.argmin(axis=1)
    assert len(np.unique(at)) == len(written) == len(read)
    return read.take(at)


def round_trip(gaussians: Gaussians, folder: Path, suffix: str) -> Gaussians:
    path = folder / f"scene{suffix}"
    save_scene(gaussians, path)
    return matched(load_scene(path), gaussians)


def quat_error(read: Gaussians, written: Gaussians) -> np.ndarray:
    """(N, 4): components of unit quaternions, of one sign."""
    ours, theirs = unit_quats(written.quats), unit_quats(read.quats)
    return ours - theirs * np.sign(np.einsum("ni,ni->n", ours, theirs))[:, None]


def smallest(errors: np.ndarray, written: Gaussians) -> float:
    """The largest error of components that are stored, which the largest is not."""
    unit = np.abs(unit_quats(written.quats))
    return float(np.abs(errors)[unit < unit.max(axis=1, keepdims=True)].max())


def opacity_error(read: Gaussians, written: Gaussians) -> float:
    return float(np.abs(sigmoid(read.opacity_logits) - sigmoid(written.opacity_logits)).max())


ROUNDING = 1e-6


@any_scene(30)
def test_spz_is_within_half_a_step(tmp_path, written):
    read = round_trip(written, tmp_path, ".spz")
    assert np.abs(read.means - written.means).max() <= 2.0**-13 + ROUNDING
    assert np.abs(read.log_scales - written.log_scales).max() <= 1 / 32 + ROUNDING
    assert opacity_error(read, written) <= 0.5 / 255 + ROUNDING
    assert np.abs(read.sh[:, 0] - written.sh[:, 0]).max() <= 0.5 / 255 / 0.15 + ROUNDING
    assert smallest(quat_error(read, written), written) <= 0.5 / 511 / np.sqrt(2) + ROUNDING
    for band in range(1, written.sh_degree + 1):
        own = slice(band**2, (band + 1) ** 2)
        half_step = 2.0 ** (8 - SH_BITS[band - 1]) / 128 / 2
        assert np.abs(read.sh[:, own] - written.sh[:, own]).max() <= half_step + ROUNDING


def test_spz_takes_fewer_bits_where_positions_are_large(tmp_path):
    written = scene(5, 0)
    written = replace(written, means=written.means * np.float32(1e5))
    read = round_trip(written, tmp_path, ".spz")
    step = np.abs(written.means).max() / (2**22 - 1)
    assert np.abs(read.means - written.means).max() <= step
    with pytest.raises(InputError, match=r"holds positions to"):
        save_scene(replace(written, means=written.means * np.float32(1e3)), tmp_path / "far.spz")
    assert not (tmp_path / "far.spz").exists()


@any_scene(20)
def test_splat_is_within_half_a_step(tmp_path, written):
    read = round_trip(written, tmp_path, ".splat")
    assert np.array_equal(read.means, written.means)
    np.testing.assert_allclose(read.log_scales, written.log_scales, atol=2e-6)
    assert opacity_error(read, written) <= 0.5 / 255 + ROUNDING
    assert np.abs(read.sh[:, 0] - written.sh[:, 0]).max() <= 0.5 / 255 / SH_C0 + ROUNDING
    # 128 steps to 1, which itself has none; lengths are left as the bytes give them.
    ours = unit_quats(written.quats)
    theirs = read.quats * np.sign(np.einsum("ni,ni->n", ours, read.quats))[:, None]
    assert np.abs(ours - theirs).max() <= 1 / 128 + ROUNDING


@any_scene(30)
def test_compressed_ply_is_within_half_a_step(tmp_path, written):
    read = round_trip(written, tmp_path, ".compressed.ply")
    # Of a chunk's bounds, which are those of the scene at most.
    for name, steps in (("means", 1023), ("log_scales", 1023)):
        ours = getattr(written, name)
        most = np.ptp(ours, axis=0).max()
        assert np.abs(getattr(read, name) - ours).max() <= 0.5 * most / steps + ROUNDING
    colours = 0.5 * np.ptp(written.sh[:, 0], axis=0).max() / 255
    assert np.abs(read.sh[:, 0] - written.sh[:, 0]).max() <= colours + ROUNDING
    assert opacity_error(read, written) <= 0.5 / 255 + ROUNDING
    assert smallest(quat_error(read, written), written) <= 0.5 * np.sqrt(2) / 1023 + ROUNDING
    assert np.abs(read.sh[:, 1:] - written.sh[:, 1:]).max(initial=0) <= 4 / 256 + ROUNDING


@any_scene(12)
def test_sog_is_within_half_a_step(tmp_path, written):
    read = round_trip(written, tmp_path, ".sog")
    logs = [np.sign(g.means) * np.log1p(np.abs(g.means)) for g in (read, written)]
    assert np.abs(logs[0] - logs[1]).max() <= 0.5 * np.ptp(logs[1], axis=0).max() / 65535 + ROUNDING
    assert smallest(quat_error(read, written), written) <= 0.5 / 127.5 / np.sqrt(2) + ROUNDING
    assert opacity_error(read, written) <= 0.5 / 255 + ROUNDING
    # Each number is the nearest level of its codebook, whose steps are as wide as numbers are rare; so few
    # splats have each an entry of the palette.
    for ours, theirs in (
        (written.log_scales, read.log_scales),
        (written.sh[:, 0], read.sh[:, 0]),
        (written.sh[:, 1:], read.sh[:, 1:]),
    ):
        levels = np.unique(theirs)
        assert len(levels) <= 256
        nearest = np.abs(ours[..., None] - levels).min(axis=-1, initial=np.inf)
        assert (np.abs(ours - theirs) <= nearest + ROUNDING).all()


def test_sog_does_not_quantise_again(tmp_path):
    first = round_trip(scene(3, 2), tmp_path, ".sog")
    again = round_trip(first, tmp_path, ".sog")
    for name in ("log_scales", "sh"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    assert np.abs(again.means - first.means).max() <= 1e-6


def test_sog_with_a_small_palette(tmp_path):
    """The centroids are of the weighted rows; more of them are never worse by much."""
    written = scene(4, 3, count=2000)
    errors = []
    for palette in (16, 256, 2000):
        save_sog(written, tmp_path / "a.sog", NO_PROGRESS, palette=palette)
        read = matched(load_scene(tmp_path / "a.sog"), written)
        errors.append(float(np.square(read.sh[:, 1:] - written.sh[:, 1:]).mean()))
    assert errors[0] > errors[1] > errors[2] and errors[2] <= (1.8 / 256) ** 2


def test_sog_folders_are_read(tmp_path):
    written = scene(6, 1)
    for name, content in sog_files(written, NO_PROGRESS).items():
        (tmp_path / name).write_bytes(content)
    for path in (tmp_path, tmp_path / "meta.json"):
        assert np.abs(matched(load_scene(path), written).means - written.means).max() < 1e-3


def test_streamed_sog_is_read_at_its_finest_level(tmp_path):
    """Each leaf from the finest level that it has; what is not asked for of a file is left out."""
    fine, coarse = scene(7, 1, count=120), scene(8, 1, count=40)
    for name, part in (("0_0", fine), ("1_0", coarse)):
        (tmp_path / name).mkdir()
        for file, content in sog_files(part, NO_PROGRESS).items():
            (tmp_path / name / file).write_bytes(content)
    leaves = [
        {"lods": {"0": {"file": 0, "offset": 0, "count": 100}, "1": {"file": 1, "offset": 0, "count": 30}}},
        {"lods": {"1": {"file": 1, "offset": 30, "count": 10}}},
    ]
    meta = {"lodLevels": 2, "filenames": ["0_0/meta.json", "1_0/meta.json"], "tree": {"children": leaves}}
    (tmp_path / "lod-meta.json").write_text(json.dumps(meta))
    read = load_scene(tmp_path)
    ours = np.concatenate([load_scene(tmp_path / "0_0").means[:100], load_scene(tmp_path / "1_0").means[30:]])
    np.testing.assert_array_equal(read.means, ours)
    (tmp_path / "lod-meta.json").write_text(json.dumps({**meta, "filenames": ["0_0/meta.json"] * 2}))
    with pytest.raises(InputError, match="names a file twice"):
        load_scene(tmp_path)
    for bad in ("../0_0/meta.json", "/etc/meta.json", "0_0/../../meta.json", "0_0/other.json"):
        (tmp_path / "lod-meta.json").write_text(json.dumps({**meta, "filenames": [bad, "1_0/meta.json"]}))
        with pytest.raises(InputError, match="FOLDER/meta"):
            load_scene(tmp_path)


@any_scene(20)
def test_glb_keeps_every_number(tmp_path, written):
    read = round_trip(written, tmp_path, ".glb")
    np.testing.assert_array_equal(read.means, written.means)
    np.testing.assert_array_equal(read.sh, written.sh)
    np.testing.assert_allclose(read.log_scales, written.log_scales, atol=2e-6)
    np.testing.assert_allclose(read.opacity_logits, written.opacity_logits, atol=1e-4)
    assert np.abs(quat_error(read, written)).max() <= ROUNDING


def test_glb_nodes_move_splats(tmp_path):
    written = scene(2, 2)
    save_scene(written, tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + length])
    # A quarter turn about y, twice as large, and away: in the file's frame, x is -x and y is -y here.
    half = float(np.sqrt(0.5))
    document["nodes"] = [
        {"children": [1], "translation": [1, 2, 3]},
        {"mesh": 0, "rotation": [0, half, 0, half], "scale": [2, 2, 2]},
    ]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary = data[20 + length :]
    head = struct.pack("<4s4I", b"glTF", 2, 20 + len(text) + len(binary), len(text), 0x4E4F534A)
    (tmp_path / "b.glb").write_bytes(head + text + binary)
    read = load_scene(tmp_path / "b.glb")
    x, y, z = (written.means[:, i] * (-1, -1, 1)[i] for i in range(3))
    expected = np.stack([-(2 * z + 1), -(2 * y + 2), 2 * -x + 3], axis=1)
    np.testing.assert_allclose(read.means, expected, atol=1e-5)
    np.testing.assert_allclose(read.log_scales, written.log_scales + np.log(2), atol=1e-5)


@pytest.mark.parametrize("tag", ["antialiased 1", "SplatRenderMode: 2dgs"])
def test_sog_keeps_the_model(tmp_path, tag):
    save_scene(replace(scene(1, 0), comments=(tag,)), tmp_path / "a.sog")
    assert load_scene(tmp_path / "a.sog").comments == (tag,)


def test_spz_keeps_the_flag_and_tells_the_frame(tmp_path):
    save_scene(replace(scene(1, 0), comments=("antialiased 1",)), tmp_path / "a.spz")
    comments = load_scene(tmp_path / "a.spz").comments
    assert "antialiased 1" in comments and "splatview: the file says that its frame is RUB" in comments


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_splats_that_nobody_draws_are_left_out_where_numbers_are_rounded(tmp_path, suffix):
    broken = scene(9, 0)
    broken.means[0, 0], broken.quats[1], broken.sh[2, 0, 0] = np.nan, 0, np.inf
    save_scene(broken, tmp_path / f"a{suffix}")
    assert len(load_scene(tmp_path / f"a{suffix}")) == (300 if suffix == ".glb" else 297)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_scene_of_nothing(tmp_path, suffix):
    save_scene(scene(1, 0).take(np.arange(0)), tmp_path / f"a{suffix}")
    if suffix == ".splat":
        with pytest.raises(InputError, match="is empty"):
            load_scene(tmp_path / f"a{suffix}")
    else:
        assert len(load_scene(tmp_path / f"a{suffix}")) == 0


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_writing_and_reading_can_be_cancelled(tmp_path, suffix):
    asked = Progress(cancelled=lambda: True)
    with pytest.raises(Cancelled):
        save_scene(scene(1, 1), tmp_path / f"a{suffix}", progress=asked)
    assert not list(tmp_path.iterdir())
    save_scene(scene(1, 1), tmp_path / f"a{suffix}")
    with pytest.raises(Cancelled):
        load_scene(tmp_path / f"a{suffix}", progress=asked)


def read_or_refused(path: Path) -> bool:
    """Whether a damaged file was read; refused in one line is as good, and anything else raises."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            load_scene(path)
        except InputError as error:
            assert "\n" not in str(error) and path.name.split(".")[0] in str(error)
            return False
    return True


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_cut_and_damaged_files_are_read_or_refused(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    save_scene(scene(1, 1, count=40), path)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    bad = tmp_path / f"b{suffix}"
    for stop in {*range(0, 64, 7), *rng.integers(0, len(whole), 25).tolist()}:
        bad.write_bytes(whole[:stop])
        assert not read_or_refused(bad) or suffix == ".splat"
    for _ in range(60):
        damaged = bytearray(whole)
        for at in rng.integers(0, len(whole), rng.integers(1, 4)):
            damaged[at] = rng.integers(256)
        bad.write_bytes(damaged)
        read_or_refused(bad)


@pytest.mark.parametrize("change", ["order", "big endian", "ascii", "a list before"])
def test_compressed_ply_laid_out_otherwise(tmp_path, change):
    """Rows that are not as threads take them from the file, and such as begin at no certain place."""
    save_scene(scene(700, 2), tmp_path / "a.compressed.ply")
    ply = plyfile.PlyData.read(tmp_path / "a.compressed.ply")
    if change == "order":
        ply.elements = [
            plyfile.PlyElement.describe(
                repack_fields(element.data[list(element.data.dtype.names)[::-1]]), element.name
            )
            for element in ply.elements
        ]
    elif change == "big endian":
        ply.byte_order = ">"
    elif change == "ascii":
        ply.text = True
    else:
        lists = np.empty(2, [("some", object)])
        lists["some"] = [np.arange(3, dtype=np.int32), np.arange(5, dtype=np.int32)]
        ply.elements = [plyfile.PlyElement.describe(lists, "more"), *ply.elements]
    ply.write(tmp_path / "b.compressed.ply")
    plain, read = load_scene(tmp_path / "a.compressed.ply"), load_scene(tmp_path / "b.compressed.ply")
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(read, name), getattr(plain, name))


def test_compressed_ply_without_bounds_of_colours(tmp_path):
    """Chunks of 12 numbers, as older files have: colours are from 0 to 1."""
    written = scene(1, 0, count=300)
    save_scene(written, tmp_path / "a.compressed.ply")
    data = (tmp_path / "a.compressed.ply").read_bytes()
    head, _, body = data.partition(b"end_header\n")
    chunks = np.frombuffer(body, "<f4", 2 * 18).reshape(2, 18)
    lines = [line for line in head.split(b"\n") if line[-5:] not in (b"min_r", b"min_g", b"min_b")]
    lines = [line for line in lines if line[-5:] not in (b"max_r", b"max_g", b"max_b")]
    short = np.ascontiguousarray(chunks[:, :12]).tobytes() + body[chunks.nbytes :]
    (tmp_path / "b.compressed.ply").write_bytes(b"\n".join(lines) + b"end_header\n" + short)
    long, read = load_scene(tmp_path / "a.compressed.ply"), load_scene(tmp_path / "b.compressed.ply")
    np.testing.assert_array_equal(read.means, long.means)
    low, high = (np.repeat(chunks[:, at : at + 3], 256, axis=0)[:300] for at in (12, 15))
    shares = (0.5 + SH_C0 * long.sh[:, 0] - low) / (high - low)
    np.testing.assert_allclose(0.5 + SH_C0 * read.sh[:, 0], shares, atol=1e-5)


def webp(texels: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(texels, "RGBA").save(out, "WEBP", lossless=True, exact=True)
    return out.getvalue()


@pytest.mark.parametrize("degree", range(4))
def test_sog_of_version_1(tmp_path, degree):
    """Ranges in the place of codebooks, and no count of the palette; numbers by the format's definition."""
    rng = np.random.default_rng(degree)
    names = ("means_l", "means_u", "scales", "quats", "sh0", "shN_labels")
    pictures = {name: rng.integers(0, 256, (4, 8, 4), np.uint8) for name in names}
    pictures["quats"][..., 3] = rng.integers(252, 256, (4, 8))
    pictures["shN_labels"][..., 1] = 0
    coefficients = (degree + 1) ** 2 - 1
    low, high = np.array([-1.0, -2, 0, -4]), np.array([3.0, 1, 2, 5])
    means = {"shape": [30, 3], "mins": low[:3].tolist(), "maxs": high[:3].tolist()}
    ranges = {"scales": (low[:3], high[:3]), "sh0": (low, high)}
    meta = {"means": {**means, "files": ["means_l.webp", "means_u.webp"]}, "quats": {"files": ["quats.webp"]}}
    for name, (least, most) in ranges.items():
        meta[name] = {"mins": least.tolist(), "maxs": most.tolist(), "files": [f"{name}.webp"]}
    if degree:
        pictures["shN_centroids"] = rng.integers(0, 256, (4, 64 * coefficients, 4), np.uint8)
        files = ["shN_centroids.webp", "shN_labels.webp"]
        meta["shN"] = {"mins": -0.5, "maxs": 0.25, "files": files}
    for name, texels in pictures.items():
        (tmp_path / f"{name}.webp").write_bytes(webp(texels))
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    read = load_scene(tmp_path)
    assert len(read) == 30 and read.sh_degree == degree
    rows = {name: texels.reshape(-1, 4)[:30].astype(np.float64) for name, texels in pictures.items()}
    logs = low[:3] + (high - low)[:3] * (rows["means_u"] * 256 + rows["means_l"])[:, :3] / 65535
    np.testing.assert_allclose(read.means, np.sign(logs) * np.expm1(np.abs(logs)), atol=1e-5)
    np.testing.assert_allclose(
        read.log_scales, low[:3] + (high - low)[:3] * rows["scales"][:, :3] / 255, atol=1e-6
    )
    colours = low + (high - low) * rows["sh0"] / 255
    np.testing.assert_allclose(read.sh[:, 0], colours[:, :3], atol=1e-6)
    np.testing.assert_allclose(read.opacity_logits, colours[:, 3], atol=1e-6)
    if degree:
        palette = pictures["shN_centroids"][..., :3].reshape(256, coefficients, 3)
        rest = -0.5 + 0.75 * palette[rows["shN_labels"][:, 0].astype(int)] / 255.0
        np.testing.assert_allclose(read.sh[:, 1:], rest, atol=1e-6)


def spz4(count: int, streams: list[bytes], sizes: list[int]) -> bytes:
    head = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, count, 0, 12, 0, len(streams), 32)
    table = b"".join(struct.pack("<QQ", len(s), n) for s, n in zip(streams, sizes, strict=True))
    return head + table + b"".join(streams)


def zip_of(files: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return out.getvalue()


def sog_meta(**changes) -> dict[str, bytes]:
    files = sog_files(scene(1, 1, count=64), NO_PROGRESS)
    meta = json.loads(files["meta.json"])
    for path, value in changes.items():
        entry, *keys = path.split("__")
        target = meta
        for key in (entry, *keys[:-1])[: len(keys)]:
            target = target[key]
        target[keys[-1] if keys else entry] = value
    return {**files, "meta.json": json.dumps(meta).encode()}


BOMB = zstandard.ZstdCompressor(19).compress(bytes(1 << 28))

LIES = {
    "count.spz": (spz4(2**31, [b"x"] * 5, [9 * 2**31, *[2**31] * 4]), "fill the memory"),
    "bomb.spz": (spz4(100, [BOMB] * 5, [900, 100, 300, 300, 400]), "truncated or damaged"),
    "streams.spz": (spz4(4, [b""] * 2, [36, 4]), "streams"),
    "version.spz": (struct.pack("<4sIIBBBB", b"NGSP", 9, 1, 0, 12, 0, 5) + bytes(64), "version 9"),
    "tree.spz": (struct.pack("<4sIIBBBB", b"NGSP", 2, 1, 0, 12, 0x80, 0) + bytes(64), "levels of detail"),
    "odd.splat": (bytes(33), "no whole number"),
    "names.sog": (zip_of(sog_meta(quats__files=["../quats.webp"])), "only plain names"),
    "absent.sog": (zip_of(sog_meta(quats__files=["none.webp"])), "has no 'none"),
    "count.sog": (zip_of(sog_meta(count=2**30)), "fill the memory|does not fit|splats need"),
    "more.sog": (zip_of(sog_meta(count=65)), "are needed"),
    "nan.sog": (zip_of(sog_meta(means__mins=[float("nan"), 0, 0])), "not that of a scene"),
    "text.sog": (zip_of(sog_meta(count="many")), "a count of"),
    "other.sog": (zip_of(sog_meta(version=3)), "version '3'"),
    "nothing.sog": (zip_of({"readme.txt": b"hello"}), r"has no 'meta\.json'"),
    "short.glb": (b"glTF" + struct.pack("<4I", 2, 100, 2**31, 0x4E4F534A) + bytes(80), "truncated"),
}


@pytest.mark.parametrize("name", LIES)
def test_lies_are_refused_in_one_line_and_little_memory(tmp_path, name):
    content, said = LIES[name]
    (tmp_path / name).write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=said) as caught:
            load_scene(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < 4 * len(content) + (1 << 24)
    finally:
        tracemalloc.stop()
    assert "\n" not in str(caught.value)


def test_sog_codebooks_may_have_gaps_and_labels_may_be_out_of_range(tmp_path):
    files = sog_meta()
    meta = json.loads(files["meta.json"])
    meta["scales"]["codebook"][200:] = [None] * 56
    meta["shN"]["count"] = 3
    (tmp_path / "a.sog").write_bytes(zip_of({**files, "meta.json": json.dumps(meta).encode()}))
    read = load_scene(tmp_path / "a.sog")
    assert np.isfinite(read.log_scales).all() and (read.sh[:, 1:] == 0).all(axis=(1, 2)).any()


def apart(a: Gaussians, b: Gaussians) -> dict[str, float]:
    """The largest difference of each attribute; of opacities, not their logits."""
    return {
        "means": float(np.abs(a.means - b.means).max()),
        "log_scales": float(np.abs(a.log_scales - b.log_scales).max()),
        "sh": float(np.abs(a.sh - b.sh).max()),
        "quats": float(np.abs(quat_error(a, b)).max()),
        "opacities": opacity_error(a, b),
    }


@pytest.mark.parametrize(
    ("packed", "plain"), [("skull.sog", "skull.ply"), ("playbot_lod0", "playbot_lod0.ply")]
)
def test_sog_of_another_writer(data_file, packed, plain):
    """Files of splat-transform, and the .ply that it makes of them: equal but for rounding of float32."""
    path = data_file("scenes/skull.sog").parent
    differences = apart(load_scene(path / packed), load_scene(path / plain))
    assert max(differences.values()) < 1e-5, differences


def test_spz_and_compressed_ply_of_another_writer(data_file):
    """One scene in both formats: the frame is right, and each is within its steps of the other."""
    spz = load_scene(data_file("scenes/biker/biker.spz"))
    ply = load_scene(data_file("scenes/biker/biker.compressed.ply"))
    ply = replace(ply, log_scales=np.clip(ply.log_scales, -10, 255 / 16 - 10))
    differences = apart(spz, ply)
    assert differences["means"] < 2e-4 and differences["log_scales"] <= 1 / 32, differences
    assert differences["sh"] < 0.02 and differences["opacities"] < 0.005, differences
    # One file has axes turned about by half a circle, which are the same ellipsoid.
    axes = [np.abs(rotation_matrices(unit_quats(each.quats))) for each in (spz, ply)]
    assert np.abs(axes[0] - axes[1]).max() < 0.01


MINIMAL = (
    "minimal-v2.spz",
    "minimal-v3.spz",
    "minimal-v4.spz",
    "minimal-raw.spz",
    "minimal.splat",
    "minimal.ksplat",
)


@pytest.mark.parametrize("name", MINIMAL)
def test_small_files_of_another_writer(data_file, name):
    """Four splats at (-1, 0, ±1), (0, 0, ±1), (-1, 0, 0) and the origin, opacity 0.9, size 0.1."""
    read = load_scene(data_file(f"scenes/stfix/{name}"))
    assert np.array_equal(np.abs(read.means), [[1, 0, 1], [0, 0, 1], [1, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(sigmoid(read.opacity_logits), 230 / 255, atol=1e-6)
    np.testing.assert_allclose(read.log_scales, np.log(0.1), atol=1 / 32)
