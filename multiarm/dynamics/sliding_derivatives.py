r"""Derivatives of sliding friction, for the equations of motion and its power.

A sliding contact has the friction :math:`-\mu\lambda_n d` on its tangents
(:mod:`multiarm.dynamics.sliding`).  At fixed forces it changes with the bodies as any contact
forces do, and with the direction d, a unit vector.  With the slip :math:`s = a\,d_0 + b\,d_0^\perp`
along the last step's direction and across it, and the angle :math:`\psi` from :math:`d_0` to d,

.. math::
    \tan\psi &= \frac{a b}{a^2 + s_0^2}, \qquad
    d\psi = \frac{b\,(s_0^2 - a^2)\,da + a\,(a^2 + s_0^2)\,db}{(a^2 + s_0^2)^2 + a^2 b^2}, \\
    d(d) &= d^\perp d\psi, \qquad
    d(s\cdot d) = d\cdot ds + (s\cdot d^\perp)\,d\psi ,

and ds are the derivatives of the tangents' rates.  The normal force is among the unknowns: its
columns in K are those of the reaction matrices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import slip_of
from multiarm.dynamics.arrays import open_data, open_system
from multiarm.dynamics.coordinates import equation_columns
from multiarm.dynamics.data import Data
from multiarm.dynamics.equation_derivatives import (
    column_of_all,
    columns_of_block,
    equation_work,
    open_equations,
    open_links,
    write_load_derivatives,
)
from multiarm.dynamics.row_selection import RowSelection
from multiarm.dynamics.sliding import friction_of_unit_force, slides_of, smooth_size
from multiarm.dynamics.status import OK
from multiarm.jit.kernels import INTS, kernel
from multiarm.jit.structs import Floats2, Ints1, referenced, struct_of, view


class FrictionDerivatives(NamedTuple):
    """Results for s sliding contacts, by the C coordinates of the blocks of these."""

    equations: Ints1  # struct of the derivatives of what forces in the tangents do to the bodies
    angle: Floats2  # (s, C) of psi [rad]
    speed: Floats2  # (s, C) of the slip along its direction [m/s]


open_friction = view(FrictionDerivatives)


def friction_derivatives(
    data: Data, columns: int, placements: int = -1
) -> tuple[FrictionDerivatives, np.ndarray]:
    """The arrays and their struct, for derivatives as those of ``equation_work``.

    The data keep them.
    """
    key = ("friction derivatives", columns, placements)
    if key not in data.cache:
        equations, count = np.zeros(0, dtype=np.int64), 0
        work, _ = equation_work(data, columns, placements)
        if data.arrays.modes.slides:
            assert isinstance(data, RowSelection) and data.tangents is not None, "a mode"
            _, equations = equation_work(data.tangents, columns, placements, masses=False)
            count = data.tangents.rows.size // 2
        angle, speed = np.zeros((2, count, work.rates.shape[1]))
        friction = FrictionDerivatives(equations, angle, speed)
        data.cache[key] = friction, struct_of(friction)
    return data.cache[key]


@kernel
def add_friction(struct: INTS, equations: INTS, of_friction: INTS):
    """Add sliding friction to the derivatives of all equations; returns a status.

    After :func:`multiarm.dynamics.equation_derivatives.write_derivatives`, in a mode in which some
    contacts slide.  ``of_friction`` is the struct of :func:`friction_derivatives`.
    """
    data, friction, slides = (
        open_data(struct),
        open_friction(of_friction),
        slides_of(open_data(struct)),
    )
    tangents = referenced(data.modes.tangents)
    sideways = open_data(tangents)
    for s in range(slides.row.size):
        normal, t = data.rows.force[slides.row[s]], slides.tangent[s]
        first, second = friction_of_unit_force(slides, s)
        sideways.rows.static_force[t] = normal * first
        sideways.rows.static_force[t + 1] = normal * second
    status = write_load_derivatives(tangents, friction.equations)
    if status == OK:
        add_loads(struct, equations, friction)
        for s in range(slides.row.size):
            differentiate_slip(s, struct, equations, friction)
            add_reactions(s, struct, equations)
    return status


@kernel
def add_loads(struct, equations, friction):
    """Add what the friction at fixed forces does to the bodies."""
    _, _, system = open_system(struct)
    links, work, sideways = (
        open_links(equations),
        open_equations(equations),
        open_equations(friction.equations),
    )
    for l in range(work.dF_o.shape[0]):
        for c in range(work.dF_o.shape[1]):
            work.dF_o[l, c] += sideways.dF_o[l, c]
    for i in range(system.first_joint.size - 1):
        n = system.first_joint[i + 1] - system.first_joint[i]
        for j in range(n):
            for c in range(columns_of_block(i, n, links, work).end):
                work.dF[i, j, c] += sideways.dF[i, j, c]


@kernel
def differentiate_slip(s, struct, equations, friction):
    """Write the derivatives of the slip of a contact, and add what its turning does."""
    _, data, system = open_system(struct)
    links, work, sideways = (
        open_links(equations),
        open_equations(equations),
        open_equations(friction.equations),
    )
    _, sliding, tangents = open_system(referenced(data.modes.tangents))
    slides, at = slides_of(data), equation_columns(data)
    i, t = slides.block[s], slides.tangent[s]
    d0, n, column = (
        system.first_joint[i],
        system.first_joint[i + 1] - system.first_joint[i],
        t - tangents.first_contact[i],
    )
    columns, normal = columns_of_block(i, n, links, work), data.rows.force[slides.row[s]]
    friction_0, friction_1 = friction_of_unit_force(slides, s)
    along_0, along_1 = slides.direction[s, 0], slides.direction[s, 1]
    d_0, d_1 = slides.turning[s, 0], slides.turning[s, 1]
    first, second = slip_of(sliding.rows.kinematics, t)
    a, b = along_0 * first + along_1 * second, along_0 * second - along_1 * first
    smooth, slope, change = smooth_size(a, slides.numbers.slow)
    size = smooth * smooth + slope * slope * b * b
    by_along, by_across = b * (change * smooth - slope * slope) / size, slope * smooth / size
    for c in range(columns.end):
        of_first, of_second = sideways.rates[t, c], sideways.rates[t + 1, c]
        angle = by_along * (along_0 * of_first + along_1 * of_second)
        angle += by_across * (along_0 * of_second - along_1 * of_first)
        friction.angle[s, c] = angle
        friction.speed[s, c] = d_0 * of_first + d_1 * of_second
        friction.speed[s, c] += (d_0 * second - d_1 * first) * angle
        force_0, force_1 = -normal * friction_1 * angle, normal * friction_0 * angle
        for j in range(n):
            W = tangents.W[i, j]
            work.dF[i, j, c] -= W[column] * force_0 + W[column + 1] * force_1
        place = column_of_all(i, at, columns, d0, c, work)
        for l in range(work.dF_o.shape[0]):
            work.dF_o[l, place] -= (
                sliding.rows.W_o[t, l] * force_0 + sliding.rows.W_o[t + 1, l] * force_1
            )


@kernel
def add_reactions(s, struct, equations):
    """Add the friction of a unit normal force to the columns of the normal force."""
    _, data, system = open_system(struct)
    work, slides = open_equations(equations), slides_of(data)
    _, sliding, tangents = open_system(referenced(data.modes.tangents))
    i, t, row = slides.block[s], slides.tangent[s], slides.row[s]
    n, column = system.first_joint[i + 1] - system.first_joint[i], t - tangents.first_contact[i]
    first, second = friction_of_unit_force(slides, s)
    for l in range(work.Wr_o.shape[1]):
        work.Wr_o[row, l] += first * sliding.rows.W_o[t, l] + second * sliding.rows.W_o[t + 1, l]
    for j in range(n):
        W = tangents.W[i, j]
        work.K[i, j, n + row - system.first_contact[i]] -= (
            first * W[column] + second * W[column + 1]
        )
