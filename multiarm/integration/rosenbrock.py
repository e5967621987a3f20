r"""One step of a Rosenbrock method: linearly implicit, for scenes with fast damped motions.

With ``u' = f(t, u)``, ``J`` its Jacobian and ``f_t`` its time derivative at the beginning of the
step, the stages of Rodas5P solve linear systems with one and the same matrix,

.. math::
    \Big(\frac{1}{\gamma} - hJ\Big) k_i = f\Big(t + c_i h,\ u + h\sum_{j<i} a_{ij} k_j\Big)
        + \sum_{j<i} C_{ij} k_j + h\, d_i f_t, \qquad u_1 = u + h \sum_i b_i k_i ,

and the last of them is the error estimate (G. Steinebach, BIT Numer. Math. 63:27, 2023; E. Hairer,
G. Wanner, Solving Ordinary Differential Equations II, IV.7).  The method is of order 5 and
L-stable: motions that damping, stiff springs or stiff gains make fast do not limit the step once
they have died out.

*The matrix.*  The state is ``[positions, velocities, inner states, works]``; inner states are those
of effects, and are treated like velocities that move no position.  Only accelerations, inner rates
and powers need derivatives; the positions' rates are known.  At the beginning of a step, where the
chart's rotation vectors are zero, they are ``B p + v`` with ``B = blkdiag(0, [omega]x / 2, 0)``,
and so :math:`R = (1/\gamma - hB)^{-1}` is written down.

Where control and effects are local, gravity compensation besides, the system falls apart into
blocks, at a cost that is linear in them (:mod:`multiarm.integration.block_matrices`).  Elsewhere it
is one matrix (:mod:`multiarm.integration.full_matrix`): with the square of the number of blocks
grows the cost of its derivatives, with the cube that of its factors; for few blocks both are small.

*The derivatives* are exact with either, and take one evaluation, that of the beginning; a step that
was rejected leaves its own to the next one, which begins there too.  A law or effect that states no
derivative is differentiated by differences, which compute its forces and the kinematics that these
need: n of the longest block twice where it is local, twelve an object and twice n of all blocks
elsewhere, and none for a function of a user, which knows the state alone.  Whole evaluations are
differentiated where constraints nearly lose rank.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.coordinates import chart_places, equation_columns
from multiarm.dynamics.data import Data
from multiarm.dynamics.equation_derivatives import equation_work
from multiarm.dynamics.force_derivatives import prepare_derivatives
from multiarm.dynamics.status import NOT_FINITE, OK, SINGULAR
from multiarm.integration.block_derivatives import differentiate_blocks, write_time_slope
from multiarm.integration.block_matrices import (
    BlockMatrices,
    acts_locally,
    is_regular,
    make_block_matrices,
)
from multiarm.integration.block_stages import factor_stages, solve_block_stage
from multiarm.integration.full_matrix import (
    FullMatrix,
    differentiate_full,
    factor_full,
    make_full_matrix,
    solve_full_stage,
)
from multiarm.integration.step import METHOD_WORK, Step, combine, open_step, slope_at, stage_slope
from multiarm.jit.kernels import cfunc, copy, kernel
from multiarm.jit.structs import Flag, Float, Floats1, Numbers, count_entries, struct_at, view


class Derived(Numbers):
    """The derivatives in the arrays: what they are for, besides the state."""

    valid: Flag
    block_by_block: Flag  # they are in ``BlockMatrices``; else in ``FullMatrix``
    alpha: Float
    beta: Float
    projects: Flag  # as in ``Stage``


class RosenbrockWork(NamedTuple):
    """A step's arrays for ``D`` entries of the chart's vector."""

    slope: Floats1  # (D,), the first slope
    right: Floats1  # (D,), right-hand side of a stage
    time_slope: Floats1  # (D,), derivative with respect to time
    derived: Derived

    @property
    def memory(self) -> tuple[np.ndarray, ...]:
        """What steps write, which is zero where a run begins."""
        return self.slope, self.right, self.time_slope, self.derived.struct


def make_rosenbrock(data: Data, step: Step) -> tuple[RosenbrockWork, BlockMatrices, FullMatrix]:
    """Allocate the arrays of a Rosenbrock method's steps."""
    slope, right, time_slope = np.zeros((3, step.z.size))
    work = RosenbrockWork(slope, right, time_slope, Derived())
    prepare_derivatives(data)
    _, equations = equation_work(data, equation_columns(data.arrays).end)
    blocks = make_block_matrices(data, step, equations)
    return work, blocks, make_full_matrix(data, step, equations)


_view_work = view(RosenbrockWork, METHOD_WORK)
_BLOCKS = METHOD_WORK + count_entries(RosenbrockWork)
_view_blocks = view(BlockMatrices, _BLOCKS)
_view_full = view(FullMatrix, _BLOCKS + count_entries(BlockMatrices))


@cfunc
def rosenbrock_step(address, size, t, h):
    """All stages of a step of length ``h`` from time ``t``, then ``z_new``; returns a status.

    ``step.k[0]`` holds the first slope.
    """
    struct = struct_at(address, size)
    method, step = open_step(struct)
    work, blocks, full = _view_work(struct), _view_blocks(struct), _view_full(struct)
    copy(step.k[0], work.slope)
    status = differentiate_step(step, work, blocks, full, t, h)
    if status != OK:
        return status
    places = chart_places(open_data(step.system))
    velocity, gamma, right = step.z[places.velocity : places.states], method.gamma, work.right
    projects = step.stage.projects != 0
    if work.derived.block_by_block:
        usable = factor_stages(gamma, blocks, step.system, velocity, h)
    else:
        usable = factor_full(gamma, full, step.system, projects, velocity, h)
    if not usable:
        return NOT_FINITE
    for i in range(method.stages):
        copy(work.slope, right)
        if i > 0:
            combine(step, method.A[i], i, h, step.z_stage)
            status = stage_slope(step, t + method.c[i] * h, step.z_stage, right)
            if status != OK:
                return status
        for j in range(i):
            weight = method.C[i, j]
            for l in range(right.size):
                right[l] += weight * step.k[j, l]
        for l in range(right.size):
            right[l] += h * method.d[i] * work.time_slope[l]
        if work.derived.block_by_block:
            solve_block_stage(gamma, blocks, step.system, velocity, h, right, step.k[i])
        else:
            solve_full_stage(gamma, full, step.system, projects, velocity, h, right, step.k[i])
    combine(step, method.b, method.stages, h, step.z_new)
    return OK


@kernel
def differentiate_step(step, work, blocks, full, t, h):
    """Derivatives at the beginning of the step; returns a status.

    Those of a step that was rejected are those of the next one.
    """
    stage, derived = step.stage, work.derived
    if (
        stage.repeats and derived.valid and derived.projects == stage.projects
        and derived.alpha == stage.alpha and derived.beta == stage.beta
    ):  # fmt: skip
        return OK
    status = differentiate_anew(step, work, blocks, full, t, h)
    derived.valid = status == OK
    derived.alpha, derived.beta, derived.projects = stage.alpha, stage.beta, stage.projects
    return status


@kernel
def differentiate_anew(step, work, blocks, full, t, h):
    """Derivatives at the beginning of the step, block by block where possible; returns a status."""
    work.derived.block_by_block = False
    status = slope_at(step, t, step.z, work.right)
    if status != OK:
        return status
    if not step.stage.projects and acts_locally(step) and is_regular(step.system):
        status = differentiate_blocks(step, blocks, h)
        if status != SINGULAR:
            work.derived.block_by_block = True
            write_time_slope(blocks, step.system, work.time_slope)
            return status
    return differentiate_full(step, full, work.slope, work.time_slope, t, h)
