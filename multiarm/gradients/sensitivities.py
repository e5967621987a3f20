r"""Forward sensitivities: how all states of a run depend on its start and on numbers of the scene.

The columns of :math:`S = (\partial x(t)/\partial x_0,\ \partial x(t)/\partial p)` solve the
variational equation :math:`\dot S = A S + (0, \beta)` along the run.  Their number does not grow
with that of the output times, so that they suit fits to many measurements, as gradients
(:mod:`multiarm.gradients.gradient`) suit many parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from multiarm.dynamics.sensitivity import Sensitivity
from multiarm.dynamics.state import Layout, State
from multiarm.dynamics.system import System, require_system, require_time
from multiarm.errors import SceneError
from multiarm.gradients.along import RICHARDSON, TINY, Along, Panel
from multiarm.gradients.variation import state_columns
from multiarm.public import facts_html, public_names
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.setup import increasing_times
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
        the parameters.
    rows, columns : mapping str -> slice
        Of the matrix; parameters have their paths as names.
    states : list of State
        The run at these times.
    trajectory : Trajectory
        The run, sampled at these times and where derivatives were taken.
    error : float
        Estimated error of the derivatives along this run, relative to the largest of their column.
    layout : Layout
    """

    time: np.ndarray
    matrix: np.ndarray
    rows: Mapping[str, slice]
    columns: Mapping[str, slice]
    states: list[State]
    trajectory: Trajectory
    error: float
    layout: Layout

    __dir__ = public_names

    def __repr__(self) -> str:
        times, rows, columns = self.matrix.shape
        return f"Sensitivities({rows} components at {times} times, by {columns} columns)"

    def _repr_html_(self) -> str:
        parameters = ", ".join(list(self.columns)[len(self.rows) :])
        facts = {"times": len(self.time), "parameters": parameters, "error": f"{self.error:.1e}"}
        return facts_html("Sensitivities", facts)

    @property
    def object_pose(self) -> Sensitivity:
        """Of a shift [m] and a turn [rad] of the object, blocks (K, 6, ...)."""
        return self._sensitivity(self.rows["object_pose"])

    @property
    def object_twist(self) -> Sensitivity:
        """Of the object's twist, blocks (K, 6, ...)."""
        return self._sensitivity(self.rows["object_twist"])

    @cached_property
    def joint_positions(self) -> Mapping[str, Sensitivity]:
        """Of the joint positions by arm, blocks (K, n_i, ...)."""
        return self._by_arm("joint_positions")

    @cached_property
    def joint_velocities(self) -> Mapping[str, Sensitivity]:
        """Of the joint velocities by arm, blocks (K, n_i, ...)."""
        return self._by_arm("joint_velocities")

    def _sensitivity(self, rows: slice) -> Sensitivity:
        return Sensitivity(self.matrix[:, rows], self.layout, self.columns)

    def _by_arm(self, quantity: str) -> dict[str, Sensitivity]:
        first, dofs = self.rows[quantity].start, self.layout.dofs
        return {
            name: self._sensitivity(slice(first + a, first + b))
            for name, a, b in zip(self.layout.names, dofs, dofs[1:], strict=False)
        }


class _Walk(NamedTuple):
    """The result of a walk over all panels."""

    error: float
    shares: np.ndarray
    at: dict[float, np.ndarray]  # (D, D + P) at all bounds of panels


def sensitivities(
    system: System,
    times: ArrayLike,
    *,
    parameters: Sequence[str] = (),
    accuracy: float | None = None,
    state: State | None = None,
    start_time: float = 0.0,
    progress: bool | Report | None = None,
) -> Sensitivities:
    """Differentiate the states of a run by its start and by numbers of the scene.

    By the variational equation along the run (:mod:`multiarm.gradients.sensitivities`).

    >>> S = ma.sensitivities(system, [0.5, 1.0], parameters=["object.mass"])
    >>> S.joint_positions["left"].d_object_twist, S.object_pose.d_parameter("object.mass")

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
    start, begin = None if state is None else system.checked(state), require_time(start_time)
    at = increasing_times(np.asarray(times, dtype=float))
    if at[0] < begin or not at[-1] > begin:
        raise SceneError(
            f"'times' must be after the start of the run at {begin:.9g} s, got {at[0]:.9g} s"
        )
    with displayed(progress, Progress) as show:
        along = Along(system, begin, float(at[-1]) - begin, accuracy, start, parameters)
        panels = along.panels(at)

        def walk(over: list[Panel], report: Callable[[int], None]) -> _Walk:
            return _forward(along, over, report)

        found = along.to_accuracy(panels, walk, show)
    rows, columns = state_columns(along.layout), state_columns(along.layout)
    for path in parameters:
        columns[path] = slice(end := max(own.stop for own in columns.values()), end + 1)
    return Sensitivities(
        time=at,
        matrix=np.stack([found.at[t] for t in at.tolist()]),
        rows=rows,
        columns=columns,
        states=[along.state(t) for t in at.tolist()],
        trajectory=along.trajectory,
        error=found.error,
        layout=along.layout,
    )


def _forward(along: Along, panels: list[Panel], report: Callable[[int], None]) -> _Walk:
    """Solve the variational equation over all panels, and for its error."""
    size, count = along.size, len(along.parameters)
    S = along.bound(along.begin).forward(np.hstack([np.eye(size), along.start_by_parameters()]))
    error, at, sizes = np.zeros_like(S), {along.begin: S}, np.abs(S).max(axis=0)
    missing, errors = [], []
    nothing = np.zeros((3, size, size + count))
    for k, panel in enumerate(panels):
        whole = _over(along, panel, S)
        for half in panel.halves:
            collocation, _, _ = along.solved(half)
            S, error = _over(along, half, S), collocation.forward(error, nothing)
        missed = (whole - S) / RICHARDSON
        bound = along.bound(panel.end)
        S, error = bound.forward(S), bound.admissible @ (error + missed)
        missing.append(np.abs(bound.admissible @ missed).max(axis=0))
        errors.append(np.abs(error).max(axis=0))
        sizes = np.maximum(sizes, np.abs(S).max(axis=0))
        at[panel.end] = S
        report(k + 1)
    sizes = np.maximum(sizes, TINY)
    return _Walk(float((errors / sizes).max()), (missing / sizes).max(axis=1), at)


def _over(along: Along, panel: Panel, S: np.ndarray) -> np.ndarray:
    """Solve the variational equation over one panel."""
    collocation, _, by_parameters = along.solved(panel)
    b = np.zeros((3, *S.shape))
    b[:, :, along.size :] = by_parameters
    return collocation.forward(S, b)
