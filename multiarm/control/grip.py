r"""Grips: what contacts can do for an object, by their normals alone or with friction.

Control counts friction where the scene says how much of it is not to be used, ``friction_margin``;
laws of the object also where the contacts need it to put every wrench on the object.  The rows of
such laws have the tangents of contacts that only push, which stick as far as the law knows, and its
forces are those of :func:`multiarm.dynamics.forces.friction.distribute_within_friction`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from multiarm.control.program import ControlContext
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.forces.friction import (
    BEYOND_FRICTION,
    NOT_CONVERGED,
    distribute_within_friction,
)
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.status import OK
from multiarm.errors import ControlError
from multiarm.geometry.records import Contact
from multiarm.jit.structs import Float, Floats1, Ints1
from multiarm.scene.control import (
    ComputedTorqueControl,
    GravityCompensationControl,
    JointPDControl,
    ObjectImpedanceControl,
)

GrippingControl = (
    ComputedTorqueControl | ObjectImpedanceControl | GravityCompensationControl | JointPDControl
)
# Part of friction that is not used, where the scene does not say it.
MARGIN = 0.2
# Without a squeeze contacts press this part of their share of the weight, with this gravity
# [m/s^2] where there is none.
LEAST_PART, STANDARD_GRAVITY = 0.1, 9.81
# The least friction that would do is sought up to this, and to this part of it.
MOST_FRICTION, FRICTION_PART = 1e3, 1e-3

ANSWERS = {
    BEYOND_FRICTION: (
        "no forces within the friction of the contacts exert the wrench that the control commands; "
        "take a slower path or smaller gains, more friction or a smaller `friction_margin`, or "
        "fingertips that press from more sides"
    ),
    NOT_CONVERGED: (
        "the forces within the friction of the contacts were not found: the wrench that the "
        "control commands is at the limit of what they can exert; take more friction, a smaller "
        "`friction_margin` or a slower path"
    ),
}
"""What laws that count friction answer."""


class PushingContacts(NamedTuple):
    """Contacts that only push, for laws; none where these do not count friction."""

    pushing: Ints1  # (C,) rows of the normals; the tangents of one with friction follow
    friction: Floats1  # (C,) coefficients less the margin; 0: without tangents
    least: Float  # how hard they press without a wrench [N]


@dataclass(frozen=True)
class Grip:
    """The system for which a law is built, and the friction that it counts.

    Attributes
    ----------
    context : ControlContext
        With the rows that the law sees.
    contacts : PushingContacts
    """

    context: ControlContext
    contacts: PushingContacts

    @property
    def counts_friction(self) -> bool:
        """Whether the law counts friction."""
        return bool(self.contacts.pushing.size)

    @property
    def tangents(self) -> frozenset[int]:
        """Rows of the tangents of contacts that only push."""
        pushing, friction = self.contacts.pushing, self.contacts.friction
        return frozenset((pushing[friction > 0.0, None] + [1, 2]).ravel().tolist())


def grip_of(control: GrippingControl, context: ControlContext, moved: Sequence[str] = ()) -> Grip:
    """The grip of a control; of a law of the object that puts every wrench on ``moved`` ones.

    Raises
    ------
    ControlError
        When the contacts cannot put every wrench on these objects, there is no friction to count,
        or it does not carry the weight.
    """
    if control.friction_margin is not None and not context.can_grip:
        raise ControlError(
            "control.friction_margin: no contact has friction; add it, as with `effects: "
            "{contact_friction: 0.5}`, or leave the margin out"
        )
    needed = context.can_grip and any(free_directions(_started(context), name) for name in moved)
    if control.friction_margin is None and not needed:
        _require_hold(_started(context), moved, control.kind)
        return Grip(context, PushingContacts(np.zeros(0, dtype=np.int64), np.zeros(0), 0.0))
    context = context.counting_friction()
    data = _started(context)
    _require_hold(data, data.model.layout.objects, control.kind)
    if context.start.layout.undriven_joints.size:
        name = data.model.joint_names[context.start.layout.undriven_joints[0]]
        raise ControlError(
            f"control: friction is not counted with joints without a drive, such as '{name}'; "
            "leave `friction_margin` out, or give the joint a drive"
        )
    margin = MARGIN if control.friction_margin is None else control.friction_margin
    contacts = _pushing_contacts(control, context, margin)
    _require_friction(control.kind, data, contacts, margin)
    return Grip(context, contacts)


def _started(context: ControlContext) -> Data:
    """The data of a context with the kinematics of its start."""
    context.data.set_state(0.0, context.start)
    require_ok(context.data, update_kinematics(context.data.struct))
    return context.data


def free_directions(data: Data, object: str) -> int:
    """How many of an object's six directions no contacts can push, at the state in the data."""
    W_o, objects = data.arrays.rows.W_o, data.model.layout.objects
    moments = W_o.reshape(len(W_o), -1, 6)[:, :, 3:]
    lever = max(float(np.max(np.linalg.norm(moments, axis=2), initial=0.0)), 1e-12)
    scale = np.tile([1.0, 1.0, 1.0, lever, lever, lever], len(objects))
    first = 6 * objects.index(object)
    of_object = null_space(W_o / scale).basis[first : first + 6]
    return int(np.linalg.matrix_rank(of_object, 1e-6)) if of_object.size else 0


def _require_hold(data: Data, moved: Sequence[str], kind: str) -> None:
    """Refuse contacts that cannot put every wrench on the objects that are ``moved``."""
    for name in moved:
        free = free_directions(data, name)
        if free:
            objects, rows = data.model.layout.objects, data.model.layout.contacts
            what = "the object" if len(objects) == 1 else f"the object '{name}'"
            raise ControlError(
                f"control: {kind} needs contacts that can put every force and moment on {what}, "
                f"but all {rows} together span only {6 - free} of 6 directions: it can turn or "
                f"slide in them freely; add an arm, or join one with fewer free motions"
            )


def _pushing_contacts(
    control: GrippingControl, context: ControlContext, margin: float
) -> PushingContacts:
    model, unilateral = context.data.model, context.full.model.unilateral
    assert unilateral is not None, "some contacts can grip"
    coefficients = {
        unilateral.of_laws.index(contact.row): contact.mu for contact in unilateral.grips
    }
    pushing = [
        row
        for row, record in enumerate(model.records)
        if isinstance(record, Contact) and record.pushes_only
    ]
    gravity = float(np.linalg.norm(model.constants.gravity)) or STANDARD_GRAVITY
    weight = gravity * float(np.sum(model.constants.object_masses))
    least = control.squeeze or LEAST_PART * weight / len(pushing)
    friction = [(1.0 - margin) * coefficients.get(row, 0.0) for row in pushing]
    return PushingContacts(np.array(pushing, dtype=np.int64), np.array(friction), least)


def _require_friction(kind: str, data: Data, contacts: PushingContacts, margin: float) -> None:
    """Refuse contacts that cannot carry the weight within friction."""
    wrench = np.zeros(data.model.layout.node)
    constants = data.model.constants
    for o, mass in enumerate(constants.object_masses):
        wrench[6 * o : 6 * o + 3] = -mass * constants.gravity

    W_o = data.arrays.rows.W_o
    none, force = np.zeros((2, len(W_o)))

    def answer(more: float) -> int:
        return distribute_within_friction(
            wrench, W_o, contacts.pushing, more * contacts.friction, contacts.least, none, force
        )

    def carries(more: float) -> bool:
        return answer(more) == OK

    as_it_is = answer(1.0)
    if as_it_is == OK:
        return
    if as_it_is == NOT_CONVERGED:
        raise ControlError(f"control: {kind} holds by friction; at the start {ANSWERS[as_it_is]}")
    what = "carry the weight" if np.any(wrench) else "press against each other"
    text = (
        f"control: {kind} holds by friction, but no forces within it, less `friction_margin: "
        f"{margin:g}`, {what}"
    )
    if not carries(MOST_FRICTION):
        raise ControlError(
            f"{text}, and more friction would not help; let fingertips press from opposite sides, "
            "or add an arm"
        )
    low, high = 1.0, MOST_FRICTION
    while high - low > FRICTION_PART * low:
        middle = np.sqrt(low * high)
        low, high = (low, middle) if carries(middle) else (middle, high)
    largest = float(np.max(contacts.friction)) / (1.0 - margin)
    smaller = 1.0 - (1.0 - margin) * high
    margins = f", or a margin of at most {max(smaller - 5e-3, 0.0):.2f}" if smaller > 0.01 else ""
    raise ControlError(
        f"{text}; it takes {high:.3g} times the friction, such as {high * largest:.3g} in place of "
        f"{largest:.3g}{margins}, or fingertips that press from opposite sides"
    )
