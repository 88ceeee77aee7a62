"""What a wheel holds is what the repository holds."""

from __future__ import annotations

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]

NOT_SHIPPED = {"tests", ".venv", "build"}


def test_every_package_is_listed():
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {path.parent.relative_to(ROOT) for path in ROOT.glob("**/__init__.py")}
    folders |= {path.parent.relative_to(ROOT) for path in ROOT.glob("shaders/**/*.glsl")}
    found = {
        ".".join(("splatview", *folder.parts)): str(folder)
        for folder in folders
        if folder.parts[0] not in NOT_SHIPPED
    }
    assert set(listed["packages"]) == set(found)
    assert listed["package-dir"] == found
