"""Settings of the site that ``make docs`` builds and that opens offline."""

import sys
from pathlib import Path
from xml.etree import ElementTree

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from reference import tables  # noqa: E402

project = "dextar"
author = "dextar maintainers"
release = version = ElementTree.parse(HERE.parent / "package.xml").findtext(
    "version", ""
)
html_title = f"dextar {version}"

extensions = ["myst_parser", "formulas"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath", "substitution", "fieldlist"]
myst_heading_anchors = 4
myst_substitutions = tables()

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
# A summary of what was found would be fetched, which browsers refuse to a file.
html_show_search_summary = False
html_show_copyright = False
html_math_renderer = "drawing"
