"""What a wheel holds is what the repository holds."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
import setuptools

ROOT = Path(__file__).parents[1]

NOT_SHIPPED = {"examples", "tests", "tools", "scripts", ".venv", "build"}


def test_every_folder_of_modules_and_shaders_is_a_package(monkeypatch: pytest.MonkeyPatch):
    given: dict[str, list[str]] = {}
    monkeypatch.setattr(setuptools, "setup", lambda **options: given.update(options))
    monkeypatch.chdir(ROOT)
    runpy.run_path(str(ROOT / "setup.py"))
    folders = {path.parent.relative_to(ROOT) for path in ROOT.glob("*/**/*.py")}
    folders |= {path.parent.relative_to(ROOT) for path in ROOT.glob("shaders/**/*.glsl")}
    shipped = (folder.parts for folder in folders if folder.parts[0] not in NOT_SHIPPED)
    assert set(given["packages"]) == {"splatview", *(".".join(("splatview", *parts)) for parts in shipped)}
