"""The compiled backend: robots whose terms batched kernels compute, verified against Pinocchio.

Every compiled robot is compared with Pinocchio at random states before it is used.  The states are
the same for the same robot: its structure is the seed.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence

import numpy as np

from multiarm.contacts.motion import BODY_WIDTH, BodyMotion
from multiarm.errors import ModelError
from multiarm.jit.pointers import address_of, call_whole
from multiarm.jit.rows import as_row, fields_of, offset_of
from multiarm.jit.structs import struct_of
from multiarm.robots.compiled.branches import most_in_a_row
from multiarm.robots.compiled.coriolis import update_coriolis
from multiarm.robots.compiled.kernels import update_robots
from multiarm.robots.compiled.packing import BodyLink, make_tables
from multiarm.robots.compiled.reference import at_rest, pinocchio_terms
from multiarm.robots.compiled.tables import (
    JACOBIAN_WIDTH,
    MOST_JOINTS,
    RobotTables,
    TermOffsets,
    Wanted,
    make_terms,
    make_work,
)
from multiarm.robots.robot import Robot
from multiarm.robots.terms import (
    BASE_DOF,
    BASE_POSE,
    FACTOR_WIDTH,
    POSE_WIDTH,
    Coriolis,
    JointFactor,
    LinkPose,
    LinkTerms,
    MatrixAddress,
    RobotState,
    TermAddresses,
    TreeStructure,
)

# Number of random states; bounds of positions [rad, m] and velocities [rad/s, m/s].
STATES, LARGEST_POSITION, LARGEST_VELOCITY = 8, np.pi, 3.0
CORIOLIS = ("coriolis",)
EVERY_EVALUATION = tuple(name for name in LinkTerms._fields if name not in CORIOLIS)
_WORDS = {
    "inertia": "the inertia",
    "jacobian": "the Jacobian",
    "bias": "the bias force",
    "gravity_torque": "the gravity torque",
    "poses": "the pose of a link",
    "bodies": "the motion of a link",
    "energy": "the potential energy",
    "factored": "the product of the factors of the inertia",
    "coriolis": "the matrix of Coriolis forces",
}
# Where parts of a quantity begin that have other units.
_PARTS = {
    "bodies": tuple(offset_of(BodyMotion, name) for name in ("origin", "velocity", "acceleration")),
    "poses": (offset_of(LinkPose, "origin"),),
}


def compile_robots(
    robots: Mapping[str, Robot], gravity: np.ndarray, links: Sequence[tuple[int, int]]
) -> tuple[CompiledBackend | None, dict[str, str]]:
    """Backend of all robots that can be compiled, verified against Pinocchio.

    Parameters
    ----------
    robots : mapping of str to Robot
    gravity : ndarray, shape (3,)
    links : sequence of (int, int)
        The links whose motion is written to the rows of ``RobotState.bodies``: the robot's number,
        and Pinocchio's number of the joint that moves the link (0: the base).

    Returns
    -------
    backend : CompiledBackend or None
        None where no robot can be compiled.
    reasons : dict of str to str
        Why each other robot is not.

    Raises
    ------
    ModelError
        When a compiled robot does not agree with Pinocchio.
    """
    structures: dict[int, TreeStructure] = {}
    reasons: dict[str, str] = {}
    for place, (name, robot) in enumerate(robots.items()):
        try:
            structures[place] = _structure(robot)
        except ModelError as reason:
            reasons[name] = str(reason)
    if not structures:
        return None, reasons
    first = np.cumsum([0, *(robot.dof for robot in robots.values())])
    places = tuple(structures)
    first_joints = [int(first[place]) for place in places]
    bodies = body_links(list(structures.values()), places, links)
    bases = floating_bases(robots)
    tables = make_tables(
        list(structures.values()), first_joints, bodies, gravity, [bases[k] for k in places]
    )
    verify(tables, places, robots, links)
    return CompiledBackend(tables, places, robots, links), reasons


class CompiledBackend:
    """Robots of one system in compiled code, four branches at a time.

    See :mod:`multiarm.robots.backends`.  The sweep writes the motion of the links that take part in
    connections into ``RobotState.bodies``.

    Parameters
    ----------
    tables : RobotTables
        Constants, which several systems may share.
    places : sequence of int
        The robots' numbers among all robots of the scene.
    robots : mapping of str to Robot
        All robots of the scene, against which the compiled ones are verified.
    links : sequence of (int, int)
        See :func:`compile_robots`.
    """

    def __init__(
        self,
        tables: RobotTables,
        places: Sequence[int],
        robots: Mapping[str, Robot],
        links: Sequence[tuple[int, int]],
    ) -> None:
        self.tables, self.places, self._robots, self._links = tables, tuple(places), robots, links
        self._terms, self._coriolis = make_terms(tables), make_terms(tables)
        self._world = as_row(LinkPose(np.eye(3), np.zeros(3)))
        self._offsets = [TermOffsets(*row) for row in tables.robots.tolist()]
        self.pointers = np.array([self._pointers(offsets) for offsets in self._offsets])

    def copy(self) -> CompiledBackend:
        """The same robots with their own terms; the constants are shared."""
        tables = self.tables._replace(wanted=self.tables.wanted.copy())  # flags of one system
        return CompiledBackend(tables, self.places, self._robots, self._links)

    def bind(
        self, angles: np.ndarray, rates: np.ndarray, base_poses: np.ndarray, bodies: np.ndarray
    ) -> None:
        """Let the sweeps read positions and velocities of all joints, and write all bodies.

        Links of a fixed base are at rest: their rows are written here.
        """
        self._work = make_work(
            self.tables, angles, rates, base_poses, bodies, self._terms, self._coriolis
        )
        self._struct = struct_of(self.tables, self._work)
        for row, (place, joint) in enumerate(self._links):
            if joint == 0 and place in self.places:
                bodies.reshape(-1, BODY_WIDTH)[row] = at_rest()

    def connect(self, state: RobotState) -> dict[str, int]:
        """Addresses of the function that updates all terms and of its struct, and its size."""
        self.bind(state.angles, state.rates, state.base_poses, state.bodies)
        struct = self._struct
        return {
            "robots": address_of(update_robots),
            "robots_struct": struct.ctypes.data,
            "robots_size": struct.size,
        }

    def connect_coriolis(self, coriolis: Coriolis) -> None:
        """Write the places of the matrices, and the function that updates them with its struct.

        Raises
        ------
        ModelError
            When a compiled matrix is not Pinocchio's.
        """
        verify(self.tables, self.places, self._robots, self._links, CORIOLIS)
        at = self._coriolis.ctypes.data
        for place, offsets in zip(self.places, self._offsets, strict=True):
            coriolis.matrices[place] = MatrixAddress(at + 8 * offsets.inertia, offsets.stride)
        calls, struct = coriolis.calls, self._struct
        calls.compiled, calls.robots_struct = address_of(update_coriolis), struct.ctypes.data
        calls.robots_size = struct.size

    def want_gravity_torque(self) -> None:
        """Write gravity torques too."""
        self.tables.wanted.gravity_torque = True

    def want_factors(self, inertias: bool) -> None:
        """Write the factors of the inertias of robots that are no plain arms, or both."""
        self.tables.wanted.factors, self.tables.wanted.inertias = True, inertias

    def pose_address(self, place: int, joint: int) -> int:
        """Address of the pose of a joint, which is written from now on; joint 0 is the world."""
        if joint == 0:
            return self._world.ctypes.data
        self.tables.wanted.poses = True
        offsets = self._offsets[self.places.index(place)]
        poses = offsets.poses + POSE_WIDTH * (joint - _first_link(offsets.joints > offsets.links))
        return self._terms.ctypes.data + 8 * poses

    def update(self, with_coriolis: bool = False) -> None:
        """Compute all terms at the positions and velocities bound, from Python."""
        for entry in (update_robots, update_coriolis) if with_coriolis else (update_robots,):
            call_whole(entry, self._struct)

    def terms(self, robot: int) -> LinkTerms:
        """Copies of the last terms of robot number ``robot`` of these."""
        at, terms, n = self._offsets[robot], self._terms, self._offsets[robot].joints
        lower = np.tril(_square(terms, at.inertia, at.stride, n))
        inertia = lower + np.tril(lower, -1).T
        jacobian = terms[at.jacobian : at.jacobian + JACOBIAN_WIDTH * n].reshape(n, 6)
        rows = [row for row, link in enumerate(self._links) if link[0] == self.places[robot]]
        return LinkTerms(
            inertia=inertia,
            jacobian=jacobian.T.copy(),
            bias=terms[at.bias : at.bias + n].copy(),
            gravity_torque=terms[at.gravity_torque : at.gravity_torque + n].copy(),
            poses=terms[at.poses : at.poses + POSE_WIDTH * at.links].reshape(-1, POSE_WIDTH).copy(),
            bodies=self._work.bodies.reshape(-1, BODY_WIDTH)[rows].copy(),
            energy=np.sum(terms[at.energy : at.energy + at.energies], keepdims=True),
            factored=self._factored(robot) if at.factors else inertia,
            coriolis=_square(self._coriolis, at.inertia, at.stride, n).T.copy(),
        )

    def _factored(self, robot: int) -> np.ndarray:
        """The product of the factors of the inertia."""
        at, terms = self._offsets[robot], self._terms
        rows = terms[at.factors : at.factors + FACTOR_WIDTH * at.joints]
        of_joints = fields_of(JointFactor, rows.reshape(at.joints, FACTOR_WIDTH))
        on_way = np.eye(at.joints, dtype=bool)
        robots = list(self._robots.values())
        for joint, parent in enumerate(robots[self.places[robot]].parent_numbers):
            if parent >= 0:
                on_way[joint] |= on_way[parent]
        L = np.where(on_way, of_joints.force @ of_joints.column.T, 0.0)
        np.fill_diagonal(L, 1.0)
        return L.T @ (L / of_joints.inverse[:, None])

    def _pointers(self, offsets: TermOffsets) -> np.ndarray:
        at = self._terms.ctypes.data
        addresses = TermAddresses(
            inertia=at + 8 * offsets.inertia,
            stride=offsets.stride,
            jacobian=at + 8 * offsets.jacobian,
            bias=at + 8 * offsets.bias,
            gravity_torque=at + 8 * offsets.gravity_torque,
            factors=at + 8 * offsets.factors if offsets.factors else 0,
        )
        return np.array(addresses, dtype=np.int64)


def verify(
    tables: RobotTables,
    places: Sequence[int],
    robots: Mapping[str, Robot],
    links: Sequence[tuple[int, int]],
    quantities: Sequence[str] = EVERY_EVALUATION,
) -> None:
    """Compare compiled robots with Pinocchio's.

    ``places`` are the numbers of the compiled robots among all ``robots``, ``links`` those
    of :func:`compile_robots`, ``quantities`` fields of :class:`multiarm.robots.terms.LinkTerms`.

    Raises
    ------
    ModelError
        Naming the robot, the quantity, the difference and the remedy.
    """
    first = np.cumsum([0, *(robot.dof for robot in robots.values())])
    angles, rates = np.zeros(first[-1]), np.zeros(first[-1])
    wanted = Wanted(gravity_torque=True, poses=True, factors=True, inertias=True)
    copies = CompiledBackend(tables._replace(wanted=wanted), places, robots, links)
    bases = floating_bases(robots)
    poses = np.zeros((sum(robot.floats for robot in robots.values()), BASE_POSE))
    copies.bind(angles, rates, poses, np.zeros((len(links), BODY_WIDTH)))
    every = [list(robots.values())[place] for place in places]
    structures = [robot.structure() for robot in every]
    states = [_random_states(structure) for structure in structures]
    computed: list[list[LinkTerms]] = [[] for _ in every]
    for number in range(STATES):
        for place, (q, v, pose) in zip(places, states, strict=True):
            angles[first[place] : first[place + 1]] = q[number]
            rates[first[place] : first[place + 1]] = v[number]
            if every[places.index(place)].floats:
                poses[bases[place]] = pose[number]
        copies.update(with_coriolis=CORIOLIS[0] in quantities)
        for k, terms in enumerate(computed):
            terms.append(copies.terms(k))
    for k, (robot, structure, state) in enumerate(zip(every, structures, states, strict=True)):
        joints = [joint for place, joint in links if place == places[k]]
        expected = _stacked(pinocchio_terms(robot, joints, *state, tables.gravity))
        floors = {name: _floors(structure, expected, tables.gravity)[name] for name in quantities}
        _compare(robot, _stacked(computed[k]), expected, floors)


def _structure(robot: Robot) -> TreeStructure:
    structure = robot.structure()
    if structure.base_floats and structure.parents.size == 1:
        raise ModelError("its base floats and carries no joints")
    depth = most_in_a_row(structure.parents)
    if depth > MOST_JOINTS:
        raise ModelError(
            f"it has {depth} joints between base and a link; at most {MOST_JOINTS} are compiled"
        )
    return structure


def floating_bases(robots: Mapping[str, Robot]) -> list[int]:
    """Of each robot with a floating base its number among those bases."""
    return np.cumsum([0, *(robot.floats for robot in robots.values())])[:-1].tolist()


def body_links(
    structures: Sequence[TreeStructure], places: Sequence[int], links: Sequence[tuple[int, int]]
) -> list[BodyLink]:
    """The links of the compiled robots that joints or floating bases move, and their rows."""
    bodies = []
    for row, (place, joint) in enumerate(links):
        if place in places and joint > 0:
            robot = places.index(place)
            bodies.append(BodyLink(robot, joint - _first_link(structures[robot].base_floats), row))
    return bodies


def _first_link(floats: bool) -> int:
    """Pinocchio's number of the joint that moves the first link of a structure.

    A floating base is two joints of Pinocchio.
    """
    return 2 if floats else 1


def _square(numbers: np.ndarray, at: int, stride: int, size: int) -> np.ndarray:
    """View of the (size, size) matrix at an offset, with ``stride`` numbers a row."""
    return np.lib.stride_tricks.as_strided(numbers[at:], (size, size), (8 * stride, 8))


def _random_states(robot: TreeStructure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and velocities of a robot, each (8, n), and poses (8, 7) of a floating base."""
    rng = np.random.default_rng(zlib.crc32(b"".join(part.tobytes() for part in robot)))
    draw = rng.uniform(-1.0, 1.0, (2, STATES, robot.dof))
    angles, poses = LARGEST_POSITION * draw[0], rng.normal(size=(STATES, BASE_POSE))
    if robot.base_floats:
        angles[:, :BASE_DOF] = 0.0
        poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    return angles, LARGEST_VELOCITY * draw[1], poses


def _stacked(states: Sequence[LinkTerms]) -> LinkTerms:
    """The terms at all states, which are the first axis."""
    return LinkTerms(*(np.stack(values) for values in zip(*states, strict=True)))


def _floors(robot: TreeStructure, terms: LinkTerms, gravity: np.ndarray) -> dict[str, float]:
    """Magnitude of the summands of each quantity, which may cancel."""
    mass, weight = float(np.sum(robot.masses)), float(np.linalg.norm(gravity))
    origins = fields_of(LinkPose, terms.poses).origin
    inertia, away = (float(np.max(np.abs(x))) for x in (terms.inertia, origins))
    held = weight * np.sqrt(mass * inertia)  # m g r, with m r^2 among the inertias
    return {
        "inertia": inertia,
        "jacobian": 1.0,
        "bias": held + LARGEST_VELOCITY**2 * inertia,
        "gravity_torque": held,
        "poses": 1.0,
        "bodies": 1.0,
        "energy": held + mass * weight * away,
        "factored": inertia,
        "coriolis": LARGEST_VELOCITY * inertia,
    }


def _compare(
    robot: Robot, computed: LinkTerms, expected: LinkTerms, floors: Mapping[str, float]
) -> None:
    """Raise an error for the first quantity that differs, relative to its largest entry."""
    for name, floor in floors.items():
        values, references = getattr(computed, name), getattr(expected, name)
        cuts = _PARTS.get(name, ())
        parts = [np.split(quantity, cuts, axis=-1) for quantity in (values, references)]
        for value, reference in zip(*parts, strict=True):
            size = _difference(value, reference, floor)
            if not size <= 1e-11:
                raise ModelError(
                    f"{robot.text}: its compiled copy is not the {robot.noun}: {_WORDS[name]} "
                    f"differs from Pinocchio's by {size:.1e} of its largest entry, at most 1e-11 "
                    f"is allowed; let Pinocchio compute the arms (`run: {{arms: pinocchio}}`)"
                )


def _difference(computed: np.ndarray, expected: np.ndarray, floor: float) -> float:
    """Largest difference over the largest entry, or over a larger ``floor``."""
    largest = float(np.max(np.abs(computed - expected), initial=0.0))
    scale = max(float(np.max(np.abs(expected), initial=0.0)), floor)
    return largest / scale if scale > 0.0 else largest
