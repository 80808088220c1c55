"""The cases of ``config/faults.yaml``: which fault is done, where, how often, what may
come of it and who must report it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from dextar_control.contract.errors import DextarError
from dextar_control.contract.validation import Section, load_yaml, problem, unknown
from dextar_control.experiments.faults.frames import LinkQuality
from dextar_control.experiments.faults.judgement import Outcome
from dextar_control.experiments.faults.link import MessageShape, Transport

Number = Annotated[float, Field(allow_inf_nan=False)]
Node = Literal["plant", "controller", "trajectory_server", "recorder"]
Way = Literal["states", "commands"]
KINDS = (
    "transport",
    "window",
    "kill",
    "commander",
    "flood",
    "parameters",
    "disk",
    "network",
)


class KillSettings(Section):
    """Names a signal to one node."""

    node: Node
    signal: Literal["SIGKILL", "SIGTERM"]


class WindowSettings(Section):
    """Describes a span of time in which each message has one shape."""

    shape: str
    lasting: Number = Field(gt=0.0, le=1.0)

    @field_validator("shape")
    @classmethod
    def _known_shape(cls, shape: str) -> str:
        known = [item.value for item in MessageShape]
        if shape not in known:
            raise problem(unknown(shape, known, "shape"))
        return shape


class FaultCase(Section):
    """Describes one fault: exactly one of the ``KINDS``.

    ``crossings`` faulted ones are tried in a full run, ``quick`` in a quick one (0
    leaves the case out); ``trips`` return trips make one trajectory. An outcome that is
    not among ``expect`` fails the run. Of ``reported`` at least one must be seen for
    each fault that took effect: ``node.key`` (a counter in the diagnostics that rose),
    ``node.key~words`` (a text that held the words), ``exit.node`` (an exit code that is
    not 0), ``silent.node`` (its diagnostics stopped), ``log.node~words``,
    ``answer~words`` (of a service); an empty list is a fault that nobody needs to
    notice.
    """

    title: str
    clock: Literal["lockstep", "realtime"] = "lockstep"
    ways: Annotated[list[Way], Field(min_length=1)] = ["states"]
    transport: dict[str, Number] | None = None
    window: WindowSettings | None = None
    kill: KillSettings | None = None
    commander: bool = False
    flood: Number = Field(default=0.0, ge=0.0, le=10_000.0)
    parameters: bool = False
    disk: Number = Field(default=0.0, ge=0.0, le=1000.0)
    network: dict[str, Number] | None = None
    crossings: int = Field(ge=1, le=100_000)
    quick: int = Field(default=0, ge=0, le=1000)
    trips: int = Field(default=1, ge=1, le=100)
    expect: list[str] = Field(min_length=1)
    reported: list[str] = []

    @property
    def kind(self) -> str:
        """The kind of fault that it is."""
        return next(kind for kind in KINDS if getattr(self, kind))

    @field_validator("expect")
    @classmethod
    def _known_outcomes(cls, expect: list[str]) -> list[str]:
        for outcome in expect:
            if outcome not in list(Outcome):
                raise problem(
                    f"unknown outcome '{outcome}'; known are: {', '.join(Outcome)}"
                )
        return expect

    @model_validator(mode="after")
    def _one_fault(self) -> FaultCase:
        kinds = [kind for kind in KINDS if getattr(self, kind)]
        if len(kinds) != 1:
            raise problem(
                f"it has {' and '.join(kinds) or 'no fault'}; it must have exactly one"
                f" of: {', '.join(KINDS)}"
            )
        if (
            self.kind not in ("transport", "window")
            and self.clock == "lockstep"
            and self.kind != "parameters"
        ):
            raise problem(f"{self.kind} needs the clock realtime")
        try:
            Transport(**(self.transport or {}))
            LinkQuality(**(self.network or {}))
        except (DextarError, TypeError) as error:
            raise problem(str(error)) from error
        return self


class TripSettings(Section):
    """Describes the return trip that is made again and again: seconds one way, and at
    rest.
    """

    duration: Number = Field(gt=0.02, le=60.0)
    dwell: Number = Field(ge=0.01, le=60.0)


class FaultConfig(Section):
    """Holds everything that a run of faults is made of."""

    seed: int = Field(default=0, ge=0, lt=2**32)
    trip: TripSettings
    cases: dict[str, FaultCase] = Field(min_length=1)


def load_cases(path: str | Path) -> FaultConfig:
    """Load the cases of a YAML file.

    Raises:
        ParameterError: the file cannot be read, or something in it is unknown, missing
            or out of its range.
    """
    return load_yaml(FaultConfig, path, "fault file")
