"""The site of the documentation, which `make docs` builds with Sphinx from the pages that GitHub shows.

The sources are the repository's Markdown files, so that a link that works on GitHub works on the site.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]

sys.path[:0] = [str(ROOT), str(Path(__file__).parent / "_extensions")]

import spatula_env  # noqa: E402

project = "spatula_env"
author = "The spatula_env authors"
project_copyright = author
release = version = spatula_env.__version__

root_doc = "docs/index"
include_patterns = ["*.md", "docs/**.md", "requirements/README.md"]
exclude_patterns = [".*", "build", "dist", "docs/_*", "logs", "out", "runs"]

nitpicky = True
# Types of properties, and exceptions that are public by their bases alone.
nitpick_ignore_regex = [("py:class", r"numpy\..*"), ("py:exc", r".*")]

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
    # In docs/_extensions:
    "accessible",
    "code_links",
    "contents",
    "formulas",
    "markdown_docstrings",
    "words",
]

# As GitHub does: anchors of headings, formulas between dollar signs.
myst_enable_extensions = ["dollarmath", "fieldlist", "html_image"]
myst_heading_anchors = 4

# Types stand with the descriptions of arguments, where docs/_extensions/markdown_docstrings.py puts them.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True}
toc_object_entries_show_parents = "hide"
python_maximum_signature_line_length = 88

html_theme = "furo"
html_title = f"spatula_env {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_extra_path = ["_extra"]
html_copy_source = False
html_search_scorer = str(Path(__file__).parent / "_static" / "scorer.js")
html_math_renderer = "mathml"
html_show_sphinx = False
pygments_style = "default"
pygments_dark_style = "github-dark"
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
