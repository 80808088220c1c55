"""The tests with torque follow one after the other, each only when those before allow
it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

from dextar_control.check_rig.limits import Limits
from dextar_control.check_rig.report import TORQUE_LINES, CheckLine, Result, skipped
from dextar_control.check_rig.response import nan_line, response_line, watchdog_line
from dextar_control.check_rig.samples import JointSample
from dextar_control.check_rig.trial import (
    NO_TORQUE,
    Torque,
    TorqueTrial,
    doublet,
    nan_and_on,
    silence,
)

# A test that failed while the machine disturbed it has so many tries; the last one is
# judged as it is.
TRIES = 5
Judge = Callable[[TorqueTrial, Limits], CheckLine]


class TorqueTests:
    """Sends small torques to each motor, then nothing, then NaN; ends at the first
    limit that the robot leaves.

    A test that fails while states or answers were away for too long is repeated.

    Call ``update`` at each new state, and now and then without one; publish what it
    returns.

    Args:
        limits: of the check.
        has_effort: whether the states carry the effort that was applied.

    Attributes:
        lines: of the tests that are over, all ``TORQUE_LINES`` once ``finished``.
        trials: what was recorded.
        finished: no torque any more; zero should be commanded.
    """

    def __init__(self, limits: Limits, *, has_effort: bool) -> None:
        self._limits = limits
        self._has_effort = has_effort
        self.lines: list[CheckLine] = []
        self.trials: list[TorqueTrial] = []
        self.finished = False
        self._tries = 1
        self._steps = self._sequence()
        self._next()

    @property
    def stage(self) -> str:
        """What is being tested."""
        return "done" if self.finished else TORQUE_LINES[len(self.lines)]

    @property
    def expected_duration(self) -> float:
        """How long all tests take, s."""
        parts = (
            doublet(0, self._limits),
            doublet(1, self._limits),
            silence(0, self._limits),
            nan_and_on(0, self._limits),
        )
        return sum(segment.duration for part in parts for segment in part)

    def update(self, now: int, sample: JointSample | None) -> Torque | None:
        """Return what to command now, N m; None for nothing.

        Args:
            now: of the clock of the samples' arrival, ns.
            sample: a new state, or None.
        """
        if self.finished:
            return NO_TORQUE if sample is not None else None
        trial = self.trials[-1]
        answer = trial.update(now, sample)
        if trial.finished:
            answer = NO_TORQUE
            line = self._judge(trial, self._limits)
            again = line.result is Result.SKIP or (
                trial.disturbed and line.result is Result.FAIL
            )
            if again and not trial.trouble and self._tries < TRIES:
                self._tries += 1
                self.trials[-1] = TorqueTrial(trial.joint, trial.segments, trial.limits)
                return answer
            self.lines.append(
                line
                if self._tries == 1
                else replace(line, measured=f"{line.measured} (try {self._tries})")
            )
            self._tries = 1
            if trial.trouble:
                self.stop(f"the tests ended: {trial.trouble}")
            else:
                self._next()
        return answer

    def stop(self, reason: str) -> None:
        """Send no more torque; what is left is skipped for this reason."""
        if not self.finished:
            self.finished = True
            done = {line.name for line in self.lines}
            self.lines += [
                skipped(name, reason) for name in TORQUE_LINES if name not in done
            ]

    def _next(self) -> None:
        step = next(self._steps, None)
        if step is None:
            self.finished = True
        else:
            trial, self._judge = step
            self.trials.append(trial)

    def _sequence(self) -> Iterator[tuple[TorqueTrial, Judge]]:
        """Give each trial with what judges it."""
        limits = self._limits
        for joint in (0, 1):
            yield TorqueTrial(joint, doublet(joint, limits), limits), response_line
        good = [
            joint for joint, line in enumerate(self.lines) if line.result is Result.PASS
        ]
        joint = good[0] if good else 0
        why = (
            "without effort feedback nobody sees the torque go"
            if good
            else "neither motor responds as commanded"
        )
        if not good or not self._has_effort:
            self.lines.append(skipped("watchdog", why))
        else:
            yield TorqueTrial(joint, silence(joint, limits), limits), watchdog_line
            if self.lines[-1].numbers.get("gone") == 0.0:
                self.stop(
                    "the drive keeps its torque when commands stop: too risky to go on"
                )
                return
        script = nan_and_on(joint, limits) if good else nan_and_on(joint, limits)[:2]
        judge = partial(nan_line, responds=bool(good))
        yield TorqueTrial(joint, script, limits), judge
