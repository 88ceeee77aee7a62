"""Training without a window, cut short from outside: what was trained is saved, and one line says where."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from splatview.cli.main import main
from splatview.raster import render
from splatview.scene.captures.demo import demo_capture
from splatview.scene.captures.nerfstudio import save_capture
from splatview.scene.formats import load_scene
from splatview.trainer import run as session
from splatview.trainer.checkpoint import load_checkpoint


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    folder = tmp_path / "pond"
    save_capture(demo_capture(render, photos=4, width=48, height=36, splats=1000), folder)
    return folder


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_request_to_end_saves(capture: Path, tmp_path: Path, name: str) -> None:
    """Ctrl-C does the same: see tests/trainer/test_train_command."""
    metrics = tmp_path / "m.jsonl"
    command = [sys.executable, "-c", "import sys; from splatview.cli.main import main; sys.exit(main())"]
    command += [
        "train",
        str(capture),
        "--headless",
        "-o",
        str(tmp_path / "toy.ply"),
        "--metrics",
        str(metrics),
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 200
    while not (metrics.exists() and metrics.read_text()):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(getattr(signal, name))
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130 and "Traceback" not in said
    reached = load_checkpoint(tmp_path / "toy.checkpoint.safetensors").counters.iteration
    assert reached >= 50 and f"stopped at step {reached:,}: " in said and "--resume" in said
    assert len(load_scene(tmp_path / "toy.ply")) > 0


def test_photos_that_are_removed_are_in_memory(capture: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    step = session.TrainingRun.step

    def remove(self: session.TrainingRun) -> session.RunProgress:
        if self.trainer.counters.iteration == 5:
            shutil.rmtree(capture)
        return step(self)

    monkeypatch.setattr(session.TrainingRun, "step", remove)
    output = tmp_path / "toy.ply"
    assert main(["train", str(capture), "--headless", "--iterations", "30", "-o", str(output)]) == 0
    assert not capture.exists()
    assert len(load_scene(output)) > 0
    assert list((tmp_path / "toy-held-out").glob("*.png"))
    assert load_checkpoint(tmp_path / "toy.checkpoint.safetensors").counters.iteration == 30
