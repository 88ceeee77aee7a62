"""torch is for training alone: all else works without it, and training says in a line what to install."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from splatview.scene import InputError
from splatview.trainer import torch_import

BLOCKED = "import sys; sys.modules['torch'] = None\n"
"""As if torch were not installed: an import of it raises ImportError."""

EVERYTHING_ELSE = (
    BLOCKED
    + """
import json
from pathlib import Path
from splatview.cli.main import main
import splatview.viewer.app, splatview.viewer.training.live, splatview.viewer.panels.training
import splatview.viewer.panels.recipe, splatview.viewer.panels.photos, splatview.viewer.editing.target
from splatview.trainer.checkpoint import load_checkpoint
from splatview.trainer.settings import TrainSettings
scene, capture, out = sys.argv[1:]
Path(out, "r.json").write_text(json.dumps({"splatview_recipe": 1, "scene": {}, "steps": []}))
codes = [
    main(["info", scene]),
    main(["render", scene, "-o", f"{out}/a.png", "--size", "32x24", "--renderer", "cpu"]),
    main(["convert", scene, f"{out}/a.spz"]),
    main(["edit", f"{out}/a.spz", "--recipe", f"{out}/r.json", "-o", f"{out}/b.ply"]),
    main(["train", capture, "--headless", "-o", f"{out}/t.ply"]),
    main(["ladder", "--train", capture]),
]
print(codes, Path(out, "b.ply").exists(), Path(out, "t.ply").exists())
try:
    from splatview.trainer import train
except Exception as error:
    print(error)
"""
)

LAZY = """
import sys
import splatview.viewer.app, splatview.viewer.training.live, splatview.trainer
import splatview.cli.train, splatview.cli.ladder, splatview.trainer.checkpoint
assert "torch" not in sys.modules
from splatview.trainer import rasterize, SelectiveAdam, train
from splatview.trainer import Splats
import numpy as np
from splatview.raster import Parameters
from splatview.trainer.settings import TrainSettings
shapes = ((3, 3), (3, 4), (3, 3), (3,), (3, 1, 3))
splats = Splats(Parameters(*(np.ones(shape, np.float32) for shape in shapes)))
optimizer = SelectiveAdam(splats, TrainSettings().rates(0, 1.0))
optimizer.step()
optimizer.zero_grad()
print("torch._dynamo" in sys.modules)
"""


def output_of(code: str, *arguments: str) -> tuple[list[str], list[str]]:
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=200, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines(), [line for line in done.stderr.splitlines() if "splatview:" in line]


def test_everything_but_training_works_without_torch(capture_folder: Path, tmp_path: Path, truth) -> None:
    from splatview.scene.formats import save_scene

    save_scene(truth, tmp_path / "scene.ply")
    said, lines = output_of(EVERYTHING_ELSE, str(tmp_path / "scene.ply"), str(capture_folder), str(tmp_path))
    assert said[-2] == "[0, 0, 0, 0, 2, 2] True False"
    assert said[-1] == torch_import.MISSING and "splatview[train]" in said[-1]
    assert lines == [f"splatview: {torch_import.MISSING}"] * 2


def test_torch_is_imported_when_something_of_it_is_used() -> None:
    """And its compiler never, which would take as long again."""
    said, _ = output_of(LAZY)
    assert said == ["False"]


def test_a_torch_that_cannot_be_imported_is_told(monkeypatch) -> None:
    def broken(*_: object) -> None:
        raise OSError("libtorch.so: no such file\nand more")

    monkeypatch.setattr("torch.set_num_threads", broken)
    with pytest.raises(InputError, match=r"cannot be imported \(libtorch.so: no such file and more\)"):
        torch_import.TorchImport().wait()
