"""The tables of the scaling study."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from multiarm.studies.tables import TEXT, Cell, Column, Table
from multiarm.studies.time_shares import TARGET

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


def tables(result: dict[str, Any]) -> dict[str, list[Table]]:
    """Study -> its tables, of :func:`multiarm.studies.scaling.run_scaling`'s result."""
    makers: dict[str, Callable[[Any], Iterator[Table]]] = {
        "evaluations": _evaluations,
        "thesis": _thesis,
        "shares": _shares,
        "contact_rows": _contact_rows,
    }
    return {study: list(make(result[study])) for study, make in makers.items() if study in result}


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
        lines: list[tuple[Any, ...]] = []
        for method, title in _METHODS.items():
            known = [row["relative_error"].get(method) for row in rows]
            errors = [error for error in known if error is not None]
            lines.append(
                (
                    Cell(title, "strong" if method in ("multiarm", "compiled") else ""),
                    *(row["microseconds"][method] for row in rows),
                    exponents[method],
                    found["upper_exponents"][kind][method],
                    max(errors) if errors else "",
                )
            )
        for method, title in (("multiarm", "best peer / ours"), ("compiled", "  compiled arms")):
            ratios = (row["ratio_to_best_peer"][method] for row in rows)
            lines.append((Cell(title, "good"), *map(exponent, ratios), "", "", ""))
        yield Table(
            f"One evaluation, {kind} joints, in microseconds",
            (
                Column("", TEXT),
                *_numbers(micro, *(f"n={row['arms']}" for row in rows)),
                *_numbers(exponent, "slope", "upper\nhalf"),
                *_numbers("{:.0e}".format, "error"),
            ),
            tuple(lines),
            tuple(_evaluation_notes(rows, found["growth"][kind])),
        )


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
        n = str(row["arms"])
        then = found["thesis"].get(n, {})
        sources = (then, *(row["columns"][picture] for picture in pictures))
        speedups.append((n, *(s.get(k) for k in ("total", "solving", "saved") for s in sources)))
        scripted, ours = (row["microseconds"][picture] for picture in pictures)
        parts = [scripted["build"], scripted["node"]]
        parts += [ours[part] for part in ("build", "node", "lu", "ldl", "assembly")]
        costs.append((n, then.get("t1"), then.get("t2"), *parts))
        count = row["operations"]
        sizes = (count[key] for key in ("node", "direct", "ratio", "ratio_as_written"))
        counts.append((n, *sizes, max(row["deviation"].values())))
    arms = Column("n", TEXT)
    names, times = ("total", "t2/t1", "t2-t1"), ("1995", "NumPy", "ours")
    yield Table(
        "Section 4.4: speed-up in total and in solving, time saved (1995 [ms], now [us])",
        (arms, *_numbers(plain, *(f"{name}\n{when}" for name in names for when in times))),
        tuple(speedups),
    )
    heads = ("NumPy\nt", "NumPy\nt1", "ours\nt", "ours\nt1", "LU\nt2", "LDL^T\nt2",
             "matrix\nfilled")  # fmt: skip
    yield Table(
        "Section 4.4: times of 1995 [ms] and now [us]",
        (arms, *_numbers(plain, "1995\nt1", "1995\nt2"), *_numbers(micro, *heads)),
        tuple(costs),
    )
    yield Table(
        "Section 4.4: floating point operations, and how far the solvers agree",
        (
            arms,
            *_numbers("{:,}".format, "node", "direct"),
            *_numbers(plain, "ratio", "ratio\nas written"),
            *_numbers("{:.0e}".format, "deviation"),
        ),
        tuple(counts),
        tuple(_thesis_notes(found)),
    )


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
    heads = [f"n={row['arms']}" for row in rows]
    steps = [row["step_cost"] for row in rows]
    for title, parts, wholes in (
        ("an evaluation", "evaluation", [row["evaluation_microseconds"] for row in rows]),
        (f"a step of {steps[0]['integrator']}", "step", [step["microseconds"] for step in steps]),
    ):
        yield Table(
            f"Where {title} goes ({kind} joints), in microseconds",
            (Column("", TEXT), *(c for head in heads for c in _numbers(micro, head, "%"))),
            tuple(_parts([row[parts] for row in rows], wholes)),
        )
    yield Table(
        f"Cost of a step besides its evaluations, n = {found['overheads'][0]['arms']}",
        (
            Column("integrator", TEXT),
            Column("steps"),
            *_numbers("{:.1f}".format, "evaluations\na step"),
            *_numbers(micro, "us\na step", "us an\nevaluation"),
            *_numbers(lambda share: f"{100 * share:+.0f} %", "overhead"),
        ),
        tuple(
            (
                *(cost[key] for key in ("integrator", "steps", "evaluations", "microseconds")),
                cost["evaluation_microseconds"],
                Cell(cost["overhead"], "good" if cost["overhead"] < TARGET else "bad"),
            )
            for cost in found["overheads"]
        ),
        (
            f"with projection, {found['duration_s']:g} s at a tolerance of "
            f"{found['tolerance']:g}, or {found['fixed_steps']} steps of "
            f"{found['fixed_step_s']:g} s; a projection counts as two evaluations; between, rest: "
            "what the parts, each measured by itself, leave of the whole",
        ),
    )


def _parts(
    parts: Sequence[dict[str, float]], wholes: Sequence[float]
) -> Iterator[tuple[str | Cell | float, ...]]:
    """Microseconds and percent of each part at each number of arms, and those of the whole."""

    def values(costs: Sequence[float]) -> Iterator[float | str]:
        for cost, whole in zip(costs, wholes, strict=True):
            yield from (cost, f"{100 * cost / whole:.0f}")

    for name in parts[0]:
        yield (name, *values([part[name] for part in parts]))
    yield (Cell("whole", "strong"), *values(wholes))


def _contact_rows(costs: dict[str, float]) -> Iterator[Table]:
    columns = (Column("row", TEXT), Column("cost", write="{:.3f}".format))
    yield Table("One row of W, in microseconds", columns, tuple(costs.items()))


def _numbers(write: Callable[[Any], str], *heads: str) -> list[Column]:
    """Columns of numbers that are written alike."""
    return [Column(head, write=write) for head in heads]


def micro(value: float) -> str:
    """Microseconds, three digits."""
    return plain(value, whole_from=99.95)


def plain(value: float, whole_from: float = 999.5) -> str:
    """A number in three or four digits; from some size on without decimals."""
    size = abs(value)
    return f"{value:.{2 if size < 9.995 else 1 if size < whole_from else 0}f}"


def exponent(value: float | None) -> str:
    """An exponent or a ratio with two decimals."""
    return "-" if value is None else f"{value:.2f}"


def _arms(value: float | None) -> str:
    return "never here" if value is None else f"{value:.3g}"
