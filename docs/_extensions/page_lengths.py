"""A long page without anything to look at ends the build.

What counts are figures, replays and what cells and commands print.  Pages of the reference that are
made from docstrings are exempt.
"""

from docutils import nodes
from sphinx.errors import ExtensionError

MOST_WORDS = 1200
EXEMPT = ("reference/api/", "reference/scene", "reference/grasp")


def _shows_something(doctree):
    for node in doctree.findall(nodes.Element):
        if isinstance(node, nodes.image) or node.get("nb_element") == "cell_code_output":
            return True
        if isinstance(node, nodes.raw) and ("<svg" in node.astext() or "<iframe" in node.astext()):
            return True
        if isinstance(node, nodes.literal_block) and node.astext().startswith("$ "):
            return True
    return False


def _measure(app, doctree):
    page = app.env.docname
    words = len(doctree.astext().split())
    if words > MOST_WORDS and not page.startswith(EXEMPT) and not _shows_something(doctree):
        raise ExtensionError(
            f"{page}: {words} words and nothing to look at; add a figure, a replay or the output "
            f"of a cell, or take something out (at most {MOST_WORDS} words are bare)"
        )


def setup(app):
    """Look at each page when it was read and its commands were run."""
    app.connect("doctree-read", _measure, priority=900)
    return {"parallel_read_safe": True}
