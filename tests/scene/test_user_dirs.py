"""Folders of settings, caches and compiled kernels on each platform."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from splatview.scene.user_dirs import cache_folder, config_folder, kernel_folder


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    names = ("SPLATVIEW_CONFIG_DIR", "SPLATVIEW_CACHE_DIR", "XDG_CONFIG_HOME", "XDG_CACHE_HOME")
    for name in (*names, "NUMBA_CACHE_DIR", "APPDATA", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(
    ("platform", "config", "cache"),
    [
        ("linux", ".config", ".cache"),
        ("darwin", "Library/Application Support", "Library/Caches"),
        ("win32", "AppData/Local", "AppData/Local"),
    ],
)
def test_kernels_lie_beside_the_other_caches(monkeypatch, tmp_path, platform, config, cache):
    monkeypatch.setattr(sys, "platform", platform)
    assert config_folder() == tmp_path / config / "splatview"
    assert cache_folder() == tmp_path / cache / "splatview"
    assert kernel_folder() == cache_folder() / "kernels"


def test_the_environment_overrides(monkeypatch, tmp_path):
    monkeypatch.setenv("SPLATVIEW_CACHE_DIR", str(tmp_path / "mine"))
    kernels = kernel_folder()
    assert cache_folder() == tmp_path / "mine"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    assert kernel_folder() == tmp_path / "numba" / "splatview" != kernels
