r"""The variational equation of a run: how nearby motions differ from it.

A nearby motion is displaced by :math:`\delta = (\delta x, \theta, \delta v_o, \delta q, \delta
\dot q)`: a shift of the object and a rotation vector, world axes, a change of its twist, of the
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
numbers.  Where they move the joints themselves, as lengths do, nearby motions keep
:math:`C\delta = -\partial(\varphi, \dot\varphi)/\partial p\;\delta p`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.assembly.compilation import compile_system
from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.contacts.table import KIND, TANGENT
from multiarm.dynamics import evaluation
from multiarm.dynamics.sensitivity import STATE, Derivatives, Motions, columns_of
from multiarm.dynamics.state import Layout, State
from multiarm.dynamics.system import System
from multiarm.errors import MultiarmError, SceneError, SolverError
from multiarm.events.evaluation import evaluate
from multiarm.scene.changes import parse_path, value_at
from multiarm.scene.faults import place, shown
from multiarm.simulation.setup import positive
from multiarm.spatial import skew

# Displacement of a difference, as part of the size of a number of the scene; numbers below the
# second may be roundings of zero, and have the size 1.
PART, ROUNDING = 1e-3, 1e-6
# Larger gaps [m] and gap rates [m/s] are those that a parameter makes.
CLOSED = 1e-5
OFFSETS = {-2.0: 1.0 / 12.0, -1.0: -2.0 / 3.0, 1.0: 2.0 / 3.0, 2.0: -1.0 / 12.0}


class Variation(NamedTuple):
    """The variational equation at one state, D = 12 + 2 n.

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


def state_columns(layout: Layout) -> dict[str, slice]:
    """Where the parts of a displacement are: first among the columns of derivatives."""
    columns = columns_of(layout, 0, False)
    return {name: columns[name] for name in STATE}


def variation(derivatives: Derivatives) -> tuple[np.ndarray, np.ndarray]:
    """``A`` and ``B`` from the derivatives of the accelerations."""
    layout, rows, columns = derivatives.layout, derivatives.rows, derivatives.columns
    at, size = state_columns(layout), 12 + 2 * layout.joints
    A, B = np.zeros((size, size)), np.zeros((size, layout.joints))
    A[at["object_pose"], at["object_twist"]] = np.eye(6)
    A[3:6, 3:6] = skew(derivatives.evaluation.state.object_twist[3:])
    A[at["joint_positions"], at["joint_velocities"]] = np.eye(layout.joints)
    for velocity, acceleration in (
        ("object_twist", "object_acceleration"),
        ("joint_velocities", "joint_accelerations"),
    ):
        own = derivatives.matrix[rows[acceleration]]
        A[at[velocity]], B[at[velocity]] = own[:, :size], own[:, columns["torques"]]
    return A, B


def displacement(start: State, end: State) -> np.ndarray:
    """The displacement from one state to another nearby, shape (D,)."""
    moved, faster = start.displacement_to(end), end.velocity - start.velocity
    return np.concatenate([moved[:6], faster[:6], moved[6:], faster[6:]])


def displaced(state: State, delta: np.ndarray) -> State:
    """A state with a displacement, shape (D,)."""
    n = state.layout.joints
    moved = state.displaced(np.r_[delta[:6], delta[12 : 12 + n]])
    moved.velocity[:] += np.r_[delta[6:12], delta[12 + n :]]
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
            size = abs(value) if abs(value) > ROUNDING else 1.0
        self.path, self.size = path, positive(f"parameters[{path!r}]", size)
        self._start, step = system.initial_state(), PART * self.size
        self._systems = {
            weight / step: _with_value(system, path, value + offset * step)
            for offset, weight in OFFSETS.items()
        }

    def of_start(self) -> np.ndarray:
        """The derivative of the scene's start, shape (D,)."""
        own, found = self._start, np.zeros(12 + 2 * self._start.layout.joints)
        for weight, system in self._systems.items():
            found += weight * displacement(own, system.initial_state())
        return found

    def at(self, t: float, state: State) -> tuple[np.ndarray, np.ndarray]:
        """The derivatives of the state's rate at a time [s], shape (D,), and of gaps and gap rates.

        Those are in the order of :attr:`multiarm.dynamics.sensitivity.Motions.constraint`.

        Raises
        ------
        SolverError
            When the parameter moves contacts that can open.
        """
        found = [(w, *self._evaluated(system, t, state)) for w, system in self._systems.items()]
        rate = np.sum([w * accelerations for w, accelerations, _ in found], axis=0)
        gaps = np.sum([w * residuals for w, _, residuals in found], axis=0)
        still = np.zeros(6), np.zeros(state.layout.joints)
        return np.concatenate([still[0], rate[:6], still[1], rate[6:]]), gaps

    def _evaluated(self, system: System, t: float, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations of one system, and its gaps and gap rates."""
        if system.model.unilateral is None:
            with system.borrow() as data:
                found = evaluation.evaluate(data, t, state)
                codes, contacts = data.model.constants.codes, data.arrays.contacts
                gaps = contacts[codes[:, KIND] != TANGENT, GAP]
                return found.accelerations, np.concatenate([gaps, contacts[:, GAP_RATE]])
        found = evaluate(system, t, state)
        if max(found.position_residual, found.velocity_residual) > CLOSED:
            raise SolverError(
                f"the parameter {self.path} moves contacts that can open; a run is differentiated "
                "by such numbers only where all contacts hold both ways"
            )
        return found.accelerations, np.zeros(0)


def _with_value(system: System, path: str, value: float) -> System:
    control = system.model.python_control
    try:
        other = compile_system(system.scene.replace({path: value}), like=system)
    except MultiarmError as error:
        raise SceneError(
            f"{path}: derivatives by it need the scene with {value:.9g}, which cannot be compiled; "
            f"name a smaller size, `parameters={{{path!r}: ...}}` ({error})"
        ) from None
    if control is not None and not control.in_scene:
        other = other.with_control(control.function)
    return other
