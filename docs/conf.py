"""Settings of the site that ``make docs`` builds and that opens offline."""

import sys
from pathlib import Path
from xml.etree import ElementTree

from docutils import nodes
from latex2mathml.converter import convert

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from reference import tables  # noqa: E402

project = "dextar"
author = "dextar maintainers"
release = version = ElementTree.parse(HERE.parent / "package.xml").findtext(
    "version", ""
)
html_title = f"dextar {version}"

extensions = ["myst_parser"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath", "substitution", "fieldlist"]
myst_heading_anchors = 4
myst_substitutions = tables()

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = (
    False  # it would fetch the pages, which a browser refuses to a file
)
html_show_copyright = False
html_math_renderer = (
    "mathml"  # browsers draw MathML themselves: no script, no font from elsewhere
)


def _inline(self, node):
    self.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _block(self, node):
    self.body.append(
        f'<div class="math">{convert(node.astext(), display="block")}</div>'
    )
    raise nodes.SkipNode


def setup(app):
    """Add the renderer of mathematics."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
