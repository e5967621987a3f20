"""Dense output: the state between the ends of a step, in the step's chart.

Each tableau has one of four forms: a cubic through both ends (HERMITE), a polynomial of the slopes
(POLYNOMIAL), DOP853's nested form with further stages (NESTED), and Rodas5P's (QUARTIC).
"""

from __future__ import annotations

from multiarm.dynamics.status import OK
from multiarm.integration.step import add_slopes, combine, slope_at
from multiarm.jit.kernels import clear, copy, inlined, kernel
from multiarm.tableaus import HERMITE, POLYNOMIAL, QUARTIC


@inlined
def weighted_slopes(step, weights, count, h, out):
    """``out = h sum_j weights[j] k[j]`` over the first ``count`` slopes."""
    clear(out)
    add_slopes(step, weights, count, h, out)


@kernel
def prepare_dense(method, step, t, h):
    """Coefficients of the dense output of the last step, whose end slope is ``k[stages]``.

    Returns a status.
    """
    z, new, k, dense = step.z, step.z_new, step.k, step.dense
    copy(z, step.z_old)
    copy(step.base, step.base_old)
    end = method.stages
    if method.dense_kind == POLYNOMIAL:
        for r in range(method.dense.shape[0]):
            weighted_slopes(step, method.dense[r], end + 1, h, dense[r])
        return OK
    if method.dense_kind == QUARTIC:
        for i in range(z.size):
            dense[0, i] = new[i] - z[i]
        for r in range(3):
            weighted_slopes(step, method.dense[r], end, h, dense[1 + r])
        return OK
    for i in range(z.size):
        delta = new[i] - z[i]
        dense[0, i] = delta
        dense[1, i] = h * k[0, i] - delta
        dense[2, i] = 2.0 * delta - h * (k[end, i] + k[0, i])
    if method.dense_kind == HERMITE:
        return OK
    for s in range(end + 1, method.A.shape[0]):
        combine(step, method.A[s], s, h, step.z_stage)
        status = slope_at(step, t + method.c[s] * h, step.z_stage, k[s])
        if status != OK:
            return status
    for r in range(method.dense.shape[0]):
        weighted_slopes(step, method.dense[r], k.shape[0], h, dense[3 + r])
    return OK


@kernel
def interpolate(method, step, theta, out):
    """State at the fraction ``theta`` of the last step, in its chart (``base_old``)."""
    dense = step.dense
    clear(out)
    if method.dense_kind == POLYNOMIAL:
        for r in range(method.dense.shape[0] - 1, -1, -1):
            for i in range(out.size):
                out[i] = theta * (out[i] + dense[r, i])
    elif method.dense_kind == QUARTIC:
        for i in range(out.size):
            bend = dense[1, i] + theta * (dense[2, i] + theta * dense[3, i])
            out[i] = theta * (dense[0, i] + (1.0 - theta) * bend)
    else:
        rows = 3 if method.dense_kind == HERMITE else 3 + method.dense.shape[0]
        for count in range(rows):
            factor = theta if count % 2 == 0 else 1.0 - theta
            for i in range(out.size):
                out[i] = factor * (out[i] + dense[rows - 1 - count, i])
    for i in range(out.size):
        out[i] += step.z_old[i]
