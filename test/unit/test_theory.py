"""The page of the theory names functions that exist and carry their equations, and the
pages on plug-ins show what the examples run.
"""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
THEORY = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
ROOMS = "contract|symbols|mechanisms|model|planning|estimation|control|identification"
NAME = re.compile(rf"`((?:{ROOMS})\.\w+\.[\w.]+)`")
TAG = re.compile(r"Eqs?\. ([\d(), and]+)")
PAGES = ("theory", "your_mechanism", "your_law_or_estimator", "symbols", "glossary")


def found(name: str) -> Any:
    """What ``room.module.attribute`` names; a module for two parts."""
    room, module, *attributes = name.split(".")
    thing: Any = importlib.import_module(f"dextar_control.{room}.{module}")
    for attribute in attributes:
        thing = getattr(thing, attribute)
    return thing


def numbers(text: str) -> set[int]:
    return {int(number) for number in re.findall(r"\d+", text)}


@pytest.mark.parametrize("page", PAGES)
def test_each_name_of_the_code_on_a_page_exists(page: str) -> None:
    for name in NAME.findall(
        (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    ):
        assert found(name) is not None, name


def rows() -> list[tuple[set[int], str]]:
    """Equations and function of each line of the table."""
    table = re.findall(r"^\| (\(\d.*?) \|.*\| `([\w.]+)` \|$", THEORY, re.MULTILINE)
    return [(numbers(equations), name) for equations, name in table]


@pytest.mark.parametrize(("equations", "name"), rows())
def test_a_function_carries_the_numbers_of_its_equations(
    equations: set[int], name: str
) -> None:
    tags = TAG.findall(inspect.getsource(found(name)))
    assert equations <= numbers(" ".join(tags)), name


def test_each_equation_of_the_paper_has_a_function() -> None:
    assert set.union(*(equations for equations, _ in rows())) == set(range(1, 15))


@pytest.mark.parametrize(
    ("page", "example"),
    [
        ("your_mechanism", "own_mechanism"),
        ("your_law_or_estimator", "own_law"),
        ("your_law_or_estimator", "own_estimator"),
    ],
)
def test_a_page_shows_what_the_example_runs(page: str, example: str) -> None:
    """The definitions, word by word."""
    text = (ROOT / "examples" / f"{example}.py").read_text(encoding="utf-8")
    shown = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    definition = re.search(
        r"^(?:class|def) .*?(?=\n\n\n)", text, re.DOTALL | re.MULTILINE
    )
    assert definition is not None and definition[0] in shown
