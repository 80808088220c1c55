"""Formulas as drawings within the page: no script and no font is asked for."""

from __future__ import annotations

import html
import re
from typing import Any
from xml.etree import ElementTree

import ziamath
from docutils import nodes
from sphinx.application import Sphinx

SIZE = 17.0  # of the drawing, to which its measures are related
SCALE = 1.08  # of a formula's letters beside the text's
ziamath.config.svg2 = False  # each glyph where it stands, without names of its own
ziamath.config.math.color = "currentColor"


def drawing(formula: str, *, inline: bool) -> str:
    """An SVG of a formula in LaTeX, as high as the text beside it."""
    svg = ziamath.Latex(formula, size=SIZE, inline=inline).svgxml()
    top, width, height = (float(one) for one in svg.attrib["viewBox"].split()[1:])
    em = {"width": width, "height": height, "vertical-align": -(top + height)}
    style = ";".join(f"{key}:{SCALE * value / SIZE:.3f}em" for key, value in em.items())
    told = html.escape(formula, quote=True)
    box = f'viewBox="{svg.attrib["viewBox"]}"'
    parts = "".join(ElementTree.tostring(one, encoding="unicode") for one in svg)
    return f'<svg role="img" aria-label="{told}" {box} style="{style}">{parts}</svg>'


def inline(self: Any, node: nodes.math) -> None:
    """Within a sentence."""
    self.body.append(drawing(node.astext(), inline=True))
    raise nodes.SkipNode


def block(self: Any, node: nodes.math_block) -> None:
    """On lines of its own, with the numbers of its tags at the end."""
    formula, numbers = node.astext(), re.findall(r"\\tag\{([^}]*)\}", node.astext())
    plain = re.sub(r"\\tag\{[^}]*\}", "", formula).strip()
    told = f"<span>({', '.join(numbers)})</span>" if numbers else ""
    picture = drawing(plain, inline=False)
    self.body.append(f'<div class="formula"><div>{picture}</div>{told}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_html_math_renderer("drawing", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
