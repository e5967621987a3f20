"""What kernels see of a compiled scene: constants of the model, variables of an evaluation.

A struct (:mod:`multiarm.jit.structs`) stands for both and for the solver's workspace in calls
between compiled functions.  :func:`open_system` gives the views ``model, data, work`` of it, in
which every field has its name.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import BODY_WIDTH, CONTACT_WIDTH, RELATIVE_WIDTH
from multiarm.contacts.surfaces import QUERY_WIDTH
from multiarm.dynamics.solver.singular import CoupledWork
from multiarm.dynamics.solver.work import NodeWork
from multiarm.jit.kernels import inlined
from multiarm.jit.structs import (
    Flag,
    Float,
    Floats1,
    Floats2,
    Int,
    Ints1,
    Ints2,
    Numbers,
    make_struct,
    struct_of,
    view,
)

# Results of an evaluation; k >= 0: the elimination failed at arm k, or at the object where k is the
# number of arms.
OK, CALLBACK_FAILED, PROJECTION_FAILED, NOT_FINITE, CONTRADICTION = -1, -2, -3, -4, -5

# Columns of an event: time, number of the monitor, 1 when its margin became positive (else 0).
# Further events between two visits from Python are only counted.
EVENT_WIDTH, MOST_EVENTS = 3, 512


class Constants(NamedTuple):
    """Constants of all evaluations of a scene.

    q_slots : int64 (joints,), circular : int64 (joints,)
        Place of each joint in Pinocchio's configuration, -1 for those of compiled arms; whether it
        takes cosine and sine there.
    codes, geometry, shapes
        The contact table; the arms' geometry in the frame of the joint that carries the tip.
    frames : (n, 24)
        Joint frames of every arm, see :mod:`multiarm.contacts.frames`.
    free_bounds : int64 (n + 1,), free : int64 (m, 2)
        Which components of the relative motion in those frames are recorded, arm after arm: of
        the rates, of the coordinates.
    monitors : (w, 20)
        Forces, patches and limits to monitor, see :mod:`multiarm.integration.monitors`.
    object_mass : float, object_inertia : (3, 3)
        About the centre of mass, object axes [kg, kg m^2].
    gravity : (3,)
        World axes [m/s^2].
    control : int64 (k, 2), parameters : float64
        Address of each control law's kernel and offset of its numbers in ``parameters``.
    effects : int64 (k, 2)
        Address of each effect's kernel and place of its first array in the system's struct, in
        the order of their phases, see :mod:`multiarm.dynamics.effect_kernels`.
    passive_end, actuator_end, applied_end : int
        Where the three phases end in this list.
    joint_rows : int64 (r, 3)
        Rows of W that belong to a joint: arm, row, joint in the stacked vector.
    dense : bool
        Solve by the dense reference instead of the node algorithm.
    calls_user : bool
        Whether user functions take part: a controller, surfaces, effects.
    """

    q_slots: Ints1
    circular: Ints1
    codes: Ints2
    geometry: Floats2
    shapes: Floats2
    frames: Floats2
    free_bounds: Ints1
    free: Ints2
    monitors: Floats2
    object_mass: Float
    object_inertia: Floats2
    gravity: Floats1
    control: Ints2
    parameters: Floats1
    effects: Ints2
    passive_end: Int
    actuator_end: Int
    applied_end: Int
    joint_rows: Ints2
    dense: Flag
    calls_user: Flag


class Time(Numbers):
    """Time of an evaluation [s].

    Attributes
    ----------
    now : float
    latest : float
        At which stages of the step at hand are evaluated: a step that ends at a jump does not see
        what comes after it.
    """

    now: Float
    latest: Float


class Status(Numbers):
    """How the equations were solved last.

    Attributes
    ----------
    failed : bool
        A Python function that compiled code called has raised an exception.
    rank, coupled_arms : int
        Rank of the constraints; arms in the coupled system.
    residual : float
        Largest constraint residual, relative to the largest term.
    imbalance : float
        What the object's equation leaves over, relative to the largest force in it.
    position_change, velocity_change : float
        Largest change of a coordinate by the last projection [m, rad; m/s, rad/s].
    stage_gap : float
        Gap to which the stages of a step are projected before they are evaluated [m]; negative:
        they are not.
    branch_gap : float
        Gap to which the neighbours of a state near a loss of rank are projected [m].
    potential_energy : float
        Of Pinocchio's arms [J]; at samples only.
    """

    failed: Flag
    rank: Int
    coupled_arms: Int
    residual: Float
    imbalance: Float
    position_change: Float
    velocity_change: Float
    stage_gap: Float
    branch_gap: Float
    potential_energy: Float


class Functions(Numbers):
    """Addresses of the functions that an evaluation calls; 0 where there is none.

    Compiled: ``kinematics``, ``forces``, ``solve`` (the parts of an evaluation), ``project`` (the
    node algorithm without friction, for impulses and projections), ``coupled`` (the system with
    deficient arms), ``row`` (a contact that is not a tip on a plane, sphere or cylinder),
    ``near_singular`` (an evaluation near a loss of rank), ``contact_forces`` and ``guards`` (of
    scenes with unilateral contacts), ``arms`` with address and size of its struct (the terms of
    compiled arms).  Python: ``pinocchio`` (the terms of its arms), ``pinocchio_energy``,
    ``control``, ``dense``, ``surface``.
    """

    kinematics: Int
    forces: Int
    solve: Int
    project: Int
    coupled: Int
    row: Int
    near_singular: Int
    contact_forces: Int
    guards: Int
    arms: Int
    arms_struct: Int
    arms_size: Int
    pinocchio: Int
    pinocchio_energy: Int
    control: Int
    dense: Int
    surface: Int


class ModeStructs(Numbers):
    """Addresses of further structs, of scenes with unilateral contacts.

    ``closed``: with all contacts of the joints closed, as controllers take them to be; ``full``:
    with all rows; ``tangents``: with the tangents of the contacts that slide; ``guards``: the
    mode's guards (:mod:`multiarm.events`).
    """

    closed: Int
    full: Int
    tangents: Int
    guards: Int


class Variables(NamedTuple):
    """What one evaluation reads and writes.

    time : Time, status : Status, functions : Functions
    pointers : int64 (n, 8)
        Where each arm's terms are, see :mod:`multiarm.arms.terms`.
    link_poses : int64 (k,)
        Addresses of the poses of links on which effects act.
    modes : ModeStructs
    position : (7,), angles : (joints,), twist : (6,)
        The state being evaluated: object position and quaternion (xyzw), joint positions, object
        twist.  ``v`` (joints,) holds the joint velocities.
    q : (pinocchio's,), v : (joints,)
        Arrays that Pinocchio reads.
    arms : (n, 24), body : (24,), relative : (15,)
        Motion of the links that carry the tips, and of the object; scratch: one relative to the
        other.
    contacts : (N, 18), parts : (P, 18)
        Contact kinematics of the rows of W, and of the contacts that combined rows are made of.
    query : (29,), places, located : (S, 3)
        Scratch of the rows beyond a tip on a plane, sphere or cylinder; where contacts of two
        surfaces are, in the frame of the guiding body: where the search begins, and what it found.
    Wo : (N, 6), wrench : (6, N)
        The rows ``[e; (P - x_o) x e]``, world axes; the wrenches on one arm about the world's
        origin (scratch).
    inertia : (6, 6), h_o : (6,), h : (joints,), c : (N,)
        The object's inertia and right-hand sides of the node system.
    q_o : (6,), qdd : (joints,), force : (N,)
        Accelerations and contact forces (positive = pushing).
    shown : (N,)
        Contact forces as they are recorded: ``force`` itself, unless only some contacts are held at
        a time; then those of all rows, and the states of all contacts.
    torque, gravity_torque : (joints,)
        Control torques; gravity forces of the joints (filled only for control that needs them).
    weight : (6,), static_force : (N,)
        Wrench that the control wants on the object, and the contact forces for it.
    power : (1 + w,)
        Power of each effect that does work, and last of control and effects together [W].
    inner, inner_rate : (e,)
        States of effects that have their own, such as lagging actuators, and their rates.
    coordinates : (n, 6)
        Free coordinates of the joints at the end of the last step; angles go on past half a turn.
    margins : (w,), events : (e, 3), event_count : int64 (1,)
        What is monitored, see :mod:`multiarm.integration.monitors`.
    residual : (joints,)
        Scratch.
    kept : (13 + 2 joints,), mixed : (6 + joints,)
        Scratch: a state, and accelerations.
    lost : int64 (n + 1,), signs : (n,), passed : int64 (n,)
        Directions that each arm has lost at the end of the last step, and the rank; on which side
        of its singular postures an arm is (0: unknown), and whether it changed sides.
    """

    time: Time
    status: Status
    functions: Functions
    pointers: Ints2
    link_poses: Ints1
    modes: ModeStructs
    position: Floats1
    angles: Floats1
    twist: Floats1
    q: Floats1
    v: Floats1
    arms: Floats2
    body: Floats1
    relative: Floats1
    contacts: Floats2
    parts: Floats2
    query: Floats1
    places: Floats2
    located: Floats2
    Wo: Floats2
    wrench: Floats2
    inertia: Floats2
    h_o: Floats1
    h: Floats1
    c: Floats1
    q_o: Floats1
    qdd: Floats1
    force: Floats1
    shown: Floats1
    torque: Floats1
    gravity_torque: Floats1
    weight: Floats1
    static_force: Floats1
    power: Floats1
    inner: Floats1
    inner_rate: Floats1
    coordinates: Floats2
    margins: Floats1
    events: Floats2
    event_count: Ints1
    residual: Floats1
    kept: Floats1
    mixed: Floats1
    lost: Ints1
    signs: Floats1
    passed: Ints1


def make_variables(
    constants: Constants,
    pointers: np.ndarray,
    *,
    rows: int,
    configuration: int,
    works: int = 0,
    states: int = 0,
) -> Variables:
    """Allocate for a number of rows of W, numbers in Pinocchio's configuration, effects that do
    work, and states of effects.
    """
    arms, joints = len(pointers), constants.q_slots.size
    monitors = len(constants.monitors)
    return Variables(
        time=Time(latest=np.inf),
        status=Status(stage_gap=-1.0, branch_gap=-1.0),
        functions=Functions(),
        pointers=pointers,
        link_poses=np.zeros(0, dtype=np.int64),
        modes=ModeStructs(),
        position=np.zeros(7),
        angles=np.zeros(joints),
        twist=np.zeros(6),
        q=np.zeros(configuration),
        v=np.zeros(joints),
        arms=np.zeros((arms, BODY_WIDTH)),
        body=np.zeros(BODY_WIDTH),
        relative=np.zeros(RELATIVE_WIDTH),
        query=np.zeros(RELATIVE_WIDTH + QUERY_WIDTH),
        inertia=np.zeros((6, 6)),
        h_o=np.zeros(6),
        h=np.zeros(joints),
        q_o=np.zeros(6),
        qdd=np.zeros(joints),
        torque=np.zeros(joints),
        gravity_torque=np.zeros(joints),
        weight=np.zeros(6),
        power=np.zeros(1 + works),
        inner=np.zeros(states),
        inner_rate=np.zeros(states),
        coordinates=np.full((arms, 6), np.nan),
        margins=np.full(monitors, np.nan),
        events=np.zeros((MOST_EVENTS if monitors else 0, EVENT_WIDTH)),
        event_count=np.zeros(1, dtype=np.int64),
        residual=np.zeros(joints),
        kept=np.zeros(13 + 2 * joints),
        mixed=np.zeros(6 + joints),
        lost=np.zeros(arms + 1, dtype=np.int64),
        signs=np.zeros(arms),
        passed=np.zeros(arms, dtype=np.int64),
        **row_variables(constants, rows),
    )


def row_variables(constants: Constants, rows: int) -> dict[str, np.ndarray]:
    """The variables that have an entry for every row of W, or for every pair of surfaces."""
    shapes, force = len(constants.shapes), np.zeros(rows)
    return {
        "contacts": np.zeros((rows, CONTACT_WIDTH)),
        "parts": np.zeros((len(constants.codes) - rows, CONTACT_WIDTH)),
        "places": np.zeros((shapes, 3)),
        "located": np.zeros((shapes, 3)),
        "Wo": np.zeros((rows, 6)),
        "wrench": np.zeros((6, rows)),
        "c": np.zeros(rows),
        "force": force,
        "shown": force,
        "static_force": np.zeros(rows),
    }


def system_struct(
    constants: Constants,
    variables: Variables,
    work: NodeWork,
    coupled: CoupledWork,
    effects: Sequence[np.ndarray] = (),
) -> np.ndarray:
    """Struct of a system; :func:`open_system` and :func:`open_coupled` are its inverse.

    ``effects`` are the effects' own arrays, from place ``OWN_ARRAYS`` on.
    """
    own = struct_of(constants, variables, work, coupled)
    return np.concatenate([own, make_struct(effects)])


_PARTS = (Constants, Variables, NodeWork, CoupledWork)
_FIRST = [sum(len(part._fields) for part in _PARTS[:k]) for k in range(len(_PARTS) + 1)]
_open_constants, _open_variables, _open_work = (
    view(part, at) for part, at in zip(_PARTS[:3], _FIRST[:3], strict=True)
)
# Views of the coupled system's arrays in a system's struct.
open_coupled = view(CoupledWork, _FIRST[3])

# Places of two fields in the struct of a system, and of the first of the effects' arrays.
FUNCTIONS = _FIRST[1] + Variables._fields.index("functions")
STATUS = _FIRST[1] + Variables._fields.index("status")
OWN_ARRAYS = _FIRST[4]


@inlined
def open_system(struct):
    """Views ``model, data, work`` of a system's struct: constants, variables, solver workspace."""
    return _open_constants(struct), _open_variables(struct), _open_work(struct)


@inlined
def open_data(struct):
    """The view ``data`` alone."""
    return _open_variables(struct)
