r"""Section 4.4 of the thesis repeated: node algorithm against direct elimination.

    python benchmarks/efficiency.py [--arms 2,4,6] [--rounds N] [--json FILE]

Arms of 6 joints, one contact each, an object; ``t`` is the time to build the coefficients of (4.9),
``t1`` that of the node algorithm and ``t2`` that of direct elimination, on identical coefficients.
The thesis measured Matlab programs; here the same is measured twice.

*interpreted*: coefficients by Pinocchio's Python functions and NumPy, the node algorithm as a plain
NumPy loop (and over all arms at once), direct elimination by LAPACK, which is compiled, as Matlab's
was.  *compiled*: coefficients and node algorithm as the time loop performs them.

Direct elimination has its best form: LAPACK's LU on one thread, without the assembly of the matrix,
which is timed separately; the symmetric factorisation is measured too.  The time of the node
algorithm includes loading its inertias and constraint matrices.  Figures are medians over bursts.

Operation counts: every addition, subtraction, multiplication, division and square root counts as
one.  For ``n`` arms of ``d`` joints and ``N`` contacts each, direct elimination of the matrix of
order :math:`k = 6 + n (d + N)` takes :math:`\tfrac23 k^3 + O(k^2)`, cubic in the arms.  The node
algorithm takes, an arm,

.. math::
    \underbrace{\tfrac13 d^3}_{M_i} + \underbrace{2 d^2 (N + 1)}_{M_i^{-1}[W_i, f_i]} +
    \underbrace{2 d N (N + 1)}_{K_i,\, r_i} + \underbrace{\tfrac13 N^3 + 14 N^2}_{K_i^{-1}[W_{oi}^T,
    r_i]} + \underbrace{84 N}_{A,\, b} + \underbrace{12 N}_{\mu_i} +
    \underbrace{2 d N + 2 d^2}_{a_i}

to leading orders when the equations (4.10) - (4.12) of the thesis are carried out as written, and
:math:`\tfrac13 6^3 + 2 \cdot 6^2` for the object: linear.  The actual number of
:mod:`multiarm.dynamics.solver.batched` is smaller, since it uses triangular factors and symmetric
halves twice; :func:`node_operations` counts it exactly, without padding of arms to SIMD packs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import output
import pandas
from evaluations import moving_state
from matplotlib.figure import Figure
from solver_forms import (
    Coefficients,
    Solution,
    assemble,
    build,
    lilly_orin,
    mcmillan,
    node_loop,
    solve_ldl,
    solve_lu,
    unpack,
)
from timing import (
    Burst,
    call_burst,
    fitted_slopes,
    measure,
    median,
    one_thread,
    python_burst,
    upper_half,
)

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.solver.batched import solve_batched
from multiarm.dynamics.solver.node import make_work
from multiarm.dynamics.status import OK
from multiarm.errors import SolverError
from multiarm.jit.kernels import kernel
from multiarm.plots.style import BLUE, GREEN, INK, ORANGE, PINK
from multiarm.problems import ring_of_arms
from multiarm.scene import Scene

ARMS = (2, 3, 4, 5, 6, 7, 8, 9, 10, 20, 50, 100)
BURSTS_PER_ROUND = 12
PICTURES = {
    "compiled": ("build", "node", "assembly", "lu", "ldl"),
    "interpreted": ("build", "node", "node at once", "assembly", "lu"),
}
"""The two ways in which everything is measured, and the parts of each."""
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


def main(words: Sequence[str] | None = None) -> None:
    """Measure, and write the table, the figure and the numbers."""
    parser = output.options(__doc__, "efficiency")
    parser.add_argument("--arms", type=output.counts, default=ARMS, metavar="N,N,...",
                        help="numbers of arms (default 2 to 10, 20, 50, 100)")  # fmt: skip
    arguments = parser.parse_args(words)
    with output.Clock() as clock:
        study = solver_study(arguments.arms, arguments.rounds)
    output.save(arguments, clock, "thesis", study, table(study), figure)
    passed, slopes = study["crossover"], study["upper_slopes"]["compiled"]
    print("node algorithm faster from so many arms on:",
          ", ".join(f"{name} {arms:.3g}" if arms else f"{name} never here"
                    for name, arms in passed.items()))  # fmt: skip
    print("exponents over the larger half:",
          ", ".join(f"{name} {slope:.2f}" for name, slope in slopes.items() if slope))  # fmt: skip


def table(study: dict[str, Any]) -> pandas.DataFrame:
    """A row for each number of arms: ratios in 1995 and now, times [us], operations, deviation."""
    rows = []
    for row in study["rows"]:
        cost, count = row["microseconds"], row["operations"]
        in_1995 = study["thesis"].get(str(row["arms"]), {})
        rows.append(
            {"arms": row["arms"]}
            | {f"{key}_1995": in_1995.get(key) for key in ("solving", "total")}
            | {f"{key}_{picture}": row["columns"][picture][key]
               for picture in PICTURES for key in ("solving", "total")}
            | {f"{part.replace(' ', '_')}_{picture}_us": microseconds
               for picture in PICTURES for part, microseconds in cost[picture].items()}
            | {"node_operations": count["node"], "direct_operations": count["direct"],
               "deviation": max(row["deviation"].values())}
        )  # fmt: skip
    return pandas.DataFrame(rows)


def figure(rows: pandas.DataFrame) -> Figure:
    """Times of both algorithms, and the speed-up then and now."""
    drawing, (times, ratios) = output.panels(2)
    for column, name, colour, dashes in (
        ("node_compiled_us", "node, compiled", BLUE, "-"),
        ("node_interpreted_us", "node, NumPy loop", BLUE, "--"),
        ("node_at_once_interpreted_us", "node, NumPy, all arms at once", BLUE, ":"),
        ("lu_compiled_us", "direct, LU", ORANGE, "-"),
    ):
        times.plot(rows["arms"], rows[column], dashes, color=colour, marker="o", ms=3, label=name)
    for suffix, name, colour in (("compiled", "compiled", BLUE), ("interpreted", "NumPy", GREEN)):
        for key, dashes, what in (("solving", "-", "$t_2/t_1$"), ("total", "--", "total")):
            ratios.plot(rows["arms"], rows[f"{key}_{suffix}"], dashes, color=colour, marker="o",
                        ms=3, label=f"{what}, {name}")  # fmt: skip
    for key, marker, what in (("solving", "o", "$t_2/t_1$"), ("total", "s", "total")):
        ratios.plot(rows["arms"], rows[f"{key}_1995"], marker, color=PINK, mfc="none", ms=4,
                    label=f"{what}, 1995 (Matlab)")  # fmt: skip
    ratios.axhline(1.0, color=INK, linewidth=0.8)
    arms = list(rows["arms"])
    output.over_arms(times, arms, "Section 4.4: solving for the accelerations", "microseconds")
    output.over_arms(ratios, arms, "Section 4.4: speed-up by the node algorithm", "times")
    return drawing


def columns(t: float, t1: float, t2: float) -> dict[str, float]:
    """The columns of the thesis's table and what they imply, in the unit of the times.

    ``total`` speed-up ``(t2 + t) / (t1 + t)``, ``solving`` speed-up ``t2 / t1``, time ``saved``
    ``t2 - t1``, and the times of the node algorithm ``t1`` and of direct elimination ``t2``.
    """
    return {
        "total": (t2 + t) / (t1 + t), "solving": t2 / t1, "saved": t2 - t1, "t1": t1, "t2": t2,
    }  # fmt: skip


def thesis_columns() -> dict[int, dict[str, float]]:
    """The table of section 4.4 by number of arms [ms]; ``t1`` and ``t2`` follow from it.

    ``t1 = saved / (solving - 1)``; both figures are rounded, near 5 arms to few digits.
    """
    columns_of = {}
    for arms, (total, solving, saved) in _THESIS.items():
        t1 = saved / (solving - 1.0)
        columns_of[arms] = {
            "total": total, "solving": solving, "saved": saved, "t1": t1, "t2": solving * t1,
        }  # fmt: skip
    return columns_of


def study_scene(arms: int) -> Scene:
    """The ring of UR5 arms, each touching a face of the disc with its tip; no torques."""
    ring = ring_of_arms(arms, "ball")
    joints = [{"arm": name, "kind": "point_on_plane"} for name in ring.arms]
    return ring.replace(name=f"{arms} arms with one contact each", joints=joints,
                        control={"kind": "none"})  # fmt: skip


def solver_study(arms: Sequence[int] = ARMS, rounds: int = 7) -> dict[str, Any]:
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
            print(f"section 4.4: {count} arms", flush=True)
            rows.append(_measure(count, rounds))
    sizes = [row["arms"] for row in rows]
    costs = {picture: [row["microseconds"][picture] for row in rows] for picture in PICTURES}
    ranges = {
        "slopes": slice(None),
        "upper_slopes": upper_half(rows),
        "last_slopes": slice(-2, None),
    }
    thesis = thesis_columns()
    ratios = {"thesis": [(n, row["solving"]) for n, row in thesis.items()]}
    for name, picture, node in (
        ("compiled", "compiled", "node"),
        ("interpreted", "interpreted", "node"),
        ("interpreted, at once", "interpreted", "node at once"),
    ):
        measured = zip(sizes, costs[picture], strict=True)
        ratios[name] = [(n, cost["lu"] / cost[node]) for n, cost in measured]
    return {
        "rows": rows,
        "thesis": {str(n): row for n, row in thesis.items()},
        **{
            key: {name: fitted_slopes(sizes[part], cost[part]) for name, cost in costs.items()}
            for key, part in ranges.items()
        },
        "crossover": {name: crossover(series) for name, series in ratios.items()},
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
    matrix, right = assemble(s)
    return {
        "LU": unpack(solve_lu(matrix, right), s),
        "LDL^T": unpack(solve_ldl(matrix, right), s),
        "node, compiled": CompiledNode(s).solve(),
        "node, loop": node_loop(s),
        "node, at once": mcmillan(s, together=0),
        "Lilly-Orin": lilly_orin(s),
        "McMillan": mcmillan(s),
    }


def deviations(s: Coefficients) -> dict[str, float]:
    """Largest deviation of every solver's accelerations from those by LU, relative."""
    accelerations = {
        name: np.concatenate([solution.a_o, solution.q.ravel()])
        for name, solution in solve_in_all_ways(s).items()
    }
    exact = accelerations.pop("LU")
    scale = np.max(np.abs(exact))
    return {name: float(np.max(np.abs(x - exact)) / scale) for name, x in accelerations.items()}


def _measure(count: int, rounds: int) -> dict[str, Any]:
    system = compile_system(study_scene(count))
    state = moving_state(system, seed=count)
    s = build(system, state)
    matrix, right = assemble(s)
    data = system.model.data()
    data.set_state(0.0, state)
    parts = data.arrays.functions
    bursts: dict[str, Burst] = {
        # the coefficients of (4.9) at the state in the data, with ``W`` and all forces
        "compiled build": call_burst(data, parts.kinematics, parts.forces),
        "compiled node": CompiledNode(s).burst,
        "compiled assembly": assembly_burst(s),
        "compiled lu": python_burst(lambda: solve_lu(matrix, right)),
        "compiled ldl": python_burst(lambda: solve_ldl(matrix, right)),
        "interpreted build": python_burst(lambda: build(system, state)),
        "interpreted node": python_burst(lambda: node_loop(s)),
        "interpreted node at once": python_burst(lambda: mcmillan(s, together=0)),
        "interpreted assembly": python_burst(lambda: assemble(s)),
    }
    cost = median(measure(bursts, rounds * BURSTS_PER_ROUND))
    cost["interpreted lu"] = cost["compiled lu"]  # LAPACK's, in both pictures
    times = {
        picture: {name: cost[f"{picture} {name}"] for name in names}
        for picture, names in PICTURES.items()
    }
    node, direct = node_operations(count), direct_operations(count)
    return {
        "arms": count,
        "microseconds": times,
        "columns": {
            picture: columns(part["build"], part["node"], part["lu"])
            for picture, part in times.items()
        },
        "operations": {
            "node": node,
            "direct": direct,
            "ratio": direct / node,
            "ratio_as_written": ratio_as_written(count),
        },
        "deviation": deviations(s),
    }


def node_operations(arms: int, joints: int = 6, rows: int = 1) -> int:
    """Operations of elimination and solution, as the time loop performs them."""
    d, right = joints, joints + rows
    filling = 8 * rows
    # row i: factors and pivot, its inverse, what is right of it; the pivot's relative size
    elimination = sum(3 * i + 1 + 2 * i * (right - i) for i in range(right)) + rows
    elimination += joints + rows + 2  # the diagonal relative to the mobility
    elimination += sum(12 * (i - d) for i in range(d, right))  # the object's columns
    share = 6 * 2 * rows + 2 * 27 * rows
    backward = right * right + 12 * rows
    addition = 27 * (3 + 1)  # of the four sums of shares, and of the object's own
    node = 75 + 2 * 6 + 40 + 36  # below the diagonal, pivots, above it, backward
    return arms * (filling + elimination + share + backward) + addition + node


def direct_operations(arms: int, joints: int = 6, rows: int = 1) -> int:
    """Operations of Gaussian elimination of the whole matrix and of its two triangular solves."""
    k = order(arms, joints, rows)
    # column by column: k - 1 - j quotients, and twice its square in the rest of the matrix
    factor = k * (k - 1) // 2 + k * (k - 1) * (2 * k - 1) // 3
    return factor + k * (k - 1) + k * k


def order(arms: int, joints: int = 6, rows: int = 1) -> int:
    """Number of unknowns: object, joints and contact forces."""
    return 6 + arms * (joints + rows)


def ratio_as_written(arms: int, joints: int = 6, rows: int = 1) -> float:
    """Operations of direct elimination over those of (4.10) - (4.12) as written, leading orders."""
    k, d, m = order(arms, joints, rows), joints, rows
    direct = 2.0 / 3.0 * k**3 + 2.0 * k**2
    an_arm = (
        d**3 / 3 + 2 * d**2 * (m + 1) + 2 * d * m * (m + 1) + m**3 / 3 + 14 * m**2
        + 84 * m + 12 * m + 2 * d * m + 2 * d**2
    )  # fmt: skip
    return direct / (arms * an_arm + 6**3 / 3 + 2 * 6**2)


class CompiledNode:
    """The node algorithm of the time loop (``dynamics.solver.batched``) on coefficients."""

    def __init__(self, s: Coefficients) -> None:
        n, d, N = s.W.shape
        self._work = make_work([d] * n, [N] * n)
        self._matrices = tuple(
            np.ascontiguousarray(array)
            for array in (
                s.M, s.W, s.W_o.transpose(0, 2, 1).reshape(n * N, 6), s.M_o, s.f_o,
                s.f_j.ravel(), s.c.ravel(),
            )
        )  # fmt: skip
        self._solution = np.zeros(6), np.zeros(n * d), np.zeros(n * N)
        self._shape = n, d, N

    def burst(self, count: int) -> None:
        """Eliminate and solve that many times."""
        if _node_often(self._work, *self._matrices, *self._solution, count) != OK:
            raise SolverError("an arm of the study is singular; put it in a regular posture")

    def solve(self) -> Solution:
        """Accelerations and forces."""
        self.burst(1)
        n, d, N = self._shape
        a_o, q, force = (array.copy() for array in self._solution)
        return Solution(a_o, q.reshape(n, d), force.reshape(n, N))


def assembly_burst(s: Coefficients) -> Burst:
    """Filling the whole matrix and its right-hand side."""
    matrix, right = map(np.ascontiguousarray, assemble(s))  # the matrix is symmetric
    given = (s.M_o, s.f_o, s.M, s.f_j, s.W_o, s.W, s.c, matrix, right)
    return lambda count: _assemble_often(*given, count)


@kernel
def _node_often(work, M, W, W_o, M_o, f_o, f_j, c, a_o, q, force, count):
    """Load, eliminate, solve."""
    status = OK
    for _ in range(count):
        for i in range(M.shape[0]):
            for a in range(M.shape[1]):
                for b in range(a + 1):
                    work.M[i, a, b] = M[i, a, b]
                for b in range(W.shape[2]):
                    work.W[i, a, b] = W[i, a, b]
        status = solve_batched(work, W_o, M_o, f_o, f_j, c, a_o, q, force)
        if status != OK:
            return status
    return status


@kernel
def _assemble_often(M_o, f_o, M, f_j, W_o, W, c, matrix, right, count):
    """What :func:`solver_forms.assemble` does."""
    n, d, m = W.shape
    for _ in range(count):
        for a in range(matrix.shape[0]):
            for b in range(matrix.shape[1]):
                matrix[a, b] = 0.0
        for a in range(6):
            right[a] = f_o[a]
            for b in range(6):
                matrix[a, b] = M_o[a, b]
        for i in range(n):
            j0, r0 = 6 + i * d, 6 + n * d + i * m
            for a in range(d):
                right[j0 + a] = f_j[i, a]
                for b in range(d):
                    matrix[j0 + a, j0 + b] = M[i, a, b]
            for k in range(m):
                right[r0 + k] = c[i, k]
                for a in range(d):
                    matrix[j0 + a, r0 + k] = matrix[r0 + k, j0 + a] = W[i, a, k]
                for a in range(6):
                    matrix[a, r0 + k] = matrix[r0 + k, a] = W_o[i, a, k]


if __name__ == "__main__":
    main()
