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

from typing import NamedTuple

import numpy as np

from multiarm.assembly.compilation import compile_system
from multiarm.assembly.linkage import projection_tolerance
from multiarm.assembly.start import project_start
from multiarm.contacts.table import Code, rolls
from multiarm.dynamics import evaluation
from multiarm.dynamics.contact_geometry import place_state
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.sensitivity import Derivatives, Motions
from multiarm.dynamics.solver.bounds import SYSTEM_TOLERANCE
from multiarm.dynamics.solver.dense import reciprocal_lengths
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError, MultiarmError, SceneError, SolverError
from multiarm.events.evaluation import evaluate
from multiarm.geometry.screws import skew
from multiarm.geometry.stencils import CENTRAL_4
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
    """

    A: np.ndarray
    B: np.ndarray
    beta: np.ndarray
    motions: Motions
    offset: np.ndarray
    slope: np.ndarray
    rate: float
    scale: np.ndarray

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
        self._gap_roundings = _gap_roundings(system)
        self._systems = [
            _with_value(system, path, value + offset * step) for offset in CENTRAL_4.offsets
        ]

    def of_start(self, t: float, state: State | None) -> np.ndarray:
        """The derivative of the state in which runs begin at a time [s], shape (D,).

        Runs begin in the scene's start, or in a given state, which is put on the joints.

        Raises
        ------
        SceneError
            When that state or its accelerations jump, or it cannot be put on the joints.
        """
        try:
            start = _start(self._system, state)
            ends = [_start(system, state) for system in self._systems]
        except ModelError as error:
            raise SceneError(
                f"{self.path}: derivatives by it need runs from `state` in scenes with values "
                "nearby, and these cannot begin there; name a smaller size, "
                f"`parameters={{{self.path!r}: ...}}` ({error})"
            ) from None
        changes = np.array([displacement(start, end) for end in ends])
        before, _ = self._evaluated(self._system, t, start)
        after = [
            self._evaluated(system, t, end)[0]
            for system, end in zip(self._systems, ends, strict=True)
        ]
        faster = (np.array(after) - before) / max(1.0, np.abs(before).max())
        if _jump(changes, START_ROUNDINGS) or _jump(faster, ACCELERATION_ROUNDINGS):
            raise SceneError(
                f"{self.path}: the start of the run, or its accelerations, do not depend on it "
                f"smoothly: they jump as it changes by {PART * self.size:.3g}; where a posture or "
                "a base that is to be found jumps, write what was found in the scene "
                "(`system.initial_state().joint_positions`); else name another size, "
                f"`parameters={{{self.path!r}: ...}}`"
            )
        return self._weights @ changes

    def at(self, t: float, state: State, motions: Motions) -> tuple[np.ndarray, np.ndarray]:
        """The derivatives of the state's rate, and of the state itself as it follows the joints.

        Parameters
        ----------
        t : float
            [s]
        state : State
        motions : Motions
            At this state.

        Returns
        -------
        rate, offset : ndarray, shape (D,)
            The accelerations at the state that follows; zero at the places of velocities.

        Raises
        ------
        SolverError
            When the parameter moves contacts that can open.
        """
        weights, systems = self._weights, self._systems
        moves = np.zeros((len(systems), 2 * state.layout.nv))
        evaluated = [self._evaluated(system, t, state) for system in systems]
        gaps = np.array([residuals for _, residuals in evaluated])
        fastest = max(1.0, np.abs(state.velocity).max())
        if np.ptp(gaps, axis=0).max(initial=0.0) > self._gap_roundings * fastest:
            C = motions.constraint
            scale = reciprocal_lengths(np.linalg.norm(C, axis=1))
            closing = np.linalg.pinv(scale[:, None] * C, SYSTEM_TOLERANCE) * scale
            for _ in range(NEWTON_STEPS):
                moves -= gaps @ closing.T
                evaluated = [
                    self._evaluated(system, t, displaced(state, move))
                    for system, move in zip(systems, moves, strict=True)
                ]
                gaps = np.array([residuals for _, residuals in evaluated])
        rate = np.zeros(2 * state.layout.nv)
        rate[state.layout.velocity_columns] = weights @ [changes for changes, _ in evaluated]
        return rate, weights @ moves

    def _evaluated(self, system: System, t: float, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations of one system, and its gaps and gap rates."""
        if system.model.unilateral is None:
            with system.borrow() as data:
                accelerations = evaluation.evaluate(data, t, state).accelerations
                contacts = data.contact_rows
                codes = fields_of(Code, data.model.constants.contacts.codes)
                gaps = contacts.gap[~rolls(codes.kind[: contacts.gap.size])]
                return accelerations, np.concatenate([gaps, contacts.gap_rate])
        evaluated = evaluate(system, t, state)
        if max(evaluated.position_residual, evaluated.velocity_residual) > CLOSED:
            raise SolverError(
                f"the parameter {self.path} moves contacts that can open; a run is differentiated "
                "by such numbers only where all contacts hold both ways"
            )
        return evaluated.accelerations, np.zeros(0)


def _jump(changes: np.ndarray, roundings: float) -> bool:
    """Whether changes by the four displacements are not those of a smooth function.

    Its first and second differences agree over the long and over the short steps.
    """
    far_back, back, ahead, far_ahead = changes
    slopes = 0.5 * (far_ahead - far_back) - (ahead - back)
    curvatures = 0.25 * (far_ahead + far_back) - (ahead + back)
    uneven, largest = np.abs([slopes, curvatures]).max(), np.abs([ahead, back]).max()
    return bool(uneven > roundings + UNEVEN * largest)


def _gap_roundings(system: System) -> float:
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
