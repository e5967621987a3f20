"""The variables of an evaluation, in groups, and how they are allocated.

A kernel that opens them (:func:`multiarm.dynamics.arrays.open_data`) reads and writes
``data.state.velocity``, ``data.forces.f_j``, ``data.rows.force``.  All are in world axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import CONTACT_WIDTH, ROW_LANES, ContactSearch, make_search
from multiarm.contacts.motion import BODY_WIDTH, RELATIVE_WIDTH, BodyMotion
from multiarm.dynamics.coordinates import columns_of_forces, floating_bases
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.references import References
from multiarm.dynamics.solver.solution import UNSOLVED, Solution
from multiarm.jit.rows import Pair, Quaternion, Vector, fields_of, row_of, width
from multiarm.jit.simd import aligned_zeros
from multiarm.jit.structs import Flag, Float, Floats1, Floats2, Int, Ints1, Ints2, Numbers


class Time(Numbers):
    """Time of an evaluation [s]."""

    now: Float


class Status(Numbers):
    """What evaluations and projections leave behind beside arrays."""

    failed: Flag  # a Python function that compiled code called has raised an exception
    block: Int  # of the last ``BLOCK_INERTIA`` or ``BLOCK_NOT_FINITE``
    kernel: Int  # address of the control law, effect or derivative of the last ``KERNEL_FAILED``, 0
    answer: Int  # that this returned
    position_change: Float  # largest change of a coordinate by the last projection [m, rad]
    velocity_change: Float  # the same of the velocities [m/s, rad/s]
    potential_energy: Float  # of Pinocchio's robots [J], at samples only


class DenseCall(Numbers):
    """The last call of the dense solver, which is Python's."""

    tolerance: Float  # part of the largest singular value below which others count as zero
    status: Int  # that it returned


class Check(Numbers):
    """Largest residuals of a result, see :mod:`multiarm.dynamics.residuals`."""

    block: Float  # of the blocks' equations [N m, N]
    on_object: Float  # [N, N m]
    constraint: Float  # [m/s^2]
    gap: Float  # [m]
    gap_rate: Float  # [m/s]
    solved: Flag  # whether the result is a solution


class StateVectors(NamedTuple):
    """The state: two vectors (:mod:`multiarm.dynamics.layout`), and parts of the same memory."""

    configuration: Floats1
    poses: Floats2  # (F, 7) of the objects
    base_poses: Floats2  # (B, 7) of the floating bases
    floating_bases: Ints1  # (B,) the first of the six joints of each
    joint_positions: Floats1  # (joints,)
    velocity: Floats1
    twists: Floats2  # (F, 6) of the objects
    joint_rates: Floats1  # (joints,)


class BodyVariables(NamedTuple):
    """Motion and inertia of the bodies, of ``n`` blocks and L links that carry tips."""

    pointers: Ints2  # (n, 5) addresses of each block's terms, see multiarm.robots.terms
    copies: Ints2  # (k, 6) fill the terms of blocks of several robots, see multiarm.robots.joined
    base_pointers: Ints2  # (B, 5) addresses of the terms of each robot whose base floats
    link_pointers: Ints2  # (L, 3) addresses of the motion of each link
    pinocchio_configuration: Floats1
    # (joints,) velocities as Pinocchio has them: of floating bases the angular one in base axes
    pinocchio_velocity: Floats1
    # (B, 24) motion of the links, of the objects and of the world, see
    # multiarm.dynamics.connections; parts of the same memory, (L, 24), (F, 24)
    motion: Floats2
    links: Floats2
    objects: Floats2
    relative: Floats1  # (15,) scratch for the relative motion of two bodies
    object_inertia: Floats2  # (6 F, 6 F) of the objects, block diagonal


class GeneralisedForces(NamedTuple):
    """Right-hand sides of the equations of motion."""

    f: Floats1  # (6 F + joints,), parts of the same memory: on the objects (6 F,), on the joints
    f_o: Floats1
    f_j: Floats1
    # with those of the contacts; the check of a solution (imbalance) writes the objects' only
    total: Floats1
    # while a mode with forces that are given is solved, see multiarm.events.kernels
    without_prestress: Floats1


class Accelerations(NamedTuple):
    """Their solution."""

    a: Floats1  # (6 F + joints,), parts of the same memory: of the objects (6 F,), of the joints
    a_o: Floats1
    a_j: Floats1


class Rows(NamedTuple):
    """The N rows of W, of C owners."""

    first: Ints1  # (C + 1,) first row of each owner
    kinematics: Floats2  # (N, 18) of the contacts, see multiarm.contacts.kernel
    parts: Floats2  # (P, 18) the same of the contacts that combined rows consist of
    W_o: Floats2  # (N, 6 F) ``[e; (P - x_o) x e]`` of the second body, its opposite of the first
    c: Floats1  # (N,) right-hand sides of the constraints
    force: Floats1  # (N,) contact forces, positive = pushing
    static_force: Floats1  # (N,) contact forces for the wrench that the control commands
    block_wrenches: Floats2  # (6, N) scratch: wrenches on one block about the world's origin
    about_joint: Floats1  # (6,) scratch: a row of W_o about the origin of a joint's frame
    packs: Floats1  # (72,) scratch: four rows of the kinematics


class StepSolution(Numbers):
    """The solution at the end of a step, as in :class:`Solution`."""

    known: Flag  # there is one: a run has begun
    rank: Int
    coupled_blocks: Int
    motion_unique: Flag
    margin: Float
    residual: Float
    correction: Float  # largest change of the state by projection [m, rad; m/s, rad/s]
    changes: Int  # of the rank and of deficient blocks, since the step before


class StepEnd(NamedTuple):
    """What a run remembers of the end of a step, of ``n`` blocks and C owners of rows."""

    solution: StepSolution
    lost_directions: Ints1  # (n,) how many each has lost
    determinant_signs: Floats1  # (n,) of each (0: unknown)
    sign_changes: Ints1  # (n,) whether this sign has changed in the step
    coordinates: Floats2  # (C, 6) free coordinates of the connections, without jumps
    points: Floats2  # (S, 3) of contacts of two surfaces, as in ``ContactSearch``


def make_step_end(layout: Layout, pairs: int) -> StepEnd:
    """As before any step."""
    blocks = layout.block_count
    return StepEnd(
        solution=StepSolution(),
        lost_directions=np.zeros(blocks, dtype=np.int64),
        determinant_signs=np.zeros(blocks),
        sign_changes=np.zeros(blocks, dtype=np.int64),
        coordinates=np.full((len(layout.owners), 6), np.nan),
        points=np.zeros((pairs, 3)),
    )


# When the laws of a control that can be held are evaluated: not at all, at the next evaluation, at
# every one.
HELD, ONCE, ALWAYS = 0, 1, 2


class SamplingStatus(Numbers):
    """Which torques of a control that can be held act; of use to no other."""

    mode: Int  # what a sample, and the beginning of a run, makes of ``due``
    due: Int  # HELD, ONCE or ALWAYS
    samples: Int  # taken since the beginning


class ControlVariables(NamedTuple):
    """What control laws read and write, beside the state."""

    torque: Floats1  # (joints,) of the drives
    power: Floats1  # (n,) of these torques on each robot [W], in models with control
    sampling: SamplingStatus
    held_torques: (
        Floats2  # (2, joints) of a control that can be held: those that act, the last ones
    )
    gravity_torque: Floats1  # (joints,) gravity forces, for control that needs them
    object_wrench: Floats1  # (6 F,) on the objects, that the control commands


class EffectVariables(NamedTuple):
    """What effects read and write, beside state and forces."""

    states: Floats1  # such as the torques of lagging drives
    state_rates: Floats1
    power: Floats1  # (1 + w,) of each effect that does work; last of control and effects [W]
    link_poses: Ints1  # addresses of the poses of links on which effects act


class ForceSlopes(NamedTuple):
    """Derivatives of forces, by the columns of :func:`multiarm.dynamics.coordinates.force_columns`.

    They are written by :mod:`multiarm.dynamics.force_derivatives`.
    """

    torque: Floats2  # (joints, columns) of the drives
    passive: Floats2  # of what passive effects do to the joints; as many rows, or none
    # (velocities + states, columns) of the forces of one effect, and the rates of its states
    force: Floats2
    balance: Floats2  # (6 F, columns) of the wrench balance that determines a law's multipliers


class InterpolationNumbers(Numbers):
    """How states near a loss of rank are evaluated, and what the last one has cost."""

    gap: Float  # to which neighbours of the state are projected [m]
    evaluations: Int  # that were made beside the first one, projections as what they count


class Interpolation(NamedTuple):
    """Memory of an evaluation near a loss of rank, :mod:`multiarm.integration.near_singular`."""

    numbers: InterpolationNumbers
    configuration: Floats1  # of the state itself
    velocity: Floats1
    acceleration: Floats1  # interpolated


class DeficientBlocks(NamedTuple):
    """Which blocks (n,) the solution could not eliminate as a whole."""

    coupled: Ints1  # these, where ``solution`` has any
    undetermined: Ints1  # their contact forces take part in a motion that is not unique


class JointMotion(NamedTuple):
    """The relative motion that one joint leaves free, of the owner that was evaluated last."""

    rates: Floats1  # (6,)
    coordinates: Floats1  # (9,) see multiarm.contacts.joint


class TipMotion(NamedTuple):
    """Motion of a tip, world axes."""

    position: Vector  # [m]
    quaternion_xyzw: Quaternion
    twist: Pair  # [m/s, rad/s]


open_tip = row_of(TipMotion)


class Sample(NamedTuple):
    """What the last sample has recorded, beside the state, of ``o`` owners of rows."""

    # contact forces: those of the rows; with unilateral contacts those of all rows, and the states
    # of all contacts
    forces: Floats1
    rows: Ints1  # (o + 1,) the first force of each owner
    states: Ints1  # (o + 1,) the first state of each owner, also in ``forces``
    wrenches: Floats2  # (o, 6) on the second body of each owner
    tips: Floats2  # (o, 13), of :class:`TipMotion`; zero of an owner whose first body is no link


class Functions(Numbers):
    """Addresses of the functions that an evaluation calls; 0 where there is none."""

    # compiled: the parts of an evaluation
    kinematics: Int
    forces: Int
    solve: Int
    solve_frictionless: Int  # the same without friction, for impulses and projections
    project_state: Int  # onto the constraints
    coupled: Int  # the system with deficient blocks
    decomposed: Int  # the same with no block eliminated as a whole
    solve_again: Int  # the system with deficient blocks, its factors known
    command: Int  # torques of the control laws, with unilateral contacts
    general_rows: Int  # those that are not in closed form
    near_singular: Int  # an evaluation near a loss of rank
    record: Int  # rank and residual of the last solution
    compare: Int  # the recorded solution with that of the step before, into ``this_step``
    contact_forces: Int  # with unilateral contacts
    guards: Int  # with unilateral contacts: the check of the mode's guards at the end of a step
    accept: Int  # ... after which the next step begins there
    reports: Int  # the check of the guards that only report, where there are any
    watch: Int  # what all guards see of a stage, where there are any
    robots: Int  # terms of compiled robots, with address and size of their struct
    robots_struct: Int
    robots_size: Int
    # Python
    pinocchio: Int  # terms of its robots
    pinocchio_energy: Int
    control: Int
    dense: Int
    dense_with_friction: Int  # the same for a mode with sliding contacts


class ModeStructs(References):
    """Addresses of further structs, and the mode, of scenes with unilateral contacts."""

    active: Flag  # the rows are those of a mode; else there are none of these structs
    of_laws: Int  # with all contacts of the joints closed, as controllers assume
    full: Int  # with all rows
    tangents: Int  # with the tangents of the sliding contacts
    mode: Int  # the mode's guards, numbers and slides, see multiarm.events
    slides: Flag  # some of its contacts slide with friction
    event: Flag  # one of its guards has found an event in the last step


class Variables(NamedTuple):
    """Variables of one evaluation, world axes."""

    time: Time
    status: Status
    functions: Functions
    modes: ModeStructs
    state: StateVectors
    bodies: BodyVariables
    rows: Rows
    control: ControlVariables
    effects: EffectVariables
    forces: GeneralisedForces
    accelerations: Accelerations
    solution: Solution
    deficient: DeficientBlocks
    dense: DenseCall
    check: Check
    last_step: StepEnd
    this_step: StepEnd  # which becomes the last one when it is accepted
    sample: Sample
    slopes: ForceSlopes
    interpolation: Interpolation
    search: ContactSearch  # its guesses are the points of the last step
    joint_motion: JointMotion


class Sizes(NamedTuple):
    """What the arrays are allocated for."""

    layout: Layout
    parts: int  # of combined rows
    pairs: int  # of surfaces
    pinocchio_configuration: int
    works: int  # effects that do work
    states: int  # of effects
    passive: bool  # there are passive effects
    contact_states: Sequence[int]  # unilateral contacts of each owner of rows


class Pointers(NamedTuple):
    """Addresses of what backends compute."""

    terms: np.ndarray  # (n, 5) of the blocks
    bases: np.ndarray  # (B, 5) of the robots whose bases float
    copies: np.ndarray  # (k, 6) of terms, into those of blocks of several robots
    links: np.ndarray  # (L, 3)
    poses: Sequence[int]  # of the links on which effects act


def make_variables(sizes: Sizes, pointers: Pointers) -> Variables:
    """Allocate."""
    layout, states, pairs = sizes.layout, sizes.states, sizes.pairs
    blocks, joints, owners = layout.block_count, layout.rate_count, len(layout.owners)
    columns = columns_of_forces(layout.nv, joints, states).end
    rows, motion = (
        make_rows(layout, sizes.parts),
        motion_of_bodies(len(pointers.links) + layout.frames),
    )
    recorded = np.append(layout.first_contact, layout.contacts + np.cumsum(sizes.contact_states))
    state, forces, accelerations = stacked_vectors(layout)
    rates = state.joint_rates
    last_step = make_step_end(layout, pairs)
    return Variables(
        time=Time(),
        status=Status(),
        functions=Functions(),
        modes=ModeStructs(),
        state=state,
        bodies=BodyVariables(
            pointers=pointers.terms,
            copies=pointers.copies,
            base_pointers=pointers.bases,
            link_pointers=pointers.links,
            pinocchio_configuration=np.zeros(sizes.pinocchio_configuration),
            pinocchio_velocity=rates.copy() if layout.floating_robots else rates,
            motion=motion,
            links=motion[: len(pointers.links)],
            objects=motion[len(pointers.links) : -1],
            relative=np.zeros(RELATIVE_WIDTH),
            object_inertia=np.zeros((layout.node, layout.node)),
        ),
        rows=rows,
        control=ControlVariables(
            torque=np.zeros(joints),
            power=np.zeros(len(layout.names)),
            sampling=SamplingStatus(mode=ALWAYS),
            held_torques=np.zeros((2, joints)),
            gravity_torque=np.zeros(joints),
            object_wrench=np.zeros(layout.node),
        ),
        effects=EffectVariables(
            states=np.zeros(states),
            state_rates=np.zeros(states),
            power=np.zeros(1 + sizes.works),
            link_poses=np.array(pointers.poses, dtype=np.int64),
        ),
        forces=forces,
        accelerations=accelerations,
        solution=UNSOLVED.copy(),
        deficient=DeficientBlocks(
            coupled=np.zeros(blocks, dtype=np.int64), undetermined=np.zeros(blocks, dtype=np.int64)
        ),
        dense=DenseCall(),
        check=Check(),
        last_step=last_step,
        this_step=make_step_end(layout, pairs),
        sample=Sample(
            forces=np.zeros(recorded[-1]) if recorded[-1] > layout.contacts else rows.force,
            rows=recorded[: owners + 1],
            states=recorded[owners:],
            wrenches=np.zeros((owners, 6)),
            tips=np.zeros((owners, width(TipMotion))),
        ),
        slopes=ForceSlopes(
            torque=np.zeros((joints, columns)),
            passive=np.zeros((joints if sizes.passive else 0, columns)),
            force=np.zeros((layout.nv + states, columns)),
            balance=np.zeros((layout.node, columns)),
        ),
        interpolation=Interpolation(
            numbers=InterpolationNumbers(),
            configuration=np.zeros(layout.nq),
            velocity=np.zeros(layout.nv),
            acceleration=np.zeros(layout.nv),
        ),
        search=make_search(last_step.points),
        joint_motion=JointMotion(rates=np.zeros(6), coordinates=np.zeros(9)),
    )


def stacked_vectors(layout: Layout) -> tuple[StateVectors, GeneralisedForces, Accelerations]:
    """Configuration, velocity, forces and accelerations, with views of their parts."""
    q, v, a, f = (np.zeros(size) for size in (layout.nq, *[layout.nv] * 3))
    return (
        StateVectors(
            configuration=q,
            poses=layout.poses(q),
            base_poses=layout.base_poses(q),
            floating_bases=floating_bases(layout),
            joint_positions=layout.joint_positions(q),
            velocity=v,
            twists=layout.twists(v),
            joint_rates=layout.joint_rates(v),
        ),
        GeneralisedForces(
            f=f,
            f_o=f[layout.of_frames],
            f_j=layout.joint_rates(f),
            total=np.zeros(layout.nv),
            without_prestress=np.zeros(layout.nv),
        ),
        Accelerations(a=a, a_o=a[layout.of_frames], a_j=layout.joint_rates(a)),
    )


def motion_of_bodies(moving: int) -> np.ndarray:
    """``BodyVariables.motion`` of links and objects, and of the world at rest at the origin."""
    motion = np.zeros((moving + 1, BODY_WIDTH))
    fields_of(BodyMotion, motion[-1]).rotation[:] = np.eye(3)
    return motion


def make_rows(layout: Layout, parts: int) -> Rows:
    """Allocate for the rows of a layout, and a number of parts of combined rows."""
    arrays = {
        name: np.zeros(shape) for name, shape in row_shapes(layout.contacts, layout.node).items()
    }
    first = np.array(layout.first_contact, dtype=np.int64)
    parts_of_rows = np.zeros((parts, CONTACT_WIDTH))
    return Rows(
        first=first,
        parts=parts_of_rows,
        about_joint=np.zeros(6),
        packs=aligned_zeros(ROW_LANES),
        **arrays,
    )


def row_shapes(rows: int, node: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays of :class:`Rows` with an entry for every row."""
    return {
        "kinematics": (rows, CONTACT_WIDTH), "W_o": (rows, node), "c": (rows,), "force": (rows,),
        "static_force": (rows,), "block_wrenches": (6, rows),
    }  # fmt: skip
