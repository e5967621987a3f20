"""The tables of the scaling study as text, for the terminal and for the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from multiarm.studies.time_shares import TARGET

NOTHING = "-"
DISTURBED = 0.05
"""Share of the time spent waiting above which something is said."""
_METHODS = {
    "multiarm": "multiarm",
    "terms": "  arm terms in it",
    "compiled": "multiarm, compiled arms",
    "constraintDynamics": "constraintDynamics",
    "tree": "  object on one arm",
    "lcaba": "lcaba",
    "dense": "dense KKT",
}


class Cell(NamedTuple):
    """One cell; ``tone`` is empty, strong, good or bad."""

    text: str
    tone: str = ""


class Table(NamedTuple):
    """A table of numbers, and what is to be said about it.

    study : str
        The study of the result that it belongs to.
    title : str
    heads : tuple of str
        In one or two lines; the first column is text, the others are numbers.
    rows : tuple of tuple of Cell
    notes : tuple of str
    """

    study: str
    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()


def tables(result: dict[str, Any]) -> Iterator[Table]:
    """All tables of :func:`multiarm.studies.scaling.run_scaling`'s result."""
    if "evaluations" in result:
        yield from _evaluations(result["evaluations"])
    if "thesis" in result:
        yield from _thesis(result["thesis"])
    if "shares" in result:
        yield from _shares(result["shares"])
    if "contact_rows" in result:
        rows = [(name, f"{cost:.3f}") for name, cost in result["contact_rows"].items()]
        yield _table("contact_rows", "One row of W, in microseconds", ("row", "cost"), rows)


def disturbance(result: dict[str, Any]) -> str:
    """What is to be said when other programs disturbed the measurements; empty when not."""
    waited = result["waited"]
    if waited < DISTURBED:
        return ""
    return (
        f"other programs kept this one waiting for {100 * waited:.0f} % of the time, which is not "
        "counted; but they shared its caches: repeat in quiet for the best figures"
    )


def _evaluations(found: dict[str, Any]) -> Iterator[Table]:
    for kind, exponents in found["exponents"].items():
        rows = [row for row in found["rows"] if row["kind"] == kind]
        heads = ["", *(f"n={row['arms']}" for row in rows), "slope", "upper\nhalf", "error"]
        lines = []
        for method, title in _METHODS.items():
            known = [row["relative_error"].get(method) for row in rows]
            errors = [error for error in known if error is not None]
            lines.append(
                (
                    Cell(title, "strong" if method in ("multiarm", "compiled") else ""),
                    *(micro(row["microseconds"][method]) for row in rows),
                    exponent(exponents[method]),
                    exponent(found["upper_exponents"][kind][method]),
                    f"{max(errors):.0e}" if errors else "",
                )
            )
        for method, title in (("multiarm", "best peer / ours"), ("compiled", "  compiled arms")):
            ratios = (row["ratio_to_best_peer"][method] for row in rows)
            shown = (NOTHING if ratio is None else f"{ratio:.2f}" for ratio in ratios)
            lines.append((Cell(title, "good"), *shown, "", "", ""))
        yield _table(
            "evaluations", f"One evaluation, {kind} joints, in microseconds", heads, lines,
            _evaluation_notes(rows, found["growth"][kind]),
        )  # fmt: skip


def _evaluation_notes(rows: Sequence[dict[str, Any]], growth: float | None) -> Iterator[str]:
    if growth is not None:
        yield (
            f"multiarm: the cost at n = {rows[-1]['arms']} is {growth:.1f} times that at "
            f"n = {rows[0]['arms']}"
        )
    for row in rows:
        for remark in sorted(set(row["remarks"].values())):
            yield f"{', '.join(row['remarks'])} at n = {row['arms']}: {remark}"


def _thesis(found: dict[str, Any]) -> Iterator[Table]:
    pictures = ("interpreted", "compiled")
    speedups, costs, counts = [], [], []
    for row in found["rows"]:
        then, n = found["thesis"].get(str(row["arms"])), str(row["arms"])
        cells = [n]
        for key in ("total", "solving", "saved"):
            cells.append(NOTHING if then is None else plain(then[key]))
            cells += [plain(row["columns"][picture][key]) for picture in pictures]
        speedups.append(cells)
        was = [NOTHING, NOTHING] if then is None else [plain(then["t1"]), plain(then["t2"])]
        scripted, ours = (row["microseconds"][picture] for picture in pictures)
        parts = [scripted["build"], scripted["node"]]
        parts += [ours[part] for part in ("build", "node", "lu", "ldl", "assembly")]
        costs.append([n, *was, *map(micro, parts)])
        count = row["operations"]
        counts.append(
            [
                n, f"{count['node']:,}", f"{count['direct']:,}", plain(count["ratio"]),
                plain(count["ratio_as_written"]), f"{max(row['deviation'].values()):.0e}",
            ]
        )  # fmt: skip
    heads = ["n"]
    for name in ("total", "t2/t1", "t2-t1"):
        heads += [f"{name}\n{when}" for when in ("1995", "NumPy", "ours")]
    title = "Section 4.4: speed-up in total and in solving, time saved (1995 [ms], now [us])"
    yield _table("thesis", title, heads, speedups)
    heads = ["n", "1995\nt1", "1995\nt2", "NumPy\nt", "NumPy\nt1", "ours\nt", "ours\nt1",
             "LU\nt2", "LDL^T\nt2", "matrix\nfilled"]  # fmt: skip
    yield _table("thesis", "Section 4.4: times of 1995 [ms] and now [us]", heads, costs)
    heads = ["n", "node", "direct", "ratio", "ratio\nas written", "deviation"]
    title = "Section 4.4: floating point operations, and how far the solvers agree"
    yield _table("thesis", title, heads, counts, _thesis_notes(found))


def _thesis_notes(found: dict[str, Any]) -> Iterator[str]:
    slopes, upper, last = (
        found[key]["compiled"] for key in ("slopes", "upper_slopes", "last_slopes")
    )
    yield (
        "t: coefficients of (4.9); t1: node algorithm; t2: direct elimination by LU, the matrix "
        "filled beforehand; total: (t2 + t) / (t1 + t). NumPy: t and t1 as a plain script, next to "
        "LAPACK's LU; 1995: the thesis's Matlab."
    )
    yield (
        f"exponents: t1 {exponent(slopes['node'])} compiled, "
        f"{exponent(found['slopes']['interpreted']['node'])} as a script; t2 "
        f"{exponent(slopes['lu'])}, over the larger half {exponent(upper['lu'])}, between the two "
        f"largest {exponent(last['lu'])}"
    )
    passed = found["crossover"]
    yield (
        "the node algorithm is faster than direct elimination from so many arms on: "
        f"1995 {_arms(passed['thesis'])}, NumPy loop {_arms(passed['interpreted'])}, NumPy over "
        f"all arms at once {_arms(passed['interpreted, at once'])}, compiled "
        f"{_arms(passed['compiled'])}"
    )
    worst = max(max(row["deviation"].values()) for row in found["rows"])
    solvers = "; ".join(found["rows"][0]["deviation"])
    yield (
        f"deviation: largest of the accelerations by {solvers} from those by LU, {worst:.0e} at "
        "the most"
    )


def _shares(found: dict[str, Any]) -> Iterator[Table]:
    rows, kind = found["rows"], found["kind"]
    heads = [""]
    for row in rows:
        heads += [f"n={row['arms']}", "%"]
    wholes = [row["evaluation_microseconds"] for row in rows]
    title = f"Where an evaluation goes ({kind} joints), in microseconds"
    yield _table("shares", title, heads, _parts([row["evaluation"] for row in rows], wholes))
    wholes = [row["step_cost"]["microseconds"] for row in rows]
    name = rows[0]["step_cost"]["integrator"]
    title = f"Where a step of {name} goes ({kind} joints), in microseconds"
    yield _table("shares", title, heads, _parts([row["step"] for row in rows], wholes))
    lines = [
        (
            cost["integrator"], str(cost["steps"]), f"{cost['evaluations']:.1f}",
            micro(cost["microseconds"]), micro(cost["evaluation_microseconds"]),
            _overhead(cost["overhead"]),
        )
        for cost in found["overheads"]
    ]  # fmt: skip
    note = (
        f"with projection, {found['duration_s']:g} s at a tolerance of {found['tolerance']:g}, or "
        f"{found['fixed_steps']} steps of {found['fixed_step_s']:g} s; a projection counts as two "
        "evaluations; between, rest: what the parts, each measured by itself, leave of the whole"
    )
    heads = ["integrator", "steps", "evaluations\na step", "us\na step", "us an\nevaluation",
             "overhead"]  # fmt: skip
    title = f"Cost of a step besides its evaluations, n = {found['overheads'][0]['arms']}"
    yield _table("shares", title, heads, lines, [note])


def _parts(
    parts: Sequence[dict[str, float]], wholes: Sequence[float]
) -> Iterator[tuple[str | Cell, ...]]:
    for name in parts[0]:
        cells: list[str] = [name]
        for part, whole in zip(parts, wholes, strict=True):
            cells += [micro(part[name]), f"{100 * part[name] / whole:.0f}"]
        yield tuple(cells)
    sums: list[str] = []
    for whole in wholes:
        sums += [micro(whole), "100"]
    yield Cell("whole", "strong"), *sums


def _overhead(value: float) -> Cell:
    return Cell(f"{100 * value:+.0f} %", "good" if value < TARGET else "bad")


def _table(study: str, title: str, heads, rows, notes=()) -> Table:
    cells = (tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in row) for row in rows)
    return Table(study, title, tuple(heads), tuple(cells), tuple(notes))


def micro(value: float | None) -> str:
    """Microseconds, three digits."""
    return NOTHING if value is None else plain(value, whole_from=99.95)


def plain(value: float, whole_from: float = 999.5) -> str:
    """A number in three or four digits; from some size on without decimals."""
    size = abs(value)
    return f"{value:.{2 if size < 9.995 else 1 if size < whole_from else 0}f}"


def exponent(value: float | None) -> str:
    """A fitted exponent with two decimals."""
    return NOTHING if value is None else f"{value:.2f}"


def _arms(value: float | None) -> str:
    return "never here" if value is None else f"{value:.3g}"
