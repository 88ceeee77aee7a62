"""Folders as a file browser shows them: what is in them, places to begin at, completion of typed paths."""

from __future__ import annotations

import fnmatch
import os
import string
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

SEPARATORS = os.sep + (os.altsep or "")

LIST = ";"
"""Between several paths that are typed at once."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A row of the browser."""

    path: Path
    is_folder: bool
    size: int = 0
    """Bytes, of a file."""
    modified: float = 0.0
    """Seconds since the epoch; 0 where unknown."""

    @property
    def name(self) -> str:
        return self.path.name or str(self.path)


def listed(folder: Path) -> list[Entry]:
    """What is in `folder`: folders first, both by name, hidden ones at the end of their kind.

    Raises:
        OSError: it cannot be read.
    """
    found = []
    with os.scandir(folder) as entries:
        for entry in entries:
            try:
                is_folder = entry.is_dir()
                status = entry.stat()
            except OSError:  # a link to nowhere, or not ours to look at
                found.append(Entry(path=folder / entry.name, is_folder=False))
                continue
            found.append(
                Entry(
                    path=folder / entry.name,
                    is_folder=is_folder,
                    size=status.st_size,
                    modified=status.st_mtime,
                )
            )
    return sorted(
        found, key=lambda entry: (not entry.is_folder, entry.name.startswith("."), entry.name.casefold())
    )


def entries_of(paths: Iterable[str]) -> list[Entry]:
    """Rows of the files and folders of `paths` that exist, in their order."""
    found = []
    for name in paths:
        try:
            status = os.stat(name)
        except (OSError, ValueError):
            continue
        found.append(
            Entry(
                path=Path(name),
                is_folder=os.path.isdir(name),
                size=status.st_size,
                modified=status.st_mtime,
            )
        )
    return found


def split(text: str, base: Path) -> tuple[Path, str]:
    """The folder that a typed path is in, and what is typed of a name in it; `base` is where relative paths
    begin."""
    text = os.path.expanduser(text.strip().strip("\"'"))
    cut = max(text.rfind(one) for one in SEPARATORS) + 1
    return base / text[:cut] if cut else base, text[cut:]


def typed_paths(text: str, base: Path) -> list[Path]:
    """The paths of a typed line: one that exists as it is, else the parts between semicolons."""
    whole = text.strip().strip("\"'")
    if not whole:
        return []
    if os.path.lexists(base / os.path.expanduser(whole)):
        return [base / os.path.expanduser(whole)]
    parts = (part.strip().strip("\"'") for part in text.split(LIST))
    return [base / os.path.expanduser(part) for part in parts if part]


def matching(
    entries: Sequence[Entry], patterns: Sequence[str], typed: str = "", *, folders_only: bool = False
) -> list[Entry]:
    """The rows to show: all folders, and files of the `patterns`; where something is `typed`, what begins
    with it, before what has it within. Hidden ones only where a dot is typed."""
    wanted = typed.casefold()
    shown = [
        entry
        for entry in entries
        if (entry.is_folder or (not folders_only and fits(entry.name, patterns)))
        and (not entry.name.startswith(".") or wanted.startswith("."))
        and wanted in entry.name.casefold()
    ]
    return sorted(shown, key=lambda entry: not entry.name.casefold().startswith(wanted)) if wanted else shown


def fits(name: str, patterns: Sequence[str]) -> bool:
    """Whether a file of this name has one of the `patterns`, in capitals or not."""
    lower = name.casefold()
    return any(fnmatch.fnmatchcase(lower, pattern.casefold()) for pattern in patterns)


def completed(text: str, base: Path, entries: Sequence[Entry]) -> str:
    """`text` with its last name as long as all `entries` that begin with it agree; a folder that is the only
    one gets its separator. Where nothing fits, `text`."""
    _, typed = split(text, base)
    fitting = [entry for entry in entries if entry.name.casefold().startswith(typed.casefold())]
    if not fitting or not (typed or len(fitting) == 1):
        return text
    names = [entry.name for entry in fitting]
    common = os.path.commonprefix([name.casefold() for name in names])  # noqa: RUF071, of names
    kept = text.rstrip()[: len(text.rstrip()) - len(typed)]
    if len(fitting) == 1:
        return kept + names[0] + (os.sep if fitting[0].is_folder else "")
    return kept + names[0][: max(len(common), len(typed))]


def places(recent: Iterable[str], *, most_recent: int = 6) -> list[tuple[str, Path]]:
    """Label and folder of places to begin at: the usual ones that exist, then the folders of `recent` paths,
    None of them twice."""
    home = Path.home() if os.path.isdir(os.path.expanduser("~")) else None
    usual = [("Working folder", Path.cwd())]
    if home is not None:
        usual.append(("Home", home))
        usual += [(name, home / name) for name in ("Desktop", "Documents", "Downloads", "Pictures")]
    if sys.platform == "win32":
        usual += [(f"{letter}:", Path(f"{letter}:\\")) for letter in string.ascii_uppercase]
    else:
        usual.append(("Computer", Path("/")))
    found = [(label, folder) for label, folder in usual if folder.is_dir()]
    known = {folder for _, folder in found}
    folders = []
    for name in recent:
        folder = Path(name).parent
        if folder not in known and folder.is_dir():
            known.add(folder)
            folders.append((folder.name or str(folder), folder))
    return [*found, *folders[:most_recent]]
