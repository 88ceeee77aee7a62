"""NOTICE names every dependency with the licence that its metadata state."""

from __future__ import annotations

import runpy
from importlib.metadata import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TOOL = runpy.run_path(str(ROOT / "tools" / "licences.py"))
NOTICE = (ROOT / "NOTICE").read_text(encoding="utf-8")
TEXT, _, LIST = NOTICE.partition(TOOL["MARKER"])


def lines_of(title: str) -> dict[str, str]:
    """Package -> licence, of the list below a title of NOTICE."""
    block = LIST.partition(f"\n{title}\n\n")[2].partition("\n\n")[0]
    pairs = [line.strip().partition("  ") for line in block.splitlines()]
    return {name: licence.strip() for name, _, licence in pairs}


@pytest.mark.parametrize("extra", TOOL["direct"]())
def test_every_dependency_is_listed_with_its_licence(extra):
    title = TOOL["TITLES"][extra]
    names = {metadata(one.name)["Name"] for one in TOOL["direct"]()[extra]}
    packages = lines_of(title)
    # A package is listed once, below the first title that needs it.
    anywhere = {name for each in TOOL["TITLES"].values() for name in lines_of(each)}
    assert names <= anywhere, f"missing: {names - anywhere}; run `make tables`"
    for name, licence in TOOL["listed"]()[extra].items():
        assert packages.get(name) == licence, f"{name}: run `make tables`"


def test_what_comes_along_is_listed_too():
    """Not named in pyproject.toml, but required by what is."""
    always = lines_of(TOOL["TITLES"][""])
    assert {"llvmlite", "glcontext", "Pygments"} <= set(always)
    assert "torch" not in always and "sympy" in lines_of(TOOL["TITLES"]["train"])


def test_the_one_copyleft_licence_is_explained():
    always = lines_of(TOOL["TITLES"][""])
    copyleft = {name for name, licence in always.items() if "GNU" in licence or "GPL" in licence}
    assert copyleft == {"plyfile"}
    assert all(words in TEXT for words in ("GPL-3.0-or-later", "MIT licence", "combined work"))


def test_a_package_without_a_licence_is_refused(monkeypatch):
    from email.message import Message

    monkeypatch.setitem(TOOL["licence"].__globals__, "metadata", lambda name: Message())
    with pytest.raises(ValueError, match="name no licence"):
        TOOL["licence"]("nothing")
