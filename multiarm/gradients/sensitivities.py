r"""Forward sensitivities: how all states of a run depend on its start and on numbers of the scene.

The columns of :math:`S = (\partial x(t)/\partial x_0,\ \partial x(t)/\partial p)` solve the
variational equation :math:`\dot S = A S + (0, \beta)` along the run, and jump where timed joints
take hold or let go (:mod:`multiarm.gradients.switches`).  Their number does not grow
with that of the output times, so that they suit fits to many measurements, as gradients
(:mod:`multiarm.gradients.gradient`) suit many parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from multiarm.dynamics.layout import Layout
from multiarm.dynamics.sensitivity import Sensitivity
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System, require_system
from multiarm.errors import SceneError
from multiarm.gradients.collocation import WEIGHTS
from multiarm.gradients.linearised_run import Done, Linearisation, LinearisedRun, Parameters
from multiarm.gradients.segments import (
    RICHARDSON,
    ROUNDING,
    WHOLE,
    Coefficients,
    CollocatedPanel,
    Halving,
)
from multiarm.gradients.variational_equation import TINY
from multiarm.notation import count_of
from multiarm.public import facts_html, public_names
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.setup import finite_time, increasing_times
from multiarm.terminal.progress import Progress, Report, displayed

__all__ = ["Sensitivities", "sensitivities"]


@dataclass(frozen=True, repr=False)
class Sensitivities:
    """Derivatives of the states of a run at some times.

    Of a displacement of the state: shift and turn of the object (world axes), its twist, joints,
    joint velocities; D = 12 + 2 n components.

    Attributes
    ----------
    time : ndarray, shape (K,)
        [s]
    matrix : ndarray, shape (K, D, C)
        By the columns: a displacement of the start, of which the part along the joints acts, and
        the parameters.  At the time of a switch they are those before it.
    rows, columns : mapping str -> slice
        Of the matrix; parameters have their paths as names.
    states : list of State
        The run at these times.
    trajectory : Trajectory
        The run, sampled at these times and at the nodes of series.
    error : float
        Estimated error of the derivatives, relative to the largest of their column, with what the
        error of the run itself changes, as of :class:`multiarm.gradients.gradient.Gradient`.
    digits : int
        How many are right, by this error; 0 of a chaotic run that is too long.
    message : str
        What is wrong when few digits are right, and what to do; else empty.
    layout : Layout
    """

    time: np.ndarray
    matrix: np.ndarray
    rows: Mapping[str, slice]
    columns: Mapping[str, slice]
    states: list[State]
    trajectory: Trajectory
    error: float
    digits: int
    message: str
    layout: Layout

    __dir__ = public_names

    def __repr__(self) -> str:
        times, rows, columns = self.matrix.shape
        of, by = count_of(rows, "component"), count_of(columns, "column")
        counts = f"{of} at {count_of(times, 'time')}, by {by}"
        return f"Sensitivities({counts}{self.message and '; '}{self.message})"

    def _repr_html_(self) -> str:
        parameters = ", ".join(list(self.columns)[len(self.rows) :])
        facts = {"times": len(self.time), "parameters": parameters, "error": f"{self.error:.1e}"}
        return facts_html("Sensitivities", facts | {"message": self.message})

    @property
    def object_pose(self) -> Sensitivity:
        """Of a shift [m] and a turn [rad] of each object, blocks (K, 6 F, ...)."""
        return self._sensitivity(self.rows["object_pose"])

    @property
    def object_twist(self) -> Sensitivity:
        """Of the objects' twists, blocks (K, 6 F, ...)."""
        return self._sensitivity(self.rows["object_twist"])

    @cached_property
    def joint_positions(self) -> Mapping[str, Sensitivity]:
        """Of the joint positions by arm, blocks (K, n_i, ...)."""
        return self._by_arm("joint_positions")

    @cached_property
    def joint_velocities(self) -> Mapping[str, Sensitivity]:
        """Of the joint velocities by arm, blocks (K, n_i, ...)."""
        return self._by_arm("joint_velocities")

    @cached_property
    def base_poses(self) -> Mapping[str, Sensitivity]:
        """Of a shift [m] and a turn [rad] of floating bases by robot, blocks (K, 6, ...)."""
        return self._by_base("joint_positions")

    @cached_property
    def base_twists(self) -> Mapping[str, Sensitivity]:
        """Of the twists of floating bases by robot, blocks (K, 6, ...)."""
        return self._by_base("joint_velocities")

    def _sensitivity(self, rows: slice | np.ndarray) -> Sensitivity:
        return Sensitivity(self.matrix[:, rows], self.layout, self.columns)

    def _by_arm(self, quantity: str) -> dict[str, Sensitivity]:
        rows = self.layout.split_joints(self._rows_of(quantity))
        return {name: self._sensitivity(of_arm) for name, of_arm in rows.items()}

    def _by_base(self, quantity: str) -> dict[str, Sensitivity]:
        rows = self.layout.split_bases(self._rows_of(quantity))
        return {name: self._sensitivity(of_base) for name, of_base in rows.items()}

    def _rows_of(self, quantity: str) -> np.ndarray:
        return np.arange(self.rows[quantity].start, self.rows[quantity].stop)


class _ForwardSolution(NamedTuple):
    """The variational equation over all panels, from the start of the run to its end."""

    error: float
    segment_errors: np.ndarray
    at: dict[float, np.ndarray]  # (D, D + P) at all bounds of panels
    sizes: np.ndarray  # (D + P,), what errors of the columns are relative to

    def difference(self, comparison: _ForwardSolution) -> float:
        """The largest relative difference of a derivative along the comparison run."""
        times = self.at.keys() & comparison.at.keys()
        differences = np.max(
            [np.abs(comparison.at[t] - self.at[t]).max(axis=0) for t in times], axis=0
        )
        return float((differences / np.maximum(self.sizes, comparison.sizes)).max())


def sensitivities(
    system: System,
    times: ArrayLike,
    *,
    parameters: Parameters = (),
    accuracy: float | None = None,
    state: State | None = None,
    start_time: float = 0.0,
    progress: bool | Report | None = None,
) -> Sensitivities:
    """Differentiate the states of a run by its start and by numbers of the scene.

    By the variational equation along the run (:mod:`multiarm.gradients.sensitivities`).

    >>> S = ma.sensitivities(system, [0.5, 1.0], parameters=["object.mass"])
    >>> S.joint_positions["left"].d_object_twist, S.object_pose.parameters["object.mass"]

    Parameters
    ----------
    system : System
    times : array-like, shape (K,)
        Increasing times of the states [s]; the run ends at the last.
    parameters, accuracy, state, start_time, progress
        As of :func:`multiarm.gradient`.

    Raises
    ------
    ModelError, SceneError, SolverError
        As of :func:`multiarm.gradient`; also for times that do not increase from the start on.
    """
    system = require_system(system, "ma.sensitivities(system, times)")
    start = None if state is None else system.checked(state)
    begin = finite_time(start_time, "start_time")
    at = increasing_times(times, "times")
    if at[0] < begin or not at[-1] > begin:
        raise SceneError(
            f"'times' must be after the start of the run at {begin:.9g} s, got {at[0]:.9g} s"
        )
    with displayed(progress, Progress) as show:
        linearised = LinearisedRun(system, begin, float(at[-1]), accuracy, start, parameters, at)
        solution, quality = linearised.to_accuracy(
            lambda linearisation, report: _ForwardSolver(linearised, linearisation).solve(report),
            show,
        )
    rows, size = linearised.layout.columns, linearised.size
    of_parameters = {path: slice(size + k, size + k + 1) for k, path in enumerate(linearised.paths)}
    return Sensitivities(
        time=at,
        matrix=np.stack([solution.at[t][:size] for t in at.tolist()]),
        rows=rows,
        columns=rows | of_parameters,
        states=[linearised.state(t) for t in at.tolist()],
        trajectory=linearised.trajectory,
        **quality._asdict(),
        layout=linearised.layout,
    )


class _ForwardSolver:
    """Solves the variational equation, from the start of the run to its end."""

    def __init__(self, linearised: LinearisedRun, linearisation: Linearisation) -> None:
        self._linearised, self._linearisation = linearised, linearisation
        start = np.hstack([linearised.admissible, linearised.start_by_parameters])
        self._S = np.zeros((linearised.whole_size, start.shape[1]))
        self._S[: linearised.size] = start
        self._error, self._worst = np.zeros_like(self._S), np.zeros(self._S.shape[1])
        self._sizes = np.abs(self._S).max(axis=0, initial=TINY)
        self._grown = np.zeros(self._S.shape[1])
        self._at = {linearised.begin: self._S}

    def solve(self, report: Done) -> _ForwardSolution:
        """Solve the variational equation over all segments."""
        linearised = self._linearised
        segment_errors = np.zeros((linearised.count, self._S.shape[1]))
        for k in range(linearised.count):
            segment = self._linearisation.segment(k)
            if k == 0:  # columns that begin with nothing grow to about this size
                at, _ = segment.at([segment.panel.nodes[1]])
                duration, of_all = linearised.end - linearised.begin, slice(linearised.size, None)
                self._grown[of_all] = duration * np.abs(at.beta).max(axis=(0, 1))
                least = (
                    ROUNDING
                    / linearised.tolerance
                    * duration
                    * segment.scale.max(axis=0, initial=0)
                )
                self._sizes[of_all] = np.maximum(self._sizes[of_all], least)
            to = segment.basis.T
            self._S, self._error = to @ self._S, to @ self._error
            for collocated in segment.panels(linearised.bounds):
                self._solve_panel(collocated, segment_errors[k])
                E, n = segment.lift(collocated.panel.end)
                self._at[collocated.panel.end] = E @ self._S
                self._at[collocated.panel.end][:, linearised.size :] += n
            self._S, self._error = self._at[segment.panel.end], E @ self._error
            jump = self._linearisation.jump(k)
            if jump is not None:
                self._S, self._error = jump.by_state @ self._S, jump.by_state @ self._error
                self._S[:, linearised.size :] += jump.by_parameters
            report(k + 1)
        of_series = (segment_errors / self._sizes).max(axis=1)
        error = max((self._worst / self._sizes).max(), of_series.sum())
        return _ForwardSolution(float(error), of_series, self._at, self._sizes)

    def _solve_panel(
        self, collocated: CollocatedPanel, segment_error: np.ndarray, halving: Halving = WHOLE
    ) -> None:
        """Solve over a panel, or over parts of it; adds the errors of the series, (C,)."""
        linearised, panel, S, error = self._linearised, collocated.panel, self._S, self._error
        whole, _, _ = _solved_with_error(collocated, S, error)
        of_series = np.zeros(S.shape[1])
        for half in collocated.halves:
            S, error, of_half = _solved_with_error(half, S, error)
            of_series += of_half
        missed = (whole - S) / RICHARDSON
        sizes = np.maximum(self._sizes, np.abs(S).max(axis=0))
        part = panel.length / (linearised.end - linearised.begin)
        relative_error = np.abs(missed).max(axis=0) / (part * np.maximum(sizes, self._grown))
        if relative_error.max() > linearised.panel_tolerance and (
            finer := halving.next(relative_error.max(), part)
        ):
            for half in collocated.halves:
                self._solve_panel(half, segment_error, finer)
            return
        self._S, self._error, self._sizes = S, error + missed, sizes
        self._worst = np.maximum(self._worst, np.abs(self._error).max(axis=0))
        segment_error += of_series


def _solved_with_error(
    collocated: CollocatedPanel, S: np.ndarray, error: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve the variational equation, and for its error, over a panel.

    Returns both at the end, (d, C) each, and the part of the error that begins here, (C,).
    """
    at, defect, collocation = collocated.at, collocated.defect, collocated.collocation
    end, stages = collocation.forward(S, _by_column(at, S))
    residual = defect.A @ stages + _by_column(defect, S)
    error, _ = collocation.forward(error, residual)
    of_series = collocated.panel.length * np.abs(np.einsum("i,idk->dk", WEIGHTS, residual)).max(
        axis=0
    )
    return end, error, of_series


def _by_column(at: Coefficients, S: np.ndarray) -> np.ndarray:
    """What drives the columns: nothing, and for the last ones a parameter, (s, D, C)."""
    b = np.zeros((len(at.beta), *S.shape))
    b[:, :, S.shape[1] - at.beta.shape[2] :] = at.beta
    return b
