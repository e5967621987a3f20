r"""Derivatives of the equations of motion with respect to the state, in compiled code.

For every block, and for the surroundings as a block without joints, with :math:`F_i, F_{\varphi i},
F_o` of :mod:`multiarm.dynamics.derivatives`,

.. math::
    K_i = \begin{bmatrix} M_i & -W_i \\ W_i^T & 0 \end{bmatrix}, \qquad
    \partial \begin{bmatrix} F_i \\ F_{\varphi i} \end{bmatrix}, \qquad \partial F_o .

Each block has columns of its own, so that the cost is linear in the blocks.  Every connection of a
block adds the derivatives of its rows to :math:`F_{\varphi i}`, and those of the wrenches on its
two bodies, links of the block or objects, to :math:`F_i` and :math:`F_o`.

*Feedback on the drift* adds :math:`2\alpha\dot\varphi + \beta^2\varphi` to :math:`F_\varphi`: the
derivatives of the gaps' rates by the state, and of the gaps by the pose and the joints, which are
those of their rates by the velocities, :math:`W_o^T, W^T`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import CONTACT_WIDTH
from multiarm.contacts.motion import BODY_WIDTH, BodyMotion, open_body
from multiarm.contacts.table import JOINT, WHEELS, open_code, open_joint, rolls
from multiarm.dynamics.arrays import open_data, open_system
from multiarm.dynamics.contact_derivatives import (
    BASE,
    FIRST_OBJECT,
    SCRATCH_ROWS,
    SLOPES_WIDTH,
    STILL,
    VALUE,
    differentiate_connection,
)
from multiarm.dynamics.coordinates import (
    block_columns,
    chart_places,
    column_of_state,
    equation_columns,
)
from multiarm.dynamics.data import Data
from multiarm.dynamics.layout import TWIST, Layout
from multiarm.dynamics.solver.factored_trees import complete_inertias
from multiarm.dynamics.solver.factors import decompose, factor_lu, solve_rows
from multiarm.dynamics.status import CALLBACK_FAILED, OK, SINGULAR
from multiarm.jit.kernels import (
    INTS,
    NUMBER,
    TABLE,
    allocating,
    clear,
    copy,
    inlined,
    kernel,
)
from multiarm.jit.rows import fields_of
from multiarm.jit.structs import Floats1, Floats2, Floats3, Int, Ints1, struct_of, view
from multiarm.jit.vectors import AXES, ZERO, add_cross, cross, rotate, sub, times, vec
from multiarm.robots.chain import ChainJoint
from multiarm.robots.derivatives import (
    DISPLACEMENT_WIDTH,
    LINK_WIDTH,
    TreeLinks,
    subtract_load,
    subtract_torques,
    tree_links,
    write_inverse_dynamics,
    write_link,
    write_motions,
)
from multiarm.robots.robot import Robot
from multiarm.robots.terms import TreeStructure


class EquationWork(NamedTuple):
    """Results and scratch for ``n`` blocks; ``d`` joints and ``m`` contacts of the largest.

    A block's own columns are C coordinates, see
    :class:`multiarm.dynamics.coordinates.BlockColumns`, the torques of its joints and the
    objects' accelerations.
    """

    placements: Int  # first of their columns among all, six for each owner of rows; -1 without
    first_owner: Ints1  # (n + 1,) of the rows of each block, see multiarm.dynamics.connections
    # velocities and accelerations of the joints (joints,), contact forces (N,)
    v: Floats1
    a_j: Floats1
    force: Floats1
    K: Floats3  # (n, d + m, d + m)
    M: Floats3  # (n, d, d)
    dF: Floats3  # (n, d + m, C + d + 6 F) derivatives of F_i and F_phi
    dF_o: Floats2  # (6 F, columns) of F_o
    Wr_o: Floats2  # (N, 6 F) the objects' rows of the contact forces, those of W_o without friction
    rates: Floats2  # (N, C) of the gaps' rates
    objects: Floats2  # (F, 24) their motions
    at_rest: Floats1  # (6 F,) zeros, the twists of objects that do not move
    # scratch of one connection: motions of its bodies, their displacements by the joints; (C + 1,
    # 6) derivatives, and in the last used row the values, of the rows' wrenches on them, about
    # their origins in their axes
    first_body: Floats1
    second_body: Floats1
    first_moved: Floats2
    second_moved: Floats2
    on_first: Floats2
    on_second: Floats2
    # scratch of one block
    links: Floats2
    scratch: Floats2
    rows: Floats2
    parts: Floats2
    slopes: Floats2
    wrench: Floats2
    by_q: Floats2
    by_v: Floats2
    S: Floats2
    pivots: Ints1


# A twist and an acceleration.
AT_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

open_links = view(TreeLinks)
open_equations = view(EquationWork, len(TreeLinks._fields))


def _make_work(data: Data, columns: int, placements: int) -> EquationWork:
    layout, parts = data.model.layout, data.arrays.rows.parts
    n, N, node = layout.block_count, layout.contacts, layout.node
    d, m = max(layout.joint_counts), max(layout.contact_counts)
    first_owner = np.searchsorted(layout.block_of, range(n + 1))
    C = block_columns(node, d, int(np.max(np.diff(first_owner))) if placements >= 0 else 0).end
    work = EquationWork(
        placements=placements,
        first_owner=first_owner.astype(np.int64),
        v=np.zeros(layout.rate_count),
        a_j=np.zeros(layout.rate_count),
        force=np.zeros(N),
        K=np.zeros((n, d + m, d + m)),
        M=np.zeros((n, d, d)),
        dF=np.zeros((n, d + m, C + d + node)),
        dF_o=np.zeros((node, columns)),
        Wr_o=np.zeros((N, node)),
        rates=np.zeros((N, C)),
        objects=np.zeros((layout.frames, BODY_WIDTH)),
        at_rest=np.zeros(node),
        first_body=np.zeros(BODY_WIDTH),
        second_body=np.zeros(BODY_WIDTH),
        first_moved=np.zeros((2 * d, DISPLACEMENT_WIDTH)),
        second_moved=np.zeros((2 * d, DISPLACEMENT_WIDTH)),
        on_first=np.zeros((C + 1, TWIST)),
        on_second=np.zeros((C + 1, TWIST)),
        links=np.zeros((d, LINK_WIDTH)),
        scratch=np.zeros((SCRATCH_ROWS, BODY_WIDTH)),
        rows=np.zeros((N, CONTACT_WIDTH)),
        parts=np.zeros_like(parts),
        slopes=np.zeros((N, SLOPES_WIDTH)),
        wrench=np.zeros((VALUE + 1, TWIST)),
        by_q=np.zeros((d, d)),
        by_v=np.zeros((d, d)),
        S=np.zeros((node, node)),
        pivots=np.zeros(max(node, d + m), dtype=np.int64),
    )
    fields_of(BodyMotion, work.scratch[STILL]).rotation[:] = np.eye(3)
    return work


def structures_of_blocks(arms: Iterable[Robot], layout: Layout) -> list[list[TreeStructure]]:
    """Structures of the joints of each block of the robots, a tree of each robot."""
    robots = [arm.structure() for arm in arms]
    blocks = layout.parts_of_blocks[: layout.blocks_of_robots.stop]
    return [
        [robots[robot].part(first, joints) for robot, first, joints in block] for block in blocks
    ]


def equation_work(
    data: Data, columns: int, placements: int = -1, *, masses: bool = True, weights: bool = True
) -> tuple[EquationWork, np.ndarray]:
    """The arrays for derivatives with a number of columns, and their struct for the kernels.

    The data keep them.  ``placements`` is the first of their columns, -1 without.  Without
    ``masses``, those for :func:`write_load_derivatives`; without ``weights``, gravity is left out.
    """
    key = ("equation work", columns, placements, masses, weights)
    if key not in data.cache:
        structures = structures_of_blocks(data.model.robots.values(), data.model.layout)
        links = tree_links(structures, data.model.constants.gravity)
        if not (masses and weights):
            links = links._replace(gravity=np.zeros(3))
        if not masses:
            joints = fields_of(ChainJoint, links.joints)
            joints.mass[:], joints.inertia[:] = 0.0, 0.0
        work = _make_work(data, columns, placements)
        data.cache[key] = links, work, struct_of(links, work)
    _, work, struct = data.cache[key]
    return work, struct


@kernel
def write_derivatives(struct: INTS, equations: INTS):
    """Write the derivatives of all equations at the solution in the data; returns a status.

    Without friction (:mod:`multiarm.dynamics.sliding_derivatives`).  ``equations`` is the struct of
    :func:`equation_work`.
    """
    data, work = open_data(struct), open_equations(equations)
    copy(data.state.joint_rates, work.v)
    copy(data.accelerations.a_j, work.a_j)
    copy(data.rows.force, work.force)
    for k in range(data.rows.W_o.shape[0]):
        copy(data.rows.W_o[k], work.Wr_o[k])
    for o in range(work.objects.shape[0]):
        write_object(o, data, data.state.twists[o], data.accelerations.a_o[6 * o :], work)
    status = differentiate_bodies(struct, equations)
    for o in range(work.objects.shape[0]):
        add_object_equation(
            o, data.bodies.object_inertia, data.state.twists[o], data.accelerations.a_o[6 * o :],
            work,
        )  # fmt: skip
    return status


@kernel
def write_derivatives_at_rest(struct, equations, twist):
    """Write derivatives of what holds the blocks at rest under ``work.force``; returns a status.

    At rest but for the accelerations ``work.a_j``.  They are the rows of joints in ``dF``; ``dF_o``
    has those of the opposite wrenches on the objects, and ``rates`` those of the gap rates while
    the objects move with twists (6 F,).
    """
    data, work = open_data(struct), open_equations(equations)
    clear(work.v)
    for o in range(work.objects.shape[0]):
        write_object(o, data, twist[6 * o :], AT_REST, work)
    return differentiate_bodies(struct, equations)


@kernel
def write_load_derivatives(struct, equations):
    """Write the derivatives of what contacts do to the bodies, with ``data.rows.static_force``.

    ``equations`` has massless links.  The rows of joints in ``dF``, and ``dF_o``, are those of
    ``-W force`` and ``-W_o force``; ``rates`` those of the gap rates.  Returns a status.
    """
    data, work = open_data(struct), open_equations(equations)
    copy(data.state.joint_rates, work.v)
    clear(work.a_j)
    copy(data.rows.static_force, work.force)
    for o in range(work.objects.shape[0]):
        write_object(o, data, data.state.twists[o], AT_REST, work)
    return differentiate_bodies(struct, equations)


@kernel
def differentiate_bodies(struct, equations):
    """Write the derivatives of all blocks and their wrenches on the objects; returns a status.

    At the motion and the contact forces in ``work.objects, v, a_j, force``.
    """
    model, data, system = open_system(struct)
    links, work = open_links(equations), open_equations(equations)
    complete_inertias(system)
    for l in range(work.dF_o.shape[0]):
        clear(work.dF_o[l])
    for i in range(system.first_joint.size - 1):
        differentiate_block(i, model, data, system, links, work)
    return CALLBACK_FAILED if data.status.failed else OK


@inlined
def write_object(o, data, twist, acceleration, work):
    """Write an object's pose in the data, and a twist and an acceleration, six numbers each."""
    body = open_body(work.objects[o])
    body.rotation = open_body(data.bodies.objects[o]).rotation
    body.origin = vec(data.state.poses[o], 0)
    body.velocity, body.spin = vec(twist, 0), vec(twist, 3)
    body.acceleration, body.spin_rate = vec(acceleration, 0), vec(acceleration, 3)


@inlined
def add_object_equation(o, inertia, twist, acceleration, work):
    """Add the derivatives of ``M_o a_o - f_o`` without control and effects to those of ``F_o``.

    Of one object; its inertia turns with it, and ``f_o`` is its weight and the gyroscopic moment.
    """
    w, alpha = vec(twist, 3), vec(acceleration, 3)
    x = 6 * o + 3  # rows of its moment, and columns of its turn
    y, z, spins = x + 1, x + 2, work.dF_o.shape[0] + x
    I = (
        inertia[x, x], inertia[x, y], inertia[x, z], inertia[y, y], inertia[y, z], inertia[z, z],
    )  # fmt: skip
    spin, torque = times(I, w), times(I, alpha)
    for axis in range(3):
        e = AXES[axis]
        gyroscopic = sub(times(I, cross(w, e)), cross(spin, e))
        by_turn = add_cross(sub(times(I, cross(alpha, e)), cross(torque, e)), w, gyroscopic)
        by_spin = add_cross(cross(w, times(I, e)), e, spin)
        for k in range(3):
            work.dF_o[x + k, x + axis] += by_turn[k]
            work.dF_o[x + k, spins + axis] += by_spin[k]


@kernel
def differentiate_block(i, model, data, system, links, work):
    """Write ``K_i`` and the derivatives of one block's equations, and add those of its wrenches."""
    n = system.first_joint[i + 1] - system.first_joint[i]
    first, last = system.first_contact[i], system.first_contact[i + 1]
    has_joints, dF = i < links.first.size - 1, work.dF[i]
    columns = columns_of_block(i, n, links, work)
    C = columns.end
    for k in range(n + last - first):
        clear(dF[k])
    if has_joints:
        state = data.state
        write_motions(
            links, i, state.base_poses, state.joint_positions, work.v, work.a_j, work.links
        )
    for c in range(work.first_owner[i], work.first_owner[i + 1]):
        add_connection(i, c, columns, model, data, system, links, work)
    for k in range(model.joint_rows.row.size):
        if model.joint_rows.block[k] == i and model.joint_rows.kind[k] == WHEELS:
            add_wheels(k, n, columns, model, data, system, work)
    if has_joints:
        write_inverse_dynamics(links, i, work.links, work.by_q, work.by_v)
    for j in range(n):
        for k in range(n):
            dF[j, columns.positions + k] += work.by_q[j, k]
            dF[j, columns.rates + k] += work.by_v[j, k]
        dF[j, C + j] = -1.0
    for k in range(first, last):
        for l in range(work.dF_o.shape[0]):
            dF[n + k - first, C + n + l] = data.rows.W_o[k, l]
    write_matrix_of_block(i, first, last - first, n, data, system, work)


@inlined
def add_connection(i, owner, columns, model, data, system, links, work):
    """Write the derivatives of the rows of an owner, and add those of their wrenches.

    After :func:`write_motions` of the block, before :func:`write_inverse_dynamics`.
    """
    n, pairs, first = (
        system.first_joint[i + 1] - system.first_joint[i],
        model.connections,
        data.rows.first,
    )
    rows = first[owner], first[owner + 1]
    bodies = (
        joint_that_moves(pairs.first[owner], model), joint_that_moves(pairs.second[owner], model)
    )  # fmt: skip
    write_connected_body(i, bodies[0], links, work, work.first_body, work.first_moved)
    write_connected_body(i, bodies[1], links, work, work.second_body, work.second_moved)
    gaps = work.dF[i, n + rows[0] - system.first_contact[i] :]
    placement = columns.placement + TWIST * (owner - work.first_owner[i])
    differentiate_connection(model, data, rows, bodies, placement, columns, gaps, work)
    add_wrench(i, bodies[0], columns, work.on_first, data, system, links, work)
    add_wrench(i, bodies[1], columns, work.on_second, data, system, links, work)


@inlined
def add_wheels(k, n, columns, model, data, system, work):
    r"""Add the derivatives of the wheels in row ``k`` of ``model.joint_rows``, by yaw and rates.

    With :math:`\partial_\theta W = (-\cos\theta, -\sin\theta, 0)^T`; see
    :mod:`multiarm.contacts.table`.
    """
    joint_rows = model.joint_rows
    i, row, x = joint_rows.block[k], joint_rows.row[k], joint_rows.joint[k]
    y, turn = x + 1, x + 2
    yaw, spin, force = data.state.joint_positions[turn], work.v[turn], work.force[row]
    sine, cosine = math.sin(yaw), math.cos(yaw)
    forward, sideways = (
        cosine * work.v[x] + sine * work.v[y], cosine * work.v[y] - sine * work.v[x]
    )  # fmt: skip
    first = x - system.first_joint[i]
    rate, position = columns.rates + first, columns.positions + first + 2
    dF, of_row = work.dF[i], work.dF[i, n + row - system.first_contact[i]]
    dF[first, position] += cosine * force
    dF[first + 1, position] += sine * force
    of_row[position] += -cosine * work.a_j[x] - sine * work.a_j[y] - sideways * spin
    of_row[rate] -= cosine * spin
    of_row[rate + 1] -= sine * spin
    of_row[rate + 2] -= forward
    work.rates[row, position] = -forward


@inlined
def joint_that_moves(body, model):
    """The joint of its block that moves a body of a connection, ``BASE``, or an object.

    See ``FIRST_OBJECT``.
    """
    links, objects = model.links, model.object_masses.size
    if body >= links.block.size:
        o = body - links.block.size
        return FIRST_OBJECT - o if o < objects else BASE
    length = links.length[body]
    return links.chain[body, length - 1] if length > 0 else BASE


@kernel
def write_connected_body(i, body, links, work, motion, moved):
    """Write the motion of a body of a connection, and its displacements by the block's joints.

    ``body`` as in :func:`multiarm.dynamics.contact_derivatives.write_body_displacement`.
    """
    if body <= FIRST_OBJECT:
        copy(work.objects[FIRST_OBJECT - body], motion)
    elif body == BASE:
        clear(motion)
        open_body(motion).rotation = AXES
    else:
        write_link(links, i, body, work.links, motion, moved)


@kernel
def add_wrench(i, body, columns, wrench, data, system, links, work):
    """Add the derivatives of a connection's wrench on a body to those of ``F_i`` or ``F_o``.

    ``wrench`` (C + 1, 6) is that of ``work.on_first`` or ``on_second``.
    """
    if body >= 0:
        subtract_load(body, wrench[columns.end], work.links)
    for c in range(columns.end):
        if columns.twists <= c < columns.positions or columns.rates <= c < columns.placement:
            continue  # wrenches of contacts do not depend on velocities
        if body >= 0:
            subtract_torques(links, i, body, wrench[c], work.links, work.dF[i], c)
        elif body <= FIRST_OBJECT:
            at = column_of_all(i, equation_columns(data), columns, system.first_joint[i], c, work)
            subtract_object_wrench(FIRST_OBJECT - body, c, at, wrench[columns.end], wrench[c], work)


@inlined
def subtract_object_wrench(o, c, at, wrench, slope, work):
    """Subtract the derivative of a wrench on an object from column ``at`` of ``dF_o``.

    ``wrench`` and ``slope`` (6,), its derivative in the object's axes, are in these; in columns 3
    to 5 of its own the object turns.
    """
    R, first = open_body(work.objects[o]).rotation, 6 * o
    moment_row = first + 3
    turn = AXES[c - moment_row] if moment_row <= c < moment_row + 3 else ZERO
    force = add_cross(rotate(R, vec(slope, 0)), turn, rotate(R, vec(wrench, 0)))
    moment = add_cross(rotate(R, vec(slope, 3)), turn, rotate(R, vec(wrench, 3)))
    for l in range(3):
        work.dF_o[first + l, at] -= force[l]
        work.dF_o[moment_row + l, at] -= moment[l]


@inlined
def columns_of_block(i, n, links, work):
    """The first columns of a block; the surroundings have no placements."""
    placed = i < links.first.size - 1 and work.placements >= 0
    placements = work.first_owner[i + 1] - work.first_owner[i] if placed else 0
    return block_columns(work.dF_o.shape[0], n, placements)


@inlined
def column_of_all(i, at, columns, d0, c, work):
    """Place among all columns ``at`` of a column of block ``i``, whose joints begin at ``d0``."""
    if c < columns.placement:
        return column_of_state(at, columns, d0, c)
    return work.placements + TWIST * work.first_owner[i] + c - columns.placement


@inlined
def write_matrix_of_block(i, first, m, n, data, system, work):
    """Write ``K_i`` and ``M_i``."""
    K, M, W = work.K[i], system.M[i], system.W[i]
    for a in range(n):
        for b in range(n):
            work.M[i, a, b] = K[a, b] = M[max(a, b), min(a, b)]
        for k in range(m):
            K[a, n + k], K[n + k, a] = -W[a, k], W[a, k]
    for k in range(m):
        for b in range(m):
            K[n + k, n + b] = 0.0


@kernel
def add_drift_feedback(struct, equations, alpha, beta):
    """Add the derivatives of the feedback on the drift to those of ``F_phi``.

    After :func:`write_derivatives`; ``alpha, beta`` [1/s] are the gains.
    """
    model, data, system = open_system(struct)
    links, work = open_links(equations), open_equations(equations)
    for i in range(system.first_joint.size - 1):
        n, first = system.first_joint[i + 1] - system.first_joint[i], system.first_contact[i]
        columns, W = columns_of_block(i, n, links, work), system.W[i]
        for k in range(first, system.first_contact[i + 1]):
            dF, by_gap = work.dF[i, n + k - first], beta * beta * gap_weight(model, k)
            for c in range(columns.twists):
                rate = data.rows.W_o[k, c]
                dF[c] += by_gap * rate + 2.0 * alpha * work.rates[k, c]
                dF[columns.twists + c] += 2.0 * alpha * rate
            for j in range(n):
                rate, position = W[j, k - first], columns.positions + j
                dF[position] += by_gap * rate + 2.0 * alpha * work.rates[k, position]
                dF[columns.rates + j] += 2.0 * alpha * rate


@inlined
def gap_weight(model, row):
    """1 for a row with a gap, 0 for one with a rate only."""
    kind = open_code(model.contacts.codes[row]).kind
    if kind == JOINT:
        return open_joint(model.contacts.geometry[row]).has_bound
    return 0.0 if rolls(kind) else 1.0


# --- solution -------------------------------------------------------------------------------------


@kernel
def stack_matrix(struct: INTS, equations: INTS, K: TABLE):
    """Add the matrix of all equations to ``K``.

    Its rows are those of the objects, of the joints and of the contacts, 6 F + n + N.
    """
    _, data, system = open_system(struct)
    work, places = open_equations(equations), chart_places(data)
    for l in range(places.joints):
        for c in range(places.joints):
            K[l, c] += data.bodies.object_inertia[l, c]
    for i in range(system.first_joint.size - 1):
        d0, n = system.first_joint[i], system.first_joint[i + 1] - system.first_joint[i]
        first, last = system.first_contact[i], system.first_contact[i + 1]
        joints, contacts = places.joints + d0, places.velocity + first - n
        for a in range(n + last - first):
            row = a + (joints if a < n else contacts)
            for b in range(n + last - first):
                K[row, b + (joints if b < n else contacts)] += work.K[i, a, b]
        for k in range(first, last):
            for l in range(places.joints):
                K[l, places.velocity + k] -= work.Wr_o[k, l]
                K[places.velocity + k, l] += data.rows.W_o[k, l]


@kernel
def stack_derivatives(struct: INTS, equations: INTS, weight: NUMBER, dF: TABLE):
    """Add the derivatives of all equations, times a weight, to ``dF``; rows as in ``K``."""
    _, data, system = open_system(struct)
    links, work = open_links(equations), open_equations(equations)
    places, of_all = chart_places(data), equation_columns(data)
    for l in range(places.joints):
        for c in range(dF.shape[1]):
            dF[l, c] += weight * work.dF_o[l, c]
    for i in range(system.first_joint.size - 1):
        d0, n = system.first_joint[i], system.first_joint[i + 1] - system.first_joint[i]
        first, last = system.first_contact[i], system.first_contact[i + 1]
        columns = columns_of_block(i, n, links, work)
        joints, contacts = places.joints + d0, places.velocity + first - n
        for a in range(n + last - first):
            row = dF[a + (joints if a < n else contacts)]
            add_block_columns(weight, work.dF[i, a], i, d0, n, columns, of_all, work, row)


@allocating
def solve_at_once(struct, equations, matrix):
    """Solve for ``dy`` where some block cannot be solved on its own; returns a status.

    ``matrix`` (6 F + n + N, columns) is written; of forces that are not unique it has one of many
    derivatives.  The result is ``SINGULAR`` where the rank of the constraints changes.
    """
    size = matrix.shape[0]
    K, pivots = np.zeros((size, size)), np.zeros(size, dtype=np.int64)
    for i in range(size):
        clear(matrix[i])
    stack_matrix(struct, equations, K)
    stack_derivatives(struct, equations, -1.0, matrix)
    data = open_data(struct)
    separate_dependent_rows(K, data.state.velocity.size, data.solution.dependent)
    if not factor_lu(K, size, pivots) > 0.0:
        return SINGULAR
    solve_rows(K, size, pivots, matrix)
    return OK


@allocating
def separate_dependent_rows(K, nv, dependent):
    r"""Add :math:`N\tilde N^T` to the block of the forces: K is regular then, its motions the same.

    The columns of N, as many as constraints are ``dependent``, are orthonormal with :math:`W N = 0`
    and :math:`\tilde W\tilde N = 0`.  So the part of the right-hand sides that no acceleration
    can meet goes into forces without effect.
    """
    if dependent == 0:
        return
    rows = K.shape[0] - nv
    G, Gr, singular = np.zeros((rows, nv)), np.zeros((rows, nv)), np.zeros(rows)
    V, Vr = np.zeros((rows, rows)), np.zeros((rows, rows))
    for k in range(rows):
        for l in range(nv):
            G[k, l] = K[nv + k, l] / math.sqrt(K[l, l])
            Gr[k, l] = -K[l, nv + k] / math.sqrt(K[l, l])
    decompose(G, rows, nv, V, singular)
    decompose(Gr, rows, nv, Vr, singular)
    for k in range(rows - dependent, rows):
        for a in range(rows):
            for b in range(rows):
                K[nv + a, nv + b] += V[k, a] * Vr[k, b]


@kernel
def solve_by_blocks(struct: INTS, equations: INTS, matrix: TABLE):
    """Solve for ``dy``, each block on its own and then the objects; returns a status.

    ``matrix`` (6 F + n + N, columns) is written; matrices and derivatives in the work are used up.
    The result is ``SINGULAR`` where a block, or the object, cannot be solved so.
    """
    _, data, system = open_system(struct)
    links, work = open_links(equations), open_equations(equations)
    S, places, of_all = work.S, chart_places(data), equation_columns(data)
    of_frames = S.shape[0]
    for l in range(of_frames):
        copy(data.bodies.object_inertia[l], S[l])
        row, dF_o = matrix[l], work.dF_o[l]
        for c in range(row.size):
            row[c] = -dF_o[c]
    for i in range(system.first_joint.size - 1):
        d0, n = system.first_joint[i], system.first_joint[i + 1] - system.first_joint[i]
        first, last, X = system.first_contact[i], system.first_contact[i + 1], work.dF[i]
        if not factor_lu(work.K[i], n + last - first, work.pivots) > 0.0:
            return SINGULAR
        solve_rows(work.K[i], n + last - first, work.pivots, X)
        columns = columns_of_block(i, n, links, work)
        C = columns.end
        for k in range(first, last):
            forces = X[n + k - first]
            for l in range(of_frames):
                add_block_columns(
                    -work.Wr_o[k, l], forces, i, d0, n, columns, of_all, work, matrix[l]
                )
                for c in range(of_frames):
                    S[l, c] += work.Wr_o[k, l] * forces[C + n + c]
    if not factor_lu(S, of_frames, work.pivots) > 0.0:
        return SINGULAR
    solve_rows(S, of_frames, work.pivots, matrix)
    for i in range(system.first_joint.size - 1):
        d0, n = system.first_joint[i], system.first_joint[i + 1] - system.first_joint[i]
        columns = columns_of_block(i, n, links, work)
        m, C = system.first_contact[i + 1] - system.first_contact[i], columns.end
        for k in range(n + m):
            X = work.dF[i, k]
            row = matrix[
                places.joints + d0 + k
                if k < n
                else places.velocity + system.first_contact[i] + k - n
            ]
            clear(row)
            for l in range(of_frames):
                weight, of_object = X[C + n + l], matrix[l]
                for c in range(row.size):
                    row[c] -= weight * of_object[c]
            add_block_columns(-1.0, X, i, d0, n, columns, of_all, work, row)
    return OK


@inlined
def add_block_columns(weight, values, i, d0, n, columns, of_all, work, row):
    """Add the columns of a block, times a weight, to a row of all columns."""
    at = of_all
    for c in range(columns.twists):
        row[c] += weight * values[c]
        row[at.twists + c] += weight * values[columns.twists + c]
    for k in range(n):
        row[at.positions + d0 + k] += weight * values[columns.positions + k]
        row[at.rates + d0 + k] += weight * values[columns.rates + k]
        row[at.torques + d0 + k] += weight * values[columns.end + k]
    first = work.placements + TWIST * work.first_owner[i]
    for k in range(columns.end - columns.placement):
        row[first + k] += weight * values[columns.placement + k]
