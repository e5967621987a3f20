"""The directive ``implementation``: a module's derivation, and a link to its source.

The text is the docstring with which the module opens.  The source is a page of its own, since
`viewcode` writes those of modules with public names only.
"""

from importlib.util import find_spec
from pathlib import Path

from docutils import nodes
from docutils.statemachine import StringList
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import PythonLexer
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).parents[2]


def _source(module):
    return Path(find_spec(module).origin)


class Implementation(SphinxDirective):
    """What a module says of itself, and where it is."""

    required_arguments = 1  # the module

    def run(self):
        """The link and the derivation."""
        module = self.arguments[0]
        source = _source(module)
        self.env.note_dependency(str(source))
        modules = getattr(self.env, "theory_modules", {})
        modules[module] = self.env.docname
        self.env.theory_modules = modules
        up = "../" * self.env.docname.count("/")
        link = f'<p class="source"><a href="{up}_source/{module}.html">Source</a></p>'
        text = [f".. automodule:: {module}", "   :no-index:", "   :no-members:"]
        with_rst = ["```{eval-rst}", *text, "```"]
        found = nodes.container()
        self.state.nested_parse(StringList(with_rst, source=str(source)), 0, found)
        return [nodes.raw("", link, format="html"), *found.children]


def _pages(app):
    """A page for each module that the theory shows."""
    formatter = HtmlFormatter(linenos="inline", lineanchors="line")
    for module, page in sorted(getattr(app.env, "theory_modules", {}).items()):
        source = _source(module)
        title = str(source.relative_to(ROOT))
        back = f'<p><a href="../{page}.html">What it is about</a></p>'
        code = highlight(source.read_text(encoding="utf-8"), PythonLexer(), formatter)
        body = f"<h1>{title}</h1>{back}{code}"
        yield f"_source/{module}", {"title": title, "body": body}, "page.html"


def setup(app):
    """Register the directive and the sources' pages."""
    app.add_directive("implementation", Implementation)
    app.connect("html-collect-pages", _pages)
    return {"parallel_read_safe": False}
