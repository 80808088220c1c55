"""A node's start with parameters under the names of the release before."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.node_parameters import RECORDER
from dextar_control.nodekit.node import DextarNode


class _Plain(DextarNode):
    NAME, PARAMETERS, ROBOT = "recorder", RECORDER, False


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("notes:=by hand", ""),
        ("run.tags:=b", "parameter 'tags' is now called 'run.tags', and both names"),
        ("run.noets:=b", "unknown parameter 'run.noets' for node recorder; did you"),
    ],
)
def test_a_start_takes_former_names_from_file_and_command_line_and_tells_them_once(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], more: str, said: str
) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("/**/recorder: {ros__parameters: {sync_period: 0.5, tags: a}}\n")
    rclpy.init(
        args=["--ros-args", "--params-file", str(file), "-p", more],
        signal_handler_options=SignalHandlerOptions.NO,
    )
    try:
        with pytest.raises(ParameterError) if said else contextlib.nullcontext() as got:
            node = _Plain()
            assert node.values["bag.sync_period"] == 0.5
            assert node.values["run.tags"] == "a"
            assert node.get_parameter("run.notes").value == "by hand"
            assert not node.has_parameter("notes")
            node.destroy_node()
    finally:
        rclpy.shutdown()
    told = capfd.readouterr().err
    if said:
        assert got is not None and str(got.value).startswith(said)
    else:
        assert told.count("have been renamed: ") == 1
        assert "sync_period is now bag.sync_period" in told
        assert "notes is now run.notes" in told
