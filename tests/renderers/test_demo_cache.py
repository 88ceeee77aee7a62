"""The demo's cache: the same scene to the bit, and never in the way."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.renderers import demo_cache
from splatview.scene.demo import demo_scene


@pytest.fixture
def small_demo(monkeypatch, tmp_path):
    """A small demo, a cache of the test's own, and a count of how often it was made."""
    made = []

    def make():
        made.append(1)
        return demo_scene("gloss", splats=3000)

    monkeypatch.setattr(demo_cache, "demo_scene", make)
    monkeypatch.setenv("SPLATVIEW_CACHE_DIR", str(tmp_path / "cache"))
    return made


def test_the_second_time_it_is_read_back_bit_for_bit(small_demo):
    first, second = demo_cache.cached_demo(), demo_cache.cached_demo()
    assert len(small_demo) == 1
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.comments == second.comments and not second.extras


def test_a_broken_or_outdated_cache_is_replaced(small_demo, tmp_path):
    folder = tmp_path / "cache"
    folder.mkdir()
    (folder / "demo-0000000000000000.ply").write_bytes(b"an earlier version's")
    demo_cache.cached_demo()
    [path] = folder.iterdir()
    path.write_bytes(path.read_bytes()[:1000])
    demo_cache.cached_demo()
    demo_cache.cached_demo()
    assert len(small_demo) == 2 and len(list(folder.iterdir())) == 1


def test_a_folder_that_cannot_be_made_costs_only_time(small_demo, tmp_path):
    (tmp_path / "cache").write_text("a file in the way")
    assert len(demo_cache.cached_demo()) > 0
    demo_cache.cached_demo()
    assert len(small_demo) == 2
