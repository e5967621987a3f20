r"""Putting a start on the constraints, with the least change, and telling what was changed.

Positions: the arms move onto the joints with the object held, each on its own; where one cannot, or
only by a large swing for a small gap, the object gives way too.  They stay within the limits of
their joints and on the branch of the written start (:mod:`multiarm.assembly.closing`).  A start
that is too far off, or whose contacts contradict each other, is refused with its residuals.

Velocities: the least change in the metric of the inertia,

.. math:: \min_{\delta v} \tfrac12\, \delta v^T M\, \delta v \ \text{ with }\ W^T(v + \delta v) = 0,

which is an inelastic impact that closes all gap rates; ``W`` may have dependent columns.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from multiarm.assembly.closing import CLOSED, close_gaps
from multiarm.assembly.linkage import Linkage, projection_tolerance, scene_size
from multiarm.assembly.refusals import (
    cannot_close,
    gaps_by_arm,
    joint_names,
    joints_at_limit,
    too_far,
)
from multiarm.assembly.velocities import close_rates
from multiarm.contacts.kernel import GAP_RATE
from multiarm.dynamics.equations import OK, update_kinematics
from multiarm.errors import SceneError
from multiarm.spatial import difference

if TYPE_CHECKING:
    from multiarm.assembly.system import System
    from multiarm.dynamics.state import State

# A start whose gaps are larger than this fraction of the scene's size is refused.
CLOSE = 0.1
# The object is held while no joint of an arm moves more than so many times what closes its worst
# gap by itself; more is a swing near a singular posture.
SWING = 20.0


@dataclass(frozen=True)
class StartReport:
    """How the written start was corrected.

    Attributes
    ----------
    gaps : dict arm -> float
        Largest gap of the written start [m].
    gap_rates : dict arm -> float
        Largest gap rate of the written start [m/s].
    gaps_left : dict arm -> float
        Largest gap of the assembled start [m].
    joint_change : float
        Largest change of one joint [rad, m].
    joint_changes : dict arm -> float
        The same, arm by arm.
    object_held : bool
        Whether the arms closed the gaps without moving the object.
    object_shift, object_turn : float
        Displacement [m] and rotation [rad] of the object.
    at_limit : tuple of str
        Joints (``arm/joint``) of the assembled start that are at a limit.
    outside_limits : tuple of str
        Joints that were written outside their limits, which then do not hold them.
    velocity_change : float
        Largest change of a velocity component [m/s, rad/s].
    object_velocity_change, object_spin_change : float
        Change of the velocity of the centre of mass [m/s] and of the angular velocity [rad/s].
    joint_velocity_change : float
        Largest change of a joint's velocity [rad/s, m/s].
    energy_lost : float
        Kinetic energy that the written velocities had more [J].

    :meth:`lines` tells it in words.
    """

    gaps: dict[str, float] = field(default_factory=dict)
    gap_rates: dict[str, float] = field(default_factory=dict)
    gaps_left: dict[str, float] = field(default_factory=dict)
    joint_change: float = 0.0
    joint_changes: dict[str, float] = field(default_factory=dict)
    object_held: bool = True
    object_shift: float = 0.0
    object_turn: float = 0.0
    at_limit: tuple[str, ...] = ()
    outside_limits: tuple[str, ...] = ()
    velocity_change: float = 0.0
    object_velocity_change: float = 0.0
    object_spin_change: float = 0.0
    joint_velocity_change: float = 0.0
    energy_lost: float = 0.0

    def lines(self) -> list[str]:
        """What was corrected, and what a reader should know of the joints' limits."""
        told = []
        if self.joint_change > 0.0 or not self.object_held:
            arms = ", ".join(f"{arm} {change:.3g}" for arm, change in self.joint_changes.items())
            body = "held"
            if not self.object_held:
                body = f"moved by {self.object_shift:.3g} m and {self.object_turn:.3g} rad"
            told.append(f"joints moved by up to {arms} (rad or m), the object was {body}")
        if self.velocity_change > 0.0:
            told.append(
                f"velocities changed: object {self.object_velocity_change:.3g} m/s and "
                f"{self.object_spin_change:.3g} rad/s, joints up to "
                f"{self.joint_velocity_change:.3g} rad/s or m/s; {self.energy_lost:.3g} J were lost"
            )
        if self.at_limit:
            told.append(f"at a limit: {', '.join(self.at_limit)}")
        if self.outside_limits:
            told.append(
                f"written outside its limits, and left there: {', '.join(self.outside_limits)}"
            )
        return told


def assemble(system: System, written: State) -> tuple[State, StartReport]:
    """Put the written start of a scene on the constraints.

    Raises
    ------
    SceneError
        When a gap is too large or cannot be closed, with the residuals of the joints.
    SolverError
        When an arm's inertia is not positive definite.
    """
    system.set_state(0.0, written)
    return assemble_placed(system, "the start")


def assemble_placed(system: System, what: str) -> tuple[State, StartReport]:
    """Put the state in the system's buffers on the constraints; ``what`` it is called in messages.

    A state that satisfies the joints to within :func:`projection_tolerance` is not touched.

    Raises
    ------
    SceneError, SolverError
        As :func:`assemble`.
    """
    written = system.get_state()
    _update(system)
    lost = np.flatnonzero(~np.isfinite(system.buffers.contacts).all(axis=1))
    if lost.size:
        from multiarm.dynamics.evaluation import lost_contact

        raise SceneError(
            [f"{lost_contact(system, int(row))}; mend its placement at the start" for row in lost]
        )
    gaps, rates = gaps_by_arm(system), gaps_by_arm(system, GAP_RATE)
    size = scene_size(system)
    if not all(gap <= CLOSE * size for gap in gaps.values()):
        raise SceneError(too_far(system, what, gaps, CLOSE * size))
    limits, outside = _limits(system, written)
    held = _close(system, what, gaps, limits, size)
    energy_lost = close_rates(system, size)
    start = system.get_state()
    moved = np.abs(start.position[7:] - written.position[7:])
    faster = np.abs(start.velocity - written.velocity)
    return start, StartReport(
        gaps=gaps,
        gap_rates=rates,
        gaps_left=gaps_by_arm(system),
        joint_change=float(np.max(moved)),
        joint_changes={a: float(np.max(m)) for a, m in system.layout.split_joints(moved).items()},
        object_held=held,
        object_shift=float(np.linalg.norm(start.position[:3] - written.position[:3])),
        object_turn=float(np.linalg.norm(difference(written.position[3:7], start.position[3:7]))),
        at_limit=joints_at_limit(system),
        outside_limits=outside,
        velocity_change=float(np.max(faster)),
        object_velocity_change=float(np.linalg.norm(faster[:3])),
        object_spin_change=float(np.linalg.norm(faster[3:6])),
        joint_velocity_change=float(np.max(faster[6:])),
        energy_lost=energy_lost,
    )


def _close(
    system: System, what: str, gaps: dict[str, float], limits: np.ndarray, size: float
) -> bool:
    """Close the gaps of the state in the buffers; returns whether the object was held."""
    tolerance = projection_tolerance(system, size)
    if max(gaps.values()) <= tolerance:
        return True
    everything = list(range(len(system.arm_names)))
    whole = Linkage(system, everything, True, limits)
    begin = whole.here()
    closed, calm = True, True
    for i, gap in enumerate(gaps.values()):
        if gap > tolerance:
            arm = Linkage(system, [i], False, limits)
            near = SWING * arm.here().least_turn
            end = close_gaps(arm, tolerance)
            closed, calm = closed and end.status == CLOSED, calm and end.change <= near
    if closed and calm:
        return True
    arms_alone = whole.here()
    whole.place(begin)
    end = close_gaps(whole, tolerance)
    if end.status == CLOSED:
        return False
    if closed:
        whole.place(arms_alone)
        return True
    raise SceneError(cannot_close(system, what, gaps, whole, end))


def _limits(system: System, written: State) -> tuple[np.ndarray, tuple[str, ...]]:
    """Limits (n, 2) of all joints, and the joints outside of theirs, which get none."""
    limits = np.vstack([arm.position_limits for arm in system.arms.values()])
    angles = written.position[7:]
    out = (angles < limits[:, 0]) | (angles > limits[:, 1])
    limits[out] = -np.inf, np.inf
    return limits, tuple(np.array(joint_names(system))[out])


def _update(system: System) -> None:
    if update_kinematics(system.struct()) != OK:
        system.reraise()
