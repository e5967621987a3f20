"""How the arms hold the object at one state: each joint's motion, and what the contact forces do.

The arms' kinematics are computed afresh from the state, so that nothing here touches the arrays in
which a run may be under way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from multiarm.contacts.internal_forces import InternalForces, decompose, internal_forces
from multiarm.contacts.matrices import (
    ContactTerms,
    RelativeMotion,
    relative_wrenches,
    seen_from_object,
)
from multiarm.contacts.motion_space import (
    MotionSpace,
    joint_selection,
    motion_space,
    motion_space_in_rates,
)
from multiarm.dynamics.model import Model
from multiarm.dynamics.state import State
from multiarm.errors import ModelError
from multiarm.spatial import quaternion_to_matrix


@dataclass(frozen=True)
class ForceDecomposition:
    """Contact forces as what moves the object and what squeezes it.

    Attributes
    ----------
    moving : mapping arm -> ndarray, shape (N_i,)
        The smallest contact forces with the same resultant [N].
    squeezing : mapping arm -> ndarray, shape (N_i,)
        The rest, which does not move the object [N].
    internal : InternalForces
        Basis ``A_o`` over all contacts, arm after arm.
    coordinates : ndarray, shape (k,)
        ``mu_I`` in that basis.
    wrench : ndarray, shape (6,)
        Resultant of the contact forces: force [N] and moment [N m] about the object's centre of
        mass, in object axes.
    """

    moving: Mapping[str, np.ndarray]
    squeezing: Mapping[str, np.ndarray]
    internal: InternalForces
    coordinates: np.ndarray
    wrench: np.ndarray


def relative_motion_of(model: Model, state: State, arm: str) -> RelativeMotion:
    """Pose and twist of an arm's tip frame relative to the object, in object axes.

    Raises
    ------
    ModelError
        For an unknown arm.
    """
    if arm not in model.arms:
        raise ModelError(f"unknown arm {arm!r}; arms are {', '.join(model.arm_names)}")
    tip = model.arms[arm].terms(state.joint_positions[arm], state.joint_velocities[arm])
    X_WO, X_WT = np.eye(4), np.eye(4)
    X_WO[:3, :3] = quaternion_to_matrix(state.object_quaternion_xyzw.copy())
    X_WO[:3, 3] = state.object_position
    X_WT[:3, :3], X_WT[:3, 3] = tip.tip_rotation, tip.tip_position
    return seen_from_object(X_WO, state.object_twist, X_WT, tip.tip_twist)


def motion_space_of(
    model: Model,
    state: State,
    terms: Mapping[str, ContactTerms],
    arm: str,
    rows: Sequence[int | str] | None = None,
) -> MotionSpace:
    """Motion space of an arm's joint, with its rate.

    Parameters
    ----------
    model : Model
    state : State
    terms : mapping arm -> ContactTerms
        The contacts at this state.
    arm : str
    rows : sequence of int or str, optional
        Components of the tip's relative twist (at the tip's origin, object axes) that are the rates
        ``alpha``.  Left out: the free components of the joint itself, ``system.frames[arm]``.

    Raises
    ------
    ModelError
        For an unknown arm.
    GraspError
        When these components cannot be coordinates at this state.
    """
    relative = relative_motion_of(model, state, arm)
    W, W_dot = relative_wrenches(terms[arm], relative)
    if rows is not None:
        return motion_space(W, W_dot, rows)
    return motion_space_in_rates(W, joint_selection(model.frames[arm], relative), W_dot)


def relative_rates_of(model: Model, state: State, arm: str) -> np.ndarray:
    """Rates ``alpha`` of the free components of an arm's joint [m/s, rad/s]."""
    relative = relative_motion_of(model, state, arm)
    return joint_selection(model.frames[arm], relative).matrix @ relative.twist


def internal_forces_of(
    model: Model,
    terms: Mapping[str, ContactTerms],
    form: str = "orthonormal",
    rows: Sequence[int | str] | None = None,
) -> InternalForces:
    """Internal forces of all contacts, arm after arm; contacts are named ``arm/contact``."""
    names = [f"{arm}/{contact.name}" for arm in model.arm_names for contact in model.contacts[arm]]
    return internal_forces(_on_object(terms), form, rows, names)


def force_decomposition_of(
    model: Model,
    terms: Mapping[str, ContactTerms],
    forces: Mapping[str, np.ndarray],
    internal: InternalForces | None = None,
    length: float | None = None,
) -> ForceDecomposition:
    """Contact forces of all arms as what moves the object and what squeezes it.

    Parameters
    ----------
    model : Model
    terms : mapping arm -> ContactTerms
    forces : mapping arm -> ndarray, shape (N_i,)
        [N], positive pushes.
    internal : InternalForces, optional
        What the coordinates mean; the orthonormal form when left out.
    length : float, optional
        Measure forces in newtons, couples over this lever arm [m]; left out: multipliers as they
        are.
    """
    internal = internal or internal_forces_of(model, terms)
    stacked = np.concatenate([forces[arm] for arm in terms])
    parts = decompose(_on_object(terms), stacked, internal, length)
    return ForceDecomposition(
        moving=model.layout.split_contacts(parts.moving),
        squeezing=model.layout.split_contacts(parts.squeezing),
        internal=internal,
        coordinates=parts.coordinates,
        wrench=parts.wrench,
    )


def _on_object(terms: Mapping[str, ContactTerms]) -> np.ndarray:
    """``W_o`` of all contacts, (6, N)."""
    return np.hstack([term.W_o for term in terms.values()])
