"""Where compiled kernels are kept, and that the user is told."""

from __future__ import annotations

import os
import subprocess
import sys

PROGRAM = """
import time
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


def run(cache: str) -> list[str]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=200,
    )
    return result.stdout.split()


def test_compiles_once_and_says_so_once(tmp_path):
    assert run(str(tmp_path)) == ["True", "1", "False"]
    assert list(tmp_path.rglob("*.nbc"))
    assert run(str(tmp_path)) == ["False", "0", "False"]


def test_works_where_nothing_can_be_written(tmp_path):
    (tmp_path / "file").write_text("in the way")
    assert run(str(tmp_path / "file")) == ["True", "1", "False"]
