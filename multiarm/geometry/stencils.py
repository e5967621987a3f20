r"""Differences that kernels take: where they need values, and with which weights.

.. math:: f'(x) \approx \frac1h \sum_k w_k\, (f(x + o_k h) - f(x)) .
"""

from __future__ import annotations

from typing import NamedTuple


class Stencil(NamedTuple):
    """Where a difference takes values, and their weights."""

    offsets: tuple[float, ...]  # in steps h
    weights: tuple[float, ...]  # times h


# With errors of order h, h^2 and h^4.
FORWARD_1 = Stencil((1.0,), (1.0,))
FORWARD_2 = Stencil((1.0, 2.0), (2.0, -0.5))
CENTRAL_4 = Stencil((-2.0, -1.0, 1.0, 2.0), (1.0 / 12.0, -2.0 / 3.0, 2.0 / 3.0, -1.0 / 12.0))
