r"""Tables over time whose columns are polynomials between the rows.

Between two rows :math:`t_s \le t < t_{s+1}` a column is
:math:`y(t) = \sum_{k=0}^{D} a_{sk}\,(t - t_s)^{D - k}`.
"""

from __future__ import annotations

from multiarm.jit.kernels import inlined, kernel


@kernel
def row_at(times, t):
    """The last row whose time is not after ``t``, by bisection; -1 before the first one."""
    low, high = -1, times.size - 1
    while low < high:
        middle = (low + high + 1) // 2
        if times[middle] <= t:
            low = middle
        else:
            high = middle - 1
    return low


@inlined
def segment_at(bounds, t):
    """The segment of a path at ``t``, or the nearest; ``bounds`` (S + 1,) are where they meet."""
    return min(max(row_at(bounds, t), 0), bounds.size - 2)


@inlined
def polynomial(coefficients, x):
    """Value and rate of a polynomial, highest power first."""
    value = rate = 0.0
    for k in range(coefficients.size):
        rate = rate * x + value
        value = value * x + coefficients[k]
    return value, rate
