"""References of docstrings to names that have no page of their own.

They are shown as code where the name exists, and are unknown, which ends the build, where it does
not: a docstring cannot go on naming what was renamed.
"""

from importlib.util import find_spec
from pkgutil import resolve_name
from types import ModuleType


def _exists(name):
    owner, _, last = name.rpartition(".")
    try:
        found = resolve_name(owner)
    except (AttributeError, ImportError, ValueError):
        return False
    if hasattr(found, last) or last in getattr(found, "__annotations__", ()):
        return True
    return find_spec(name) is not None if isinstance(found, ModuleType) else False


def _show_inner(app, env, node, contnode):
    target, module, owner = node["reftarget"], node.get("py:module"), node.get("py:class")
    if node.get("refdomain") != "py":
        return None
    names = (target, f"{module}.{target}", f"{module}.{owner}.{target}")
    known = any(name.startswith("multiarm.") and _exists(name) for name in names)
    return contnode if known else None


def setup(app):
    """Look at what Sphinx itself does not find."""
    app.connect("missing-reference", _show_inner)
    return {"parallel_read_safe": True}
