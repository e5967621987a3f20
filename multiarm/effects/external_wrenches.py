r"""External forces and torques on the object or on links of the arms.

A force ``f`` and a torque ``m`` at a point ``p``, in world axes, add to the right-hand sides

.. math::
    f_o \mathrel{+}= \begin{bmatrix} f \\ m + (p - x_o)\times f \end{bmatrix}
    \quad\text{or}\quad
    f_j \mathrel{+}= J_j^T \begin{bmatrix} f \\ m + p\times f \end{bmatrix}

for the joints ``j`` that carry the link, ``J`` being the arm's Jacobian about the world's origin.
Pinocchio has the pose of every joint after each evaluation; a compiled arm writes those of the
links in use.

A wrench is constant, or times :math:`\sin(2\pi f t + \psi)`, or a pulse from ``begin`` to ``end``,
or a table over time, or the result of a function.  Tables are interpolated by cubics with a
continuous slope that do not overshoot (F.N. Fritsch, J. Butland, SIAM J. Sci. Stat. Comput. 5,
1984).  Steps end at the rows of tables and at the ends of pulses.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from multiarm.contacts.motion import open_body
from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.callbacks import UserCallback
from multiarm.dynamics.coordinates import chart_places, force_columns
from multiarm.dynamics.data import Data
from multiarm.dynamics.effect_kernels import APPLIED, EffectKernel, set_power, view_of_effect
from multiarm.dynamics.piecewise import polynomial, row_at
from multiarm.dynamics.state import checked_vector
from multiarm.effects.building import BuildContext
from multiarm.errors import ControlError
from multiarm.jit.kernels import cfunc, clear, inlined, kernel
from multiarm.jit.pointers import call_python
from multiarm.jit.structs import Floats1, Floats2, Floats3, Ints1, Ints2, floats_at, struct_at
from multiarm.jit.vectors import (
    AXES,
    ZERO,
    add,
    add_cross,
    add_rotated,
    compose,
    cross,
    dot,
    put,
    rotate,
    rotation,
    vec,
)
from multiarm.robots.chain import twist_product
from multiarm.robots.terms import POSE_WIDTH, open_addresses, open_pose
from multiarm.scene import read_wrench_table

# Time dependence.
CONSTANT, SINUSOID, PULSE, TABLE, FUNCTION = range(5)


class ExternalWrenches(NamedTuple):
    """Wrenches, k of them."""

    course: Ints1  # time dependence
    on_link: Ints1  # whether it acts on a link, else on an object
    object: Ints1  # that object
    in_body: Ints1  # whether its axes are those of the body, else of the world
    # of one on a link: number of its pose, block of the joints that move it, the block's first
    # joint; (k, d) these joints, counted from the block's first, how many they are, and how many of
    # them are those of a floating base
    link: Ints1
    block: Ints1
    first_joint: Ints1
    chain: Ints2
    joints: Ints1
    base: Ints1
    function: Ints1  # address of a function that writes it
    # of a table: its first row among those of all tables, and how many
    first_row: Ints1
    rows: Ints1
    frequency: Floats1  # of a sinusoid [Hz]
    phase: Floats1  # [rad]
    begin: Floats1  # of a pulse [s]
    end: Floats1
    frame: Floats2  # (k, 9) the link's frame in that of the joint that carries it
    point: Floats2  # (k, 3) in the frame of this joint, or of the object [m]
    size: Floats2  # (k, 6) force and torque
    # rows of all tables: times [s], and cubics (r, 6, 4) from each of them on, see
    # multiarm.dynamics.piecewise; those from the last row of a table on are zero
    times: Floats1
    cubics: Floats3
    wrench: Floats2  # (k, 6) at the last evaluation


open_wrenches = view_of_effect(ExternalWrenches)


@cfunc
def add_external_wrenches(address, size, at, t):
    """Add all wrenches at time ``t``."""
    struct = struct_at(address, size)
    data, wrenches, power = open_data(struct), open_wrenches(struct, at), 0.0
    for k in range(wrenches.course.size):
        lever = place_wrench(wrenches, k, data, t)
        power += apply_wrench(wrenches, k, lever, data)
    set_power(struct, at, power)
    return 0


@cfunc
def differentiate_external_wrenches(address, size, at, t):
    """Add the derivatives of all wrenches at time ``t``."""
    struct = struct_at(address, size)
    data, wrenches = open_data(struct), open_wrenches(struct, at)
    for k in range(wrenches.course.size):
        lever = place_wrench(wrenches, k, data, t)
        f = vec(wrenches.wrench[k], 0)
        m = add_cross(vec(wrenches.wrench[k], 3), lever, f)
        follows = wrenches.in_body[k] != 0
        if wrenches.on_link[k] != 0:
            differentiate_on_link(wrenches, k, lever, f, m, follows, data)
            continue
        turn = 6 * wrenches.object[k] + 3
        for axis in range(3):
            e = AXES[axis]
            by_turn = cross(e, f) if follows else ZERO
            moment_by_turn = cross(e, m) if follows else cross(cross(e, lever), f)
            for a in range(3):
                data.slopes.force[turn - 3 + a, turn + axis] += by_turn[a]
                data.slopes.force[turn + a, turn + axis] += moment_by_turn[a]
    return 0


@inlined
def differentiate_on_link(wrenches, k, lever, f, m, follows, data):
    """Add the derivatives of the torques of a wrench on a link, by joints that carry it.

    A joint displaces the columns of those after it, the point, and axes of the body, by its twist
    about the world's origin.  Those of a floating base do not turn with each other.
    """
    first, chain = wrenches.first_joint[k], wrenches.chain[k]
    addresses = open_addresses(data.bodies.pointers[wrenches.block[k]])
    J = floats_at(addresses.jacobian, 6 * columns_of_carriers(wrenches, k))
    row, column = chart_places(data).joints + first, force_columns(data).positions + first
    for a in range(wrenches.joints[k]):
        i = chain[a]
        v, w = vec(J, 6 * i), vec(J, 6 * i + 3)
        df, dm = ZERO, cross(add_cross(v, w, lever), f)
        if follows:
            df, dm = cross(w, f), add_cross(cross(w, m), v, f)
        for b in range(wrenches.joints[k]):
            j = chain[b]
            twist = vec(J, 6 * j), vec(J, 6 * j + 3)
            slope = dot(twist[0], df) + dot(twist[1], dm)
            if b > a and (b >= wrenches.base[k] or a < 3):
                moved = twist_product((v, w), twist)
                slope += dot(moved[0], f) + dot(moved[1], m)
            data.slopes.force[row + j, column + i] += slope


@kernel
def place_wrench(wrenches, k, data, t):
    """Write a wrench at time ``t``, world axes; returns its lever arm.

    It is about the object's centre of mass, or about the world's origin.
    """
    write_wrench(wrenches, k, t)
    R, origin = open_body(data.bodies.objects[wrenches.object[k]]).rotation, ZERO
    if wrenches.on_link[k] != 0:
        pose = open_pose(floats_at(data.effects.link_poses[wrenches.link[k]], POSE_WIDTH))
        R, origin = pose.axes, pose.origin
    if wrenches.in_body[k] != 0:
        to_world(R, wrenches.frame[k], wrenches.wrench[k])
    return add_rotated(origin, R, vec(wrenches.point[k], 0))


@kernel
def write_wrench(wrenches, k, t):
    """Force and torque at time ``t``, in the axes in which they are given."""
    course, factor, wrench = wrenches.course[k], 1.0, wrenches.wrench[k]
    if course == FUNCTION:
        call_python(wrenches.function[k])  # writes them
        return
    if course == TABLE:
        first = wrenches.first_row[k]
        end = first + wrenches.rows[k]
        interpolate_wrench(wrenches.times[first:end], wrenches.cubics[first:end], t, wrench)
        return
    if course == SINUSOID:
        factor = math.sin(2.0 * math.pi * wrenches.frequency[k] * t + wrenches.phase[k])
    elif course == PULSE:
        factor = 1.0 if wrenches.begin[k] <= t < wrenches.end[k] else 0.0
    for a in range(6):
        wrench[a] = factor * wrenches.size[k, a]


@kernel
def interpolate_wrench(times, cubics, t, wrench):
    """The six cubics of the row that ``t`` follows; zero before the first and after the last."""
    row = row_at(times, t)
    if row < 0:
        clear(wrench)
        return
    for a in range(6):
        wrench[a], _ = polynomial(cubics[row, a], t - times[row])


@kernel
def to_world(R, frame, wrench):
    """Turn force and torque from the axes of the link or object into those of the world."""
    R = compose(R, rotation(frame, 0))
    put(wrench, 0, rotate(R, vec(wrench, 0)))
    put(wrench, 3, rotate(R, vec(wrench, 3)))


@kernel
def apply_wrench(wrenches, k, lever, data):
    """Add a wrench to the right-hand sides; returns its power [W]."""
    wrench = wrenches.wrench[k]
    f = vec(wrench, 0)
    m = add_cross(vec(wrench, 3), lever, f)
    if wrenches.on_link[k] == 0:
        o = wrenches.object[k]
        f_o, body, at = data.forces.f_o, open_body(data.bodies.objects[o]), 6 * o
        put(f_o, at, add(vec(f_o, at), f))
        put(f_o, at + 3, add(vec(f_o, at + 3), m))
        return dot(f, body.velocity) + dot(m, body.spin)
    first, power = wrenches.first_joint[k], 0.0
    addresses = open_addresses(data.bodies.pointers[wrenches.block[k]])
    J = floats_at(addresses.jacobian, 6 * columns_of_carriers(wrenches, k))
    for a in range(wrenches.joints[k]):
        j = wrenches.chain[k, a]
        torque = dot(f, vec(J, 6 * j)) + dot(m, vec(J, 6 * j + 3))
        data.forces.f_j[first + j] += torque
        power += torque * data.state.joint_rates[first + j]
    return power


@inlined
def columns_of_carriers(wrenches, k):
    """Number of columns of a block's Jacobian up to that of the last joint that carries a link."""
    joints = wrenches.joints[k]
    return wrenches.chain[k, joints - 1] + 1 if joints > 0 else 0


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The kernel of external wrenches; their functions have been loaded."""
    joints = max(context.layout.joint_counts)
    wrenches, breakpoints = _without_course(len(spec), joints), [np.zeros(0)]
    functions: dict[int, Callable] = {}
    for k, wrench in enumerate(spec):
        _place(wrench, context, wrenches, k)
        wrenches.size[k] = [*(wrench.force or (0, 0, 0)), *(wrench.torque or (0, 0, 0))]
        if wrench.sinusoid is not None:
            wrenches.course[k] = SINUSOID
            wrenches.frequency[k] = wrench.sinusoid.frequency
            wrenches.phase[k] = wrench.sinusoid.phase
        elif wrench.pulse is not None:
            wrenches.course[k] = PULSE
            wrenches.begin[k], wrenches.end[k] = wrench.pulse.begin, wrench.pulse.end
            breakpoints.append(np.array([wrench.pulse.begin, wrench.pulse.end]))
        elif wrench.table is not None:
            times, cubics = _table_of(wrench.table, wrenches.size[k])
            wrenches.course[k] = TABLE
            wrenches.first_row[k], wrenches.rows[k] = len(wrenches.times), len(times)
            wrenches = wrenches._replace(
                times=np.append(wrenches.times, times), cubics=np.vstack([wrenches.cubics, cubics])
            )
            breakpoints.append(times)
        elif wrench.function is not None:
            wrenches.course[k] = FUNCTION
            functions[k] = wrench.function

    def connect(data: Data, arrays: ExternalWrenches) -> dict[str, UserCallback]:
        calls = {}
        for k, function in functions.items():
            name = f"external_wrenches[{k}]"
            calls[name] = _callback(function, name, arrays.wrench[k], data)
            arrays.function[k] = calls[name].address
        return calls

    return [
        EffectKernel(
            "external_wrenches",
            add_external_wrenches,
            APPLIED,
            wrenches,
            breakpoints=np.concatenate(breakpoints),
            connect=connect if functions else None,
            calls_user=bool(functions),
            local=not functions,
            derivative=None if functions else differentiate_external_wrenches,
        )
    ]


def _without_course(count: int, joints: int) -> ExternalWrenches:
    """Arrays for a number of wrenches, all of them zero, and no table.

    ``joints`` is the largest number of joints of a block.
    """
    widths = {"frame": 9, "point": 3, "size": 6, "wrench": 6}
    numbers = ("frequency", "phase", "begin", "end")
    tables = {"times": np.zeros(0), "cubics": np.zeros((0, 6, 4))}
    integers = set(ExternalWrenches._fields) - {*widths, *numbers, *tables, "chain"}
    return ExternalWrenches(
        chain=np.zeros((count, joints), dtype=np.int64),
        **{name: np.zeros(count, dtype=np.int64) for name in integers},
        **{name: np.zeros(count) for name in numbers},
        **{name: np.zeros((count, width)) for name, width in widths.items()},
        **tables,
    )


def _place(wrench, context: BuildContext, wrenches: ExternalWrenches, k: int) -> None:
    """Write the body and the point of a wrench."""
    frame, point = np.eye(3), np.array(wrench.at)
    if wrench.target.is_link:
        link = context.link(wrench.target.robot, wrench.target.tip)
        wrenches.on_link[k], wrenches.link[k], wrenches.block[k] = 1, link.number, link.block
        wrenches.first_joint[k], wrenches.joints[k] = link.first, link.chain.size
        wrenches.chain[k, : link.chain.size], wrenches.base[k] = link.chain, link.base
        frame, point = link.rotation, link.rotation @ point + link.translation
    elif wrench.on in context.layout.objects:  # else the only one
        wrenches.object[k] = context.layout.objects.index(wrench.on)
    wrenches.in_body[k] = wrench.axes == "body"
    wrenches.frame[k] = frame.ravel()
    wrenches.point[k] = point


def _table_of(table, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times (r,) of a table, and cubics (r, 6, 4) from each row on, highest power first."""
    from scipy.interpolate import PchipInterpolator

    if table.file is not None:
        rows = np.array(read_wrench_table(table.file)[0])
        times, values = rows[:, 0].copy(), rows[:, 1:]
    else:
        times, values = np.array(table.times), np.outer(table.values, size)
    between = PchipInterpolator(times, values).c.transpose(1, 2, 0)  # (r - 1, 6, 4)
    return times, np.ascontiguousarray(np.concatenate([between, np.zeros((1, 6, 4))]))


def _callback(function: Callable, name: str, out: np.ndarray, data: Data) -> UserCallback:
    """A function ``f(t, state)`` that writes force and torque."""
    words = f"the function of {name}"

    def read(result: object) -> np.ndarray:
        return checked_vector(f"{words}, force and torque", result, 6, ControlError)

    layout = data.model.layout
    return UserCallback(function, words, read, out, layout, data.arrays, owner=function)
