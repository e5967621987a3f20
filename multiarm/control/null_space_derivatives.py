r"""Derivatives of the accelerations that hold poses (:mod:`multiarm.control.null_space`).

Seen from the object, and in its axes (:mod:`multiarm.dynamics.contact_derivatives`), a link that
holds it has the pose, the velocity :math:`(V, \Omega)` and, with the joint accelerations p that
hold the robot, the acceleration :math:`(A, \Omega')`.  Its joint frame, m from the link's origin,
obeys

.. math::
    e = \begin{bmatrix} A + \Omega'\times m + \Omega\times(\Omega\times m)
    + \delta\,(V + \Omega\times m) + k x \\ \Omega' + \delta\,\Omega + k\,\theta
    \end{bmatrix} = 0 ,

without feedforward with A and :math:`\Omega'` of a robot at rest at an object at rest.  Of such
accelerations p, at all links that hold the object, are the nearest to
:math:`p_0 = -\delta\dot q`, so that with :math:`J = \partial e / \partial p`, and the multipliers
:math:`\kappa` in axes of the object,

.. math::
    \begin{bmatrix} M & -J^T \\ J & 0 \end{bmatrix} \begin{bmatrix} dp \\ d\kappa \end{bmatrix}
    = \begin{bmatrix} M\,dp_0 - \partial\big(M (p - p_0) - J^T\kappa\big) \\
    -\partial e \end{bmatrix} .

:math:`M (p - p_0) - J^T\kappa` are the torques of a robot at rest but for these accelerations, with
the wrenches :math:`\kappa` on its links at the joint frames.
"""

from __future__ import annotations

import numpy as np

from multiarm.contacts.joint import open_frames
from multiarm.contacts.motion import motion_relative_to, open_body
from multiarm.control.null_space import count_held, holds_pose
from multiarm.dynamics.contact_derivatives import (
    FIRST_OBJECT,
    OF_SEEN,
    SEEN,
    write_column_displacement,
    write_seen_motion,
)
from multiarm.dynamics.coordinates import block_columns
from multiarm.dynamics.equation_derivatives import (
    AT_REST,
    joint_that_moves,
    open_equations,
    open_links,
    write_connected_body,
    write_object,
)
from multiarm.dynamics.solver.factors import factor_lu, solve_rows
from multiarm.dynamics.status import OK, SINGULAR
from multiarm.jit.kernels import allocating, inlined, kernel
from multiarm.jit.vectors import (
    add,
    add_cross,
    add_scaled,
    compose,
    cross,
    put,
    rotate,
    rotate_back,
    rotation_vector,
    scale,
    sub,
    vec,
)
from multiarm.robots.derivatives import (
    open_displacement,
    subtract_load,
    subtract_torques,
    write_inverse_dynamics,
    write_motions,
)
from multiarm.spatial import write_chart_rate


@allocating
def differentiate_holds(i, law, command, feedforward, model, data, work, derivatives):
    """Write the derivatives of the accelerations that hold the poses of block i.

    Into ``derivatives.preferred``; ``derivatives`` as in
    :mod:`multiarm.control.command_derivatives`.  Returns a status.
    """
    d0, n = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
    size = n + 6 * count_held(i, model, data)
    arm = open_equations(derivatives.excess)
    of_block = block_columns(arm.dF_o.shape[0], n, 0)
    M, preferred = open_equations(derivatives.motion).M[i], command.preferred
    K, X = np.zeros((size, size)), np.zeros((size, of_block.end))
    pivots = np.zeros(size, dtype=np.int64)
    for j in range(n):
        damped = -law.free_rate * data.state.joint_rates[d0 + j]
        arm.v[d0 + j], arm.a_j[d0 + j] = 0.0, preferred[d0 + j] - damped
        for k in range(n):
            K[j, k] = M[j, k]
            X[j, of_block.rates + k] = -law.free_rate * M[j, k]
    for o in range(arm.objects.shape[0]):
        write_object(o, data, AT_REST, AT_REST, arm)
    subtract_torque_slopes(i, of_block, command, model, data, derivatives, X)
    for j in range(n):
        arm.a_j[d0 + j] = preferred[d0 + j]
    if not feedforward:
        subtract_slopes(i, of_block, 1.0, 0.0, 0.0, model, data, derivatives, X)
    for j in range(n):
        arm.v[d0 + j] = data.state.joint_rates[d0 + j]
    for o in range(arm.objects.shape[0]):
        write_object(o, data, data.state.twists[o], command.acceleration[6 * o :], arm)
    of_acceleration = 1.0 if feedforward else 0.0
    subtract_slopes(
        i, of_block, of_acceleration, law.free_rate, law.free_stiffness, model, data, derivatives, X
    )
    write_jacobians(i, n, model, data, derivatives, K)
    if not factor_lu(K, size, pivots) > 0.0:
        return SINGULAR
    solve_rows(K, size, pivots, X)
    for j in range(n):
        for c in range(of_block.end):
            derivatives.preferred[j, c] = X[j, c]
    return OK


@kernel
def write_links(i, data, derivatives):
    """Write the motion of a robot's links with the rates and accelerations in the work."""
    links, arm = open_links(derivatives.excess), open_equations(derivatives.excess)
    state = data.state
    write_motions(links, i, state.base_poses, state.joint_positions, arm.v, arm.a_j, arm.links)


@inlined
def held_bodies(c, model):
    """The joint that moves the link of connection ``c``, and the object that it holds."""
    pairs = model.connections
    return joint_that_moves(pairs.first[c], model), joint_that_moves(pairs.second[c], model)


@kernel
def write_held(i, link, second, derivatives):
    """Write the motion of a link that holds an object, and how the object sees it.

    ``link`` is the joint that moves it, ``second`` the object, see ``FIRST_OBJECT``; after
    :func:`write_links`.
    """
    links, arm = open_links(derivatives.excess), open_equations(derivatives.excess)
    write_connected_body(i, link, links, arm, arm.first_body, arm.first_moved)
    write_connected_body(i, second, links, arm, arm.second_body, arm.second_moved)
    seen = motion_relative_to(open_body(arm.first_body), open_body(arm.second_body))
    write_seen_motion(arm.first_body, arm.second_body, seen, arm.scratch[SEEN])


@kernel
def subtract_torque_slopes(i, of_block, command, model, data, derivatives, X):
    """Subtract the derivatives of ``M (p - p_0) - J^T kappa`` from the rows of the joints."""
    links, arm = open_links(derivatives.excess), open_equations(derivatives.excess)
    n = of_block.rates - of_block.positions
    write_links(i, data, derivatives)
    for c in range(model.connections.block.size):
        if holds_pose(c, i, model, data):
            bodies = held_bodies(c, model)
            write_held(i, bodies[0], bodies[1], derivatives)
            frame, multipliers = model.joint_frames[c], command.held[c]
            subtract_wrench_slopes(i, bodies, of_block, frame, multipliers, derivatives, X)
    write_inverse_dynamics(links, i, arm.links, arm.by_q, arm.by_v)
    for j in range(n):
        for k in range(n):
            X[j, of_block.positions + k] -= arm.by_q[j, k]


@kernel
def subtract_wrench_slopes(i, bodies, of_block, frame, multipliers, derivatives, X):
    """Subtract the derivatives of ``-J^T kappa`` of a link whose wrench stays in the object's axes.

    Its change with the link, on which it is a load, is that of the inverse dynamics;
    ``multipliers`` (6,) in world axes.
    """
    links, arm = open_links(derivatives.excess), open_equations(derivatives.excess)
    link = bodies[0]
    relative = motion_relative_to(open_body(arm.first_body), open_body(arm.second_body))
    R_o, R = open_body(arm.second_body).rotation, open_body(arm.scratch[SEEN]).rotation
    force, moment = rotate_back(R_o, vec(multipliers, 0)), rotate_back(R_o, vec(multipliers, 3))
    put_wrench(frame, rotate_back(R, force), rotate_back(R, moment), arm.on_first[of_block.end])
    subtract_load(link, arm.on_first[of_block.end], arm.links)
    for c in range(of_block.rates):
        write_column_displacement(bodies, of_block.end, of_block, c, relative, arm)
        turn = open_displacement(arm.scratch[OF_SEEN]).turn
        opposite = rotate_back(R, cross(turn, force)), rotate_back(R, cross(turn, moment))
        put_wrench(frame, opposite[0], opposite[1], arm.on_first[c])
        subtract_torques(links, i, link, arm.on_first[c], arm.links, X, c)


@kernel
def put_wrench(frame, force, moment, out):
    """Write a wrench at the joint frame as one about the link's origin, both in the link's axes."""
    put(out, 0, force)
    put(out, 3, add_cross(moment, open_frames(frame).origin_on_link, force))


@kernel
def subtract_slopes(i, of_block, of_acceleration, rate, stiffness, model, data, derivatives, X):
    """Subtract the derivatives of e of all held connections from their rows, after the joints'.

    Accelerations are multiplied by ``of_acceleration``.
    """
    at = of_block.rates - of_block.positions
    write_links(i, data, derivatives)
    for c in range(model.connections.block.size):
        if holds_pose(c, i, model, data):
            bodies = held_bodies(c, model)
            write_held(i, bodies[0], bodies[1], derivatives)
            subtract_slopes_of(
                bodies, of_block, model.joint_frames[c], of_acceleration, rate, stiffness,
                derivatives, X[at : at + 6],
            )  # fmt: skip
            at += 6


@allocating
def subtract_slopes_of(bodies, of_block, frame, of_acceleration, rate, stiffness, derivatives, X):
    """Subtract the derivatives of e of one connection from its rows ``X`` (6, C)."""
    arm, frames, turn_rate = (
        open_equations(derivatives.excess), open_frames(frame), np.empty(3)
    )  # fmt: skip
    commanded = derivatives.acceleration
    seen, displacement = open_body(arm.scratch[SEEN]), open_displacement(arm.scratch[OF_SEEN])
    R_o, R, w, w_rate = (
        open_body(arm.second_body).rotation,
        seen.rotation,
        seen.spin,
        seen.spin_rate,
    )
    m, on_arm, G = rotate(R, frames.origin_on_link), compose(R, frames.on_link), frames.on_object
    turned = rotate_back(G, on_arm[0]), rotate_back(G, on_arm[1]), rotate_back(G, on_arm[2])
    theta = rotate(G, rotation_vector(turned))
    relative = motion_relative_to(open_body(arm.first_body), open_body(arm.second_body))
    first = 6 * (FIRST_OBJECT - bodies[1])
    for c in range(of_block.end):
        write_column_displacement(bodies, of_block.end, of_block, c, relative, arm)
        dw, dm = displacement.spin, cross(displacement.turn, m)
        velocity = add_cross(add_cross(displacement.velocity, dw, m), w, dm)
        write_chart_rate(theta, displacement.turn, turn_rate)
        slide = add_scaled(scale(rate, velocity), stiffness, add(displacement.shift, dm))
        turn = add_scaled(scale(rate, dw), stiffness, vec(turn_rate, 0))
        a, alpha = displacement.acceleration, displacement.spin_rate
        if c < of_block.positions:  # the acceleration that is commanded to the object changes too
            a_o = (commanded[first, c], commanded[first + 1, c], commanded[first + 2, c])
            turn_o = commanded[first + 3, c], commanded[first + 4, c], commanded[first + 5, c]
            alpha_o = rotate_back(R_o, turn_o)
            a = sub(a, add_cross(rotate_back(R_o, a_o), alpha_o, seen.origin))
            alpha = sub(alpha, alpha_o)
        a = add_cross(add_cross(a, alpha, m), w_rate, dm)
        a = add_cross(add_cross(a, dw, cross(w, m)), w, add_cross(cross(dw, m), w, dm))
        slide = add_scaled(slide, of_acceleration, a)
        turn = add_scaled(turn, of_acceleration, alpha)
        for k in range(3):
            X[k, c] -= slide[k]
            X[3 + k, c] -= turn[k]


@kernel
def write_jacobians(i, n, model, data, derivatives, K):
    """Write J of all held connections, and ``-J^T`` beside the inertia."""
    arm, at = open_equations(derivatives.excess), n
    write_links(i, data, derivatives)
    for c in range(model.connections.block.size):
        if not holds_pose(c, i, model, data):
            continue
        bodies = held_bodies(c, model)
        write_held(i, bodies[0], bodies[1], derivatives)
        R_o, R = open_body(arm.second_body).rotation, open_body(arm.scratch[SEEN]).rotation
        m = rotate(R, open_frames(model.joint_frames[c]).origin_on_link)
        for j in range(n):
            displacement = open_displacement(arm.first_moved[n + j])
            turn = rotate_back(R_o, displacement.spin)
            slide = add_cross(rotate_back(R_o, displacement.velocity), turn, m)
            for k in range(3):
                K[at + k, j], K[at + 3 + k, j] = slide[k], turn[k]
                K[j, at + k], K[j, at + 3 + k] = -slide[k], -turn[k]
        at += 6
