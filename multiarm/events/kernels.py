r"""The compiled part of a mode: its arrays, its solution, and the check of its guards.

*Redundant contacts.*  Minimum-norm forces may pull or leave the friction cones where other forces
of the same motion do not.  The mode then begins with forces :math:`\lambda_0` that obey the contact
laws, and :math:`\lambda = \lambda_0 + \delta` with :math:`\delta` of minimum norm.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import (
    guards_of_mode,
    open_data,
    open_system,
)
from multiarm.dynamics.contact_forces import add_contact_forces, write_wrenches
from multiarm.dynamics.equations import call_dense_solver, update_rows
from multiarm.dynamics.guards import (
    SHARED,
    Guards,
    accept_guards,
    count_events,
    judge_guards,
    open_guards,
    remember_scales,
    write_values,
)
from multiarm.dynamics.residuals import imbalance
from multiarm.dynamics.sliding import (
    Slides,
    accept_slip,
    follow_slip,
    friction_of_unit_force,
    friction_power,
    open_slides,
    slides_of,
    write_reactions,
)
from multiarm.dynamics.solver.bounds import IMBALANCE_BOUND
from multiarm.dynamics.solver.factored_trees import complete_inertias
from multiarm.dynamics.solver.reactions import (
    ReactionWork,
    eliminate_with_reactions,
    solve_for_reactions,
)
from multiarm.dynamics.solver.solution import FRICTION, write_solution
from multiarm.dynamics.solver_monitor import accept_solution
from multiarm.dynamics.status import CALLBACK_FAILED, OK
from multiarm.jit.kernels import INTS, cfunc, copy, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import (
    Flag,
    Float,
    Floats1,
    Floats2,
    Ints1,
    Numbers,
    count_entries,
    referenced,
    size_places,
    struct_at,
    struct_of,
    view,
)


class ModeNumbers(Numbers):
    """Numbers of one mode."""

    muted: Flag  # the current step ends at an event that has been located
    stressed: Flag  # there are forces ``lambda_0``
    begin: Float  # of the last step [s]
    end: Float


class ModeArrays(NamedTuple):
    """Numbers and arrays of a mode, with m held rows."""

    numbers: ModeNumbers
    held: Ints1  # (m,) rows among all
    states: Floats1  # (u,) state of every contact, as it is recorded
    Wr_o: Floats2  # (m, 6 F) the objects' rows of the reaction matrices
    prestress: Floats1  # (m,) the forces lambda_0
    # compliant contacts: rows among all, and forces
    springs: Ints1
    spring_force: Floats1


def make_mode_struct(
    guards: Guards, slides: Slides, arrays: ModeArrays, reactions: ReactionWork | None = None
) -> np.ndarray:
    """Struct of a mode, which begins with its guards; the functions below open its parts."""
    return struct_of(guards, slides, arrays, *([] if reactions is None else [reactions]))


_SLIDES = count_entries(Guards)
_MODE = _SLIDES + count_entries(Slides)
_REACTIONS = _MODE + count_entries(ModeArrays)
open_mode, open_reactions = view(ModeArrays, _MODE), view(ReactionWork, _REACTIONS)


class ModeSizes(NamedTuple):
    """Places of the sizes of arrays in a mode's struct.

    Attributes
    ----------
    rows, slides, guards : int64 (k,)
        Of those with an entry for every held row, sliding contact and guard.
    reactions : int64 (k,)
        Of those that depend on the rows of each block, in the order of their shapes.
    """

    rows: np.ndarray
    slides: np.ndarray
    guards: np.ndarray
    reactions: np.ndarray


def mode_sizes(reactions: Mapping[str, tuple[int, ...]]) -> ModeSizes:
    """These places; ``reactions`` are the shapes of the arrays of a :class:`ReactionWork`."""

    def lengths(holder: type, at: int, names: Iterable[str]) -> np.ndarray:
        return size_places(holder, at, dict.fromkeys(names, (0,)))

    return ModeSizes(
        rows=lengths(ModeArrays, _MODE, ("held", "Wr_o", "prestress")),
        slides=lengths(Slides, _SLIDES, Slides._fields[1:]),
        guards=lengths(Guards, 0, [name for name in Guards._fields if name not in SHARED]),
        reactions=size_places(ReactionWork, _REACTIONS, reactions),
    )


@kernel
def write_guards(struct: INTS, table: INTS, numbers: INTS):
    """Write the guards of a mode, some of those of a ``table``, at their beginning."""
    guards, of_all = open_guards(struct), open_guards(table)
    for g in range(numbers.size):
        k = numbers[g]
        guards.kind[g], guards.place[g] = of_all.kind[k], of_all.place[k]
        guards.sign[g], guards.stops[g] = of_all.sign[k], of_all.stops[k]
        guards.threshold[g], guards.scale[g] = of_all.threshold[k], of_all.scale[k]
        guards.value[g] = guards.course[g] = guards.rate[g] = 0.0
        guards.before[g] = guards.rate_before[g] = 0.0
        guards.least[g], guards.level[g] = math.inf, 0.0
        guards.armed[g] = guards.result[g] = 0


@cfunc
def solve_held(address, size, _a, _b):
    """Solve a mode without sliding contacts."""
    struct = struct_at(address, size)
    _, data, work = open_system(struct)
    mode = open_mode(referenced(data.modes.mode))
    if mode.numbers.stressed:
        add_prestress(mode, data.rows.W_o, work.W, data, work)
    status = call_cfunc(data.functions.solve_frictionless, struct, 0.0, 0.0)
    if mode.numbers.stressed:
        take_prestress(mode, data)
    return status


@kernel
def add_prestress(mode, W_o, W, data, work):
    """Let the forces of ``mode.prestress``, along ``W_o`` and ``W``, act on object and joints."""
    copy(data.forces.f, data.forces.without_prestress)
    add_contact_forces(work, W_o, W, mode.prestress, data.forces.f_o, data.forces.f_j)


@kernel
def take_prestress(mode, data):
    """Make the forces of ``mode.prestress`` forces of the contacts: a part of the solution."""
    copy(data.forces.without_prestress, data.forces.f)
    for k in range(data.rows.force.size):
        data.rows.force[k] += mode.prestress[k]


@cfunc
def solve_sliding(address, size, _a, _b):
    """Solve a mode with sliding contacts."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    of_mode = referenced(data.modes.mode)
    mode, slides, reactions = open_mode(of_mode), open_slides(of_mode), open_reactions(of_mode)
    if write_reactions(data, work, mode.Wr_o, slides, reactions) != OK:
        return CALLBACK_FAILED
    if mode.numbers.stressed:
        add_prestress(mode, mode.Wr_o, reactions.Wr, data, work)
    if model.dense:
        status = call_dense_solver(data.functions.dense_with_friction, data, mode.Wr_o, 0.0)
    else:
        status = solve_reactions(data, work, mode, reactions, False)
        if status == OK and not data.solution.imbalance <= IMBALANCE_BOUND:
            status = solve_reactions(data, work, mode, reactions, True)
    if status != OK:
        return status
    if mode.numbers.stressed:
        take_prestress(mode, data)
    power = friction_power(slides, data.rows.force)
    data.effects.power[slides.numbers.power] = power
    data.effects.power[data.effects.power.size - 1] += power
    return OK


@kernel
def solve_reactions(data, work, mode, reactions, couple_all):
    """Eliminate and solve for one right-hand side, with the reaction matrices; returns a status."""
    rows, forces, accelerations = data.rows, data.forces, data.accelerations
    work.status.block_by_block = True
    complete_inertias(work)
    status, data.status.block = eliminate_with_reactions(
        reactions, rows.W_o, mode.Wr_o, data.bodies.object_inertia, couple_all
    )
    copy(reactions.pivot, work.pivot)
    if status != OK:
        return status
    solve_for_reactions(
        reactions, rows.W_o, mode.Wr_o, forces.f_o, forces.f_j, rows.c,
        accelerations.a_o, accelerations.a_j, rows.force,
    )  # fmt: skip
    write_reaction_solution(data, reactions)
    data.solution.imbalance = imbalance(data, mode.Wr_o)
    return OK


@kernel
def write_reaction_solution(data, reactions):
    """What the solver with friction has found out.

    Arms are coupled for the digits, too; they count where some of their constraints are dependent.
    """
    dependent, coupled_blocks = reactions.status.contacts - reactions.status.rank, 0
    for i in range(reactions.coupled.size):
        data.deficient.undetermined[i] = reactions.undetermined[i]
        data.deficient.coupled[i] = reactions.coupled[i]
        coupled_blocks += reactions.coupled[i]
    unique = 1 if reactions.status.motions == 0 else 0
    write_solution(
        data, FRICTION, coupled_blocks if dependent > 0 else 0, dependent, math.inf, unique
    )


@cfunc
def record_forces(address, size, _t, _b):
    """Write the forces of all rows, the states of contacts and the wrenches to ``data.sample``."""
    data = open_data(struct_at(address, size))
    of_mode = referenced(data.modes.mode)
    mode, slides, shown = open_mode(of_mode), slides_of(data), data.sample.forces
    shown[:] = 0.0
    for k in range(mode.held.size):
        shown[mode.held[k]] = data.rows.force[k]
    for s in range(slides.row.size):
        normal, t = data.rows.force[slides.row[s]], slides.tangent_of_all[s]
        first, second = friction_of_unit_force(slides, s)
        shown[t], shown[t + 1] = normal * first, normal * second
    for k in range(mode.springs.size):
        shown[mode.springs[k]] = mode.spring_force[k]
    first = shown.size - mode.states.size
    for k in range(mode.states.size):
        shown[first + k] = mode.states[k]
    struct = referenced(data.modes.full)
    status = update_rows(struct)
    model, full, _ = open_system(struct)
    write_wrenches(model, full, shown)
    return status


@kernel
def write_mode_guards(struct: INTS):
    """Kinematics of all rows, and the values of a mode's guards at the state evaluated last.

    Returns ``OK`` or ``CALLBACK_FAILED``.
    """
    data = open_data(struct)
    rows = referenced(data.modes.full)
    status = update_rows(rows)
    model, full, work = open_system(rows)
    write_values(guards_of_mode(data), struct, data, model, full, work)
    return CALLBACK_FAILED if data.status.failed else status


@cfunc
def check_guards(address, size, begin, end):
    """Check all guards at the end of a step: is there an ``event``?  Returns a status."""
    struct = struct_at(address, size)
    status = write_mode_guards(struct)
    if status != OK:
        return status
    data = open_data(struct)
    of_mode = referenced(data.modes.mode)
    numbers = open_mode(of_mode).numbers
    numbers.begin, numbers.end = begin, end
    judge_guards(open_guards(of_mode), end - begin)
    data.modes.event = count_events(open_guards(of_mode)) > 0 and not numbers.muted
    follow_slip(open_slides(of_mode), open_data(referenced(data.modes.full)).rows.kinematics)
    return OK


@cfunc
def accept_mode_step(address, size, _a, _b):
    """Make the end of a step that has been checked the beginning of the next one."""
    of_mode = referenced(open_data(struct_at(address, size)).modes.mode)
    open_mode(of_mode).numbers.muted = False
    remember_scales(open_guards(of_mode))
    begin_mode_step(of_mode)
    return OK


@kernel
def begin_mode_step(of_mode):
    """Let guards and slip begin where they have been written last."""
    accept_guards(open_guards(of_mode))
    accept_slip(open_slides(of_mode))


@kernel
def start_guards(struct: INTS):
    """Begin guards and solver monitor at the state evaluated last; returns a status."""
    data = open_data(struct)
    of_mode = referenced(data.modes.mode)
    status = call_cfunc(data.functions.record, struct, 0.0, 0.0)
    if status != OK:
        return status
    call_cfunc(data.functions.compare, struct, 0.0, 0.0)
    accept_solution(data)
    status = write_mode_guards(struct)
    follow_slip(open_slides(of_mode), open_data(referenced(data.modes.full)).rows.kinematics)
    begin_mode_step(of_mode)
    return status
