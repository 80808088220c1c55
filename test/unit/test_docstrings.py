"""A public function that takes or gives arrays tells their shapes and units. That each
has a docstring at all the linter sees to.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ALIAS = re.compile(r"^(\w+)(?:: TypeAlias)? = NDArray\[", re.MULTILINE)
# (n,), (2, n), (..., 3), (k, 2n)
SHAPE = re.compile(r"\((?:[\w.+*]{1,7},)(?: [\w.+*]{1,7},?)*\)")
UNIT = re.compile(
    r"(?<![\w.|])(?:rad|m|mm|s|ms|ns|kg|N|J|W|Hz|px|points|counts?|units?)(?![\w(])|, 1\b"
)
WITHOUT_UNIT = re.compile(r"NDArray\[np\.(?:bool_|intp)\]")
SOURCES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for package in ("dextar_control", "dextar_sim")
    for path in sorted((ROOT / package).rglob("*.py"))
}
ARRAYS = {"NDArray", "ndarray", "ArrayLike"}.union(
    *(ALIAS.findall(text) for text in SOURCES.values())
)


def _public(
    body: list[ast.stmt], place: str = ""
) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Each public function and method, by its dotted name."""
    for node in body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield f"{place}{node.name}", node
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from _public(node.body, f"{place}{node.name}.")


def _arrays(function: ast.FunctionDef) -> list[str]:
    """The annotations of arguments and of the result that name an array."""
    arguments = function.args
    given = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    annotations = [argument.annotation for argument in given] + [function.returns]
    texts = [ast.unparse(annotation) for annotation in annotations if annotation]
    return [text for text in texts if ARRAYS & set(re.findall(r"\w+", text))]


def untold(text: str) -> list[str]:
    """What each function with arrays in a module does not tell, one line each."""
    found = []
    for name, function in _public(ast.parse(text).body):
        arrays = _arrays(function)
        said = ast.get_docstring(function) or ""
        if arrays and not SHAPE.search(said):
            found.append(f"{name} tells no shape, as in (n,)")
        if not all(map(WITHOUT_UNIT.search, arrays)) and not UNIT.search(
            SHAPE.sub("", said)
        ):
            found.append(f"{name} tells no unit; one without is written as ', 1'")
    return found


@pytest.mark.parametrize("file", SOURCES)
def test_arrays_have_their_shapes_and_units_told(file: str) -> None:
    missing = untold(SOURCES[file])
    assert not missing, f"{file}:\n" + "\n".join(missing)


def test_this_test_sees_what_is_missing() -> None:
    text = 'def f(q: Array) -> float:\n    """{}"""\n'
    assert len(untold(text.format("Something of q."))) == 2
    assert untold(text.format("Sum of q (n,).")) == [
        "f tells no unit; one without is written as ', 1'"
    ]
    assert not untold(text.format("Sum of q (n,), rad."))
    assert not untold(text.format("Sum of q (n, 2), 1."))
