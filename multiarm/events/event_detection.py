"""Event detection: which constraints touch at a state, and the first event inside a step.

*At the edge of a patch*, such as a table top.  A contact beyond the edge is *off* its patch and
touches nothing, however low it is; crossing the edge is an event that is not reported.  A contact
under the patch is *below* it: it touches nothing until it is off the patch again, or has come up
through it.

*Inside a step* the guards are functions of time on the step's dense output, whose first root is the
event.
"""

from __future__ import annotations

from collections.abc import Callable, Set

import numpy as np

from multiarm.assembly.loop_closure import scene_size
from multiarm.assembly.start import TOUCHING
from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.contacts.unilateral import DRY_JOINT
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.contact_geometry import patch_margin, place_state
from multiarm.dynamics.coordinates import load_chart
from multiarm.dynamics.equations import evaluate_state, update_kinematics, update_rows
from multiarm.dynamics.guards import QUIET, spring_length
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import State
from multiarm.dynamics.status import OK
from multiarm.events.kernels import write_guards
from multiarm.events.modes import GAP_THRESHOLD, Choice, Modes
from multiarm.integration.dense_output import interpolate
from multiarm.integration.step import open_step
from multiarm.jit.kernels import kernel
from multiarm.jit.pointers import address_of, call_cfunc
from multiarm.results.channels import ContactState


def touching_constraints(
    modes: Modes, t: float, state: State
) -> tuple[set[int], frozenset[int], float]:
    """Move to a state; constraints that touch there, that are off their patches, and scene size.

    Compliant contacts that push touch too.  The size is in metres.
    """
    full, bare = modes.full, modes.bare
    place_state(bare, t, state)
    if update_kinematics(bare.struct) != OK:
        bare.reraise()
    update_rows(full.struct)
    size, nothing = scene_size(modes.closed), Choice((), ())
    touching = closed_constraints(modes, TOUCHING * size)
    touching |= pressed_constraints(modes, nothing, set())
    return touching, off_patch_constraints(modes, nothing, set()), size


def closed_constraints(modes: Modes, tolerance: float) -> set[int]:
    """Contacts that cannot open, and contacts and limits whose gaps are closed."""
    gaps = modes.full.arrays.contacts[:, GAP]
    return {
        u
        for u, constraint in enumerate(modes.unilateral.constraints)
        if constraint.kind != DRY_JOINT
        and not constraint.compliant
        and (constraint.bilateral or abs(gaps[constraint.row]) <= tolerance)
    }


def pressed_constraints(modes: Modes, before: Choice, fired: Set[int]) -> set[int]:
    """Compliant contacts that push from now on, at the state in the data.

    One whose guard has just ``fired`` is at zero and changes its state.  ``before`` has no states
    at the beginning of a run.
    """
    pressed = set()
    for u, constraint in enumerate(modes.unilateral.constraints):
        if not constraint.compliant:
            continue
        gap, rate = modes.full.arrays.contacts[constraint.row, [GAP, GAP_RATE]]
        length = spring_length(gap, rate, constraint.lag)
        pushes = length < 0.0
        if abs(length) <= GAP_THRESHOLD:
            started = bool(before.states)
            was_open = started and before.states[u] == ContactState.OPEN
            pushes = was_open == (u in fired) if started else rate <= 0.0
        if pushes:
            pressed.add(u)
    return pressed


def off_patch_constraints(modes: Modes, before: Choice, crossed: Set[int]) -> frozenset[int]:
    """Constraints whose contacts are off their patches from now on, at the state in the data.

    One that has just ``crossed`` an edge is on it, and on its other side from now on.
    """
    found = set()
    for u, constraint in enumerate(modes.unilateral.constraints):
        margin = patch_margin(modes.full, constraint)
        off = margin < 0.0
        if u in crossed or abs(margin) <= GAP_THRESHOLD:
            off = (u in before.off_patch) != (u in crossed)
        if off:
            found.add(u)
    return frozenset(found)


def below_patch_constraints(full: Data, others: Set[int]) -> frozenset[int]:
    """Constraints whose contacts are below their patches; ``others`` are known not to be."""
    assert full.model.unilateral is not None
    gaps = full.arrays.contacts[:, GAP]
    return frozenset(
        u
        for u, constraint in enumerate(full.model.unilateral.constraints)
        if u not in others
        and gaps[constraint.row] < -1e-8  # [m]
        and patch_margin(full, constraint) != float("inf")
    )


# --- inside a step --------------------------------------------------------------------------------

# Fractions of the step at which guards are evaluated before roots are refined.
GRID = np.linspace(0.0, 1.0, 9)


@kernel
def evaluate_in_step(struct, arrays, guards, t, h, theta):
    """Evaluate the mode with this struct at the fraction ``theta`` of a step; returns a status.

    The gains of the drift feedback are those of the step, so that a force is the one that fired.

    ``guards`` is the address of :func:`multiarm.events.kernels.write_guards`, which writes the
    values into the mode's arrays.
    """
    method, step = open_step(arrays)
    _, data, _ = open_system(struct)
    interpolate(method, step, theta, step.z_stage)
    load_chart(step.z_stage, step.base_old, data)
    data.time.now = min(t + theta * h, step.stage.latest)
    status = evaluate_state(struct, step.stage.alpha, step.stage.beta)
    if status != OK:
        return status
    return call_cfunc(guards, struct, 0.0, 0.0)


class GuardValues:
    """Values of all guards as a function of the fraction of a step."""

    def __init__(self, struct, arrays, mode, begin: float, end: float):
        self._call = struct, arrays, address_of(write_guards), begin, end - begin
        self._mode = mode
        self._known: dict[float, np.ndarray] = {}

    def __call__(self, theta: float) -> np.ndarray:
        """Values of all guards; NaN where the state cannot be evaluated."""
        if theta not in self._known:
            status = evaluate_in_step(*self._call, theta)
            values = self._mode.guards.value.copy()
            self._known[theta] = values if status == OK else np.full_like(values, np.nan)
        return self._known[theta]


def first_event(
    values: Callable[[float], np.ndarray], results: np.ndarray, levels: np.ndarray
) -> tuple[float, list[int]]:
    """Fraction of the step at which the first guard changes its sign, and all that do so there.

    Parameters
    ----------
    values : callable
        All guards as a function of the fraction.
    results : ndarray of int
        Result of each guard for the step, see :mod:`multiarm.dynamics.guards`.
    levels : ndarray
        Smaller values are zero: a guard may begin there, and grow before it falls.

    Returns
    -------
    theta : float
        1 when there is none.
    guards : list of int
    """
    samples = np.array([values(theta) for theta in GRID])
    roots: dict[int, float] = {}
    for g in map(int, np.flatnonzero(results != QUIET)):
        root = _root(values, g, samples[:, g], float(levels[g]))
        if root is not None:
            roots[g] = root
    if not roots:
        return 1.0, []
    theta = min(roots.values())
    return theta, [g for g, root in roots.items() if root <= theta + 1e-9]


def _root(
    values: Callable[[float], np.ndarray], g: int, samples: np.ndarray, level: float
) -> float | None:
    """First downward root of a guard; 0 when it was never positive."""
    from scipy.optimize import brentq, minimize_scalar

    def value(theta: float) -> float:
        return float(values(theta)[g])

    above = np.flatnonzero(samples > level)
    if not above.size:
        return 0.0 if samples[-1] < -level else None
    below = np.flatnonzero(samples[above[0] :] < 0.0) + above[0]
    if below.size:
        before = above[above < below[0]][-1]
        return float(brentq(value, GRID[before], GRID[below[0]], xtol=1e-14))
    lowest = above[0] + int(np.argmin(samples[above[0] :]))
    left, right = GRID[max(lowest - 1, 0)], GRID[min(lowest + 1, len(GRID) - 1)]
    best = minimize_scalar(value, bounds=(left, right), method="bounded", options={"xatol": 1e-6})
    if best.fun < 0.0 < value(left):
        return float(brentq(value, left, float(best.x), xtol=1e-14))
    return None
