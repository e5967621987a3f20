r"""The gradient of a scalar of a run, by the adjoint equation.

For :math:`J = \Phi(x(T)) + \int \ell(t, x)\,dt` along the run, and its variational equation
:math:`\dot\delta = A\delta + B\,\delta\tau + \beta\,\delta p`,

.. math::
    -\dot\mu = A^T \mu + \nabla\ell, \qquad \mu(T) = \nabla\Phi, \qquad
    dJ = \mu(0)\cdot\delta(0) + \int \mu^T (B\,\delta\tau + \beta\,\delta p)\,dt .

So one solution, backward in time, gives the derivatives by the whole start, by any number of
parameters, and by torques at all times, whose density is :math:`B^T\mu`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from multiarm.control.recorded import DEGREES, polynomials
from multiarm.dynamics.sensitivity import Sensitivity
from multiarm.dynamics.state import State, checked_vector
from multiarm.dynamics.system import System, require_system, require_time
from multiarm.errors import ModelError
from multiarm.gradients.along import RICHARDSON, TINY, Along, Panel
from multiarm.gradients.collocation import WEIGHTS
from multiarm.gradients.variation import displaced, state_columns
from multiarm.public import facts_html, public_names
from multiarm.results.trajectory import Trajectory
from multiarm.scene.faults import shown, unknown
from multiarm.simulation.setup import increasing_times, positive
from multiarm.terminal.progress import Progress, Report, displayed

__all__ = ["Gradient", "gradient"]

Scalar = Callable[[float, State], "float | tuple[float, ArrayLike]"]
# Displacement of a difference of a user's function.
DISPLACEMENT = 1e-5


@dataclass(frozen=True, repr=False)
class Gradient:
    """A scalar of a run, and its derivatives.

    Attributes
    ----------
    value : float
    start : Sensitivity
        By a displacement of the start: ``start.d_joint_velocities["left"]``, shape (n_i,).  Only
        the part along displacements that keep the joints closed.
    parameters : mapping str -> float
        By numbers of the scene, as they were named.
    trajectory : Trajectory
        The run, sampled where derivatives were taken.
    error : float
        Estimated error of the derivatives along this run, relative to the largest.
    times : ndarray, shape (K,)
        Nodes of a quadrature over the run [s], with ``weights`` (K,) [s].
    torque_density : ndarray, shape (K, n)
        By torques that act on the joints at these times, for a second.
    """

    value: float
    start: Sensitivity
    parameters: Mapping[str, float]
    trajectory: Trajectory
    error: float
    times: np.ndarray
    weights: np.ndarray
    torque_density: np.ndarray

    __dir__ = public_names

    def __repr__(self) -> str:
        parts = ", ".join(f"{path}: {number:.6g}" for path, number in self.parameters.items())
        return f"Gradient(value {self.value:.9g}; {parts or 'by start and torques'})"

    def _repr_html_(self) -> str:
        facts: dict[str, object] = {"value": f"{self.value:.9g}"}
        facts |= {path: f"{number:.6g}" for path, number in self.parameters.items()}
        return facts_html("Gradient", facts | {"estimated error": f"{self.error:.1e}"})

    def by_torque_table(
        self, times: ArrayLike, interpolation: str = "linear"
    ) -> dict[str, np.ndarray]:
        """Derivatives by the rows of a table of torques that are added to the joints.

        Parameters
        ----------
        times : array-like, shape (r,)
            Of the rows [s].  The torques are zero before the first and after the last.
        interpolation : {"linear", "cubic", "hold"}
            Between them.  The quadrature is exact to ``error`` where the run's own control has rows
            at these times, as kinks must not lie inside of its panels.

        Returns
        -------
        mapping arm -> ndarray, shape (r, n_i)

        Raises
        ------
        ModelError, SceneError
            When the times do not increase, or the interpolation is unknown.
        """
        rows = increasing_times(np.asarray(times, dtype=float))
        if interpolation not in DEGREES or len(rows) < 2:
            few = "a table needs two rows or more"
            fault = few if len(rows) < 2 else unknown("interpolation", interpolation, DEGREES)
            raise ModelError(f"by_torque_table: {fault}")
        coefficients = polynomials(rows, np.eye(len(rows)), interpolation)
        inside = (self.times >= rows[0]) & (self.times < rows[-1])
        t = self.times[inside]
        before = np.searchsorted(rows, t, side="right") - 1
        degree, x = coefficients.shape[2] - 1, (t - rows[before])[:, None]
        shape = sum(coefficients[before][:, :, k] * x ** (degree - k) for k in range(degree + 1))
        weighted = self.weights[inside, None] * self.torque_density[inside]
        return self.start.layout.split_joints(shape.T @ weighted)


class _Walk(NamedTuple):
    """The result of a walk backward over all panels."""

    error: float
    shares: np.ndarray
    start: np.ndarray  # (D,)
    integrals: np.ndarray  # (1 + P,), of the running scalar, and by the parameters
    times: np.ndarray
    weights: np.ndarray
    torque_density: np.ndarray


def gradient(
    system: System,
    duration: float,
    *,
    final: Scalar | None = None,
    running: Scalar | None = None,
    parameters: Sequence[str] = (),
    accuracy: float | None = None,
    state: State | None = None,
    start_time: float = 0.0,
    progress: bool | Report | None = None,
) -> Gradient:
    r"""Differentiate a scalar of a run, :math:`\Phi(T, x(T)) + \int \ell(t, x)\,dt`.

    By the adjoint equation along the run (:mod:`multiarm.gradients.gradient`): by the start, by
    numbers of the scene, and by torques at all times.

    >>> g = ma.gradient(system, 1.0, final=lambda t, state: state.object_position[2],
    ...                 parameters=["object.mass"])
    >>> g.value, g.parameters["object.mass"], g.start.d_joint_velocities["left"]

    Parameters
    ----------
    system : System
    duration : float
        Of the run [s].
    final, running : callable, optional
        ``f(t, state)`` at the end, and under the integral; a smooth function of the state.  It
        returns a number, or a number and its derivatives by a displacement of the state, shape
        (12 + 2 n,): shift and turn of the object, its twist, joint positions, joint velocities.
        Without them they are found by differences.
    parameters : sequence of str
        Paths of numbers of the scene, such as ``"object.mass"``, ``"control.stiffness.left"``.
    accuracy : float, optional
        Of the run [m, rad], and relative error of its derivatives; the scene's when left out.  The
        run is not certified.
    state : State, optional
        Initial state; the scene's start when left out, which parameters may move.
    start_time : float
        [s]
    progress : bool or callable, optional
        True: a bar.  A function is called with how much is done, of how much, and what.

    Raises
    ------
    ModelError
        When ``system`` is no system, ``state`` none of its states, or a function returns no number.
    SceneError
        When a parameter is no number of the scene.
    SolverError
        When the run is not differentiable: contacts open, close or slide, the rank of the
        constraints changes, the control is sampled; or when it fails.
    """
    system = require_system(system, "ma.gradient(system, duration)")
    start = None if state is None else system.checked(state)
    if final is None and running is None:
        raise ModelError("gradient: give `final` or `running`, the scalar to be differentiated")
    begin, duration = require_time(start_time), positive("duration", duration)
    with displayed(progress, Progress) as show:
        along = Along(system, begin, duration, accuracy, start, parameters)
        panels = along.panels(())


        def walk(over: list[Panel], report: Callable[[int], None]) -> _Walk:
            return _backward(along, over, final, running, report)

        found = along.to_accuracy(panels, walk, show)
    end = 0.0 if final is None else _differentiated(final, along.end, along.state(along.end))[0]
    by_parameters = found.integrals[1:] + found.start @ along.start_by_parameters()
    return Gradient(
        value=end + float(found.integrals[0]),
        start=Sensitivity(found.start, along.layout, state_columns(along.layout)),
        parameters=dict(zip(parameters, by_parameters.tolist(), strict=True)),
        trajectory=along.trajectory,
        error=found.error,
        times=found.times,
        weights=found.weights,
        torque_density=found.torque_density,
    )


def _backward(
    along: Along,
    panels: list[Panel],
    final: Scalar | None,
    running: Scalar | None,
    report: Callable[[int], None],
) -> _Walk:
    """Solve the adjoint equation over all panels, and for its error, which is a second column."""
    mu, count = np.zeros((along.size, 2)), 1 + len(along.parameters)
    if final is not None:
        mu[:, 0] = _differentiated(final, along.end, along.state(along.end))[1]
    integrals, magnitudes = np.zeros((count, 2)), np.zeros(count)
    of_start, of_integrals = np.zeros(len(panels)), np.zeros((len(panels), count))
    pieces: list[_Piece] = []
    mu, integrals[1:] = along.bound(along.end).backward(mu)
    for k in reversed(range(len(panels))):
        after, halves = mu, np.zeros((count, 2))
        for half in reversed(panels[k].halves):
            piece = _over(along, half, running, mu)
            mu, halves = piece.start, halves + piece.integrals
            magnitudes += piece.magnitudes
            pieces.append(piece)
        whole = _over(along, panels[k], running, after[:, :1])
        of_integrals[k] = (whole.integrals[:, 0] - halves[:, 0]) / RICHARDSON
        halves[:, 1] += of_integrals[k]
        mu[:, 1] += (whole.start[:, 0] - mu[:, 0]) / RICHARDSON
        bound = along.bound(panels[k].begin)
        of_start[k] = np.abs(bound.admissible @ (whole.start[:, 0] - mu[:, 0])).max() / RICHARDSON
        mu, across = bound.backward(mu)
        of_start[k] /= np.abs(mu[:, 0]).max(initial=TINY)
        halves[1:] += across
        integrals += halves
        report(len(panels) - k)
    pieces.reverse()
    magnitudes = np.maximum(magnitudes, TINY)
    error = np.abs(mu[:, 1]).max() / np.abs(mu[:, 0]).max(initial=TINY)
    return _Walk(
        error=float(max(error, (np.abs(integrals[:, 1]) / magnitudes).max())),
        shares=np.maximum(of_start, (np.abs(of_integrals) / magnitudes).max(axis=1)),
        start=mu[:, 0],
        integrals=integrals[:, 0],
        times=np.concatenate([piece.times for piece in pieces]),
        weights=np.concatenate([piece.weights for piece in pieces]),
        torque_density=np.concatenate([piece.torque_density for piece in pieces]),
    )


class _Piece(NamedTuple):
    """The adjoint over one panel."""

    start: np.ndarray  # (D, k)
    integrals: np.ndarray  # (1 + P, k)
    magnitudes: np.ndarray  # (1 + P,), of the integrands
    times: list[float]
    weights: np.ndarray  # (3,)
    torque_density: np.ndarray  # (3, n)


def _over(along: Along, panel: Panel, running: Scalar | None, end: np.ndarray) -> _Piece:
    """Solve the adjoint equation over one panel, from the columns at its end."""
    collocation, by_torques, by_parameters = along.solved(panel)
    rates, slopes = np.zeros(3), np.zeros((3, along.size))
    if running is not None:
        for i, t in enumerate(panel.nodes):
            rates[i], slopes[i] = _differentiated(running, t, along.state(t))
    start, stages = collocation.backward(end, slopes)
    integrand = np.zeros((3, 1 + len(along.parameters), end.shape[1]))
    integrand[:, 0, 0] = rates
    integrand[:, 1:] = np.einsum("idp,idk->ipk", by_parameters, stages)
    weights = panel.length * WEIGHTS
    return _Piece(
        start,
        np.einsum("i,iqk->qk", weights, integrand),
        weights @ np.abs(integrand[:, :, 0]),
        panel.nodes,
        weights,
        np.einsum("idn,id->in", by_torques, stages[:, :, 0]),
    )


def _differentiated(function: Scalar, t: float, state: State) -> tuple[float, np.ndarray]:
    """The value of a user's function and its derivatives by a displacement, shape (D,)."""
    size = 12 + 2 * state.layout.joints
    found = function(t, state.copy())
    if isinstance(found, tuple):
        value, slope = found
        return _number(value), checked_vector("the derivatives of a scalar", slope, size)
    slope = np.zeros(size)
    for column in range(size):
        for sign in (-1.0, 1.0):
            there = function(t, displaced(state, column, sign * DISPLACEMENT))
            slope[column] += 0.5 * sign * _number(there) / DISPLACEMENT
    return _number(found), slope


def _number(value: object) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ModelError(
            f"gradient: the scalar must be a finite number, or a number and its derivatives, got "
            f"{shown(value)}"
        )
    return number
