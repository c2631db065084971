"""Settings of the documentation site; `make docs` builds it."""

import sys
from pathlib import Path

from splitband import __version__

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project, author = "splitband", "The splitband developers"
version = release = __version__
copyright = f"2026, {author}"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_copybutton",
    "sphinxcontrib.typer",
    "docstrings",
    "mathml",
    "repository",
]
exclude_patterns = ["_build"]
nitpicky = True

smartquotes = False  # it takes the two hyphens of an option for a dash

html_theme = "furo"
html_title = f"splitband {release}"
html_static_path = ["_static"]
html_css_files = ["splitband.css"]
html_theme_options = {"light_css_variables": {"color-code-background": "#f4f6f8"}}
html_math_renderer = "mathml"
html_show_sphinx = False
html_copy_source = False
pygments_style, pygments_dark_style = "a11y-high-contrast-light", "a11y-dark"

myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
suppress_warnings = ["myst.strikethrough"]

default_role = "py:obj"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
autosummary_generate = False
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
