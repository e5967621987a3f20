r"""The gradient of a scalar of a run, by the adjoint equation.

For :math:`J = \Phi(x(T)) + \int \ell(t, x)\,dt` along the run, and its variational equation
:math:`\dot\delta = A\delta + B\,\delta\tau + \beta\,\delta p`,

.. math::
    -\dot\mu = A^T \mu + \nabla\ell, \qquad \mu(T) = \nabla\Phi, \qquad
    dJ = \mu(0)\cdot\delta(0) + \int \mu^T (B\,\delta\tau + \beta\,\delta p)\,dt .

Where timed joints take hold or let go, :math:`\delta^+ = S\delta + s\,\delta p`
(:mod:`multiarm.gradients.switches`).  Velocities jump there, and :math:`\ell` with them; a nearby
motion switches later by :math:`\delta t = d\cdot\delta + e\,\delta p`, and has the integrand before
the switch so much longer:

.. math::
    \mu = S^T\mu^+ + (\ell - \ell^+)\,d, \qquad
    dJ = \dots + (\mu^+\cdot s + (\ell - \ell^+)\,e)\,\delta p .

So one solution, backward in time, gives the derivatives by the whole start, by any number of
parameters, and by torques at all times, whose density is :math:`B^T\mu`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from multiarm.control.recorded import INTERPOLATIONS, polynomials
from multiarm.dynamics.sensitivity import ByPath, Sensitivity
from multiarm.dynamics.state import State, checked_vector
from multiarm.dynamics.system import System, require_system
from multiarm.errors import ModelError
from multiarm.gradients.collocation import WEIGHTS
from multiarm.gradients.linearised_run import Done, Linearisation, LinearisedRun, Parameters
from multiarm.gradients.segments import (
    RICHARDSON,
    ROUNDING,
    WHOLE,
    Coefficients,
    CollocatedPanel,
    Halving,
    Panel,
    Segment,
)
from multiarm.gradients.switches import Jump
from multiarm.gradients.variational_equation import TINY, displaced
from multiarm.public import facts_html, public_names
from multiarm.results.trajectory import Trajectory
from multiarm.scene.faults import shown, unknown
from multiarm.scene.registry import called
from multiarm.simulation.setup import finite_time, increasing_times, positive
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
        By numbers of the scene, path -> derivative.
    trajectory : Trajectory
        The run, sampled at the nodes of series (:mod:`multiarm.gradients.run_series`).
    error : float
        Estimated error of the derivatives.  By start and torques: relative to the largest.  By a
        number of the scene: relative to the integral of its integrand's magnitude over the run,
        with what the start and switches add, or, where that is a rounding, to what it would be if a
        change of the number by its size changed the accelerations by theirs.  It contains what the
        error of the run itself changes: the difference from derivatives along a second run with a
        tenth of the tolerance (:mod:`multiarm.gradients.linearised_run`).
    digits : int
        How many are right, by this error; 0 of a chaotic run that is too long.
    message : str
        What is wrong when few digits are right, and what to do; else empty.
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
    digits: int
    message: str
    times: np.ndarray
    weights: np.ndarray
    torque_density: np.ndarray

    __dir__ = public_names

    def __repr__(self) -> str:
        parts = ", ".join(f"{path}: {number:.6g}" for path, number in self.parameters.items())
        parts = parts or "by start and torques"
        return f"Gradient(value {self.value:.9g}; {parts}{self.message and '; '}{self.message})"

    def _repr_html_(self) -> str:
        facts: dict[str, object] = {"value": f"{self.value:.9g}"}
        facts |= {path: f"{number:.6g}" for path, number in self.parameters.items()}
        facts |= {"estimated error": f"{self.error:.1e}", "message": self.message}
        return facts_html("Gradient", facts)

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
        rows = increasing_times(times, "times")
        if interpolation not in INTERPOLATIONS or len(rows) < 2:
            few = "a table needs two rows or more"
            fault = (
                few if len(rows) < 2 else unknown("interpolation", interpolation, INTERPOLATIONS)
            )
            raise ModelError(f"by_torque_table: {fault}")
        coefficients = polynomials(rows, np.eye(len(rows)), interpolation)
        # nodes are at the ends of panels, and never at their beginnings
        inside = (self.times > rows[0]) & (self.times <= rows[-1])
        t = self.times[inside]
        before = np.searchsorted(rows, t) - 1
        degree, x = coefficients.shape[2] - 1, (t - rows[before])[:, None]
        shape = sum(coefficients[before][:, :, k] * x ** (degree - k) for k in range(degree + 1))
        weighted = self.weights[inside, None] * self.torque_density[inside]
        return self.start.layout.split_joints(shape.T @ weighted)


class _AdjointSolution(NamedTuple):
    """The adjoint over all segments, from the end of the run to its start."""

    error: float
    segment_errors: np.ndarray
    value: float
    start: np.ndarray  # (D,), the adjoint's part along displacements that keep the joints closed
    start_size: float  # what errors of it are relative to
    by_parameters: np.ndarray  # (P,)
    sizes: np.ndarray  # (P,), what errors of these are relative to
    times: np.ndarray
    weights: np.ndarray
    torque_density: np.ndarray

    def difference(self, comparison: _AdjointSolution) -> float:
        """The largest relative difference of a derivative along the comparison run."""
        of_start = np.abs(comparison.start - self.start).max()
        of_start /= max(self.start_size, comparison.start_size)
        sizes = np.maximum(self.sizes, comparison.sizes)
        by_parameters = np.abs(comparison.by_parameters - self.by_parameters) / sizes
        return float(max(of_start, by_parameters.max(initial=0.0)))


def gradient(
    system: System,
    duration: float,
    *,
    final: Scalar | None = None,
    running: Scalar | None = None,
    parameters: Parameters = (),
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
        (12 F + 2 n,): shift and turn of each of the F objects, their twists, joint positions, joint
        velocities.
        Without them they are differences.
    parameters : sequence of str, or mapping str -> float or None
        Paths of numbers of the scene, such as ``"object.mass"``, ``"control.stiffness.left"``; in a
        mapping with a change that is no longer small, of which a thousandth is tried (None: the
        number itself).  Times at which joints take hold or let go are numbers, too:
        ``"joints[1].from"``, ``"joints[0].until"``, ``"joints[2].from[0][1]"``.
    accuracy : float, optional
        Of the run [m, rad], and relative error of its derivatives along it, but not below 1e-8; the
        scene's when left out.  The run is not certified; what its error changes is in ``error``.
    state : State, optional
        Initial state; the scene's start when left out, which parameters may move.  With it, the
        derivatives are those of runs from this state, which each puts on its joints.
    start_time : float
        [s]
    progress : bool or callable, optional
        True: a bar.  A function is called with how much is done, of how much, and what.

    Raises
    ------
    ModelError
        When ``system`` is no system, ``state`` none of its states, or a function returns no number.
    SceneError
        When a parameter is no number of the scene, or the time of a switch at the start or the end
        of the run, or the start jumps with it.
    SolverError
        When the run is not differentiable: contacts open, close or slide, the rank of the
        constraints changes, joints take hold or let go at the same time for different reasons or
        nearly so, the control is sampled; or when it fails.
    """
    system = require_system(system, "ma.gradient(system, duration)")
    start = None if state is None else system.checked(state)
    if final is None and running is None:
        raise ModelError("gradient: give `final` or `running`, the scalar to be differentiated")
    for name, function in (("final", final), ("running", running)):
        if function is not None and not callable(function):
            raise ModelError(f"gradient: `{name}` is a function f(t, state), got {shown(function)}")
    begin, duration = finite_time(start_time, "start_time"), positive("duration", duration)
    integrand = None if running is None else partial(_differentiated, running)
    with displayed(progress, Progress) as show:
        linearised = LinearisedRun(
            system, begin, begin + duration, accuracy, start, parameters, np.zeros(0), integrand
        )

        def solve(linearisation: Linearisation, report: Done) -> _AdjointSolution:
            value, slope = 0.0, np.zeros(linearised.whole_size)
            if final is not None:
                at_end = linearised.end, linearisation.state(linearised.end)
                value, slope[: linearised.size] = _differentiated(final, *at_end)
            return _AdjointSolver(linearised, linearisation, value, slope).solve(report)

        solution, quality = linearised.to_accuracy(solve, show)
    return Gradient(
        value=solution.value,
        start=Sensitivity(solution.start, linearised.layout, linearised.layout.columns),
        parameters=ByPath(zip(linearised.paths, solution.by_parameters.tolist(), strict=True)),
        trajectory=linearised.trajectory,
        **quality._asdict(),
        times=solution.times,
        weights=solution.weights,
        torque_density=solution.torque_density,
    )


class _PanelSolution(NamedTuple):
    """The adjoint over one panel, and its error that is solved for with it."""

    start: np.ndarray  # (d,), the adjoint
    integrals: np.ndarray  # (1 + P,)
    magnitudes: np.ndarray  # (1 + P,), of the integrands
    typical: np.ndarray  # (1 + P,), what the integrals by parameters are as a rule
    torque_density: np.ndarray  # (s, n)
    start_error: np.ndarray  # (d,)
    integral_errors: np.ndarray  # (1 + P,)
    series_error: float  # the part that begins here, relative to the adjoint
    series_integrals: np.ndarray  # (1 + P,), the same of the integrals


class _AdjointSolver:
    """Solves the adjoint equation, from the end of the run to its start."""

    def __init__(
        self,
        linearised: LinearisedRun,
        linearisation: Linearisation,
        value: float,
        slope: np.ndarray,
    ) -> None:
        self._linearised, self._linearisation, count = (
            linearised,
            linearisation,
            1 + len(linearised.parameters),
        )
        self._mu, self._error = slope, np.zeros_like(slope)
        self._integrals, self._integral_errors = np.zeros(count), np.zeros(count)
        self._magnitudes, self._typical = np.zeros(count), np.zeros(count)
        self._integrals[0], self._magnitudes[0] = value, abs(value)
        # what the adjoint is as a rule: displacements neither grow nor fade
        self._typical_start = np.abs(slope).max()
        self._pieces: list[tuple[Panel, np.ndarray]] = []

    def solve(self, report: Done) -> _AdjointSolution:
        """Solve the adjoint equation over all segments."""
        linearised = self._linearised
        segment_errors = (
            np.zeros(linearised.count),
            np.zeros((linearised.count, self._integrals.size)),
        )
        for k in reversed(range(linearised.count)):
            segment = self._linearisation.segment(k)
            self._jump(self._linearisation.jump(k))
            self._change_coordinates(segment)
            self._typical_start += segment.panel.length * segment.steepest
            for collocated in reversed(segment.panels(linearised.bounds)):
                for segment_error, added in zip(
                    segment_errors, self._solve_panel(collocated), strict=True
                ):
                    segment_error[k] += added
            self._mu, self._error = segment.basis @ self._mu, segment.basis @ self._error
            report(linearised.count - k)
        mu, mu_error = self._mu[: linearised.size], self._error[: linearised.size]
        by_parameters = linearised.start_by_parameters
        self._integrals[1:] += mu @ by_parameters
        self._magnitudes[1:] += np.abs(mu @ by_parameters)
        self._typical[1:] += self._typical_start * np.abs(by_parameters).max(axis=0)
        self._integral_errors[1:] += mu_error @ by_parameters
        sizes, admissible = self._sizes(self._magnitudes, self._typical), linearised.admissible
        start = admissible @ mu
        resolved = ROUNDING / linearised.tolerance * self._typical_start
        start_size = float(max(np.abs(start).max(), resolved, TINY))
        of_start = np.abs(admissible @ mu_error).max() / start_size
        self._pieces.reverse()
        weights = [panel.length * WEIGHTS for panel, _ in self._pieces]
        of_series = np.maximum(segment_errors[0], (segment_errors[1] / sizes).max(axis=1))
        of_integrals = (np.abs(self._integral_errors) / sizes).max()
        return _AdjointSolution(
            error=float(max(of_start, of_integrals, of_series.sum())),
            segment_errors=of_series,
            value=float(self._integrals[0]),
            start=start,
            start_size=start_size,
            by_parameters=self._integrals[1:],
            sizes=sizes[1:],
            times=np.concatenate([panel.nodes for panel, _ in self._pieces]),
            weights=np.concatenate(weights),
            torque_density=np.concatenate([density for _, density in self._pieces]),
        )

    def _jump(self, jump: Jump | None) -> None:
        """From displacements after a switch to those before; None: there is none."""
        if jump is None:
            return
        added = self._mu @ jump.by_parameters, jump.integral_by_parameters
        self._integrals[1:] += added[0] + added[1]
        self._magnitudes[1:] += np.abs(added[0]) + np.abs(added[1])
        self._typical[1:] += self._typical_start * jump.scale
        self._integral_errors[1:] += self._error @ jump.by_parameters
        self._typical_start += np.abs(jump.integral_by_state).max()
        self._mu = self._mu @ jump.by_state + jump.integral_by_state
        self._error = self._error @ jump.by_state

    def _change_coordinates(self, segment: Segment) -> None:
        """From displacements at the end of a segment to its coordinates."""
        E, n = segment.lift(segment.panel.end)
        self._integrals[1:] += self._mu @ n
        self._magnitudes[1:] += np.abs(self._mu @ n)
        self._integral_errors[1:] += self._error @ n
        self._mu, self._error = self._mu @ E, self._error @ E

    def _solve_panel(
        self, collocated: CollocatedPanel, halving: Halving = WHOLE
    ) -> tuple[float, np.ndarray]:
        """Solve over a panel, or over parts of it.

        Returns what the series' error adds: relative to the adjoint, and to the integrals.
        """
        linearised, panel, (first, second) = self._linearised, collocated.panel, collocated.halves
        start, _, integrand = _adjoint(collocated, self._mu)
        late = _solved_with_error(second, self._mu, self._error)
        early = _solved_with_error(first, late.start, late.start_error)
        missed = (start - early.start) / RICHARDSON
        integrals = late.integrals + early.integrals
        missed_integrals = (panel.length * WEIGHTS @ integrand - integrals) / RICHARDSON
        magnitudes = late.magnitudes + early.magnitudes
        part = panel.length / (linearised.end - linearised.begin)
        typical = late.typical + early.typical
        sizes = np.maximum(magnitudes, part * self._magnitudes)
        sizes = self._sizes(sizes, np.maximum(typical, part * self._typical))
        relative_error = np.abs(missed).max() / (part * np.abs(early.start).max(initial=TINY))
        relative_error = max(relative_error, (np.abs(missed_integrals) / sizes).max())
        if relative_error > linearised.panel_tolerance and (
            finer := halving.next(relative_error, part)
        ):
            later, later_integrals = self._solve_panel(second, finer)
            earlier, earlier_integrals = self._solve_panel(first, finer)
            return later + earlier, later_integrals + earlier_integrals
        self._mu, self._error = early.start, early.start_error + missed
        self._integrals += integrals
        self._integral_errors += late.integral_errors + early.integral_errors + missed_integrals
        self._magnitudes += magnitudes
        self._typical += typical
        densities = late.torque_density, early.torque_density
        self._pieces += zip((second.panel, first.panel), densities, strict=True)
        return (
            late.series_error + early.series_error,
            late.series_integrals + early.series_integrals,
        )

    def _sizes(self, magnitudes: np.ndarray, typical: np.ndarray) -> np.ndarray:
        """What errors of integrals are relative to: with smaller sizes they would be roundings."""
        return np.maximum(magnitudes, ROUNDING / self._linearised.tolerance * typical) + TINY


def _adjoint(
    collocated: CollocatedPanel, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve the adjoint equation over a panel, from its value at the end.

    Returns its value at the start (d,), at the stages (s, d), and the integrands (s, 1 + P).
    """
    start, stages = collocated.collocation.backward(end, collocated.at.slope)
    return start, stages, _integrand(collocated.at, stages) + collocated.at.rates


def _solved_with_error(
    collocated: CollocatedPanel, end: np.ndarray, error: np.ndarray
) -> _PanelSolution:
    """Solve the adjoint equation, and for its error, over a panel."""
    at, defect, weights = collocated.at, collocated.defect, collocated.panel.length * WEIGHTS
    start, stages, integrand = _adjoint(collocated, end)
    residual = np.einsum("ide,id->ie", defect.A, stages) + defect.slope
    start_error, error_stages = collocated.collocation.backward(error, residual)
    of_series = _integrand(defect, stages) + defect.rates
    typical = np.zeros_like(integrand)
    typical[:, 1:] = np.abs(stages) @ collocated.scale
    return _PanelSolution(
        start=start,
        integrals=weights @ integrand,
        magnitudes=weights @ np.abs(integrand),
        typical=weights @ typical,
        torque_density=np.einsum("idn,id->in", at.B, stages),
        start_error=start_error,
        integral_errors=weights @ (_integrand(at, error_stages) + of_series),
        series_error=float(np.abs(weights @ residual).max() / np.abs(stages).max(initial=TINY)),
        series_integrals=weights @ np.abs(of_series),
    )


def _integrand(at: Coefficients, stages: np.ndarray) -> np.ndarray:
    """Of the integrals by the parameters, shape (s, 1 + P); the first is left zero."""
    integrand = np.zeros((len(stages), 1 + at.beta.shape[2]))
    integrand[:, 1:] = np.einsum("idp,id->ip", at.beta, stages)
    return integrand


def _differentiated(function: Scalar, t: float, state: State) -> tuple[float, np.ndarray]:
    """The value of a user's function and its derivatives by a displacement, shape (D,)."""
    size = 2 * state.layout.nv
    result = _scalar(function, t, state.copy())
    if isinstance(result, tuple):
        value, slope = result
        return _number(value), checked_vector("the derivatives of a scalar", slope, size)
    steps = DISPLACEMENT * np.eye(size)
    changes = [
        _number(_scalar(function, t, displaced(state, step)))
        - _number(_scalar(function, t, displaced(state, -step)))
        for step in steps
    ]
    return _number(result), np.array(changes) / (2.0 * DISPLACEMENT)


def _scalar(function: Scalar, t: float, state: State) -> object:
    """What a user's function returns."""
    who = f"gradient: the scalar, f(t, state) at t = {t:.9g} s,"
    return called(lambda: function(t, state), who)


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
