"""A node's start with parameters under the names of the release before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from dextar_control.contract.node_parameters import RECORDER
from dextar_control.nodekit.node import EXIT_USAGE, DextarNode, run_node

FILE = "/**/recorder: {ros__parameters: {sync_period: 0.5, tags: a}}\n"


class _Plain(DextarNode):
    NAME, PARAMETERS, ROBOT = "recorder", RECORDER, False


def start(folder: Path, *typed: str) -> tuple[int, dict[str, Any]]:
    """The exit code of a node that ends at once, and its values."""
    file = folder / "params.yaml"
    file.write_text(FILE, encoding="utf-8")
    values: dict[str, Any] = {}
    words = [part for value in typed for part in ("-p", value)]
    code = run_node(
        _Plain,
        ["--ros-args", "--params-file", str(file), *words],
        lambda node, *_: values.update(node.values),
    )
    return code, values


def test_a_start_takes_former_names_and_tells_them_once(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    code, values = start(tmp_path, "notes:=by hand", "recorder:run.tags:=b")
    assert code == 0
    assert (values["bag.sync_period"], values["run.notes"]) == (0.5, "by hand")
    assert values["run.tags"] == "b"  # the command line overrides the file
    assert not {"sync_period", "notes", "tags"} & values.keys()
    told = capfd.readouterr().err
    assert told.count("have been renamed: ") == 1
    for name in ("sync_period is now bag.sync_period", "notes is now run.notes"):
        assert name in told


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        (
            ("tags:=b", "run.tags:=c"),
            "parameter 'tags' is now called 'run.tags', and both names are given; give"
            " 'run.tags' alone",
        ),
        (
            ("run.noets:=b",),
            "unknown parameter 'run.noets' for node recorder; did you mean"
            " 'run.notes'?",
        ),
    ],
)
def test_a_start_is_refused_in_one_sentence_with_both_names_or_a_misspelt_one(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], typed: tuple[str, ...], said: str
) -> None:
    assert start(tmp_path, *typed) == (EXIT_USAGE, {})
    assert capfd.readouterr().err == f"error: {said}\n"
