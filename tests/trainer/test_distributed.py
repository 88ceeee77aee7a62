"""Several processes train as one would with the same batch; what ends one of them ends all, in one line."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatview.cli.main import main
from splatview.scene.formats import load_scene
from splatview.trainer.checkpoint import load_checkpoint
from splatview.trainer.distributed import Alone, BatchSum, gist, stopping_between_steps
from splatview.trainer.warm_up import warm_up

SPLATVIEW = [sys.executable, "-c", "import sys; from splatview.cli.main import main; sys.exit(main())"]
TORCHRUN = [sys.executable, "-m", "torch.distributed.run"]


class Pair:
    """Two processes that torchrun would start, without torchrun."""

    def __init__(self, *arguments: list[str]) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = str(probe.getsockname()[1])
        self.processes = []
        for rank, options in enumerate(arguments):
            environment = {"RANK": str(rank), "WORLD_SIZE": "2", "LOCAL_WORLD_SIZE": "2"}
            environment |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
            self.processes.append(
                subprocess.Popen(
                    [*SPLATVIEW, "train", *options, "--headless"],
                    env=os.environ | environment,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    text=True,
                )
            )

    def results(self) -> list[tuple[int, list[str]]]:
        """(exit code, lines on standard error) of each."""
        printed = [process.communicate(timeout=240)[1].splitlines() for process in self.processes]
        return [(process.returncode, lines) for process, lines in zip(self.processes, printed, strict=True)]


@pytest.fixture(scope="module", autouse=True)
def kernels() -> None:
    """Compiled before processes need them: each would compile them for itself."""
    warm_up()


@pytest.fixture
def running(capture_folder: Path, tmp_path: Path) -> Iterator[Pair]:
    """A run of two without end, past its first 50 steps."""
    metrics = tmp_path / "m.jsonl"
    options = [str(capture_folder), "-o", str(tmp_path / "two.ply"), "--metrics", str(metrics)]
    pair = Pair(options, options)
    deadline = time.monotonic() + 200
    try:
        while not (metrics.exists() and metrics.read_text()):
            assert time.monotonic() < deadline and all(process.poll() is None for process in pair.processes)
            time.sleep(0.05)
        yield pair
    finally:
        for process in pair.processes:
            process.kill()
            process.communicate()


@pytest.mark.parametrize("strategy", ["classic", pytest.param("mcmc", marks=pytest.mark.slow)])
def test_two_processes_train_what_one_does_with_the_same_batch(
    capture_folder: Path, tmp_path: Path, strategy: str
) -> None:
    one, two = tmp_path / "one.ply", tmp_path / "two.ply"
    # The third photo of a step goes to the first process again, so that sums are rounded in another order.
    options = ["--iterations", "120", "--strategy", strategy, "--batch", "3", "--max-splats", "400"]
    command = [*TORCHRUN, "--nproc-per-node", "2", "--no-python", *SPLATVIEW, "train", str(capture_folder)]
    done = subprocess.run(
        [*command, "--headless", "-o", str(two), *options], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "2 processes share batches of 3" in done.stderr
    assert done.stdout.count("side by side") == 1
    assert main(["train", str(capture_folder), "--headless", "-o", str(one), *options]) == 0
    alone, shared = load_scene(one), load_scene(two)
    assert len(alone) == len(shared) != 60
    # Rounding grows along a run; a photo left out or counted twice would show in the first digits.
    for name in ("means", "log_scales", "opacity_logits", "sh"):
        difference = np.abs(getattr(alone, name) - getattr(shared, name))
        assert np.median(difference) < 1e-4, name


def test_one_photo_a_process_is_the_same_bit_for_bit(capture_folder: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one.ply", tmp_path / "two.ply"
    options = [str(capture_folder), "--iterations", "70"]
    pair = Pair([*options, "-o", str(two)], options)
    assert [code for code, _ in pair.results()] == [0, 0]
    assert main(["train", *options, "--headless", "-o", str(one), "--batch", "2"]) == 0
    assert one.read_bytes() == two.read_bytes()
    # What several began, one may end.
    for output in (one, two):
        checkpoint = str(output.with_name(f"{output.stem}.checkpoint.safetensors"))
        resume = ["--resume", checkpoint, "--iterations", "75", "-o", str(output)]
        assert main(["train", str(capture_folder), "--headless", *resume]) == 0
    assert one.read_bytes() == two.read_bytes()


def test_a_process_that_dies_ends_the_other_and_the_scene_is_kept(running: Pair, tmp_path: Path) -> None:
    running.processes[1].kill()
    code, lines = running.results()[0]
    assert code == 2
    assert lines[-1].startswith("splatview: process 0 of 2 stops, for another one has ended")
    assert lines[-1].endswith(f"go on with --resume {tmp_path / 'two.checkpoint.safetensors'}")
    assert len(load_scene(tmp_path / "two.ply")) > 0
    assert load_checkpoint(tmp_path / "two.checkpoint.safetensors").counters.iteration >= 50


def test_ctrl_c_ends_both_after_the_same_step(running: Pair, tmp_path: Path) -> None:
    running.processes[1].send_signal(signal.SIGINT)
    (code, lines), (other_code, other_lines) = running.results()
    assert (code, other_code) == (130, 130)
    assert "stopped at step" in lines[-1] and other_lines == []
    assert len(load_scene(tmp_path / "two.ply")) > 0


def test_processes_without_a_headless_run_are_refused(monkeypatch, capsys) -> None:
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert main(["train", "anything"]) == 2
    assert "add --headless" in capsys.readouterr().err
    monkeypatch.setenv("MASTER_ADDR", "")
    monkeypatch.delenv("MASTER_PORT", raising=False)
    assert main(["train", "anything", "--headless"]) == 2
    assert "start them with torchrun" in capsys.readouterr().err


def test_captures_that_differ_are_told_once(capture_folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(capture_folder, other)
    photo = other / "images" / "view_3.png"
    changed = np.asarray(Image.open(photo)).copy()
    changed[5, 5] ^= 1
    Image.fromarray(changed).save(photo)
    (code, lines), (other_code, other_lines) = Pair(
        [str(capture_folder), "-o", str(tmp_path / "x.ply")], [str(other)]
    ).results()
    assert (code, other_code) == (2, 2)
    assert [line for line in lines if line.startswith("splatview:")] == [
        "splatview: process 1 of 2 has other photos than process 0; all must be given the same capture and"
        " options"
    ]
    assert other_lines == []


@pytest.mark.slow
def test_a_mistake_of_one_process_is_told_once(capture_folder: Path, tmp_path: Path) -> None:
    (code, lines), (other_code, other_lines) = Pair(
        [str(capture_folder), "-o", str(tmp_path / "x.ply")], [str(tmp_path / "none")]
    ).results()
    assert (code, other_code) == (2, 2)
    assert lines == [f"splatview: process 1: {tmp_path / 'none'}: no such folder"]
    assert other_lines == []


def test_signals_stop_between_steps_and_are_the_callers_again_afterwards() -> None:
    group, before = Alone(), signal.getsignal(signal.SIGINT)
    with stopping_between_steps(group):
        assert group.agreed(3.0) == 3.0
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            group.agreed(4.0)
        with pytest.raises(KeyboardInterrupt):  # at once, the second time
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_batches_average_gradients(make_trainer) -> None:
    """A step over two photos has the mean of their gradients, and sees whom either sees."""
    trainer = make_trainer(batch=2)
    parameters, looked = list(trainer.splats.parameters()), []
    for place in range(2):
        trainer.optimizer.zero_grad()
        _, loss = trainer._render_and_backprop(trainer.views.at(place))
        looked.append(([gradient_of(tensor).copy() for tensor in parameters], loss))
    batch = BatchSum(parameters)
    for place in range(2):
        info, loss = trainer._render_and_backprop(trainer.views.at(place))
        batch.add(info.pieces, loss)
    seen, loss = batch.means(2, Alone(), 2)
    means = [gradient_of(tensor) for tensor in parameters]
    for mean, first, second in zip(means, looked[0][0], looked[1][0], strict=True):
        np.testing.assert_allclose(mean, (first + second) / 2, rtol=1e-6, atol=1e-12)
    assert loss == pytest.approx((looked[0][1] + looked[1][1]) / 2)
    moving = np.flatnonzero(np.abs(means[0]).sum(axis=1))
    assert len(moving) and np.isin(moving, np.concatenate(seen)).all()


def gradient_of(tensor: torch.Tensor) -> np.ndarray:
    assert tensor.grad is not None
    return tensor.grad.numpy()


def test_the_gist_of_torchs_messages() -> None:
    message = (
        "[/pytorch/third_party/gloo/pair.cc:553] Connection closed by peer [127.0.0.1]:7. Call someone!\nat"
    )
    assert gist(RuntimeError(message)) == "Connection closed by peer [127.0.0.1]:7"
