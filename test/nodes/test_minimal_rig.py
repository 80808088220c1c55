"""The rig driver written out in the documentation keeps the contract: the same check as the
plant's, its two functions filled in.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from fake_driver import INERTIA, START, WATCHDOG
from patience import PATIENCE
from test_check_rig import LINES, ROOT, named, outcome

RUNNER = f"""
import json, sys, time
import driver

class Motors:
    q, q_dot, torque, since, most = {list(START)}, [0.0, 0.0], [0.0, 0.0], time.monotonic(), 0.0

    def go_on(self):
        now = time.monotonic()
        dt, self.since = now - self.since, now
        for i in range(2):
            a = self.torque[i] / {INERTIA}
            self.q[i] += dt * self.q_dot[i] + 0.5 * dt * dt * a
            self.q_dot[i] += dt * a

    def read(self):
        self.go_on()
        return list(self.q), list(self.q_dot)

    def write(self, torque):
        self.go_on()
        self.torque = list(torque)
        self.most = max([self.most, *map(abs, torque)])

motors = Motors()
driver.read_encoders, driver.write_torques, driver.RATE, driver.WATCHDOG = motors.read, motors.write, 200.0, {WATCHDOG}
driver.main()
json.dump({{"last": motors.torque, "most": motors.most}}, open(sys.argv[1], "w"))
"""


@pytest.fixture
def minimal_rig(tmp_path: Path) -> Path:
    """A folder with the documentation's driver and what fills it in."""
    blocks = re.findall(
        r"```python\n(.*?)```",
        (ROOT / "docs" / "driver.md").read_text(encoding="utf-8"),
        re.DOTALL,
    )
    code = next(block for block in blocks if "def read_encoders" in block)
    assert len([line for line in code.splitlines() if line]) <= 65
    (tmp_path / "driver.py").write_text(code, encoding="utf-8")
    (tmp_path / "runner.py").write_text(RUNNER, encoding="utf-8")
    return tmp_path


def test_the_documented_driver_passes_every_line_and_ends_without_torque(
    minimal_rig: Path,
) -> None:
    told = minimal_rig / "motors.json"
    process = subprocess.Popen(
        [sys.executable, "runner.py", str(told)], cwd=minimal_rig
    )
    try:
        code, lines, text = outcome(minimal_rig, "--yes")
        process.terminate()
        assert process.wait(PATIENCE) == 0
    finally:
        process.kill()
        process.wait()
    assert named(lines, "PASS") == set(LINES), text
    assert code == 0
    assert json.loads(told.read_text()) == {"last": [0.0, 0.0], "most": 0.005}
