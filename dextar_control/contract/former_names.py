"""The parameters' names of the release before, which are still taken where a node
starts, and its bags. The next release does without this module, and without
``Parameter.formerly``.
"""

from __future__ import annotations

import stat
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.node_parameters import parameters_of_node
from dextar_control.contract.parameters import Parameter
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.yaml_text import (
    PARAMETERS,
    Sections,
    dump_document,
    load_parameters,
    parameters_of,
)

FILE_FLAG = "--params-file"
VALUE_FLAGS = ("-p", "--param")
Value = TypeVar("Value")


def former_names(specs: Iterable[Parameter]) -> dict[str, str]:
    """Return the present names of the parameters that have been renamed, by their
    former ones.
    """
    return {spec.formerly: spec.name for spec in specs if spec.formerly}


def present_names(
    specs: Iterable[Parameter], given: Mapping[str, Value]
) -> tuple[dict[str, Value], dict[str, str]]:
    """Return parameters under their present names.

    Args:
        specs: of the node's parameters.
        given: values by names, present or former ones, of one source.

    Returns:
        The values by present names, and the former names that were given with the
        present ones.

    Raises:
        ParameterError: a parameter is given under both of its names.
    """
    renamed = {old: new for old, new in former_names(specs).items() if old in given}
    for old, new in renamed.items():
        if new in given:
            raise ParameterError(
                f"parameter '{old}' is now called '{new}', and both names are given;"
                f" give '{new}' alone"
            )
    return {renamed.get(name, name): value for name, value in given.items()}, renamed


def renamed_in_words(renamed: Mapping[str, str]) -> str:
    """Return the warning about former names, each with the present one."""
    names = ", ".join(f"{old} is now {new}" for old, new in renamed.items())
    return (
        f"parameters have been renamed: {names}; the next release takes the present"
        " names only"
    )


def present_sections(node: str, path: Path) -> tuple[Sections, dict[str, str]]:
    """Return what a parameter file holds, in the sections that a node reads under
    present names; and the former names that it uses there.

    Args:
        node: its name, with or without its namespace.
        path: of the file.

    Raises:
        ParameterError: the file cannot be read, ROS 2 would not take it, or it gives a
            parameter under both of its names in one section.
    """
    specs, name = parameters_of_node(node), node.rpartition("/")[2]
    sections: Sections = {}
    renamed: dict[str, str] = {}
    for pattern, section in load_parameters(path).items():
        if not _meant(pattern, name):
            sections[pattern] = section
            continue
        try:
            sections[pattern], found = present_names(specs, section)
        except ParameterError as error:
            raise ParameterError(f"parameter file {path}: {error}") from error
        renamed |= found
    return sections, renamed


def present_parameters(node: str, *paths: Path) -> dict[str, ParameterValue]:
    """Return the parameters of one node in parameter files, as the node itself would
    get them, under present names.

    Args:
        node: its name, with its namespace where it has one.
        paths: of the files, later ones over earlier ones.

    Raises:
        ParameterError: as ``present_sections``.
    """
    merged: Sections = {}
    for path in paths:
        for pattern, section in present_sections(node, path)[0].items():
            merged.setdefault(pattern, {}).update(section)
    return parameters_of(node, merged)


def present_arguments(
    node: str, words: Sequence[str], folder: Callable[[], Path]
) -> tuple[list[str], dict[str, str]]:
    """Return a node's command line with present names, so that what stands later
    overrides what stands earlier under whichever name.

    Args:
        node: its name.
        words: of the command line; files among them that are pipes stay as they are.
        folder: makes one for the copy of a parameter file that uses former names.

    Returns:
        The words, and the former names that were given with the present ones.

    Raises:
        ParameterError: a file, or the command line, gives a parameter under both of its
            names.
    """
    present = list(words)
    renamed: dict[str, str] = {}
    typed: dict[int, str] = {}
    for place, (flag, word) in enumerate(zip(words, words[1:], strict=False), start=1):
        if flag == FILE_FLAG and not stat.S_ISFIFO(Path(word).stat().st_mode):
            sections, found = present_sections(node, Path(word))
            if found:
                copy = folder() / Path(word).name
                document = {
                    pattern: {PARAMETERS: own} for pattern, own in sections.items()
                }
                copy.write_text(dump_document(document), encoding="utf-8")
                present[place] = str(copy)
                renamed |= found
        elif flag in VALUE_FLAGS:
            pattern, _, name = word.partition(":=")[0].rpartition(":")
            if _meant(pattern or "**", node):
                typed[place] = name
    _, found = present_names(parameters_of_node(node), dict.fromkeys(typed.values()))
    for place, name in typed.items():
        if name in found:
            rule, sign, value = words[place].partition(":=")
            present[place] = f"{rule.removesuffix(name)}{found[name]}{sign}{value}"
    return present, renamed | found


def _meant(pattern: str, name: str) -> bool:
    """Return whether a pattern of nodes' names may be of the node with this name."""
    return pattern.rpartition("/")[2] in ("*", "**", name)
