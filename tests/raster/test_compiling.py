"""Where compiled kernels are kept, and that the user is told."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from splatview.raster import compiling
from splatview.scene.compiling import remove_old_caches

HERE = Path(compiling.__file__).parent

PROGRAM = """
import numpy as np
from splatview import raster
from splatview.scene import Gaussians, look_at
zeros = np.zeros((1, 3), np.float32)
scene = Gaussians(means=zeros, quats=np.ones((1, 4), np.float32), log_scales=zeros,
                  opacity_logits=np.zeros(1, np.float32), sh=np.zeros((1, 1, 3), np.float32))
camera = look_at((0, 0, -3), (0, 0, 0), width=8, height=8)
told = []
print(raster.will_compile())
raster.render(scene, camera, on_compile=lambda: told.append(1), threads=1)
raster.render(scene, camera, on_compile=lambda: told.append(1), threads=1)
print(len(told), raster.will_compile())
"""


INSTEAD = """
from types import SimpleNamespace
from splatview import raster
from splatview.raster.sort import make_keys
def draw_frame(*_, **__):
    numbers = np.zeros(1, np.int32)
    make_keys(0, 0, 0, numbers, np.zeros(1, np.int64), 0, 0, np.zeros(1, np.uint64))
    return SimpleNamespace(image=None, milliseconds={})
raster.draw_frame = draw_frame
"""
"""Draws by one small kernel of the renderer's, for who asks when it is compiled, not what it draws."""


def run(cache: str, *, small: bool) -> list[str]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM.replace("zeros =", f"{INSTEAD}zeros =", 1) if small else PROGRAM],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=200,
    )
    return result.stdout.split()


@pytest.mark.parametrize("small", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_compiles_once_and_says_so_once(tmp_path, small):
    assert run(str(tmp_path), small=small) == ["True", "1", "False"]
    assert list(tmp_path.rglob("*.nbc"))
    assert run(str(tmp_path), small=small) == ["False", "0", "False"]


def test_nothing_is_cached_where_nothing_can_be_written(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert compiling.cache_folder.__wrapped__(HERE) is None

    @compiling.kernel
    def one_more(number):
        return number + 1

    assert one_more(1) == 2


def test_sources_of_both_packages_decide_the_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    package = tmp_path / "package"
    package.mkdir()
    source = package / "kernels.py"
    source.write_text("one = 1\n")
    first = compiling.cache_folder.__wrapped__(package)
    assert first is not None
    assert first.is_dir()
    assert compiling.cache_folder.__wrapped__(package) == first
    source.write_text("one = 2\n")
    assert compiling.cache_folder.__wrapped__(package) != first


def test_only_old_compiled_files_are_removed(tmp_path):
    old, new = tmp_path / "old", tmp_path / "new"
    for folder in (old, new):
        (folder / "sub").mkdir(parents=True)
        (folder / "sub" / "kernel.nbc").write_text("x")
    (old / "letter.txt").write_text("not ours")
    os.utime(old, (0, 0))
    remove_old_caches(tmp_path)
    assert sorted(path.name for path in tmp_path.rglob("*")) == [
        "kernel.nbc",
        "letter.txt",
        "new",
        "old",
        "sub",
    ]


@pytest.mark.parametrize("damage", ["index", "data", "unwritable"])
def test_a_damaged_or_full_cache_of_kernels_costs_time_only(tmp_path, damage):
    """What failed: a traceback at every start until the user deleted the cache by hand."""
    source = tmp_path / "package" / "kernels.py"
    source.parent.mkdir()
    source.write_text(
        "from splatview.raster.compiling import kernel\n\n@kernel\ndef add(a, b):\n    return a + b\n"
    )
    code = "import sys; sys.path.insert(0, sys.argv[1]); import kernels; print(kernels.add(2.0, 3.0))"

    def run() -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", code, str(source.parent)],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")},
            capture_output=True,
            text=True,
            check=False,
            timeout=200,
        )

    first = run()
    assert (first.returncode, first.stdout.strip(), first.stderr) == (0, "5.0", "")
    files = [*tmp_path.glob("cache/**/*.nbi" if damage == "index" else "cache/**/*.nbc")]
    assert files
    for file in files:
        if damage == "unwritable":
            file.unlink()
            file.mkdir()
        else:
            file.write_bytes(b"\x80\x04garbage")
    again = run()
    assert (again.returncode, again.stdout.strip()) == (0, "5.0"), again.stderr
    assert all(
        line.startswith("splatview: the cache of compiled kernels") for line in again.stderr.splitlines()
    )
    assert len(again.stderr.splitlines()) <= 2
    if damage != "unwritable":
        healed = run()
        assert (healed.returncode, healed.stdout.strip(), healed.stderr) == (0, "5.0", "")
