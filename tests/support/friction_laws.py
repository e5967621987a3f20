"""Whether a recorded run obeys the laws of contact and friction in every sample.

Gaps, slips and accelerations are those of :mod:`friction_oracle`: from the written geometry, the
recorded motion and the recorded forces.  Figures are parts of the largest force, length, speed and
acceleration of the run.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from friction_oracle import Oracle, State, contact_motion, skew
from random_friction_scenes import Table
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.scene import parse_scene

LAWS = 1e-9
"""Largest violation of a law."""
CREATED = 2e-11
"""Largest energy that contacts may create, of that in the run."""
SMALL = 1e-3
"""An energy that is small in any of the scenes [J]."""
SLIPS = 1e-6
"""Speeds of slip that have a direction, as a part of the largest speed; and above the accuracy."""
REST = 0.01
"""Part of the accuracy below which a joint is at rest."""


def state_at(oracle: Oracle, trajectory: Any, k: int) -> State:
    """A sample."""
    motions = [trajectory.objects[name] for name in oracle.objects]
    names = [arm.name for arm in oracle.arms]
    return State(
        np.array([motion.position[k] for motion in motions]),
        np.array([Rotation.from_quat(m.quaternion_xyzw[k]).as_matrix() for m in motions]),
        [trajectory.joint_positions[name][k] for name in names],
        np.concatenate(
            [motion.twist[k] for motion in motions]
            + [trajectory.joint_velocities[name][k] for name in names]
        ),
    )


class _Recorded:
    """Forces of a run in the frames of the oracle's contacts."""

    def __init__(self, oracle: Oracle, trajectory: Any) -> None:
        self._oracle, self._trajectory = oracle, trajectory
        evaluation = ma.evaluate(ma.compile_system(parse_scene(oracle.table)))
        state = evaluation.state
        rotations = {"world": np.eye(3)}
        for name in oracle.objects:
            quaternion = state.objects[name].quaternion_xyzw
            rotations[name] = Rotation.from_quat(quaternion).as_matrix()
        self.axes = []
        for contact in oracle.contacts:
            width = 1 if contact.mu is None else 3
            first = width * contact.index
            normals = evaluation.contact_normals[contact.channel]
            # all of the frame is fixed in the plane's body
            axes = normals[first : first + width] @ rotations[contact.base]
            self.axes.append((first, -axes if contact.pushes_base else axes))

    def force(self, i: int, k: int, base: np.ndarray) -> np.ndarray:
        """Force of a contact on the body of the point, in world axes."""
        first, axes = self.axes[i]
        values = self._trajectory.contact_forces[self._oracle.contacts[i].channel][k]
        return base @ (values[first : first + len(axes)] @ axes)


def judge_laws(table: Table, trajectory: Any, accuracy: float) -> dict[str, float]:
    """The largest violation of each law in any sample; see the module.

    Slips that are slower than the ``accuracy`` of the run may have any direction; joints are at
    rest that are slower than a hundredth of it.

    Accelerations of scenes with dry joints or joints that are not ``contacts`` are not judged, for
    their forces are not all recorded; dry friction is where arms with six joints are welded to
    the only object.
    """
    oracle = Oracle(table)
    welded = [joint["arm"] for joint in table["joints"] if joint["kind"] == "weld"]
    if "joint_friction" in table["effects"] and welded:
        return _dry_joint_laws(oracle, trajectory, welded, accuracy)
    return _contact_laws(oracle, trajectory, accuracy)


def _dry_joint_laws(
    oracle: Oracle, trajectory: Any, welded: list[str], accuracy: float
) -> dict[str, float]:
    """Laws of dry joints in arms that are welded to the object, all of whose wrenches are recorded.

    The object's acceleration follows from the wrenches, those of the joints from it, and from these
    the torques that nothing else explains.
    """
    friction = oracle.table["effects"]["joint_friction"]["torque"]
    arms = [arm for arm in oracle.arms if arm.name in welded]
    excess, against = 0.0, 0.0
    rates = np.concatenate([trajectory.joint_velocities[arm.name] for arm in arms], axis=1)
    V = max(float(np.abs(rates).max()), 1e-3)
    for k in range(len(trajectory)):
        state = state_at(oracle, trajectory, k)
        mechanism = oracle.mechanism(float(trajectory.time[k]), state)
        wrenches = {arm.name: trajectory.wrenches[arm.name][k] for arm in oracle.arms}
        object_force = mechanism.force[:6] + sum(wrenches.values())
        acceleration = mechanism.inverse_inertia[:6, :6] @ object_force
        spin = state.velocity[3:6]
        for arm in arms:
            tip, own = mechanism.bodies[arm.name], arm.columns
            r = tip.origin - state.positions[0]
            of_tip = acceleration.copy()
            of_tip[:3] += skew(acceleration[3:]) @ r + skew(spin) @ (skew(spin) @ r)
            J = tip.jacobian[:, own]
            joints = np.linalg.solve(J, of_tip - tip.bias)
            force = wrenches[arm.name][:3]
            moment = wrenches[arm.name][3:] - skew(r) @ force  # about the tip
            others = mechanism.force[own] - J.T @ np.concatenate([force, moment])
            torques = trajectory.joint_torques
            if arm.name in torques and torques[arm.name].shape[1]:
                others = others + torques[arm.name][k]
            inertia = np.linalg.inv(mechanism.inverse_inertia[own, own])
            torque, most = inertia @ joints - others, np.array(friction[arm.name])
            size = max(float(np.abs(others).max()), float(most.max()))
            excess = max(excess, float(np.max(np.abs(torque) - most)) / size)
            moves = np.abs(state.velocity[own]) > max(SLIPS * V, REST * accuracy)
            left = torque + most * np.sign(state.velocity[own])
            against = max(against, float(np.max(np.abs(left), where=moves, initial=0.0)) / size)
    return {"dry torque too large": excess, "dry torque not against the rate": against}


def _contact_laws(oracle: Oracle, trajectory: Any, accuracy: float) -> dict[str, float]:
    table = oracle.table
    recorded = _Recorded(oracle, trajectory)
    whole = "joint_friction" not in table["effects"] and all(
        joint["kind"] == "contacts" for joint in table["joints"]
    )
    samples = len(trajectory)
    motions, forces, rates, accelerations = [], [], [], []
    velocities = []
    for k in range(samples):
        state = state_at(oracle, trajectory, k)
        mechanism = oracle.mechanism(float(trajectory.time[k]), state)
        contacts = [contact_motion(c, mechanism.bodies, state.velocity) for c in oracle.contacts]
        force = []
        for i, (contact, motion) in enumerate(zip(oracle.contacts, contacts, strict=True)):
            total = recorded.force(i, k, mechanism.bodies[contact.base].rotation)
            force.append(motion.frame @ total)
        total = mechanism.force.copy()
        for arm in oracle.arms:
            torques = trajectory.joint_torques
            if arm.name in torques and torques[arm.name].shape[1]:
                total[arm.columns] += torques[arm.name][k]
        for motion, f in zip(contacts, force, strict=True):
            total += motion.jacobian.T @ f
        acceleration = mechanism.inverse_inertia @ total
        motions.append(contacts)
        forces.append(force)
        rates.append([motion.jacobian @ state.velocity for motion in contacts])
        accelerations.append([motion.jacobian @ acceleration + motion.bias for motion in contacts])
        # what the same forces would do to each contact alone: the size of what cancels
        velocities.append([
            np.linalg.norm(motion.jacobian, axis=1).max() * np.linalg.norm(state.velocity)
            for motion in contacts
        ])  # fmt: skip
    f, u, a = np.array(forces), np.array(rates), np.array(accelerations)  # (K, N, 3)
    gap = np.array([[motion.gap for motion in contacts] for contacts in motions])
    mu = np.array([contact.mu or 0.0 for contact in oracle.contacts])
    weight = float(np.sum(oracle.masses) * np.linalg.norm(oracle.gravity))
    F = max(float(np.abs(f).max()), weight)
    V = max(float(np.max(velocities)), 1e-3)
    A = max(float(np.abs(a).max()), float(np.linalg.norm(oracle.gravity)))
    pushes, drag, slip = f[..., 0], np.hypot(f[..., 1], f[..., 2]), np.hypot(u[..., 1], u[..., 2])
    loaded = pushes > LAWS * F
    found = {
        "pull": np.max(-pushes) / F,
        "overlap": np.max(-gap),
        "force at a gap": np.max(gap, where=loaded, initial=0.0),
        "force while it opens": np.max(np.abs(u[..., 0]), where=loaded, initial=0.0) / V,
        "cone": np.max(drag - mu * pushes) / F,
    }
    slips = slip > max(SLIPS * V, accuracy)
    along = u[..., 1:] / np.maximum(slip, np.finfo(float).tiny)[..., None]
    against = np.linalg.norm(f[..., 1:] + (mu * pushes)[..., None] * along, axis=-1)
    found["friction not against slip"] = np.max(against, where=slips, initial=0.0) / F
    power = np.sum(f[..., 1:] * u[..., 1:], axis=-1)
    too_large = np.max(power + mu * pushes * slip, where=slips, initial=0.0)
    found["friction power"] = too_large / (F * V)
    if whole:
        touches = (np.abs(gap) < LAWS) & (np.abs(u[..., 0]) < LAWS * V)
        found["overlaps next"] = np.max(-a[..., 0], where=touches, initial=0.0) / A
        found["force while it leaves"] = np.max(np.abs(a[..., 0]), where=loaded, initial=0.0) / A
        sticks = loaded & (slip < LAWS * V) & (drag < mu * pushes - 1e-6 * F)
        creep = np.hypot(a[..., 1], a[..., 2])
        found["creeps"] = np.max(creep, where=sticks, initial=0.0) / A
    return {name: float(value) for name, value in found.items()}


def judge_energy(trajectory: Any) -> dict[str, float]:
    """Energy that contacts create between two samples, and that of the whole balance.

    As parts of the largest energy or work in the run.  The balance has the errors of the
    integration; the works of contacts may only fall, whatever the accuracy.
    """
    works = {
        name: trajectory.channel(name)
        for name in trajectory.channels
        if name in ("effects/impacts/work", "effects/contact_friction/work",
                    "effects/joint_friction/work")
    }  # fmt: skip
    energies = [trajectory.channel(f"energy/{part}") for part in ("kinetic", "potential", "work")]
    energies[1] = energies[1] - energies[1][0]
    size = max(*(float(np.abs(values).max()) for values in [*energies, *works.values()]), SMALL)
    found = {
        name.split("/")[1]: float(np.max(np.diff(work), initial=0.0)) / size
        for name, work in works.items()
    }
    return found | {"balance": float(np.max(trajectory.energy_balance)) / size}
