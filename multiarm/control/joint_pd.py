r"""Joint PD: :math:`\tau = K_p (q_r(t) - q) + K_d (\dot q_r(t) - \dot q)`, springs and dampers.

The reference is a point or a path.  On a segment :math:`t_s \le t < t_{s+1}` of a path every joint
is a Chebyshev series

.. math:: q_r(t) = \sum_k a_{sk} T_k(x), \qquad x = 2\,\frac{t - t_s}{t_{s+1} - t_s} - 1,

which Clenshaw's recurrence sums together with its derivative.  Before and after the path the
reference rests.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.control.gravity_compensation import carrying_grip, reach_with
from multiarm.control.program import ControlContext, ControlProgram, JointPath
from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.control_laws import ControlLaw, view_of_law
from multiarm.dynamics.coordinates import force_columns
from multiarm.dynamics.piecewise import segment_at
from multiarm.jit.kernels import cfunc, inlined, kernel
from multiarm.jit.structs import Floats1, Floats3, struct_at
from multiarm.scene.control import JointPDControl


class JointPD(NamedTuple):
    """Springs and dampers in the joints, and the path of their reference."""

    stiffness: Floats1  # (n,) [N m/rad, N/m]
    damping: Floats1  # (n,) [N m s/rad, N s/m]
    bounds: Floats1  # (S + 1,) [s], where the segments meet
    coefficients: Floats3  # (S, n, width) of the Chebyshev series [rad, m]


open_joint_pd = view_of_law(JointPD)


@cfunc
def joint_pd(address, size, at, t):
    """Add the torques."""
    struct = struct_at(address, size)
    data, law = open_data(struct), open_joint_pd(struct, at)
    for j in range(data.control.torque.size):
        reference, rate = path_point(t, law.bounds, law.coefficients, j)
        add_spring(law, j, reference, rate, data)
    return 0


@cfunc
def differentiate_joint_pd(address, size, at, _t):
    """Add the derivatives of the torques."""
    struct = struct_at(address, size)
    differentiate_springs(open_joint_pd(struct, at), open_data(struct))
    return 0


@inlined
def add_spring(gains, j, reference, rate, data):
    """Add the torque of the spring and the damper in joint ``j``."""
    data.control.torque[j] += gains.stiffness[j] * (reference - data.state.joint_positions[j])
    data.control.torque[j] += gains.damping[j] * (rate - data.state.joint_rates[j])


@inlined
def differentiate_springs(gains, data):
    """Add the derivatives of the torques of springs and dampers in all joints."""
    columns = force_columns(data)
    for j in range(data.control.torque.size):
        data.slopes.torque[j, columns.positions + j] -= gains.stiffness[j]
        data.slopes.torque[j, columns.rates + j] -= gains.damping[j]


@kernel
def path_point(t, bounds, coefficients, joint):
    """Reference of one joint and its rate at time ``t``."""
    s, width = segment_at(bounds, t), coefficients.shape[2]
    begin, end = bounds[s], bounds[s + 1]
    moving = begin <= t <= end
    x = 2.0 * (min(max(t, begin), end) - begin) / (end - begin) - 1.0
    # Clenshaw for the value (b) and for its derivative with respect to x (d)
    b1 = b2 = d1 = d2 = 0.0
    for k in range(width - 1, 0, -1):
        d0 = 2.0 * b1 + 2.0 * x * d1 - d2
        b0 = coefficients[s, joint, k] + 2.0 * x * b1 - b2
        b2, b1, d2, d1 = b1, b0, d1, d0
    value = coefficients[s, joint, 0] + x * b1 - b2
    slope = b1 + x * d1 - d2
    return value, slope * 2.0 / (end - begin) if moving else 0.0


def joint_pd_program(control: JointPDControl, context: ControlContext) -> ControlProgram:
    """The law of springs and dampers, and the one that carries the weight, where there is one."""
    path = JointPath(np.array([0.0, 1.0]), context.start_angles[None, :, None])
    paths = control.paths(context.start.layout.objects)
    if paths:
        path = context.joint_path(paths)
    stiffness, damping = context.stacked(control.stiffness), context.stacked(control.damping)
    numbers = JointPD(stiffness, damping, path.bounds, np.ascontiguousarray(path.coefficients))
    carrying, counts_friction = carrying_grip(control, context)
    return ControlProgram(
        (ControlLaw(joint_pd, numbers, differentiate_joint_pd), *carrying),
        breakpoints=path.bounds if paths else np.zeros(0),
        reach=reach_with(carrying),
        counts_friction=counts_friction,
    )
