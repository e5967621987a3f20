"""Backends: what computes the terms of each robot of a system.

A backend reads positions and velocities of its robots from given arrays and writes inertia, bias,
Jacobian and the motion of the tip's link at fixed addresses, where kernels find them through a
table (:mod:`multiarm.robots.terms`).  There are two: Pinocchio, called back in Python, and batched
RNEA and CRBA in compiled code (:mod:`multiarm.robots.compiled`).  A system may have robots of both.

Of Pinocchio two calls, ``crba`` in the world convention and ``nonLinearEffects``, compute all that
a group of robots in one model needs.  The kernels read it where Pinocchio keeps it: nothing is
copied and no Python object is made inside a step.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from multiarm.errors import ModelError
from multiarm.jit.pointers import PythonCallback
from multiarm.jit.rows import fields_of, width
from multiarm.robots.compiled.backend import CompiledBackend, compile_robots, floating_bases
from multiarm.robots.robot import Robot, named_with_prefix
from multiarm.robots.terms import (
    ADDRESSES,
    Coriolis,
    CoriolisCalls,
    LinkAddresses,
    MatrixAddress,
    RobotFunctions,
    RobotState,
    TermAddresses,
)

# More robots in a model mean fewer calls, but a larger and mostly empty inertia matrix: the cost of
# each is flat around eight.
ROBOTS_PER_GROUP = 8


class Backends:
    """The robots of one system and the backends that compute their terms.

    Parameters
    ----------
    robots : mapping of str to Robot
    gravity : ndarray, shape (3,)
    with_gravity_torque : bool
        Whether the control needs the gravity torques.
    compiled : bool
        Compile the robots for which that is possible, verified against Pinocchio's.

    Attributes
    ----------
    by_robot : dict of str to str
        ``"compiled"`` or ``"pinocchio"``.
    reasons : dict of str to str
        Why a robot stays with Pinocchio although ``compiled`` is set.
    links : tuple of (int, int)
        The links that carry tips: robot and Pinocchio's number of the joint that moves them.
    pointers : int64 ndarray, shape (robots, 5)
        Every :class:`multiarm.robots.terms.TermAddresses`; valid while this lives.
    link_pointers : int64 ndarray, shape (links, 3)
        Every :class:`multiarm.robots.terms.LinkAddresses`; valid while this lives.
    q_slots : int64 ndarray, shape (joints,)
        Index of each joint in Pinocchio's configuration; -1 for those of compiled robots and of
        floating bases.
    base_slots : int64 ndarray, shape (bases,)
        Index there of the pose of every floating base; -1 for those of compiled robots.
    configuration : int
        Size of that configuration.
    """

    def __init__(
        self,
        robots: Mapping[str, Robot],
        gravity: np.ndarray,
        with_gravity_torque: bool,
        compiled: bool = False,
    ) -> None:
        self._compiled: CompiledBackend | None = None
        self._groups: list[RobotGroup] = []
        self._coriolis: tuple[Coriolis, PythonCallback | None] | None = None
        self.reasons: dict[str, str] = {}
        self.by_robot = dict.fromkeys(robots, "pinocchio")
        self.links = tuple(
            (number, joint)
            for number, robot in enumerate(robots.values())
            for joint in dict.fromkeys(tip.joint for tip in robot.tips.values())
        )
        if compiled:
            self._compiled, self.reasons = compile_robots(robots, gravity, self.links)
        for name, reason in self.reasons.items():
            warnings.warn(f"{robots[name].text} stays with Pinocchio: {reason}", stacklevel=2)
        names, in_order = list(robots), list(robots.values())
        if self._compiled is not None:
            self.by_robot |= {names[place]: "compiled" for place in self._compiled.places}
            if with_gravity_torque:
                self._compiled.want_gravity_torque()
        first_joints = np.cumsum([0, *(robot.dof for robot in in_order)])
        self.q_slots = np.full(first_joints[-1], -1, dtype=np.int64)
        bases = floating_bases(robots)
        self.base_slots = np.full(sum(robot.floats for robot in in_order), -1, dtype=np.int64)
        self.configuration = 0
        of_pinocchio = [k for k, name in enumerate(names) if self.by_robot[name] == "pinocchio"]
        for places in _neighbours(of_pinocchio):
            start = int(first_joints[places[0]]), self.configuration
            members = [in_order[place] for place in places]
            group = RobotGroup(members, places[0], start, gravity, with_gravity_torque)
            self._groups.append(group)
            slots = group.q_slots
            self.q_slots[group.joints] = np.where(slots < 0, -1, slots + self.configuration)
            of_bases = [bases[place] for place in places if in_order[place].floats]
            self.base_slots[of_bases] = np.array(group.base_slots, dtype=np.int64)
            self.base_slots[of_bases] += self.configuration
            self.configuration += group.model.nq
        self._fill_tables()

    def copy(self) -> Backends:
        """The same robots with their own terms; models and tables are shared."""
        twin = copy(self)
        twin._compiled = None if self._compiled is None else self._compiled.copy()
        twin._groups = [group.copy() for group in self._groups]
        twin._coriolis = None
        twin._fill_tables()
        return twin

    def connect(
        self,
        angles: np.ndarray,
        rates: np.ndarray,
        base_poses: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        bodies: np.ndarray,
        status: Any,
    ) -> RobotFunctions:
        """Let all robots read positions and velocities, and write the motion of their last links.

        Parameters
        ----------
        angles, rates, base_poses, q, v, bodies : ndarray
            See :class:`multiarm.robots.terms.RobotState`.
        status : Numbers
            ``failed`` is set when Pinocchio raises, ``potential_energy`` where that is wanted.
        """
        self._state = RobotState(angles, rates, base_poses, q, v, bodies)
        addresses = {} if self._compiled is None else self._compiled.connect(self._state)
        callbacks: dict[str, PythonCallback] = {}
        if self._groups:
            updates = [group.bind(self._state) for group in self._groups]
            callbacks["pinocchio"] = PythonCallback(_all_of(updates), status)
            if any(np.any(group.model.gravity.linear) for group in self._groups):
                energy = PythonCallback(self._energy_update(status), status)
                callbacks["pinocchio_energy"] = energy
        addresses |= {name: call.address for name, call in callbacks.items()}
        return RobotFunctions(addresses, callbacks)

    def coriolis(self, status: Any) -> tuple[Coriolis, PythonCallback | None]:
        """Addresses of the matrices of Coriolis forces and of the functions that update them.

        The second result is Pinocchio's callback among these; None where all robots are compiled.

        Raises
        ------
        ModelError
            When a compiled matrix is not Pinocchio's.
        """
        if self._coriolis is None:
            matrices = np.zeros((len(self.by_robot), width(MatrixAddress)), dtype=np.int64)
            coriolis, call = Coriolis(CoriolisCalls(), matrices), None
            if self._compiled is not None:
                self._compiled.connect_coriolis(coriolis)
            if self._groups:
                updates = [group.bind_coriolis(self._state, matrices) for group in self._groups]
                call = PythonCallback(_all_of(updates), status)
                coriolis.calls.callback = call.address
            self._coriolis = coriolis, call
        return self._coriolis

    def want_factors(self, inertias: bool) -> None:
        """Let compiled robots write the factors of their inertias, or both."""
        if self._compiled is not None:
            self._compiled.want_factors(inertias)

    def pose_address(self, robot: int, joint: int) -> int:
        """Address of the pose of a joint of a robot (0: the world): rotation by columns, origin."""
        if self._compiled is not None and robot in self._compiled.places:
            return self._compiled.pose_address(robot, joint)
        group = self._group_of(robot)
        return group.pose_address(robot - group.place, joint)

    def _energy_update(self, status: Any) -> Callable[[], None]:
        def update() -> None:
            energies = [group.potential_energy(self._state) for group in self._groups]
            status.potential_energy = sum(energies)

        return update

    def _fill_tables(self) -> None:
        pointers = np.zeros((len(self.by_robot), ADDRESSES), dtype=np.int64)
        if self._compiled is not None:
            pointers[list(self._compiled.places)] = self._compiled.pointers
        for group in self._groups:
            pointers[group.place : group.place + len(group.pointers)] = group.pointers
        self.pointers = pointers
        addresses = [self._link_addresses(*link) for link in self.links]
        self.link_pointers = np.array(addresses, dtype=np.int64)

    def _link_addresses(self, robot: int, joint: int) -> LinkAddresses:
        if self._compiled is not None and robot in self._compiled.places:
            return LinkAddresses()
        group = self._group_of(robot)
        return group.link_addresses(robot - group.place, joint)

    def _group_of(self, robot: int) -> RobotGroup:
        return next(group for group in reversed(self._groups) if group.place <= robot)


class Ground:
    """The surroundings as a robot without joints.

    ``addresses`` are those of its terms; valid while this lives.
    """

    def __init__(self) -> None:
        self._nothing = np.zeros(1)
        at = _address(self._nothing)
        self.addresses = TermAddresses(at, stride=1, jacobian=at, bias=at, gravity_torque=at)


class RobotGroup:
    """Neighbouring robots in one Pinocchio model.

    Attributes
    ----------
    place : int
        Number of its first robot among all.
    joints, numbers : slice
        Its joints in the stacked vectors, and its part of Pinocchio's configuration.
    q_slots : int64 ndarray
        As of the ``Backends``, in this part.
    base_slots : list of int
        The same of floating bases.
    pointers : int64 ndarray, shape (robots, 5)
        Rows of ``Backends.pointers``.
    """

    def __init__(
        self,
        robots: list[Robot],
        place: int,
        start: tuple[int, int],
        gravity: np.ndarray,
        with_gravity_torque: bool,
    ) -> None:
        model = pin.Model()
        for robot in robots:
            model = pin.appendModel(model, named_with_prefix(robot), 0, pin.SE3.Identity())
        model.gravity.linear = gravity
        model.armature = np.concatenate([robot.model.armature for robot in robots])  # not appended
        self.model, self.data = model, model.createData()
        self.place = place
        self.joints = slice(start[0], start[0] + model.nv)
        self.numbers = slice(start[1], start[1] + model.nq)
        first_dof = np.cumsum([0] + [robot.dof for robot in robots])
        self._joints_before = np.cumsum([0] + [robot.model.njoints - 1 for robot in robots])
        slots: list[int] = []
        numbers: list[int] = []
        for joint in model.joints[1:]:
            numbers += range(joint.idx_v, joint.idx_v + joint.nv)
            slots += [joint.idx_q] if joint.nv == 1 else [-1] * joint.nv
        self.q_slots = np.array(slots, dtype=np.int64)
        first_of_robots = [model.joints[int(k) + 1].idx_q for k in self._joints_before[:-1]]
        pairs = zip(robots, first_of_robots, strict=True)
        self.base_slots = [slot for robot, slot in pairs if robot.floats]
        if numbers != list(range(model.nv)):
            raise ModelError("Pinocchio did not number the joints of several robots in order")
        self.pointers = np.zeros((len(robots), ADDRESSES), dtype=np.int64)
        self._first_dof = first_dof
        self._fill_pointers()
        self._with_gravity_torque = with_gravity_torque

    def copy(self) -> RobotGroup:
        """The same robots with their own terms; the model is shared."""
        twin = copy(self)
        twin.data, twin.pointers = self.model.createData(), np.zeros_like(self.pointers)
        twin._fill_pointers()
        return twin

    def bind(self, state: RobotState) -> Callable[[], None]:
        """Function without arguments that updates all terms from positions and velocities."""
        model, data = self.model, self.data
        q, v = state.q[self.numbers], state.v[self.joints]
        crba, bias, world = pin.crba, pin.nonLinearEffects, pin.Convention.WORLD
        gravity_torque = pin.computeGeneralizedGravity

        def update() -> None:
            crba(model, data, q, world)
            bias(model, data, q, v)

        def update_with_gravity_torque() -> None:
            # first, because it overwrites data.a_gf, whose values must be those of nonLinearEffects
            gravity_torque(model, data, q)
            crba(model, data, q, world)
            bias(model, data, q, v)

        return update_with_gravity_torque if self._with_gravity_torque else update

    def bind_coriolis(self, state: RobotState, matrices: np.ndarray) -> Callable[[], None]:
        """Function that updates the matrices of Coriolis forces; writes where these are."""
        model, data, n = self.model, self.model.createData(), self.model.nv
        q, v = state.q[self.numbers], state.v[self.joints]
        run = pin.computeCoriolisMatrix

        def update() -> None:
            run(model, data, q, v)

        update()
        at = _address(data.C)
        _require_layout(data.C.strides == (8, 8 * n) or n == 1, "C is not stored densely")
        first_dof, group = self._first_dof[:-1], slice(self.place, self.place + len(self.pointers))
        of_group = fields_of(MatrixAddress, matrices[group])
        of_group.at[:], of_group.stride[:] = at + 8 * (n + 1) * first_dof, n
        return update

    def pose_address(self, robot: int, joint: int) -> int:
        """Address of the pose of a joint of the group's robot number ``robot``."""
        return _address(self.data.oMi[self._joint(robot, joint)].rotation)

    def link_addresses(self, robot: int, joint: int) -> LinkAddresses:
        """Addresses of the motion of the link that a joint of the group's robot ``robot`` moves."""
        data, joint = self.data, self._joint(robot, joint)
        pose, twist, drift = data.oMi[joint], data.v[joint], data.a_gf[joint]
        at = _address(pose.rotation)
        _require_layout(_address(pose.translation) == at + 72, "SE3 is not [R, p]")
        for motion in (twist, drift):
            near = _address(motion.angular) == _address(motion.linear) + 24
            _require_layout(near, "Motion is not [linear, angular]")
        return LinkAddresses(at, _address(twist.linear), _address(drift.linear))

    def _joint(self, robot: int, joint: int) -> int:
        """Number in the group's model of a joint of its robot number ``robot``; 0: the world."""
        return int(self._joints_before[robot]) + joint if joint > 0 else 0

    def potential_energy(self, state: RobotState) -> float:
        """Potential energy of all links [J], zero at the world's origin."""
        return pin.computePotentialEnergy(self.model, self.data, state.q[self.numbers])

    def _fill_pointers(self) -> None:
        """Read addresses once; check the memory layout that the kernels rely on."""
        model, data, n = self.model, self.data, self.model.nv
        q, v = pin.neutral(model), np.zeros(n)
        pin.crba(model, data, q, pin.Convention.WORLD)
        pin.nonLinearEffects(model, data, q, v)
        pin.computeGeneralizedGravity(model, data, q)
        _require_layout(data.M.strides == (8, 8 * n) or n == 1, "M is not stored by columns")
        J = data.J
        _require_layout(J.size == 6 * n and J.strides[0] == 8, "J is not stored by columns")
        for row, d in enumerate(self._first_dof[:-1].tolist()):
            self.pointers[row] = TermAddresses(
                inertia=_address(data.M) + 8 * (d * n + d),
                stride=n,
                jacobian=_address(J) + 8 * 6 * d,
                bias=_address(data.nle) + 8 * d,
                gravity_torque=_address(data.g) + 8 * d,
            )


def _address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def _require_layout(condition: bool, what: str) -> None:
    if not condition:
        raise ModelError(
            f"this build of Pinocchio ({pin.__version__}) stores its data differently ({what}); "
            f"install pin 4.x from PyPI"
        )


def _neighbours(places: Sequence[int]) -> Iterator[list[int]]:
    """Runs of at most ``ROBOTS_PER_GROUP`` consecutive numbers, as even as possible."""
    runs = np.split(np.array(places, dtype=int), np.flatnonzero(np.diff(places) != 1) + 1)
    for run in runs:
        count = -(-len(run) // ROBOTS_PER_GROUP)
        bounds = np.linspace(0, len(run), count + 1).round().astype(int)
        for a, b in pairwise(bounds):
            yield run[a:b].tolist()


def _all_of(updates: list[Callable[[], None]]) -> Callable[[], None]:
    if len(updates) == 1:
        return updates[0]

    def update_all() -> None:
        for update in updates:
            update()

    return update_all
