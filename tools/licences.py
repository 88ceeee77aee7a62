"""The list of dependencies and their licences in NOTICE, from the metadata of the installed packages.

``python tools/licences.py`` writes it anew; a test says when that is due.
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, metadata, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
NOTICE = ROOT / "NOTICE"

MARKER = "The lines below are written by `python tools/licences.py`.\n"
"""In NOTICE, what follows it is generated."""

TITLES = {
    "": "Always installed",
    "train": 'With the extra "train"',
    "plot": 'With the extra "plot"',
    "film": 'With the extra "film"',
    "dev": 'With the extra "dev": for tests, not for use',
}
"""Extra of pyproject.toml ("": none) -> title of its packages in the list."""

PLATFORM = {
    "python_version": "3.11",
    "python_full_version": "3.11.0",
    "implementation_name": "cpython",
    "platform_python_implementation": "CPython",
    "os_name": "posix",
    "sys_platform": "linux",
    "platform_system": "Linux",
    "platform_machine": "x86_64",
}
"""Environment for which requirements are resolved, so that the list is the same wherever it is made."""

NOT_LISTED = ("nvidia-", "cuda-", "triton")
"""Name prefixes of what torch's builds for GPUs bring along; NOTICE speaks of them in words."""

SPDX = {
    "MIT License": "MIT",
    "BSD License": "BSD",
    "GNU General Public License v3 or later (GPLv3+)": "GPL-3.0-or-later",
}
"""Classifiers of package indexes -> the usual short names, of those that leave no doubt."""

MOST_LETTERS = 60
"""A longer field `License` is the licence's text, not its name."""


def direct() -> dict[str, list[Requirement]]:
    """Requirements of pyproject.toml by extra ("": none), those on other extras of our own left out."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = {"": project["dependencies"], **project["optional-dependencies"]}
    parsed = {extra: [Requirement(line) for line in lines] for extra, lines in groups.items()}
    return {extra: [one for one in them if one.name != project["name"]] for extra, them in parsed.items()}


def listed() -> dict[str, dict[str, str]]:
    """By extra, package -> licence: those of pyproject.toml and what pip installs for them.

    A package is listed once, in the first group that needs it.

    Raises:
        PackageNotFoundError: a package that pyproject.toml names is not installed.
    """
    groups: dict[str, dict[str, str]] = {}
    known: set[str] = set()
    for extra, requirements in direct().items():
        found = {}
        for name in installed_for(requirements):
            if name not in known:
                known.add(name)
                found[metadata(name)["Name"]] = licence(name)
        groups[extra] = dict(sorted(found.items(), key=lambda item: item[0].lower()))
    return groups


def installed_for(requirements: list[Requirement]) -> Iterator[str]:
    """Canonical names of the requirements and of all that they require, where that is installed."""
    queue = [(one, True) for one in requirements]
    seen: set[tuple[str, frozenset[str]]] = set()
    while queue:
        requirement, is_direct = queue.pop(0)
        name = canonicalize_name(requirement.name)
        key = name, frozenset(requirement.extras)
        if key in seen or name.startswith(NOT_LISTED):
            continue
        seen.add(key)
        try:
            needed = requires(name) or []
        except PackageNotFoundError:
            if is_direct:
                raise
            continue
        yield name
        queue += [(one, False) for one in map(Requirement, needed) if applies(one, requirement.extras)]


def applies(requirement: Requirement, extras: set[str]) -> bool:
    """Whether a package that was asked for with `extras` needs this requirement on `PLATFORM`."""
    marker = requirement.marker
    return marker is None or any(marker.evaluate({**PLATFORM, "extra": extra}) for extra in ("", *extras))


def licence(name: str) -> str:
    """The licence of an installed package, as its metadata names it.

    Raises:
        ValueError: the metadata name none.
        PackageNotFoundError: it is not installed.
    """
    fields = metadata(name)

    def values(field: str) -> list[str]:
        return [value.strip() for value in fields.get_all(field) or []]

    if expression := values("License-Expression"):
        return expression[0]
    classifiers = {
        line.rpartition(" :: ")[2]
        for line in values("Classifier")
        if line.startswith("License :: OSI Approved :: ")
    }
    if classifiers:
        return ", ".join(sorted(SPDX.get(line, line) for line in classifiers))
    text = "".join(values("License"))
    if not text or len(text) > MOST_LETTERS or "\n" in text:
        raise ValueError(f"the metadata of {name} name no licence")
    return text


def section() -> str:
    """The generated part of NOTICE."""
    lines = []
    for extra, packages in listed().items():
        width = max(map(len, packages))
        lines += ["", TITLES[extra], ""]
        lines += [f"  {name:{width}}  {text}" for name, text in packages.items()]
    return "\n".join(lines) + "\n"


def filled(notice: str) -> str:
    """The text of NOTICE with the list made anew."""
    return notice.partition(MARKER)[0] + MARKER + section()


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    NOTICE.write_text(filled(NOTICE.read_text(encoding="utf-8")), encoding="utf-8")
