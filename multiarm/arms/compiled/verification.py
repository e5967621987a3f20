"""Which arms are compiled, and their verification: terms against Pinocchio's at random states.

The states are the same for the same arm: its structure is the seed.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from multiarm.arms.compiled.backend import CompiledBackend
from multiarm.arms.compiled.tables import MOST_JOINTS, ArmTables, make_tables
from multiarm.arms.terms import ArmStructure, LinkTerms
from multiarm.contacts.kernel import ACCELERATION, BODY_WIDTH, ORIGIN_AT, VELOCITY
from multiarm.errors import ModelError

if TYPE_CHECKING:
    from multiarm.arms.arm import Arm

# States, bounds of positions [rad, m] and velocities [rad/s, m/s], and what may differ, relative to
# the largest entry.
STATES, FARTHEST, FASTEST, TOLERANCE = 8, np.pi, 3.0, 1e-11
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
# Where the parts of a quantity begin that have units of their own.
_PARTS = {"body": (ORIGIN_AT, VELOCITY, ACCELERATION), "poses": (ORIGIN_AT,)}


def compile_arms(
    arms: Mapping[str, Arm], gravity: np.ndarray
) -> tuple[CompiledBackend | None, dict[str, str]]:
    """Backend of all arms that can be compiled, verified against Pinocchio.

    Returns
    -------
    backend : CompiledBackend or None
        None where no arm can be compiled.
    reasons : dict of str to str
        Why the other arms are not.

    Raises
    ------
    ModelError
        When a compiled arm does not agree with Pinocchio.
    """
    found: dict[int, ArmStructure] = {}
    reasons: dict[str, str] = {}
    for place, (name, arm) in enumerate(arms.items()):
        try:
            found[place] = _structure(arm)
        except ModelError as reason:
            reasons[name] = str(reason)
    if not found:
        return None, reasons
    first = np.cumsum([0, *(arm.dof for arm in arms.values())])
    places = tuple(found)
    tables = make_tables(list(found.values()), places, [int(first[k]) for k in places], gravity)
    verify(tables, places, arms)
    return CompiledBackend(tables, places, arms), reasons


def _structure(arm: Arm) -> ArmStructure:
    if arm.dof > MOST_JOINTS:
        raise ModelError(f"it has {arm.dof} joints; at most {MOST_JOINTS} are compiled")
    return arm.structure()


def verify(
    tables: ArmTables,
    places: Sequence[int],
    arms: Mapping[str, Arm],
    quantities: Sequence[str] = EVERY_EVALUATION,
) -> None:
    """Compare compiled arms with Pinocchio's.

    Parameters
    ----------
    tables : ArmTables
    places : sequence of int
        Numbers of the compiled arms among all.
    arms : mapping of str to Arm
        All arms of the scene.
    quantities : sequence of str
        Fields of :class:`multiarm.arms.terms.LinkTerms`.

    Raises
    ------
    ModelError
        Naming the arm, the quantity that differs, by how much, and the remedy.
    """
    first = np.cumsum([0, *(arm.dof for arm in arms.values())])
    angles, rates = np.zeros(first[-1]), np.zeros(first[-1])
    wanted = np.ones_like(tables.wanted)
    copies = CompiledBackend(tables._replace(wanted=wanted), places, arms)
    copies.bind(angles, rates, np.zeros((len(arms), BODY_WIDTH)))
    every = [list(arms.values())[place] for place in places]
    structures = [arm.structure() for arm in every]
    states = [_random_states(structure) for structure in structures]
    found: list[list[LinkTerms]] = [[] for _ in every]
    for number in range(STATES):
        for place, (q, v) in zip(places, states, strict=True):
            angles[first[place] : first[place + 1]] = q[number]
            rates[first[place] : first[place + 1]] = v[number]
        copies.update(with_coriolis=CORIOLIS[0] in quantities)
        for k, own in enumerate(found):
            own.append(copies.terms(k))
    for arm, structure, (q, v), own in zip(every, structures, states, found, strict=True):
        expected = _stacked(arm.reference(q, v, tables.gravity))
        floors = _floors(structure, expected, tables.gravity)
        _compare(arm.name, _stacked(own), expected, {name: floors[name] for name in quantities})


def _random_states(arm: ArmStructure) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of an arm, each (8, n)."""
    seed = zlib.crc32(b"".join(part.tobytes() for part in arm))
    draw = np.random.default_rng(seed).uniform(-1.0, 1.0, (2, STATES, arm.masses.size))
    return FARTHEST * draw[0], FASTEST * draw[1]


def _stacked(states: Sequence[LinkTerms]) -> LinkTerms:
    """The terms at all states, which are the first axis."""
    return LinkTerms(*(np.stack(values) for values in zip(*states, strict=True)))


def _floors(arm: ArmStructure, terms: LinkTerms, gravity: np.ndarray) -> dict[str, float]:
    """How large the terms are that each quantity is the sum of, which may cancel."""
    mass, weight = float(np.sum(arm.masses)), float(np.linalg.norm(gravity))
    inertia, away = (float(np.max(np.abs(x))) for x in (terms.inertia, terms.poses[..., 9:]))
    held = weight * np.sqrt(mass * inertia)  # m g r, with m r^2 among the inertias
    return {
        "inertia": inertia,
        "jacobian": 1.0,
        "bias": held + FASTEST**2 * inertia,
        "gravity_torque": held,
        "poses": 1.0,
        "body": 1.0,
        "energy": held + mass * weight * away,
        "coriolis": FASTEST * inertia,
    }


def _compare(arm: str, found: LinkTerms, expected: LinkTerms, floors: Mapping[str, float]) -> None:
    """Raise what differs."""
    for name, floor in floors.items():
        own, other = getattr(found, name), getattr(expected, name)
        cuts = _PARTS.get(name, ())
        parts = zip(np.split(own, cuts, axis=-1), np.split(other, cuts, axis=-1), strict=True)
        for part in parts:
            size = _difference(*part, floor)
            if not size <= TOLERANCE:
                raise ModelError(
                    f"arm '{arm}': its compiled copy is not the arm: {_WORDS[name]} differs from "
                    f"Pinocchio's by {size:.1e} of its largest entry, at most {TOLERANCE:g} is "
                    f"allowed; let Pinocchio compute the arms (`run: {{arms: pinocchio}}`)"
                )


def _difference(found: np.ndarray, expected: np.ndarray, floor: float) -> float:
    """Largest difference over the largest entry, or over ``floor`` where that is larger."""
    largest = float(np.max(np.abs(found - expected)))
    scale = max(float(np.max(np.abs(expected))), floor)
    return largest / scale if scale > 0.0 else largest
