"""The reference of a study: a tight run, and an independent run that determines its digits.

The reference is a run of the node algorithm with a method of high order.  Its check shares nothing
with it but the model: the dense solution of all equations at once
(:mod:`multiarm.dynamics.solver.dense`), and another method.  The differences of the two are the
digits of the reference: errors below them are not significant.

Both take long.  Until they are there, the most accurate of a study's first runs stands in for the
reference, and its difference from the next one for the digits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from multiarm.dynamics.system import System
from multiarm.errors import MultiarmError
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.comparison import rotation_apart
from multiarm.studies.timing import OutOfTime, clocked_run

QUANTITIES = {
    "motion": ("worst of pose and joints", "m, rad"),
    "position": ("object's position", "m"),
    "rotation": ("object's rotation", "rad"),
    "joints": ("joint angles", "rad, m"),
    "force": ("contact forces", "N"),
}
"""Quantity -> what it is, and its unit; an error is the worst one at an output time."""
OF_MOTION = ("position", "rotation", "joints")
TOLERANCES = (1e-14, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9)
"""Tolerances of the reference; the first with which the run comes to its end is taken."""
METHODS = ("dop853", "rodas5p")
CHECKS = ("dopri5", "rodas5p")
"""Methods of the reference and of its check: what the second of each is for are stiff scenes."""
CHECK_TOLERANCES = (1e-9, 1e-11, 1e-13)
PATIENCE = 20.0
"""Wall time for the reference, and for its check [s]."""


class Motion(NamedTuple):
    """What runs are compared by."""

    positions: np.ndarray  # (K, 7 + n): object's position, quaternion xyzw, joint positions
    forces: np.ndarray | None = None  # (K, N): contact forces

    @classmethod
    def of(cls, run: Trajectory) -> Motion:
        """The motion of a run."""
        arms = run.arm_names
        joints = [run.joint_positions[arm] for arm in arms]
        pose = [run.object_position, run.object_quaternion_xyzw]
        forces = np.column_stack([run.contact_forces[arm] for arm in arms])
        return cls(np.column_stack([*pose, *joints]), forces)

    def errors(self, exact: Motion) -> dict[str, float | None]:
        """Largest differences from another motion at the times that both have.

        Returns
        -------
        dict
            position [m], rotation [rad], joints [rad or m], force [N] or None.
        """
        count = min(len(self.positions), len(exact.positions))
        q, q_exact = self.positions[:count], exact.positions[:count]
        apart, force = np.abs(q - q_exact), None
        if self.forces is not None and exact.forces is not None:
            force = float(np.max(np.abs(self.forces[:count] - exact.forces[:count]), initial=0.0))
        return {
            "position": float(np.max(np.linalg.norm(apart[:, :3], axis=1))),
            "rotation": float(np.max(rotation_apart(q[:, 3:7], q_exact[:, 3:7]))),
            "joints": float(np.max(apart[:, 7:], initial=0.0)),
            "force": force,
        }


@dataclass(frozen=True)
class Reference:
    """A motion with known digits."""

    motion: Motion
    digits: Mapping[str, float]  # quantity -> what the check differs by
    average_step_s: float
    wall_time_s: float
    # how it was made and checked: method, tolerance, evaluations, check
    about: Mapping[str, Any] = field(default_factory=dict)
    first: bool = False  # it is a first one, which the one of :func:`make_reference` is to replace


def motion_error(errors: Mapping[str, float | None]) -> float | None:
    """The worst of position, rotation and joints."""
    known = [error for name in OF_MOTION if (error := errors.get(name)) is not None]
    return max(known) if len(known) == len(OF_MOTION) else None


def difference(check: Motion, motion: Motion) -> dict[str, float]:
    """Quantity -> what two motions differ by: the digits of the second."""
    errors = {name: error for name, error in check.errors(motion).items() if error is not None}
    return {"motion": motion_error(errors) or 0.0, **errors}


def make_reference(
    system: System, report: Callable[[str], None] = lambda _words: None
) -> Reference:
    """Compute the reference of a system's scene, and check it.

    Parameters
    ----------
    system : System
    report : callable, optional
        Called with a description of each stage.

    Raises
    ------
    MultiarmError
        Where no tight run comes to its end, or none of the independent ones does.
    """
    report("reference")
    run, method, tolerance = _tight_run(system)
    motion, statistics = Motion.of(run), run.statistics
    methods = CHECKS if method == METHODS[0] else CHECKS[::-1]
    for solver, check in [(solver, check) for solver in ("dense", "node") for check in methods]:
        digits, about = _check(system, motion, solver, check, report)
        if about:
            break
    else:
        raise MultiarmError(
            f"the reference cannot be checked: no independent run ends within {PATIENCE:g} s; "
            "take a shorter duration"
        )
    return Reference(
        motion,
        digits,
        statistics["simulated_s"] / max(1, statistics["steps"]),
        statistics["wall_time_s"],
        {
            "integrator": method,
            "tolerance": tolerance,
            "stabilization": statistics["stabilization"],
            "evaluations": statistics["evaluations"],
            "check": about,
        },
    )


def _tight_run(system: System) -> tuple[Trajectory, str, float]:
    trouble = ""
    for method in METHODS:
        for tolerance in TOLERANCES:
            try:
                run = _run(system, PATIENCE, "node", method, tolerance)
            except OutOfTime:
                trouble = trouble or f"{method} takes longer than {PATIENCE:g} s"
                break
            if run.status == "completed":
                return run, method, tolerance
            trouble = run.message
    raise MultiarmError(f"the scene has no reference to compare with: {trouble}")


def _check(
    system: System, motion: Motion, solver: str, method: str, report: Callable[[str], None]
) -> tuple[dict[str, float], dict[str, Any]]:
    """Digits of the motion, and how they were found, tighter and tighter as long as time and gain
    allow; both empty where no run ends."""
    digits: dict[str, float] = {}
    about: dict[str, Any] = {}
    left = PATIENCE
    for tolerance in CHECK_TOLERANCES:
        report(f"checking the reference: {solver} solver, {method}, tolerance {tolerance:g}")
        begin = time.perf_counter()
        try:
            run = _run(system, left, solver, method, tolerance)
        except (OutOfTime, MultiarmError, np.linalg.LinAlgError):
            break
        took = time.perf_counter() - begin
        left -= took
        if run.status != "completed":
            break
        apart = difference(Motion.of(run), motion)
        if not digits or apart["motion"] < digits["motion"]:
            evaluations = run.statistics["evaluations"]
            digits, about = apart, {
                "solver": solver, "integrator": method, "tolerance": tolerance,
                "evaluations": evaluations,
            }  # fmt: skip
        if left < 3.0 * took:  # what the next one would take
            break
    return digits, about


def _run(system: System, limit_s: float, solver: str, method: str, tolerance: float) -> Trajectory:
    run, _ = clocked_run(
        system, limit_s, solver=solver, integrator=method, tolerance=tolerance,
        stabilization="projection",
    )  # fmt: skip
    return run
