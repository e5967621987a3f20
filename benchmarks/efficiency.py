r"""Section 4.4 of the thesis repeated: node algorithm against direct elimination.

    python benchmarks/efficiency.py [--arms 2,4,6] [--rounds N] [--json FILE]

Arms of 6 joints, one contact each, an object; ``t`` is the time to build the coefficients of (4.9),
``t1`` that of the node algorithm and ``t2`` that of direct elimination, on identical coefficients.
The thesis measured Matlab programs; here the same is measured twice.

*interpreted*: coefficients by Pinocchio's Python functions and NumPy, the node algorithm as a plain
NumPy loop (and over all arms at once), direct elimination by LAPACK, which is compiled, as Matlab's
was.  *compiled*: coefficients and node algorithm as the time loop performs them.

Direct elimination has its best form: LAPACK's LU on one thread, without the assembly of the matrix;
the symmetric factorisation is measured too.  The time of the node
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

from collections.abc import Sequence

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
    fitted_slope,
    measure,
    median,
    python_burst,
    upper_half,
)

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.data import Data
from multiarm.dynamics.solver.batched import solve_batched
from multiarm.dynamics.solver.node import make_work
from multiarm.dynamics.status import OK
from multiarm.errors import SolverError
from multiarm.jit.kernels import kernel
from multiarm.plots.style import BLUE, GREEN, INK, ORANGE, PINK
from multiarm.problems import ring_of_arms
from multiarm.scene import Scene
from multiarm.threads import one_thread

ARMS = (2, 3, 4, 5, 6, 7, 8, 9, 10, 20, 50, 100)
BURSTS_PER_ROUND = 12
WAYS = ("compiled", "interpreted")
"""In which everything is measured."""
THESIS = pandas.DataFrame(
    {
        "total_1995": [0.98, 0.99, 0.99, 1.00, 1.01, 1.02, 1.03, 1.05, 1.06],
        "solving_1995": [0.71, 0.77, 0.88, 1.03, 1.22, 1.41, 1.64, 1.88, 2.13],
        "saved_1995_ms": [-6.5, -7.2, -4.9, 1.3, 12.3, 27.1, 47.7, 73.7, 104.6],
    },
    index=pandas.RangeIndex(2, 11, name="arms"),
)
"""The table of section 4.4: ``(t2 + t) / (t1 + t)``, ``t2 / t1`` and ``t2 - t1`` of Matlab."""


def main(words: Sequence[str] | None = None) -> None:
    """Measure, and write the table, the figure and the numbers."""
    parser = output.options(__doc__, "efficiency", ARMS)
    arguments = parser.parse_args(words)
    with output.Clock() as clock:
        rows = solver_study(arguments.arms, arguments.rounds)
    output.save(arguments, clock, "thesis", rows, figure)
    for way in WAYS:
        arms = crossover(rows["arms"], rows[f"solving_{way}"])
        print(f"node algorithm faster, {way}:", f"from {arms:.3g} arms" if arms else "never here")
    larger = rows[upper_half(rows)]
    for part in ("build_compiled", "node_compiled", "lu", "ldl"):
        slope = fitted_slope(larger["arms"], larger[f"{part}_us"])
        print(f"exponent of {part} over the larger half:", slope and f"{slope:.2f}")


def figure(rows: pandas.DataFrame) -> Figure:
    """Times of both algorithms, and the speed-up then and now."""
    drawing, (times, ratios) = output.panels(2)
    for column, name, colour, dashes in (
        ("node_compiled_us", "node, compiled", BLUE, "-"),
        ("node_interpreted_us", "node, NumPy loop", BLUE, "--"),
        ("node_at_once_interpreted_us", "node, NumPy, all arms at once", BLUE, ":"),
        ("lu_us", "direct, LU", ORANGE, "-"),
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


def study_scene(arms: int) -> Scene:
    """The ring of UR5 arms, each touching a face of the disc with its tip; no torques."""
    ring = ring_of_arms(arms, "ball")
    joints = [{"arm": name, "kind": "point_on_plane"} for name in ring.arms]
    return ring.replace(name=f"{arms} arms with one contact each", joints=joints,
                        control={"kind": "none"})  # fmt: skip


def solver_study(arms: Sequence[int] = ARMS, rounds: int = 7) -> pandas.DataFrame:
    """Measure section 4.4: a row for each number of arms.

    Returns
    -------
    DataFrame
        ``arms``; ``solving_WAY``, ``t2 / t1``, and ``total_WAY``, ``(t2 + t) / (t1 + t)``, in 1995
        and in both ways; ``PART_us``, the median microseconds of every part; ``node_operations``
        and ``direct_operations``; ``deviation``, the largest relative deviation of a solver's
        accelerations from those of LU.
    """
    rows = []
    with one_thread():
        for count in arms:
            print(f"section 4.4: {count} arms", flush=True)
            rows.append(_measure(count, rounds))
    ratios = THESIS[["solving_1995", "total_1995"]].reset_index()
    return ratios.merge(pandas.DataFrame(rows), "right", "arms")


def crossover(arms: Sequence[float], ratios: Sequence[float]) -> float | None:
    """Number of arms at which ``t2 / t1`` passes 1 for good, between neighbours interpolated.

    Returns the smallest number when the ratio is never below 1, None when it is below at the end.
    """
    sizes, logs = np.log(arms), np.log(ratios)
    (below,) = np.nonzero(logs < 0.0)
    if not below.size:
        return float(np.exp(sizes[0]))
    last = below[-1]
    if last == len(logs) - 1:
        return None
    return float(np.exp(np.interp(0.0, logs[last : last + 2], sizes[last : last + 2])))


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


def _measure(count: int, rounds: int) -> dict[str, float]:
    system = compile_system(study_scene(count))
    state = moving_state(system, seed=count)
    s = build(system, state)
    matrix, right = assemble(s)
    data = Data(system.model)
    data.set_state(0.0, state)
    parts = data.arrays.functions
    bursts: dict[str, Burst] = {
        # the coefficients of (4.9) at the state in the data, with ``W`` and all forces
        "build_compiled": call_burst(data, parts.kinematics, parts.forces),
        "node_compiled": CompiledNode(s).burst,
        "lu": python_burst(lambda: solve_lu(matrix, right)),
        "ldl": python_burst(lambda: solve_ldl(matrix, right)),
        "build_interpreted": python_burst(lambda: build(system, state)),
        "node_interpreted": python_burst(lambda: node_loop(s)),
        "node_at_once_interpreted": python_burst(lambda: mcmillan(s, together=0)),
    }
    cost = median(measure(bursts, rounds * BURSTS_PER_ROUND))
    row: dict[str, float] = {"arms": count}
    for way in WAYS:
        t, t1, t2 = cost[f"build_{way}"], cost[f"node_{way}"], cost["lu"]  # LAPACK's in both ways
        row |= {f"solving_{way}": t2 / t1, f"total_{way}": (t2 + t) / (t1 + t)}
    row |= {f"{part}_us": microseconds for part, microseconds in cost.items()}
    row |= {
        "node_operations": node_operations(count),
        "direct_operations": direct_operations(count),
    }
    return row | {"deviation": max(deviations(s).values())}


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


if __name__ == "__main__":
    main()
