r"""Newton's method and Gauss-Seidel sweeps for the contact laws, compiled.

The laws hold where the natural map is zero,

.. math:: \Phi(z) = z - P(z - w(z)), \qquad w = G z + g,

P the projection on bounds and on the disk :math:`|z_t| \le \mu z_n` of each contact.

**Newton.** With any :math:`r > 0` the argument :math:`p = z - r w` gives the mode of every law. The
equation of that mode is linear (open: z = bound; closed, sticking: w = 0) or, for a contact that
begins to slip in a direction not yet known, smooth:

.. math:: z_t = \mu p_n d, \qquad d = p_t / |p_t|, \qquad
          \delta d = \frac{1 - d d^T}{|p_t|} \, \delta p_t .

A step solves the equations of the present modes. Once the modes are right it is exact, or converges
quadratically (Alart and Curnier, CMAME 92, 1991).

**Redundant contacts** make these equations singular. Each step is therefore one of the proximal
point method (Rockafellar, SIAM J. Control Optim. 14, 1976): :math:`G + \rho I` takes the place of
G, and :math:`g - \rho z_k` that of g, with :math:`z_k` the forces before the step. Where the
iteration ends nothing of :math:`\rho` is left in the equations; of all forces that give the same
motion it finds some near to those where it began. A small :math:`\rho` takes fewer steps where
responses are nearly singular; a large one lets less of the rounding into forces that move nothing.

**Gauss-Seidel.** One law after the other is solved exactly, the other forces as they are: the
normal force, then the friction that minimises :math:`x^T A x / 2 + q^T x` on its disk. Slow but
steady, it leads Newton's method out of a cycle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from multiarm.events.complementarity.problem import GROWN, ROUNDED_RESIDUAL
from multiarm.jit.kernels import clear, copy, inlined, kernel
from multiarm.jit.structs import Floats1, Floats2, Ints1

# What an independent force is.
SINGLE, NORMAL, TANGENT = 0, 1, 2

# Newton steps from one start, and those that may go by without progress.
STEPS, IDLE_STEPS = 25, 8
# Residuals below this do not get smaller.
LEAST_RESIDUAL = 1e-14
# Responses below this are none.
_NONE = 1e-14


class Laws(NamedTuple):
    """A scaled problem of n independent forces, see :mod:`~.complementarity.problem`.

    The two tangents of a contact with friction at zero slip follow its normal force.
    """

    G: Floats2  # (n, n)
    terms: Floats2  # (n, n), sums of the absolute terms of G, or G itself
    g: Floats1
    lower: Floats1
    upper: Floats1
    kind: Ints1  # SINGLE, NORMAL or TANGENT
    mu: Floats1  # of normal forces


class NewtonWork(NamedTuple):
    """Arrays of Newton's method."""

    A: Floats2  # (n, n)
    step: Floats1
    row: Floats1
    right: Floats1
    w: Floats1
    z: Floats1
    best: Floats1
    free: Ints1  # forces that are not at a bound


@kernel
def rates(laws, z, w):
    """Write ``w = G z + g``; returns the scale, see ``Problem.size``."""
    size, free = 0.0, 0.0
    for i in range(z.size):
        rate, terms = laws.g[i], abs(laws.g[i])
        free = max(free, terms)
        for j in range(z.size):
            rate += laws.G[i, j] * z[j]
            terms += abs(laws.terms[i, j]) * abs(z[j])
        w[i] = rate
        size = max(size, terms)
    return min(size, GROWN * free) if free > 0.0 else size


@kernel
def residual(laws, z, w):
    """Largest entry of the natural map, as a part of the scale; writes the rates ``w``.

    Infinite where a number is not finite.
    """
    size, worst = rates(laws, z, w), 0.0
    for i in range(z.size):
        if laws.kind[i] == TANGENT:
            continue
        p = z[i] - w[i]
        worst = max(worst, abs(z[i] - min(max(p, laws.lower[i]), laws.upper[i])))
        if not abs(p) < math.inf:
            return math.inf
        if laws.kind[i] == NORMAL:
            radius = laws.mu[i] * max(z[i], 0.0)
            p1, p2 = z[i + 1] - w[i + 1], z[i + 2] - w[i + 2]
            length = math.hypot(p1, p2)
            if not length < math.inf:
                return math.inf
            part = radius / length if length > radius else 1.0
            worst = max(worst, abs(z[i + 1] - part * p1), abs(z[i + 2] - part * p2))
    return worst / size if size > 0.0 else 0.0


@kernel
def newton(laws, r, rho, work):
    """Steps from ``work.z``; ``work.best`` is the best point met.

    Returns its residual and the number of steps.
    """
    z, best = work.z, work.best
    copy(z, best)
    least = progress = math.inf
    idle = steps = 0
    while True:
        now = residual(laws, z, work.w)
        settled = now <= ROUNDED_RESIDUAL and now >= 0.1 * least
        idle = 0 if now < 0.9 * progress else idle + 1
        progress = min(progress, now)
        if now < least:
            least = now
            copy(z, best)
        if settled or now == math.inf or least <= LEAST_RESIDUAL:
            break
        if idle > IDLE_STEPS or steps == STEPS or not _newton_step(laws, r, rho, work):
            break
        steps += 1
        for i in range(z.size):
            z[i] += work.step[i]
    return least, steps


@kernel
def _newton_step(laws, r, rho, work):
    """Write the step of the equations of the present modes; False where they are singular."""
    z, w, step, row, right = work.z, work.w, work.step, work.row, work.right
    free = _set_to_bounds(laws, r, work)
    # of the contact whose tangents are at hand
    slips, radius, d1, d2, turn = False, 0.0, 0.0, 0.0, 0.0
    for k in range(free):
        i = work.free[k]
        first = laws.kind[i] == TANGENT and laws.kind[i - 1] == NORMAL
        if first or laws.kind[i] != TANGENT:
            slips = False
        if first:
            p1, p2 = z[i] - r * w[i], z[i + 1] - r * w[i + 1]
            length = math.hypot(p1, p2)
            radius = laws.mu[i - 1] * max(z[i - 1] - r * w[i - 1], 0.0)
            slips = length > radius
            if slips:
                d1, d2, turn = p1 / length, p2 / length, radius / length
        if slips:
            side = 0 if first else 1
            _slip_row(laws, r, rho, i - 1 - side, side, d1, d2, turn, row)
            right[k] = radius * (d1 if first else d2) - z[i]
        else:
            for j in range(z.size):
                row[j] = laws.G[i, j]
            row[i] += rho
            right[k] = -w[i]
        _reduce(row, step, work.free, free, k, work.A, right)
    if not solve_linear(work.A, right, free):
        return False
    for k in range(free):
        step[work.free[k]] = right[k]
    return True


@inlined
def _set_to_bounds(laws, r, work):
    """Write the steps of forces that go to a bound; returns how many others there are."""
    z, w, step, free = work.z, work.w, work.step, 0
    clear(step)
    for i in range(z.size):
        if laws.kind[i] == TANGENT:
            continue
        p = z[i] - r * w[i]
        if p <= laws.lower[i]:
            step[i] = laws.lower[i] - z[i]
        elif p >= laws.upper[i]:
            step[i] = laws.upper[i] - z[i]
        else:
            work.free[free] = i
            free += 1
        if laws.kind[i] == NORMAL:
            if laws.mu[i] * max(p, 0.0) == 0.0:
                step[i + 1], step[i + 2] = -z[i + 1], -z[i + 2]
            else:
                work.free[free], work.free[free + 1] = i + 1, i + 2
                free += 2
    return free


@inlined
def _slip_row(laws, r, rho, n, side, d1, d2, turn, row):
    """Write the derivative of one tangent's equation, the direction of slip among the unknowns."""
    along, across = (d1, -d2) if side == 0 else (d2, d1)
    response = laws.G
    for j in range(row.size):
        across_j = d1 * response[n + 2, j] - d2 * response[n + 1, j]
        row[j] = r * (laws.mu[n] * along * response[n, j] + turn * across * across_j)
    own = 1.0 - r * rho
    row[n] -= laws.mu[n] * along * own
    row[n + 1] += turn * across * d2 * own
    row[n + 2] -= turn * across * d1 * own
    row[n + 1 + side] += 1.0


@inlined
def _reduce(row, step, columns, free, k, A, right):
    """Write row k of the equations of the free forces; the steps of the others are known."""
    for j in range(row.size):
        if step[j] != 0.0:
            right[k] -= row[j] * step[j]
    for m in range(free):
        A[k, m] = row[columns[m]]


@kernel
def solve_linear(A, x, n):
    """Solve ``A x = b`` with ``A[:n, :n]`` by pivoting, ``x`` is b before; False if singular."""
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if not abs(A[pivot, k]) > 0.0:
            return False
        if pivot != k:
            for j in range(k, n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            x[k], x[pivot] = x[pivot], x[k]
        inverse = 1.0 / A[k, k]
        for i in range(k + 1, n):
            factor = A[i, k] * inverse
            if factor != 0.0:
                for j in range(k + 1, n):
                    A[i, j] -= factor * A[k, j]
                x[i] -= factor * x[k]
    for i in range(n - 1, -1, -1):
        rest = x[i]
        for j in range(i + 1, n):
            rest -= A[i, j] * x[j]
        x[i] = rest / A[i, i]
    return True


@kernel
def gauss_seidel(laws, z, sweeps):
    """One law after the other solved exactly, ``sweeps`` times."""
    G = laws.G
    for _ in range(sweeps):
        for i in range(z.size):
            if laws.kind[i] == TANGENT:
                continue
            if G[i, i] > _NONE:
                rate = laws.g[i]
                for j in range(z.size):
                    rate += G[i, j] * z[j]
                z[i] = min(max(z[i] - rate / G[i, i], laws.lower[i]), laws.upper[i])
            if laws.kind[i] == NORMAL:
                q1, q2 = laws.g[i + 1], laws.g[i + 2]
                for j in range(z.size):
                    if j != i + 1 and j != i + 2:
                        q1 += G[i + 1, j] * z[j]
                        q2 += G[i + 2, j] * z[j]
                radius = laws.mu[i] * max(z[i], 0.0)
                z[i + 1], z[i + 2] = _least_on_disk(
                    G[i + 1, i + 1],
                    G[i + 1, i + 2],
                    G[i + 2, i + 2],
                    q1,
                    q2,
                    radius,
                    z[i + 1],
                    z[i + 2],
                )


@kernel
def _least_on_disk(a, b, c, q1, q2, radius, x1, x2):
    """Minimise ``x^T [[a, b], [b, c]] x / 2 + q^T x`` where ``|x| <= radius``; from ``x``."""
    mean, half = 0.5 * (a + c), math.hypot(0.5 * (a - c), b)
    large, small = mean + half, mean - half
    if radius == 0.0:
        return 0.0, 0.0
    if not large > _NONE:
        length = math.hypot(x1, x2)
        part = radius / length if length > radius else 1.0
        return part * x1, part * x2
    # along the axes of the ellipse
    v1, v2 = (a - small, b) if abs(a - small) > abs(c - small) else (b, c - small)
    length = math.hypot(v1, v2)
    v1, v2 = (v1 / length, v2 / length) if length > 0.0 else (1.0, 0.0)
    k1, k2 = v1 * q1 + v2 * q2, v1 * q2 - v2 * q1
    inside = small > 1e-12 * large and math.hypot(k1 / large, k2 / small) <= radius
    # the multiplier t of |x| = radius, where 1 / |x| is nearly linear
    t = 0.0 if inside else max(math.hypot(k1, k2) / radius - large, 0.0)
    for _ in range(30):
        y1 = k1 / (large + t)
        y2 = k2 / (small + t) if small + t > 0.0 else 0.0
        size = math.hypot(y1, y2)
        if inside or size == 0.0:
            break
        fall = y1 * y1 / (large + t) + (y2 * y2 / (small + t) if small + t > 0.0 else 0.0)
        change = (size - radius) / radius * size * size / fall
        t = max(t + change, 0.0)
        if abs(change) <= 1e-15 * (t + large):
            break
    y1 = -k1 / (large + t)
    y2 = -k2 / (small + t) if small + t > 0.0 else 0.0
    size = math.hypot(y1, y2)
    part = radius / size if size > radius else 1.0
    return part * (v1 * y1 - v2 * y2), part * (v2 * y1 + v1 * y2)
