"""What a wheel holds is what the repository holds."""

from __future__ import annotations

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]

NOT_SHIPPED = {"tests", ".venv", "build"}


def test_every_package_is_listed():
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    found = {
        ".".join(("splatview", *path.parent.relative_to(ROOT).parts)): str(path.parent.relative_to(ROOT))
        for path in ROOT.glob("**/__init__.py")
        if path.relative_to(ROOT).parts[0] not in NOT_SHIPPED
    }
    assert set(listed["packages"]) == set(found)
    assert listed["package-dir"] == found
