"""README.md and docs/: commands that parse, links that resolve, paths that exist, and a short README."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from splatview.cli.arguments import Parser
from splatview.cli.main import COMMANDS, main

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]

MOST_README_LINES = 150

BLOCK = re.compile(r"^ *```(\w*)\n(.*?)^ *```$", re.DOTALL | re.MULTILINE)
SPAN = re.compile(r"`([^`\n]+)`")
LINK = re.compile(r"(!?)\[[^\[\]]*\]\(([^)\s]+)\)")
REPOSITORY_PATH = re.compile(r"[\w.-]+/([\w./-]*(\.py|\.glsl|/))?")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)

by_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def prose(page: Path) -> str:
    """The page without its blocks of code."""
    return BLOCK.sub("", page.read_text(encoding="utf-8"))


def commands(page: Path) -> Iterator[str]:
    """Command lines in blocks and in code spans; of a span only one with arguments is a whole line."""
    for language, block in BLOCK.findall(page.read_text(encoding="utf-8")):
        if language in ("", "sh"):
            yield from (line for line in block.splitlines() if re.search(r"\bsplatview\b", line))
    for span in SPAN.findall(prose(page)):
        if re.fullmatch(rf"splatview ({'|'.join(COMMANDS)}) .+|splatview [\w-]+\.ply.*", span):
            yield span


def anchors(page: Path) -> set[str]:
    """The fragments of a page's headings, as GitHub makes them."""
    plain = [heading.replace("`", "").lower() for heading in HEADING.findall(prose(page))]
    slugs = [re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain]
    return {
        slug if not slugs[:i].count(slug) else f"{slug}-{slugs[:i].count(slug)}"
        for i, slug in enumerate(slugs)
    }


@by_page
def test_command_lines_parse(page, monkeypatch, capsys):
    parsed = []

    def only_parse(self: Parser, arguments: list[str]) -> None:
        parsed.append(parse(self, arguments))

    parse = Parser.parse
    monkeypatch.setattr(Parser, "parse", only_parse)
    for line in commands(page):
        words = shlex.split(re.sub(r"(^|\s)#\s.*", "", line))
        arguments = words[words.index("splatview") + 1 :]
        parsed.clear()
        assert main(arguments) == 0, f"{line}: {capsys.readouterr().err}"
        assert len(parsed) == 1 and parsed[0] is not None, line


def test_command_lines_are_found_and_can_be_wrong(monkeypatch):
    lines = [line for page in PAGES for line in commands(page)]
    shown = {name for name in COMMANDS for line in lines if f"splatview {name} " in f"{line} "}
    assert shown == set(COMMANDS), "a command is shown on no page"
    monkeypatch.setattr(Parser, "parse", lambda self, arguments: self.parse_args(arguments))
    assert main(["render", "scene.ply", "--no-such-option"]) == 2


@by_page
def test_links_resolve(page):
    for _, target in LINK.findall(prose(page)):
        if re.match(r"https?:", target):
            continue
        path, _, fragment = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        assert linked.is_relative_to(ROOT) and linked.exists(), f"{page.name}: {target} does not exist"
        if fragment:
            assert fragment in anchors(linked), f"{page.name}: {target} is no heading of that page"


def test_pictures_are_pictures():
    shown = {
        (page.parent / target).resolve()
        for page in PAGES
        for image, target in LINK.findall(prose(page))
        if image
    }
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in shown)
    unused = set((ROOT / "assets" / "readme").iterdir()) - shown
    assert not unused, "no page shows these"


@by_page
def test_paths_exist(page):
    paths = [span for span in SPAN.findall(prose(page)) if REPOSITORY_PATH.fullmatch(span)]
    missing = sorted(path for path in paths if not (ROOT / path).exists())
    assert not missing, f"{page.name} names what does not exist"


def test_the_readme_is_short():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= MOST_README_LINES


def test_every_page_is_linked_from_the_readme():
    linked = {target.partition("#")[0] for _, target in LINK.findall(prose(README))}
    assert {f"docs/{page.name}" for page in PAGES[1:]} <= linked
