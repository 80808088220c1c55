"""Whether a command of the documentation exists as it is written: held to the real
command line, parameters, launch arguments, services and topics, without running it.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import re
import shlex
from collections.abc import Callable
from pathlib import Path

from documents import ROOT

from dextar_control.cli.main import parser
from dextar_control.contract.parameters import Parameter, settled
from dextar_control.contract.resources import (
    NODES_FILE,
    ROBOT_FILE,
    config_file,
    node_defaults,
)
from dextar_control.contract.topics import GO, INTERFACES, SERVICES, TOPICS
from dextar_control.contract.yaml_text import parse_value
from dextar_control.executables import EXECUTABLES
from dextar_control.experiments import launch_arguments
from dextar_control.experiments.start_check import KINDS

MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
SETUP = (ROOT / "setup.py").read_text(encoding="utf-8")
OF_THE_SHELL = {".", "cd", "cp", "colcon", "export", "git", "plotjuggler", "sudo"}
TRANSITIONS = {"configure", "activate", "deactivate", "cleanup", "shutdown"}


class Unknown(AssertionError):
    """There is no such command, option, parameter, file or name."""


def need(condition: object, what: str) -> None:
    if not condition:
        raise Unknown(what)


def check(line: str, *, whole: bool = True) -> None:
    """One line, of one or more commands.

    Args:
        line: as it is typed, a remark behind it or not.
        whole: whether it can be typed as it stands; words of a text may lack arguments.

    Raises:
        Unknown: of a command that does not exist so.
    """
    said = re.sub(r"\$\([^)]*\)", "VALUE", line)
    reader = shlex.shlex(said, posix=True, punctuation_chars=";&|")
    reader.whitespace_split, reader.commenters = True, "#"
    words: list[str] = []
    for word in [*reader, ";"]:
        if word not in (";", "&&", "||", "|", "&"):
            words.append(word)
        elif words:
            command(words, whole)
            words = []


def command(words: list[str], whole: bool) -> None:
    while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
        words = words[1:]
    if not words:
        return
    name, given = words[0].removeprefix(".venv/bin/"), words[1:]
    checks: dict[str, Callable[[list[str], bool], None]] = {
        "make": make, "dextar": dextar, "python": python, "ros2": ros2,
    }  # fmt: skip
    if name in checks:
        checks[name](given, whole)
    else:
        need(name in OF_THE_SHELL, f"no such command: {name}")
    for word in given:
        if re.fullmatch(r"(config|test|examples|docs)/[\w./]+", word):
            need((ROOT / word).exists() or "--output" in given, f"no such file: {word}")


def make(given: list[str], whole: bool) -> None:
    variables = dict(word.split("=", 1) for word in given if "=" in word)
    targets = [word for word in given if "=" not in word]
    for name in variables:
        need(re.search(rf"^# {name}=", MAKEFILE, re.M), f"make has no {name}")
    for target in targets:
        need(re.search(rf"^{target}:.*##", MAKEFILE, re.M), f"make has no {target}")
    arguments = shlex.split(variables.get("ARGS", ""))
    for extra in variables.get("EXTRAS", "").split():
        need(re.search(rf'^        "{extra}": ', SETUP, re.M), f"no extra {extra}")
    if "demo" in targets:
        law, duration = variables.get("LAW"), variables.get("DURATION")
        options = ["--law", law] if law else []
        options += ["--duration", duration] if duration else []
        dextar(["demo", *options, *arguments], whole)


def dextar(given: list[str], whole: bool) -> None:
    if given and given[0] in EXECUTABLES:
        node(given[0], given[1:])
        return
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            arguments = parser().parse_args(given)
    except SystemExit as end:
        lacks = "arguments are required" in said.getvalue()
        need(not end.code or (lacks and not whole), said.getvalue())
        return
    for override in getattr(arguments, "overrides", ()):
        name, _, rest = override.partition(".")
        assigned(name, rest)


def assigned(name: str, text: str) -> None:
    """NAME:=VALUE of a node's parameter, or of a robot's."""
    key, _, value = text.partition(":=")
    kind = KINDS.get(name)
    names = node_defaults(name)
    specs = kind.PARAMETERS if kind else tuple(Parameter(one, "") for one in names)
    robot = kind is None or kind.ROBOT
    settled(name, specs, names | {key: parse_value(value, text)}, robot=robot)


def node(name: str, given: list[str]) -> None:
    """The arguments of a node."""
    words = iter(given)
    for word in words:
        if word in ("--host", "--port"):
            need(name == "panel", f"{name} has no {word}")
            next(words)
        elif word == "-p":
            text = next(words)
            before, _, rest = text.partition(":=")
            whose, _, key = before.rpartition(":")
            need(whose in ("", name), f"{text} is not for {name}")
            assigned(name, f"{key}:={rest}")
        elif word == "--params-file":
            file = next(words)
            need((ROOT / file).exists() or file == "my_robot.yaml", f"no file {file}")
        elif word in ("-r", "--enclave"):
            next(words)
        else:
            need(word in ("--ros-args", "--help", "..."), f"{name} has no {word}")


def python(given: list[str], whole: bool) -> None:
    if given[0] == "-m":
        need(importlib.util.find_spec(given[1]), f"no module {given[1]}")
    else:
        need((ROOT / given[0]).exists(), f"no file {given[0]}")


def ros2(given: list[str], whole: bool) -> None:
    what, *words = given
    if len(words) < 2 and not whole:
        return
    if what == "run":
        need(words[0] == "dextar" and words[1] in EXECUTABLES, f"no node: {words}")
        node(words[1], words[2:])
    elif what == "launch":
        need((ROOT / "launch" / words[1]).exists(), f"no launch file {words[1]}")
        usual = {key: one.default for key, one in launch_arguments.ARGUMENTS.items()}
        asked = dict(word.split(":=") for word in words[2:] if word != "--show-args")
        need(set(asked) <= set(usual), f"unknown launch arguments in {words}")
        files = {"robot_file": ROBOT_FILE, "params_file": NODES_FILE}
        shipped = {key: str(config_file(file)) for key, file in files.items()}
        launch_arguments.read({**usual, **asked, **shipped})
    elif what == "param" and whole:
        kind = KINDS[words[1].removeprefix("/")]
        found = [spec for spec in kind.PARAMETERS if spec.name == words[2]]
        need(found, f"{words[1]} has no parameter {words[2]}")
        if words[0] == "set":
            settable = found[0].live or words[2] == "assembly_mode"
            need(settable, f"{words[2]} is not live")
            assigned(kind.NAME, f"{words[2]}:={words[3]}")
    elif what == "service" and whole:
        types = {f"/{service.name}": service.type for service in SERVICES}
        need(types.get(words[1]) == words[2], f"no service {words[1:3]}")
    elif what == "topic" and whole:
        names = {topic.name.removeprefix("/") for topic in TOPICS}
        need(words[1].removeprefix("/") in names, f"no topic {words[1]}")
    elif what == "lifecycle" and whole:
        need(words[1] == "/controller" and words[2] in TRANSITIONS, f"not {words}")
    elif what == "action":
        kind = [word for word in words if word.startswith(INTERFACES)]
        need(f"/{GO}" in words and kind == [f"{INTERFACES}/action/Go"], f"not {words}")
    elif what == "interface":
        need(interface(words[1]).exists(), f"no interface {words[1]}")
    else:
        known = {
            "param",
            "service",
            "topic",
            "lifecycle",
            "security",
            "pkg",
            "bag",
            "...",
        }
        need(what in known, f"ros2 {what}")


def interface(name: str) -> Path:
    _, kind, message = name.split("/")
    return ROOT / "interfaces" / kind / f"{message}.{kind}"
