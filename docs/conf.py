"""Settings of the site: Markdown pages; from the code, pages of worlds and commands and a reference."""

from __future__ import annotations

import importlib
import json
import os
import re
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

import moral_envs
from moral_algorithms.cli import main

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "MORAL"
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

# A reference into these packages that leads nowhere is a warning, and a warning fails the build.
nitpicky = True
nitpick_ignore_regex = [
    (r"py:.*", r"(?!moral_(envs|algorithms)).*"),
    (r"py:class", r"moral_\w+\..*\.\w+T"),  # type variables
]
# What stands between single backticks in a docstring is linked if it is one of the module's own names.
default_role = "py:obj"

autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_class_signature = "mixed"
autodoc_type_aliases = {name: name for name in ("NDArray", "ArrayLike", "FloatArray")}
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
_WIDTH = 88
"""Columns that a page shows without scrolling."""
_SHAPE = re.compile(r"(?<!`)\([^()]*\)(?!`)")
_HELP = re.compile(r"^<!-- help of moral (\w+) -->$", re.MULTILINE)


def insert_docstrings(app: Sphinx, page: str, source: list[str]) -> None:
    """Put a module's Markdown docstring, or a command's help, where a page asks for it."""
    source[0] = _DOCSTRING.sub(lambda asked: importlib.import_module(asked[1]).__doc__ or "", source[0])
    source[0] = _HELP.sub(lambda asked: f"```text\n{explain(asked[1])}```", source[0])


def explain(command: str) -> str:
    """Catch what a command's ``--help`` prints."""
    os.environ |= {"COLUMNS": str(_WIDTH), "NO_COLOR": "1"}
    with redirect_stdout(StringIO()) as printed, suppress(SystemExit):
        main([command, "--help"])
    # What stands above the options a terminal wraps.
    return "".join(f"{fill(line, _WIDTH)}\n" for line in printed.getvalue().splitlines())


def keep_colons(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Keep napoleon from taking what stands before a colon in an attribute's first line for its type."""
    if what in ("data", "attribute", "property"):
        lines[:0] = ["..", ""]  # an empty comment


def show_shapes_as_code(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Keep the names in a type's shape, such as (n, size), from being linked to whatever has that name."""
    lines[:] = [
        _SHAPE.sub(r"``\g<0>``", line) if line.startswith((":rtype:", ":type ")) else line for line in lines
    ]


def setup(app: Sphinx) -> None:
    """Register the above with Sphinx."""
    app.connect("source-read", insert_docstrings)
    app.connect("autodoc-process-docstring", keep_colons, priority=400)  # before napoleon's own, at 500
    app.connect("autodoc-process-docstring", show_shapes_as_code, priority=600)
