"""Linear arrays in textures: runs of any length and place, growth, and what does not fit."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.renderers.gl import scene_textures as texel_array
from splatview.renderers.gl.scene_textures import TEXTURE_WIDTH, TexelArray
from splatview.scene import InputError


@pytest.fixture
def array(ctx):
    array = TexelArray(ctx, 1, "u4", "things")
    yield array
    array.release()


def contents(array: TexelArray) -> np.ndarray:
    return np.frombuffer(array.texture.read(), np.uint32)


def test_runs_of_any_length_land_where_they_belong(array, rng):
    count = 5 * TEXTURE_WIDTH + 77
    array.reserve(count)
    expected = np.zeros(count, np.uint32)
    array.write(expected)
    edges = [0, 1, TEXTURE_WIDTH - 1, TEXTURE_WIDTH, TEXTURE_WIDTH + 1, 3 * TEXTURE_WIDTH, count - 1, count]
    for first in edges:
        for end in edges:
            if end < first:
                continue
            values = rng.integers(0, 2**32, end - first, dtype=np.uint32)
            array.write(values, first)
            expected[first:end] = values
            assert np.array_equal(contents(array)[:count], expected)


def test_texels_of_several_numbers(ctx, rng):
    array = TexelArray(ctx, 4, "f4", "things")
    values = rng.normal(size=(TEXTURE_WIDTH + 3, 4)).astype(np.float32)
    array.reserve(len(values))
    array.write(values[:5])
    array.write(values[5:], 5)
    found = np.frombuffer(array.texture.read(), np.float32).reshape(-1, 4)
    assert np.array_equal(found[: len(values)], values)
    array.release()


def test_room_is_made_only_where_there_is_none(array):
    with pytest.raises(RuntimeError, match="reserve"):
        _ = array.texture
    array.reserve(10)
    texture = array.texture
    array.reserve(TEXTURE_WIDTH)
    assert array.texture is texture
    array.reserve(TEXTURE_WIDTH + 1)
    assert array.texture.height == 2


def test_more_than_a_texture_holds_is_refused_in_one_line(array, monkeypatch):
    monkeypatch.setattr(texel_array, "TEXTURE_WIDTH", 1)
    with pytest.raises(
        InputError, match="70,000 things do not fit into this OpenGL driver's textures"
    ) as caught:
        array.reserve(70_000)
    assert "\n" not in str(caught.value)
