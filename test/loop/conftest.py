"""A closed loop that fails says where to look."""

from __future__ import annotations

from collections.abc import Generator

import closed_loop
import pytest


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add to a failure what each loop of the test came to."""
    report = yield
    if report.failed and closed_loop.ran:
        lines = map(closed_loop.told, closed_loop.ran)
        report.sections.append(("closed loops", "\n".join(lines)))
    if call.when == "teardown":
        closed_loop.ran.clear()
    return report
