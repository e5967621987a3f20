"""Terms of robot dynamics: where kernels find them, and named arrays of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from multiarm.jit.pointers import PythonCallback
from multiarm.jit.rows import Axes, Number, Pair, Vector, row_of, width
from multiarm.jit.structs import Int, Numbers
from multiarm.public import public_names


class TermAddresses(NamedTuple):
    """Addresses of the float64 terms of a robot or of a block of its joints, a row of int64."""

    inertia: Number  # where there are factors, it is made from them when it is wanted
    stride: Number  # of the inertia, in numbers
    # (n, 6): the columns one after the other, each as if its joint moved all links
    jacobian: Number
    bias: Number
    gravity_torque: Number
    factors: Number = 0  # (n, 13) rows of :class:`JointFactor`, 0 where there are none

    @property
    def inertia_matrix(self) -> MatrixAddress:
        """Where the inertia is."""
        return MatrixAddress(self.inertia, self.stride)

    def from_joint(self, first: int) -> TermAddresses:
        """Addresses of the terms of a robot's joints from number ``first`` on."""
        return TermAddresses(
            *self.inertia_matrix.from_joint(first),
            jacobian=self.jacobian + NUMBER_BYTES * 6 * first,
            bias=self.bias + NUMBER_BYTES * first,
            gravity_torque=self.gravity_torque + NUMBER_BYTES * first,
            factors=self.factors + NUMBER_BYTES * FACTOR_WIDTH * first if self.factors else 0,
        )


class LinkAddresses(NamedTuple):
    """Addresses of the motion of a link in Pinocchio's layout, a row of int64.

    0 for compiled robots, which write it into ``RobotState.bodies``.
    """

    pose: Number = 0
    twist: Number = 0
    drift: Number = 0


NUMBER_BYTES = np.dtype(float).itemsize
BASE_DOF = 6
"""Velocities of a floating base."""
BASE_POSE = 7
"""Numbers of its pose: position, quaternion xyzw."""
ADDRESSES, open_addresses = width(TermAddresses), row_of(TermAddresses)
open_link_addresses = row_of(LinkAddresses)


class LinkPose(NamedTuple):
    """Pose of a link in the world, as Pinocchio keeps it."""

    axes: Axes
    origin: Vector  # [m]


POSE_WIDTH, open_pose = width(LinkPose), row_of(LinkPose)


class JointFactor(NamedTuple):
    r"""What a joint has of the factors of its robot's inertia.

    With the column S of each joint, about the robot's base, and the inertia :math:`I^A` of the
    articulated body that begins at its link (R. Featherstone, Rigid Body Dynamics Algorithms, 2008,
    7.3),

    .. math::
        M = L^T \operatorname{diag}(p)\, L, \qquad p_j = S_j\cdot I^A_j S_j, \qquad
        L_{jj} = 1, \qquad L_{jk} = S_k\cdot V_j, \qquad V_j = I^A_j S_j / p_j

    for all joints k on the way from the base to j.  A floating base has six joints, along and about
    the axes of the world, in the order of its twist.
    """

    column: Pair  # S
    force: Pair  # V
    inverse: Number  # 1 / p


FACTOR_WIDTH = width(JointFactor)
VANISHING_INERTIA = 1e-300
"""Added to each p, which rounds it away unless p is zero: so the inverses are finite."""


class RobotTerms(NamedTuple):
    r"""One robot at one state: ``M q'' + bias = tau + J^T f`` (thesis, 3.1, in joint space).

    M : (n, n)
        Joint-space inertia, symmetric.
    bias : (n,)
        Coriolis, centrifugal and gravity forces [N m or N].
    J : (6, n)
        Jacobian of the tip frame: world axes, at the tip's origin.
    tip_position, tip_rotation : (3,), (3, 3)
        Pose of the tip in the world.
    tip_twist : (6,)
        Velocity of the tip's origin and angular velocity, world axes.
    drift : (6,)
        Classical acceleration of the tip at ``q'' = 0``, i.e. ``dJ/dt q'``; without gravity.
    """

    M: np.ndarray
    bias: np.ndarray
    J: np.ndarray
    tip_position: np.ndarray
    tip_rotation: np.ndarray
    tip_twist: np.ndarray
    drift: np.ndarray


@dataclass(frozen=True, eq=False)
class TipKinematics:
    r"""Pose, twist and Jacobian of a robot's tip frame at a state.

    .. math:: \begin{bmatrix} \dot x \\ \omega \end{bmatrix} = J(q)\,\dot q

    with the tip's origin ``x`` and its angular velocity ``omega`` in world axes (Pinocchio's
    ``LOCAL_WORLD_ALIGNED``).  The arrays are copies.

    Attributes
    ----------
    position : ndarray, shape (3,)
        Origin of the tip frame in world axes [m].
    rotation : ndarray, shape (3, 3)
        Its axes, as columns, in world axes.
    twist : ndarray, shape (6,)
        Velocity of the tip's origin [m/s] and angular velocity [rad/s], world axes.
    jacobian : ndarray, shape (6, n)
        ``twist = jacobian @ joint_velocities``; world axes, at the tip's origin.  Of a robot with a
        floating base (6, 6 + n): the twist of the base stands before the joint velocities.
    joint_names : tuple of str
        The joints of the last n columns, from base to tip: those that the robot moves.  A locked
        joint, such as the trunk of a robot with several arms, has none.
    """

    position: np.ndarray
    rotation: np.ndarray
    twist: np.ndarray
    jacobian: np.ndarray
    joint_names: tuple[str, ...]

    __dir__ = public_names


class RobotState(NamedTuple):
    """Inputs of a backend, and the array for the motion of the links that carry tips.

    angles, rates : (joints,)
        Positions and velocities of the joints of all robots; the first six of a robot whose base
        floats are zero, and the twist of its base.
    base_poses : (B, 7)
        Of the floating bases: position, quaternion xyzw.
    q, v : (numbers,), (joints,)
        The same as configuration and velocity of Pinocchio.
    bodies : (links, 24)
        Motion of the links of ``Backends.links``, see
        :class:`multiarm.contacts.motion.BodyMotion`.
    """

    angles: np.ndarray
    rates: np.ndarray
    base_poses: np.ndarray
    q: np.ndarray
    v: np.ndarray
    bodies: np.ndarray


class RobotFunctions(NamedTuple):
    """Functions that update the terms of robots.

    addresses : dict of str to int
        Fields of :class:`multiarm.dynamics.variables.Functions`.
    callbacks : dict of str to PythonCallback
        Those that enter Python; empty where all robots are compiled.
    """

    addresses: dict[str, int]
    callbacks: dict[str, PythonCallback]


class CoriolisCalls(Numbers):
    """Addresses of the functions that update the robots' matrices of Coriolis forces; 0: none."""

    callback: Int  # Pinocchio's
    compiled: Int  # with the address and the size of its struct:
    robots_struct: Int
    robots_size: Int


class MatrixAddress(NamedTuple):
    """Where a matrix is: a row of int64."""

    at: Number
    stride: Number  # in numbers

    def from_joint(self, first: int) -> MatrixAddress:
        """Where its part is of a robot's joints from number ``first`` on."""
        return MatrixAddress(self.at + NUMBER_BYTES * first * (self.stride + 1), self.stride)


open_matrix = row_of(MatrixAddress)


NO_COPIES = np.zeros((0, 6), dtype=np.int64)


class Coriolis(NamedTuple):
    """Matrices of Coriolis forces, and what updates them.

    calls : CoriolisCalls
    matrices : int64 (n, 2)
        The :class:`MatrixAddress` of each robot, or of each block of the equations.
    copies : int64 (k, 6)
        Fill those of blocks of several robots, see :mod:`multiarm.robots.joined`.
    """

    calls: CoriolisCalls
    matrices: np.ndarray
    copies: np.ndarray = NO_COPIES


class TreeStructure(NamedTuple):
    """Structure of a robot: a tree of ``n`` joints, each with the link that it moves.

    Of a robot whose base floats the first joint is that of its base, which has six velocities: the
    twist of the base in world axes.  All others follow after it.

    parents : int64 (n,)
        Number of the joint before each joint, counted from 0, less than its own; -1: the base.
    slides, floats : bool (n,)
        Prismatic joints, and floating bases; the others are revolute.
    axes : (n, 3)
        Unit vector of the joint's motion, in its own frame; of a floating base z.
    rotations, translations : (n, 3, 3), (n, 3)
        The joint's frame at zero in that of its parent; without one, in the world [m].
    masses, centres, inertias : (n,), (n, 3), (n, 3, 3)
        Of the link [kg], its centre of mass [m] and inertia about it [kg m^2], in the joint's
        frame.
    armature : (n,)
        Inertia of the drive reflected to the joint [kg m^2 or kg].
    """

    parents: np.ndarray
    slides: np.ndarray
    floats: np.ndarray
    axes: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray
    masses: np.ndarray
    centres: np.ndarray
    inertias: np.ndarray
    armature: np.ndarray

    @property
    def base_floats(self) -> bool:
        """Whether the first joint is that of a floating base."""
        return bool(self.floats[0])

    @property
    def dof(self) -> int:
        """Numbers of a velocity."""
        return self.number_of(self.parents.size)

    @property
    def parent_numbers(self) -> np.ndarray:
        """As of :class:`multiarm.robots.robot.Robot`, shape (dof,)."""
        numbers = [self.number_of(int(k)) if k >= 0 else -1 for k in self.parents]
        if not self.base_floats:
            return np.array(numbers, dtype=np.int64)
        after = [BASE_DOF - 1 if number == 0 else number for number in numbers[1:]]
        return np.array([*range(-1, BASE_DOF - 1), *after], dtype=np.int64)

    def number_of(self, joint: int) -> int:
        """The place of a joint's rate among the numbers of a velocity."""
        return joint + (BASE_DOF - 1 if self.base_floats and joint > 0 else 0)

    def standing_on(self, pose: np.ndarray) -> TreeStructure:
        """Structure of the joints after a floating base, which stands at a pose (4, 4)."""
        tree = TreeStructure(*(values[1:].copy() for values in self))
        first = self.parents[1:] == 0
        tree.translations[first] = pose[:3, 3] + tree.translations[first] @ pose[:3, :3].T
        tree.rotations[first] = pose[:3, :3] @ tree.rotations[first]
        return tree._replace(parents=tree.parents - 1)

    def part(self, first: int, count: int) -> TreeStructure:
        """Structure of neighbouring joints that neither carry others nor are carried by them."""
        part = TreeStructure(*(values[first : first + count] for values in self))
        parents = np.where(part.parents >= 0, part.parents - first, -1)
        return part._replace(parents=parents)


class LinkTerms(NamedTuple):
    r"""One robot at one state, as the time loop uses it.

    inertia : (n, n)
        Of the joints.
    jacobian : (6, n)
        Each column as if its joint moved the whole robot: world axes, about the world's origin.
    bias, gravity_torque : (n,)
        Coriolis, centrifugal and gravity forces; the gravity forces alone.
    poses : (n, 12)
        Of the links of all joints of its structure in the world, see :class:`LinkPose`.
    bodies : (m, 24)
        Motion of the links that take part in connections, see
        :class:`multiarm.contacts.motion.BodyMotion`.
    energy : (1,)
        Potential energy [J], zero at the world's origin.
    factored : (n, n)
        The product of the factors of the inertia, see :class:`JointFactor`.
    coriolis : (n, n)
        Matrix ``C`` for which the rate of the inertia is ``C + C^T``, and ``C q'`` the bias without
        gravity; zero where the base floats.
    """

    inertia: np.ndarray
    jacobian: np.ndarray
    bias: np.ndarray
    gravity_torque: np.ndarray
    poses: np.ndarray
    bodies: np.ndarray
    energy: np.ndarray
    factored: np.ndarray
    coriolis: np.ndarray
