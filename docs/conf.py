"""Settings of the site: Markdown pages, pages of worlds from their docstrings, a reference from the code."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import moral_envs

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "moral-envs"
author = "The MORAL contributors"
project_copyright = author
release = version = moral_envs.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
myst_heading_anchors = 3
# Figures on the pages are those of the committed results, {{ planner.config.starts }} for example.
_RESULTS = Path(__file__).parents[1] / "benchmarks" / "results"
myst_enable_extensions = ["substitution"]
myst_substitutions = {"planner": json.loads((_RESULTS / "delivery_planner.json").read_text(encoding="utf-8"))}

# A reference into this package that leads nowhere is a warning, and a warning fails the build.
nitpicky = True
nitpick_ignore_regex = [
    (r"py:.*", r"(?!moral_envs).*"),
    (r"py:class", r"moral_envs\..*\.\w+T"),  # type variables
]
# What stands between single backticks in a docstring is linked if it is one of the module's own names.
default_role = "py:obj"

autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_class_signature = "mixed"
autodoc_type_aliases = {name: name for name in ("NDArray", "ArrayLike")}
napoleon_google_docstring = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
add_module_names = False

html_theme = "furo"
html_title = f"{project} {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False

_DOCSTRING = re.compile(r"^<!-- docstring of ([\w.]+) -->$", re.MULTILINE)


def insert_docstrings(app: Sphinx, page: str, source: list[str]) -> None:
    """Put a module's Markdown docstring where a page asks for it."""
    source[0] = _DOCSTRING.sub(lambda asked: importlib.import_module(asked[1]).__doc__ or "", source[0])


def keep_colons(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Keep napoleon from taking what stands before a colon in an attribute's first line for its type."""
    if what in ("data", "attribute", "property"):
        lines[:0] = ["..", ""]  # an empty comment


def setup(app: Sphinx) -> None:
    """Register the above with Sphinx."""
    app.connect("source-read", insert_docstrings)
    app.connect("autodoc-process-docstring", keep_colons, priority=400)  # before napoleon's own, at 500
