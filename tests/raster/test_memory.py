"""Memory: bounded by so many bytes a splat and a pair, whatever the scene."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from splatview import raster
from splatview.raster.gradients import differentiate
from splatview.scene import RenderSettings, look_at

BYTES_A_SPLAT = 120
"""Record 64, depth 8, keys and order twice 16, visible 4, spans twice 8 and 8 for each row of tiles."""

BYTES_A_PAIR = 4

BYTES_A_PIXEL = 8
"""The light that is left, and the splats met before it was."""

BYTES_A_SPLAT_BACKWARD = 64
BYTES_A_PAIR_BACKWARD = 64


def test_workspace_per_splat_and_per_pair(random_gaussians):
    """Small splats: one row of tiles each, mostly."""
    scene = random_gaussians(40_000, sh_degree=0)
    scene.log_scales.flags.writeable = True
    scene.log_scales[:] -= 2
    camera = look_at((0, 0, -2.5), (0, 0, 0), width=320, height=200)
    splats, workspace = raster.parameters_of(scene), raster.Workspace()
    frame = raster.draw_frame(splats, camera, RenderSettings(), workspace, threads=2)
    pairs, tiles = int(frame.bins.offsets[-1]), len(frame.bins.offsets)
    extra_rows = max(0, len(frame.bins.spans) - len(scene))
    fixed = (64 + BYTES_A_PIXEL * 256) * tiles + 2 * frame.bins.positions.nbytes + 20_000
    allowed = BYTES_A_SPLAT * len(scene) + BYTES_A_PAIR * pairs + 8 * extra_rows + fixed
    assert workspace.nbytes <= allowed
    differentiate(splats, frame, np.ones_like(frame.image))
    allowed += BYTES_A_SPLAT_BACKWARD * len(scene) + BYTES_A_PAIR_BACKWARD * pairs
    assert workspace.nbytes <= allowed


FIVE_MILLION = """
import resource
import numpy as np
from splatview import raster
from splatview.raster.gradients import differentiate
from splatview.raster.parameters import check_parameters
from splatview.scene import RenderSettings, look_at
count = 5_000_000
rng = np.random.default_rng(0)
means = rng.normal(size=(count, 3), scale=0.4).astype(np.float32)
sh = rng.random((count, 16, 3), np.float32)
splats = check_parameters(
    means,
    rng.random((count, 4), np.float32) - np.float32(0.5),
    np.log(rng.random((count, 3), np.float32) * np.float32(0.004) + np.float32(0.0005)),
    rng.random(count, np.float32) * 4 - 2,
    sh,
)
camera = look_at((0, 0, -1.6), (0, 0, 0), width=1920, height=1080)
workspace = raster.Workspace()
frame = raster.draw_frame(splats, camera, RenderSettings(), workspace)
scene_bytes = sum(array.nbytes for array in splats)
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
print(len(frame.bins.order), int(frame.bins.offsets[-1]), scene_bytes, workspace.nbytes, peak)
differentiate(splats, frame, np.ones_like(frame.image))
print(workspace.nbytes, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""


@pytest.mark.slow
def test_five_million_splats_in_full_hd_fit_into_4_gib():
    """Forward and backward, the scene, torch-free Python and the gradients included."""
    result = subprocess.run(
        [sys.executable, "-c", FIVE_MILLION], capture_output=True, text=True, check=False, timeout=280
    )
    assert result.returncode == 0, result.stderr
    print(result.stdout)
    first, second = ([int(word) for word in line.split()] for line in result.stdout.splitlines())
    visible, pairs, _, _, peak = first
    assert visible > 3_000_000
    assert pairs > 5_000_000
    assert peak < 4 * 2**30
    assert second[1] < 4 * 2**30
