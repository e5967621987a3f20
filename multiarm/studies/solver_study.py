"""Section 4.4 of the thesis repeated: node algorithm against direct elimination.

Arms of 6 joints, one contact each, an object; ``t`` is the time to build the coefficients of (4.9),
``t1`` that of the node algorithm and ``t2`` that of direct elimination, on identical coefficients.
The thesis measured Matlab programs; here the same is measured twice.

*interpreted*: coefficients by Pinocchio's Python functions and NumPy, the node algorithm as a plain
NumPy loop (and over all arms at once), direct elimination by LAPACK, which is compiled, as Matlab's
was.  *compiled*: coefficients and node algorithm as the time loop performs them.

Direct elimination is given its best form: LAPACK's LU on one thread, without the assembly of the
matrix, which is timed on its own; beside it the symmetric factorisation.  The time of the node
algorithm includes loading its inertias and constraint matrices.  Medians over bursts count.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from multiarm.assembly.compilation import compile_system
from multiarm.problems import ring_of_arms
from multiarm.scene import Scene
from multiarm.studies import operation_counts, solver_forms
from multiarm.studies.bursts import (
    Burst,
    fitted_slope,
    measure,
    median,
    one_thread,
    python_burst,
    upper_half,
)
from multiarm.studies.evaluation_costs import moving_state
from multiarm.studies.solver_forms import Coefficients, Solution
from multiarm.studies.solver_loops import CompiledNode, assembly_burst, build_burst

ARMS = (2, 3, 4, 5, 6, 7, 8, 9, 10, 20, 50, 100)
BURSTS_PER_ROUND = 12
COMPILED = ("build", "node", "assembly", "lu", "ldl")
INTERPRETED = ("build", "node", "node at once", "assembly", "lu")
# number of arms: (t2 + t) / (t1 + t), t2 / t1, t2 - t1 [ms]
_THESIS = {
    2: (0.98, 0.71, -6.5),
    3: (0.99, 0.77, -7.2),
    4: (0.99, 0.88, -4.9),
    5: (1.00, 1.03, 1.3),
    6: (1.01, 1.22, 12.3),
    7: (1.02, 1.41, 27.1),
    8: (1.03, 1.64, 47.7),
    9: (1.05, 1.88, 73.7),
    10: (1.06, 2.13, 104.6),
}


class Columns(NamedTuple):
    """The columns of the thesis's table, and what they imply; times in one unit.

    total : float
        Total speed-up ``(t2 + t) / (t1 + t)``.
    solving : float
        Speed-up in solving ``t2 / t1``.
    saved : float
        ``t2 - t1``.
    t1, t2 : float
    """

    total: float
    solving: float
    saved: float
    t1: float
    t2: float


def columns(t: float, t1: float, t2: float) -> Columns:
    """The columns of measured times."""
    return Columns((t2 + t) / (t1 + t), t2 / t1, t2 - t1, t1, t2)


def thesis_columns() -> dict[int, Columns]:
    """The table of section 4.4 by number of arms [ms]; ``t1`` and ``t2`` follow from it.

    ``t1 = saved / (solving - 1)``; both figures are rounded, near 5 arms to few digits.
    """
    return {
        arms: Columns(total, ratio, saved, saved / (ratio - 1.0), ratio * saved / (ratio - 1.0))
        for arms, (total, ratio, saved) in _THESIS.items()
    }


def study_scene(arms: int) -> Scene:
    """The ring of UR5 arms, each touching a face of the disc with its tip; no torques."""
    ring = ring_of_arms(arms, "ball")
    joints = [{"arm": name, "kind": "point_on_plane"} for name in ring.arms]
    return ring.replace(name=f"{arms} arms with one contact each", joints=joints,
                        control={"kind": "none"})  # fmt: skip


def solver_study(
    arms: Sequence[int] = ARMS,
    rounds: int = 7,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Measure section 4.4.

    Returns
    -------
    dict
        ``rows``: a list with, for every number of arms, ``arms``; ``microseconds`` (``compiled``
        and ``interpreted`` -> part -> median); ``columns`` (the same two -> the thesis's columns,
        in microseconds); ``operations`` (``node``, ``direct``, their ``ratio``, and
        ``ratio_as_written`` of the thesis's equations); ``deviation`` (solver -> largest relative
        deviation of the accelerations from direct elimination's).
        ``thesis``: number of arms -> its columns [ms].
        ``slopes``, ``upper_slopes``, ``last_slopes``: ``compiled`` and ``interpreted`` -> part ->
        exponent of its cost in the number of arms, over all numbers, the larger half of them, and
        the largest two.
        ``crossover``: of the two, of NumPy's stacked operations and of the ``thesis``: from how
        many arms on the node algorithm is faster (None: not within the range), see
        :func:`crossover`.
    """
    rows = []
    with one_thread():
        for count in arms:
            if progress is not None:
                progress(f"section 4.4: {count} arms")
            rows.append(_measure(count, rounds))
    thesis = thesis_columns()
    pictures = {"compiled": COMPILED, "interpreted": INTERPRETED}
    ratios = {
        picture: [(row["arms"], row["columns"][picture]["solving"]) for row in rows]
        for picture in pictures
    }
    stacked = [row["microseconds"]["interpreted"] for row in rows]
    ratios["interpreted, at once"] = [
        (row["arms"], part["lu"] / part["node at once"])
        for row, part in zip(rows, stacked, strict=True)
    ]
    ratios["thesis"] = [(n, thesis[n].solving) for n in thesis]
    ranges = {
        "slopes": slice(None),
        "upper_slopes": upper_half(rows),
        "last_slopes": slice(-2, None),
    }
    return {
        "rows": rows,
        "thesis": {str(n): found._asdict() for n, found in thesis.items()},
        **{
            key: {name: _slopes(rows[part], name, parts) for name, parts in pictures.items()}
            for key, part in ranges.items()
        },
        "crossover": {name: crossover(found) for name, found in ratios.items()},
    }


def crossover(ratios: Sequence[tuple[int, float]]) -> float | None:
    """Number of arms at which ``t2 / t1`` passes 1 for good, between neighbours interpolated.

    Returns the smallest number when the ratio is never below 1, None when it is below at the end.
    """
    below = [k for k, (_, ratio) in enumerate(ratios) if ratio < 1.0]
    if not below:
        return float(ratios[0][0])
    if below[-1] == len(ratios) - 1:
        return None
    (n0, r0), (n1, r1) = ratios[below[-1]], ratios[below[-1] + 1]
    share = -math.log(r0) / (math.log(r1) - math.log(r0))
    return float(n0 * (n1 / n0) ** share)


def solve_in_all_ways(s: Coefficients) -> dict[str, Solution]:
    """Every solver of the study on one set of coefficients."""
    matrix, right = solver_forms.assemble(s)
    return {
        "LU": solver_forms.unpack(solver_forms.solve_lu(matrix, right), s),
        "LDL^T": solver_forms.unpack(solver_forms.solve_ldl(matrix, right), s),
        "node, compiled": CompiledNode(s).solve(),
        "node, loop": solver_forms.node_loop(s),
        "node, at once": solver_forms.node_at_once(s),
        "Lilly-Orin": solver_forms.lilly_orin(s),
        "McMillan": solver_forms.mcmillan(s),
    }


def deviations(s: Coefficients) -> dict[str, float]:
    """Largest deviation of every solver's accelerations from those by LU, relative."""
    found = {
        name: np.concatenate([solution.q_o, solution.q.ravel()])
        for name, solution in solve_in_all_ways(s).items()
    }
    exact = found.pop("LU")
    scale = np.max(np.abs(exact))
    return {name: float(np.max(np.abs(x - exact)) / scale) for name, x in found.items()}


def _measure(count: int, rounds: int) -> dict[str, Any]:
    system = compile_system(study_scene(count))
    state = moving_state(system, seed=count)
    s = solver_forms.build(system, state)
    matrix, right = solver_forms.assemble(s)
    data = system.model.data()
    data.set_state(0.0, state)
    bursts: dict[str, Burst] = {
        "compiled build": build_burst(data),
        "compiled node": CompiledNode(s).burst,
        "compiled assembly": assembly_burst(s),
        "compiled ldl": python_burst(lambda: solver_forms.solve_ldl(matrix, right)),
        "lu": python_burst(lambda: solver_forms.solve_lu(matrix, right)),
        "interpreted build": python_burst(lambda: solver_forms.build(system, state)),
        "interpreted node": python_burst(lambda: solver_forms.node_loop(s)),
        "interpreted node at once": python_burst(lambda: solver_forms.node_at_once(s)),
        "interpreted assembly": python_burst(lambda: solver_forms.assemble(s)),
    }
    cost = median(measure(bursts, rounds * BURSTS_PER_ROUND))
    cost["compiled lu"] = cost["interpreted lu"] = cost.pop("lu")
    times = {
        picture: {part: cost[f"{picture} {part}"] for part in parts}
        for picture, parts in (("compiled", COMPILED), ("interpreted", INTERPRETED))
    }
    node, direct = (
        operation_counts.node_operations(count),
        operation_counts.direct_operations(count),
    )
    return {
        "arms": count,
        "microseconds": times,
        "columns": {
            picture: columns(part["build"], part["node"], part["lu"])._asdict()
            for picture, part in times.items()
        },
        "operations": {
            "node": node,
            "direct": direct,
            "ratio": direct / node,
            "ratio_as_written": operation_counts.ratio_as_written(count),
        },
        "deviation": deviations(s),
    }


def _slopes(
    rows: Sequence[dict[str, Any]], picture: str, parts: Sequence[str]
) -> dict[str, float | None]:
    arms = [row["arms"] for row in rows]
    return {
        part: fitted_slope(arms, [row["microseconds"][picture][part] for row in rows])
        for part in parts
    }
