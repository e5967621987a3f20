"""What guards watch: contacts, their forces and slip, joints and drives, functions of users.

Each kind has a record with what the function of its guards depends on, and the function beside it.
A guard is its sign times this function, see :mod:`multiarm.dynamics.guards`.  Rows are numbered
among all rows, those of a scene with all contacts closed; *held* rows are those of the mode, whose
forces are known.

Where the rate is known, an extremum inside a step shows.  A function that has a rate returns the
value, and *course* and rate: a smooth function of time that is the value where both fall.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.contacts.joint import unwrapped
from multiarm.contacts.kernel import PatchRow, depth_in_patch, open_contact, slip_of, tip_offset
from multiarm.contacts.motion import open_body
from multiarm.contacts.table import open_code, open_geometry
from multiarm.dynamics.kinematics import rate_by_block, rate_by_object, write_connection_motion
from multiarm.geometry.records import Patch
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.pointers import call_python
from multiarm.jit.rows import as_row
from multiarm.jit.structs import Float, Floats1, Floats2, Int, floats1, view_at
from multiarm.jit.vectors import add_scaled, rotate_back, sub

# --- gaps -----------------------------------------------------------------------------------------


class OpenGap(NamedTuple):
    """The gap of an open contact or of a joint's stop [m, rad]; it closes at zero."""

    row: Int


gap_at = view_at(OpenGap)


class Touch(NamedTuple):
    """How far the gap of a contact that touches without force is from opening or pressing [m]."""

    row: Int
    allowance: Float  # largest gap or penetration [m]


touch_at = view_at(Touch)


class SpringExtension(NamedTuple):
    """The extension of the spring of a compliant contact [m], see :func:`spring_length`."""

    row: Int
    lag: Float  # damping over stiffness [s]


extension_at = view_at(SpringExtension)


class SpringCompression(NamedTuple):
    """How far the spring of a compliant contact is pressed [m]: minus its extension."""

    row: Int
    lag: Float  # damping over stiffness [s]


compression_at = view_at(SpringCompression)


class PatchDepth(NamedTuple):
    """How far inside the patch of its surface a contact is [m]."""

    row: Int
    body: Int  # with the patch: its number in ``BodyVariables.motion``
    patch: Floats1  # :class:`~multiarm.contacts.kernel.PatchRow` in the body


patch_at = view_at(PatchDepth)


def packed_patch(patch: Patch) -> np.ndarray:
    """Frame and corners of a patch, (18,)."""
    corners = (np.clip(corner, -1e300, 1e300) for corner in (patch.lower, patch.upper))
    return as_row(PatchRow(patch.pose[:3, :3], patch.pose[:3, 3], *corners))


@inlined
def touch(guard, rows):
    """``allowance - |phi|``."""
    return guard.allowance - abs(open_contact(rows.kinematics[guard.row]).gap)


@inlined
def spring_extension(guard, rows):
    """The extension; gap and its rate, since the extension is the gap while the gap falls."""
    contact = open_contact(rows.kinematics[guard.row])
    return spring_length(contact.gap, contact.gap_rate, guard.lag), contact.gap, contact.gap_rate


@inlined
def spring_compression(guard, rows):
    """Minus the extension."""
    contact = open_contact(rows.kinematics[guard.row])
    return -spring_length(contact.gap, contact.gap_rate, guard.lag)


@inlined
def spring_length(gap, rate, lag):
    """Extension of a spring and damper that only push [m]; they push where it is negative.

    They push while they are compressed and their force ``-k (gap + lag rate)`` is positive, with
    ``lag`` the damping over the stiffness ``k`` [s].
    """
    return max(gap, gap + lag * rate)


@kernel
def depth_on_body(patch, body, row, model, data):
    """How far inside its patch (18,) on a body the contact of a row is [m]."""
    contact, code = open_contact(data.rows.kinematics[row]), open_code(model.contacts.codes[row])
    radius = open_geometry(model.contacts.geometry[row]).tip_radius
    offset = tip_offset(code.kind, code.surface_body, radius)
    touching = add_scaled(contact.point, offset, contact.normal)
    carrier = open_body(data.bodies.motion[body])
    return depth_in_patch(patch, rotate_back(carrier.rotation, sub(touching, carrier.origin)))


# --- forces and commands --------------------------------------------------------------------------


class PushingForce(NamedTuple):
    """The force of a contact [N], which pushes where it is positive."""

    row: Int  # held


push_at = view_at(PushingForce)


class FrictionCone(NamedTuple):
    """How far the force of a sticking contact is inside its friction cone [N]."""

    row: Int  # held
    mu: Float  # coefficient of friction; negative where the contact pulls
    # its tangents; what is not held has no force: other contacts hold the contact there
    first_tangent: Int
    second_tangent: Int


cone_at = view_at(FrictionCone)


class StaticFriction(NamedTuple):
    """How far the torque that dry friction holds a joint with is below its bound [N m, N]."""

    row: Int  # held
    bound: Float  # [N m, N]


static_friction_at = view_at(StaticFriction)


class DriveMargin(NamedTuple):
    """How far the command of a joint's drive is below its limit [N m, N]."""

    joint: Int
    excess: Int  # place of this array in the system's struct, see EffectKernel.watched


drive_at = view_at(DriveMargin)


@inlined
def friction_cone(guard, held, force):
    r"""``mu \lambda_n - |\lambda_t|``."""
    first, second, square = held[guard.first_tangent], held[guard.second_tangent], 0.0
    if first >= 0:
        square += force[first] ** 2
    if second >= 0:
        square += force[second] ** 2
    return guard.mu * force[held[guard.row]] - math.sqrt(square)


@inlined
def drive_margin(guard, struct):
    """Minus the excess of the command over the limit."""
    return -floats1(struct, guard.excess)[guard.joint]


# --- speeds ---------------------------------------------------------------------------------------


class Slip(NamedTuple):
    """The speed of a sliding contact along the direction of its slip [m/s]."""

    tangent: Int  # the row of the first of its two tangents
    block: Int  # of these rows
    constraint: Int  # of the scene's unilateral constraints
    directions: Floats2  # (s, 2) of all sliding contacts, see multiarm.dynamics.sliding


slip_at = view_at(Slip)


class SlipOnset(NamedTuple):
    """How far the slip of a contact that rests is below the speed of one that slides [m/s]."""

    tangent: Int  # the row of the first of its two tangents
    still: Float  # largest speed at rest [m/s]


onset_at = view_at(SlipOnset)


class JointSpeed(NamedTuple):
    """The speed of a joint [rad/s, m/s]."""

    joint: Int


joint_speed_at = view_at(JointSpeed)


@inlined
def slip(guard, slides, accelerations, full, work):
    """``d . s`` and its rate; ``slides`` are the numbers of the sliding contacts, by constraint."""
    t, direction = guard.tangent, guard.directions[slides[guard.constraint]]
    first, second = slip_of(full.rows.kinematics, t)
    value, rate = first * direction[0] + second * direction[1], 0.0
    for k in range(2):
        by_object = rate_by_object(t + k, full, accelerations.a_o)
        by_block = rate_by_block(guard.block, t + k, work, accelerations.a_j)
        bias = open_contact(full.rows.kinematics[t + k]).gap_bias
        rate += direction[k] * (by_object + by_block + bias)
    return value, rate


@inlined
def slip_onset(guard, rows):
    """``still - |s|``."""
    t = guard.tangent
    first, second = slip_of(rows.kinematics, t)
    return guard.still - math.sqrt(first * first + second * second)


# --- ranges ---------------------------------------------------------------------------------------


class RangeDepth(NamedTuple):
    """How far inside its range a component of the motion of a connection is [m, rad]."""

    connection: Int
    component: Int  # of the six relative motions, see multiarm.contacts.joint
    lower: Float
    upper: Float


range_at = view_at(RangeDepth)


@kernel
def range_depth(guard, model, data):
    """The distance to the nearer end, and its rate; NaN where the component is not free."""
    c, component = guard.connection, guard.component
    rates, coordinates = data.joint_motion.rates, data.joint_motion.coordinates
    free = model.free
    for k in range(free.bounds[c], free.bounds[c + 1]):
        if free.component[k] == component:
            write_connection_motion(model, data, c, rates, coordinates)
            place = free.coordinate[k]
            x = unwrapped(coordinates[place], data.last_step.coordinates[c, component], place)
            above, below = x - guard.lower, guard.upper - x
            return (above, rates[component]) if above < below else (below, -rates[component])
    return math.nan, math.nan


# --- functions of users ---------------------------------------------------------------------------


class UserFunction(NamedTuple):
    """A function of a user, of time and state."""

    function: Int  # address of a function that writes its value
    value: Floats1  # (1,)


user_function_at = view_at(UserFunction)


@inlined
def user_value(guard):
    """The value of the function at the state evaluated last."""
    call_python(guard.function)
    return guard.value[0]


# --- all kinds ------------------------------------------------------------------------------------


# The records, whose places here are the numbers of their kinds.
KINDS: tuple[type, ...] = (
    OpenGap, Touch, SpringExtension, SpringCompression, PatchDepth, PushingForce, FrictionCone,
    StaticFriction, DriveMargin, Slip, SlipOnset, JointSpeed, RangeDepth, UserFunction,
)  # fmt: skip
(
    OPEN_GAP, TOUCH, SPRING_EXTENSION, SPRING_COMPRESSION, PATCH_DEPTH, PUSH, FRICTION_CONE,
    STATIC_FRICTION, DRIVE_MARGIN, SLIP, SLIP_ONSET, JOINT_SPEED, RANGE_DEPTH, USER_FUNCTION,
) = range(len(KINDS))  # fmt: skip


@inlined
def is_force_function(kind):
    """Whether the function depends on forces or on commands of drives, known at every stage."""
    return kind in (PUSH, FRICTION_CONE, STATIC_FRICTION, DRIVE_MARGIN)


@kernel
def force_function(guards, g, struct, force):
    """Value of such a function of guard ``g``, for the forces of the held rows."""
    kind, records, at, held = guards.kind[g], guards.records, guards.place[g], guards.held
    if kind == PUSH:
        return force[held[push_at(records, at).row]]
    if kind == FRICTION_CONE:
        return friction_cone(cone_at(records, at), held, force)
    if kind == STATIC_FRICTION:
        guard = static_friction_at(records, at)
        return guard.bound - abs(force[held[guard.row]])
    return drive_margin(drive_at(records, at), struct)


@kernel
def guard_function(guards, g, struct, data, model, full, work):
    """Value, course and rate for guard ``g`` at the state evaluated last; without a rate, it is 0.

    ``model``, ``full`` and ``work`` are those of the system with all rows, with their kinematics.
    """
    kind, records, at = guards.kind[g], guards.records, guards.place[g]
    if kind == OPEN_GAP:
        contact = open_contact(full.rows.kinematics[gap_at(records, at).row])
        return contact.gap, contact.gap, contact.gap_rate
    if kind == SPRING_EXTENSION:
        return spring_extension(extension_at(records, at), full.rows)
    if kind == RANGE_DEPTH:
        depth, rate = range_depth(range_at(records, at), model, data)
        return depth, depth, rate
    if kind == SLIP:
        speed, rate = slip(slip_at(records, at), guards.slides, data.accelerations, full, work)
        return speed, speed, rate
    if kind == JOINT_SPEED:
        joint = joint_speed_at(records, at).joint
        speed = data.state.joint_rates[joint]
        return speed, speed, data.accelerations.a_j[joint]
    if is_force_function(kind):
        value = force_function(guards, g, struct, data.rows.force)
    elif kind == TOUCH:
        value = touch(touch_at(records, at), full.rows)
    elif kind == SPRING_COMPRESSION:
        value = spring_compression(compression_at(records, at), full.rows)
    elif kind == PATCH_DEPTH:
        guard = patch_at(records, at)
        value = depth_on_body(guard.patch, guard.body, guard.row, model, full)
    elif kind == SLIP_ONSET:
        value = slip_onset(onset_at(records, at), full.rows)
    else:
        value = user_value(user_function_at(records, at))
    return value, value, 0.0
