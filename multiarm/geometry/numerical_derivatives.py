r"""Numerical derivatives of functions of users, and checks of those that they give.

Derivatives that are not given are computed with complex numbers where a function accepts them, else
by central differences.  The first derivative is then free of cancellation,

.. math:: f'(x) = \operatorname{Im} f(x + i h) / h + O(h^2), \qquad h = 10^{-30},

(W. Squire and G. Trapp, Using complex variables to estimate derivatives, SIAM Review 40, 1998), and
a second one is a mean over 8 points around x, conjugate in pairs,

.. math:: f''(x) = \frac{1}{2\rho^2} \sum_{k=1}^4
          \operatorname{Re}\left(f(x + \rho e^{i\theta_k}) e^{-2 i \theta_k}\right) + O(\rho^8),
          \qquad \theta_k = (2k - 1)\,\pi / 8 .

Central differences combine values at :math:`x \pm k h, k = 1..4`, with an error of order
:math:`h^8` too.
"""

from __future__ import annotations

import threading
import warnings

import numpy as np

from multiarm.errors import USER_FAULTS, ModelError
from multiarm.geometry.user_functions import UserFunction, shown

# Central differences of order 8, and the mean over a circle; steps and radius are fractions of the
# function's length scale.  Rounding errors weigh more in a second derivative.
_FIRST, _FIRST_STEP = (4 / 5, -1 / 5, 4 / 105, -1 / 280), 0.02
_SECOND, _CENTRE, _SECOND_STEP = (8 / 5, -1 / 5, 8 / 315, -1 / 560), -205 / 72, 0.03
_COMPLEX_STEP = 1e-30
_CIRCLE, _RADIUS = np.exp(1j * np.pi * np.array([1, 3, 5, 7]) / 8), 0.04
_MEAN = _CIRCLE**-2 / (2.0 * _RADIUS**2)
_PROBING = threading.Lock()


def check_agreement(name: str, role: str, of: str, x: np.ndarray, error: float) -> None:
    """Raise a ModelError for given derivatives that are not those of the function.

    ``error`` is relative to the largest derivative there may be.
    """
    if not error <= 1e-5:
        raise ModelError(
            f"the {role} of {name} disagrees with differences of its {of} by {error:.1e} "
            f"(relative) at {shown(x)}; correct it or leave it out (differences need a 'length' "
            "near the smallest radius of curvature)"
        )


def check_certainty(
    name: str,
    differences: NumericalDerivatives,
    derivative: UserFunction,
    x: np.ndarray,
    scale: float,
) -> None:
    """Raise a ModelError where halving the steps of the differences changes the derivatives."""
    coarse, lengths = derivative(x), differences.lengths
    differences.lengths = 0.5 * lengths  # in place, it would be that of all threads
    try:
        error = float(np.max(np.abs(derivative(x) - coarse))) / scale
    finally:
        differences.lengths = lengths
    if not error <= 1e-7:
        raise ModelError(
            f"differences of {name} are uncertain by {error:.1e} (relative) at {shown(x)}; set "
            "'length' to its smallest radius of curvature, or give its derivatives; it must be "
            "smooth"
        )


class NumericalDerivatives:
    """First and second derivatives of a function of ``n`` variables with ``m`` values.

    Parameters
    ----------
    function : callable, (n,) -> (m,)
        Of an array, which may be complex if the function accepts it.
    lengths : array-like, shape (n,)
        Length scale of the function in each variable; steps are a fraction of it.
    """

    def __init__(self, function: UserFunction, lengths: np.ndarray) -> None:
        self.function = function
        self.lengths = np.array(lengths, dtype=float)
        self.takes_complex = False
        self._probed_at: np.ndarray | None = None

    def probe(self, x: np.ndarray) -> None:
        """Determine, at a point (n,), whether the function accepts complex numbers."""
        self.takes_complex = False
        first, second = self._first(x), self._second(x)
        self.takes_complex = True
        # all threads share the warning filters
        with _PROBING, warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                errors = self._first(x) - first, self._second(x) - second
            except USER_FAULTS:  # the function was not written for complex numbers
                self.takes_complex = False
                return
        lengths = self.lengths.reshape(-1, *(1,) * (first.ndim - 1))
        size = np.max(np.abs(first) * lengths)
        wrong = np.max(np.abs(errors[0]) * lengths)
        wrong += np.max(np.abs(errors[1]) * np.multiply.outer(self.lengths, lengths))
        # one that takes an absolute value on the way does not agree with differences
        self.takes_complex = bool(wrong <= 1e-6 * size)

    def follow(self, x: np.ndarray) -> None:
        """Probe again a quarter of the length scale away from the last probe.

        The function may have branches, one of which takes an absolute value.
        """
        at = self._probed_at
        if at is None or (self.takes_complex and np.max(np.abs(x - at) / self.lengths) > 0.25):
            self.probe(x)
            self._probed_at = np.array(x)

    def forget(self) -> None:
        """Probe again at the next point."""
        self._probed_at = None

    def first(self, x: np.ndarray) -> np.ndarray:
        """Derivatives by each variable, shape (n, m)."""
        return self._derive(self._first, x)

    def second(self, x: np.ndarray) -> np.ndarray:
        """Second derivatives, shape (n, n, m)."""
        return self._derive(self._second, x)

    def _derive(self, derive: UserFunction, x: np.ndarray) -> np.ndarray:
        """Without complex numbers where the function turns out to drop imaginary parts."""
        try:
            return derive(x)
        except _RealError:
            self.takes_complex = False
            return derive(x)

    def _first(self, x: np.ndarray) -> np.ndarray:
        if self.takes_complex:
            places = x + 1j * _COMPLEX_STEP * np.eye(x.size)
            return _complex(np.array([self.function(at) for at in places])).imag / _COMPLEX_STEP
        rows = []
        for step, way in zip(_FIRST_STEP * self.lengths, np.eye(x.size), strict=True):
            terms = (
                weight * (self.function(x + k * step * way) - self.function(x - k * step * way))
                for k, weight in enumerate(_FIRST, start=1)
            )
            rows.append(sum(terms) / step)
        return np.array(rows)

    def _second(self, x: np.ndarray) -> np.ndarray:
        """Second derivatives.

        They are those along the axes and along their diagonals, from which follow the mixed ones.
        """
        n, ways = x.size, np.diag(self.lengths)
        centre = None if self.takes_complex else self.function(x)
        second = [self._along(x, way, centre) for way in ways]
        scaled = np.empty((n, n, *np.shape(second[0])))
        for i in range(n):
            scaled[i, i] = second[i]
            for j in range(i):
                diagonal = self._along(x, np.sqrt(0.5) * (ways[i] + ways[j]), centre)
                scaled[i, j] = scaled[j, i] = diagonal - 0.5 * (second[i] + second[j])
        lengths = np.multiply.outer(self.lengths, self.lengths)
        return scaled / lengths.reshape(n, n, *(1,) * (scaled.ndim - 2))

    def _along(self, x: np.ndarray, way: np.ndarray, centre: np.ndarray | None) -> np.ndarray:
        """Second derivative along a line, per length of ``way``."""
        if centre is None:
            places = x + np.multiply.outer(_RADIUS * _CIRCLE, way)
            values = _complex(np.array([self.function(at) for at in places]))
            return np.tensordot(_MEAN, values, 1).real
        way = _SECOND_STEP * way
        pairs = (
            weight * (self.function(x + k * way) + self.function(x - k * way))
            for k, weight in enumerate(_SECOND, start=1)
        )
        return (sum(pairs) + _CENTRE * centre) / _SECOND_STEP**2


class _RealError(TypeError):
    """A function returned real values for complex arguments."""


def _complex(values: np.ndarray) -> np.ndarray:
    if values.dtype.kind != "c":
        raise _RealError("the function drops imaginary parts")
    return values
