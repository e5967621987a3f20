r"""The linear system near one state, in minimal coordinates.

With the coordinates :math:`\eta, \zeta` of :mod:`multiarm.linear.coordinates` and the states z of
effects, such as the torques of lagging drives,

.. math:: y = (\eta, \zeta, z), \qquad
    \dot y = \dot y_0 + A y + B \tau, \qquad  o = C y + D \tau,

where :math:`\tau` are torques that are added to the joints.  The accelerations' derivatives
:math:`\dot{\delta\nu} = A_p u + A_v \delta\nu + A_z z + A_\tau \tau` are those of
:mod:`multiarm.dynamics.derivatives`; with :math:`u = E_p\eta` and :math:`\delta\nu = E_v \zeta + K
\eta`, and as a rotation vector changes by :math:`\dot\theta = \omega + \tfrac12\,\omega\times\theta
+ \ldots`,

.. math::
    \dot\eta &= S_p\,\big((\Omega E_p + K)\,\eta + E_v\, \zeta\big), \qquad
        \Omega = \mathrm{blkdiag}(0, \tfrac12 [\omega\times], 0) \\
    \dot\zeta &= S_v\,\big((A_p E_p + A_v K)\,\eta + A_v E_v\, \zeta + A_z z + A_\tau \tau\big) .

Control and loads are those of one time; sampled control is taken as continuous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from multiarm.assembly.start import project_start
from multiarm.dynamics.sensitivity import Derivatives
from multiarm.dynamics.state import State, checked_vector
from multiarm.dynamics.system import System, require_system
from multiarm.errors import MultiarmError, SolverError
from multiarm.events.derivatives import derivatives
from multiarm.linear.coordinates import Coordinates, minimal_coordinates
from multiarm.linear.modes import Mode, natural_modes, stability_of
from multiarm.notation import count_of
from multiarm.public import facts_html, public_names
from multiarm.scene.faults import unknown

__all__ = ["LinearSystem", "linearise"]

# Components of a displacement of an object.
OF_OBJECT = ("x", "y", "z", "turn_x", "turn_y", "turn_z")


@dataclass(frozen=True, repr=False)
class LinearSystem:
    """``y' = rate + A y + B torques``, ``outputs = C y + D torques`` near a state.

    Attributes
    ----------
    system : System
    derivatives : Derivatives
        Of the evaluation at the state.
    coordinates : Coordinates
    A, B, C, D : ndarray, shapes (s, s), (s, n), (o, s), (o, n)
        States are displacements, velocities and states of effects; inputs are torques [N m] or
        forces [N] that are added to those of the control; outputs are changes of all displacements
        (objects: shift [m] and rotation vector [rad] in world axes; joints [rad, m]), of all
        velocities, and of the contact forces [N] that are unique.
    rate : ndarray, shape (s,)
        ``y'`` at the state itself; zero at an equilibrium.
    state_names, input_names, output_names : tuple of str
        Such as ``object/turn_z``, ``object/turn_z'`` for its rate, ``left/elbow_joint``; of an
        object below ``objects:`` with its name, ``beam/turn_z``.
    """

    system: System
    derivatives: Derivatives
    coordinates: Coordinates
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    rate: np.ndarray
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]

    __dir__ = public_names

    def __repr__(self) -> str:
        return (
            f"LinearSystem({count_of(len(self.state_names), 'state')}, "
            f"{count_of(len(self.input_names), 'input')}, "
            f"{count_of(len(self.output_names), 'output')}; {self.stability})"
        )

    def _repr_html_(self) -> str:
        facts: dict[str, object] = {
            "states": ", ".join(self.state_names),
            "inputs": len(self.input_names),
            "outputs": len(self.output_names),
            "stability": self.stability,
        }
        return facts_html("LinearSystem", facts)

    @property
    def state(self) -> State:
        """The state at which the system was linearised."""
        return self.derivatives.evaluation.state

    @property
    def largest_acceleration(self) -> float:
        """Of an object [m/s^2, rad/s^2] or a joint [rad/s^2, m/s^2] at the state itself."""
        return float(np.abs(self.derivatives.evaluation.accelerations).max())

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """The natural motions, slowest first; a pair of conjugate eigenvalues is one."""
        size = len(self.coordinates.displacement)
        return natural_modes(self.A, self.B, self.C[:size], self.output_names[:size])

    @cached_property
    def controllable(self) -> bool:
        """Whether torques reach every state."""
        return all(mode.controllable for mode in self.modes)

    @property
    def stability(self) -> str:
        """``"stable"``, ``"unstable"``, or ``"undecided"`` where the linear terms do not tell.

        Of the motion near an equilibrium; elsewhere of the linear terms alone.
        """
        return stability_of(self.modes)

    def coordinates_of(self, state: State) -> np.ndarray:
        """The coordinates y of a state near this one, shape (s,); states of effects are zero.

        Raises
        ------
        ModelError
            For a state of other arms.
        """
        start, end = self.state, self.system.checked(state)
        moved, faster = start.displacement_to(end), end.velocity - start.velocity
        positions, velocities = self.coordinates.positions, self.coordinates.velocities
        y = np.zeros(len(self.A))
        y[: len(positions)] = moved[list(positions)]
        y[len(positions) : len(positions) + len(velocities)] = faster[list(velocities)]
        return y

    def state_at(self, y: np.ndarray) -> State:
        """The state with coordinates y, to first order, put on the joints.

        States of effects are not in it.

        Raises
        ------
        ModelError
            When y does not fit, or is too far for the joints to be closed.
        """
        y, at = checked_vector("y", y, len(self.A)), self.coordinates
        p, m = len(at.positions), len(at.velocities)
        moved, faster = at.displacement @ y[:p], at.turning @ y[:p] + at.velocity @ y[p : p + m]
        state = self.state.displaced(moved)
        state.velocity[:] += faster
        with self.system.borrow() as data:
            return project_start(data, self.system.scene, state)[0]

    def to_scipy(
        self, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None
    ) -> Any:
        """The system for ``scipy.signal``, with the inputs and outputs that are named, or all.

        Returns
        -------
        scipy.signal.StateSpace

        Raises
        ------
        SolverError
            For an unknown name.
        """
        from scipy.signal import StateSpace

        return StateSpace(*self._matrices(inputs, outputs))

    def to_control(
        self, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None
    ) -> Any:
        """The system for the package ``control``, as of :meth:`to_scipy`, with the names.

        Returns
        -------
        control.StateSpace

        Raises
        ------
        SolverError
            For an unknown name.
        MultiarmError
            When the package is not installed.
        """
        try:
            import control
        except ImportError:
            raise MultiarmError(
                "to_control: the package 'control' is not installed; pip install control, or use "
                "to_scipy()"
            ) from None
        return control.ss(
            *self._matrices(inputs, outputs),
            states=list(self.state_names),
            inputs=list(self.input_names if inputs is None else inputs),
            outputs=list(self.output_names if outputs is None else outputs),
        )

    def _matrices(
        self, inputs: Sequence[str] | None, outputs: Sequence[str] | None
    ) -> tuple[np.ndarray, ...]:
        columns = _places("input", inputs, self.input_names)
        rows = _places("output", outputs, self.output_names)
        return self.A, self.B[:, columns], self.C[rows], self.D[np.ix_(rows, columns)]


def linearise(
    system: System, t: float = 0.0, state: State | None = None, *, closed_loop: bool = True
) -> LinearSystem:
    """Linearise a system near a state, in minimal coordinates.

    The coordinates are components of the objects' displacements, or joints, as many as the joints
    leave free, and their rates (:mod:`multiarm.linear.linearisation`).

    >>> linear = ma.linearise(system)
    >>> linear.modes[0].frequency

    Parameters
    ----------
    system : System
    t : float
        Time, for control and loads [s].
    state : State, optional
        The start when left out.  Near a state that is no equilibrium the system has a ``rate``.
    closed_loop : bool
        The control's torques depend on the state; False: they are held.

    Raises
    ------
    ModelError
        When ``system`` is no system, ``t`` no time, or ``state`` none of its states.
    SolverError
        As of :func:`multiarm.derivatives`.
    ControlError
        When a Python controller returns something unusable.
    """
    system = require_system(system, "ma.linearise(system, t, state)")
    D = derivatives(system, t, state, closed_loop=closed_loop)
    at, layout = minimal_coordinates(D.motions), D.layout
    size, e = layout.nv, len(D.effect_state_rates.matrix)
    driven = layout.driven_joints
    n = len(driven)
    p, m = len(at.positions), len(at.velocities)
    by_y, by_torques = _by_coordinates(D, at)
    by_torques = by_torques[:, driven]
    velocities = np.hstack([at.turning, at.velocity, np.zeros((size, e))])
    ev, positions, rates = D.evaluation, list(at.positions), list(at.velocities)
    chart, v0 = velocities.copy(), ev.state.velocity
    for turn in layout.turns:
        chart[turn, :p] += 0.5 * np.cross(v0[turn], at.displacement[turn], axisb=0, axisc=0)
    inner = D.rows["effect_state_rates"]
    first_force = D.rows["contact_forces"].start
    forces = np.r_[D.rows["contact_forces"]]
    forces = forces[np.isfinite(D.matrix[forces]).all(axis=1)]
    names = [f"{name}/{component}" for name in layout.objects for component in OF_OBJECT]
    names += system.model.joint_names
    return LinearSystem(
        system=system,
        derivatives=D,
        coordinates=at,
        A=np.vstack([chart[positions], by_y[rates], by_y[inner]]),
        B=np.vstack([np.zeros((p, n)), by_torques[rates], by_torques[inner]]),
        C=np.vstack([np.pad(at.displacement, ((0, 0), (0, m + e))), velocities, by_y[forces]]),
        D=np.vstack([np.zeros((2 * size, n)), by_torques[forces]]),
        rate=np.concatenate([v0[positions], ev.accelerations[rates], ev.effect_state_rates]),
        state_names=(
            *(names[k] for k in positions),
            *(f"{names[k]}'" for k in rates),
            *(f"effect state {k + 1}" for k in range(e)),
        ),
        input_names=tuple(f"{system.model.joint_names[joint]}/torque" for joint in driven),
        output_names=(
            *names,
            *(f"{name}'" for name in names),
            *(_force_name(system, int(row) - first_force) for row in forces),
        ),
    )


def _by_coordinates(D: Derivatives, at: Coordinates) -> tuple[np.ndarray, np.ndarray]:
    """The derivatives of everything by y, and by torques."""
    by_position = D.matrix[:, D.layout.displacement_columns]
    by_velocity = D.matrix[:, D.layout.velocity_columns]
    by_displacement = by_position @ at.displacement + by_velocity @ at.turning
    by_inner = D.matrix[:, D.columns["effect_states"]]
    by_y = np.hstack([by_displacement, by_velocity @ at.velocity, by_inner])
    return by_y, D.matrix[:, D.columns["torques"]]


def _force_name(system: System, row: int) -> str:
    owner, record = system.model.owner(row)
    return f"{owner}/{record.name}/force"


def _places(what: str, wanted: Sequence[str] | None, names: tuple[str, ...]) -> list[int]:
    if wanted is None:
        return list(range(len(names)))
    for name in wanted:
        if name not in names:
            raise SolverError(unknown(what, name, names))
    return [names.index(name) for name in wanted]
