"""The reference of a study: a tight run, and an independent run that determines its digits.

The reference is a run of the node algorithm with a method of high order.  Its check shares nothing
with it but the model: the dense solution of all equations at once
(:mod:`multiarm.dynamics.solver.dense`), and another method.  The differences of the two are the
digits of the reference: errors below them are not significant.  Forces that dependent constraints
leave open are neither in the digits nor in errors: they depend on roundings.

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
from multiarm.results.outcome import RunStatus
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.comparison import object_poses, pose_differences
from multiarm.studies.differences import Quantity, largest_differences, open_forces
from multiarm.studies.timing import OutOfTime, clocked_run

QUANTITIES = {
    "motion": Quantity("worst of pose and joints", "m or rad"),
    "position": Quantity("object's position", "m", ("object position",)),
    "rotation": Quantity("object's rotation", "rad", ("object rotation",)),
    "joints": Quantity("joint positions", "rad or m", ("joints", "sliding joints")),
    "force": Quantity("contact forces", "N", ("contact forces",)),
}
OF_MOTION = ("position", "rotation", "joints")
TOLERANCES = (1e-14, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9)
"""Tolerances of the reference; the first with which the run comes to its end is taken."""
METHODS = ("dop853", "rodas5p")
CHECKS = ("dopri5", "rodas5p")
"""Methods of the reference and of its check; the second of each is for stiff scenes."""
CHECK_TOLERANCES = (1e-9, 1e-11, 1e-13)
PATIENCE = 20.0
"""Wall time for the reference, and for its check [s]."""


class Motion(NamedTuple):
    """The motion of a peer, which tells no forces."""

    positions: np.ndarray  # (K, 7 + n): object's position, quaternion xyzw, joint positions

    def errors(self, exact: Trajectory) -> dict[str, float | None]:
        """As :func:`run_errors`; the force is None."""
        joints = [exact.joint_positions[arm] for arm in exact.arm_names]
        count = min(len(self.positions), len(exact))
        poses, angles = np.split(self.positions[:count], (7,), axis=1)
        position, rotation = pose_differences(poses, object_poses(exact)[:count, 0])
        apart = np.abs(angles - np.column_stack(joints)[:count])
        return {
            "position": position,
            "rotation": rotation,
            "joints": float(np.max(apart, initial=0.0)),
            "force": None,
        }


@dataclass(frozen=True)
class Reference:
    """A run with known digits."""

    run: Trajectory
    # by arm: forces that the equations leave open where the constraints are dependent
    undetermined: Mapping[str, np.ndarray]
    digits: Mapping[str, float]  # quantity -> what the check differs by
    average_step_s: float
    wall_time_s: float
    # how it was made and checked: integrator, tolerance, stabilization, evaluations, check
    about: Mapping[str, Any] = field(default_factory=dict)
    first: bool = False  # it is a first one, which the one of :func:`make_reference` is to replace

    def errors(self, course: Trajectory | Motion) -> dict[str, float | None]:
        """Largest differences of a run of ours, or of a peer, from the reference."""
        if isinstance(course, Motion):
            return course.errors(self.run)
        return run_errors(course, self.run, self.undetermined)


def run_errors(
    run: Trajectory, exact: Trajectory, undetermined: Mapping[str, np.ndarray]
) -> dict[str, float | None]:
    """Largest differences of a run from another one at the output times that both have.

    Returns
    -------
    dict
        position [m], rotation [rad], joints [rad or m], force [N]; None where there is nothing to
        compare, such as forces of which the equations determine none.
    """
    differences = largest_differences(run, exact, undetermined, QUANTITIES)
    return {
        name: differences[name].worst if name in differences else None
        for name, about in QUANTITIES.items()
        if about.nouns
    }


def motion_error(errors: Mapping[str, float | None]) -> float | None:
    """The worst of position, rotation and joints; None where none is known."""
    known = (errors.get(name) for name in OF_MOTION)
    return max((error for error in known if error is not None), default=None)


def digits_of(
    check: Trajectory, run: Trajectory, undetermined: Mapping[str, np.ndarray]
) -> dict[str, float]:
    """Quantity -> what a run differs from its check by."""
    errors = run_errors(check, run, undetermined)
    known = {name: error for name, error in errors.items() if error is not None}
    return {"motion": motion_error(errors) or 0.0, **known}


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
    undetermined, statistics = open_forces(system, run), run.statistics
    methods = CHECKS if method == METHODS[0] else CHECKS[::-1]
    for solver, check in [(solver, check) for solver in ("dense", "node") for check in methods]:
        digits, about = _check(system, run, undetermined, solver, check, report)
        if about:
            break
    else:
        raise MultiarmError(
            f"the reference cannot be checked: no independent run ends within {PATIENCE:g} s; "
            "take a shorter duration"
        )
    return Reference(
        run,
        undetermined,
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
            if run.status == RunStatus.COMPLETED:
                return run, method, tolerance
            trouble = run.message
    raise MultiarmError(f"the scene has no reference to compare with: {trouble}")


def _check(
    system: System,
    exact: Trajectory,
    undetermined: Mapping[str, np.ndarray],
    solver: str,
    method: str,
    report: Callable[[str], None],
) -> tuple[dict[str, float], dict[str, Any]]:
    """Digits of the reference, and how they were found, tighter and tighter as long as time and
    gain allow; both empty where no run ends."""
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
        if run.status != RunStatus.COMPLETED:
            break
        apart = digits_of(run, exact, undetermined)
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
