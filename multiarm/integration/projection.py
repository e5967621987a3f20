r"""Constraint stabilization: feedback on the gaps, and projection.

*Feedback* adds :math:`-2\alpha\dot\varphi - \beta^2\varphi` to the constraint accelerations
(thesis, 4.3; J. Baumgarte, Comput. Methods Appl. Mech. Eng. 1, 1972).  The gains depend on the
step: with :math:`\alpha = \beta` the linear stability limit of :math:`\alpha h` is 0.83 for
semi-implicit Euler, 2 for explicit Euler and 2.79 for RK4; ``FEEDBACK_RATIO`` is well below.

*Projection* moves the state onto the constraints after a step, in the metric of the inertia:

.. math::
    \min_\delta \tfrac12 \delta^T M \delta \ \text{ with }\ W^T\delta = -\varphi
    \qquad\text{and}\qquad
    \min_{\delta v} \tfrac12 \delta v^T M\, \delta v \ \text{ with }\ W^T (v + \delta v) = 0 .

Wheels hold velocities and not positions: they take no part in the first one.
Both are the node system with other right-hand sides (``f = 0``, ``c = -\varphi`` or
``-\dot\varphi``), so that each costs as much as an evaluation and stays linear in the blocks.  Of
deficient blocks the factors for the velocities serve the evaluation that follows, too.
Where the constraints lose rank, small gaps that no motion closes to first order (a flat
parallelogram, redundant contacts) are left.  Constraints that depend on each other on the joints
only (a loop of Bricard's) are independent off them, by as little as the gaps are large: the rank
for the positions is decided with the largest gap as a bound, not to move along the motion itself.
"""

from __future__ import annotations

import math

from multiarm.contacts.kernel import greatest_gaps, open_contact
from multiarm.dynamics.arrays import open_data, open_system
from multiarm.dynamics.coordinates import retract_into, retract_joints
from multiarm.dynamics.equations import keeps_factors, solve_frictionless, update_kinematics
from multiarm.dynamics.kinematics import release_wheels
from multiarm.dynamics.solver.bounds import NEAR_LOSS
from multiarm.dynamics.status import OK, PROJECTION_FAILED
from multiarm.jit.kernels import (
    INT,
    INTS,
    NUMBER,
    TRUTH,
    cfunc,
    clear,
    greatest,
    inlined,
    kernel,
    larger,
)
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import struct_at

# Gains that are not given: alpha = beta = FEEDBACK_RATIO / step
FEEDBACK_RATIO = 0.1


@inlined
def project(struct, tolerance):
    """Project the state in ``data`` of the system with this struct; returns a status.

    The kinematics left in ``data`` are those from before the velocities' correction.
    """
    return call_cfunc(open_data(struct).functions.project_state, struct, tolerance, 0.0)


@inlined
def cost_of_projection(data):
    """Evaluations as which a projection counts, with the evaluation that follows it.

    One for the positions and one for the velocities, unless that evaluation keeps its factors.
    """
    return 1 if keeps_factors(data) else 2


@cfunc
def project_state(address, size, tolerance, _b):
    """:func:`project`, once for all the kernels that call it."""
    struct = struct_at(address, size)
    status = project_positions(struct, tolerance, False, 0.5, 12)
    if status != OK:
        return status
    return project_velocities(struct)


@kernel
def project_positions(
    struct: INTS, tolerance: NUMBER, hold_object: TRUTH, longest: NUMBER, iterations: INT
):
    """Newton's method for ``phi = 0`` in the inertia metric; moves the configuration.

    Parameters
    ----------
    tolerance : float
        Largest gap that is accepted [m].
    hold_object : bool
        Move the robots only.
    longest : float
        Longest change of one joint in one iteration [rad, m]; longer steps are shortened.
    iterations : int
        Largest number of iterations.

    Returns
    -------
    int
        ``OK`` with the kinematics of the projected state in ``data``; ``PROJECTION_FAILED``; or
        what :func:`multiarm.dynamics.equations.solve_frictionless` returned.  The largest change of
        a coordinate is in ``data.status.position_change``.
    """
    model, data, work = open_system(struct)
    data.status.position_change = 0.0
    # near a loss of rank, gaps have large effects: more iterations reduce them to roundings
    before, further, released = math.inf, 3, 0
    for _ in range(iterations):
        status = update_kinematics(struct)
        if status != OK:
            return status
        worst, _ = greatest_gaps(data.rows.kinematics)
        if worst <= tolerance:
            if further == 0 or worst > 0.5 * before or not near_loss(data.solution):
                return OK
            further -= 1
        if not math.isfinite(worst):
            return PROJECTION_FAILED
        slow = worst > 0.5 * before and worst <= 1e4 * tolerance
        if slow and data.solution.dependent > released:
            return OK  # small gaps that no motion closes to first order
        before = worst
        released = release_wheels(model, work)
        clear(data.forces.f)
        for k in range(data.rows.c.size):
            data.rows.c[k] = -open_contact(data.rows.kinematics[k]).gap
        status = solve_frictionless(struct, worst)
        if status != OK:
            return status
        reach = greatest(data.accelerations.a_j)
        scale = 1.0 if reach <= longest else longest / reach
        if not hold_object:
            reach = larger(reach, greatest(data.accelerations.a_o))
        data.status.position_change += scale * reach
        q, frames = data.state.configuration, data.state.poses.shape[0]
        bases = data.state.floating_bases
        if hold_object:
            retract_joints(frames, bases, q, scale, data.accelerations.a, q)
        else:
            retract_into(frames, bases, q, scale, data.accelerations.a, q)
    return PROJECTION_FAILED


@inlined
def near_loss(solution):
    """Whether the constraints of a solution are near a loss of rank."""
    return solution.margin < NEAR_LOSS


@kernel
def project_velocities(struct):
    """Project ``velocity`` on ``W^T v = 0``; needs the state's kinematics in ``data``.

    The largest change of a velocity is in ``data.status.velocity_change``.
    """
    _, data, _ = open_system(struct)
    clear(data.forces.f)
    for k in range(data.rows.c.size):
        data.rows.c[k] = -open_contact(data.rows.kinematics[k]).gap_rate
    status = solve_frictionless(struct, 0.0)
    if status != OK:
        return status
    data.status.velocity_change = greatest(data.accelerations.a)
    for k in range(data.state.velocity.size):
        data.state.velocity[k] += data.accelerations.a[k]
    return OK
