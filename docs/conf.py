"""How ``build.sh`` builds the documentation.

Pages are notebooks in MyST Markdown: the build executes every cell and every command, and a cell
that fails, a link that leads nowhere or a name that does not exist ends it.  The pages load nothing
from the network.
"""

import os
import shutil
import sys
from importlib import metadata
from pathlib import Path

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.insert(0, str(DOCS / "_extensions"))

project = "multiarm"
author = "the authors of multiarm"
copyright = "the authors of multiarm, BSD-3-Clause"
version = release = metadata.version("multiarm")

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinxcontrib.programoutput",
    "inner_names",
    "sphinx-mathjax-offline",
    "replays",
    "schema_pages",
    "implementations",
    "house",
    "page_lengths",
    "event_kinds",
]
exclude_patterns = ["_build", "_templates", "_extensions", "_workplace"]
templates_path = ["_templates"]
nitpicky = True
suppress_warnings = ["misc.highlighting_failure"]  # of what an error prints
nitpick_ignore_regex = [
    # Types of other packages, and words of docstrings such as "array-like, shape (n, 3)".
    (r"py:class", r"(?!multiarm\.).*"),
    (r"py:obj", r"(?!multiarm\.).*"),
]

# --- pages that run -------------------------------------------------------------------------------
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist", "attrs_inline"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_render_markdown_format = "myst"  # tables among the output
programoutput_prompt_template = "$ {command}\n{output}"


def _workplace() -> Path:
    """A folder in which pages run: a checkout's files by their usual paths, and room to write."""
    folder = DOCS / "_workplace"
    shutil.rmtree(folder, ignore_errors=True)
    startup = folder / ".ipython" / "profile_default" / "startup"
    startup.mkdir(parents=True)
    shutil.copy(DOCS / "_extensions" / "page_startup.py", startup)
    for name in ("examples", "robots", "benchmarks"):
        (folder / name).symlink_to(ROOT / name)
    return folder


WORKPLACE = _workplace()
os.environ["IPYTHONDIR"] = str(WORKPLACE / ".ipython")
os.environ["MULTIARM_DOCS_WORKPLACE"] = str(WORKPLACE)
os.environ["COLUMNS"] = "92"  # of the commands' tables
os.environ["NO_COLOR"] = "1"

# --- reference ------------------------------------------------------------------------------------
autosummary_generate = True
autodoc_typehints = "none"  # docstrings have types and shapes
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

# --- looks ----------------------------------------------------------------------------------------
html_theme = "pydata_sphinx_theme"
html_title = "multiarm"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "show_prev_next": False,
    "navigation_with_keys": False,
    # Equations need the width.
    "secondary_sidebar_items": {"theory/**": [], "[!t]**": ["page-toc"]},
    "navbar_persistent": ["search-button"],
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "header_links_before_dropdown": 9,
}
html_sidebars = {"index": [], "start": [], "choosing": [], "gallery": [], "limits": []}
