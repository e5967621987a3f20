"""The compiled backend: arms whose terms batched kernels compute, verified against Pinocchio.

Every compiled arm is compared with Pinocchio at random states before it is used.  The states are
the same for the same arm: its structure is the seed.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.arms.chain import require_chain
from multiarm.arms.compiled.coriolis import update_coriolis
from multiarm.arms.compiled.kernels import update_arms
from multiarm.arms.compiled.tables import (
    JACOBIAN_WIDTH,
    MOST_JOINTS,
    ArmTables,
    Wanted,
    make_tables,
    make_terms,
    make_work,
)
from multiarm.arms.terms import (
    POSE_WIDTH,
    ArmState,
    ArmStructure,
    Coriolis,
    LinkPose,
    LinkTerms,
    MatrixAddress,
    TermAddresses,
)
from multiarm.contacts.motion import BODY_WIDTH, BodyMotion
from multiarm.errors import ModelError
from multiarm.jit.pointers import address_of, call_whole
from multiarm.jit.rows import as_row, fields_of, offset_of
from multiarm.jit.structs import make_struct

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
    "body": "the motion of the tip's link",
    "energy": "the potential energy",
    "coriolis": "the matrix of Coriolis forces",
}
# Where parts of a quantity begin that have other units.
_PARTS = {
    "body": tuple(offset_of(BodyMotion, name) for name in ("origin", "velocity", "acceleration")),
    "poses": (offset_of(LinkPose, "origin"),),
}


def compile_arms(
    arms: Mapping[str, Arm], gravity: np.ndarray
) -> tuple[CompiledBackend | None, dict[str, str]]:
    """Backend of all arms that can be compiled, verified against Pinocchio.

    Returns
    -------
    backend : CompiledBackend or None
        None where no arm can be compiled.
    reasons : dict of str to str
        Why each other arm is not.

    Raises
    ------
    ModelError
        When a compiled arm does not agree with Pinocchio.
    """
    structures: dict[int, ArmStructure] = {}
    reasons: dict[str, str] = {}
    for place, (name, arm) in enumerate(arms.items()):
        try:
            structures[place] = _structure(arm)
        except ModelError as reason:
            reasons[name] = str(reason)
    if not structures:
        return None, reasons
    first = np.cumsum([0, *(arm.dof for arm in arms.values())])
    places = tuple(structures)
    tables = make_tables(
        list(structures.values()), places, [int(first[k]) for k in places], gravity
    )
    verify(tables, places, arms)
    return CompiledBackend(tables, places, arms), reasons


class CompiledBackend:
    """Arms of one system in compiled code, four at a time; see :mod:`multiarm.arms.backends`.

    Its ``pointers`` have no pose, twist and drift: the sweep writes the motion of the link that
    carries the tip into ``ArmState.bodies``.

    Parameters
    ----------
    tables : ArmTables
        Constants, which several systems may share.
    places : sequence of int
        The arms' numbers among all arms of the scene.
    arms : mapping of str to Arm
        All arms of the scene, against which the compiled ones are verified.
    """

    def __init__(self, tables: ArmTables, places: Sequence[int], arms: Mapping[str, Arm]) -> None:
        self.tables, self.places, self._arms = tables, tuple(places), arms
        self._terms, self._coriolis = make_terms(tables), make_terms(tables)
        self._world = as_row(LinkPose(np.eye(3), np.zeros(3)))
        self._lanes = [
            _Lane(tables, place, int(joints))
            for place, joints in zip(self.places, tables.joints, strict=True)
        ]
        self.pointers = np.array([self._pointers(lane) for lane in self._lanes])

    def copy(self) -> CompiledBackend:
        """The same arms with their own terms; the constants are shared."""
        tables = self.tables._replace(wanted=self.tables.wanted.copy())  # flags of one system
        return CompiledBackend(tables, self.places, self._arms)

    def bind(self, angles: np.ndarray, rates: np.ndarray, bodies: np.ndarray) -> None:
        """Let the sweeps read positions and velocities of all joints, and write all bodies."""
        self._work = make_work(self.tables, angles, rates, bodies, self._terms, self._coriolis)
        self._struct = make_struct([*self.tables, *self._work])

    def connect(self, state: ArmState) -> dict[str, int]:
        """Addresses of the function that updates all terms and of its struct, and its size."""
        self.bind(state.angles, state.rates, state.bodies)
        struct = self._struct
        return {
            "arms": address_of(update_arms),
            "arms_struct": struct.ctypes.data,
            "arms_size": struct.size,
        }

    def connect_coriolis(self, coriolis: Coriolis) -> None:
        """Write the places of the matrices, and the function that updates them with its struct.

        Raises
        ------
        ModelError
            When a compiled matrix is not Pinocchio's.
        """
        verify(self.tables, self.places, self._arms, CORIOLIS)
        at = self._coriolis.ctypes.data
        for lane in self._lanes:
            coriolis.matrices[lane.place] = MatrixAddress(at + 8 * lane.square, lane.stride)
        calls, struct = coriolis.calls, self._struct
        calls.compiled, calls.compiled_struct = address_of(update_coriolis), struct.ctypes.data
        calls.compiled_size = struct.size

    def want_gravity_torque(self) -> None:
        """Write gravity torques too."""
        self.tables.wanted.gravity_torque = True

    def pose_address(self, place: int, joint: int) -> int:
        """Address of the pose of a joint, which is written from now on; joint 0 is the world."""
        if joint == 0:
            return self._world.ctypes.data
        self.tables.wanted.poses = True
        return self._terms.ctypes.data + 8 * self._lanes[self.places.index(place)].pose(joint - 1)

    def update(self, with_coriolis: bool = False) -> None:
        """Compute all terms at the positions and velocities bound, from Python."""
        for entry in (update_arms, update_coriolis) if with_coriolis else (update_arms,):
            call_whole(entry, self._struct)

    def terms(self, arm: int) -> LinkTerms:
        """Copies of the last terms of arm number ``arm`` of these."""
        lane, terms = self._lanes[arm], self._terms
        n = lane.joints
        lower = np.tril(_square(terms, lane.square, lane.stride, n))
        jacobian = terms[lane.jacobian : lane.jacobian + JACOBIAN_WIDTH * n].reshape(n, 6)
        return LinkTerms(
            inertia=lower + np.tril(lower, -1).T,
            jacobian=jacobian.T.copy(),
            bias=terms[lane.bias : lane.bias + n].copy(),
            gravity_torque=terms[lane.gravity_torque : lane.gravity_torque + n].copy(),
            poses=terms[lane.pose(0) : lane.pose(n)].reshape(n, POSE_WIDTH).copy(),
            body=self._work.bodies.reshape(-1, BODY_WIDTH)[lane.place].copy(),
            energy=terms[lane.energy : lane.energy + 1].copy(),
            coriolis=_square(self._coriolis, lane.square, lane.stride, n).T.copy(),
        )

    def _pointers(self, lane: _Lane) -> np.ndarray:
        at = self._terms.ctypes.data
        addresses = TermAddresses(
            inertia=at + 8 * lane.square,
            stride=lane.stride,
            jacobian=at + 8 * lane.jacobian,
            bias=at + 8 * lane.bias,
            gravity_torque=at + 8 * lane.gravity_torque,
        )
        return np.array(addresses, dtype=np.int64)


def verify(
    tables: ArmTables,
    places: Sequence[int],
    arms: Mapping[str, Arm],
    quantities: Sequence[str] = EVERY_EVALUATION,
) -> None:
    """Compare compiled arms with Pinocchio's.

    ``places`` are the numbers of the compiled arms among all ``arms`` of the scene, ``quantities``
    fields of :class:`multiarm.arms.terms.LinkTerms`.

    Raises
    ------
    ModelError
        Naming the arm, the quantity, the difference and the remedy.
    """
    first = np.cumsum([0, *(arm.dof for arm in arms.values())])
    angles, rates = np.zeros(first[-1]), np.zeros(first[-1])
    wanted = Wanted(gravity_torque=True, poses=True)
    copies = CompiledBackend(tables._replace(wanted=wanted), places, arms)
    copies.bind(angles, rates, np.zeros((len(arms), BODY_WIDTH)))
    every = [list(arms.values())[place] for place in places]
    structures = [arm.structure() for arm in every]
    states = [_random_states(structure) for structure in structures]
    computed: list[list[LinkTerms]] = [[] for _ in every]
    for number in range(STATES):
        for place, (q, v) in zip(places, states, strict=True):
            angles[first[place] : first[place + 1]] = q[number]
            rates[first[place] : first[place + 1]] = v[number]
        copies.update(with_coriolis=CORIOLIS[0] in quantities)
        for k, terms in enumerate(computed):
            terms.append(copies.terms(k))
    for arm, structure, (q, v), terms in zip(every, structures, states, computed, strict=True):
        expected = _stacked(arm.reference(q, v, tables.gravity))
        floors = _floors(structure, expected, tables.gravity)
        _compare(arm.name, _stacked(terms), expected, {name: floors[name] for name in quantities})


def _structure(arm: Arm) -> ArmStructure:
    if arm.dof > MOST_JOINTS:
        raise ModelError(f"it has {arm.dof} joints; at most {MOST_JOINTS} are compiled")
    return require_chain(arm.structure(), arm.tip.joint)


class _Lane:
    """Offsets of the terms of one arm, with ``joints`` joints and matrices of ``stride`` rows."""

    def __init__(self, tables: ArmTables, place: int, joints: int) -> None:
        (b, lane), *_ = np.argwhere(tables.arms == place)
        self.place, self.joints, self.stride = place, joints, int(tables.block_joints[b])
        before = self.stride - self.joints  # padding
        at = int(tables.first_term[b] + lane * tables.term_count[b])
        self.square = at + before * (self.stride + 1)
        self.jacobian = at + int(tables.jacobian[b]) + JACOBIAN_WIDTH * before
        self.bias = at + int(tables.bias[b]) + before
        self.gravity_torque = at + int(tables.gravity_torque[b]) + before
        self.energy = at + int(tables.energy[b])
        self._poses = at + int(tables.poses[b]) + POSE_WIDTH * before

    def pose(self, link: int) -> int:
        """Offset of the pose of one of the arm's links, counted from 0."""
        return self._poses + POSE_WIDTH * link


def _square(numbers: np.ndarray, at: int, stride: int, size: int) -> np.ndarray:
    """View of the (size, size) matrix at an offset, with ``stride`` numbers a row."""
    return np.lib.stride_tricks.as_strided(numbers[at:], (size, size), (8 * stride, 8))


def _random_states(arm: ArmStructure) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of an arm, each (8, n)."""
    seed = zlib.crc32(b"".join(part.tobytes() for part in arm))
    draw = np.random.default_rng(seed).uniform(-1.0, 1.0, (2, STATES, arm.masses.size))
    return LARGEST_POSITION * draw[0], LARGEST_VELOCITY * draw[1]


def _stacked(states: Sequence[LinkTerms]) -> LinkTerms:
    """The terms at all states, which are the first axis."""
    return LinkTerms(*(np.stack(values) for values in zip(*states, strict=True)))


def _floors(arm: ArmStructure, terms: LinkTerms, gravity: np.ndarray) -> dict[str, float]:
    """Magnitude of the summands of each quantity, which may cancel."""
    mass, weight = float(np.sum(arm.masses)), float(np.linalg.norm(gravity))
    origins = fields_of(LinkPose, terms.poses).origin
    inertia, away = (float(np.max(np.abs(x))) for x in (terms.inertia, origins))
    held = weight * np.sqrt(mass * inertia)  # m g r, with m r^2 among the inertias
    return {
        "inertia": inertia,
        "jacobian": 1.0,
        "bias": held + LARGEST_VELOCITY**2 * inertia,
        "gravity_torque": held,
        "poses": 1.0,
        "body": 1.0,
        "energy": held + mass * weight * away,
        "coriolis": LARGEST_VELOCITY * inertia,
    }


def _compare(
    arm: str, computed: LinkTerms, expected: LinkTerms, floors: Mapping[str, float]
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
                    f"arm '{arm}': its compiled copy is not the arm: {_WORDS[name]} differs from "
                    f"Pinocchio's by {size:.1e} of its largest entry, at most 1e-11 is "
                    f"allowed; let Pinocchio compute the arms (`run: {{arms: pinocchio}}`)"
                )


def _difference(computed: np.ndarray, expected: np.ndarray, floor: float) -> float:
    """Largest difference over the largest entry, or over a larger ``floor``."""
    largest = float(np.max(np.abs(computed - expected)))
    scale = max(float(np.max(np.abs(expected))), floor)
    return largest / scale if scale > 0.0 else largest
