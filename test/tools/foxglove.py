"""The JavaScript readers that Foxglove uses, run by Node."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).parent / "js" / "read_bag.cjs"
MODULES = Path(sys.prefix) / "js" / "node_modules"


def read(*files: Path) -> Iterator[dict[str, Any]]:
    """Every message of the files as plain data, with topic, type, log, publish and
    sequence; skips the test without Node.
    """
    node = shutil.which("node")
    if node is None:
        pytest.skip("Node.js is not installed")
    if not (MODULES / "@mcap" / "core").is_dir():
        pytest.skip(
            f"the JavaScript readers are not in {MODULES}; make test installs them"
            " where npm is"
        )
    environment = os.environ | {"NODE_PATH": str(MODULES)}
    answer = subprocess.run(
        [node, str(SCRIPT), *map(str, files)],
        capture_output=True,
        env=environment,
        timeout=300,
    )
    assert answer.returncode == 0, answer.stderr.decode()
    return (json.loads(line) for line in answer.stdout.splitlines())
