"""The directive ``house``: the package in one figure, drawn from its imports.

The rooms are those that ``tests/package/test_architecture.py`` allows; a room stands one storey
above the highest that it imports.  The way of a scene through them is drawn over it.
"""

import ast
from pathlib import Path

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).parents[2]
TEST, PACKAGE = ROOT / "tests" / "package" / "test_architecture.py", ROOT / "multiarm"

# From room to room: what a user calls or gets.
WAY = (
    ("scene", "assembly", "compile_system: a Scene becomes a System"),
    ("assembly", "dynamics", "evaluate: the System at one state, an Evaluation"),
    ("dynamics", "simulation", "simulate: many evaluations, integrated"),
    ("simulation", "results", "what remains of a run: a Trajectory"),
)
STOREY, BOX, SPACE = 44, (104, 30), 10  # [px]
LEFT, COLUMN, WIDTH = 4, 400, 790  # [px] where rooms begin, those of the way, the figure's width


def rooms():
    """The names, from the ground up, as the test has them."""
    for node in ast.parse(TEST.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "ROOMS":
            return ast.literal_eval(node.value)
    raise ValueError(f"{TEST.name} has no ROOMS")


def storeys(names):
    """The storey of each room: one above the highest that it imports."""
    uses = {name: set() for name in names}
    for path in PACKAGE.rglob("*.py"):
        inside = path.relative_to(PACKAGE).with_suffix("").parts
        room = "multiarm" if inside == ("__init__",) else inside[0]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("multiarm."):
                uses[room].add(node.module.split(".")[1])
            elif isinstance(node, ast.ImportFrom) and node.module == "multiarm":
                uses[room] |= {alias.name for alias in node.names} & uses.keys()
    found = {}
    for name in names:
        found[name] = 1 + max((found[used] for used in uses[name] - {name}), default=-1)
    return found


def _figure():
    heights = storeys(rooms())
    top = max(heights.values())
    on_way = {end for start, goal, _ in WAY for end in (start, goal)}
    place, parts = {}, []
    for storey in range(top + 1):
        x = LEFT
        for name in (room for room, height in heights.items() if height == storey):
            own = name in on_way
            place[name] = (COLUMN if own else x, (top - storey) * STOREY + 4)
            x += 0 if own else BOX[0] + SPACE
            at = f'x="{place[name][0]}" y="{place[name][1]}" width="{BOX[0]}" height="{BOX[1]}"'
            parts.append(f'<rect {at} rx="5" class="{"way" if own else "room"}"/>')
            middle = place[name][0] + BOX[0] / 2, place[name][1] + BOX[1] / 2 + 4
            parts.append(f'<text x="{middle[0]}" y="{middle[1]}" class="name">{name}</text>')
    for step, (start, goal, words) in enumerate(WAY, start=1):
        x, out = COLUMN + BOX[0], 60 * step
        y = place[start][1] + BOX[1] * (0.75 if start != "scene" else 0.5)
        end = place[goal][1] + BOX[1] * (0.25 if goal != "results" else 0.5)
        parts.append(
            f'<path d="M {x} {y} C {x + out} {y}, {x + out} {end}, {x + 5} {end}" class="path" '
            f'marker-end="url(#house-arrow)"/>'
        )
        for mark in ((x + 0.75 * out, 0.5 * (y + end)), (COLUMN + 12, 26 * step - 8)):
            parts.append(f'<circle cx="{mark[0]}" cy="{mark[1]}" r="10" class="mark"/>')
            parts.append(f'<text x="{mark[0]}" y="{mark[1] + 4}" class="number">{step}</text>')
        parts.append(f'<text x="{COLUMN + 30}" y="{26 * step - 4}" class="step">{words}</text>')
    arrow = (
        '<defs><marker id="house-arrow" viewBox="0 0 8 8" refX="6" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M 0 0 L 8 4 L 0 8 z" class="tip"/></marker></defs>'
    )
    size = f'viewBox="0 0 {WIDTH} {(top + 1) * STOREY}"'
    alt = "The rooms of the package, each above those that it imports; the way of a scene over them"
    return f'<svg class="house" {size} role="img" aria-label="{alt}">{arrow}{"".join(parts)}</svg>'


class House(SphinxDirective):
    """The figure."""

    def run(self):
        """An SVG that follows the page's colours."""
        self.env.note_dependency(str(TEST))
        return [nodes.raw("", _figure(), format="html")]


def setup(app):
    """Register the directive."""
    app.add_directive("house", House)
    return {"parallel_read_safe": True}
