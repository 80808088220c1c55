"""Text files that users give are read here, and YAML as ROS 2 reads it.

A parameter file is read by the nodes with rcl's own parser, whose rules are not those
of YAML 1.1 (nor of PyYAML): ``1e-1`` is a number, ``1:30`` and ``1_000`` are words,
``010`` is 8, ``null`` is a word, aliases do not exist, and a later section overrides an
earlier one. The package reads such files by the same rules, so that no value means one
thing to a command and another to a node; only what stands twice in one place is
refused. Campaign and fault files have the same scalars, beside null; there ``nan``
without its dot is a word, a list holds anything, and no key stands twice.
"""

from __future__ import annotations

import errno
import math
import os
import re
import select
import stat
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from sys import float_info
from typing import cast

import yaml

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.plain_data import ParameterValue, Plain

MOST_BYTES = 4_000_000
WRITER_PATIENCE = 5.0  # s until a pipe has a writer
BYTE_ORDER_MARK = "\ufeff"
STRING_TAG = "tag:yaml.org,2002:str"
PLAIN_TAG = "plain"
MERGE = "<<"
QUOTED = ("'", '"')
PARAMETERS = "ros__parameters"
MISSPELT = PARAMETERS.replace("_", "")
Sections = dict[str, dict[str, ParameterValue]]
"""Parameters by the pattern of the nodes' names, in the order in which they are
applied.
"""

_TRUE = {"Y", "y", "yes", "Yes", "YES", "on", "On", "ON", "true", "True", "TRUE"}
_FALSE = {"N", "n", "no", "No", "NO", "off", "Off", "OFF", "false", "False", "FALSE"}
_NULL = {"", "~", "null", "Null", "NULL"}
_DOTTED = re.compile(r"(\.nan|\.NaN|\.NAN)|([+-]?)(\.inf|\.Inf|\.INF)")
_INTEGER = re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_HEXADECIMAL = re.compile(
    r"[+-]?0[xX]([0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)([pP][+-]?[0-9]+)?"
)
_INFINITE = re.compile(r"([+-]?)inf(inity)?", re.IGNORECASE)
_NAN = re.compile(r"[+-]?nan(\([0-9A-Za-z_]*\))?", re.IGNORECASE)


def read_text(path: str | Path, what: str) -> str:
    """Return the text of a file in UTF-8, with or without a byte order mark.

    Args:
        path: of the file.
        what: names the kind of file in messages.

    Raises:
        ParameterError: it cannot be read, is no text in UTF-8, or is far too large.
    """
    try:
        if stat.S_ISDIR(_mode(os.fspath(path))):
            raise IsADirectoryError(errno.EISDIR, "it is a folder, not a file")
        with open(_descriptor(path), "rb") as stream:
            content = stream.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # a path with a NUL byte is a ValueError
        raise ParameterError(
            f"{what} {path}: {getattr(error, 'strerror', None) or error}"
        ) from error
    if len(content) > MOST_BYTES:
        raise ParameterError(
            f"{what} {path}: it is larger than {MOST_BYTES // 1_000_000} MB, which no"
            " such file is"
        )
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ParameterError(
            f"{what} {path}: it is UTF-16, not UTF-8; convert it: iconv -f UTF-16 -t"
            " UTF-8 OLD > NEW"
        )
    if (place := content.find(b"\0")) >= 0:
        raise ParameterError(
            f"{what} {path}: line {_line(content, place)} holds a NUL byte; it is no"
            " text file in UTF-8"
        )
    try:
        return content.decode().removeprefix(BYTE_ORDER_MARK)
    except UnicodeDecodeError as error:
        raise ParameterError(
            f"{what} {path}: line {_line(content, error.start)} is not UTF-8 (byte"
            f" 0x{content[error.start]:02x}); if it is Latin-1, convert it: iconv -f"
            " ISO-8859-1 -t UTF-8 OLD > NEW"
        ) from error


def _descriptor(path: str | Path) -> int:
    """Open a file to be read, a pipe only where somebody writes into it; return its
    descriptor.

    Raises:
        OSError: it cannot be opened, or is a pipe into which nobody writes.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    if stat.S_ISFIFO(os.fstat(descriptor).st_mode) and not poll.poll(
        1e3 * WRITER_PATIENCE
    ):
        try:
            # Nothing comes: a writer that only has not written yet makes this fail.
            os.read(descriptor, 1)
        except BlockingIOError:
            pass
        else:
            os.close(descriptor)
            raise OSError(
                errno.ENXIO,
                f"it is a pipe, and nobody wrote into it within {WRITER_PATIENCE:g} s",
            )
    os.set_blocking(descriptor, True)
    return descriptor


def _line(content: bytes, place: int) -> int:
    return content.count(b"\n", 0, place) + 1


def load_document(path: str | Path, what: str) -> Plain:
    """Return what a YAML file holds, as plain data.

    Args:
        path: of the file.
        what: names the kind of file in messages.

    Raises:
        ParameterError: it cannot be read, is no YAML, holds more than one document or a
            key twice.
    """
    source = f"{what} {path}"
    nodes = _nodes(read_text(path, what), source, _Loader)
    if len(nodes) > 1:
        raise ParameterError(
            f"{source}: it holds {len(nodes)} YAML documents; it must hold one"
        )
    try:
        return _plain(nodes[0], source, {}) if nodes else None
    except RecursionError as error:
        raise ParameterError(
            f"{source}: an alias stands within what it names"
        ) from error


def load_parameters(*paths: str | Path, what: str = "parameter file") -> Sections:
    """Return the content of ROS 2 parameter files, merged as a node merges those that
    it is given.

    Args:
        paths: of the files, later ones over earlier ones.
        what: names the kind of file in messages.

    Returns:
        Dotted parameters by pattern, e.g. ``/**``, ``/controller``, ``/left/*``.

    Raises:
        ParameterError: a file cannot be read, or ROS 2 would not take it.
    """
    sections: Sections = {}
    for path in paths:
        source = f"{what} {path}"
        for node in _nodes(read_text(path, what), source, _ParameterLoader):
            if isinstance(node, yaml.MappingNode):
                _add_sections(sections, node, "", source)
            elif not _empty(node):
                raise ParameterError(
                    f"{_at(source, node)}: {_kind(node)} stands where a node's name is"
                    " wanted, such as /**:"
                )
    return sections


def check_parameter_files(arguments: Sequence[str]) -> list[str]:
    """Refuse a file after ``--params-file`` as a command would: rcl's own words name
    neither line nor remedy.

    Returns:
        The arguments without pipes, which give their content once, to the node.

    Raises:
        ParameterError: a file cannot be read, or ROS 2 would not take it.
    """
    left: list[str] = []
    for word in arguments:
        if not left or left[-1] != "--params-file":
            left.append(word)
        elif stat.S_ISFIFO(_mode(word)):
            left.pop()
        else:
            load_parameters(word)
            left.append(word)
    return left


def _mode(path: str) -> int:
    try:
        return os.stat(path).st_mode
    except (OSError, ValueError):
        return 0


def parameters_of(
    node: str, sections: Mapping[str, Mapping[str, ParameterValue]]
) -> dict[str, ParameterValue]:
    """Return the parameters of the node with this full name (``/controller``,
    ``/left/plant``), as rcl matches and overrides them.
    """
    values: dict[str, ParameterValue] = {}
    for pattern, section in sections.items():
        if _matches(pattern.strip("/").split("/"), node.strip("/").split("/")):
            values.update(section)
    return values


def parse_value(text: str, source: str) -> ParameterValue:
    """Return the value in ``NAME:=VALUE`` as rcl reads it; ``source`` names it in
    messages.

    Raises:
        ParameterError: it is no value of a parameter.
    """
    nodes = _nodes(text, source, _ParameterLoader)
    if len(nodes) != 1 or _empty(nodes[0]):
        raise ParameterError(f"{source}: the value is empty; an empty string is ''")
    return _value(nodes[0], source)


def assignment(name: str, value: object) -> str:
    """Return ``NAME:=VALUE`` for ``ros2 run ... --ros-args -p``, quoted so that the
    node gets this very value.

    Args:
        name: of the parameter, with its node's name and a colon where it has one.
        value: a bool, number, string or path, or a list of them.

    Raises:
        ParameterError: a text, or a path, is not UTF-8.
    """
    return f"{name}:={as_yaml(value)}"


def as_yaml(value: object) -> str:
    """Return a parameter's value in one line of YAML, whichever characters a text
    holds.

    Raises:
        ParameterError: a text, or a path, is not UTF-8.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)  # also inf and nan, which rcl's strtod reads
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(as_yaml, value))}]"
    try:
        text = str(value)
        text.encode()
    except UnicodeEncodeError as error:
        raise ParameterError(
            f"{str(value)!a}: it is not UTF-8, and a ROS 2 parameter must be"
        ) from error
    return yaml.safe_dump(
        text, default_style='"', width=math.inf, allow_unicode=True
    ).rstrip("\n")


def dump_document(document: object) -> str:
    """Return plain data as YAML; texts that another reader might take for numbers are
    quoted, so that rcl and PyYAML read the same.
    """
    return yaml.dump(
        document,
        Dumper=_Dumper,
        sort_keys=False,
        default_flow_style=None,
        allow_unicode=True,
    )


class _Dumper(yaml.SafeDumper):
    """Quotes each text that another reader might take for a number."""


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    return dumper.represent_scalar(
        STRING_TAG, text, style=None if isinstance(scalar(text), str) else '"'
    )


_Dumper.add_representer(str, _represent_text)


class _Loader(yaml.SafeLoader):
    """Leaves open what a scalar is; only an explicit tag is kept."""

    def resolve(
        self, kind: type[yaml.Node], value: str | None, implicit: tuple[bool, bool]
    ) -> str:
        if kind is yaml.ScalarNode:
            return PLAIN_TAG
        resolved: str = yaml.SafeLoader.resolve(self, kind, value, implicit)
        return resolved


class _ParameterLoader(_Loader):
    """Refuses aliases, as rcl does."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            raise yaml.MarkedYAMLError(
                problem=f"ROS 2 knows no aliases (*{event.anchor})",
                problem_mark=event.start_mark,
            )
        return super().compose_node(parent, index)


def _nodes(text: str, source: str, loader: type[_Loader]) -> list[yaml.Node]:
    try:
        return [
            node for node in yaml.compose_all(text, Loader=loader) if node is not None
        ]
    except yaml.MarkedYAMLError as error:
        where = (
            f"{source}, line {error.problem_mark.line + 1}"
            if error.problem_mark
            else source
        )
        said = " ".join(part for part in (error.context, error.problem) if part)
        raise ParameterError(f"{where}: {' '.join(said.split())}") from error
    except yaml.YAMLError as error:
        raise ParameterError(f"{source}: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise ParameterError(f"{source}: it is nested too deeply") from error


def scalar(text: str) -> bool | int | float | str:
    """Return a scalar without quotes as rcl_yaml_param_parser takes it: strtol's whole
    numbers, strtod's others, else a text.
    """
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if _INTEGER.fullmatch(text):
        digits = text.lstrip("+-")
        base = 16 if digits[:2] in ("0x", "0X") else 8 if digits[0] == "0" else 10
        if len(digits) <= 32 and -(2**63) <= (number := int(text, base)) < 2**63:
            return number
    if dotted := _DOTTED.fullmatch(text):
        return math.nan if dotted[1] else -math.inf if dotted[2] == "-" else math.inf
    if _NAN.fullmatch(text):
        return math.nan
    if infinite := _INFINITE.fullmatch(text):
        return -math.inf if infinite[1] == "-" else math.inf
    return _floating(text)


def _floating(text: str) -> float | str:
    """Return a number, or the text where there is none or where strtod says that a
    double cannot hold it.
    """
    if _HEXADECIMAL.fullmatch(text):
        try:
            return float.fromhex(text)
        except OverflowError:
            return text
    if not _DECIMAL.fullmatch(text):
        return text
    value = float(text)
    if math.isinf(value) or (
        abs(value) < float_info.min and Decimal(text) != Decimal(value)
    ):
        return text
    return value


def _value_of(node: yaml.ScalarNode) -> bool | int | float | str:
    return (
        node.value
        if node.style in QUOTED or node.tag == STRING_TAG
        else scalar(node.value)
    )


def _empty(node: yaml.Node) -> bool:
    return (
        isinstance(node, yaml.ScalarNode)
        and node.style not in QUOTED
        and not node.value
    )


def _plain(node: yaml.Node, source: str, seen: dict[int, Plain]) -> Plain:
    """Return a node as plain data; a key that stands there twice is a mistake. ``seen``
    holds what an alias may name again.
    """
    if id(node) in seen:
        return seen[id(node)]
    value: Plain
    if isinstance(node, yaml.ScalarNode):
        null = node.style is None and node.value in _NULL and node.tag != STRING_TAG
        value = _value_of(node)
        # nan and inf without a point are words, as in YAML.
        not_finite = isinstance(value, float) and not math.isfinite(value)
        word = not_finite and "." not in node.value
        return None if null else node.value if word else value
    if isinstance(node, yaml.SequenceNode):
        value = [_plain(item, source, seen) for item in node.value]
    else:
        value = _mapping(node, source, seen)
    return seen.setdefault(id(node), value)


def _mapping(node: yaml.Node, source: str, seen: dict[int, Plain]) -> dict[str, Plain]:
    found: dict[str, Plain] = {}
    merged: dict[str, Plain] = {}  # by YAML's <<, under the mapping's own keys
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise ParameterError(f"{_at(source, key)}: {_kind(key)} cannot be a key")
        if key.value in found:
            raise ParameterError(
                f"{_at(source, key)}: the key '{key.value}' stands there twice"
            )
        if key.value == MERGE and isinstance(value, yaml.MappingNode):
            merged |= cast(dict[str, Plain], _plain(value, source, seen))
        else:
            found[key.value] = _plain(value, source, seen)
    return merged | found


def _add_sections(
    sections: Sections, node: yaml.MappingNode, prefix: str, source: str
) -> None:
    for key, value in node.value:
        name = _key(key, source)
        if name == PARAMETERS and not prefix:
            raise ParameterError(
                f"{_at(source, key)}: '{PARAMETERS}' stands under no node's name; /**"
                " is any node's"
            )
        if name.replace("_", "") == MISSPELT and name != PARAMETERS:
            raise ParameterError(
                f"{_at(source, key)}: '{name}' stands where '{PARAMETERS}', with two"
                " underscores, is wanted"
            )
        if not isinstance(value, yaml.MappingNode):
            wanted = (
                "a mapping of parameters ({} where there are none) under"
                f" '{PARAMETERS}'"
                if name == PARAMETERS
                else f"'{PARAMETERS}:' under '{name}'"
            )
            raise ParameterError(
                f"{_at(source, key)}: {_kind(value)} stands where {wanted} is wanted"
            )
        if name == PARAMETERS:
            _flatten(sections.setdefault(prefix, {}), value, "", source)
        else:
            _add_sections(sections, value, f"{prefix}/{name.strip('/')}", source)


def _flatten(
    flat: dict[str, ParameterValue], node: yaml.MappingNode, prefix: str, source: str
) -> None:
    names = [_key(key, source) for key, _ in node.value]
    for row, (key, value) in enumerate(node.value):
        if names[row] in names[:row]:  # rcl would take the last of them
            raise ParameterError(
                f"{_at(source, key)}: the key '{names[row]}' stands there twice"
            )
        name = f"{prefix}{names[row]}"
        if isinstance(value, yaml.MappingNode):
            _flatten(flat, value, f"{name}.", source)
        elif _empty(value):
            raise ParameterError(f"{_at(source, key)}: '{name}' has no value")
        else:
            flat[name] = _value(value, source)


def _value(node: yaml.Node, source: str) -> ParameterValue:
    """Return a scalar or a list of scalars of one type; an empty list, whose type
    nobody knows, reaches a node as None.
    """
    if isinstance(node, yaml.ScalarNode):
        return _value_of(node)
    if not isinstance(node, yaml.SequenceNode) or not all(
        isinstance(item, yaml.ScalarNode) for item in node.value
    ):
        raise ParameterError(
            f"{_at(source, node)}: {_kind(node)} of lists or mappings is no value of a"
            " parameter"
        )
    values = [_value_of(item) for item in node.value]
    if len({type(value) for value in values}) > 1:
        names = " and ".join(dict.fromkeys(_TYPES[type(value)] for value in values))
        raise ParameterError(
            f"{_at(source, node)}: a list holds {names}; ROS 2 wants all of one type"
            " (0.0, not 0, beside 0.5)"
        )
    return values


_TYPES = {
    bool: "true or false",
    int: "whole numbers",
    float: "numbers with a point",
    str: "words",
}


def _key(node: yaml.Node, source: str) -> str:
    if not isinstance(node, yaml.ScalarNode) or not node.value:
        raise ParameterError(f"{_at(source, node)}: {_kind(node)} cannot be a name")
    return str(node.value)


def _kind(node: yaml.Node) -> str:
    if isinstance(node, yaml.SequenceNode):
        return "a list"
    if isinstance(node, yaml.MappingNode):
        return "a mapping"
    text = node.value if len(node.value) <= 40 else f"{node.value[:37]}..."
    return "nothing" if _empty(node) else f"'{text}'"


def _at(source: str, node: yaml.Node) -> str:
    return f"{source}, line {node.start_mark.line + 1}"


def _matches(pattern: Sequence[str], name: Sequence[str]) -> bool:
    """Return whether the parts of a node's name fit a pattern: ``*`` is one part,
    ``**`` any number of them.
    """
    if not pattern or not name:
        return all(part == "**" for part in pattern) and not name
    if pattern[0] == "**":
        return _matches(pattern[1:], name) or _matches(pattern, name[1:])
    return pattern[0] in ("*", name[0]) and _matches(pattern[1:], name[1:])
