r"""Momenta and kinetic energy: what the inertias make of velocities.

.. math:: p = M v, \qquad T = \tfrac12 v^T M v

with the objects' inertia :math:`M_o` and those of the blocks :math:`M_i` at the kinematics in the
data, in world axes.
"""

from __future__ import annotations

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.solver.factored_trees import complete_inertias
from multiarm.jit.kernels import INTS, NUMBERS, inlined, kernel


@inlined
def times_object_inertia(k, data, x):
    """Entry ``k`` of ``M_o x``, which is block diagonal by the objects."""
    first, product = k - k % 6, 0.0
    for l in range(first, first + 6):
        product += data.bodies.object_inertia[k, l] * x[l]
    return product


@inlined
def times_block_inertia(i, j, work, x):
    """Entry of ``M_i x_i`` for joint ``j`` of block ``i``; ``x`` has all joints."""
    first, product = work.first_joint[i], 0.0
    for k in range(work.first_joint[i + 1] - first):  # the lower triangle is filled
        product += work.M[i, max(j, k), min(j, k)] * x[first + k]
    return product


@kernel
def write_momenta(struct: INTS, momenta: NUMBERS):
    """Write ``M v`` of objects and joints, in the order of a velocity [N s, N m s]."""
    _, data, work = open_system(struct)
    complete_inertias(work)
    rates = data.state.joint_rates
    first = momenta.size - rates.size
    for k in range(first):
        momenta[k] = times_object_inertia(k, data, data.state.velocity)
    for i in range(work.first_joint.size - 1):
        for j in range(work.first_joint[i + 1] - work.first_joint[i]):
            momenta[first + work.first_joint[i] + j] = times_block_inertia(i, j, work, rates)


@kernel
def kinetic_energy(data, work):
    """Kinetic energy of robots and objects [J] at the last evaluated state."""
    complete_inertias(work)
    velocity, rates, energy = data.state.velocity, data.state.joint_rates, 0.0
    for k in range(data.bodies.object_inertia.shape[0]):
        energy += 0.5 * velocity[k] * times_object_inertia(k, data, velocity)
    for i in range(work.first_joint.size - 1):
        d0 = work.first_joint[i]
        for j in range(work.first_joint[i + 1] - d0):
            energy += 0.5 * rates[d0 + j] * times_block_inertia(i, j, work, rates)
    return energy
