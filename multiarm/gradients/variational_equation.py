r"""The variational equation of a run: how nearby motions differ from it.

A nearby motion is displaced by :math:`\delta = (\delta x, \theta, \delta v_o, \delta q, \delta
\dot q)`: a shift of each object and a rotation vector, world axes, a change of its twist, of the
joints and of their rates.  With the derivatives of the accelerations
(:mod:`multiarm.dynamics.derivatives`) and :math:`R_\theta = \exp(\theta) R`,

.. math::
    \dot{\delta x} = \delta v, \qquad \dot\theta = \omega\times\theta + \delta\omega, \qquad
    \dot{\delta q} = \delta\dot q, \qquad
    \dot{\delta\nu} = \frac{\partial\dot\nu}{\partial x}\,\delta
        + \frac{\partial\dot\nu}{\partial\tau}\,\delta\tau
        + \frac{\partial\dot\nu}{\partial p}\,\delta p .

Displacements that keep the gaps and their rates closed, :math:`C\delta = 0`, go on doing so.  How
many they are does not depend on the number of arms; they have coordinates of their own
(:mod:`multiarm.gradients.segments`).

*Parameters* p are numbers of the scene.  What they change of the accelerations at a state, of its
gaps, and of the start, are differences of order four between systems that are compiled with other
numbers.  A start that is given is put on the joints of each, as that of a run is: derivatives are
those of runs from the same state in other scenes.  Where parameters move the joints themselves, as
lengths do, nearby motions keep
:math:`C\delta = -\partial(\varphi, \dot\varphi)/\partial p\;\delta p`; changes of the gaps that are
roundings do not count.  Accelerations are then differentiated along states that follow the joints:
where an arm is singular they have no derivative off them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiarm.assembly.compilation import compile_system
from multiarm.assembly.linkage import projection_tolerance
from multiarm.assembly.start import project_start
from multiarm.contacts.table import Code, rolls
from multiarm.dynamics import evaluation
from multiarm.dynamics.contact_geometry import place_state
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.sensitivity import Derivatives, Motions
from multiarm.dynamics.solver.bounds import COUPLED_RANK_TOLERANCE, SYSTEM_TOLERANCE
from multiarm.dynamics.solver.dense import reciprocal_lengths
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError, MultiarmError, SceneError, SolverError
from multiarm.events.evaluation import enter_mode_at, evaluate
from multiarm.events.taking_hold import HeldJoints
from multiarm.geometry.screws import skew
from multiarm.geometry.stencils import CENTRAL_4
from multiarm.gradients.phase import Phase
from multiarm.jit.rows import fields_of
from multiarm.scene.changes import parse_path, value_at
from multiarm.scene.faults import place, shown
from multiarm.simulation.setup import positive

# Displacement of a difference, as part of the size of a number of the scene; numbers below the
# second may be roundings of zero, and have the size 1.
PART, PARAMETER_IS_ZERO = 1e-3, 1e-6
# In place of lengths that are zero.
TINY = 1e-300
# Larger gaps [m] and gap rates [m/s] are those that a parameter makes.
CLOSED = 1e-5
# Steps by which a state follows joints that a parameter moves, each with the derivatives at the
# state itself: a rest of the third order in the change is left.
NEWTON_STEPS = 2
# Changes by four displacements are those of a smooth function when they agree to this part, or to
# what closing the joints leaves of the start [m, rad] and of its accelerations, relative to these.
UNEVEN, START_ROUNDINGS, ACCELERATION_ROUNDINGS = 0.1, 1e-9, 1e-5


class VariationalEquation(NamedTuple):
    """The variational equation at one state, D = 12 F + 2 n with F objects.

    Where joints hold their bodies where they were at a switch, displacements have r further
    components, of places (:mod:`multiarm.gradients.switches`), the same number in all of a run.

    Attributes
    ----------
    A : ndarray, shape (D, D)
        By the state.
    B : ndarray, shape (D, n)
        By torques that are added to the joints.
    beta : ndarray, shape (D, P)
        By the parameters.
    motions : Motions
        Which displacements keep the joints closed.
    offset : ndarray, shape (D, P)
        Displacements that follow joints which parameters move.
    slope : ndarray, shape (D,)
        Derivatives of an integrand; zero without one.
    rate : float
        The integrand.
    scale : ndarray, shape (D, P)
        What ``beta`` is as a rule: the largest acceleration, or gravity, over a parameter's size.
    place_offset : ndarray, shape (2 nv, r)
        Displacements of the state that follow joints which have taken hold elsewhere.
    """

    A: np.ndarray
    B: np.ndarray
    beta: np.ndarray
    motions: Motions
    offset: np.ndarray
    slope: np.ndarray
    rate: float
    scale: np.ndarray
    place_offset: np.ndarray

    @property
    def numbers(self) -> int:
        """How many there are."""
        arrays = (*self, *self.motions)
        return sum(part.size for part in arrays if isinstance(part, np.ndarray))


def state_matrices(derivatives: Derivatives) -> tuple[np.ndarray, np.ndarray]:
    """``A`` and ``B`` from the derivatives of the accelerations."""
    layout, rows, columns = derivatives.layout, derivatives.rows, derivatives.columns
    at, size = layout.columns, 2 * layout.nv
    A, B = np.zeros((size, size)), np.zeros((size, layout.rate_count))
    A[layout.displacement_columns, layout.velocity_columns] = 1.0
    v = derivatives.evaluation.state.velocity
    for turn in layout.turns:
        columns_of_turn = layout.displacement_columns[turn]
        A[np.ix_(columns_of_turn, columns_of_turn)] = skew(v[turn])
    for velocity, acceleration in (
        ("object_twist", "object_acceleration"),
        ("joint_velocities", "joint_accelerations"),
    ):
        by_all = derivatives.matrix[rows[acceleration]]
        A[at[velocity]], B[at[velocity]] = by_all[:, :size], by_all[:, columns["torques"]]
    return A, B


def displacement(start: State, end: State) -> np.ndarray:
    """The displacement from one state to another nearby, shape (D,)."""
    layout = start.layout
    delta = np.empty(2 * layout.nv)
    delta[layout.displacement_columns] = start.displacement_to(end)
    delta[layout.velocity_columns] = end.velocity - start.velocity
    return delta


def displaced(state: State, delta: np.ndarray) -> State:
    """A state with a displacement, shape (D,)."""
    moved = state.displaced(delta[state.layout.displacement_columns])
    moved.velocity[:] += delta[state.layout.velocity_columns]
    return moved


class Parameter:
    """A number of a scene, by which a run is differentiated.

    Parameters
    ----------
    system : System
    path : str
        Such as ``object.mass``, see :mod:`multiarm.scene.changes`.
    size : float, optional
        A change of the number that changes motions as a whole; a thousandth of it is tried.  The
        number itself when left out.

    Attributes
    ----------
    path : str
    size : float
    systems : list of System
        With the numbers of a difference of order four.

    Raises
    ------
    SceneError
        When there is no number at the path, or the scene cannot be compiled with others nearby.
    """

    def __init__(self, system: System, path: str, size: float | None = None) -> None:
        parts = parse_path(path)
        value = value_at(system.scene, path)
        if parts[0] == "run":
            raise SceneError(f"{place(parts)}: settings of the run are no parameters of the motion")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise SceneError(
                f"{place(parts)}: expected a number to differentiate by, got {shown(value)}"
            )
        if size is None:
            size = abs(value) if abs(value) > PARAMETER_IS_ZERO else 1.0
        self.path, self.size = path, positive(f"parameters[{path!r}]", size)
        self._system, step = system, PART * self.size
        self._weights = np.array(CENTRAL_4.weights) / step
        self._gap_roundings = gap_roundings(system)
        self.systems = [
            _with_value(system, path, value + offset * step) for offset in CENTRAL_4.offsets
        ]

    def of_start(self, t: float, state: State | None, phase: Phase) -> np.ndarray:
        """The derivative of the state in which runs begin at a time [s], shape (D,).

        Runs begin in the scene's start, or in a given state, which is put on the joints.

        Raises
        ------
        SceneError
            When that state or its accelerations jump, or it cannot be put on the joints.
        """
        try:
            start = _start(self._system, state)
            ends = [_start(system, state) for system in self.systems]
        except ModelError as error:
            raise SceneError(
                f"{self.path}: derivatives by it need runs from `state` in scenes with values "
                "nearby, and these cannot begin there; name a smaller size, "
                f"`parameters={{{self.path!r}: ...}}` ({error})"
            ) from None
        changes = np.array([displacement(start, end) for end in ends])
        before, _ = evaluated(self._system, t, start, phase.held(self._system), self.path)
        after = [
            evaluated(system, t, end, phase.held(system), self.path)[0]
            for system, end in zip(self.systems, ends, strict=True)
        ]
        faster = (np.array(after) - before) / max(1.0, np.abs(before).max())
        if jumps(changes, START_ROUNDINGS) or jumps(faster, ACCELERATION_ROUNDINGS):
            raise SceneError(
                f"{self.path}: the start of the run, or its accelerations, do not depend on it "
                f"smoothly: they jump as it changes by {PART * self.size:.3g}; where a posture or "
                "a base that is to be found jumps, write what was found in the scene "
                "(`system.initial_state().joint_positions`); else name another size, "
                f"`parameters={{{self.path!r}: ...}}`"
            )
        return self._weights @ changes

    def at(
        self, t: float, state: State, motions: Motions, phase: Phase
    ) -> tuple[np.ndarray, np.ndarray]:
        """The derivatives of the state's rate, and of the state itself as it follows the joints.

        Parameters
        ----------
        t : float
            [s]
        state : State
        motions : Motions
            At this state.
        phase : Phase
            Of the run at this time.

        Returns
        -------
        rate, offset : ndarray, shape (D,)
            The accelerations at the state that follows; zero at the places of velocities.

        Raises
        ------
        SolverError
            When the parameter moves contacts that can open.
        """
        nearby = [Nearby(system, phase.held(system)) for system in self.systems]
        return response(nearby, self._weights, t, state, motions, self._gap_roundings, self.path)


class Nearby(NamedTuple):
    """A system beside that of the run, or with joints that have taken hold elsewhere."""

    system: System
    held: HeldJoints | None


def response(
    nearby: Sequence[Nearby],
    weights: np.ndarray,
    t: float,
    state: State,
    motions: Motions,
    roundings: float,
    path: str = "",
) -> tuple[np.ndarray, np.ndarray]:
    """Differences, with some weights, of a state's rate, and of the state as it follows the joints.

    Changes of the gaps [m] that are ``roundings`` do not count.  As of :meth:`Parameter.at`.
    """
    moves = np.zeros((len(nearby), 2 * state.layout.nv))
    results = [evaluated(system, t, state, held, path) for system, held in nearby]
    gaps = np.array([residuals for _, residuals in results])
    fastest = max(1.0, np.abs(state.velocity).max())
    if np.ptp(gaps, axis=0).max(initial=0.0) > roundings * fastest:
        closing = closing_of(motions)
        for k, (system, held) in enumerate(nearby):
            for _ in range(NEWTON_STEPS):
                moves[k] -= closing @ results[k][1]
                results[k] = evaluated(system, t, displaced(state, moves[k]), held, path)
    rate = np.zeros(2 * state.layout.nv)
    rate[state.layout.velocity_columns] = weights @ [changes for changes, _ in results]
    return rate, weights @ moves


def closing_of(motions: Motions) -> np.ndarray:
    """The least displacements that change gaps and gap rates by one, (D, K + N)."""
    C = motions.constraint
    scale = reciprocal_lengths(np.linalg.norm(C, axis=1))
    # the rank is that of the displacements that keep the joints closed
    tolerance = SYSTEM_TOLERANCE if motions.independent else COUPLED_RANK_TOLERANCE
    return np.linalg.pinv(scale[:, None] * C, tolerance) * scale


def evaluated(
    system: System, t: float, state: State, held: HeldJoints | None, path: str = ""
) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations of a system, and its gaps and gap rates.

    ``path`` is that of the number by which it differs from the run's.
    """
    unilateral = system.model.unilateral
    if unilateral is None:
        with system.borrow() as data:
            accelerations = evaluation.evaluate(data, t, state).accelerations
            return accelerations, _closed_gaps(data)
    if held is None:
        result = evaluate(system, t, state)
        if max(result.position_residual, result.velocity_residual) > CLOSED:
            raise _moves_contacts(path)
        return result.accelerations, np.zeros(0)
    with system.borrow() as data:
        modes = enter_mode_at(data, t, state, held)
        accelerations = evaluation.evaluate(modes.data, t, state).accelerations
        rows = modes.data.contact_rows
        enforced = [row in unilateral.enforced for row in modes.data.rows.tolist()]
        if np.abs([rows.gap[enforced], rows.gap_rate[enforced]]).max(initial=0.0) > CLOSED:
            raise _moves_contacts(path)
        return accelerations, _closed_gaps(modes.data)


def _closed_gaps(data: Data) -> np.ndarray:
    """Gaps that joints keep closed, and rates of all rows, at the last evaluation."""
    contacts = data.contact_rows
    codes = fields_of(Code, data.model.constants.contacts.codes)
    gaps = contacts.gap[~rolls(codes.kind[: contacts.gap.size])]
    return np.concatenate([gaps, contacts.gap_rate])


def _moves_contacts(path: str) -> SolverError:
    what = f"the parameter {path}" if path else "a joint that takes hold elsewhere"
    return SolverError(
        f"{what} moves contacts that can open; a run is differentiated by such numbers only where "
        "all contacts hold both ways"
    )


def jumps(changes: np.ndarray, roundings: float) -> bool:
    """Whether changes by the four displacements are not those of a smooth function.

    Its first and second differences agree over the long and over the short steps.
    """
    far_back, back, ahead, far_ahead = changes
    slopes = 0.5 * (far_ahead - far_back) - (ahead - back)
    curvatures = 0.25 * (far_ahead + far_back) - (ahead + back)
    uneven, largest = np.abs([slopes, curvatures]).max(), np.abs([ahead, back]).max()
    return bool(uneven > roundings + UNEVEN * largest)


def gap_roundings(system: System) -> float:
    """Gaps that are roundings of the coordinates at the scene's start [m]."""
    with system.borrow() as data:
        place_state(data, 0.0, system.initial_state())
        require_ok(data, update_kinematics(data.struct))
        return projection_tolerance(data)


def _start(system: System, state: State | None) -> State:
    """The state in which a run of a system begins."""
    if state is None:
        return system.initial_state()
    with system.borrow() as data:
        return project_start(data, system.scene, state)[0]


def _with_value(system: System, path: str, value: float) -> System:
    control = system.model.python_control
    try:
        nearby = compile_system(system.scene.replace({path: value}), like=system)
    except MultiarmError as error:
        raise SceneError(
            f"{path}: derivatives by it need the scene with {value:.9g}, which cannot be compiled; "
            f"name a smaller size, `parameters={{{path!r}: ...}}` ({error})"
        ) from None
    if control is not None and not control.in_scene:
        nearby = nearby.with_control(control.function)
    return nearby
