"""The site: `make docs` builds it of these pages, the demos, docstrings and kept measurements.

All that a page loads is in the site itself: it works without a network.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

import dolfinx_tresca  # noqa: E402

project = "dolfinx_tresca"
author = "the dolfinx_tresca authors"
copyright = "the dolfinx_tresca authors, MIT licence"
version = release = dolfinx_tresca.__version__
html_title = f"dolfinx_tresca {version}"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx_design",
    "extensions.architecture",
    "extensions.docstrings",
    "extensions.links",
    "extensions.measured",
    "extensions.roles",
    "extensions.tutorials",
]
exclude_patterns = ["extensions"]
highlight_language = "text"  # diagrams and what programs print have no other mark
default_role = "py:obj"  # `names` in docstrings
nitpicky = False  # most of them are no targets: arguments, modules of the inside

myst_enable_extensions = [
    "amsmath",
    "attrs_block",
    "attrs_inline",
    "colon_fence",
    "deflist",
    "dollarmath",
]
myst_heading_anchors = 3
myst_dmath_double_inline = True
suppress_warnings = [
    "myst.header",  # demos begin at the second level where they have no title of their own
    "config.cache",
]

autosummary_generate = False  # the pages of the reference are written by hand
autoclass_content = "both"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
python_maximum_signature_line_length = 80


def mathjax() -> Path:
    """Return MathJax's one file that needs no fonts, of the package that brings it."""
    spec = importlib.util.find_spec("sphinx-mathjax-offline")
    assert spec is not None and spec.origin is not None, "make docs installs it"
    return Path(spec.origin).parent / "static" / "mathjax" / "tex-svg.js"


mathjax_path = "tex-svg.js"
mathjax3_config = {
    "options": {"enableMenu": False},
    "tex": {
        "macros": {
            "norm": [r"\lVert #1 \rVert", 1],
            "abs": [r"\lvert #1 \rvert", 1],
            "argmin": r"\operatorname*{arg\,min}",
            "tens": [r"\boldsymbol{#1}", 1],
        }
    },
}

html_theme = "furo"
html_static_path = ["static", str(mathjax())]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
