r"""Internal forces that laws of the object ask for, as desired forces of contacts and arms.

A squeeze consists of internal forces.  Where all contacts are fingertips, which can only push, it
is a combination of pushing forces (thesis, 3.7.3) with the mean that the scene names.  Bilateral
joints hold both ways; there every arm presses towards the middle of all grips.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.contacts.motion import BodyMotion
from multiarm.dynamics.data import Data
from multiarm.dynamics.forces.internal_forces import decompose, pressing_forces
from multiarm.dynamics.model import Model
from multiarm.errors import ControlError, GraspError
from multiarm.geometry.screws import skew
from multiarm.jit.rows import fields_of
from multiarm.notation import count_of
from multiarm.scene.control import ComputedTorqueControl, ObjectImpedanceControl

# Of a pressing force, the part that a joint may lose along its free motions.
LOST_PART = 0.01


class DesiredForces(NamedTuple):
    """What the contacts are to do beyond the motion; only its internal part remains."""

    of_contacts: np.ndarray  # (N,) [N]
    of_arms: np.ndarray  # (n, 6) wrenches on the object, about its centre of mass, its axes


def desired_forces(
    data: Data, control: ComputedTorqueControl | ObjectImpedanceControl, W_o: np.ndarray
) -> DesiredForces:
    """The desired forces of a scene, at the start in the data.

    ``W_o`` (N, 6) are the contacts' rows there.

    Raises
    ------
    ControlError
        When the contacts cannot have such internal forces.
    """
    model, of_contacts = data.model, np.zeros(len(W_o))
    of_arms = np.zeros((len(model.arm_names), 6))
    by_arm = model.layout.split_contacts(of_contacts)
    for arm, forces in (control.internal_forces or {}).items():
        if len(forces) != by_arm[arm].size:
            names = ", ".join(contact.name for contact in model.contacts[arm])
            raise ControlError(
                f"control.internal_forces.{arm}: {count_of(len(forces), 'force')} for "
                f"{count_of(by_arm[arm].size, 'contact')}; give one each: {names}"
            )
        by_arm[arm][:] = forces
    moving = np.linalg.norm(decompose(W_o.T, of_contacts).moving)
    if np.any(of_contacts) and moving > (1.0 - 1e-6) * np.linalg.norm(of_contacts):
        raise ControlError(
            "control.internal_forces: these forces only move the object, nothing of them is "
            "internal; name contacts that press against each other, or use `squeeze`"
        )
    if control.squeeze:
        contacts = [(arm, contact) for arm, of_arm in model.contacts.items() for contact in of_arm]
        if all(contact.pushes_only for _, contact in contacts):
            labels = [f"{arm}: {contact.name}" for arm, contact in contacts]
            of_contacts += control.squeeze * _pushing(W_o, labels)
        else:
            of_arms += control.squeeze * _towards_the_middle(model)
            _require_pressing(data, W_o, of_arms)
    return DesiredForces(of_contacts, of_arms)


def _require_pressing(data: Data, W_o: np.ndarray, of_arms: np.ndarray) -> None:
    """Raise an error for a squeeze along a joint's free motion."""
    model, R = data.model, fields_of(BodyMotion, data.arrays.bodies.object).rotation
    for i, arm in enumerate(model.arm_names):
        of_arm = W_o[model.layout.contacts_of(i)]
        desired = np.concatenate([R @ of_arms[i, :3], R @ of_arms[i, 3:]])
        reached = of_arm.T @ np.linalg.lstsq(of_arm.T, desired, rcond=None)[0]
        lost = np.linalg.norm((reached - desired)[:3])
        if lost > LOST_PART * np.linalg.norm(desired[:3]):
            raise ControlError(
                f"control.squeeze: the joint of arm '{arm}' cannot press towards the middle of all "
                f"grips, it gives way there; use `internal_forces` or a joint that holds"
            )


def _pushing(W_o: np.ndarray, names: list[str]) -> np.ndarray:
    try:
        return pressing_forces(W_o.T, names)
    except GraspError as error:
        raise ControlError(f"control.squeeze: {error}") from None


def _towards_the_middle(model: Model) -> np.ndarray:
    """Wrenches (n, 6) of the arms on the object, object axes, that are in balance.

    Each is a force of 1 N (in the mean over the arms) at the origin of the arm's joint frame,
    towards the middle of all of them as nearly as the balance of forces and moments allows.
    """
    grips = np.array([frame.on_object[:3, 3] for frame in model.frames.values()])
    inward = np.mean(grips, axis=0) - grips
    distance = np.linalg.norm(inward, axis=1)
    if not np.all(distance > 1e-9):
        raise ControlError(
            "control.squeeze: the arms do not hold the object from different sides, so that they "
            "cannot press against each other; leave `squeeze` out or join them elsewhere"
        )
    inward /= distance[:, None]
    balance = np.zeros((6, 3 * len(grips)))
    for k, grip in enumerate(grips):
        balance[:3, 3 * k : 3 * k + 3] = np.eye(3)
        balance[3:, 3 * k : 3 * k + 3] = skew(grip)
    wish = inward.ravel()
    forces = (wish - np.linalg.pinv(balance) @ (balance @ wish)).reshape(-1, 3)
    mean = np.mean(np.sum(forces * inward, axis=1))
    if not mean > 1e-6:
        raise ControlError(
            "control.squeeze: forces towards the middle of all grips cannot be in balance; use "
            "`internal_forces`"
        )
    forces /= mean
    return np.hstack([forces, np.cross(grips, forces)])
