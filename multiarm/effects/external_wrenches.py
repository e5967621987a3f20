r"""External forces and torques on the object or on links of the arms.

A force ``f`` and a torque ``m`` at a point ``p``, in world axes, add to the right-hand sides

.. math::
    h_o \mathrel{+}= \begin{bmatrix} f \\ m + (p - x_o)\times f \end{bmatrix}
    \quad\text{or}\quad
    h_j \mathrel{+}= J_j^T \begin{bmatrix} f \\ m + p\times f \end{bmatrix}

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

import numpy as np

from multiarm.arms.terms import J_AT
from multiarm.contacts.kernel import SPIN, VELOCITY
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.callbacks import UserCallback
from multiarm.dynamics.effect_kernels import APPLIED, POWER, Arrays, EffectKernel
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import checked_vector
from multiarm.effects.building import BuildContext
from multiarm.errors import ControlError
from multiarm.jit.kernels import cfunc, kernel
from multiarm.jit.pointers import call_python
from multiarm.jit.structs import floats2, floats_at, ints1, ints2, struct_at
from multiarm.jit.vectors import (
    ZERO,
    add,
    add_cross,
    add_rotated,
    compose,
    dot,
    put,
    rotate,
    rotation,
    vec,
)
from multiarm.scene import read_wrench_table

# Time dependence.
CONSTANT, SINUSOID, PULSE, TABLE, FUNCTION = range(5)
# Columns of the table of integers: time dependence; whether on a link; in body axes; the link and
# its arm; the arm's first joint, how many carry the link; address of a function or first row of a
# table, and how many.
COURSE, ON_LINK, IN_BODY, LINK, ARM, FIRST, JOINTS, SOURCE, ROWS, INTEGERS = range(10)
# Columns of the table of numbers: the link's frame in the joint's (rotation row by row), the point
# in the joint's or object's frame, force and torque, frequency and phase or begin and end.
FRAME, POINT, SIZE, TIMES, NUMBERS = 0, 9, 12, 18, 20
# Columns of a row of a table: begin and end [s], then the cubics of the six components.
CUBICS, ROW = 2, 26


@cfunc
def add_external_wrenches(address, size, at, t):
    """Own arrays: integers, numbers, rows of tables, the wrenches now."""
    struct = struct_at(address, size)
    _, data, _ = open_system(struct)
    first, power = int(at), 0.0
    slots, integers, numbers = (
        ints1(struct, first),
        ints2(struct, first + 1),
        floats2(struct, first + 2),
    )
    rows, wrenches = floats2(struct, first + 3), floats2(struct, first + 4)
    for k in range(integers.shape[0]):
        which, own, wrench = integers[k], numbers[k], wrenches[k]
        write_wrench(which, own, rows, t, wrench)
        # the moment is that about the object's centre of mass, or about the world's origin
        R, origin = rotation(data.body, 0), ZERO
        if which[ON_LINK] != 0:
            pose = floats_at(data.link_poses[which[LINK]], 12)
            R, origin = (vec(pose, 0), vec(pose, 3), vec(pose, 6)), vec(pose, 9)  # by columns
        if which[IN_BODY] != 0:
            to_world(R, own, wrench)
        lever = add_rotated(origin, R, vec(own, POINT))
        power += apply_wrench(which, wrench, lever, data)
    data.power[slots[POWER]] = power
    return 0


@kernel
def write_wrench(which, own, rows, t, wrench):
    """Force and torque at time ``t``, in the axes in which they are given."""
    course, factor = which[COURSE], 1.0
    if course == FUNCTION:
        call_python(which[SOURCE])  # writes them
        return
    if course == TABLE:
        interpolate(rows[which[SOURCE] : which[SOURCE] + which[ROWS]], t, wrench)
        return
    if course == SINUSOID:
        factor = math.sin(2.0 * math.pi * own[TIMES] * t + own[TIMES + 1])
    elif course == PULSE:
        factor = 1.0 if own[TIMES] <= t < own[TIMES + 1] else 0.0
    for a in range(6):
        wrench[a] = factor * own[SIZE + a]


@kernel
def interpolate(rows, t, wrench):
    """The six cubics of the row in which ``t`` lies; zero before the first and after the last."""
    low, high = 0, rows.shape[0] - 1
    if not rows[low, 0] <= t < rows[high, 1]:
        wrench[:] = 0.0
        return
    while low < high:
        middle = (low + high + 1) // 2
        if rows[middle, 0] <= t:
            low = middle
        else:
            high = middle - 1
    x, cubics = t - rows[low, 0], rows[low, CUBICS:]
    for a in range(6):
        at = 4 * a
        wrench[a] = ((cubics[at] * x + cubics[at + 1]) * x + cubics[at + 2]) * x + cubics[at + 3]


@kernel
def to_world(R, own, wrench):
    """Turn force and torque from the axes of the link or object into those of the world."""
    R = compose(R, rotation(own, FRAME))
    put(wrench, 0, rotate(R, vec(wrench, 0)))
    put(wrench, 3, rotate(R, vec(wrench, 3)))


@kernel
def apply_wrench(which, wrench, lever, data):
    """Add a wrench to the right-hand sides; returns its power [W]."""
    f = vec(wrench, 0)
    m = add_cross(vec(wrench, 3), lever, f)
    if which[ON_LINK] == 0:
        h_o, body = data.h_o, data.body
        put(h_o, 0, add(vec(h_o, 0), f))
        put(h_o, 3, add(vec(h_o, 3), m))
        return dot(f, vec(body, VELOCITY)) + dot(m, vec(body, SPIN))
    joints, first, power = which[JOINTS], which[FIRST], 0.0
    J = floats_at(data.pointers[which[ARM], J_AT], 6 * joints)
    for j in range(joints):
        torque = dot(f, vec(J, 6 * j)) + dot(m, vec(J, 6 * j + 3))
        data.h[first + j] += torque
        power += torque * data.v[first + j]
    return power


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The kernel of external wrenches; their functions have been loaded."""
    count = len(spec)
    integers, numbers = np.zeros((count, INTEGERS), dtype=np.int64), np.zeros((count, NUMBERS))
    wrenches, rows, times = np.zeros((count, 6)), np.zeros((0, ROW)), [np.zeros(0)]
    functions: dict[int, Callable] = {}
    for k, wrench in enumerate(spec):
        _place(wrench, context, integers[k], numbers[k])
        numbers[k, SIZE : SIZE + 6] = [*(wrench.force or (0, 0, 0)), *(wrench.torque or (0, 0, 0))]
        if wrench.sinusoid is not None:
            integers[k, COURSE] = SINUSOID
            numbers[k, TIMES:] = wrench.sinusoid.frequency, wrench.sinusoid.phase
        elif wrench.pulse is not None:
            integers[k, COURSE] = PULSE
            numbers[k, TIMES:] = wrench.pulse.begin, wrench.pulse.end
            times.append(numbers[k, TIMES:])
        elif wrench.table is not None:
            own = _table_rows(wrench.table, numbers[k, SIZE : SIZE + 6])
            integers[k, [COURSE, SOURCE, ROWS]] = TABLE, len(rows), len(own)
            rows = np.vstack([rows, own])
            times.append(np.append(own[:, 0], own[-1, 1]))
        elif wrench.function is not None:
            integers[k, COURSE] = FUNCTION
            functions[k] = wrench.function

    def connect(data: Data, arrays: Arrays) -> dict[str, UserCallback]:
        calls = {}
        for k, function in functions.items():
            name = f"external_wrenches[{k}]"
            calls[name] = _callback(function, name, arrays[3][k], data)
            arrays[0][k, SOURCE] = calls[name].address
        return calls

    return [
        EffectKernel(
            "external_wrenches",
            add_external_wrenches,
            APPLIED,
            (integers, numbers, rows, wrenches),
            breakpoints=np.concatenate(times),
            connect=connect if functions else None,
            calls_user=bool(functions),
            local=not functions,
        )
    ]


def _place(wrench, context: BuildContext, integers: np.ndarray, numbers: np.ndarray) -> None:
    """Write the body and the point of a wrench."""
    rotation, point = np.eye(3), np.array(wrench.at)
    if wrench.target is not None:
        link = context.link(*wrench.target)
        integers[[ON_LINK, LINK, ARM, FIRST, JOINTS]] = (
            1, link.number, link.arm, link.first, link.joints,
        )  # fmt: skip
        rotation, point = link.rotation, link.rotation @ point + link.translation
    integers[IN_BODY] = wrench.axes == "body"
    numbers[FRAME : FRAME + 9] = rotation.ravel()
    numbers[POINT : POINT + 3] = point


def _table_rows(table, size: np.ndarray) -> np.ndarray:
    """Begin, end and cubics between the rows of a table, shape (rows - 1, 26)."""
    from scipy.interpolate import PchipInterpolator

    if table.file is not None:
        values = np.array(read_wrench_table(table.file)[0])
        times, values = values[:, 0], values[:, 1:]
    else:
        times, values = np.array(table.times), np.outer(table.values, size)
    cubics = PchipInterpolator(times, values).c  # (4, rows - 1, 6), highest power first
    by_row = cubics.transpose(1, 2, 0).reshape(len(times) - 1, -1)
    return np.column_stack([times[:-1], times[1:], by_row])


def _callback(function: Callable, name: str, out: np.ndarray, data: Data) -> UserCallback:
    """A function ``f(t, state)`` that writes force and torque."""
    words = f"the function of {name}"

    def read(result: object) -> np.ndarray:
        return checked_vector(f"{words}, force and torque", result, 6, ControlError)

    layout = data.model.layout
    return UserCallback(function, words, read, out, layout, data.arrays, owner=function)
