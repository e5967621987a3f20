r"""Internal forces that laws of the object ask for: of contacts, and wrenches of connections.

A squeeze consists of internal forces.  Where all contacts are fingertips, which can only push, it
is a combination of pushing forces (thesis, 3.7.3) with the mean that the scene names.  Bilateral
joints hold both ways; there every connection of the object presses towards the middle of all
grips.  Of several objects, those that the law moves are squeezed, each between its hands and the
world: what connects it to other objects takes no part.

Where friction is counted, contacts are squeezed by the forces in the middle of its cones
(:mod:`multiarm.dynamics.forces.friction`), without those above.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from multiarm.contacts.motion import BodyMotion
from multiarm.dynamics.data import Data
from multiarm.dynamics.forces.internal_forces import decompose, pressing_forces
from multiarm.dynamics.model import Model
from multiarm.errors import ControlError, GraspError
from multiarm.geometry.records import Contact
from multiarm.geometry.screws import skew
from multiarm.jit.rows import fields_of
from multiarm.notation import count_of
from multiarm.scene.control import ComputedTorqueControl, ObjectImpedanceControl

# Of a pressing force, the part that a joint may lose along its free motions.
LOST_PART = 0.01


class DesiredForces(NamedTuple):
    """What the contacts are to do beyond the motion; only its internal part remains."""

    of_contacts: np.ndarray  # (N,) [N]
    # (C, 6) wrenches of the connections on their object, about its centre of mass, its axes
    of_connections: np.ndarray
    pressed: np.ndarray  # int (C,) this object


def desired_forces(
    data: Data,
    control: ComputedTorqueControl | ObjectImpedanceControl,
    moved: Sequence[str],
    tangents: Collection[int] = (),
) -> DesiredForces:
    """The desired forces of a scene, at the start in the data; ``moved`` objects are squeezed.

    ``tangents`` are rows of friction, which are not named.

    Raises
    ------
    ControlError
        When the contacts cannot have such internal forces.
    """
    model, of_contacts = (
        data.model,
        _named_forces(data.model, control.internal_forces or {}, tangents),
    )
    of_connections = np.zeros((len(model.layout.owners), 6))
    pressed = np.zeros(len(model.layout.owners), dtype=np.int64)
    if not (control.squeeze or control.internal_forces):
        return DesiredForces(of_contacts, of_connections, pressed)
    W_o = data.arrays.rows.W_o
    moving = np.linalg.norm(decompose(W_o.T, of_contacts).moving)
    if np.any(of_contacts) and moving > (1.0 - 1e-6) * np.linalg.norm(of_contacts):
        raise ControlError(
            "control.internal_forces: these forces only move the object, nothing of them is "
            "internal; name contacts that press against each other, or use `squeeze`"
        )
    for name in moved if control.squeeze else ():
        rows, at = _contacts_of(model, name), 6 * model.layout.objects.index(name)
        on_object = W_o[:, at : at + 6]
        if all(model.records[row].pushes_only for row in rows):
            labels = [": ".join((owner, record.name)) for owner, record in map(model.owner, rows)]
            of_contacts[rows] += control.squeeze * _pushing(on_object[rows], labels)
        else:
            holding = [model.layout.owners.index(holder) for holder in _holding(model, name)]
            pressed[holding] = model.layout.objects.index(name)
            of_connections[holding] = control.squeeze * _towards_the_middle(model, name)
            _require_pressing(data, name, on_object, of_connections)
    return DesiredForces(of_contacts, of_connections, pressed)


def _named_forces(
    model: Model, by_connection: Mapping[str, Sequence[float]], tangents: Collection[int]
) -> np.ndarray:
    """The forces of contacts (N,) that a scene names; zero for all others and for ``tangents``."""
    of_rows = np.zeros(model.layout.contacts)
    by_owner = model.layout.split_contacts(of_rows)
    for connection, forces in by_connection.items():
        records = model.contacts[connection]
        first = model.layout.contacts_of(model.layout.owners.index(connection)).start
        places = [
            k
            for k, record in enumerate(records)
            if isinstance(record, Contact) and first + k not in tangents
        ]
        names = [records[k].name for k in places]
        if len(forces) != len(names):
            raise ControlError(
                f"control.internal_forces.{connection}: {count_of(len(forces), 'force')} for "
                f"{count_of(len(names), 'contact')}; give one each: {', '.join(names)}"
            )
        by_owner[connection][places] = forces
    return of_rows


def _holding(model: Model, object: str) -> list[str]:
    """The connections of an object with robots and with the world."""
    return [name for name, pair in model.connections.items() if pair.objects == (object,)]


def _contacts_of(model: Model, object: str) -> list[int]:
    """Rows of the contacts of these connections."""
    rows: list[int] = []
    for name in _holding(model, object):
        of_owner = model.layout.contacts_of(model.layout.owners.index(name))
        rows += range(of_owner.start, of_owner.stop)
    return [row for row in rows if isinstance(model.records[row], Contact)]


def _require_pressing(data: Data, object: str, W_o: np.ndarray, of_connections: np.ndarray) -> None:
    """Raise an error for a squeeze of an object along a joint's free motion; ``W_o`` (N, 6)."""
    model, o = data.model, data.model.layout.objects.index(object)
    R = fields_of(BodyMotion, data.arrays.bodies.objects[o]).rotation
    for name in _holding(model, object):
        c = model.layout.owners.index(name)
        rows, wrench = W_o[model.layout.contacts_of(c)], of_connections[c]
        desired = np.concatenate([R @ wrench[:3], R @ wrench[3:]])
        reached = rows.T @ np.linalg.lstsq(rows.T, desired, rcond=None)[0]
        lost = np.linalg.norm((reached - desired)[:3])
        if lost > LOST_PART * np.linalg.norm(desired[:3]):
            raise ControlError(
                f"control.squeeze: {joint_text(model, name)} cannot press towards the middle of "
                f"all grips, it gives way there; use `internal_forces` or a joint that holds"
            )


def joint_text(model: Model, connection: str) -> str:
    """A connection in a message."""
    arm = connection in model.robots
    return f"the joint of arm '{connection}'" if arm else f"the joint '{connection}'"


def _pushing(W_o: np.ndarray, names: list[str]) -> np.ndarray:
    try:
        return pressing_forces(W_o.T, names)
    except GraspError as error:
        raise ControlError(f"control.squeeze: {error}") from None


def _towards_the_middle(model: Model, object: str) -> np.ndarray:
    """Wrenches (C, 6) of the connections that hold an object, object axes, that are in balance.

    Each is a force of 1 N (in their mean) at the origin of the joint's frame on the object, towards
    the middle of all of them as nearly as the balance of forces and moments allows.
    """
    grips = np.array([_grip(model, name) for name in _holding(model, object)]).reshape(-1, 3)
    inward = np.mean(grips, axis=0) - grips if len(grips) else grips
    distance = np.linalg.norm(inward, axis=1)
    if not (len(grips) and np.all(distance > 1e-9)):
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


def _grip(model: Model, connection: str) -> np.ndarray:
    """Origin of a joint's frame on the object, in its axes, shape (3,) [m]."""
    frame, pair = model.frames[connection], model.connections[connection]
    return (frame.on_tip if pair.first.is_object else frame.on_object)[:3, 3]
