"""A run of faults: its sessions are processes, some side by side, whose events are
counted, shown and written.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Generator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TimeElapsedColumn

from dextar_control.contract.errors import DextarError, ParameterError
from dextar_control.contract.plain_data import as_plain
from dextar_control.contract.resources import config_file, node_defaults
from dextar_control.contract.terminal import Steps, Terminal, TextColumn
from dextar_control.contract.yaml_text import dump_document
from dextar_control.experiments.faults.cases import FaultConfig, load_cases
from dextar_control.experiments.faults.events import Event
from dextar_control.experiments.faults.figure import draw
from dextar_control.experiments.faults.netns import FaultyLink
from dextar_control.experiments.faults.stack import SessionRequest
from dextar_control.experiments.faults.table import Summary
from dextar_control.experiments.processes import end_with_parent
from dextar_control.experiments.run_folder import make_run_folder
from dextar_control.nodekit.domain import own_domain

CONFIG_NAME = "faults.yaml"
ATTEMPTS = 3  # sessions in which a case may begin before it is given up
STOP_TIMEOUT = 90.0  # s
RESOLUTION = 130  # dots per inch


class SessionPlan(NamedTuple):
    """The cases for sessions of one kind.

    Attributes:
        kind: ``lockstep``, ``realtime`` or ``network``.
        cases: name and count, in order.
    """

    kind: str
    cases: dict[str, int]


class SessionRunner(threading.Thread):
    """Runs the sessions of one plan, one after the other, and hands on their events.

    Args:
        plan: what to try.
        folder: of the run.
        config: of the cases.
        seed: of all chance.
        events: where the events go; ``None`` at the end.
        label: of its folders.
    """

    def __init__(
        self,
        plan: SessionPlan,
        folder: Path,
        config: FaultConfig,
        seed: int,
        events: queue.Queue[Event | None],
        label: str,
    ) -> None:
        super().__init__(name=label, daemon=True)
        self._kind = plan.kind
        self._left = dict(plan.cases)  # faulted crossings still to come
        self._folder = folder
        self._config = config
        self._seed = seed
        self._events = events
        self._process: subprocess.Popen[str] | None = None
        self._stopped = False

    def run(self) -> None:
        """Run sessions until nothing is left or a case was begun too often."""
        number, tries = 0, Counter[str]()
        try:
            while not self._stopped and (
                cases := {
                    name: count for name, count in self._left.items() if count > 0
                }
            ):
                number += 1
                first = next(iter(cases))
                tries[first] += 1
                if tries[first] > ATTEMPTS:
                    self._fail(first, f"given up after {ATTEMPTS} sessions")
                    self._left[first] = 0
                elif self._kind == "network":
                    with FaultyLink(seed=self._seed) as link:
                        self._session(cases, link, number)
                else:
                    self._session(cases, None, number)
        except DextarError as error:
            self._fail("", str(error))
        finally:
            self._events.put(None)

    def _fail(self, case: str, text: str) -> None:
        self._events.put({"event": "failed", "case": case, "text": text})

    def _session(
        self, cases: dict[str, int], link: FaultyLink | None, number: int
    ) -> None:
        folder, kind = self._folder / f"{self.name}-{number}", self._kind
        folder.mkdir(parents=True)
        request = SessionRequest(
            str(folder),
            "lockstep" if kind == "lockstep" else "realtime",
            cases,
            self._config.model_dump(),
            self._seed + 1000 * number,
            injector=kind == "lockstep",
            record=kind == "realtime",
            prefix={"controller": link.inside("b")} if link is not None else {},
        )
        command = [sys.executable, "-m", "dextar_control.experiments.faults.session"]
        place = [] if link is None else link.inside("a")
        environment = os.environ if link is None else link.environment()
        with (folder / "session.log").open("wb") as log, contextlib.ExitStack() as end:
            self._process = process = subprocess.Popen(
                [*place, *command],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env={**environment, "ROS_DOMAIN_ID": str(own_domain())},
                start_new_session=True,  # a signal to this group would reach it twice
                preexec_fn=end_with_parent,
            )
            end.callback(process.terminate)  # where the link breaks
            if self._stopped:  # while it was being started
                self.stop()
            with contextlib.suppress(BrokenPipeError):  # it ended at once
                self._write(json.dumps(asdict(request)))
            assert process.stdout is not None
            failed = ""
            for line in process.stdout:
                event: Event = json.loads(line)
                if event["event"] == "record" and event["outcome"] != "disturbed":
                    self._left[event["case"]] -= 1
                elif event["event"] == "network":
                    assert link is not None
                    self._write(json.dumps(_apply(link, event["quality"])))
                    continue
                elif event["event"] == "failed":
                    failed = event["case"] or next(iter(cases))
                self._events.put(event)
            code = process.wait()
        if code and not failed and not self._stopped:
            words = (folder / "session.log").read_text(errors="replace").strip()
            last = (words.splitlines() or ["nothing was said"])[-1]
            self._fail(next(iter(cases)), f"the session ended with code {code}: {last}")

    def _write(self, line: str) -> None:
        assert self._process is not None and self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def stop(self) -> None:
        """End the session under way."""
        self._stopped = True
        process = self._process
        if process is not None and process.poll() is None:
            process.send_signal(signal.SIGTERM)


def _apply(link: FaultyLink, quality: dict[str, float]) -> dict[str, int]:
    """Give both directions a quality; return the frames so far, both together."""
    both = [counts.to_dict() for counts in link.set_quality(**quality).values()]
    return {key: sum(counts[key] for counts in both) for key in both[0]}


def select(
    config: FaultConfig, names: Sequence[str], count: int | None, quick: bool
) -> dict[str, int]:
    """Select how many crossings of which case are tried.

    Args:
        config: the cases.
        names: or beginnings of names; all when empty.
        count: of each case instead of its own.
        quick: only those of a quick run, so many as it has.

    Raises:
        ParameterError: a name that no case has or begins with.
    """
    chosen = dict.fromkeys(config.cases)
    if names:
        chosen = {}
        for name in names:
            found = [case for case in config.cases if case == name] or [
                case for case in config.cases if case.startswith(name)
            ]
            if not found:
                raise ParameterError(
                    f"unknown case '{name}'; known are: {', '.join(config.cases)}"
                )
            chosen |= dict.fromkeys(found)
    wanted = {
        name: config.cases[name].quick if quick else config.cases[name].crossings
        for name in chosen
    }
    return {name: count or number for name, number in wanted.items() if number}


def session_plans(
    config: FaultConfig, counts: dict[str, int], jobs: int
) -> list[list[SessionPlan]]:
    """Plan sessions that run side by side, one group after the other: the machine's
    noise matters in real time only.
    """
    kinds: dict[str, dict[str, int]] = {"lockstep": {}, "realtime": {}, "network": {}}
    for name, count in counts.items():
        case = config.cases[name]
        kinds["network" if case.kind == "network" else case.clock][name] = count
    shares: list[dict[str, int]] = [{} for _ in range(jobs)]
    for name, count in sorted(
        kinds["lockstep"].items(), key=lambda item: -_cost(config, *item)
    ):
        min(
            shares,
            key=lambda share: sum(_cost(config, *item) for item in share.items()),
        )[name] = count
    groups = [[SessionPlan("lockstep", share) for share in shares if share]]
    groups += [[SessionPlan(kind, kinds[kind])] for kind in ("realtime", "network")]
    return [group for group in groups if group and group[0].cases]


def _cost(config: FaultConfig, name: str, count: int) -> float:
    """Estimate the seconds that a case takes: a fault that ends the trip costs a
    recovery.
    """
    return count * (0.5 if config.cases[name].trips > 1 else 2.5)


def run_faults(
    *,
    config_path: Path | None,
    names: Sequence[str],
    seed: int | None,
    count: int | None,
    quick: bool,
    jobs: int,
    output: Path,
) -> int:
    """Try the faults, print the table, write the folder; return the exit code.

    Raises:
        ParameterError: a wrong case or file.
        BagError: the folder cannot be made.
    """
    console = Terminal()
    path = config_path or config_file(CONFIG_NAME)
    config = load_cases(path)
    seed = config.seed if seed is None else seed
    counts = select(config, names, count, quick)
    folder = make_run_folder(output, "faults-")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    console.print(
        f"{sum(counts.values())} faulted crossings of {len(counts)} cases, seed {seed},"
        f" into {folder}",
        soft_wrap=True,
    )
    summary = Summary.of(config, list(counts))
    begun = time.monotonic()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    interrupted: KeyboardInterrupt | None = None
    with (
        (folder / "events.jsonl").open("w", encoding="utf-8") as record,
        Steps(*columns, console=console) as progress,
    ):
        whole = progress.add_task("faulted crossings", total=sum(counts.values()))
        try:
            for index, group in enumerate(session_plans(config, counts, jobs)):
                with contextlib.closing(
                    _run_group(group, folder, config, seed, index, progress)
                ) as events:
                    for event in events:
                        record.write(json.dumps(event) + "\n")
                        summary.take(event)
                        progress.update(whole, completed=summary.count)
        except KeyboardInterrupt as interrupt:
            interrupted = interrupt  # held until what there is has been written
    summary.seconds = time.monotonic() - begun
    _write(folder, summary, config, seed)
    for table in summary.tables():
        console.print(table)
    for line in summary.troubles():
        console.print(line, style="bold")
    drawn = " faults.png" if summary.rows() else ""
    console.print(
        f"{folder}: faults.md faults.json{drawn} events.jsonl and each session's logs",
        soft_wrap=True,
    )
    if interrupted is not None:
        raise interrupted
    return 0 if summary.good else 1


def _run_group(
    group: list[SessionPlan],
    folder: Path,
    config: FaultConfig,
    seed: int,
    index: int,
    progress: Steps,
) -> Generator[Event, None, None]:
    events: queue.Queue[Event | None] = queue.Queue()
    workers = [
        SessionRunner(
            plan,
            folder,
            config,
            seed + 100_000 * (10 * index + place),
            events,
            f"{plan.kind}-{place + 1}",
        )
        for place, plan in enumerate(group)
    ]
    bars: dict[str, tuple[str, TaskID]] = {}
    for plan in group:
        bar = progress.add_task(
            f"  {plan.kind}: starting the nodes", total=sum(plan.cases.values())
        )
        bars.update(dict.fromkeys(plan.cases, (plan.kind, bar)))
    running = len(workers)
    try:
        for worker in workers:
            worker.start()
        while running:
            event = events.get()
            if event is None:
                running -= 1
                continue
            if event["event"] == "start":
                kind, bar = bars[event["case"]]
                title = config.cases[event["case"]].title
                progress.update(bar, description=f"  {kind}: {title}")
            elif event["event"] == "record":
                progress.advance(bars[event["case"]][1])
            yield event
    finally:
        for worker in workers:
            worker.stop()
        for worker in workers:
            if worker.ident is not None:
                worker.join(timeout=STOP_TIMEOUT)
        for bar in {bar for _, bar in bars.values()}:
            progress.remove_task(bar)


def _write(folder: Path, summary: Summary, config: FaultConfig, seed: int) -> None:
    data = {"seed": seed, **summary.to_dict()}
    (folder / "faults.json").write_text(
        json.dumps(as_plain(data), indent=1) + "\n", encoding="utf-8"
    )
    (folder / "faults.md").write_text(summary.markdown(), encoding="utf-8")
    (folder / "cases.yaml").write_text(
        dump_document(config.model_dump()), encoding="utf-8"
    )
    if summary.rows():
        timeout = float(node_defaults("plant")["drive.command_timeout"])
        draw(summary, timeout).savefig(folder / "faults.png", dpi=RESOLUTION)
