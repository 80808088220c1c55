"""Words are legible and curves told apart on light, dark and grey; symbols are
typeset.
"""

from __future__ import annotations

import itertools

import pytest

from dextar_control.contract import style

# Colours in which words are set, on paper and on wash.
TEXTS = ("ink", "soft", "bad", "good", "accent")
PALETTES = {
    "light": style.LIGHT,
    "dark": style.DARK,
    "grey": style.grey(style.LIGHT),
    "dark, grey": style.grey(style.DARK),
}
SHARED = (  # curves that lie in one picture
    [("planned", 0), ("planned", 1), ("commanded", 0), ("commanded", 1)],
    [("true", 0), ("estimated", 0), ("planned", 0), ("confidence", 0)],
    [("each", 0), ("mean", 0), ("limit", 0)],
    [
        ("stretched", 0),
        ("folded", 0),
        ("planned", 0),
        ("true", 0),
        ("t_s", 0),
        ("linkage", 0),
    ],
)


def contrast(one: str, other: str) -> float:
    """Return the contrast of two colours, 1 to 21 (WCAG 2.2)."""
    high, low = sorted((style.luminance(one), style.luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("name", PALETTES)
def test_words_have_the_contrast_that_wcag_asks_for(name: str) -> None:
    palette = PALETTES[name]
    for text, under in itertools.product(TEXTS, ("paper", "wash")):
        assert contrast(palette[text], palette[under]) >= 4.5, (text, under)
    for drawn in {line.color for line in (*style.LINES.values(), *style.RUNS)} - {
        "band",
        "link",
    }:
        assert contrast(palette[drawn], palette["paper"]) >= 3.0, drawn
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)


@pytest.mark.parametrize("name", PALETTES)
def test_curves_that_share_a_picture_differ_without_colour(name: str) -> None:
    palette = PALETTES[name]
    pictures = [[style.LINES[key] for key in keys] for keys in SHARED] + [
        list(style.RUNS)
    ]
    for lines in pictures:
        for one, other in itertools.combinations(lines, 2):
            lightness = contrast(palette[one.color], palette[other.color])
            wider = max(one.width, other.width) / min(one.width, other.width)
            assert one.dash != other.dash or lightness >= 1.8 or wider >= 1.6, (
                one,
                other,
            )


def test_symbols_are_typeset_and_the_rest_is_text() -> None:
    assert (
        style.html("|t_s·w_d| <N>")
        == "|<i>t</i><sub>s</sub>·<i>w</i><sub>d</sub>| &lt;N&gt;"
    )
    assert style.html("max_torque, t_start") == "max_torque, t_start"
    assert style.mathtext("τ1 planned") == r"$\tau_{1}$ planned"
    assert style.label("residual") == "t_s·w_d (N)"


def test_every_palette_has_every_colour() -> None:
    assert set(style.LIGHT) == set(style.DARK)
    assert all(
        f"--{name}: {color};" in style.css()
        for name, color in (*style.LIGHT.items(), *style.DARK.items())
    )
