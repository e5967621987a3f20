"""The table of all kinds of events: the kinds from the code, their meanings from here.

An event is a dict with ``kind`` and ``text``.  A kind in the code without a meaning, and a meaning
without such a kind, end the build.
"""

import ast
from pathlib import Path

from sphinx.errors import ExtensionError

ROOT = Path(__file__).parents[2]
FILE = ROOT / "docs" / "reference" / "generated" / "events.txt"

MEANINGS = {
    "touches": "a contact closes, without a rebound",
    "bounces": "a contact, or the end of a joint's range, closes and opens again at once",
    "comes to rest": "impacts that came ever faster have ended; the contact stays closed",
    "lets go": "a contact opens",
    "slides": "a closed contact with friction begins to slip",
    "sticks": "the slip of a contact has ended",
    "joint slips": "a joint with dry friction begins to move",
    "joint sticks": "dry friction holds a joint",
    "reaches its limit": "a joint comes to the end of its range and stays there",
    "leaves its limit": "a joint moves away from the end of its range",
    "passes its limit": "a joint passes the end of its range, which the scene does not name",
    "is back within its limit": "a joint has returned to its range",
    "pulls": "a contact that can only push is pulled, in a scene whose contacts stay closed",
    "pushes again": "a contact that was pulled pushes",
    "leaves its patch": "a contact point leaves the patch that bounds its surface",
    "is back on its patch": "a contact point has returned to its patch",
    "saturates": "a drive comes to the limit of its torque",
    "is no longer saturated": "a drive is below its limit again",
    "loses a direction": "an arm cannot follow its joint in every direction",
    "regains a direction": "an arm can follow its joint in more directions, or in all",
    "passes a singular posture": "an arm loses a direction and regains it within one step",
    "rank falls": "constraints become dependent: the chains may move on in more than one way",
    "rank rises": "constraints are independent again",
    "start": "a remark on how the run was prepared, such as a correction of the start",
    "method changes": "the integrator was switched, because the scene is stiff, or no longer",
    "shows a mode": "a natural motion is shown from here on, in the replay of `multiarm modes`",
    "control ends": "a table or a path of the control ends",
    "not listed": "last of all: how many more events there were than the thousand that are listed",
}  # fmt: skip


def _texts(node):
    constants = (n.value for n in ast.walk(node) if isinstance(n, ast.Constant))
    return {value for value in constants if isinstance(value, str)}


def _constants(tree):
    """Texts that a module gives a name, alone or several in one statement."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            target, value = node.targets[0], node.value
            pairs = [(target, value)]
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = zip(target.elts, value.elts, strict=True)
            for name, text in pairs:
                if isinstance(name, ast.Name) and isinstance(getattr(text, "value", None), str):
                    yield name.id, text


class _Inlined(ast.NodeTransformer):
    """A module with texts in place of their names."""

    def __init__(self, tree):
        self.texts = dict(_constants(tree))

    def visit_Name(self, node):
        return self.texts.get(node.id, node) if isinstance(node.ctx, ast.Load) else node


def _kinds_in(tree):
    """What the key ``kind`` of the events that a module makes can be."""
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    for event in (node for node in ast.walk(tree) if isinstance(node, ast.Dict)):
        pairs = zip(event.keys, event.values, strict=True)
        entries = {getattr(key, "value", None): value for key, value in pairs}
        if not {"kind", "text"} <= entries.keys():
            continue
        kind = entries["kind"]
        if isinstance(kind, ast.Constant):
            yield kind.value
            continue
        owner = next(f for f in reversed(functions) if event in ast.walk(f))
        named = [
            node.value
            for node in ast.walk(owner)
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]).startswith("kind")
        ]
        if not named:  # an argument, which a function of this name returns
            source = next(f for f in functions if f.name == f"_{kind.id}")
            returns = (node for node in ast.walk(source) if isinstance(node, ast.Return))
            named = [node.value for node in returns]
        for value in named:
            if isinstance(value, ast.IfExp):  # its condition has words, too
                named += [value.body, value.orelse]
            else:
                yield from _texts(value) - {""}


def kinds():
    """All kinds that a run's log may hold."""
    from multiarm.simulation.guard_log import KINDS

    found = {kind for changes in KINDS.values() for kind in changes}
    for path in (ROOT / "multiarm").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if '"kind":' in text:
            tree = ast.parse(text)
            found |= set(_kinds_in(_Inlined(tree).visit(tree)))
    return found


def _write():
    from multiarm.results.event_log import FAMILIES, family_of

    found = kinds()
    if found != MEANINGS.keys():
        new, gone = sorted(found - MEANINGS.keys()), sorted(MEANINGS.keys() - found)
        raise ExtensionError(f"{Path(__file__).name}: explain {new}, remove {gone}")
    order = {family.name: k for k, family in enumerate(FAMILIES)}
    rows = sorted(MEANINGS, key=lambda kind: order[family_of(kind).name])
    lines = ["| | kind | what happened |", "|---|---|---|"]
    lines += [f"| {family_of(kind).sign} | `{kind}` | {MEANINGS[kind]} |" for kind in rows]
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")


def setup(app):
    """Write the table before any page is read."""
    _write()
    return {"parallel_read_safe": True}
