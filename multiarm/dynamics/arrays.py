"""What a scene compiles to, and what an evaluation writes: plain arrays with names.

:class:`Plant` holds the constants, :class:`Buffers` everything that one evaluation reads and
writes.  A struct (:func:`system_struct`) stands for both, and for the node algorithm's arrays,
in calls between the functions of the time loop.
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
from multiarm.jit.structs import Floats1, Floats2, Ints1, Ints2, make_struct, view

# Entries of Plant.calls: callbacks into Python, then compiled entries.
CALL_TERMS, CALL_CONTROL, CALL_DENSE, CALL_POTENTIAL, CALL_SURFACE = range(5)
CALL_KINEMATICS, CALL_FORCES, CALL_SOLVE, CALL_COUPLED, CALL_CLOSE = range(5, 10)
# Entries of scenes whose contacts come and go: 0 in others.
CALL_SHOW, CALL_GUARDS = range(10, 12)
# One of the user's functions that effects ask: 0 where there are none.
CALL_FUNCTION = 12
# Writes a row of W that is not a tip on a plane, a sphere or a cylinder.
CALL_ROW = 13
# Goes on with an evaluation near a loss of rank.
CALL_CROSSING = 14
# Function that computes the terms of compiled arms, address and size of its struct, or 0.
CALL_ARMS, ARMS_STRUCT, ARMS_SIZE, CALL_COUNT = range(15, 19)

# Entry of Buffers.flag.
BUSY = 1

# Entries of Buffers.solved.
RANK_OF_ALL, COUPLED_ARMS, RESIDUAL, SHIFT, KICK, IMBALANCE, SOLVED_WIDTH = range(7)

# Columns of an event: time, number of the watch, 1 when its margin became positive (else 0).  More
# than so many between two looks from outside are only counted.
EVENT_WIDTH, MOST_EVENTS = 3, 512


class Plant(NamedTuple):
    """What a scene compiles to: constants of all its evaluations.

    pointers : int64 (n, 8)
        Where each arm's terms are, see :mod:`multiarm.arms.terms`.
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
    watches : (w, 20)
        Forces, patches and limits to watch, see :mod:`multiarm.integration.monitors`.
    object_mass : (1,), object_inertia : (3, 3)
        About the centre of mass, object axes.
    gravity : (3,)
    control : int64 (k, 2), parameters : float64
        Address of each control law's kernel and offset of its numbers in ``parameters``.
    effects : int64 (k, 2), phases : int64 (3,)
        Address of each effect's kernel and place of its first array in the system's struct; where
        the three phases of an evaluation end in this list, see :mod:`multiarm.effects.piece`.
    calls : int64 (18,)
        Addresses of the callbacks (terms of Pinocchio's arms, Python controller, dense solver,
        potential energy of Pinocchio's arms, the user's surfaces), of the compiled parts of an
        evaluation, of those of scenes whose contacts come and go (:mod:`multiarm.events`), of a
        function that an effect asks, and what belongs to compiled arms.
    dense : int64 (1,)
        1: solve by the dense reference instead of the node algorithm.
    joint_rows : int64 (r, 3)
        Rows of W that belong to a joint: arm, row, joint in the stacked vector.
    links : int64 (l,)
        Addresses and sizes of other structs, of scenes whose contacts come and go.
    """

    pointers: Ints2
    q_slots: Ints1
    circular: Ints1
    codes: Ints2
    geometry: Floats2
    shapes: Floats2
    frames: Floats2
    free_bounds: Ints1
    free: Ints2
    watches: Floats2
    object_mass: Floats1
    object_inertia: Floats2
    gravity: Floats1
    control: Ints2
    effects: Ints2
    phases: Ints1
    parameters: Floats1
    calls: Ints1
    dense: Ints1
    joint_rows: Ints2
    links: Ints1


class Buffers(NamedTuple):
    """What one evaluation reads and writes.

    time : (2,), position : (7,), angles : (joints,), twist : (6,)
        The state being evaluated: its time, and the latest at which stages of the step at hand are
        evaluated; object position and quaternion (xyzw), joint positions, object twist.  ``v``
        (joints,) holds the joint velocities.
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
        Contact forces as they are recorded: ``force`` itself, but where only some contacts are held
        at a time.
    torque, gravity_torque : (joints,)
        Control torques; gravity forces of the joints (filled only for control that needs them).
    weight : (6,), static_force : (N,)
        Wrench that the control wants on the object, and the contact forces for it.
    power : (1 + w,), energy : (1,)
        Power of each effect that does work, and last of control and effects together [W]; potential
        energy of Pinocchio's arms [J] (at samples only).
    inner, inner_rate : (e,)
        States of effects that have their own, such as lagging actuators, and their rates.
    coordinates : (n, 6)
        Free coordinates of the joints at the end of the last step; angles go on past half a turn.
    margins : (w,), events : (e, 3), event_count : int64 (1,)
        What is watched, see :mod:`multiarm.integration.monitors`.
    flag : int64 (2,)
        Raised by a callback that failed; raised while a function of the user's runs (``BUSY``).
    residual : (joints,)
        Scratch.
    kept : (13 + 2 joints,), mixed : (6 + joints,)
        Scratch: a state, and accelerations.
    stage_gap : (2,)
        Gap to which the stages of a step are projected before they are evaluated [m], negative:
        they are not; gap to which states beside one near a loss of rank are.
    solved : (6,)
        How the equations were solved last: rank of the constraints, arms in the coupled system,
        largest constraint residual relative to the largest term; largest change of a position and
        of a velocity by the last projection; what the object's equation leaves over relative to
        the largest force in it.
    lost : int64 (n + 1,), signs : (n,), passed : int64 (n,)
        Directions that each arm has lost at the end of the last step, and the rank; on which side
        of its singular postures an arm is (0: unknown), and whether it changed sides.
    """

    time: Floats1
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
    energy: Floats1
    inner: Floats1
    inner_rate: Floats1
    coordinates: Floats2
    margins: Floats1
    events: Floats2
    event_count: Ints1
    flag: Ints1
    residual: Floats1
    kept: Floats1
    mixed: Floats1
    stage_gap: Floats1
    solved: Floats1
    lost: Ints1
    signs: Floats1
    passed: Ints1


def make_buffers(
    plant: Plant, rows: int, configuration: int, works: int = 0, states: int = 0
) -> Buffers:
    """Allocate the buffers of one system.

    It has so many rows of W, numbers in Pinocchio's q, effects that do work, and states of effects.
    """
    arms, joints, shapes = plant.pointers.shape[0], plant.q_slots.size, plant.shapes.shape[0]
    watches, force = plant.watches.shape[0], np.zeros(rows)
    return Buffers(
        time=np.array([0.0, np.inf]),
        position=np.zeros(7),
        angles=np.zeros(joints),
        twist=np.zeros(6),
        q=np.zeros(configuration),
        v=np.zeros(joints),
        arms=np.zeros((arms, BODY_WIDTH)),
        body=np.zeros(BODY_WIDTH),
        relative=np.zeros(RELATIVE_WIDTH),
        contacts=np.zeros((rows, CONTACT_WIDTH)),
        parts=np.zeros((plant.codes.shape[0] - rows, CONTACT_WIDTH)),
        query=np.zeros(RELATIVE_WIDTH + QUERY_WIDTH),
        places=np.zeros((shapes, 3)),
        located=np.zeros((shapes, 3)),
        Wo=np.zeros((rows, 6)),
        wrench=np.zeros((6, rows)),
        inertia=np.zeros((6, 6)),
        h_o=np.zeros(6),
        h=np.zeros(joints),
        c=np.zeros(rows),
        q_o=np.zeros(6),
        qdd=np.zeros(joints),
        force=force,
        shown=force,
        torque=np.zeros(joints),
        gravity_torque=np.zeros(joints),
        weight=np.zeros(6),
        static_force=np.zeros(rows),
        power=np.zeros(1 + works),
        energy=np.zeros(1),
        inner=np.zeros(states),
        inner_rate=np.zeros(states),
        coordinates=np.full((arms, 6), np.nan),
        margins=np.full(watches, np.nan),
        events=np.zeros((MOST_EVENTS if watches else 0, EVENT_WIDTH)),
        event_count=np.zeros(1, dtype=np.int64),
        flag=np.zeros(2, dtype=np.int64),
        residual=np.zeros(joints),
        kept=np.zeros(13 + 2 * joints),
        mixed=np.zeros(6 + joints),
        stage_gap=np.full(2, -1.0),
        solved=np.zeros(SOLVED_WIDTH),
        lost=np.zeros(arms + 1, dtype=np.int64),
        signs=np.zeros(arms),
        passed=np.zeros(arms, dtype=np.int64),
    )


def system_struct(
    plant: Plant,
    buffers: Buffers,
    work: NodeWork,
    coupled: CoupledWork,
    others: Sequence[np.ndarray] = (),
) -> np.ndarray:
    """Struct of one system; :func:`open_system` and :func:`open_coupled` are its inverse.

    ``others`` are the effects' own arrays, from place ``OWN_ARRAYS`` on.
    """
    return make_struct([*plant, *buffers, *work, *coupled, *others])


_PARTS = (Plant, Buffers, NodeWork, CoupledWork)
_FIRST = [sum(len(part._fields) for part in _PARTS[:k]) for k in range(len(_PARTS) + 1)]
_open_plant, _open_buffers, _open_work = (
    view(part, at) for part, at in zip(_PARTS[:3], _FIRST[:3], strict=True)
)
# Views of the coupled system's arrays in a system's struct.
open_coupled = view(CoupledWork, _FIRST[3])

# Places of ``calls``, ``flag`` and of the coupled system's ``counts`` in the struct of a
# system, and of the first of the effects' arrays.
CALLS = Plant._fields.index("calls")
FLAG = _FIRST[1] + Buffers._fields.index("flag")
COUPLED_COUNTS = _FIRST[3] + CoupledWork._fields.index("counts")
OWN_ARRAYS = _FIRST[4]


@inlined
def open_system(struct):
    """Views ``plant, buffers, work`` of the arrays in a system's struct."""
    return _open_plant(struct), _open_buffers(struct), _open_work(struct)


@inlined
def asks_python(plant):
    """Whether functions of the user's take part: a controller, surfaces, wrenches from outside."""
    return (
        plant.calls[CALL_CONTROL] != 0
        or plant.calls[CALL_SURFACE] != 0
        or plant.calls[CALL_FUNCTION] != 0
    )
