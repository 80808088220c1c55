"""One set of nodes and the cases tried on it, as a process of its own that tells its
results as lines of JSON.

``python -m dextar_control.experiments.faults.session`` reads a ``Request`` as one line
of JSON. Each line that it prints is an event: ``start`` (a case), ``record`` (a faulted
crossing), ``checks`` (what was looked at, and violations), ``note``, ``failed`` (a case
that could not go on), ``network`` (answered on the standard input once the link is so).
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from std_srvs.srv import Trigger

from dextar_control.contract import signals
from dextar_control.contract.errors import DextarError, NodesError
from dextar_control.contract.resources import ROBOT_FILE, config_file, node_defaults
from dextar_control.contract.robot import load_robot
from dextar_control.contract.topics import CRITERION_NAMES
from dextar_control.control.phases import MOVING, Phase
from dextar_control.experiments.faults import bag_check, judgement
from dextar_control.experiments.faults.actions import Action, Trouble, make_action
from dextar_control.experiments.faults.cases import FaultCase
from dextar_control.experiments.faults.events import CrossingRecord, Event
from dextar_control.experiments.faults.judgement import (
    Check,
    Evidence,
    NodeReports,
    Outcome,
    Stamps,
    Tally,
)
from dextar_control.experiments.faults.monitor import KEPT_COMMANDS
from dextar_control.experiments.faults.stack import SessionRequest, Stack
from dextar_control.experiments.processes import MODULES
from dextar_control.nodekit.cdr import NANOSECONDS
from dextar_control.planning.planner import Plan, plan_return_trip
from dextar_control.symbols.types import Array

TRIP_PATIENCE = 60.0  # s beyond twenty times the trip's duration
REPORT_PATIENCE = 4.0  # s: every node speaks at least each second
CATCH_UP = 1.0  # s given to commands under way to the reader that judges them
SERVE_ATTEMPTS = 5
MOST_IDLE = 20  # trips in a row in which a fault met nothing
SILENT = 2.5  # s without its diagnostics after which a node counts as silent
SPREAD = 0.13  # s around a crossing within which its fault begins
# s after the planned crossing, where the reference is clear of the locus
JUDGED_AFTER = 0.12
AT_LOCUS_ABS_S = 0.4  # |s| of the reference below which a fault is at the locus
SETTLE = 0.3  # s of the rig's time that a robot without control is watched
FIRST_FAULT = 0.02  # s after the start before which no window opens
PHASE = CRITERION_NAMES.index("phase")
# of the phases without control, by number and by name
OUTCOMES: dict[int | str, Outcome] = {
    Phase.FAULT: Outcome.FAULT,
    Phase.FAULT.name: Outcome.FAULT,
    Phase.SAFE_STOP: Outcome.SAFE_STOP,
    Phase.SAFE_STOP.name: Outcome.SAFE_STOP,
}


class Fault(NamedTuple):
    """A faulted crossing of a trip."""

    number: int  # among the planned crossings, from 0
    crossing: int  # when it is planned, ns of the rig's clock
    begin: int  # when the fault begins, ns of the rig's clock


class Trip(NamedTuple):
    """A trajectory under way.

    Attributes:
        plan: of it.
        start: stamp of its first moving state, ns.
        approach: time that the way to the plan's start takes before the plan, s.
    """

    plan: Plan
    start: int
    approach: float

    def stamp(self, time: float) -> int:
        """Return the stamp, ns, of a time of the plan, s."""
        return self.start + round(NANOSECONDS * (time + self.approach))

    def times(self, stamps: Stamps) -> Array:
        """Return the times of the plan, (n,), s, of stamps, (n,), ns."""
        return (stamps - self.start) / NANOSECONDS - self.approach

    def faults(self, indices: list[int], offsets: list[float]) -> list[Fault]:
        """Place faults at crossings with these indices, so far from each, s."""
        found, first = [], self.start + round(NANOSECONDS * FIRST_FAULT)
        for index, offset in zip(indices, offsets, strict=True):
            crossing = self.stamp(self.plan.certificate.crossing_times[index])
            begin = max(crossing + round(NANOSECONDS * offset), first)
            found.append(Fault(index, crossing, begin))
        return found


class Session(Stack):
    """Tries cases on the nodes of a stack."""

    def __init__(self, request: SessionRequest) -> None:
        super().__init__(request)
        self.robot = load_robot(config_file(ROBOT_FILE))
        self.period = round(node_defaults("plant")["task.sample_period"] * NANOSECONDS)
        self.gap_limit = float(node_defaults("controller")["joint_states.timeout"])
        self.random = random.Random(request.seed)
        self._last_reason = ""
        self._plans: dict[int, Plan] = {}

    def plan(self, trips: int) -> Plan:
        """Return the trajectory of so many return trips, as the server plans it from
        the same numbers.
        """
        if trips not in self._plans:
            task, trip = node_defaults("trajectory_server"), self.config.trip
            start, goal = np.array(task["task.start"]), np.array(task["task.goal"])
            self._plans[trips] = plan_return_trip(
                self.robot, start, goal, trip.duration, trip.dwell, trips
            )
        return self._plans[trips]

    def run_case(self, name: str, count: int) -> Iterator[Event]:
        """Try one case; give a record for each faulted crossing, and the checks of each
        trip.
        """
        case = self.config.cases[name]
        action = make_action(case, self)
        done = idle = 0
        while done < count:
            trips = min(case.trips, (count - done + 1) // 2)
            refusals = self.monitor.change_parameters(
                "trajectory_server", task__repeat=trips
            )
            if any(refusals):
                raise NodesError(
                    f"the trajectory server does not take task.repeat = {trips}:"
                    f" {refusals[0]}"
                )
            records, tally = self.trip(name, case, action, trips, count - done)
            action.restore()
            self.processes.check()
            recovered = self.recover()
            for record in records:
                record["recovered"] = recovered
                yield record
            yield tally.told(name)
            tried = [
                record
                for record in records
                if record["outcome"] != Outcome.DISTURBED.value
            ]
            done += len(tried)
            idle = 0 if tried else idle + 1
            if not records:
                why = self._last_reason or "it met nothing"
                text = f"a trip without the fault: {why}"
                yield {"event": "note", "case": name, "text": text}
            if idle > MOST_IDLE:
                raise NodesError(f"the fault did not come about in {idle} trips")
            if not recovered:
                self.processes.check()
                raise NodesError(
                    "the robot did not come back to HOLD:"
                    f" {self.monitor.get('controller', 'reason')}"
                )

    def trip(
        self, name: str, case: FaultCase, action: Action, trips: int, left: int
    ) -> tuple[list[CrossingRecord], Tally]:
        """Make one trajectory with faults in its crossings; return their records and
        the checks on everything seen.
        """
        monitor, plan = self.monitor, self.plan(trips)
        self.processes.check()
        self.processes.forget()
        monitor.forget()
        self.answers = []
        before = {node: dict(values) for node, values in monitor.status.items()}
        faulted = list(range(len(plan.certificate.crossing_times)))
        if trips == 1 and case.kind != "transport" and self.random.random() < 0.5:
            faulted = faulted[1:]  # the fault meets the way back
        faulted = faulted[:1] if action.single else faulted[:left]
        offsets = [self.random.uniform(-SPREAD, SPREAD) for _ in faulted]
        action.prepare(self.random)
        trip = self._start(plan)
        faults = trip.faults(faulted, offsets)
        action.arm([fault.begin for fault in faults])
        trouble = self._follow(action, trip)
        action.release()
        self.linger(0.02)
        # what is judged: a command may come to this reader later than to the drives
        until = monitor.now
        monitor.until(
            lambda: bool(monitor.at_rig.stamps) and monitor.at_rig.stamps[-1] >= until,
            CATCH_UP,
        )
        took = action.took_effect
        ways = self._reports(case, before, took)
        self._last_reason = monitor.get("controller", "reason") if trouble else ""
        tally = Tally()
        evidence, records = self._judge(name, action, trip, faults, trouble, until)
        silent = took and case.reported and not ways
        none = f"{case.title}: none of {', '.join(case.reported)} was seen"
        tally.count(Check.UNREPORTED, int(took), [none] if silent else [])
        self._check(evidence, tally, action)
        if not took:
            records = []  # nothing was tried
        for record in records:
            record["reported"] = ways
            record["answers"] = self.answers
        action.extra(records, evidence)
        return records, tally

    def _start(self, plan: Plan) -> Trip:
        """Serve the plan, once more where the last trip left the robot off its start or
        its side unknown.
        """
        try:
            return self._serve(plan)
        except NodesError:
            if not self.recover(disable=True):
                raise
            return self._serve(plan)

    def _serve(self, plan: Plan) -> Trip:
        """Serve the plan; return its trip once it is under way."""
        monitor = self.monitor
        refused = monitor.get("controller", "trajectory")
        # a busy machine keeps the controller's words from the server
        for _ in range(SERVE_ATTEMPTS):
            answer = monitor.call(Trigger, "trajectory_server/start")
            if answer.success:
                break
            monitor.wait(1.0)
        else:
            raise NodesError(f"the trajectory server: {answer.message}")
        first = max(len(monitor.criterion.rows) - 1, 0)

        def moving() -> int | None:
            nonlocal first
            rows = monitor.criterion.rows
            while first < len(rows):
                if int(rows[first][PHASE]) in MOVING:
                    return monitor.criterion.stamps[first]
                first += 1
            note = monitor.get("controller", "trajectory")
            if note.startswith("refused") and note != refused:
                raise NodesError(f"the controller {note}")
            return None

        if not monitor.until(moving, TRIP_PATIENCE):
            raise NodesError(
                "the trajectory did not begin; the controller is in phase"
                f" {monitor.get('controller', 'phase')}"
            )
        start = moving()
        assert start is not None
        duration = plan.certificate.duration
        # these words are of this trajectory
        monitor.until(
            lambda: monitor.get("controller", "phase") != Phase.HOLD.name, 5.0
        )
        whole = float(monitor.get("controller", "duration") or duration)
        return Trip(plan, start, max(whole - duration, 0.0))

    def _follow(self, action: Action, trip: Trip) -> Trouble | None:
        """Watch until the trajectory is over or the robot is without control, and a
        little longer.
        """
        monitor = self.monitor
        duration = trip.plan.certificate.duration
        end = trip.stamp(duration)
        deadline = time.monotonic() + TRIP_PATIENCE + 20.0 * duration
        while time.monotonic() < deadline:
            monitor.turn()
            trouble = action.poll(monitor.now)
            if trouble is not None:
                self.linger(SETTLE)
                return trouble
            told = monitor.get("controller", "phase")
            outcome = OUTCOMES.get(monitor.phase) or OUTCOMES.get(told)
            if outcome is not None:
                stamps = monitor.criterion.stamps
                self.linger(SETTLE)
                return Trouble(stamps[-1] if stamps else monitor.now, outcome)
            if monitor.now >= end + round(0.05 * NANOSECONDS) and action.done:
                return None
        raise NodesError(
            "the trip did not end; the controller is in phase"
            f" {monitor.get('controller', 'phase')}"
        )

    def _reports(
        self, case: FaultCase, before: dict[str, dict[str, str]], took: bool
    ) -> list[str]:
        monitor, processes = self.monitor, self.processes

        def look() -> list[str]:
            for name in MODULES:
                processes.ended(name)
            silent = {
                name
                for name, heard in monitor.heard.items()
                if time.monotonic() - heard > SILENT
            }
            seen = NodeReports(
                before,
                monitor.status,
                monitor.texts,
                processes.exits,
                processes.logs(),
                self.answers,
                silent,
            )
            return seen.reports(case.reported)

        monitor.until(look, REPORT_PATIENCE if took and case.reported else 0.0)
        return look()

    def _judge(
        self,
        name: str,
        action: Action,
        trip: Trip,
        faults: list[Fault],
        trouble: Trouble | None,
        until: int,
    ) -> tuple[Evidence, list[CrossingRecord]]:
        """Judge what became of each faulted crossing, by the true joints until a stamp,
        ns.
        """
        monitor, case, certificate = self.monitor, action.case, trip.plan.certificate
        stamps, rows = monitor.truth.table(12)
        rows, stamps = rows[stamps <= until], stamps[stamps <= until]
        evidence = Evidence(
            stamps, rows[:, :4], rows[:, [8, 10]], *monitor.at_rig.table(2), self.period
        )
        trouble = self._first_trouble(trouble)
        sides = judgement.true_side(evidence.joints)
        sent = (monitor.truth.sent[1:], monitor.commands.sent[KEPT_COMMANDS:])
        disturbed = not self.lockstep and any(
            judgement.paused(np.array(times), self.gap_limit) for times in sent
        )
        records: list[CrossingRecord] = []
        for fault in faults:
            judged_at = max(
                fault.crossing + round(JUDGED_AFTER * NANOSECONDS),
                fault.begin + round(0.02 * NANOSECONDS),
            )
            stopped = trouble is not None and trouble.stamp <= judged_at + action.grace
            if stopped and trouble is not None:
                outcome = trouble.outcome
            elif not len(stamps) or stamps[-1] < judged_at:
                outcome = Outcome.MISSED
            elif sides[np.searchsorted(stamps, judged_at)] != np.sign(
                certificate.crossing_signs[fault.number]
            ):
                outcome = Outcome.MISSED
            else:
                outcome = Outcome.REFUSED if action.refused else Outcome.CROSSED
            expected = outcome.value in case.expect
            if disturbed and not expected and outcome is not Outcome.MISSED:
                outcome, expected = Outcome.DISTURBED, True
            records.append(
                {
                    "event": "record",
                    "case": name,
                    "outcome": outcome.value,
                    "expected": expected,
                    "where": self._place(case, trip, fault),
                    "offset": (fault.begin - fault.crossing) / NANOSECONDS,
                    "reason": monitor.get("controller", "reason") if stopped else "",
                    "true_error": (
                        None if stopped else self._true_error(trip, evidence, fault)
                    ),
                    "torque": judgement.largest_torque(evidence),
                    "reported": [],
                    "answers": [],
                    "recovered": False,
                }
            )
            if stopped:
                break  # the crossings after it did not take place
        return evidence, records

    @staticmethod
    def _place(case: FaultCase, trip: Trip, fault: Fault) -> str:
        """Say where in the crossing the fault began."""
        if case.kind in ("transport", "network", "flood"):
            return "throughout"
        profile = trip.plan.certificate.profile
        time = trip.times(np.array([fault.begin]))
        if abs(np.interp(time, profile.time, profile.s)[0]) < AT_LOCUS_ABS_S:
            return "at the locus"
        return "before" if fault.begin < fault.crossing else "after"

    def _first_trouble(self, trouble: Trouble | None) -> Trouble | None:
        """Return the first answered state without control, where there is one."""
        stamps, rows = self.monitor.criterion.stamps, self.monitor.criterion.rows
        for stamp, row in zip(stamps[1:], rows[1:], strict=True):
            if (outcome := OUTCOMES.get(int(row[PHASE]))) is not None:
                return Trouble(min(stamp, trouble.stamp) if trouble else stamp, outcome)
        return trouble

    def _true_error(self, trip: Trip, evidence: Evidence, fault: Fault) -> float:
        """Return the largest distance of the true end effector from the reference
        around one crossing, m.
        """
        half = round(SPREAD * NANOSECONDS)
        near = np.abs(evidence.stamps - fault.crossing) <= half
        if not near.any():
            return float("nan")
        times = trip.times(evidence.stamps[near])
        end = trip.plan.certificate.duration
        wanted = trip.plan.trajectory.table(np.clip(times, 0.0, end))[0]
        actual = judgement.true_position(self.robot, evidence.joints[near])
        return float(np.hypot(*(actual - wanted).T).max())

    def _check(self, evidence: Evidence, tally: Tally, action: Action) -> None:
        monitor, limit = self.monitor, self.robot.max_torque
        tally.count(Check.TORQUE_AFTER_DEATH, *judgement.torque_after_death(evidence))
        tally.count(Check.TORQUE_LIMIT, *judgement.torque_beyond(evidence, limit))
        stamps, rows = monitor.commands.table(2)
        bad = monitor.injector.bad_stamps if monitor.injector is not None else []
        tally.count(Check.NOT_FINITE, *judgement.not_finite(stamps, rows, bad, limit))
        for path in action.bags():
            tally.count(Check.BAG, 1, bag_check.unreadable(path))
        tally.count(Check.BAG, 0, action.broken_bags())

    def close(self) -> Tally:
        """End the nodes, and check what was recorded meanwhile."""
        tally = Tally()
        self.processes.stop_all()
        self.monitor.close()
        if self.request.record and self.bags:
            path = self._bag_path()
            if path.exists():
                tally.count(Check.BAG, 1, bag_check.unreadable(path))
        return tally


def say(event: Event) -> None:
    """Tell one event on the standard output."""
    print(json.dumps(event), flush=True)


def main() -> int:
    """Run the session; return 0 when every case was tried to its end, 128 + a signal's
    number when one ended them.
    """
    request = SessionRequest(**json.loads(sys.stdin.readline()))
    code = 0
    session: Session | None = None
    with signals.interruptible():
        try:
            session = Session(request)
            session.begin()
            for name, count in request.cases.items():
                say({"event": "start", "case": name})
                try:
                    for event in session.run_case(name, count):
                        say(event)
                except NodesError as error:
                    code = 1
                    say({"event": "failed", "case": name, "text": str(error)})
                    return code
        except DextarError as error:
            say({"event": "failed", "case": "", "text": str(error)})
            return 1
        except KeyboardInterrupt as interrupt:
            return signals.exit_code(interrupt)
        finally:
            # a further one would keep the nodes from being ended
            signals.install(signal.SIG_IGN)
            if session is not None:
                say(session.close().told(""))
    return code


if __name__ == "__main__":
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # a pipe
    argparse.ArgumentParser(
        description=(
            "One session of dextar faults: a JSON request on the standard input."
        )
    ).parse_args()
    exit_code = 1
    with signals.loading():  # also a signal before or after the session gives its code
        try:
            exit_code = main()
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(exit_code)  # rclpy's executor may outlive the nodes
