"""Judge runs of random scenes with friction: ``--help`` lists the options.

Of each family: whether the runs complete, or end with a proof that no motion obeys the laws;
whether the laws hold in every sample; whether contacts create energy.  Of the first ones of each
family: where the objects are at the end, beside an independent time stepping, and whether a
certificate is false.  Exits with 1 when something is wrong, and lists it.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from friction_laws import CREATED, LAWS, judge_energy, judge_laws
from friction_oracle import Oracle
from friction_time_stepping import step_through
from random_friction_scenes import FAMILIES, Table, draw
from run_friction_scenes import PROVEN, Case, Worker, simulate_table
from scipy.spatial.transform import Rotation

from multiarm.errors import SolverError

AGREEMENT = 1e-3
"""Largest distance from the time stepping [m, rad], of a run at an accuracy of 1e-6.

It is late by up to a step at each impact, which changes speeds by up to 10 m/s or rad/s; where
there are several, later ones multiply the error.
"""
STEP = 1e-5  # of the time stepping [s]
CERTIFIED, REFERENCE = 1e-4, 1e-8
"""Accuracies of runs with certificates, and of what these are compared with."""


class Beside(NamedTuple):
    """A run beside the time stepping."""

    apart: float  # largest distance of the objects at the end [m, rad]
    several: bool  # friction leaves the motion open, and both may be right


class Judged(NamedTuple):
    """Figures of a run."""

    laws: dict[str, float]
    energy: dict[str, float]

    def faults(self) -> list[str]:
        """What is wrong."""
        broken = [f"{law}: {value:.1e}" for law, value in self.laws.items() if not value <= LAWS]
        created = [
            f"{works} create {value:.1e}"
            for works, value in self.energy.items()
            if works != "balance" and not value <= CREATED
        ]
        return broken + created


def judge_case(case: Case) -> Judged | None:
    """The figures of a run; None where it proves that there is none."""
    table = draw(case.family, case.seed)
    try:
        trajectory = simulate_table(table, case.accuracy)
    except SolverError as error:
        if PROVEN in str(error):
            return None
        raise
    return Judged(judge_laws(table, trajectory, case.accuracy), judge_energy(trajectory))


def distance(trajectory: Any, state: Any, k: int = -1) -> float:
    """Largest distance of an object of a sample from one of the oracle [m, rad]."""
    worst = 0.0
    for i, motion in enumerate(trajectory.objects.values()):
        turn = Rotation.from_quat(motion.quaternion_xyzw[k]).inv()
        turn = turn * Rotation.from_matrix(state.rotations[i])
        shift = float(np.abs(motion.position[k] - state.positions[i]).max())
        worst = max(worst, shift, float(turn.magnitude()))
    return worst


def beside_stepping(
    table: Table, accuracy: float, h: float, duration: float | None = None
) -> float:
    """Largest distance of the objects from the time stepping at the end of a run [m, rad]."""
    if duration is not None:
        table = table | {"run": table["run"] | {"duration": duration}}
    trajectory = simulate_table(table, accuracy)
    oracle = Oracle(table)
    oracle.hold({name: torques[0] for name, torques in trajectory.joint_torques.items()})
    stepped = step_through(oracle, float(trajectory.time[-1]), h)
    several = trajectory.statistics["ambiguous_steps"] > 0
    return Beside(distance(trajectory, stepped.state), several)


def judge_certificate(family: str, seed: int) -> tuple[bool | None, float]:
    """What the certificate of a run says, and the largest error of the objects [m, rad]."""
    table = draw(family, seed)
    certified = simulate_table(table, CERTIFIED, certificate=True)
    reference = simulate_table(table, REFERENCE, output_times=certified.time)
    worst, samples = 0.0, min(len(certified), len(reference))
    for name, motion in certified.objects.items():
        exact = reference.objects[name]
        turns = Rotation.from_quat(motion.quaternion_xyzw[:samples]).inv()
        turns = turns * Rotation.from_quat(exact.quaternion_xyzw[:samples])
        shift = np.abs(motion.position[:samples] - exact.position[:samples])
        worst = max(worst, float(shift.max()), float(turns.magnitude().max()))
    return (certified.certificate or {}).get("met"), worst


def judge_family(family: str, seeds: range, accuracies: Iterable[float], worker: Worker) -> list:
    """Print the figures of a family, and return what is wrong."""
    wrong, worst = [], Counter[str]()
    ends = Counter[str]()
    for accuracy in accuracies:
        for seed in seeds:
            case = Case(family, seed, accuracy)
            run = worker.run(case)
            ends["proven" if run.proven else run.status] += 1
            if run.proven:
                continue
            if run.status != "completed":
                wrong.append(f"{family} {seed} {accuracy:.0e}: {run.status}: {run.message}")
                continue
            judged = judge_case(case)
            if judged is not None:
                worst |= Counter(judged.laws | judged.energy)
                wrong += [f"{family} {seed} {accuracy:.0e}: {fault}" for fault in judged.faults()]
    listed = ", ".join(f"{what} {value:.1e}" for what, value in worst.items())
    print(f"{family:10} {dict(ends)}; worst: {listed}", flush=True)
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--family", choices=list(FAMILIES), action="append", help="all if none")
    parser.add_argument("--number", type=int, default=50, help="scenes of each family")
    parser.add_argument("--seed", type=int, default=0, help="of the first")
    parser.add_argument("--accuracy", type=float, action="append", help="1e-4, 1e-6, 1e-8 if none")
    parser.add_argument("--stepped", type=int, default=3, help="of each beside the time stepping")
    parser.add_argument("--certificates", type=int, default=10, help="of each")
    parser.add_argument("--limit", type=float, default=120.0, help="of a run [s]")
    options = parser.parse_args()
    worker, wrong = Worker(options.limit), []
    for family in options.family or FAMILIES:
        seeds = range(options.seed, options.seed + options.number)
        wrong += judge_family(family, seeds, options.accuracy or (1e-4, 1e-6, 1e-8), worker)
        for seed in seeds[: options.stepped]:
            if not Oracle(draw(family, seed)).follows:
                continue
            if worker.run(Case(family, seed, 1e-6)).status != "completed":
                continue
            apart, several = beside_stepping(draw(family, seed), 1e-6, STEP)
            print(f"{family:10} {seed:3d} beside the time stepping: {apart:.1e}"
                  + several * ", which may be another solution", flush=True)  # fmt: skip
            if not (several or apart < AGREEMENT):
                wrong.append(f"{family} {seed}: {apart:.1e} from the time stepping")
        for seed in seeds[: options.certificates]:
            if worker.run(Case(family, seed, REFERENCE)).status != "completed":
                continue
            met, error = judge_certificate(family, seed)
            print(f"{family:10} {seed:3d} certificate {met}, error {error:.1e}", flush=True)
            if met and error > CERTIFIED:
                wrong.append(f"{family} {seed}: a false certificate, error {error:.1e}")
    worker.close()
    print("\n".join(["wrong:", *wrong]) if wrong else "all are right")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
