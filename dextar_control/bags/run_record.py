"""What a bag says of its run: names, parameters and their changes, versions, plan
certificate, losses.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping
from datetime import datetime, timezone
from functools import cache
from importlib import metadata
from pathlib import Path

import yaml

from dextar_control.contract.robot import robot_text

METADATA_NAME = "dextar"
MAX_CHANGES = 1000  # live parameter changes that are listed
_PACKAGES = ("numpy", "scipy", "casadi", "mcap", "rclpy", "pybullet", "pybullet-arm64")
_DESCRIBED = ("name", "notes", "tags")


class RunRecord:
    """Gathers what is known of a recording; ``texts`` is its metadata record.

    Args:
        labels: the run's name, notes and tags.
        middleware: the name of the ROS middleware that the recorder runs on.
    """

    def __init__(self, labels: Mapping[str, str], middleware: str) -> None:
        self.middleware = middleware
        self.started = datetime.now(timezone.utc)
        self.labels = dict(labels)
        self.certificate = ""
        self.changes: list[dict[str, object]] = []
        self.more_changes = 0

    def note_change(self, time: int, node: str, name: str, value: object) -> None:
        """Note a parameter that was changed while the recording ran; time in ns since
        the epoch.
        """
        if len(self.changes) >= MAX_CHANGES:
            self.more_changes += 1
            return
        self.changes.append(
            {"time": time, "node": node, "name": name, "value": plain(value)}
        )

    def note_certificate(self, text: str) -> None:
        """Note a plan's certificate as JSON; one that lists all its crossings is kept
        against a shortened one of the same plan.
        """
        if text == self.certificate:
            return
        try:
            new, old = json.loads(text), json.loads(self.certificate or "{}")
        except ValueError:
            return
        if isinstance(new, dict) and not _shortens(new, old):
            self.certificate = text

    def texts(
        self,
        parameters: Mapping[str, Mapping[str, object]],
        topics: Mapping[str, str],
        counts: Mapping[str, object],
        missing: list[str],
        ended: datetime | None = None,
    ) -> dict[str, str]:
        """Return the metadata record.

        Args:
            parameters: per node, as at the start of the recording.
            topics: contract name to name in this bag.
            counts: per topic {received, lost, dropped}.
            missing: nodes whose parameters are not known.
            ended: when the recording ended.
        """
        return {
            **{key: self.labels.get(key, "") for key in _DESCRIBED},
            "started": self.started.isoformat(),
            "ended": ended.isoformat() if ended else "",
            **_laws(parameters),
            "certificate": self.certificate,
            "robot_description": robot_file(parameters),
            "version": version(),
            "versions": json.dumps({**versions(), "rmw": self.middleware}),
            "contract": json.dumps(dict(topics)),
            "topics": json.dumps(dict(counts)),
            "parameters_missing": json.dumps(missing),
            "parameter_changes": json.dumps(self.changes),
            "parameter_changes_not_listed": str(self.more_changes),
            **{
                f"parameters.{node}": parameter_text(values)
                for node, values in parameters.items()
            },
        }

    def custom_data(
        self, parameters: Mapping[str, Mapping[str, object]]
    ) -> dict[str, str]:
        """Return what ``metadata.yaml`` shows of the run as ``custom_data``; nothing
        empty.
        """
        data = {**self.labels, **_laws(parameters), "dextar": version()}
        return {key: str(value) for key, value in data.items() if value}


def robot_file(parameters: Mapping[str, Mapping[str, object]]) -> str:
    """Return the robot as a ROS 2 parameter file (``--params-file``, ``load_robot``),
    the controller's before another node's; "" if no node has one.
    """
    for node in ("controller", *parameters):
        flat = {
            name.removeprefix("robot."): value
            for name, value in parameters.get(node, {}).items()
            if name.startswith("robot.")
        }
        if flat:
            return robot_text({name: plain(value) for name, value in flat.items()})
    return ""


def parameter_text(values: Mapping[str, object]) -> str:
    """Return dotted parameters as YAML, with arrays as lists."""
    plain_values = {name: plain(value) for name, value in values.items()}
    return str(
        yaml.safe_dump(
            plain_values, sort_keys=True, default_flow_style=None, width=1000
        )
    )


def plain(value: object) -> object:
    """Convert a parameter's value to Python's own types, an array to a list."""
    if isinstance(value, Iterable) and not isinstance(value, str):
        return list(value)
    return value


@cache
def version() -> str:
    """Return the version of this package."""
    try:
        return metadata.version("dextar")
    except metadata.PackageNotFoundError:
        manifest = _source() / "package.xml"
        text = manifest.read_text(encoding="utf-8") if manifest.is_file() else ""
        return text.partition("<version>")[2].partition("</version>")[0] or "unknown"


@cache
def versions() -> dict[str, str]:
    """Return the versions of what a run is made with: this package and its source's
    revision, ROS, Python, libraries, machine.
    """
    found = {
        "dextar": version(),
        "revision": _revision(),
        "ros_distro": os.environ.get("ROS_DISTRO", "jazzy (wheels)"),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.release()} {platform.machine()}",
    }
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return {name: text for name, text in found.items() if text}


def _laws(parameters: Mapping[str, Mapping[str, object]]) -> dict[str, str]:
    controller = parameters.get("controller", {})
    return {key: str(controller.get(key, "")) for key in ("law", "estimator")}


def _shortens(new: Mapping[str, object], old: Mapping[str, object]) -> bool:
    """Tell whether it is the same certificate with fewer crossings listed."""
    listed = [one.get("crossings") for one in (new, old)]
    fewer, more = (len(own) if isinstance(own, list) else 0 for own in listed)
    return fewer < more and all(
        new[key] == old.get(key) for key in new if key != "crossings"
    )


def _source() -> Path:
    return Path(__file__).resolve().parents[2]


def _revision() -> str:
    """Return the revision of the source tree where that is a checkout, else ""."""
    if not (_source() / ".git").exists():
        return ""
    try:
        command = ["git", "-C", str(_source()), "describe", "--always", "--dirty"]
        return subprocess.run(
            command, capture_output=True, text=True, timeout=5.0, check=True
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
