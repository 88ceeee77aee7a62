"""A run killed at any moment, again and again, leaves a checkpoint from which it goes on."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from splatview.cli.main import main
from splatview.trainer.checkpoint import load_checkpoint
from splatview.trainer.warm_up import warm_up

OFTEN = """
import sys
from splatview.trainer import run
from splatview.cli.main import main
run.CHECKPOINT_SECONDS = 0.02
sys.exit(main(sys.argv[1:]))
"""
"""The command, writing a checkpoint after every other step or so: most kills hit a write."""


@pytest.fixture(scope="module", autouse=True)
def kernels() -> None:
    """Compiled before processes need them: each would compile them for itself."""
    warm_up()


@pytest.mark.parametrize("kills", [3, pytest.param(40, marks=pytest.mark.slow)])
def test_a_run_killed_again_and_again_resumes(capture_folder: Path, tmp_path: Path, kills: int) -> None:
    output, checkpoint = tmp_path / "toy.ply", tmp_path / "toy.checkpoint.safetensors"
    command = [sys.executable, "-c", OFTEN, "train", str(capture_folder), "--headless", "-o", str(output)]
    rng, reached = np.random.default_rng(7), [0]
    for _ in range(kills):
        written = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        resume = ["--resume", str(checkpoint)] if written else []
        with subprocess.Popen([*command, *resume], stderr=subprocess.PIPE, text=True) as process:
            deadline = time.monotonic() + 250
            while not (checkpoint.exists() and checkpoint.stat().st_mtime_ns > written):
                assert process.poll() is None and time.monotonic() < deadline
                time.sleep(0.002)
            time.sleep(rng.uniform(0, 0.3))
            process.kill()
        reached.append(load_checkpoint(checkpoint).counters.iteration)
    assert all(earlier < later for earlier, later in pairwise(reached))
    assert not output.exists()
    goal = reached[-1] + 5
    for leftover in tmp_path.glob(".*.tmp"):  # what is a second old may still be another's
        os.utime(leftover, (time.time() - 60, time.time() - 60))
    options = ["--headless", "-o", str(output), "--resume", str(checkpoint), "--iterations", str(goal)]
    assert main(["train", str(capture_folder), *options]) == 0
    assert load_checkpoint(checkpoint).counters.iteration == goal
    # Halves of files that a kill left are gone by the next checkpoint.
    assert not list(tmp_path.glob(".*.tmp"))
