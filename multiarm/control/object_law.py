"""Numbers of the laws that move objects, and what they command."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.control.command_derivatives import PreparedDerivatives
from multiarm.dynamics.control_laws import view_of_law, view_of_work
from multiarm.dynamics.data import Data
from multiarm.jit.structs import Flag, Float, Floats1, Floats2, Floats3, Ints1, Numbers


class ObjectLaw(NamedTuple):
    """Gains of a law that moves P of the objects, their internal forces and paths.

    Stiffness and damping of computed torque are in 1/s^2 and 1/s, those of the impedance in N/m,
    N m/rad and N s/m, N m s/rad.
    """

    objects: Ints1  # (P,) those that are moved
    stiffness: Floats1  # (6,) for shifts and turns, world axes
    damping: Floats1  # (6,)
    free_rate: Float  # of the arms' free motions [1/s]
    free_stiffness: Float  # of the arms' free motions [1/s^2]; 0: they are not held
    squeezes: Flag  # whether there are internal forces
    # see multiarm.control.grip; of forces within friction
    pushing: Ints1  # (C,) none: friction is not counted
    friction: Floats1  # (C,)
    least: Float  # [N]
    # see multiarm.control.squeeze
    forces_of_contacts: Floats1  # (N,) [N]
    wrenches_of_connections: Floats2  # (C, 6) axes of the object that is pressed [N, N m]
    pressed: Ints1  # (C,) this object
    # see multiarm.control.object_path.PosePaths
    times: Floats2
    positions: Floats3
    shifts: Floats3
    quaternions: Floats3
    turns: Floats3


class JointTargets(Numbers):
    """What holds of the accelerations that are commanded."""

    # the targets of no robot depend on each other, and all accelerations have derivatives
    independent: Flag


class ObjectCommand(NamedTuple):
    """What a law commands, and what its derivative needs."""

    acceleration: Floats1  # (6 F,) of the objects; of an impedance zero
    preferred: Floats1  # (n,) joint accelerations of the free motions
    a_j: Floats1  # (n,) the nearest ones that the joints allow
    target: Floats1  # (N,) of these: W^T q''
    multipliers: Floats1  # (N,) M (q'' - preferred) = W multipliers
    # (C, 6) of the accelerations that hold the poses of connections, world axes
    held: Floats2
    targets: JointTargets
    derivatives: PreparedDerivatives

    @classmethod
    def of(cls, data: Data) -> ObjectCommand:
        """Allocate for some data."""
        joints, contacts = data.model.layout.rate_count, data.model.layout.contacts
        return cls(
            acceleration=np.zeros(data.model.layout.node),
            preferred=np.zeros(joints),
            a_j=np.zeros(joints),
            target=np.zeros(contacts),
            multipliers=np.zeros(contacts),
            held=np.zeros((len(data.model.layout.owners), 6)),
            targets=JointTargets(),
            derivatives=PreparedDerivatives(),
        )


open_object_law = view_of_law(ObjectLaw)
open_command = view_of_work(ObjectCommand, ObjectLaw)
