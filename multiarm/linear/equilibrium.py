r"""Equilibria: states at rest that the control, or given torques, hold.

At rest, the accelerations :math:`\dot\zeta` of the minimal coordinates and the rates of states of
effects are functions of the position alone, with the exact derivatives

.. math::
    \begin{bmatrix} d\dot\zeta \\ d\dot z \end{bmatrix} =
    \begin{bmatrix} A_{\zeta\eta} & A_{\zeta z} \\ A_{z\eta} & A_{zz} \end{bmatrix}
    \begin{bmatrix} d\eta \\ dz \end{bmatrix}, \qquad
    J = A_{\zeta\eta} - A_{\zeta z} A_{zz}^{-1} A_{z\eta} ,

as states of effects, such as the torques of lagging drives, are always those at rest.  The method
is Levenberg and Marquardt's in the metric of the inertia,

.. math:: \min_{\Delta\eta}\; |\dot\zeta + J \Delta\eta|_M^2 + \mu\, |E_p \Delta\eta|_M^2 ,

where :math:`\mu` falls with every step that lessens the accelerations, so that the last steps are
Newton's, and grows with every one that does not.  After each the joints are closed again.  Along
motions that nothing drives back the system stays where it is.  Unstable equilibria are found as
well as stable ones; the linear system there says which it is.

*Descent.*  Accelerations may be least, and yet not zero, where no equilibrium is.  Then the search
starts again and goes where strong damping would take the system, :math:`d\eta/ds = \dot\zeta`
(pseudo-transient continuation: C.T. Kelley, D.E. Keyes, SIAM J. Numer. Anal. 35, 1998).  With
coordinates in which the inertia is the identity, its steps are

.. math:: (\mu I + H)\, \Delta\eta = \dot\zeta, \qquad H = -\tfrac12 (J + J^T), \quad
    \mu I + H > 0 .

Forces that have a potential V, such as weights and springs, make this a trust region method for
its minimum, since :math:`\dot\zeta = -\nabla V`.  The work of the forces over a step, by the mean
of both ends, is the decrease of V.  Steps that gain less work than a part of what the model
promises are shortened.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from multiarm.assembly.start import project_start
from multiarm.dynamics.state import State, fill_by_arm
from multiarm.dynamics.system import System, require_system
from multiarm.errors import ModelError, SolverError
from multiarm.linear.linearisation import LinearSystem, linearise
from multiarm.notation import count_of
from multiarm.public import facts_html, public_names

__all__ = ["Equilibrium", "find_equilibrium"]

# Largest accelerations that count as none, as part of those that gravity or 1 m/s^2 would make.
LARGEST_AT_REST = 1e-11
# The best that roundings allow, as part of the same.
ROUNDINGS = 1e-8
MOST_STEPS = 200
# Largest motion of a step [m, rad].
LONGEST = 0.3
# The parameter mu, relative to the largest squared singular value of the matrix: first, last that
# is tried, below which a step is Newton's; factors after good and bad steps.
MU_FIRST, MU_LAST, MU_NEWTON, MU_FALLS, MU_GROWS = 1e-4, 1e4, 1e-14, 0.05, 8.0
# Of a descent: the factor after a good step; work that makes a step good, and that makes it count,
# as part of what the model promises; the curvature that is left, as part of the most negative.
MU_EASES, TRUSTED, WORTH, BENT = 0.3, 0.5, 0.1, 0.1
# A descent that goes on so far [m, rad] is one without end.
UNBOUNDED = 10.0
# Smallest singular value, relative to the largest, of a motion that something drives back.
DRIVEN_BACK = 1e-9


@dataclass(frozen=True, repr=False)
class Equilibrium:
    """A state at rest in which nothing accelerates.

    Attributes
    ----------
    state : State
    torques : mapping arm -> ndarray, shape (n_i,)
        That act on the joints [N m, N].
    linear : LinearSystem
        The system near it.
    steps : int
        Of the search.
    acceleration : float
        The largest that is left [m/s^2, rad/s^2].
    """

    state: State
    torques: Mapping[str, np.ndarray]
    linear: LinearSystem
    steps: int
    acceleration: float

    __dir__ = public_names

    def __repr__(self) -> str:
        return f"Equilibrium({self.stability}, after {count_of(self.steps, 'step')}; {self.state})"

    def _repr_html_(self) -> str:
        facts = {
            "stability": self.stability,
            "steps": self.steps,
            "acceleration left": f"{self.acceleration:.2g} m/s\N{SUPERSCRIPT TWO}",
        }
        return facts_html("Equilibrium", facts)

    @property
    def stability(self) -> str:
        """``"stable"``, ``"unstable"``, or ``"undecided"``: linear terms do not tell."""
        return self.linear.stability


def find_equilibrium(
    system: System,
    state: State | None = None,
    torques: Mapping[str, ArrayLike] | None = None,
    *,
    t: float = 0.0,
) -> Equilibrium:
    """Find a posture near a state in which the system stays at rest.

    The torques that hold a posture are those of :func:`multiarm.inverse_dynamics` for an
    object acceleration of zero.

    >>> equilibrium = ma.find_equilibrium(system)
    >>> equilibrium.stability, equilibrium.linear.modes

    Parameters
    ----------
    system : System
    state : State, optional
        Where the search begins; its velocities are left out.  The scene's start by default.
    torques : mapping arm -> array-like (n_i,), optional
        Joint torques [N m] or forces [N] that are held; arms that are not named get none.  The
        scene's control by default.
    t : float
        Time, for control and loads [s].

    Raises
    ------
    ModelError
        When an argument does not fit.
    SolverError
        When no equilibrium is found, with what is left, and whether the forces drive the system on
        without end or that is only not known; when the state cannot be linearised; when effects
        have states that do not start at rest.
    """
    system = require_system(system, "ma.find_equilibrium(system, state, torques)")
    if torques is not None:
        held = np.zeros(system.model.layout.rate_count)
        fill_by_arm("torques", system.model.layout, held, torques, ModelError)
        by_arm = system.model.layout.split_joints(held)
        system = system.with_control(lambda t, state: by_arm)
    start = _at_rest(system, system.checked(state))
    begin = linearise(system, t, start)
    size = max(float(np.linalg.norm(system.model.constants.gravity)), 1.0)
    if not _states_rest(begin, size):
        raise SolverError(
            "find_equilibrium: effects have states that do not start at rest; write `start: "
            "command` for `actuator_lag`, and let effects of your own start where their rates "
            "are zero"
        )
    least = _Search(begin, t)
    least.run(LARGEST_AT_REST * size)
    search, steps = least, least.steps
    if least.here.largest_acceleration > ROUNDINGS * size:
        search = _Descent(begin, t)
        search.run(LARGEST_AT_REST * size)
        steps += search.steps
    here = search.here
    if here.largest_acceleration > ROUNDINGS * size:
        raise SolverError(_not_found(least, search, start))
    torques = here.derivatives.evaluation.joint_torques
    return Equilibrium(here.state, torques, here, steps, here.largest_acceleration)


class _Reduced(NamedTuple):
    """Accelerations, and their derivatives by displacements, as the inertia measures both."""

    r: np.ndarray  # (m,)
    J: np.ndarray  # (m, p)
    scale: np.ndarray  # (p, p): displacements of the coordinates by those that J is for
    hessian: np.ndarray  # (m, m): of the potential, by displacements along velocities
    moves: np.ndarray  # (6 F + n, m): displacements by those that the hessian is for


class _Search:
    """Steps of the method of Levenberg and Marquardt."""

    def __init__(self, here: LinearSystem, t: float) -> None:
        self.here, self.steps = here, 0
        self._t, self._mu, self._at = t, MU_FIRST, _reduced(here)

    def run(self, at_rest: float) -> None:
        """Take steps until no acceleration is larger, or none helps."""
        while self.here.largest_acceleration > at_rest and self.steps < MOST_STEPS:
            if not self._step():
                break

    def _step(self) -> bool:
        """Take a step that lessens the accelerations; returns whether there is one."""
        at = self._at
        u, s, vt = np.linalg.svd(at.J, full_matrices=False)
        if not s.size or not s[0] > 0.0:
            return False
        along, driven = u.T @ at.r, s > DRIVEN_BACK * s[0]
        while self._mu <= MU_LAST:
            mu = self._mu * s[0] ** 2 if self._mu > MU_NEWTON else 0.0
            part = np.zeros_like(s)
            part[driven] = s[driven] * along[driven] / (s[driven] ** 2 + mu)
            move = -self.here.coordinates.displacement @ (at.scale @ (vt.T @ part))
            there = self._there(move)
            if there is not None:
                reduced = _reduced(there)
                if np.linalg.norm(reduced.r) < np.linalg.norm(at.r):
                    self._go(there, reduced)
                    self._mu = max(self._mu * MU_FALLS, MU_NEWTON)
                    return True
            self._mu *= MU_GROWS
        return False

    def _go(self, there: LinearSystem, reduced: _Reduced) -> None:
        self.here, self._at, self.steps = there, reduced, self.steps + 1

    def _there(self, move: np.ndarray) -> LinearSystem | None:
        """The system after a displacement; None where it is too long, or joints do not close."""
        if not 0.0 < np.abs(move).max(initial=0.0) <= LONGEST:
            return None
        system = self.here.system
        try:
            return linearise(system, self._t, _at_rest(system, self.here.state.displaced(move)))
        except (ModelError, SolverError):
            return None


class _Descent(_Search):
    """Steps to a minimum of the potential."""

    def _step(self) -> bool:
        """Take a step over which the forces do work; returns whether there is one."""
        at = self._at
        if not at.r.size:
            return False
        curvatures, axes = np.linalg.eigh(at.hessian)
        along = axes.T @ at.r
        stiffest = max(np.abs(curvatures).max(), np.linalg.norm(at.r))
        bent = curvatures + (1.0 + BENT) * max(-curvatures[0], 0.0)
        while self._mu <= MU_LAST:
            mu = self._mu * stiffest if self._mu > MU_NEWTON else 0.0
            part = along / np.maximum(bent + mu, DRIVEN_BACK * stiffest)
            there = self._there(at.moves @ (axes @ part))
            if there is not None:
                promised = part @ along - 0.5 * part @ (curvatures * part)
                gain = self._work(there) / promised
                if gain > WORTH:
                    self._go(there, _reduced(there))
                    self._mu *= MU_EASES if gain > TRUSTED else 1.0
                    self._mu = max(self._mu, MU_NEWTON)
                    return True
            self._mu *= MU_GROWS
        return False

    def _work(self, there: LinearSystem) -> float:
        """Of the forces over the way to another state, by the mean of both ends."""
        way = self.here.state.displacement_to(there.state)
        return 0.5 * (_virtual_work(self.here, way) + _virtual_work(there, way))


def _virtual_work(here: LinearSystem, way: np.ndarray) -> float:
    """Of the forces over the part of a displacement that the joints allow."""
    at, accelerations = here.coordinates, here.derivatives.evaluation.accelerations
    allowed = at.displacement @ way[list(at.positions)]
    return float(accelerations @ here.derivatives.motions.inertia @ allowed)


def _states_rest(here: LinearSystem, size: float) -> bool:
    """Whether the states of effects are at rest, but for roundings.

    The way of each to its rest, ``A_zz^-1 dz/dt``, counts in its unit, and by the accelerations
    that it causes.
    """
    moving, inner = _blocks(here)
    rate = here.rate[inner]
    try:
        away = np.linalg.solve(here.A[inner, inner], rate)
    except np.linalg.LinAlgError:  # a state that nothing brings to rest
        return False
    accelerations = here.A[moving, inner] @ away / size
    return bool(max(np.abs([*away, *accelerations]), default=0.0) <= ROUNDINGS)


def _blocks(here: LinearSystem) -> tuple[slice, slice]:
    """Rows of A of the velocities, and of the states of effects."""
    p, m = len(here.coordinates.positions), len(here.coordinates.velocities)
    return slice(p, p + m), slice(p + m, len(here.A))


def _reduced(here: LinearSystem) -> _Reduced:
    at, M = here.coordinates, here.derivatives.motions.inertia
    moving, inner = _blocks(here)
    p = moving.start
    by_inner = np.linalg.solve(here.A[inner, inner], here.A[inner, :p])
    J = here.A[moving, :p] - here.A[moving, inner] @ by_inner
    metric = np.linalg.cholesky(at.velocity.T @ M @ at.velocity).T
    scale = np.linalg.inv(np.linalg.cholesky(at.displacement.T @ M @ at.displacement).T)
    stretch = np.linalg.inv(metric)
    by_moves = metric @ J @ at.velocity[list(at.positions)] @ stretch
    return _Reduced(
        r=metric @ here.rate[moving],
        J=metric @ J @ scale,
        scale=scale,
        hessian=-0.5 * (by_moves + by_moves.T),
        moves=at.velocity @ stretch,
    )


def _at_rest(system: System, state: State) -> State:
    """The state on the joints, with zero velocities."""
    state.velocity[:] = 0.0
    with system.borrow() as data:
        return project_start(data, system.scene, state)[0]


def _not_found(least: _Search, descent: _Search, start: State) -> str:
    moved = float(np.abs(start.displacement_to(descent.here.state)).max())
    left = min(least.here.largest_acceleration, descent.here.largest_acceleration)
    steps = least.steps + descent.steps
    text = (
        f"find_equilibrium: none found in {steps} steps, which left accelerations of {left:.2g} "
        "m/s^2 or rad/s^2: "
    )
    if descent.steps < MOST_STEPS:
        text += (
            f"no motion near the state reached, {moved:.2g} m or rad from the start, lessens them "
            "or does work; whether there is one elsewhere is not known; begin elsewhere (`state`)"
        )
    elif moved > UNBOUNDED:
        text += (
            f"the forces drive the system on without end (so far by {moved:.2g} m or rad), and on "
            "this way there is none; add what holds it, such as springs"
        )
    else:
        text += (
            f"the forces still do work, {moved:.2g} m or rad from the start; whether there is one "
            "is not known; begin nearer to it (`state`)"
        )
    return text + (
        ", or give the torques that hold the posture: "
        "ma.inverse_dynamics(system, state, [0, 0, 0, 0, 0, 0]).torques"
    )
