"""The documentation's table of symbols is that of the code, and all of the paper's
equations are in it.
"""

from __future__ import annotations

import ast
import dataclasses
import re
from pathlib import Path
from typing import NamedTuple

import pytest

from dextar_control.mechanisms import mechanism_named
from dextar_control.model.equations import Equations
from dextar_control.model.model import equations_of

ROOT = Path(__file__).resolve().parents[2]
SHAPES = {
    "(n, n)": ("n", "n"),
    "(n,)": ("n", "1"),
    "(k,)": ("k", "1"),
    "(n, k)": ("n", "k"),
}
NOT_OF_THE_PAPER = {
    "p",
    "q_a",
    "x",
    "x_dot",
    "x_ddot",
    "tau",
    "friction",
    "forward_dynamics",
    "s",
    "s_blocks",
    "singular",
    "type1",
}
TAG = re.compile(r"# Eqs?\. (.*)$")


class Row(NamedTuple):
    """One line of the table."""

    name: str
    shape: str
    numbers: set[int]
    file: str


def rows() -> list[Row]:
    """All of them."""
    found = []
    for line in (ROOT / "docs" / "symbols.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 6 and cells[1].startswith("`"):
            numbers = {int(number) for number in cells[4].split(",")}
            found.append(
                Row(cells[1].strip("`"), cells[2], numbers, cells[5].strip("`"))
            )
    return found


def _names(assignment: ast.Assign) -> set[str]:
    return {
        name
        for target in assignment.targets
        for name in ast.unparse(target).strip("()").split(", ")
    }


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.name)
def test_a_symbol_is_defined_on_lines_that_carry_its_equations(row: Row) -> None:
    text = (ROOT / row.file).read_text(encoding="utf-8")
    lines, tagged = text.splitlines(), set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Assign) and row.name in _names(node):
            for line in lines[node.lineno - 1 : node.end_lineno]:
                if tag := TAG.search(line):
                    tagged |= {
                        int(number) for number in re.findall(r"\d+", tag.group(1))
                    }
    assert row.numbers <= tagged, f"{row.name} is defined by Eqs. {sorted(tagged)}"


@pytest.mark.parametrize("name", ["five_bar", "three_rrr"])
def test_a_symbol_has_the_shape_that_is_told(name: str) -> None:
    e = equations_of(mechanism_named(name))
    sizes = {"n": mechanism_named(name).n, "k": 1, "1": 1}
    for row in rows():
        if hasattr(e, row.name):
            assert getattr(e, row.name).shape == tuple(
                sizes[side] for side in SHAPES[row.shape]
            ), row.name


def test_no_symbol_and_no_equation_of_the_paper_is_left_out() -> None:
    assert {
        field.name for field in dataclasses.fields(Equations)
    } - NOT_OF_THE_PAPER <= {row.name for row in rows()}
    assert set.union(*(row.numbers for row in rows())) == set(range(1, 15))
