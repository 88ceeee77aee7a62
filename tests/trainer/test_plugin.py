"""Losses of one's own: they train, the examples run, and what is wrong with one is a line that names it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from test_distributed import Pair

from splatview.cli.main import main
from splatview.scene.formats import load_scene
from splatview.trainer import PluginError, train
from splatview.trainer.checkpoint import load_checkpoint
from splatview.trainer.plugin import LossPlugin, load_plugin
from splatview.trainer.splats import copied
from splatview.trainer.trainer import Trainer

EXAMPLES = Path(__file__).parents[2] / "examples"


def written(folder: Path, body: str, name: str = "my_loss.py") -> Path:
    path = folder / name
    path.write_text(body)
    return path


def headless(capture: Path, output: Path, *options: str) -> int:
    return main(["train", str(capture), "--headless", "-o", str(output), "--iterations", "40", *options])


def lines_of(capsys) -> list[str]:
    return [line for line in capsys.readouterr().err.splitlines() if line.startswith("splatview:")]


def test_a_plugin_sees_the_step_and_changes_what_is_learnt(make_trainer) -> None:
    steps = []

    def loss(step):
        steps.append((step.iteration, step.camera.name))
        assert step.image.shape == (40, 48, 4) and step.photo.shape == (40, 48, 3)
        assert step.depth().shape == (40, 48) and step.mask is None
        assert 0 <= step.progress < 1 and step.splats.sh.shape == (60, 1, 3)
        return step.photo_loss + 0.1 * step.splats.opacity_logits.sigmoid().mean()

    options = {"strategy": "classic", "resolution": (), "iterations": 1000}
    plain, pulled = make_trainer(**options), make_trainer(**options)
    pulled.loss = LossPlugin(loss)
    reports = []
    for _ in range(10):
        plain.step()
        reports.append(pulled.step())
    assert [number for number, _ in steps] == list(range(1, 11)) and len({name for _, name in steps}) == 10
    assert pulled.loss.replaces is False and np.isfinite(reports[-1].loss)
    fewer = pulled.splats.opacity_logits.sigmoid().mean()
    assert fewer < plain.splats.opacity_logits.sigmoid().mean() - 0.01


def test_a_plugin_of_nothing_changes_no_bit(make_trainer) -> None:
    plain, same = make_trainer(dropout=0.2), make_trainer(dropout=0.2)
    same.loss = LossPlugin(lambda step: step.photo_loss)
    for _ in range(60):
        assert plain.step().loss == same.step().loss
    for ours, theirs in zip(plain.splats.arrays, same.splats.arrays, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_what_dropout_takes_out_of_the_picture_moves_by_its_depth(make_trainer) -> None:
    trainer: Trainer = make_trainer(strategy="classic", resolution=(), iterations=10, dropout=0.9, seed=3)
    trainer.counters.iteration = 8
    kept = []

    def loss(step):
        depth = step.depth().mean()
        kept.append(step.depth_visibility.visible)
        return 0 * step.image.mean() + depth

    trainer.loss = LossPlugin(loss)
    before = copied(trainer.splats.arrays)
    trainer.step()
    moved = (trainer.splats.arrays.means != before.means).any(axis=1)
    assert kept[0].sum() > 40 and moved[kept[0].numpy()].mean() > 0.9


def test_a_plugin_can_replace_the_photo_loss(make_trainer) -> None:
    trainer: Trainer = make_trainer(iterations=100, resolution=())
    trainer.loss = LossPlugin(lambda step: (step.image[..., :3] - step.photo / 255).square().mean())
    losses = [trainer.step().loss for _ in range(100)]
    assert trainer.loss.replaces and np.mean(losses[-20:]) < 0.8 * np.mean(losses[:20])
    assert "loss" not in trainer.clock.milliseconds, "the photo loss was not even computed"


WRONG = {
    "raises": (
        "def loss(step):\n    return step.photo_loss + {}['x']\n",
        r":2: loss failed at step 1: Key",
    ),
    "leaves": ("def loss(step):\n    raise SystemExit(0)\n", r":2: loss failed at step 1: SystemExit"),
    "nothing": (
        "def loss(step):\n    step.photo_loss\n",
        r"must return a scalar of torch, not NoneType",
    ),
    "picture": (
        "def loss(step):\n    return step.image\n",
        r"must return a scalar, not float32 of shape",
    ),
    "whole number": (
        "def loss(step):\n    return step.photo.sum()\n",
        r"must return a scalar, not int64 of shape",
    ),
    "no graph": (
        "def loss(step):\n    return step.image.detach().mean()\n",
        r": loss returned a tensor without a graph.*\(step 1\)",
    ),
    "NaN later": (
        "def loss(step):\n    return step.photo_loss * (float('nan') if step.iteration == 7 else 1)\n",
        r": loss returned nan \(step 7\)",
    ),
    "infinite": ("def loss(step):\n    return step.photo_loss / 0\n", r": loss returned inf \(step 1\)"),
    "NaN gradient": (
        "def loss(step):\n    return step.photo_loss + 0 * (step.image[..., 3] * 0).sqrt().sum()\n",
        r": loss has a gradient by the picture that is not finite \(step 1\)",
    ),
    "NaN gradient of a parameter": (
        "def loss(step):\n    return step.photo_loss + (step.splats.quats * 0).norm(dim=1).sqrt().sum()\n",
        r": loss has a gradient by quats that is not finite \(step 1\)",
    ),
    "differentiates": (
        "def loss(step):\n    step.photo_loss.backward()\n    return step.photo_loss\n",
        r": loss could not be differentiated at step 1: RuntimeError",
    ),
    "writes": (
        "def loss(step):\n    step.splats.means += 1\n    return step.photo_loss\n",
        r":2: loss failed at step 1: ",
    ),
    "second derivatives": (
        "import torch\ndef loss(step):\n    g, = torch.autograd.grad(step.depth().sum(), step.splats.means,"
        " create_graph=True)\n    return step.photo_loss + g.square().sum()\n",
        r"at step 1: RuntimeError",
    ),
}


@pytest.mark.parametrize("kind", WRONG)
def test_what_is_wrong_is_named_and_the_step_has_not_happened(make_trainer, tmp_path, kind: str) -> None:
    body, said = WRONG[kind]
    trainer: Trainer = make_trainer(strategy="classic", resolution=())
    trainer.loss = load_plugin(written(tmp_path, body))
    before, noted, steps = copied(trainer.splats.arrays), np.empty(0), 0
    with pytest.raises(PluginError, match=rf"^{re.escape(str(tmp_path / 'my_loss.py'))}.*{said}") as caught:
        for _ in range(10):
            before, steps = copied(trainer.splats.arrays), trainer.counters.iteration
            noted = trainer.state["gradient_sums"].copy()
            trainer.step()
    assert "\n" not in str(caught.value)
    for ours, theirs in zip(trainer.splats.arrays, before, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert trainer.counters.iteration == steps
    np.testing.assert_array_equal(trainer.state["gradient_sums"], noted)
    # The trainer goes on, as if nothing had been.
    whole = make_trainer(strategy="classic", resolution=())
    trainer.loss = None
    while whole.counters.iteration < 12:
        whole.step()
    while trainer.counters.iteration < 12:
        trainer.step()
    if kind != "NaN later":
        np.testing.assert_array_equal(whole.splats.arrays.means, trainer.splats.arrays.means)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("def loss(step:\n", r":1: cannot be imported: SyntaxError"),
        ("import torch\nimport no_such_module\n", r":2: cannot be imported: ModuleNotFoundError"),
        ("import sys\nsys.exit(3)\n", r":2: cannot be imported: SystemExit: 3"),
        ("def my_loss(step): pass\n", r": has no function loss\(step\)"),
        ("loss = 3\n", r": has no function loss\(step\)"),
    ],
)
def test_files_that_are_no_plugins(capture_folder, tmp_path, capsys, body: str, said: str) -> None:
    path = written(tmp_path, body)
    assert headless(capture_folder, tmp_path / "x.ply", "--plugin", str(path)) == 2
    (line,) = lines_of(capsys)
    assert re.search(rf"{re.escape(str(path))}{said}", line)
    assert not (tmp_path / "x.ply").exists()
    assert headless(capture_folder, tmp_path / "x.ply", "--plugin", str(tmp_path / "none.py")) == 2
    assert "no such file" in lines_of(capsys)[0]


def test_a_failure_keeps_the_scene_and_names_what_is_saved(capture_folder, tmp_path, capsys) -> None:
    path, output = written(tmp_path, WRONG["NaN later"][0]), tmp_path / "x.ply"
    assert headless(capture_folder, output, "--plugin", str(path)) == 2
    (line,) = lines_of(capsys)
    assert "my_loss.py: loss returned nan (step 7); " in line and f"{output} is as far as it came" in line
    checkpoint = tmp_path / "x.checkpoint.safetensors"
    assert load_checkpoint(checkpoint).counters.iteration == 6
    assert len(load_scene(output)) == 60
    # Without its plugin it is not resumed by mistake; with a better one, or none, it goes on.
    resume = ("--resume", str(checkpoint))
    assert headless(capture_folder, output, *resume) == 2
    assert "--plugin my_loss.py" in lines_of(capsys)[0]
    written(tmp_path, "def loss(step):\n    return step.photo_loss\n")
    assert headless(capture_folder, output, *resume, "--plugin", str(path)) == 0
    assert "was trained with another" in capsys.readouterr().err
    assert headless(capture_folder, output, *resume, "--plugin", "none", "--iterations", "45") == 0


def test_a_failure_at_the_first_step_writes_nothing(capture_folder, tmp_path, capsys) -> None:
    path, output = written(tmp_path, WRONG["raises"][0]), tmp_path / "x.ply"
    output.write_bytes(b"of before")
    assert headless(capture_folder, output, "--plugin", str(path)) == 2
    (line,) = lines_of(capsys)
    assert "my_loss.py:2: loss failed at step 1" in line and line.endswith(
        "; nothing was trained, and nothing written"
    )
    assert output.read_bytes() == b"of before"
    assert sorted(file.name for file in tmp_path.iterdir() if file.is_file()) == ["my_loss.py", "x.ply"]


def test_a_resumed_run_with_a_plugin_goes_on_bit_for_bit(capture_folder, tmp_path) -> None:
    whole, part = tmp_path / "whole.ply", tmp_path / "part.ply"
    plugin = ("--plugin", str(EXAMPLES / "entropy.py"))
    assert headless(capture_folder, whole, *plugin) == 0
    stops = written(
        tmp_path,
        "import entropy\ndef loss(step):\n    if step.iteration == 21:\n        raise ValueError\n"
        "    return entropy.loss(step)\n",
    )
    (tmp_path / "entropy.py").write_text((EXAMPLES / "entropy.py").read_text())  # beside it, to be imported
    assert headless(capture_folder, part, "--plugin", str(stops)) == 2
    resume = ("--resume", str(tmp_path / "part.checkpoint.safetensors"))
    assert headless(capture_folder, part, *resume, *plugin) == 0
    assert whole.read_bytes() == part.read_bytes()


def test_two_processes_share_a_plugin(capture_folder, tmp_path) -> None:
    options = [str(capture_folder), "--iterations", "20", "--plugin", str(EXAMPLES / "entropy.py")]
    one, two = tmp_path / "one.ply", tmp_path / "two.ply"
    assert [code for code, _ in Pair([*options, "-o", str(two)], options).results()] == [0, 0]
    assert main(["train", *options, "--headless", "-o", str(one), "--batch", "2"]) == 0
    assert one.read_bytes() == two.read_bytes()


def test_a_plugin_that_fails_in_one_process_ends_both(capture_folder, tmp_path) -> None:
    body = "import os\ndef loss(step):\n    if os.environ['RANK'] == '1' and step.iteration == 5:\n"
    path = written(tmp_path, body + "        raise ValueError('mine')\n    return step.photo_loss\n")
    options = [str(capture_folder), "--iterations", "20", "--plugin", str(path)]
    (code, lines), (other_code, other_lines) = Pair(
        [*options, "-o", str(tmp_path / "two.ply")], options
    ).results()
    assert (code, other_code) == (2, 2)
    assert other_lines[-1] == f"splatview: {path}:4: loss failed at step 5: ValueError: mine"
    assert "another one has ended" in lines[-1] and "is as far as it came" in lines[-1]
    assert load_checkpoint(tmp_path / "two.checkpoint.safetensors").counters.iteration == 4


@pytest.mark.parametrize("name", ["entropy", "smooth_depth"])
def test_examples_train(capture_folder, tmp_path, name: str) -> None:
    output = tmp_path / "x.ply"
    assert (
        headless(capture_folder, output, "--plugin", str(EXAMPLES / f"{name}.py"), "--iterations", "120") == 0
    )
    assert len(load_scene(output)) > 60


def test_from_python(capture_folder, tmp_path) -> None:
    reports, threads = [], torch.get_num_threads()
    scene, evaluation = train(
        capture_folder, loss=EXAMPLES / "smooth_depth.py", iterations=40, on_step=reports.append
    )
    assert [report.iteration for report in reports] == list(range(1, 41)) and evaluation is not None
    assert evaluation.psnr > 10 and torch.get_num_threads() == threads
    assert headless(capture_folder, tmp_path / "x.ply", "--plugin", str(EXAMPLES / "smooth_depth.py")) == 0
    np.testing.assert_array_equal(load_scene(tmp_path / "x.ply").means, scene.means)

    def broken(step):
        return step.photo_loss / (step.iteration - 3)

    with pytest.raises(PluginError, match=r"test_plugin.py: loss returned inf \(step 3\)") as caught:
        train(capture_folder, loss=broken, iterations=40, max_splats=100)
    assert caught.value.scene is not None and len(caught.value.scene) == 60
    with pytest.raises(TypeError, match="max_splat"):
        train(capture_folder, iterations=40, max_splat=100)


@pytest.mark.parametrize("strategy", ["mcmc", "classic"])
def test_a_loop_of_ones_own(capture_folder, tmp_path, strategy: str) -> None:
    command = [sys.executable, str(EXAMPLES / "own_loop.py"), str(capture_folder), "--downscale", "1"]
    done = subprocess.run(
        [*command, "-o", str(tmp_path / "x.ply"), "--steps", "200", "--strategy", strategy],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ,
    )
    assert done.returncode == 0, done.stderr
    losses = [float(value) for value in re.findall(r"loss ([\d.]+)", done.stdout)]
    assert len(losses) == 2 and losses[1] < losses[0] < 0.4
    assert len(load_scene(tmp_path / "x.ply")) > 60
