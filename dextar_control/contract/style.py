"""Everything that is looked at is drawn alike: colours on light, dark and grey, fonts,
lines, marks, symbols, units.

Pages take the colours as custom properties of CSS (``css``), Matplotlib as settings
(``matplotlib_settings``). Figures must read in grey as in colour: what shares an axis
differs in dash, width or mark, not by its colour alone.
"""

from __future__ import annotations

import html as markup
import re
from typing import Any, NamedTuple, TypeAlias

LIGHT = {
    "paper": "#ffffff",
    "wash": "#f3f4f6",
    "ink": "#14171c",
    "soft": "#565d68",
    "line": "#d3d7de",
    "mid": "#767e8a",
    "band": "#f2c6a6",
    "link": "#aeb6c2",
    "accent": "#1b5fb0",
    "bad": "#b02a0c",
    "good": "#17683f",
    "fifth": "#7a3f9d",
}
DARK = {
    "paper": "#14161a",
    "wash": "#1f2228",
    "ink": "#eef0f3",
    "soft": "#a9b0bb",
    "line": "#3a4049",
    "mid": "#8b93a0",
    "band": "#7a4a28",
    "link": "#5b6470",
    "accent": "#82b8f5",
    "bad": "#ff8f73",
    "good": "#72d3a2",
    "fifth": "#cf9df0",
}
FONT = 'system-ui, -apple-system, "Segoe UI", Helvetica, Arial, sans-serif'
MONOSPACE = 'ui-monospace, "SF Mono", Menlo, Consolas, monospace'
FIGURE_FONT = "DejaVu Sans"  # Matplotlib's own, with Greek letters


class Line(NamedTuple):
    """How a curve is drawn.

    Attributes:
        color: a name of the palette.
        dash: lengths of strokes and gaps, px; () is solid.
        width: px.
    """

    color: str
    dash: tuple[float, ...] = ()
    width: float = 1.6


DASHED, DOTTED, DASHDOT = (6.0, 3.0), (1.5, 3.0), (8.0, 3.0, 1.5, 3.0)
LINES = {  # of a curve's kind and part, 1 and 2 for the second and third motor
    ("commanded", 0): Line("ink"),
    ("commanded", 1): Line("accent", DASHED),
    ("planned", 0): Line("band", (), 5.0),
    ("planned", 1): Line("band", (10.0, 5.0), 5.0),
    ("commanded", 2): Line("good", DASHDOT),
    ("planned", 2): Line("band", (4.0, 4.0), 5.0),
    ("true", 0): Line("ink"),
    ("estimated", 0): Line("accent", DASHED, 1.4),
    ("seen", 0): Line("ink"),
    ("confidence", 0): Line("mid", DASHDOT, 1.4),
    ("each", 0): Line("ink", (), 1.4),
    ("mean", 0): Line("band", (), 5.0),
    ("limit", 0): Line("bad", DASHDOT, 1.0),
    ("target", 0): Line("accent", DOTTED, 1.4),
    ("t_s", 0): Line("bad", (), 3.5),
    ("stretched", 0): Line("mid", DASHED, 1.5),
    ("folded", 0): Line("mid", DOTTED, 1.8),
    ("linkage", 0): Line("link", (), 2.6),
}
RUNS = (
    Line("ink", (), 1.8),
    Line("bad", DASHED, 1.7),
    Line("accent", DASHDOT, 1.7),
    Line("mid", DOTTED, 2.2),
    Line("good", (), 1.0),
    Line("fifth", DASHED, 1.0),
)
MARKS = {
    "crossed": "o",
    "bounced": "X",
    "undecided": "s",
    "": "D",
}  # of an estimator's verdict, as Matplotlib names them

SYMBOLS = {  # as plain text has it: the letter and its index
    "t_s": ("t", "s"),
    "w_d": ("w", "d"),
    "A_r": ("A", "r"),
    "A_q": ("A", "q"),
    "M_q": ("M", "q"),
    "τ1": ("τ", "1"),
    "τ2": ("τ", "2"),
    "τ3": ("τ", "3"),
    "q11": ("q", "11"),
    "q21": ("q", "21"),
    "q31": ("q", "31"),
}
_SYMBOL = re.compile(rf"(?<!\w)(?:{'|'.join(map(re.escape, SYMBOLS))})(?!\w)")
AXES = {  # label and unit of what is drawn
    "time": ("time since the trajectory's start", "s"),
    "x": ("x", "m"),
    "y": ("y", "m"),
    "torque": ("torque", "N m"),
    "error": ("tracking error", "mm"),
    "residual": ("t_s·w_d", "N"),
    "s": ("s, 0 on the locus", "1"),
    "disturbance": ("torque the model lacks", "mN m"),
    "innovation": ("squared innovation", "1"),
}


def label(key: str) -> str:
    """Return name and unit of an axis as plain text; ``html`` and ``mathtext`` typeset
    it.
    """
    name, unit = AXES[key]
    return f"{name} ({unit})"


def html(text: str) -> str:
    """Return plain text with its symbols typeset for a page."""
    return _SYMBOL.sub(
        lambda found: "<i>{}</i><sub>{}</sub>".format(*SYMBOLS[found[0]]),
        markup.escape(text),
    )


def mathtext(text: str) -> str:
    """Return plain text with its symbols typeset for Matplotlib."""
    greek = {"τ": r"\tau"}
    escaped = text.replace("$", r"\$")
    return _SYMBOL.sub(
        lambda found: "${}_{{{}}}$".format(
            *(greek.get(part, part) for part in SYMBOLS[found[0]])
        ),
        escaped,
    )


def grey(palette: dict[str, str]) -> dict[str, str]:
    """Return a palette as paper or a screen without colours shows it, with the same
    luminance.
    """
    return {
        name: "#" + 3 * f"{round(255.0 * _encoded(luminance(color))):02x}"
        for name, color in palette.items()
    }


def css() -> str:
    """Return the palettes and fonts as custom properties: light, dark where the
    reader's system is dark, grey on a screen without colours.
    """

    def properties(palette: dict[str, str]) -> str:
        return " ".join(f"--{name}: {color};" for name, color in palette.items())

    return (
        f":root {{ color-scheme: light dark; --font: {FONT}; --mono: {MONOSPACE};"
        f" {properties(LIGHT)} }}\n@media screen and (prefers-color-scheme: dark) {{"
        f" :root {{ {properties(DARK)} }} }}\n@media (monochrome) {{ :root {{"
        f" {properties(grey(LIGHT))} }} }}"
    )


# Its keys are Matplotlib's own literals, and no room below the figures imports it.
FigureSettings: TypeAlias = Any  # type: ignore[explicit-any]


def matplotlib_settings(palette: dict[str, str], size: float = 9.0) -> FigureSettings:
    """Return a figure's settings on this palette, in a font of this size, points."""
    return {
        "figure.facecolor": palette["paper"],
        "savefig.facecolor": palette["paper"],
        "axes.facecolor": palette["paper"],
        "text.color": palette["ink"],
        "axes.labelcolor": palette["ink"],
        "axes.titlecolor": palette["ink"],
        "axes.edgecolor": palette["mid"],
        "xtick.color": palette["mid"],
        "ytick.color": palette["mid"],
        "xtick.labelcolor": palette["ink"],
        "ytick.labelcolor": palette["ink"],
        "grid.color": palette["line"],
        "grid.linewidth": 0.5,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "font.family": FIGURE_FONT,
        "font.size": size,
        "axes.labelsize": size,
        "legend.fontsize": 0.9 * size,
        "legend.frameon": False,
        "figure.titlesize": 1.25 * size,
        "axes.titlesize": size,
        "axes.titlelocation": "left",
    }


def matplotlib_line(
    line: Line, palette: dict[str, str], scale: float = 0.75
) -> dict[str, object]:
    """Return the arguments of Matplotlib's ``plot`` for a line; its widths times
    ``scale`` are points.
    """
    dash = (0, tuple(length / line.width for length in line.dash)) if line.dash else "-"
    return {
        "color": palette[line.color],
        "linestyle": dash,
        "linewidth": scale * line.width,
    }


def luminance(color: str) -> float:
    """Return the relative luminance of ``#rrggbb``, 0 to 1 (WCAG 2.2)."""
    parts = [int(color[index : index + 2], 16) / 255.0 for index in (1, 3, 5)]
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4
        for part in parts
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _encoded(linear: float) -> float:
    return (
        12.92 * linear if linear <= 0.0031308 else 1.055 * linear ** (1.0 / 2.4) - 0.055
    )
