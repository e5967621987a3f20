"""Judge evaluations and certificates of random scenes of all families: ``--help`` lists options.

Every night all of them are judged (``.github/workflows/random_scenes.yml``); the tests take a
sample.  Evaluations are compared with dense algebra that shares nothing with the package, and ends
of runs with SciPy on that algebra.  Prints the worst figures of every family, and exits with 1 when
one is above its bound, with the seeds.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from random_trees import (
    ALL_FAMILIES,
    WELL_CONDITIONED,
    RandomTrees,
    draw_moving_trees,
    draw_trees,
)
from scipy.spatial.transform import Rotation
from tree_models import TreeState
from tree_motion import dense_motion, tree_state
from tree_oracle import centres_of_seconds, evaluation_errors, solve_minimal

import multiarm as ma
from multiarm.errors import MultiarmError
from multiarm.scene import parse_scene

# Rounding times the square of the condition of the equations, for sums of some tens of terms: 1e-9.
AGREEMENT = 40.0 * float(np.finfo(float).eps) / WELL_CONDITIONED**2
SOLVERS = (("node", "pinocchio"), ("dense", "pinocchio"), ("node", "compiled"))
ACCURACY, DURATION = 1e-6, 0.3  # [m, rad], [s]
# Tolerance of the reference, and what it may be off by, as a part of the accuracy.
REFERENCE, UNSURE = 1e-12, 0.3
WRONG = float("inf")


def evaluation_figures(drawn: RandomTrees) -> dict[str, float]:
    """Of each solver the relative error of accelerations and of determined wrenches.

    Infinite where rank or determined wrenches are other ones, or where the scene is refused.
    """
    solution = solve_minimal(drawn.trees, drawn.state, drawn.torques)
    about = centres_of_seconds(drawn.trees, drawn.state)
    figures = {}
    for solver, arms in SOLVERS:
        scene = {**drawn.scene, "run": {**drawn.scene.get("run", {}), "solver": solver}}
        try:
            ev = ma.evaluate(ma.compile_system(parse_scene(scene), arms=arms))
        except MultiarmError as error:
            print(f"{solver}, {arms}: {error}", flush=True)
            figures[f"{solver}, {arms}"] = WRONG
            continue
        unique = {name: bool(np.all(ev.contact_forces_unique[name])) for name in solution.unique}
        alike = ev.rank == solution.rank and unique == solution.unique
        error = evaluation_errors(solution, ev, about)
        figures[f"{solver}, {arms}"] = error if alike and np.isfinite(error) else WRONG
    return figures


class Certified(NamedTuple):
    """What a certificate says, and what is true.

    met : whether it says that the accuracy is met; None where the run has not come to its end
    error : true error of the end, by the accuracy asked for
    unsure : error of the reference, by the same; 0 where it is not needed
    """

    met: bool | None
    error: float
    unsure: float = 0.0

    @property
    def false(self) -> bool:
        """Whether the certificate says *met*, and is certainly wrong."""
        return bool(self.met) and self.error > 1.0 and self.unsure < UNSURE

    def __str__(self) -> str:
        says = {None: "no certificate", True: "met", False: "not met"}[self.met]
        unsure = f" (undecided, {self.unsure:.0e})" if self.unsure > UNSURE else ""
        return f"{says} {self.error:.1e}{unsure}"


def certified_error(drawn: RandomTrees, duration: float = DURATION) -> Certified:
    """The end of a run against SciPy's; where that is close, against one with finer steps."""
    system = ma.compile_system(parse_scene(drawn.scene))
    run = ma.simulate(system, duration, accuracy=ACCURACY)
    if run.certificate is None or run.status != "completed":
        print(f"{run.status}: {run.message}", flush=True)
        return Certified(None, WRONG)
    met, end = bool(run.certificate["met"]), tree_state(run, -1)
    _, *start = drawn
    exact = dense_motion(*start, duration, REFERENCE)
    error, unsure = distance(end, exact) / ACCURACY, 0.0
    if error > UNSURE:
        finer = dense_motion(*start, duration, 0.1 * REFERENCE)
        error, unsure = distance(end, finer) / ACCURACY, distance(exact, finer) / ACCURACY
    return Certified(met, error, unsure)


def distance(state: TreeState, exact: TreeState) -> float:
    """Largest difference of places, angles and joints [m, rad]."""
    gaps = [
        np.max(np.abs(q - exact.joint_positions[name]), initial=0.0)
        for name, q in state.joint_positions.items()
    ]
    for frames, others in ((state.objects, exact.objects), (state.bases, exact.bases)):
        for name, frame in frames.items():
            gaps.append(np.linalg.norm(frame["position"] - others[name]["position"]))
            turns = [Rotation.from_quat(f["quaternion_xyzw"]) for f in (frame, others[name])]
            gaps.append((turns[0] * turns[1].inv()).magnitude())
    return float(max(gaps))


def judge_evaluations(family: str, seeds: Iterable[int], folder: Path) -> list[str]:
    """Print the worst figures of a family; what is wrong."""
    worst: dict[str, tuple[float, int]] = {}
    wrong = []
    for seed in seeds:
        drawn = draw_trees(family, np.random.default_rng(seed), folder)
        for solver, figure in evaluation_figures(drawn).items():
            worst[solver] = max(worst.get(solver, (0.0, seed)), (figure, seed))
            if not figure < AGREEMENT:
                wrong.append(f"{family}, seed {seed}: {solver} is off by {figure:.1e}")
    listed = ", ".join(
        f"{solver} {figure:.1e} ({seed})" for solver, (figure, seed) in worst.items()
    )
    print(f"{family:18} worst relative error (seed): {listed}", flush=True)
    return wrong


def judge_certificates(family: str, seeds: Iterable[int], folder: Path) -> list[str]:
    """Print what the certificates of a family say, and how far off the runs are."""
    lines, wrong = [], []
    for seed in seeds:
        drawn = draw_moving_trees(family, np.random.default_rng(seed), folder)
        certified = certified_error(drawn)
        lines.append(f"{certified} ({seed})")
        if certified.met is None or certified.false:
            wrong.append(f"{family}, seed {seed}: {lines[-1]}")
    print(f"{family:18} certificate, error / accuracy (seed): {', '.join(lines)}", flush=True)
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    families: dict[str, Any] = {"choices": list(ALL_FAMILIES), "action": "append"}
    parser.add_argument("--family", **families, help="only these")
    parser.add_argument("--number", type=int, default=14, help="evaluations of each family")
    parser.add_argument("--certificates", type=int, default=2, help="runs of each family")
    parser.add_argument("--seed", type=int, default=100, help="of the first scene")
    options = parser.parse_args()
    wrong = []
    for family in options.family or ALL_FAMILIES:
        seeds = range(options.seed, options.seed + options.number)
        with tempfile.TemporaryDirectory() as folder:
            wrong += judge_evaluations(family, seeds, Path(folder))
            wrong += judge_certificates(family, seeds[: options.certificates], Path(folder))
    print("\n".join(["wrong:", *wrong]) if wrong else "all are right")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
