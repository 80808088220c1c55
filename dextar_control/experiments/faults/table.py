"""Count the faulted crossings by case, outcome, place and who reported, as a table to
read and as numbers.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from rich.table import Table

from dextar_control.experiments.faults.cases import FaultConfig
from dextar_control.experiments.faults.events import CrossingRecord, Event
from dextar_control.experiments.faults.judgement import Check, Outcome

HEAD = (
    "fault",
    "where in the crossing",
    "expected",
    "outcome",
    "true error, max (mm)",
    "reported by",
    "count",
)


@dataclass
class CaseCount:
    """Counts one case's faulted crossings.

    Attributes:
        name, title: of the case.
        expected: outcomes that may be.
        outcomes: how often each was.
        places: how often the fault began there.
        reported: how often each way of reporting was seen.
        unexpected: outcomes that may not be, robots that did not come back, failures.
        worst_error: largest true distance from the reference in a crossing that was
            completed, m; nan without one.
        curves: torque (N m) over time (s) after a commander's death.
    """

    name: str
    title: str
    expected: tuple[str, ...]
    outcomes: Counter[str] = field(default_factory=Counter)
    places: Counter[str] = field(default_factory=Counter)
    reported: Counter[str] = field(default_factory=Counter)
    unexpected: list[str] = field(default_factory=list)
    worst_error: float = math.nan
    curves: list[list[list[float]]] = field(default_factory=list)

    @property
    def count(self) -> int:
        """The faulted crossings that count: not those that the machine disturbed."""
        return sum(
            count
            for outcome, count in self.outcomes.items()
            if outcome != Outcome.DISTURBED.value
        )

    def cells(self) -> list[str]:
        """List the row of the table, in the order of ``HEAD``."""
        error = "" if math.isnan(self.worst_error) else f"{1e3 * self.worst_error:.3g}"
        return [
            self.title,
            _counted(self.places),
            ", ".join(self.expected),
            _counted(self.outcomes),
            error,
            _counted(self.reported) or "nobody needs to",
            str(self.count),
        ]


@dataclass
class Summary:
    """Counts a whole run.

    Attributes:
        cases: in the order in which they are listed.
        looked: how often each check was made.
        violations: check and what was seen.
        failures: cases that could not go on.
        notes: what was said on the way.
        seconds: that the run took.
    """

    cases: dict[str, CaseCount]
    looked: Counter[str] = field(default_factory=Counter)
    violations: list[tuple[str, str]] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0

    @classmethod
    def of(cls, config: FaultConfig, names: Sequence[str]) -> Summary:
        """Return an empty summary of these cases."""
        return cls(
            {
                name: CaseCount(
                    name, config.cases[name].title, tuple(config.cases[name].expect)
                )
                for name in names
            }
        )

    @property
    def count(self) -> int:
        """All faulted crossings that count."""
        return sum(case.count for case in self.cases.values())

    @property
    def good(self) -> bool:
        """Whether nothing happened that never must, and nothing that was not
        expected.
        """
        return not (
            self.violations
            or self.failures
            or any(case.unexpected for case in self.cases.values())
        )

    def take(self, event: Event) -> None:
        """Count one event of a session."""
        if event["event"] == "record":
            self._take_record(self.cases[event["case"]], event)
        elif event["event"] == "checks":
            self.looked.update(event["looked"])
            self.violations += [(check, text) for check, text in event["violations"]]
        elif event["event"] == "failed":
            case = self.cases.get(event["case"])
            self.failures.append(
                f"{case.title}: {event['text']}" if case else event["text"]
            )
        elif event["event"] == "note":
            self.notes.append(f"{self.cases[event['case']].title}: {event['text']}")

    @staticmethod
    def _take_record(case: CaseCount, record: CrossingRecord) -> None:
        outcome = record["outcome"]
        case.outcomes[outcome] += 1
        case.places[record["where"]] += 1
        case.reported.update(record["reported"])
        error = record["true_error"]
        if error is not None and outcome in (Outcome.CROSSED, Outcome.REFUSED):
            case.worst_error = float(np.fmax(case.worst_error, error))  # nan is none
        if curve := record.get("curve"):
            case.curves.append(curve)
        where = f"{1e3 * record['offset']:+.0f} ms from the crossing"
        if not record["expected"]:
            case.unexpected.append(
                f"{outcome}, {where}: {record['reason'] or 'no reason given'}"
            )
        if not record["recovered"]:
            case.unexpected.append(f"not brought back to HOLD after {outcome}, {where}")

    def to_dict(self) -> dict[str, object]:
        """Return everything as plain data."""
        return {
            "crossings": self.count,
            "good": self.good,
            "seconds": self.seconds,
            "failures": self.failures,
            "notes": self.notes,
            "never": {
                check.value: {
                    "looked": self.looked[check.value],
                    "violations": [
                        text for name, text in self.violations if name == check.value
                    ],
                }
                for check in Check
            },
            "cases": {
                case.name: {
                    "title": case.title,
                    "expected": list(case.expected),
                    "outcomes": dict(case.outcomes),
                    "where": dict(case.places),
                    "reported": dict(case.reported),
                    "unexpected": case.unexpected,
                    "worst_true_error": (
                        None if math.isnan(case.worst_error) else case.worst_error
                    ),
                    "count": case.count,
                }
                for case in self.cases.values()
            },
        }

    def rows(self) -> list[list[str]]:
        """List the rows of the cases that were tried."""
        return [case.cells() for case in self._tried()]

    def _tried(self) -> list[CaseCount]:
        return [case for case in self.cases.values() if case.outcomes]

    def never_rows(self) -> list[list[str]]:
        """List the checks: name, how often looked at, how often violated."""
        happened = Counter(check for check, _ in self.violations)
        return [
            [check.value, str(self.looked[check.value]), str(happened[check.value])]
            for check in Check
        ]

    def tables(self) -> list[Table]:
        """Make the tables for the terminal."""
        shown = (0, 3, 5, 6)  # the others stand in the file
        cases = Table(
            *(HEAD[column] for column in shown), title=f"{self.count} faulted crossings"
        )
        for case in self._tried():
            row, style = case.cells(), "bold" if case.unexpected else None
            cases.add_row(*(row[column] for column in shown), style=style)
        never = Table("must never happen", "looked at", "happened")
        for row in self.never_rows():
            never.add_row(*row, style="bold" if row[2] != "0" else None)
        return [cases, never]

    def troubles(self) -> list[str]:
        """Write lines about what should not have been."""
        lines = [f"{check}: {text}" for check, text in self.violations]
        lines += [
            f"{case.title}: {text}"
            for case in self.cases.values()
            for text in case.unexpected
        ]
        return [*lines, *self.failures]

    def markdown(self) -> str:
        """Write the tables for a file or a document."""
        lines = [
            f"{self.count} faulted crossings in {self.seconds:.0f} s.",
            "",
            *_markdown(HEAD, self.rows()),
            "",
        ]
        lines += _markdown(
            ("must never happen", "looked at", "happened"), self.never_rows()
        )
        for title, texts in (
            ("Not as expected", self.troubles()),
            ("Notes", self.notes),
        ):
            if texts:
                lines += ["", f"{title}:", "", *(f"- {text}" for text in texts)]
        return "\n".join(lines) + "\n"


def _counted(counter: Counter[str]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counter.most_common())


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    table = [head, ["---"] * len(head), *rows]
    return [
        "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
        for row in table
    ]
