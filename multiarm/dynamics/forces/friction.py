r"""Forces within the cones of friction: central ones that exert a wrench, in the loop of a run.

A contact that only pushes has a normal force n and, with friction, tangential forces
:math:`t \in R^2`.  With coefficients :math:`\mu` that are reduced by a margin, the forces
:math:`\lambda` of all rows are those that

.. math::
    \min_\lambda\; \tfrac12 |\lambda - \lambda_s|^2 - \tfrac{\ell^2}{2} \sum_i
    \log(\mu_i^2 n_i^2 - |t_i|^2) \quad\text{with}\quad W_o^T \lambda = w, \quad n_i > 0

(:math:`-\ell^2 \log n_i` for contacts without friction; S. Boyd and L. Vandenberghe, *Convex
Optimization*, 2004, 11.6).  The barrier keeps every force within its cone and makes it a smooth
function of the wrench; the smaller the force :math:`\ell`, the closer are the forces to the
smallest in the cones.  Without a wrench and desired forces :math:`\lambda_s` they are internal, and
their mean square over the C contacts is :math:`\ell^2` (:math:`\lambda^T` times the condition of
optimality, with :math:`\lambda^T\nabla\log = 2`): each contact presses with about :math:`\ell`.

With multipliers y of the wrench, :math:`p = \lambda_s + W_o y`, each contact has the force that is
best for itself.  In units of :math:`\ell` it is the root of a scalar equation,

.. math::
    n\,(n - p_n)\Big(1 - \frac{\mu^2 |p_t|^2}{q^2}\Big) = 1, \qquad q = (1 + \mu^2)\,n - p_n,
    \qquad t = \frac{\mu^2 n}{q}\, p_t ,

whose logarithm is concave and increasing where n is beyond the cone's point nearest to p.  What
remains are the equations :math:`W_o^T \lambda(y) = w`, those of the maximum of the concave dual
function, by Newton's method with the derivative :math:`W_o^T P W_o`,

.. math:: P_i = \Big(1 + \tfrac{\ell^2}{2}\nabla^2(-\log(\mu_i^2 n_i^2 - |t_i|^2))\Big)^{-1} .

It starts from y = 0 at every evaluation, so that the forces depend on the state alone.

*No forces.*  A twist y with :math:`y^T w > 0` on which no forces within the cones do work,
:math:`(W_o y)_n \le -\mu |(W_o y)_t|`, proves that the cones do not have the wrench (Farkas).
Newton's steps grow along such a twist.  Where they end before it is exact, the dual function there
proves it for all forces but huge ones: it is less than half of their square.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.dynamics.forces.compiled import SHORTEST_LEVER
from multiarm.dynamics.solver.factors import backward, factor_cholesky, forward, norm
from multiarm.dynamics.status import OK
from multiarm.jit.kernels import allocating, clear, copy, kernel

# Answers of laws: no forces within the cones exert the wrench, as is proven; or none were found.
BEYOND_FRICTION, NOT_CONVERGED = 1, 2
# Newton's steps: 5 to 15 usually, some 40 where cones barely have the wrench.
MOST_STEPS = 100
# Steps of the equation of one contact: 3 to 6 usually.
MOST_CONTACT_STEPS = 60
# Decrement of the dual function, of the size of the wrench, that is rounding; and one below which
# rounding may keep it from falling.
CONVERGED, NEARLY_CONVERGED = 1e-26, 1e-18
# A contact's equation is solved to this part of its unknown.
SOLVED = 1e-14
# Shorter steps along a line bring nothing.
SHORTEST_STEP = 1e-6
# A dual function of so many squares of the wrench: forces are larger than a hundred wrenches.
BEYOND = 1e4
# Part of the proof that no forces exert a wrench that counts as rounding.
PROVEN = 1e-9
# Rate at which a twist opens a contact, as a part of it, that is not rounding.
OPENS = 1e-6


@allocating
def distribute_within_friction(wrench, W_o, pushing, friction, least, desired, force):
    r"""Write the central contact forces that put ``wrench`` on the objects.

    Parameters
    ----------
    wrench : (6 K,)
        On each object about its centre of mass, world axes [N, N m].
    W_o : (N, 6 K)
        Of rank 6 K.
    pushing : int (C,)
        Rows of the normals of contacts that only push; the tangents of one with friction follow.
    friction : (C,)
        Their coefficients :math:`\mu`, less the margin; 0: there are no tangents.
    least : float
        :math:`\ell` [N], positive.
    desired : (N,)
        :math:`\lambda_s` [N].
    force : (N,), written

    Returns
    -------
    ``OK``; ``BEYOND_FRICTION`` where it is proven that no forces within the cones exert the wrench;
    ``NOT_CONVERGED`` where neither is found: the wrench is at the limit of the cones, or ``W_o``
    has not the full rank.
    """
    N, size, C = W_o.shape[0], wrench.size, pushing.size
    W, target, scale = np.empty((N, size)), np.empty(size), np.empty(size)
    y, trial, step = np.zeros(size), np.zeros(size), np.zeros(size)
    gradient, H, along = np.empty(size), np.empty((size, size)), np.empty(size)
    # of every contact: how far n is beyond its least value, and (n - p_n) / n
    beyond, share = np.zeros(C), np.empty(C)
    write_scales(W_o, scale)
    scaled = 1.0
    for l in range(size):
        target[l] = scale[l] * wrench[l] / least
        scaled += target[l] * target[l]
        for k in range(N):
            W[k, l] = scale[l] * W_o[k, l]
    status, slope, before = NOT_CONVERGED, 0.0, math.inf
    for iteration in range(MOST_STEPS):
        length = 1.0
        while True:
            for l in range(size):
                trial[l] = y[l] + length * step[l]
            write_forces(W, trial, pushing, friction, least, desired, beyond, share, force)
            ascent = 0.0
            for l in range(size):
                gradient[l] = -target[l]
                for k in range(N):
                    gradient[l] += W[k, l] * force[k]
                ascent += gradient[l] * step[l]
            # the dual function is concave: past its maximum along the step the slope is positive
            if iteration == 0 or ascent <= 0.5 * abs(slope) or length < SHORTEST_STEP:
                break
            length *= 0.5
        copy(trial, y)
        write_metric(W, pushing, friction, share, force, along, H)
        if not factor_cholesky(H, size) > 0.0:
            break
        for l in range(size):
            step[l] = -gradient[l]
        forward(H, size, step)
        slope = 0.0
        for l in range(size):
            slope -= step[l] * step[l]
        backward(H, size, step)
        stalled = -slope > 0.25 * before and -slope <= NEARLY_CONVERGED * scaled
        if -slope <= CONVERGED * scaled or stalled:
            status = OK
            break
        before = -slope
        if is_beyond(W, y, target, pushing, friction):
            status = BEYOND_FRICTION
            break
    dual = dual_value(y, gradient, desired, least, force)
    if status == NOT_CONVERGED and dual > BEYOND * scaled:
        status = BEYOND_FRICTION
    for k in range(N):
        force[k] *= least
    return status


@kernel
def dual_value(y, gradient, desired, least, force):
    """The dual function without the logarithms, in units of ``least^2``."""
    value = 0.0
    for k in range(force.size):
        value += 0.5 * (force[k] - desired[k] / least) ** 2
    for l in range(y.size):
        value -= y[l] * gradient[l]
    return value


@kernel
def write_scales(W_o, scale):
    """Write what makes the columns forces: moments are divided by the longest lever arm."""
    longest = SHORTEST_LEVER
    for k in range(W_o.shape[0]):
        for turn in range(3, scale.size, 6):
            longest = max(longest, norm(W_o[k, turn : turn + 3], 3))
    for l in range(scale.size):
        scale[l] = 1.0 if l % 6 < 3 else 1.0 / longest


@kernel
def write_forces(W, y, pushing, friction, least, desired, beyond, share, force):
    """Write the force of every row that is best at multipliers ``y``, in units of ``least``."""
    for k in range(force.size):
        force[k] = desired[k] / least
        for l in range(y.size):
            force[k] += W[k, l] * y[l]
    for i in range(pushing.size):
        k, mu, along, across = pushing[i], friction[i], 0.0, 0.0
        if mu > 0.0:
            along, across = force[k + 1], force[k + 2]
        wished = math.hypot(along, across)
        lowest, beyond[i] = normal_force(force[k], wished, mu, beyond[i])
        n, raised = lowest + beyond[i], (lowest - force[k]) + beyond[i]
        share[i] = raised / n
        if mu > 0.0:
            # q = mu^2 n + (n - p_n)
            part = mu * mu * n / (mu * mu * n + raised)
            force[k + 1], force[k + 2] = part * along, part * across
        force[k] = n


@kernel
def normal_force(p, wished, mu, beyond):
    """Solve the equation of one contact; returns the least n, and how far n is beyond it.

    ``beyond`` is a guess, 0: none.  Both parts are without cancellation, wherever p is.
    """
    both, reach = 1.0 + mu * mu, mu * wished
    edge, lowest = (p + reach) / both, max(p, 0.0)
    root = math.sqrt(p * p + 4.0)
    without = 2.0 / (root + abs(p))
    if reach == 0.0:
        return lowest, without
    if edge > lowest:
        lowest, without = edge, 1.0 / (1.0 + edge)
    z = beyond if beyond > 0.0 else without
    above, past = lowest - p, both * (lowest - edge)
    for _ in range(MOST_CONTACT_STEPS):
        n, raised, e = lowest + z, above + z, past + both * z
        q, far = e + reach, e + 2.0 * reach
        value = math.log(n * raised * (e / q) * (far / q))
        slope = 1.0 / n + 1.0 / raised + both * (1.0 / e + 1.0 / far - 2.0 / q)
        change = value / slope
        if z - change <= 0.0:
            z *= 0.1
            continue
        z -= change
        if abs(change) <= SOLVED * z:
            break
    return lowest, z


@kernel
def write_metric(W, pushing, friction, share, force, along, H):
    """Write ``W^T P W`` (lower triangle) at these forces."""
    size = along.size
    for l in range(size):
        clear(H[l])
    i, k = 0, 0
    while k < force.size:
        pushes = i < pushing.size and pushing[i] == k
        if not pushes:
            add_product(1.0, W[k], W[k], H)
            k += 1
            continue
        u, mu = share[i], friction[i]
        i += 1
        if mu == 0.0:
            add_product(1.0 / (1.0 + u), W[k], W[k], H)
            k += 1
            continue
        n, t1, t2 = force[k], force[k + 1], force[k + 2]
        # s = 1 / (mu^2 n^2 - |t|^2); the inverse of 1 + Hessian / 2 in closed form
        s, tangential = u / (mu * mu), t1 * t1 + t2 * t2
        turned = 2.0 * tangential * s * s
        determinant = (1.0 + u) * (1.0 + s) + turned * (1.0 + mu * mu)
        across = 1.0 / (1.0 + s)
        inward = (1.0 + u + mu * mu * turned) / determinant
        for l in range(size):
            along[l] = t1 * W[k + 1, l] + t2 * W[k + 2, l]
        add_product((1.0 + s + turned) / determinant, W[k], W[k], H)
        mixed = 2.0 * mu * mu * n * s * s / determinant
        add_product(mixed, W[k], along, H)
        add_product(mixed, along, W[k], H)
        add_product(across, W[k + 1], W[k + 1], H)
        add_product(across, W[k + 2], W[k + 2], H)
        if tangential > 0.0:
            add_product((inward - across) / tangential, along, along, H)
        k += 3


@kernel
def add_product(weight, left, right, H):
    """Add ``weight left right^T`` to a lower triangle."""
    for a in range(left.size):
        factor = weight * left[a]
        for b in range(a + 1):
            H[a, b] += factor * right[b]


@kernel
def is_beyond(W, y, wrench, pushing, friction):
    """Whether the twist ``y`` proves that no forces within the cones exert the wrench.

    Rows that hold both ways must do no work on it.  Without a wrench, forces that are not zero do.
    """
    work, size, opening = 0.0, 0.0, 0.0
    for l in range(y.size):
        work += y[l] * wrench[l]
        size += abs(y[l])
    load = norm(wrench, wrench.size)
    if load > 0.0 and not work > PROVEN * size * load:
        return False
    i, k = 0, 0
    while k < W.shape[0]:
        gap_rate = rate_of(W[k], y)
        if i < pushing.size and pushing[i] == k:
            slip = 0.0
            if friction[i] > 0.0:
                slip = friction[i] * math.hypot(rate_of(W[k + 1], y), rate_of(W[k + 2], y))
                k += 2
            if gap_rate + slip > PROVEN * size:
                return False
            opening = max(opening, -(gap_rate + slip))
            i += 1
        elif abs(gap_rate) > PROVEN * size:
            return False
        k += 1
    return load > 0.0 or opening > OPENS * size


@kernel
def rate_of(row, y):
    """The rate ``W_o y`` of one row while the object moves with the twist y."""
    rate = 0.0
    for l in range(y.size):
        rate += row[l] * y[l]
    return rate
