"""The README and the pages of the documentation, as a reader sees them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md"))]
MARKDOWN = MarkdownIt("commonmark").enable("table")


@cache
def tokens(page: Path) -> list[Token]:
    """The blocks of a page."""
    return MARKDOWN.parse(page.read_text(encoding="utf-8"))


def inline(page: Path) -> Iterator[Token]:
    """What stands within its lines."""
    for block in tokens(page):
        yield from block.children or ()


def code(page: Path, *languages: str) -> list[str]:
    """Its blocks of code in these languages."""
    return [
        one.content
        for one in tokens(page)
        if one.type == "fence" and one.info in languages
    ]


def spans(page: Path) -> list[str]:
    """Its words of code."""
    return [one.content for one in inline(page) if one.type == "code_inline"]


def links(page: Path) -> list[str]:
    """What its links and pictures lead to."""
    targets = (one.attrGet("href") or one.attrGet("src") for one in inline(page))
    return [str(target) for target in targets if target]


def anchors(page: Path) -> set[str]:
    """Of its headings, as GitHub and MyST make them."""
    every = tokens(page)
    titles = (
        after.content
        for one, after in zip(every, every[1:], strict=False)
        if one.type == "heading_open"
    )
    return {
        re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles
    }


def shell(page: Path) -> list[str]:
    """Its lines for a shell, without prompts, continued lines in one."""
    lines = [
        line
        for block in code(page, "sh")
        for line in block.replace("\\\n", " ").splitlines()
    ]
    typed = [line for block in code(page, "console") for line in block.splitlines()]
    return [
        line
        for line in [*lines, *(line[2:] for line in typed if line.startswith("$ "))]
        if line.strip() and not line.lstrip().startswith("#")
    ]
