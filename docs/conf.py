"""Configuration of the site that `make docs` builds, without a network."""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ["NUMBA_DISABLE_JIT"] = "1"  # kernels are plain functions then, with their docstrings
ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(Path(__file__).parent), str(ROOT)]

import scipy.signal  # noqa: F401  # before torch is mocked, which scipy would look into
from extensions.names import type_aliases

from swarm_envs import __version__

project = "swarm-envs"
author = "The swarm-envs authors"
copyright = author
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "extensions.api_pages",
    "extensions.docstrings",
    "extensions.notebooks",
    "extensions.links",
]
exclude_patterns = ["_build", "extensions", "generated", "tables"]

html_theme = "furo"
html_title = "swarm-envs"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False

myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True, "ignore-module-all": True}
autodoc_mock_imports = ["torch", "stable_baselines3"]  # only signatures are read
autodoc_type_aliases = {name: name for name in type_aliases()}
python_use_unqualified_type_names = True
toc_object_entries = False  # a page would list hundreds
add_module_names = False
suppress_warnings = ["ref.python"]  # types are named shortly: two classes may share a name
default_role = "code"
smartquotes = False  # `--drones` stays what is typed
nitpicky = True  # names in docstrings must lead somewhere; types of other libraries cannot
nitpick_ignore_regex = [
    (r"py:(class|exc|data|func|meth|attr|mod)", r".*"),
    (r"py:obj", r"typing\.(Annotated|Literal).*"),  # alternatives, and aliases like `Count`
]
