"""The blocks of the section "Train" of docs/python.md run, in order, in a folder with a capture `photos`."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from splatview.scene import Gaussians

PAGE = Path(__file__).parents[2] / "docs" / "python.md"


def test_the_section_on_training_runs(capture_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(capture_folder.parent)
    capture_folder.rename("photos")
    section = re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)[-1]
    assert section.startswith("Train\n")
    blocks = re.findall(r"^```python\n(.*?)^```$", section, re.DOTALL | re.MULTILINE)
    assert len(blocks) == 3
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    scene, trained, curve = names["scene"], names["trained"], names["curve"]
    assert isinstance(scene, Gaussians) and isinstance(trained, Gaussians) and isinstance(curve, list)
    assert len(curve) == 60 and curve[-1] < curve[0] and len(trained) == 60
