r"""Blocks of the derivatives of the accelerations, for each block: linear in the blocks.

Where control and effects are local, a block's accelerations, and the forces of its contacts, are
functions of its own state :math:`x_i`, of the object's :math:`x_o`, and of the *couplings*: the
object's acceleration, and the multipliers of a control law that distributes a wrench over the
blocks (:mod:`multiarm.dynamics.control_laws`).  With :math:`\chi` the derivatives of these,

.. math::
    d\ddot q_i = A_i\, dx_i + A_{oi}\, dx_o + U_i\, \chi, \qquad
    \chi = \sum_i B_i\, dx_i + B_o\, dx_o

(:mod:`multiarm.integration.block_derivatives`).  The rates of effects' states have rows in
:math:`A_i`, whose columns contain these states.  The linear systems of a step with these blocks:
:mod:`multiarm.integration.block_stages`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import CARRYING, open_data, open_system
from multiarm.dynamics.coordinates import columns_of_forces
from multiarm.dynamics.data import Data
from multiarm.dynamics.force_derivatives import ForceDifferences, torques_are_held
from multiarm.dynamics.solver.solution import WHOLE
from multiarm.integration.step import Step
from multiarm.jit.kernels import kernel, plain
from multiarm.jit.structs import Floats1, Floats2, Floats3, Int, Ints1, Ints2


class BlockMatrices(NamedTuple):
    """Arrays for ``n`` blocks; ``d`` joints, ``m`` contacts, ``e`` effects' states of the largest.

    A block has ``P = 2 d + e`` columns of its own.  Its ``R = d + m + e + w`` rows are those of its
    joints, right after them those of its contacts, from row ``d + m`` on the rates of its states,
    and from ``d + m + e`` on its ``w`` powers.
    """

    d: Int
    m: Int
    e: Int
    works: Int  # powers: of the effects that do work, last of control and effects
    frames: Int  # velocities of the objects, o = 6 F
    couplings: Int  # unknowns that couple the blocks: the objects' accelerations, multipliers
    counts: Ints1  # (n,) effects' states of each block
    states: Ints2  # (n, e) their places among all
    # (n, P + 2 o + 1 + u) column of each one of ``derivatives`` among those of forces; -1: none
    sources: Ints2
    powers: Ints1  # (effects that are called,) the place of each one's power, -1 without
    # struct of multiarm.dynamics.equation_derivatives, for all blocks; its K has all factors
    equations: Ints1
    differences: ForceDifferences
    # for u couplings: A, A_o, U, before the solution those of F, (n, R, P + 2 o + 1 + u); B_i
    # (n, u, P); B_o, then the powers of the forces on the object (u + w, 2 o + 1)
    derivatives: Floats3
    on_object: Floats3
    by_object: Floats2
    W_o: Floats2  # (N, o) at the beginning of the step
    # factors: of S (u, u), of E (n, d + e, d + e), of the system for chi (u, u); pivots of each
    # block's equations
    K_pivots: Ints2
    S: Floats2
    S_pivots: Ints1
    E: Floats3
    E_pivots: Ints2
    V: Floats3  # (n, d + e, u)
    D: Floats3  # (n, u, d + e)
    node: Floats2
    node_pivots: Ints1
    # of a stage: derivatives of the couplings (u,), rates of the object (2 o,), unknowns of
    # each block (n, d + e)
    chi: Floats1
    rates: Floats1
    unknowns: Floats2

    @property
    def memory(self) -> tuple[np.ndarray, ...]:
        """What steps write, which is zero where a run begins."""
        derivatives = self.derivatives, self.on_object, self.by_object, self.W_o
        factors = self.S, self.E, self.V, self.D, self.node
        return (*derivatives, *factors, self.chi, self.rates, self.unknowns)


class DerivativeColumns(NamedTuple):
    """First columns of ``BlockMatrices.derivatives``; the block's positions begin at zero.

    Those of the object's pose, its twist and the time are all that ``BlockMatrices.by_object`` has.
    """

    rates: int
    states: int
    pose: int
    twist: int
    time: int
    accelerations: int  # of the object; here the couplings begin
    multipliers: int
    end: int


@plain
def derivative_columns(blocks):
    """The columns for the sizes of these blocks."""
    pose = 2 * blocks.d + blocks.e
    time = pose + 2 * blocks.frames
    couplings = time + 1
    return DerivativeColumns(
        blocks.d,
        2 * blocks.d,
        pose,
        pose + blocks.frames,
        time,
        couplings,
        couplings + blocks.frames,
        couplings + blocks.couplings,
    )


def make_block_matrices(data: Data, step: Step, equations: np.ndarray) -> BlockMatrices:
    """Allocate the blocks of a system; see :func:`acts_locally` for when they are used.

    ``equations`` is the struct of the derivatives of its equations.
    """
    layout, effects = data.model.layout, data.model.effects
    n, d = layout.block_count, max(layout.joint_counts)
    m, works = max(layout.contact_counts), step.z.size - step.tolerance.size
    states_by_block: list[list[int]] = [[] for _ in range(n)]
    if effects.local:
        state_joints = [joint for effect in effects.kernels for joint in effect.state_joints]
        for state, joint in enumerate(state_joints):
            states_by_block[layout.block_of_joint(joint)].append(state)
    e = max(map(len, states_by_block))
    of_block, rows, frames = 2 * d + e, d + m + e + works, layout.nv - layout.rate_count
    constants = data.model.constants
    distributes = len(constants.control) > 0 and constants.control_reach == CARRYING
    u, of_object = (2 if distributes else 1) * frames, 2 * frames + 1
    blocks = BlockMatrices(
        d=d,
        m=m,
        e=e,
        works=works,
        frames=frames,
        couplings=u,
        counts=np.array(list(map(len, states_by_block)), dtype=np.int64),
        states=np.full((n, e), -1, dtype=np.int64),
        sources=np.full((n, of_block + of_object + u), -1, dtype=np.int64),
        powers=effects.powers,
        equations=equations,
        differences=ForceDifferences(local=1, laws=len(constants.control) - distributes, order=1),
        derivatives=np.zeros((n, rows, of_block + of_object + u)),
        on_object=np.zeros((n, u, of_block)),
        by_object=np.zeros((u + works, of_object)),
        W_o=np.zeros((layout.contacts, frames)),
        K_pivots=np.zeros((n, d + m), dtype=np.int64),
        S=np.zeros((u, u)),
        S_pivots=np.zeros(u, dtype=np.int64),
        E=np.zeros((n, d + e, d + e)),
        E_pivots=np.zeros((n, d + e), dtype=np.int64),
        V=np.zeros((n, d + e, u)),
        D=np.zeros((n, u, d + e)),
        node=np.zeros((u, u)),
        node_pivots=np.zeros(u, dtype=np.int64),
        chi=np.zeros(u),
        rates=np.zeros(2 * frames),
        unknowns=np.zeros((n, d + e)),
    )
    at = derivative_columns(blocks)
    of_forces = columns_of_forces(layout.nv, layout.rate_count, effects.states)
    for i, states in enumerate(states_by_block):
        joints, columns = np.arange(layout.rate_count)[layout.joints_of_block(i)], blocks.sources[i]
        blocks.states[i, : len(states)] = states
        columns[: joints.size] = of_forces.positions + joints
        columns[at.rates : at.rates + joints.size] = of_forces.rates + joints
        columns[at.states : at.states + len(states)] = np.add(of_forces.states, states)
        columns[at.pose : at.time] = range(2 * frames)
        columns[at.time] = of_forces.time
        first = of_forces.multipliers
        columns[at.multipliers : at.end] = range(first, first + u - frames)
    return blocks


@kernel
def acts_locally(step):
    """Whether control and effects are local now, in a scene that the node algorithm solves."""
    model, data, _ = open_system(step.system)
    controlled = model.control.shape[0] > 0 and not torques_are_held(model, data)
    if not model.local_effects or (controlled and model.control_reach > CARRYING):
        return False
    # contacts of modes need not be those of blocks
    return not (model.dense or data.modes.active)


@kernel
def is_regular(struct):
    """Whether the last evaluation has eliminated every block as a whole."""
    return open_data(struct).solution.elimination == WHOLE
