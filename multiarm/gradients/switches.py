r"""Switches of timed joints: how motions near a run take hold and let go.

At a switch at the time :math:`t_s` a run has the state x, and rates f before and f' after it.
Taking hold changes velocities as momentum says, :math:`x' = R(x, p)`
(:mod:`multiarm.events.taking_hold`); letting go changes nothing, R = 1.  A nearby motion switches
at :math:`t_s + \delta t`, so that seen at :math:`t_s`

.. math::
    \delta' = D_x R\,(\delta + f\,\delta t) + D_p R\,\delta p - f'\,\delta t .

A time of the scene is the same in all motions, :math:`\delta t = 0`, or is itself the number by
which the run is differentiated, :math:`\delta t = \delta p`.  A function g(t, x) that falls to zero
delays the switch by

.. math:: \delta t = -\frac{D_x g\,\delta}{D_t g + D_x g\,f}

(the saltation matrix; R.I. Leine, H. Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical
Systems, 2004, ch. 7).  An integral of a function :math:`\ell(t, x)` gains
:math:`(\ell(x) - \ell(x'))\,\delta t`, as the motion before the switch lasts longer.  Gradients
follow the transposed map.

*Places.*  A joint without a place of its own holds its bodies where they are at the switch: nearby
motions are held elsewhere from then on.  With the basis N of displacements that keep the joints
before the switch closed, :math:`c = N^T(\delta + f\,\delta t)` says where the bodies of a nearby
motion are; :math:`\rho = V^T c` are the parts of it on which the places of joints depend, further
components of a displacement that stay constant until the next switch.  There c contains them.
Motions go on with joints elsewhere as they do in a scene with another number: what that changes of
the accelerations, and how states follow the joints, are differences of order four
(:mod:`multiarm.gradients.variational_equation`).

R and places are differentiated along c and along the parameters, by differences of order four, too,
over states that are put on the joints which hold before the switch: where constraints are dependent
or postures singular, R has derivatives in these directions only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from multiarm.assembly.linkage import projection_tolerance
from multiarm.contacts.unilateral import DRY_JOINT
from multiarm.dynamics.evaluation import place_start
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.sensitivity import Motions, free_bases
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.events.derivatives import derivatives_while
from multiarm.events.evaluation import SLOW, enter_mode_at, modes_of
from multiarm.events.modes import Modes
from multiarm.events.row_dynamics import RowDynamics
from multiarm.events.taking_hold import HeldJoints, hold_placed, switch_without_limits
from multiarm.geometry.stencils import CENTRAL_4
from multiarm.gradients.phase import Phase
from multiarm.gradients.switch_times import SwitchTime
from multiarm.gradients.variational_equation import (
    PART,
    Nearby,
    Parameter,
    closing_of,
    displaced,
    displacement,
    evaluated,
    jumps,
    response,
)
from multiarm.integration.projection import project
from multiarm.results.contact_states import ContactState

# Newton steps, at most, that put a nearby state on the joints.
NEWTON_STEPS = 8
# Displacements of nearby motions, in differences of order four [m, rad, m/s, rad/s].
NEARBY = 1e-4
# Switches that are nearer to each other count as one [s]; so do samples to a switch, as those that
# are nearer than a part 1e-9 of a step are written before it.
SOON = 1e-8
# Displacement of differences of a user's function [m, rad, s].
DISPLACEMENT = 1e-4
# Places that change by less than this part of the displacement do not depend on it.
SAME_PLACE = 1e-8
# A function whose rate is this part of its terms, or less, does not pass through zero.
GRAZES = 1e-8
# What is left of states that are put on the joints [m, rad, m/s, rad/s].
ROUNDINGS = 1e-9


# An integrand, and its derivatives by a displacement of the state.
Slope = Callable[[float, State], tuple[float, np.ndarray]]


class Crossed(NamedTuple):
    """A motion right after a switch."""

    state: State
    held: HeldJoints


class Jump(NamedTuple):
    """How displacements of the state, with coordinates of places, change at a switch.

    Attributes
    ----------
    by_state : ndarray, shape (D, D)
    by_parameters : ndarray, shape (D, P)
    scale : ndarray, shape (P,)
        What ``by_parameters`` is as a rule: the largest rate of the state, over a parameter's size.
    integral_by_state : ndarray, shape (D,)
        What an integral along the run gains; zero without one.
    integral_by_parameters : ndarray, shape (P,)
    """

    by_state: np.ndarray
    by_parameters: np.ndarray
    scale: np.ndarray
    integral_by_state: np.ndarray
    integral_by_parameters: np.ndarray


class Switched(Phase):
    """What timed joints do from a switch on.

    Parameters
    ----------
    system : System
    before : Phase
    joints : frozenset of int
        Timed joints that hold from now on.
    t : float
        [s]
    state : State
        Before the switch.
    moments : sequence of (int, int)
        The moments of joints that have come.
    function : callable or None
        That has fallen to zero; None: the switch is at a time of the scene.
    like : Switched or None
        The same switch in a run nearby, whose coordinates are to be used.
    """

    def __init__(
        self,
        system: System,
        before: Phase,
        joints: frozenset[int],
        t: float,
        state: State,
        moments: Sequence[tuple[int, int]],
        function: Callable | None,
        like: Switched | None,
    ) -> None:
        assert before.joints is not None, "the system has timed joints"
        super().__init__(joints)
        self.time, self.moments, self.function = t, tuple(moments), function
        self._system, self._before, self._state = system, before, state
        self._like, self._taking = like, joints - before.joints
        self._known: dict[tuple[int, bytes], Crossed] = {}
        if self._taking:
            self._require_free_contacts(before.held(system), state)

    # --- nearby motions ---------------------------------------------------------------------------

    @cached_property
    def after(self) -> Crossed:
        """The run right after the switch."""
        after = self._crossed(self._system, None)
        if self._taking:
            self._require_free_contacts(after.held, after.state)
        return after

    @cached_property
    def rate_after(self) -> np.ndarray:
        """The rate f' of the state right after the switch, (D,)."""
        return self._rate(self.after.state, self.after.held)

    @property
    def size(self) -> int:  # type: ignore[override]
        """How many coordinates the places of joints have."""
        return self._places.shape[1]

    def held(self, system: System, places: np.ndarray | None = None) -> HeldJoints:
        """What timed joints hold, see :meth:`Phase.held`."""
        coordinates = None if places is None else self._places @ places
        return self._crossed(system, coordinates).held

    def _crossed(self, system: System, coordinates: np.ndarray | None) -> Crossed:
        """A nearby motion right after the switch, by its coordinates c before; None: the run."""
        key = id(system), b"" if coordinates is None else coordinates.tobytes()
        if key not in self._known:
            self._known[key] = self._cross(system, *self._put_on_joints(system, coordinates))
        return self._known[key]

    def _put_on_joints(
        self, system: System, coordinates: np.ndarray | None
    ) -> tuple[State, HeldJoints]:
        """A nearby motion right before the switch."""
        state, before = self._state, self._before
        if coordinates is None and system is self._system:
            held = before.held(system)
            assert held is not None
            return state, held
        places = None
        if coordinates is not None:
            d = self._basis.shape[1]
            state = displaced(state, self._basis @ coordinates[:d])
            places = coordinates[d:] if before.size else None
        held = before.held(system, places)
        assert held is not None
        return _followed(system, self.time, state, held, self._closing), held

    def _cross(self, system: System, state: State, held: HeldJoints) -> Crossed:
        """Take hold and let go, and put the state on the joints that have closed."""
        assert self.joints is not None
        with system.borrow() as data:
            modes = _placed(modes_of(data, SLOW), self.time, state, held)
            switch_without_limits(modes, self.joints)
            if self._taking:
                bilateral = modes.bilateral
                require_ok(bilateral, project(bilateral.struct, projection_tolerance(data)))
                state = bilateral.get_state()
            timed = modes.unilateral.timed
            switched = held.places.keys() | self._taking
            places = {
                k: held.places[k] if k not in self._taking else modes.pose_of(k)
                for k in sorted(switched & self.joints)
                if timed[k].located
            }
            return Crossed(state, HeldJoints(self.joints, places))

    # --- derivatives ------------------------------------------------------------------------------

    def responses(
        self, t: float, state: State, motions: Motions, A: np.ndarray, roundings: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`Phase.responses`."""
        columns, weights = [], np.array(CENTRAL_4.weights) / NEARBY
        closing = closing_of(motions) if motions.independent and self.size else None
        for unit in np.eye(self.size):
            nearby = [
                Nearby(self._system, self.held(self._system, offset * NEARBY * unit))
                for offset in CENTRAL_4.offsets
            ]
            if closing is None:
                along, offset = response(nearby, weights, t, state, motions, roundings)
                columns.append((along - A @ offset, offset))
                continue
            # there are accelerations off the joints, too
            results = [evaluated(system, t, state, held) for system, held in nearby]
            change = np.zeros(len(A))
            change[state.layout.velocity_columns] = weights @ [rates for rates, _ in results]
            columns.append((change, -closing @ (weights @ [gaps for _, gaps in results])))
        by_place, offsets = np.reshape(columns, (self.size, 2, len(A))).transpose(1, 2, 0)
        return by_place, offsets

    @cached_property
    def _motions(self) -> Motions:
        held = self._before.held(self._system)
        return derivatives_while(held, self._system, self.time, self._state).motions

    @cached_property
    def _closing(self) -> np.ndarray:
        return closing_of(self._motions)

    @cached_property
    def _basis(self) -> np.ndarray:
        """N, (D, d)."""
        (basis,) = free_bases([self._motions])
        if self._like is None:
            return basis
        return basis @ (basis.T @ self._like._basis)

    @cached_property
    def _differences(self) -> tuple[np.ndarray, np.ndarray]:
        """By c, of the state after the switch (D, m) and of the places of all joints (6 J, m)."""
        count = self._basis.shape[1] + self._before.size
        by_state, by_place = [], []
        for unit in np.eye(count):
            nearby = [
                self._crossed(self._system, offset * NEARBY * unit) for offset in CENTRAL_4.offsets
            ]
            by_state.append(self._difference(nearby, NEARBY))
            weights = np.array(CENTRAL_4.weights) / NEARBY
            by_place.append(weights @ [self._moved_places(motion) for motion in nearby])
        return np.array(by_state).T, np.array(by_place).T

    def _difference(self, nearby: Sequence[Crossed], step: float) -> np.ndarray:
        changes = np.array([displacement(self.after.state, motion.state) for motion in nearby])
        if jumps(changes, ROUNDINGS):
            raise SolverError(
                f"derivatives of a run: at t = {self.time:.9g} s {self._names} "
                "to bodies whose velocities afterwards do not depend smoothly on the motion "
                "before: the rank of the constraints changes there; let it take hold in another "
                "posture"
            )
        return np.array(CENTRAL_4.weights) / step @ changes

    def _moved_places(self, motion: Crossed) -> np.ndarray:
        """How all placed joints differ from the run's, shift and turn, (6 J,)."""
        moved = [np.zeros(0)]
        for k, pose in self.after.held.places.items():
            nearby = motion.held.places[k]
            turned = pose[:3, :3].T @ nearby[:3, :3]
            turn = (turned - turned.T)[[2, 0, 1], [1, 2, 0]] / 2.0
            moved.append(np.append(nearby[:3, 3] - pose[:3, 3], turn))
        return np.concatenate(moved)

    @cached_property
    def _places(self) -> np.ndarray:
        """V, (m, r)."""
        if self._like is not None:
            return self._like._places
        count = self._basis.shape[1] + self._before.size
        if not self.after.held.places:
            return np.zeros((count, 0))
        if not self._taking:
            return np.eye(count)[:, self._basis.shape[1] :]
        _, by_place = self._differences
        _, lengths, directions = np.linalg.svd(by_place, full_matrices=False)
        return directions[lengths > SAME_PLACE * max(1.0, lengths.max(initial=0.0))].T

    def jump(
        self,
        parameters: Sequence[Parameter | SwitchTime],
        size: int,
        integrand: Slope | None = None,
    ) -> Jump:
        """The change of displacements of the state and of ``size - 2 nv`` coordinates of places.

        ``integrand`` is that of an integral along the run.

        Raises
        ------
        SolverError
            When there is none: velocities do not depend smoothly on the motion before, or a
            function does not pass through zero.
        """
        states, (_, d) = 2 * self._state.layout.nv, self._basis.shape
        to_coordinates = np.zeros((d + self._before.size, size))  # Z: displacement -> c
        to_coordinates[:d, :states] = self._basis.T
        to_coordinates[d:, states : states + self._before.size] = np.eye(self._before.size)
        after = np.zeros((size, size))
        after[states : states + self.size] = self._places.T @ to_coordinates
        if self._taking:
            after[:states] = self._differences[0] @ to_coordinates
        else:
            after[:states, :states] = np.eye(states)
        rate_before, rate_after = np.zeros((2, size))
        rate_before[:states] = self._rate(self._state, self._before.held(self._system))
        rate_after[:states] = self.rate_after
        of_time, delay = after @ rate_before - rate_after, self._delay(rate_before)
        by_state = after + np.outer(of_time, delay)
        by_parameters, delays = np.zeros((size, len(parameters))), np.zeros(len(parameters))
        largest, scale = np.abs([rate_before, rate_after]).max(), np.zeros(len(parameters))
        for p, parameter in enumerate(parameters):
            if isinstance(parameter, SwitchTime):
                if parameter.moment in self.moments:
                    self._require_single(parameter)
                    by_parameters[:, p], delays[p], scale[p] = of_time, 1.0, largest
            elif self._taking:
                nearby = [self._crossed(system, None) for system in parameter.systems]
                by_parameters[:states, p] = self._difference(nearby, PART * parameter.size)
                scale[p] = largest / parameter.size
        falls = 0.0
        if integrand is not None:
            (before, _), (later, _) = (
                integrand(self.time, state) for state in (self._state, self.after.state)
            )
            falls = before - later
        return Jump(by_state, by_parameters, scale, falls * delay, falls * delays)

    def _rate(self, state: State, held: HeldJoints | None) -> np.ndarray:
        """f at a state, (D,)."""
        rate, layout = np.zeros(2 * state.layout.nv), state.layout
        accelerations, _ = evaluated(self._system, self.time, state, held)
        rate[layout.displacement_columns] = state.velocity
        rate[layout.velocity_columns] = accelerations
        return rate

    def _delay(self, rate: np.ndarray) -> np.ndarray:
        """The derivative of the switch's time by a displacement."""
        delay = np.zeros_like(rate)
        if self.function is None:
            return delay
        function, t, state = self.function, self.time, self._state

        def value(t: float, state: State) -> float:
            return float(function(t, state.copy()))

        weights, states = np.array(CENTRAL_4.weights) / DISPLACEMENT, 2 * state.layout.nv
        steps = [offset * DISPLACEMENT for offset in CENTRAL_4.offsets]
        by_time = weights @ [value(t + step, state) for step in steps]
        for i, unit in enumerate(np.eye(states)):
            delay[i] = weights @ [value(t, displaced(state, step * unit)) for step in steps]
        falls = by_time + delay @ rate
        if abs(falls) <= GRAZES * (abs(by_time) + np.abs(delay) @ np.abs(rate)):
            raise SolverError(
                f"derivatives of a run: the function by which {self._names} at t = {t:.9g} s "
                "does not pass through zero there, so that nearby motions may never switch; name "
                "a function that falls"
            )
        return -delay / falls

    # --- what has no derivatives ------------------------------------------------------------------

    @property
    def _names(self) -> str:
        unilateral = self._system.model.unilateral
        assert unilateral is not None and self.joints is not None
        assert self._before.joints is not None
        words = []
        for verb, joints in (
            ("takes hold", self._taking),
            ("lets go", self._before.joints - self.joints),
        ):
            words += [f"joint '{unilateral.timed[k].connection}' {verb}" for k in sorted(joints)]
        return " and ".join(words)

    def _require_single(self, parameter: SwitchTime) -> None:
        if len(self.moments) > 1:
            raise SolverError(
                f"{parameter.path}: {self._names} at the same time {self.time:.9g} s, and which "
                "comes first depends on this number; let them be apart"
            )

    def _require_free_contacts(self, held: HeldJoints | None, state: State) -> None:
        """Refuse an impact in which contacts take part that can open or slide."""
        with self._system.borrow() as data:
            closed = _closed(enter_mode_at(data, self.time, state, held))
        if closed:
            raise SolverError(
                f"derivatives of a run: {self._names} at t = {self.time:.9g} s while "
                f"{closed} is closed, which may open or slide at the impact; let it take hold "
                "where no such contact is closed"
            )


def _placed(modes: Modes, t: float, state: State, held: HeldJoints) -> Modes:
    """Modes at a state, with the kinematics of all rows."""
    hold_placed(modes, held)
    place_start(modes.bilateral, t, state)
    RowDynamics(modes).update()
    return modes


def _followed(
    system: System, t: float, state: State, held: HeldJoints, closing: np.ndarray
) -> State:
    """A state that is put on the joints."""
    before = math.inf
    for _ in range(NEWTON_STEPS):
        _, gaps = evaluated(system, t, state, held)
        largest = float(np.abs(gaps).max(initial=0.0))
        if not 0.0 < largest < 0.5 * before:
            break
        before = largest
        state = displaced(state, -closing @ gaps)
    return state


def _closed(modes: Modes) -> str:
    """A contact or stop that is closed, or a joint that friction holds, in the mode entered."""
    for u, constraint in enumerate(modes.unilateral.constraints):
        if u in modes.idle or constraint.compliant:
            continue
        state = modes.mode.states[u]
        rests = constraint.kind == DRY_JOINT and not state.moves
        if rests or (constraint.kind != DRY_JOINT and state != ContactState.OPEN):
            return f"'{constraint.owner}/{constraint.name}'"
    return ""
