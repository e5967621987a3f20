r"""The contact problem of one instant as plain arrays, compiled.

The laws are those of :mod:`~multiarm.events.complementarity.problem`, all but ``Sliding``: at the
level of impulses and velocities friction has no given direction. With D symmetric and positive
semidefinite and rates b that no forces are needed to reconcile (:math:`b` in the range of D, or a
velocity that opens all contacts) a solution exists, whatever the coefficients of friction (Acary,
Cadoux, Lemarechal, Malick, ZAMM 91, 2011).

**Strategy.** :func:`solve_laws` begins with Newton's method from the given forces: with those of
the step before, two or three steps. Where it cycles, it begins again, from the end of the smoothed
path, from Gauss-Seidel sweeps, and from convex problems with given slips
(:mod:`~multiarm.events.complementarity.smoothing`). Each attempt ends with Newton's method, so that
every solution has the accuracy of rounding. The best point met is returned, with its residual.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from multiarm.events.complementarity.problem import NO_RESPONSE, RESOLVED, ROUNDED_RESIDUAL
from multiarm.events.complementarity.semismooth import (
    NORMAL,
    SINGLE,
    TANGENT,
    Laws,
    NewtonWork,
    gauss_seidel,
    newton,
    rates,
)
from multiarm.events.complementarity.smoothing import follow_path
from multiarm.jit.kernels import (
    INT,
    INTS,
    NUMBERS,
    TABLE,
    allocating,
    copy,
    kernel,
    named_tuple_of,
)

# What a law is.
PUSH, BOUNDED, FRICTION = 0, 1, 2

# Where the attempts of Newton's method begin: at given forces; at the end of the path, along which
# epsilon falls by this factor; or after so many Gauss-Seidel sweeps more. Then the weight r of
# rates, and rho of the proximal point method, beside a response with a diagonal of one.
_GIVEN, _PATH, _SLIPS, _SWEEPS = range(4)
ATTEMPTS = (
    (_GIVEN, 0.0, 1.0, 1e-5),
    (_PATH, 0.1, 1.0, 1e-6),
    (_SWEEPS, 4.0, 1.0, 1e-5),
    (_PATH, 0.3, 1.0, 1e-7),
    (_SWEEPS, 16.0, 0.1, 1e-6),
    *[(_SLIPS, 0.2, 1.0, 1e-6)] * 24,
    (_SWEEPS, 64.0, 1.0, 1e-6),
    (_SWEEPS, 256.0, 0.1, 1e-7),
    (_SWEEPS, 1024.0, 1.0, 1e-6),
)
# Attempts after which a residual that the rounding of dependent rows leaves is not improved on.
THOROUGH = 5
# Convex problems after which the slips of the next are the mean of the last two.
SLIPS_IN_FULL = 6
LAWS: Any = named_tuple_of(Laws, TABLE, TABLE, NUMBERS, NUMBERS, NUMBERS, INTS, NUMBERS)
# Gauss-Seidel has diverged when forces are so many times the scale.
_DIVERGED = 1e8


@allocating
def solve_impulses(D, b, kinds, rows, mu, lower, upper, x):
    """Solve ``y = D x + b`` for impulses and velocities, or forces and accelerations.

    Parameters
    ----------
    D : ndarray, shape (m, m)
        Response of the rows, symmetric and positive semidefinite.
    b : ndarray, shape (m,)
        Rates without these forces.
    kinds : ndarray of int64, shape (k,)
        ``PUSH``, ``BOUNDED`` or ``FRICTION``, for each law.
    rows : ndarray of int64, shape (k, 3)
        Row of each law; of ``FRICTION`` the normal row and two tangents. Every row has one law.
    mu : ndarray, shape (k,)
        Coefficients of ``FRICTION``.
    lower, upper : ndarray, shape (k,)
        Bounds of ``BOUNDED``; may be infinite.
    x : ndarray, shape (m,)
        Where to begin, such as the impulses of the step before; becomes the solution. Of several
        it is one near to where it began.

    Returns
    -------
    residual : float
        Largest violation of any law, as a part of the largest sum of absolute terms in any rate,
        both in rows scaled by the root of their response. About 1e-16 for a solution; more than
        1e-10 where none was found, and ``x`` is the nearest point met. Infinite when D or b are
        not finite; ``x`` is then zero, or the bound nearest to it.
    iterations : int
        Newton steps.
    """
    n = b.size
    scale = np.empty(n)
    _write_scales(D, kinds, rows, scale)
    place = np.empty(n, np.int64)
    G, g, z = np.empty((n, n)), np.empty(n), np.empty(n)
    low, high, coefficient = np.empty(n), np.empty(n), np.zeros(n)
    kind = np.empty(n, np.int64)
    i = 0
    for k in range(kinds.size):
        place[i], kind[i] = rows[k, 0], SINGLE
        s = scale[rows[k, 0]]
        low[i], high[i] = 0.0, math.inf
        if kinds[k] == BOUNDED:
            low[i], high[i] = lower[k] / s, upper[k] / s
        if kinds[k] == FRICTION:
            kind[i], coefficient[i] = NORMAL, mu[k] * s / scale[rows[k, 1]]
            for t in range(1, 3):
                place[i + t], kind[i + t] = rows[k, t], TANGENT
                low[i + t], high[i + t] = -math.inf, math.inf
            i += 2
        i += 1
    for i in range(n):
        s = scale[place[i]]
        g[i] = s * b[place[i]]
        z[i] = x[place[i]] / s
        if not abs(z[i]) < math.inf:
            z[i] = 0.0
        z[i] = min(max(z[i], low[i]), high[i])
        for j in range(n):
            G[i, j] = s * D[place[i], place[j]] * scale[place[j]]
    laws = Laws(G, G, g, low, high, kind, coefficient)
    least, iterations = solve_laws(laws, z, len(ATTEMPTS))
    for i in range(n):
        x[place[i]] = scale[place[i]] * z[i]
    return least, iterations


@allocating
def solve_laws(laws: LAWS, z: NUMBERS, attempts: INT):
    """Independent forces that obey the laws; ``z`` is where to begin and becomes the best found.

    Returns its residual and the number of Newton steps; of ``ATTEMPTS`` so many are made at most.
    """
    n = z.size
    work = NewtonWork(
        np.empty((n, n)),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n, np.int64),
    )
    sweeping, slips, none = np.empty(n), np.zeros(n), -np.ones(n)
    least, iterations, convex = math.inf, 0, 0
    for attempt in range(attempts):
        kind, amount, r, rho = ATTEMPTS[attempt]
        if kind == _GIVEN:
            copy(z, work.z)
        elif kind == _SWEEPS:
            _sweep(laws, int(amount), sweeping, work)
        else:
            iterations += follow_path(laws, amount, slips if kind == _SLIPS else none, work)
        if kind == _SLIPS:
            _follow(laws, 1.0 if convex < SLIPS_IN_FULL else 0.5, slips, work)
            convex += 1
        residual, steps = newton(laws, r, rho, work)
        iterations += steps
        if residual < least or kind == _GIVEN:
            least = residual
            copy(work.best, z)
        if kind == _GIVEN:
            copy(z, sweeping)
        enough = ROUNDED_RESIDUAL if attempt < THOROUGH else RESOLVED
        if least <= enough or (kind == _GIVEN and least == math.inf):
            break
    return least, iterations


@kernel
def _sweep(laws, sweeps, z, work):
    """Gauss-Seidel sweeps of ``z``, from no forces where they diverge; into ``work.z``."""
    gauss_seidel(laws, z, sweeps)
    largest = 0.0
    for i in range(z.size):
        largest = max(largest, abs(z[i]))
    if not largest < _DIVERGED:
        for i in range(z.size):
            z[i] = min(max(0.0, laws.lower[i]), laws.upper[i])
    copy(z, work.z)


@kernel
def _follow(laws, part, slips, work):
    """Move the slips of the convex problem towards those of its solution ``work.z``."""
    rates(laws, work.z, work.w)
    for i in range(slips.size):
        if laws.kind[i] == NORMAL:
            slip = math.hypot(work.w[i + 1], work.w[i + 2])
            if slip < math.inf:
                slips[i] += part * (slip - slips[i])


@kernel
def _write_scales(D, kinds, rows, scale):
    """Write the scales of the rows, see :mod:`~multiarm.events.complementarity.problem`."""
    largest = 0.0
    for i in range(scale.size):
        scale[i] = D[i, i]
    for k in range(kinds.size):
        if kinds[k] == FRICTION:
            first, second = rows[k, 1], rows[k, 2]
            scale[first] = scale[second] = 0.5 * (D[first, first] + D[second, second])
    for i in range(scale.size):
        largest = max(largest, scale[i])
    for i in range(scale.size):
        if not largest > 0.0:
            scale[i] = 1.0
        else:
            response = scale[i] if scale[i] > NO_RESPONSE * largest else largest
            scale[i] = 1.0 / math.sqrt(response)
