r"""How a body moves in a pick-up, and what its contacts press with meanwhile.

The run of duration T has these times, as parts of it:

=============  =====================================================================
up to          what happens
=============  =====================================================================
``RESTED``     the body rests on the floor, and the hands press as hard as they must
``GRIPPED``    the hands press harder, until the floor carries at the edge alone
``TILTED``     the body is tilted about the edge
``HELD``       it rests
``CLOSED``     the late contacts, which take hold at ``HELD``, take the weight over
``LIFTED``     the body is lifted, and turned back as it lay
=============  =====================================================================

It moves from rest to rest.  At each time the contacts that press exert the wrench of Newton and
Euler on it, about the centre of mass in its axes,

.. math::
    \begin{bmatrix} m R^T (a + g e_z) \\ I\dot\omega + \omega \times I\omega \end{bmatrix},

with the forces of least norm that are all a part of the weight at least.  From one phase to the
next the forces go over smoothly: both sets exert the same wrench, and so does what lies between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from multiarm.control.object_path import (
    PosePath,
    pose_path,
    quintic,
    reference_motion,
    reference_pose,
)
from multiarm.errors import GraspError
from multiarm.geometry.poses import pose_matrix
from multiarm.grasp.face_contacts import FaceContacts
from multiarm.grasp.forces.force_distribution import distribute_forces
from multiarm.grasp.pickup.lying_body import LyingBody, PivotEdge
from multiarm.grasp.pickup.phases import GRIP, LIFT, TILT, PickupPhase
from multiarm.grasp.pickup.tilting import UP, floor_contacts
from multiarm.grasp.scenes import GRAVITY
from multiarm.spatial import quaternion_to_matrix

# Rest before anything happens, too.
RESTED, GRIPPED, TILTED, HELD, CLOSED, LIFTED = 0.02, 0.1, 0.45, 0.47, 0.62, 0.95


class ObjectMotion(NamedTuple):
    """Where the body is, and how its centre of mass moves, in world axes."""

    pose: np.ndarray  # (4, 4) of the body's frame
    twist: np.ndarray  # (6,) [m/s, rad/s]
    acceleration: np.ndarray  # (6,) [m/s^2, rad/s^2]


@dataclass(frozen=True, eq=False)
class PickupCourse:
    """The body's motion in a run, and the forces of its contacts.

    Attributes
    ----------
    lies : LyingBody
    edge : PivotEdge or None
        About which it is tilted.
    angle : float
        Of the tilt [rad].
    grasp : FaceContacts
        Contacts of all hands, in the body's frame.
    phases : sequence of PickupPhase
    least : float
        Part of the weight with which every contact presses.
    mass : float
        [kg]
    lift : float
        Height to which the body is lifted [m].
    duration : float
        [s]
    """

    lies: LyingBody
    edge: PivotEdge | None
    angle: float
    grasp: FaceContacts
    phases: Sequence[PickupPhase]
    least: float
    mass: float
    lift: float
    duration: float

    @cached_property
    def _pivot(self) -> np.ndarray:
        """A point of the edge, or the centre of mass, in the world as the body lies (3,) [m]."""
        at_centre = self.lies.at(self.lies.body.centre)
        return at_centre if self.edge is None else self.edge.point

    @cached_property
    def _path(self) -> PosePath:
        """Of a frame at the pivot."""
        start, raised = np.eye(4), np.eye(4)
        start[:3, 3], raised[:3, 3] = self._pivot, self._pivot + self.lift * UP
        tilted = start if self.edge is None else self.edge.turned(self.angle) @ start
        times = [part * self.duration for part in (GRIPPED, TILTED, CLOSED, LIFTED)]
        return pose_path(times, [start, tilted, tilted, raised])

    def at(self, t: float) -> ObjectMotion:
        """The body's motion at a time [s]."""
        lies = self.lies
        quaternion, twist, change = reference_motion(t, self._path)
        turn = quaternion_to_matrix(quaternion)
        motion = pose_matrix(turn, np.array(reference_pose(t, self._path)[0]) - turn @ self._pivot)
        r = turn @ (lies.at(lies.body.centre) - self._pivot)
        omega, alpha = twist[3:], change[3:]
        velocity = np.cross(omega, r)
        return ObjectMotion(
            motion @ lies.pose,
            np.concatenate([twist[:3] + velocity, omega]),
            np.concatenate([change[:3] + np.cross(alpha, r) + np.cross(omega, velocity), alpha]),
        )

    def forces(self, t: float) -> np.ndarray:
        """Forces (N,) of the grasp's contacts at a time [s]; those that do not press are zero [N].

        Raises
        ------
        GraspError
            The contacts do not exert what the motion takes: it is too fast.
        """
        x = t / self.duration
        tilting = GRIP if self.edge is None else TILT
        if x < GRIPPED:
            return self._between(t, GRIP, tilting, (x - RESTED) / (GRIPPED - RESTED))
        return self._between(t, tilting, LIFT, (x - HELD) / (CLOSED - HELD))

    def _between(self, t: float, before: str, after: str, part: float) -> np.ndarray:
        if part <= 0.0 or before == after:
            return self._of_phase(t, before)
        if part >= 1.0:
            return self._of_phase(t, after)
        share = quintic(part)[0]
        return (1.0 - share) * self._of_phase(t, before) + share * self._of_phase(t, after)

    def _of_phase(self, t: float, name: str) -> np.ndarray:
        """Forces (N,) of least norm with the contacts of a phase [N]."""
        phase, motion = next(phase for phase in self.phases if phase.name == name), self.at(t)
        pushes = self.grasp.contacts.subset(phase.contacts)
        if phase.floor:
            pushes = pushes.joined(floor_contacts(self.lies.body, motion.pose, phase.floor))
        weight = self.mass * abs(GRAVITY[2])
        shares = distribute_forces(
            pushes, self._wrench(motion), minimum=self.least * weight, objective="norm"
        )
        if shares.forces is None:
            raise GraspError(
                f"at {t:.3g} s, in the phase {name!r}, {shares.message}; the motion is too fast, "
                "choose a longer duration"
            )
        forces = np.zeros(len(self.grasp.contacts))
        forces[list(phase.contacts)] = shares.forces[: len(phase.contacts)]
        return forces

    def _wrench(self, motion: ObjectMotion) -> np.ndarray:
        """What the contacts exert, (6,) in the body's frame about its origin [N, N m]."""
        body, R = self.lies.body, motion.pose[:3, :3]
        force = self.mass * R.T @ (motion.acceleration[:3] - np.array(GRAVITY))
        inertia = body.mass_properties(self.mass).inertia
        omega, alpha = R.T @ motion.twist[3:], R.T @ motion.acceleration[3:]
        moment = inertia @ alpha + np.cross(omega, inertia @ omega)
        return np.concatenate([force, moment + np.cross(body.centre, force)])
