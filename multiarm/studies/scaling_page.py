"""The scaling study as tables, as figures and as one self-contained HTML page."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from multiarm.plots.style import BLUE, GREEN, INK, ORANGE, PINK, STYLE, inline_svg
from multiarm.reports import pages
from multiarm.studies.tables import TEXT, Cell, Column, Table
from multiarm.studies.time_shares import TARGET

DISTURBED = 0.05
"""Share of the time spent waiting above which something is said."""
_METHOD_ROWS = {
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


def texts(result: dict[str, Any]) -> Iterator[Table]:
    """What the command prints."""
    return itertools.chain.from_iterable(tables(result).values())


def figures(result: dict[str, Any]) -> dict[str, Any]:
    """All figures: the result itself."""
    return result


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
        for method, title in _METHOD_ROWS.items():
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


# --- figures and page -----------------------------------------------------------------------------


Drawing = Callable[[Axes], None]
GREY = "#8a94a0"
# method: name, colour, dashes
_METHODS = {
    "multiarm": ("multiarm", BLUE, ()),
    "compiled": ("compiled arms", PINK, ()),
    "terms": ("Pinocchio's arm terms", BLUE, (2, 1.5)),
    "lcaba": ("lcaba", GREEN, ()),
    "constraintDynamics": ("constraintDynamics", ORANGE, ()),
    "tree": ("the same, object on one arm", ORANGE, (2, 1.5)),
    "dense": ("dense KKT, NumPy", GREY, ()),
}
# picture and part of the study of section 4.4: name, colour, dashes
_SOLVERS = {
    ("compiled", "node"): ("node, compiled", BLUE, ()),
    ("interpreted", "node"): ("node, NumPy loop", BLUE, (4, 2)),
    ("interpreted", "node at once"): ("node, NumPy at once", BLUE, (1, 1.5)),
    ("compiled", "lu"): ("direct, LU", ORANGE, ()),
}
_PARTS = {
    "arm terms": BLUE, "contacts": "#6aa5ea", "forces": "#a9c9f2", "node": GREEN,
    "state": "#8fd0af", "between": "#cfd6dd", "stabilisation": ORANGE, "recording": "#ecb679",
    "arithmetic": PINK, "rest": GREY,
}  # fmt: skip
_DOTS: dict[str, Any] = {"marker": "o", "ms": 3}  # what was measured here
_RINGS: dict[str, Any] = {"ms": 4, "mfc": "none", "mew": 1.1}  # what the thesis gives
_PANEL = (5.0, 3.9)  # [in]
_LEGEND_ROW = 0.058  # height of a row of the legend, as a part of the axes


def figure(result: dict[str, Any]) -> Figure:
    """All studies of a result that have a figure, in one."""
    draws = [draw for own in _panels(result).values() for draw in own]
    columns = min(2, max(1, len(draws)))
    return _figure(draws or [_draw_nothing], columns, *_PANEL)


def _figure(draws: Sequence[Drawing], columns: int, width: float, height: float) -> Figure:
    """Panels of some width and height [in] in columns."""
    rows = -(-len(draws) // columns)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, draw in zip(grid, draws, strict=False):
            draw(axes)
        for axes in grid[len(draws) :]:
            axes.set_axis_off()
    return figure


def _draw_nothing(axes: Axes) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, "nothing here has a figure", ha="center")


def _panels(result: dict[str, Any]) -> dict[str, list[Drawing]]:
    """Study -> functions that draw its panels, of the studies that have a figure."""
    draws: dict[str, list[Drawing]] = {}
    if "evaluations" in result:
        found = result["evaluations"]
        draws["evaluations"] = [
            partial(_draw_evaluations, found=found, kind=kind) for kind in found["exponents"]
        ]
    if "thesis" in result:
        drawers = (_draw_solvers, _draw_speedups)
        draws["thesis"] = [partial(draw, found=result["thesis"]) for draw in drawers]
    if "shares" in result:
        draws["shares"] = [partial(_draw_shares, found=result["shares"])]
    return draws


def _draw_evaluations(axes: Axes, found: dict[str, Any], kind: str) -> None:
    rows = [row for row in found["rows"] if row["kind"] == kind]
    for method, (name, colour, dashes) in _METHODS.items():
        costs = {row["arms"]: row["microseconds"][method] for row in rows}
        known = {arms: cost for arms, cost in costs.items() if cost is not None}
        label = f"{name}{_power(found['exponents'][kind][method])}"
        width = 1.2 if dashes or method == "dense" else 1.8
        axes.plot(*_xy(known), label=label, color=colour, dashes=dashes, lw=width, **_DOTS)
    _finish(axes, [row["arms"] for row in rows], f"One evaluation, {kind} joints", "microseconds")


def _draw_solvers(axes: Axes, found: dict[str, Any]) -> None:
    for (picture, part), (name, colour, dashes) in _SOLVERS.items():
        slope = found["upper_slopes" if part == "lu" else "slopes"][picture][part]
        costs = {row["arms"]: row["microseconds"][picture][part] for row in found["rows"]}
        label = f"{name}{_power(slope)}"
        axes.plot(*_xy(costs), label=label, color=colour, dashes=dashes, lw=1.6, **_DOTS)
    for key, name, colour in (("t1", "node", BLUE), ("t2", "direct", ORANGE)):
        then = {int(n): 1e3 * values[key] for n, values in found["thesis"].items()}
        axes.plot(*_xy(then), "o", label=f"{name}, Matlab 1995", color=colour, **_RINGS)
    arms = [row["arms"] for row in found["rows"]]
    _finish(axes, arms, "Section 4.4: solving for the accelerations", "microseconds", columns=2)


def _draw_speedups(axes: Axes, found: dict[str, Any]) -> None:
    shown = (("solving", (), "o", "$t_2/t_1$"), ("total", (2, 1.5), "s", "total"))
    for picture, name, colour in (("compiled", "compiled", BLUE), ("interpreted", "NumPy", GREEN)):
        for key, dashes, _, what in shown:
            times = {row["arms"]: row["columns"][picture][key] for row in found["rows"]}
            label = f"{what}, {name}"
            axes.plot(*_xy(times), label=label, color=colour, dashes=dashes, lw=1.6, **_DOTS)
    for key, _, marker, what in shown:
        then = {int(n): values[key] for n, values in found["thesis"].items()}
        axes.plot(*_xy(then), marker, label=f"{what}, 1995", color=PINK, **_RINGS)
    axes.axhline(1.0, color=INK, linewidth=0.8)
    arms = [row["arms"] for row in found["rows"]]
    _finish(axes, arms, "Section 4.4: speed-up by the node algorithm", "times")


def _draw_shares(axes: Axes, found: dict[str, Any]) -> None:
    """Stacked bars in percent; what is left negative by the error of measurement is not drawn."""
    names, shares = [], []
    for what in ("evaluation", "step"):
        for row in found["rows"]:
            names.append(f"{what}, n = {row['arms']}")
            shares.append([max(row[what].get(part, 0.0), 0.0) for part in _PARTS])
    places = np.arange(len(names))[::-1].astype(float)
    places[: len(found["rows"])] += 0.4  # evaluations apart from steps
    percent = 100.0 * np.array(shares) / np.sum(shares, axis=1, keepdims=True)
    left = np.cumsum(percent, axis=1) - percent
    for part, (name, colour) in enumerate(_PARTS.items()):
        widths = percent[:, part]
        bars = axes.barh(places, widths, left=left[:, part], color=colour, height=0.72, label=name)
        ink = "white" if colour in (BLUE, GREEN, ORANGE, PINK, GREY) else "black"
        labels = [f"{width:.0f}" if width >= 7 else "" for width in widths]
        axes.bar_label(bars, labels, label_type="center", color=ink, fontsize=8)
    axes.set_yticks(places, names)
    axes.set_xlim(0, 100)
    axes.set_xlabel("percent")
    axes.grid(False)
    axes.set_title(f"Where the time goes ({found['kind']} joints)")
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=5, fontsize=7.5, frameon=False,
        handlelength=1.0, columnspacing=1.0,
    )  # fmt: skip


def _xy(values: dict[int, float]) -> tuple[list[int], list[float]]:
    """Numbers of arms, and the values there."""
    return list(values), list(values.values())


def _power(slope: float | None) -> str:
    return "" if slope is None else f"  $n^{{{slope:.2f}}}$"


def _finish(axes: Axes, arms: Sequence[int], title: str, unit: str, columns: int = 1) -> None:
    """Logarithmic axes, a tick for as many numbers of arms as have room, and the legend on top."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    shown: list[int] = []
    for n in reversed(arms):
        if not shown or shown[-1] >= 1.24 * n:
            shown.append(n)
    axes.set_xticks(shown, [str(n) for n in shown])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_xlabel("number of arms")
    axes.set_ylabel(unit)
    axes.set_title(title)
    legend = axes.legend(
        loc="upper left", fontsize=7.8, frameon=False, ncols=columns, handlelength=2.4,
        columnspacing=1.2, labelspacing=0.3,
    )  # fmt: skip
    room = 1.0 - _LEGEND_ROW * -(-len(legend.get_texts()) // columns)
    low, high = axes.get_ylim()
    axes.set_ylim(low, low * (high / low) ** (1.0 / room))


def render(result: dict[str, Any]) -> str:
    """The page as text."""
    return pages.render(
        "scaling.html",
        result=result,
        headlines=list(_headlines(result)),
        studies=tables(result),
        figures={
            study: inline_svg(_figure(draws, len(draws), 9.6 / len(draws), 3.9), f"{study}-")
            for study, draws in _panels(result).items()
        },
        disturbance=disturbance(result),
    )


def _headlines(result: dict[str, Any]) -> Iterable[tuple[str, str, str]]:
    """Name, value and remark of what matters most."""
    if "evaluations" in result:
        found = result["evaluations"]
        kind, row = next(iter(found["exponents"])), found["rows"][0]
        cost = f"{micro(row['microseconds']['multiarm'])} µs"
        yield f"One evaluation, {kind}", cost, f"{row['arms']} arms"
        grows = exponent(found["upper_exponents"][kind]["multiarm"])
        yield "Grows with the arms by", f"n^{grows}", "over the larger half"
    if "thesis" in result:
        last = result["thesis"]["rows"][-1]
        ratio = last["columns"]["compiled"]["solving"]
        yield "Node against direct", f"{ratio:.3g} times", f"faster at {last['arms']} arms"
    if "shares" in result:
        costs = result["shares"]["overheads"]
        most = max(costs, key=lambda cost: cost["overhead"])
        yield (
            "Most a step adds",
            f"{100 * most['overhead']:.0f} %",
            f"to its evaluations, {most['integrator']}, {most['arms']} arms",
        )
