"""A panel's backend with no robot behind it."""

from __future__ import annotations

from dextar_control.contract import style
from dextar_control.panel.server import Backend


class Nothing(Backend):
    """Knows of no number that is one."""

    def setup(self) -> dict[str, object]:
        lines = {
            f"{kind}{part}": line._asdict()
            for (kind, part), line in style.LINES.items()
        }
        specs = {
            "controller": [
                {"name": name, "choices": ["a"], "live": False}
                for name in ("law", "estimator")
            ]
        }
        return {
            "robot": "none",
            "namespace": "/",
            "low": [-0.1, -0.1],
            "high": [0.1, 0.1],
            "arcs": [],
            "lines": lines,
            "specs": specs,
        }

    def ask(self, name: str, arguments: object, answer: object) -> None: ...

    def watched(self, viewers: int) -> None: ...
