r"""User-defined smooth surfaces: a signed distance, or a parametrisation.

The kernel needs of a surface (:class:`multiarm.geometry.records.SmoothShape`) at a point :math:`y`
the signed distance :math:`s` (positive outside of the body), its gradient :math:`n` (the unit
normal) and its second derivatives :math:`H`.

On a parametrised surface :math:`x(u, v)` the foot of the normal through :math:`y` is found by
Newton's method, starting at the last foot, on

.. math:: (y - x)\cdot x_u = (y - x)\cdot x_v = 0 .

  With :math:`J = [x_u\; x_v]`, the fundamental forms
:math:`I = J^T J` and :math:`\mathit{II}_{ab} = n \cdot x_{ab}`, and
:math:`n = \pm x_u\times x_v/|x_u\times x_v|`,

.. math:: s = n\cdot(y - x), \qquad H = -J I^{-1}\mathit{II}\, (I - s \mathit{II})^{-1} J^T .

Derivatives that are not given are computed numerically
(:mod:`multiarm.geometry.numerical_derivatives`); those that are given are compared with numerical
ones once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from copy import copy
from typing import TypeVar

import numpy as np

from multiarm.errors import ModelError
from multiarm.geometry.numerical_derivatives import (
    NumericalDerivatives,
    check_agreement,
    check_certainty,
)
from multiarm.geometry.user_functions import checked, shown

Smooth = TypeVar("Smooth", "SignedDistanceSurface", "ParametricSurface")


class SignedDistanceSurface:
    """A surface given by its signed distance.

    Parameters
    ----------
    distance : callable, f(p) -> float
        Signed distance [m] of a point p (3,) from the surface, positive outside of the body.  It
        must be the distance itself everywhere, not some other function that vanishes on the
        surface.
    gradient, hessian : callable, optional
        g(p) -> (3,) and h(p) -> (3, 3).
    length : float
        Smallest radius of curvature [m], roughly.
    name : str, optional
        For messages.
    """

    def __init__(
        self,
        distance: Callable,
        gradient: Callable | None = None,
        hessian: Callable | None = None,
        length: float = 0.1,
        name: str | None = None,
    ) -> None:
        self.name = name or _name_of(distance)
        self._distance = checked(distance, self.name, "distance", ())
        self._exact_gradient = self._exact_hessian = None
        if gradient is not None:
            self._exact_gradient = checked(gradient, self.name, "gradient", (3,))
        if hessian is not None:
            self._exact_hessian = checked(hessian, self.name, "hessian", (3, 3))
        self._length = length
        self._of_distance = NumericalDerivatives(self._distance, np.full(3, length))
        self._of_gradient = None
        if self._exact_gradient is not None:
            self._of_gradient = NumericalDerivatives(self._exact_gradient, np.full(3, length))
        self._is_checked = False

    @property
    def _used(self) -> list[NumericalDerivatives]:
        if self._of_gradient is None:
            return [self._of_distance]
        return [] if self._exact_hessian is not None else [self._of_gradient]

    def __copy__(self) -> SignedDistanceSurface:
        """The same surface with its own last contact point."""
        twin = _shallow(self)
        twin._of_distance, twin._of_gradient = copy(self._of_distance), copy(self._of_gradient)
        return twin

    def closest(self, point: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Signed distance [m], its gradient (3,) and its second derivatives (3, 3) at a point.

        Raises
        ------
        ModelError
            When a function fails, is not finite, or is not a signed distance.
        """
        point = np.array(point, dtype=float)
        distance = float(self._distance(point))
        if not self._is_checked:
            self._check(point)
        for differences in self._used:
            differences.follow(point)
        gradient = self._gradient(point)
        size = float(np.linalg.norm(gradient))
        if not abs(size - 1.0) <= 1e-6:
            raise ModelError(
                f"{self.name} is not a signed distance: |gradient| = {size:.6g} at {shown(point)}, "
                "which must be 1 wherever the contact goes; give the distance itself, or a "
                "parametrisation of the surface"
            )
        return distance, gradient, self._hessian(point)

    def reset(self) -> None:
        """Check again whether the functions accept complex numbers."""
        for differences in self._used:
            differences.forget()

    def _gradient(self, point: np.ndarray) -> np.ndarray:
        return (self._exact_gradient or self._of_distance.first)(point)

    def _hessian(self, point: np.ndarray) -> np.ndarray:
        return (self._exact_hessian or self._hessian_by_differences)(point)

    def _hessian_by_differences(self, point: np.ndarray) -> np.ndarray:
        if self._of_gradient is None:
            return self._of_distance.second(point)
        hessian = self._of_gradient.first(point)
        return 0.5 * (hessian + hessian.T)

    def _check(self, point: np.ndarray) -> None:
        self._of_distance.probe(point)
        if self._of_gradient is not None:
            self._of_gradient.probe(point)
            error = np.max(np.abs(self._gradient(point) - self._of_distance.first(point)))
            check_agreement(self.name, "gradient", "distance", point, error)
        hessian = self._hessian(point)
        scale = 1.0 / self._length + np.max(np.abs(hessian))
        if self._exact_hessian is not None:
            error = np.max(np.abs(hessian - self._hessian_by_differences(point))) / scale
            check_agreement(self.name, "hessian", "distance", point, error)
        else:
            by = self._of_gradient or self._of_distance
            check_certainty(self.name, by, self._hessian, point, scale)
        self._is_checked = True


class ParametricSurface:
    """A surface given by a parametrisation.

    Parameters
    ----------
    parametrisation : callable, x(u, v) -> (3,)
        Points of the surface [m].  It is also called a little beyond the ranges.
    u, v : pair of float
        Ranges of the parameters.  A parameter is periodic where both ends of its range are the same
        line.
    derivatives : callable, optional
        d(u, v) -> (5, 3): the rows x_u, x_v, x_uu, x_uv, x_vv.
    flip : bool
        ``x_u x x_v`` points into the body.
    length : float
        Smallest radius of curvature [m], roughly.
    name : str, optional
        For messages.

    Raises
    ------
    ModelError
        When a function fails, is not finite, or is not what it is said to be.
    """

    def __init__(
        self,
        parametrisation: Callable,
        u: tuple[float, float],
        v: tuple[float, float],
        derivatives: Callable | None = None,
        flip: bool = False,
        length: float = 0.1,
        name: str | None = None,
    ) -> None:
        self.name = name or _name_of(parametrisation)
        self._low, self._high = np.array([u, v], dtype=float).T
        self._width = self._high - self._low
        self._side = -1.0 if flip else 1.0
        self._length = length
        self._x = checked(parametrisation, self.name, "parametrisation", (3,), spread=True)
        self._exact = None
        if derivatives is not None:
            self._exact = checked(derivatives, self.name, "derivatives", (5, 3), spread=True)
        self._foot: np.ndarray | None = None
        self._second: np.ndarray | None = None  # derivatives x_uu, x_uv, x_vv at the foot
        self._cells, self._points = self._grid()
        self._scale = float(np.max(np.ptp(self._points, axis=0)))
        self._stretch = self._typical_stretch()
        # the parametrisation is called up to 0.12 lengths beyond its ranges
        lengths = np.minimum(length / self._stretch, self._width)
        self._differences = NumericalDerivatives(self._x, lengths)
        self._differences.probe(self._low + 0.43 * self._width)
        self._check()
        self._periodic = self._periodic_parameters()

    def __copy__(self) -> ParametricSurface:
        """The same surface with its own last contact point."""
        twin = _shallow(self)
        twin._differences = copy(self._differences)
        return twin

    def grid(self, cells: int) -> np.ndarray:
        """Points of the surface on an even grid of its parameters, (cells + 1, cells + 1, 3).

        The outward normal is across the first and the second direction, in this order.
        """
        line = np.linspace(0.0, 1.0, cells + 1)
        places = [[self._x(self._low + self._width * np.array([u, v])) for v in line] for u in line]
        points: np.ndarray = np.real(np.array(places))
        return points if self._side > 0.0 else points.transpose(1, 0, 2)

    def closest(self, point: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Signed distance [m], its gradient (3,) and its second derivatives (3, 3) at a point.

        Raises
        ------
        ModelError
            When the foot of the normal is outside of the ranges, or the surface has no normal
            there.
        """
        point = np.array(point, dtype=float)
        foot = self._find_foot(point)
        self._differences.follow(foot)
        r, rows = point - self._x(foot), self._derivatives(foot)
        normal = np.cross(rows[0], rows[1])
        area = math.sqrt(normal @ normal)
        if not area > 1e-9 * self._stretch[0] * self._stretch[1]:
            raise ModelError(
                f"{self.name} has no normal at u = {foot[0]:.6g}, v = {foot[1]:.6g}: dx/du x dx/dv "
                "is zero; keep the contact away from there or choose other parameters"
            )
        normal *= self._side / area
        self._foot, self._second = foot, rows[2:]
        J, distance = rows[:2].T, float(normal @ r)
        L, M, N = rows[2:] @ normal
        form, second = J.T @ J, np.array([[L, M], [M, N]])
        H = -J @ np.linalg.solve(form, second) @ np.linalg.solve(form - distance * second, J.T)
        return distance, normal, H

    def reset(self) -> None:
        """Search the next foot on the whole surface."""
        self._foot = self._second = None
        self._differences.forget()

    def _find_foot(self, point: np.ndarray) -> np.ndarray:
        foot = None
        for start, second in self._starts(point):
            foot = self._newton(point, start, second)
            if foot is not None and self._is_in_range(foot):
                return foot
        where = "" if foot is None else f" (beyond: u = {foot[0]:.6g}, v = {foot[1]:.6g})"
        raise ModelError(
            f"{self.name} has no nearest point to {shown(point)} with u in [{self._low[0]:g}, "
            f"{self._high[0]:g}] and v in [{self._low[1]:g}, {self._high[1]:g}]{where}; the "
            "contact is past the edge, at a centre of curvature or at a pole of the parameters: "
            "extend the ranges, or choose others"
        )

    def _starts(self, point: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray | None]]:
        """The last foot with the second derivatives there, then the nearest points of the grid."""
        if self._foot is not None:
            yield self._foot, self._second
        nearest = np.argsort(np.sum((self._points - point) ** 2, axis=1))[:4]
        for cell in self._cells[nearest]:
            yield cell, None

    def _newton(
        self, point: np.ndarray, w: np.ndarray, second: np.ndarray | None
    ) -> np.ndarray | None:
        """The nearest point of the surface near ``w``, or None where there is none.

        Given second derivatives (3, 3) from nearby, those at each step are not computed.
        """
        r = point - self._x(w)
        for _ in range(40):
            if second is None or self._exact is not None:
                rows = self._derivatives(w)
            else:
                rows = np.concatenate([self._differences.first(w), second])
            (a, b), (_, c) = form = rows[:2] @ rows[:2].T
            L, M, N = rows[2:] @ r
            usual = a * c - b * b
            is_minimum = a > L and (a - L) * (c - N) - (b - M) ** 2 > 1e-9 * usual
            if is_minimum:
                a, b, c = a - L, b - M, c - N
            if not usual > 0.0:
                return None
            g, h = rows[:2] @ r
            step = np.array([c * g - b * h, a * h - b * g]) / (a * c - b * b)
            step /= max(1.0, np.max(np.abs(step) / (0.2 * self._width)))
            moved = math.sqrt(step @ form @ step)
            if moved <= 1e-13 * self._scale:
                return self._kept_near(w + step) if is_minimum else None
            ahead = self._kept_near(w + step)
            r_ahead = point - self._x(ahead)
            for _ in range(8):
                if r_ahead @ r_ahead <= r @ r + 1e-12 * self._scale**2:
                    break
                step *= 0.5
                ahead = self._kept_near(w + step)
                r_ahead = point - self._x(ahead)
            w, r = ahead, r_ahead
        return None

    def _kept_near(self, w: np.ndarray) -> np.ndarray:
        """The parameters clipped near their ranges; periodic ones wrapped into theirs."""
        turns = np.floor((w - self._low) / self._width)
        near = np.clip(w, self._low - 0.05 * self._width, self._high + 0.05 * self._width)
        return np.where(self._periodic, w - turns * self._width, near)

    def _is_in_range(self, w: np.ndarray) -> bool:
        beyond = np.maximum(self._low - w, w - self._high)
        return bool(np.all(beyond <= 1e-9 * self._width))

    def _derivatives(self, w: np.ndarray) -> np.ndarray:
        return self._by_differences(w) if self._exact is None else self._exact(w)

    def _by_differences(self, w: np.ndarray) -> np.ndarray:
        first, second = self._differences.first(w), self._differences.second(w)
        return np.array([first[0], first[1], second[0, 0], second[0, 1], second[1, 1]])

    def _grid(self, count: int = 24) -> tuple[np.ndarray, np.ndarray]:
        fractions = (np.arange(count) + 0.5) / count
        u, v = np.meshgrid(fractions, fractions, indexing="ij")
        cells = self._low + self._width * np.column_stack([u.ravel(), v.ravel()])
        return cells, np.array([self._x(w) for w in cells])

    def _typical_stretch(self) -> np.ndarray:
        """Mean length of ``x_u`` and ``x_v`` [m per unit], between cells of the grid."""
        count = round(np.sqrt(len(self._points)))
        points = self._points.reshape(count, count, 3)
        sizes = [np.linalg.norm(np.diff(points, axis=axis), axis=2).mean() for axis in (0, 1)]
        stretch = np.array(sizes) * count / self._width
        if not np.all(stretch > 0.0):
            raise ModelError(
                f"{self.name} is not a surface: its points do not depend on "
                f"{'u' if stretch[0] == 0.0 else 'v'}"
            )
        return stretch

    def _check(self) -> None:
        a, b = self._stretch
        scales = np.array([a, b, *(np.array([a * a, a * b, b * b]) / self._length)])[:, None]
        for fractions in ((0.31, 0.42), (0.57, 0.73), (0.83, 0.19)):
            w = self._low + fractions * self._width
            derivatives = self._derivatives(w) / scales
            size = 1.0 + float(np.max(np.abs(derivatives)))
            if self._exact is None:
                check_certainty(
                    self.name, self._differences, lambda w: self._derivatives(w) / scales, w, size
                )
            else:
                error = float(np.max(np.abs(derivatives - self._by_differences(w) / scales))) / size
                check_agreement(self.name, "derivatives", "parametrisation", w, error)

    def _periodic_parameters(self) -> np.ndarray:
        """Which of the two parameters join both ends of their range smoothly."""
        periodic = []
        for axis in (0, 1):
            gaps = []
            for fraction in (0.13, 0.37, 0.71):
                low = self._low + fraction * self._width
                high = low.copy()
                low[axis], high[axis] = self._low[axis], self._high[axis]
                gap = np.abs(self._x(low) - self._x(high)) / self._scale
                kink = np.abs(self._derivatives(low) - self._derivatives(high))[axis]
                gaps += [np.max(gap), np.max(kink) / self._stretch[axis]]
            periodic.append(max(gaps) < 1e-6)
        return np.array(periodic)


def _name_of(function: Callable) -> str:
    name = getattr(function, "__qualname__", type(function).__qualname__)
    return f"the surface {name!r}"


def _shallow(surface: Smooth) -> Smooth:
    twin = object.__new__(type(surface))
    vars(twin).update(vars(surface))
    return twin
