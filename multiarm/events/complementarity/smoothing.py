r"""Smoothed contact laws, and the path along which they become exact; compiled.

The natural map of :mod:`~multiarm.events.complementarity.semismooth` has kinks, between which
Newton's method may run in circles. With the smoothed projections

.. math:: P_\epsilon(p) = \tfrac12 \left(p + \sqrt{p^2 + 4 \epsilon^2}\right)
          \quad\Leftrightarrow\quad x > 0,\; y > 0,\; x y = \epsilon^2
          \quad\text{where}\quad x = P_\epsilon(x - y)

it has none, and its solutions are a path, the central path of interior point methods, which ends in
the interior of the set of solutions: forces of redundant contacts far from all bounds. Friction
follows from de Saxcé's change of variables, which makes the law of Coulomb one of complementarity
between a cone and its dual,

.. math:: K \ni \begin{pmatrix} \mu x_n \\ x_t \end{pmatrix} \perp
          \begin{pmatrix} y_n / \mu + s \\ y_t \end{pmatrix} \in K, \qquad s = |y_t|,
          \qquad K = \{|v_t| \le v_n\},

and :math:`P_\epsilon` is applied to the eigenvalues :math:`v_n \pm |v_t|` of the Jordan algebra of
K (Fukushima, Luo, Tseng, "Smoothing functions for second-order-cone complementarity problems",
SIAM J. Optim. 12, 2002).

With slips s that are given, the problem is convex (without sliding friction): the path exists and
Newton's method with a line search follows it. Fixed points of s -> :math:`|y_t|` are the solutions
(Acary, Cadoux, Lemarechal, Malick, "A formulation of the linear discrete Coulomb friction problem
via convex optimization", ZAMM 91, 2011; de Saxcé, Feng, Math. Comput. Modelling 28, 1998). With
:math:`s = |y_t|` among the equations the path costs no iterations around it, but it may turn back.
"""

from __future__ import annotations

import math

from multiarm.events.complementarity.semismooth import NORMAL, TANGENT, rates, solve_linear
from multiarm.jit.kernels import copy, inlined, kernel

# Where the path ends, as a part of where it begins.
END = 1e-9
# Newton steps at one point of the path, and halvings of a step.
STEPS, HALVINGS = 8, 6
# A point of the path is reached when the equations hold to this part of epsilon; the path is left
# when they do not hold to the other.
REACHED, LEFT = 0.3, 10.0


@kernel
def follow_path(laws, factor, slips, work):
    """Write the end of the path into ``work.z``, from no forces; returns the steps.

    Epsilon falls by ``factor``. Slips, by normal forces (n,), are given where ``slips[0]`` is not
    negative.
    """
    z, start, step = work.z, work.best, work.right
    n, first = z.size, 0.0
    for i in range(n):
        first = max(first, abs(laws.g[i]))
        z[i] = min(max(0.0, laws.lower[i]), laws.upper[i])
    for i in range(n):
        if laws.kind[i] == NORMAL:
            z[i] = first
    epsilon, size, part = first, math.inf, 0.0
    steps = here = 0
    while epsilon > END * first:
        now = _equations(laws, epsilon, slips, work)
        if part > 0.5**HALVINGS and not now < (1.0 - 0.1 * part) * size:
            part *= 0.5
            for i in range(n):
                z[i] = start[i] + part * step[i]
            continue
        if now < REACHED * epsilon or here == STEPS:
            if now > LEFT * epsilon:
                break
            epsilon *= factor
            here, part = 0, 0.0
            continue
        if not now < math.inf or not solve_linear(work.A, work.step, n):
            break
        steps, here, size, part = steps + 1, here + 1, now, 1.0
        copy(z, start)
        copy(work.step, step)
        for i in range(n):
            z[i] = start[i] + step[i]
    return steps


@kernel
def _equations(laws, epsilon, slips, work):
    """Write minus the smoothed natural map into ``work.step``, its derivative; returns its norm."""
    z, w, A, value = work.z, work.w, work.A, work.step
    rates(laws, z, w)
    for i in range(z.size):
        if laws.kind[i] == TANGENT:
            continue
        if laws.kind[i] == NORMAL and laws.mu[i] > 0.0:
            _cone(laws, i, epsilon, slips, work)
            continue
        p = z[i] - w[i]
        projected, slope = _between(p, laws.lower[i], laws.upper[i], epsilon)
        value[i] = projected - z[i]
        for j in range(z.size):
            A[i, j] = slope * laws.G[i, j]
        A[i, i] += 1.0 - slope
        if laws.kind[i] == NORMAL:
            for k in range(i + 1, i + 3):
                value[k] = -z[k]
                for j in range(z.size):
                    A[k, j] = 1.0 if j == k else 0.0
    square = 0.0
    for i in range(z.size):
        square += value[i] * value[i]
    return math.sqrt(square)


@inlined
def _cone(laws, i, epsilon, slips, work):
    """The three equations of a contact with friction."""
    z, w, A, value, mu = work.z, work.w, work.A, work.step, laws.mu[i]
    slip, s1, s2 = slips[i], 0.0, 0.0
    if slips[0] < 0.0:
        slip = math.sqrt(w[i + 1] ** 2 + w[i + 2] ** 2 + epsilon * epsilon)
        s1, s2 = w[i + 1] / slip, w[i + 2] / slip
    u, u1, u2 = mu * z[i] - w[i] / mu - slip, z[i + 1] - w[i + 1], z[i + 2] - w[i + 2]
    length = math.hypot(u1, u2)
    d1, d2 = (u1 / length, u2 / length) if length > 0.0 else (1.0, 0.0)
    high, high_slope = _positive(u + length, epsilon)
    low, low_slope = _positive(u - length, epsilon)
    half = 0.5 * (high - low)
    value[i] = 0.5 * (high + low) - mu * z[i]
    value[i + 1], value[i + 2] = half * d1 - z[i + 1], half * d2 - z[i + 2]
    b, c = 0.5 * (high_slope + low_slope), 0.5 * (high_slope - low_slope)
    a = half / length if length > 1e-12 * (abs(u) + epsilon) else b
    for j in range(z.size):
        g1, g2 = laws.G[i + 1, j], laws.G[i + 2, j]
        du, du1, du2 = -laws.G[i, j] / mu - s1 * g1 - s2 * g2, -g1, -g2
        if j == i:
            du += mu
        elif j == i + 1:
            du1 += 1.0
        elif j == i + 2:
            du2 += 1.0
        along = d1 * du1 + d2 * du2
        radial = c * du + (b - a) * along
        A[i, j] = -(b * du + c * along)
        A[i + 1, j] = -(d1 * radial + a * du1)
        A[i + 2, j] = -(d2 * radial + a * du2)
    A[i, i] += mu
    A[i + 1, i + 1] += 1.0
    A[i + 2, i + 2] += 1.0


@inlined
def _between(p, lower, upper, epsilon):
    """Smoothed projection between bounds, and its slope."""
    if lower == -math.inf and upper == math.inf:
        return p, 1.0
    if upper == math.inf:
        above, slope = _positive(p - lower, epsilon)
        return lower + above, slope
    if lower == -math.inf:
        below, slope = _positive(upper - p, epsilon)
        return upper - below, slope
    if not upper > lower:
        return lower, 0.0
    narrow = min(epsilon, 0.25 * (upper - lower))
    above, rises = _positive(p - lower, narrow)
    beyond, falls = _positive(p - upper, narrow)
    return lower + above - beyond, rises - falls


@inlined
def _positive(p, epsilon):
    """Smoothed ``max(p, 0)``, and its slope."""
    root = math.sqrt(p * p + 4.0 * epsilon * epsilon)
    if p >= 0.0:
        return 0.5 * (p + root), 0.5 * (1.0 + p / root)
    value = 2.0 * epsilon * epsilon / (root - p)
    return value, value / root
