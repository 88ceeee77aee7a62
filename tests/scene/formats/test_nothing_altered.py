"""Loading alters no value silently: every bit of a file is in the scene, whatever number it is, and back in
the file that is saved from it. What cannot be kept is said in the comments."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from splatview.scene import Gaussians
from splatview.scene.formats import load_cameras, load_scene, save_scene

PATTERNS = (
    *(0, 1 << 31, 1, 0x807FFFFF, 0x00800000, 0x7F7FFFFF, 0x7F800000, 0xFF800000),
    *(0x7FC00000, 0x7FFFFFFF, 0x7F800001, 0xFFBFFFFF, 0xFFC01234),  # NaN: signalling, and with payloads
)

BITS = st.one_of(st.sampled_from(PATTERNS), st.integers(0, 2**32 - 1))

FEW = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

EXTRAS = {"i1": "small", "u1": "label", "u2": "class", "i4": "segment", "f8": "time", "f4": "confidence"}


def columns_from(data: st.DataObject, degree: int, count: int) -> dict[str, np.ndarray]:
    """A trainer's properties, of any bits at all."""
    names = [*"xyz", *(f"f_dc_{c}" for c in range(3))]
    names += [f"f_rest_{i}" for i in range(3 * ((degree + 1) ** 2 - 1))]
    names += ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    table = data.draw(arrays.arrays(np.uint32, (count, len(names)), elements=BITS))
    columns = {name: np.ascontiguousarray(table[:, i]).view(np.float32) for i, name in enumerate(names)}
    for dtype, name in EXTRAS.items():
        raw = data.draw(st.binary(min_size=8 * count, max_size=8 * count))
        columns[name] = np.frombuffer(raw, dtype)[:count].copy()
    return columns


def bits(values: np.ndarray) -> bytes:
    return np.ascontiguousarray(values).tobytes()


def check_bits(scene: Gaussians, columns: dict[str, np.ndarray]) -> None:
    """Column for column, against the layout's definition."""
    rest = scene.sh.shape[1] - 1
    found = {name: scene.means[:, i] for i, name in enumerate("xyz")}
    found |= {f"f_dc_{c}": scene.sh[:, 0, c] for c in range(3)}
    found |= {f"f_rest_{c * rest + k}": scene.sh[:, 1 + k, c] for c in range(3) for k in range(rest)}
    found |= {"opacity": scene.opacity_logits}
    found |= {f"scale_{i}": scene.log_scales[:, i] for i in range(3)}
    found |= {f"rot_{i}": scene.quats[:, i] for i in range(4)}
    found |= dict(scene.extras)
    assert set(found) == set(columns)
    for name, values in columns.items():
        assert bits(found[name]) == bits(values), name


@pytest.mark.parametrize("form", ["binary_little_endian", "binary_big_endian"])
@FEW
@given(data=st.data(), degree=st.integers(0, 3), count=st.integers(1, 4))
def test_every_bit_of_a_ply(data, degree, count, form, tmp_path: Path, make_ply):
    columns = columns_from(data, degree, count)
    path = tmp_path / "any.ply"
    path.write_bytes(make_ply(columns, form=form))
    scene = load_scene(path)
    check_bits(scene, columns)
    assert scene.comments == ()
    again = tmp_path / "again.ply"
    save_scene(scene, again)
    check_bits(load_scene(again), columns)


@FEW
@given(values=arrays.arrays(np.float64, (2, 3), elements=st.floats(width=64)))
def test_every_bit_of_double_positions(values, tmp_path: Path, make_ply, columns_of, random_gaussians):
    columns = columns_of(random_gaussians(2, sh_degree=0))
    columns |= {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate("xyz")}
    path = tmp_path / "far.ply"
    path.write_bytes(make_ply(columns))
    assert bits(load_scene(path).means) == bits(values)


@FEW
@given(data=st.data(), count=st.integers(1, 3))
def test_every_number_of_an_ascii_ply(data, count, tmp_path: Path, make_ply):
    columns = columns_from(data, 0, count)
    path = tmp_path / "any.ply"
    path.write_bytes(make_ply(columns, form="ascii"))
    scene = load_scene(path)
    # Text has no payloads of NaN; all else comes to the bit.
    found = Gaussians(
        means=plain_nan(scene.means),
        quats=plain_nan(scene.quats),
        log_scales=plain_nan(scene.log_scales),
        opacity_logits=plain_nan(scene.opacity_logits),
        sh=plain_nan(scene.sh),
        extras={name: plain_nan(values) for name, values in scene.extras.items()},
    )
    check_bits(found, {name: plain_nan(values) for name, values in columns.items()})


def plain_nan(values: np.ndarray) -> np.ndarray:
    """Every NaN as the same one."""
    if values.dtype.kind != "f":
        return values
    return np.where(np.isnan(values), np.array(np.nan, values.dtype), values)


def test_rounded_doubles_are_told(tmp_path: Path, make_ply, columns_of, random_gaussians):
    columns = columns_of(random_gaussians(3, sh_degree=0))
    path = tmp_path / "wide.ply"
    path.write_bytes(make_ply({**columns, "opacity": columns["opacity"].astype(np.float64)}))
    assert load_scene(path).comments == (
        "splatview: the file's doubles were rounded to float32, but for positions",
    )


FINITE = st.floats(allow_nan=False, allow_infinity=False, width=64)


@FEW
@given(
    focal=st.tuples(*[st.floats(1e-3, 1e9)] * 2),
    centre=st.tuples(FINITE, FINITE),
    shift=st.tuples(*[FINITE] * 3),
)
def test_every_bit_of_cameras(focal, centre, shift, tmp_path: Path):
    matrix = np.eye(4)
    matrix[:3, 3] = shift
    names = ("fx", "fy", "cx", "cy")
    entry = {"width": 7, "height": 5, **dict(zip(names, (*focal, *centre), strict=True))}
    path = tmp_path / "c.json"
    path.write_text(json.dumps({**entry, "world_to_camera": matrix.tolist()}))
    (own,) = load_cameras(path)
    folder = tmp_path / "model"
    folder.mkdir(exist_ok=True)
    (folder / "cameras.bin").write_bytes(struct.pack("<QIiQQ4d", 1, 3, 1, 7, 5, *focal, *centre))
    image = struct.pack("<QI7dI", 1, 1, 1.0, 0.0, 0.0, 0.0, *shift, 3) + b"a.png\0" + struct.pack("<Q", 0)
    (folder / "images.bin").write_bytes(image)
    (model,) = load_cameras(folder)
    for camera in (own, model):
        assert [getattr(camera, name) for name in names] == [*focal, *centre]
        assert camera.world_to_camera.tobytes() == matrix.tobytes()
