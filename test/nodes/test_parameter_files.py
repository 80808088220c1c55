"""A parameter file gives our reader what it gives a node."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rclpy.context import Context
from rclpy.node import Node

from dextar_control.contract.resources import node_defaults
from dextar_control.contract.yaml_text import (
    as_yaml,
    assignment,
    load_parameters,
    parameters_of,
    parse_value,
)

SCALARS = (
    "1e-1",
    "1.5",
    "1.",
    ".5",
    "+.5e3",
    "1e5",
    "1E+5",
    "1e",
    "1d",
    ".e3",
    "-0",
    "-0.0",
    "0e400",
    "1e400",
    "1e-320",
    "4.9e-324",
    "2.2250738585072011e-308",
    "2.2250738585072014e-308",
    "0",
    "+1",
    "-7",
    "010",
    "08",
    "0o7",
    "0b11",
    "0x10",
    "-0x10",
    "0x",
    "0x1p3",
    "0x1.8",
    "0x.8",
    "9223372036854775807",
    "9223372036854775808",
    "-9223372036854775808",
    "-9223372036854775809",
    "99999999999999999999",
    "1_000",
    "1:30",
    "1,5",
    "2024-01-01",
    ".inf",
    "-.inf",
    "+.INF",
    ".NaN",
    "-.nan",
    "nan",
    "NAN",
    "nan(1)",
    "inf",
    "-infinity",
    "Inf",
    "yes",
    "Yes",
    "y",
    "N",
    "on",
    "OFF",
    "true",
    "TRUE",
    "tRUE",
    "False",
    "null",
    "~",
    "=",
    "<<",
    "word",
    "two words",
    "'1'",
    '"1"',
    "'yes'",
    '""',
    "!!str 1",
    "!!int '1'",
    "!other 1",
    "|\n      1",
    ">-\n      1",
    "[1, 2]",
    "[1.0, 2e0]",
    "[a, '1']",
    "[yes, no]",
    "&anchor 1",
    "größer",
)


TEXTS = (
    "a #b",
    "a: b",
    "a:b",
    "it's",
    '"',
    "\\",
    "\\n",
    "*a",
    "&a",
    "!a",
    "[a",
    "{a",
    "]",
    "true",
    "yes",
    "1e3",
    "0x1",
    "null",
    "~",
    "",
    "  ",
    " lead",
    "trail ",
    "größe 😀",
    "two\nlines",
    "a\ttab",
    "\x1b[31m",
    "\x7f",
    "\x85",
    "\u2028",
    "-",
    "- a",
    "%a",
    "@a",
    "`a`",
    "? a",
    "|",
    ">",
    "a, b",
    "#",
    ":",
    ":=",
    "$HOME",
    "runs/x #1/run.mcap",
    "x" * 400,
)


PATTERNS = (
    "/**",
    "/*",
    "/**/taker",
    "/taker",
    "taker",
    "/*/taker",
    "/**/*",
    "/left/*",
    "/left/**",
    "left/taker",
)


def same(ours: dict[str, Any], theirs: dict[str, Any]) -> bool:
    """Equal in value and type; nan equals nan."""
    return {name: repr(value) for name, value in ours.items()} == {
        name: repr(value) for name, value in theirs.items()
    }


class Taker:
    """What rcl hands to a node."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "taken.yaml"

    def take(
        self, text: str | bytes, *arguments: str, namespace: str = ""
    ) -> dict[str, Any]:
        """Parameters that a node gets from a file and further ROS arguments."""
        self.file.write_bytes(text if isinstance(text, bytes) else text.encode())
        context = Context()
        context.init(
            ["taker", "--ros-args", "--params-file", str(self.file), *arguments]
        )
        try:
            node = Node(
                "taker",
                namespace=namespace,
                context=context,
                enable_rosout=False,
                start_parameter_services=False,
                allow_undeclared_parameters=True,
            )
            found = {
                name: parameter.value
                for name, parameter in node._parameter_overrides.items()
            }
            node.destroy_node()
        finally:
            context.try_shutdown()
        return {
            name: value.tolist() if hasattr(value, "tolist") else value
            for name, value in found.items()
        }


@pytest.fixture
def taker(tmp_path: Path) -> Iterator[Taker]:
    yield Taker(tmp_path)


def test_each_scalar_is_what_a_node_gets(taker: Taker) -> None:
    text = "/**:\n  ros__parameters:\n" + "".join(
        f"    p{index}: {value}\n" for index, value in enumerate(SCALARS)
    )
    theirs = taker.take(text)
    ours = parameters_of("/taker", load_parameters(taker.file))
    assert len(theirs) == len(SCALARS)
    for index, written in enumerate(SCALARS):
        assert repr(ours[f"p{index}"]) == repr(theirs[f"p{index}"]), written
    assert (
        ours["p0"],
        ours[f"p{SCALARS.index('1:30')}"],
        ours[f"p{SCALARS.index('010')}"],
    ) == (0.1, "1:30", 8)


@pytest.mark.parametrize("namespace", ["", "/left"])
def test_sections_are_matched_and_merged_as_a_node_does(
    taker: Taker, namespace: str
) -> None:
    for first in PATTERNS:
        for second in PATTERNS:
            text = (
                f'"{first}": {{ros__parameters: {{a: 1, b: 1}}}}\n"{second}":'
                " {ros__parameters: {a: 2, c.d: 2}}\n"
            )
            theirs = taker.take(text, namespace=namespace)
            assert (
                parameters_of(f"{namespace}/taker", load_parameters(taker.file))
                == theirs
            ), (first, second)


@pytest.mark.parametrize(
    "text",
    [
        "left:\n  taker:\n    ros__parameters: {a: 1, b.c: 2, b: {d: 3}}\n",
        "/**:\n  taker:\n    ros__parameters: {a: 1}\n",
        "/**: {ros__parameters: {a: 1}}\n---\n/**: {ros__parameters: {b: 1}}\n",
        "/**:\r\n  ros__parameters:\r\n    a: 1e-1\r\n    b: word\r\n",
        "\ufeff/**:\n  ros__parameters:\n    a: 1\n",
        "",
    ],
)
def test_layouts_are_read_as_a_node_reads_them(taker: Taker, text: str) -> None:
    theirs = taker.take(text, namespace="/left")
    assert parameters_of("/left/taker", load_parameters(taker.file)) == theirs


def test_later_files_override_earlier_ones_section_by_section(
    taker: Taker, tmp_path: Path
) -> None:
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    first.write_text(
        "/**: {ros__parameters: {a: 1}}\ntaker: {ros__parameters: {b: 1, c: 1}}\n"
    )
    second.write_text(
        "/taker: {ros__parameters: {c: 2}}\n/**: {ros__parameters: {a: 2, b: 2}}\n"
    )
    theirs = taker.take(first.read_bytes(), "--params-file", str(second))
    assert (
        parameters_of("/taker", load_parameters(first, second))
        == theirs
        == {
            "a": 2,
            "b": 1,
            "c": 2,
        }
    )
    assert node_defaults("taker", first, second) == theirs


def test_a_text_arrives_as_it_was_given(taker: Taker) -> None:
    arguments = [
        part
        for index, text in enumerate(TEXTS)
        for part in ("-p", assignment(f"taker:p{index}", text))
    ]
    found = taker.take("/**: {ros__parameters: {p: 1}}\n", *arguments)
    for index, text in enumerate(TEXTS):
        assert found[f"p{index}"] == text
        assert parse_value(as_yaml(text), "x") == text


@pytest.mark.parametrize(
    "value",
    [
        True,
        False,
        3,
        -3,
        2**62,
        0.1,
        1e-5,
        1e16,
        5.0,
        -0.0,
        math.inf,
        -math.inf,
        math.nan,
        [1.0, 2.5],
        [1, 2],
        ["a #", "1"],
        [True, False],
    ],
)
def test_a_value_arrives_with_its_type(taker: Taker, value: Any) -> None:
    found = taker.take(
        "/**: {ros__parameters: {p: 1}}\n", "-p", assignment("taker:a", value)
    )
    assert same(found, {"p": 1, "a": value})
    assert repr(parse_value(as_yaml(value), "x")) == repr(value)
