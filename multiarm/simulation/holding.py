r"""Holding: torques of the drives with which the arms hold the object still.

Object and arms are at rest when the contact forces :math:`\lambda` carry the weight and the drives
carry the arms and the contact forces,

.. math:: W_o \lambda = -f_g, \qquad \tau = g(q) - W \lambda,

with the wrench :math:`f_g = [m g; 0]` of gravity and the torques :math:`g(q)` of the unloaded arms.
Contacts beyond the rank of :math:`W_o` squeeze the object by as much as one likes, and this changes
the torques. Of all forces, those are best that take the smallest share s of the drives' limits
:math:`\hat\tau` (:mod:`multiarm.dynamics.forces.distribution`),

.. math:: \min s, \qquad |g - W \lambda|_j \le s \, \hat\tau_j .

If s exceeds 1, no control holds the object here. Contacts that can only push do, also
in scenes that do not let them open; friction is bounded by a polygon of :data:`SIDES` sides inside
its cone, which is 2 % smaller at most. Friction of the joints does not help.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from multiarm.dynamics.contact_geometry import force_directions
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.evaluation import Evaluation
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.forces.distribution import ForceFamily, forces_for, smallest_load
from multiarm.dynamics.solver.bounds import RANK_TOLERANCE
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.geometry.records import Contact
from multiarm.geometry.screws import lever_arm, row_scale
from multiarm.programs import LinearRows
from multiarm.results.limit_use import ROUNDED_SHARE

SIDES = 16
"""Of the polygon in a cone of friction."""


@dataclass(frozen=True)
class EffortShares:
    """Shares of the joints' effort limits, 1 at the limit."""

    largest: float
    joint: str  # arm/joint, that uses most
    by_joint: dict[str, float]  # those whose limit is known

    @property
    def overloaded(self) -> bool:
        """Whether a joint is beyond its limit."""
        return self.largest > 1.0 + ROUNDED_SHARE


@dataclass(frozen=True)
class Carrying:
    """Whether contacts and drives can carry the object at rest."""

    possible: bool  # whether the verdict is "carried"
    # "carried"; "wrench": no contact forces balance the weight; "pushing": none that only push;
    # "effort": such forces take more than the drives have
    verdict: Literal["carried", "wrench", "pushing", "effort"]
    # what the best contact forces leave of the weight [N] and of its moment about the centre of
    # mass [N m], of the object and of robots on floating bases
    force_residual: float
    moment_residual: float
    # [N], of the contact forces whose largest is smallest; None where none carry the object
    largest_force: float | None
    control: EffortShares | None  # of the control at the start; None: no limit is known
    least: EffortShares | None  # torques that hold, of which the largest share is smallest


def carrying_capacity(system: System, evaluation: Evaluation) -> Carrying | None:
    """Whether contacts and drives can carry the object at rest where the system was evaluated.

    None where nothing weighs, there are several objects, a floor carries too, a joint is passive,
    or the control does not carry the object.
    """
    state, scene = evaluation.state, system.scene
    if system.model.layout.passive_joints:
        return None
    weighs = scene.gravity is not None and any(scene.gravity) and len(scene.all_objects) == 1
    if not weighs or scene.effects.floor is not None or not scene.control.carries:
        return None
    gravity = np.array(scene.gravity)
    body = scene.one_object("the load that contacts and drives carry")
    weight = np.append(-body.mass * gravity, np.zeros(3))
    with system.borrow() as data:
        data.set_state(0.0, state)
        require_ok(data, update_kinematics(data.struct))
        directions = force_directions(data)  # of all rows, open ones too
    columns, layout = _force_rows(system), system.model.layout
    W_o, W = np.split(directions[:, columns], [6])
    bounds = _force_bounds(system)[:, columns]
    unloaded = np.concatenate([
        system.arms[n].gravity_torque(state.joint_positions[n], gravity, state.bases.get(n))
        for n in system.arm_names
    ])  # fmt: skip
    # contacts carry floating bases too, which have no drives
    bases = [W_o, *(rows.T for rows in layout.split_bases(W.T).values())]
    weights = [weight, *layout.split_bases(unloaded).values()]
    W_o, weight = np.concatenate(bases), np.concatenate(weights)
    W, unloaded = W[layout.driven_joints], unloaded[layout.driven_joints]
    scale = np.tile(row_scale(max(lever_arm(W_b) for W_b in bases)), len(bases))
    size = float(np.linalg.norm(weight))
    family, _ = forces_for(scale[:, None] * W_o, scale * weight / size, RANK_TOLERANCE)
    left = W_o @ (size * family.least_norm) - weight
    forces_left, moments_left = np.reshape(left, (-1, 2, 3)).transpose(1, 0, 2)
    balanced = float(np.linalg.norm(scale * left)) <= 1e-6 * size
    torques = least = largest_force = None
    if balanced:
        forces = _best_forces(family, _torque_shares(system, unloaded, size * W), bounds)
        torques = None if forces is None else unloaded - W @ (size * forces)
        least = None if torques is None else _effort_shares(system, torques)
        eye = np.vstack([np.eye(W_o.shape[1]), -np.eye(W_o.shape[1])])
        forces = _best_forces(family, (eye, np.zeros(len(eye))), bounds)
        largest_force = None if forces is None else size * float(np.max(np.abs(forces)))
    verdict: Literal["carried", "wrench", "pushing", "effort"] = "carried"
    if torques is None:
        verdict = "pushing" if balanced else "wrench"
    elif least is not None and least.overloaded:
        verdict = "effort"
    return Carrying(
        possible=verdict == "carried",
        verdict=verdict,
        force_residual=float(np.linalg.norm(forces_left)),
        moment_residual=float(np.linalg.norm(moments_left)),
        largest_force=largest_force,
        control=_effort_shares(system, np.concatenate(list(evaluation.joint_torques.values()))),
        least=least,
    )


def _force_rows(system: System) -> np.ndarray:
    """Rows with which the arms act on the object at the start: contacts and their friction."""
    unilateral = system.model.unilateral
    if unilateral is None:
        return np.arange(system.constraint_count)
    pushing = [contact for contact in unilateral.contacts if not contact.bilateral]
    tangents = [row for contact in pushing for row in contact.tangents]
    rows = sorted({*unilateral.model, *tangents})
    return np.array(unilateral.rows_held_by(unilateral.holding_at(0.0), rows), dtype=np.int64)


def _force_bounds(system: System) -> np.ndarray:
    """``P`` (k, N), with ``P lambda <= 0`` for forces that only push, with friction in its cone."""
    unilateral, turns = system.model.unilateral, 2.0 * np.pi * np.arange(SIDES) / SIDES
    pushing = [
        row
        for row, record in enumerate(system.model.records)
        if isinstance(record, Contact) and record.pushes_only and record.tangent == 0
    ]
    normals = -np.eye(system.constraint_count)
    bounds = [normals[pushing]]
    for contact in () if unilateral is None else unilateral.contacts:
        if contact.tangents and not contact.bilateral:
            cone = contact.mu * np.cos(np.pi / SIDES) * normals[contact.row]
            polygon = np.tile(cone, (SIDES, 1))
            polygon[:, list(contact.tangents)] = np.column_stack([np.cos(turns), np.sin(turns)])
            bounds.append(polygon)
    return np.concatenate(bounds)


def _efforts(system: System) -> np.ndarray:
    return np.concatenate([system.arms[name].effort_limits for name in system.arm_names])


def _torque_shares(system: System, unloaded: np.ndarray, W: np.ndarray) -> LinearRows:
    """Shares of the known efforts that the torques ``unloaded - W forces`` take, either way."""
    efforts = _efforts(system)
    known = np.isfinite(efforts)
    shares = unloaded[known] / efforts[known]
    slopes = -W[known] / efforts[known, None]
    none = np.zeros((1, W.shape[1]))  # without a known effort, any forces will do
    return np.vstack([slopes, -slopes, none]), np.concatenate([shares, -shares, [0.0]])


def _best_forces(family: ForceFamily, loads: LinearRows, bounds: np.ndarray) -> np.ndarray | None:
    """Forces (N,) with ``bounds @ forces <= 0`` whose largest load is smallest; None if none."""
    best = smallest_load(family, loads, (bounds, np.zeros(len(bounds))))
    if best.forces is None and not best.infeasible:
        raise SolverError(f"the forces that hold the start were not found: {best.message}")
    return best.forces


def _effort_shares(system: System, torques: np.ndarray) -> EffortShares | None:
    """Shares of stacked torques (n,); None where no limit is known."""
    joints = [f"{name}/{j}" for name in system.arm_names for j in system.arms[name].joint_names]
    shares = {
        joint: float(abs(torque) / effort)
        for joint, torque, effort in zip(joints, torques, _efforts(system), strict=True)
        if np.isfinite(effort)
    }
    if not shares:
        return None
    joint = max(shares, key=lambda name: shares[name])
    return EffortShares(shares[joint], joint, shares)
