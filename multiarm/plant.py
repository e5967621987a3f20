"""What a scene compiles to, and what an evaluation writes: plain arrays with names.

:class:`Plant` holds the constants, :class:`Buffers` everything that one evaluation reads and
writes.  An address book (:func:`system_book`) stands for both, and for the node algorithm's arrays,
in calls between the functions of the time loop.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import BODY_WIDTH, CONTACT_WIDTH, RELATIVE_WIDTH
from multiarm.lowlevel import address_book, floats1, floats2, floats3, inner_inlined, ints1, ints2
from multiarm.node.regular import NodeWork

# Entries of Plant.calls.
CALL_TERMS, CALL_CONTROL, CALL_DENSE, CALL_POTENTIAL = range(4)

# Entry of Buffers.flag.
BUSY = 1


class Plant(NamedTuple):
    """What a scene compiles to: constants of all its evaluations.

    pointers : int64 (n, 8)
        Where Pinocchio keeps each arm's terms, see :class:`multiarm.arm.ArmGroup`.
    q_slots : int64 (joints,), circular : int64 (joints,)
        Place of each joint in Pinocchio's configuration; whether it takes cosine and sine there.
    codes, geometry
        The contact table; the arms' geometry in the frame of the joint that carries the tip.
    object_mass : (1,), object_inertia : (3, 3)
        About the centre of mass, object axes.
    gravity : (3,)
    control, effects : int64 (k, 2), parameters : float64
        Programs of (code, offset), and the numbers they refer to.
    calls : int64 (4,)
        Addresses of the callbacks: arm terms, Python controller, dense solver, potential energy.
    dense : int64 (1,)
        1: solve by the dense reference instead of the node algorithm.
    """

    pointers: np.ndarray
    q_slots: np.ndarray
    circular: np.ndarray
    codes: np.ndarray
    geometry: np.ndarray
    object_mass: np.ndarray
    object_inertia: np.ndarray
    gravity: np.ndarray
    control: np.ndarray
    effects: np.ndarray
    parameters: np.ndarray
    calls: np.ndarray
    dense: np.ndarray


class Buffers(NamedTuple):
    """What one evaluation reads and writes.

    time : (1,), position : (7,), angles : (joints,), twist : (6,)
        The state being evaluated: object position and quaternion (xyzw), joint positions, object
        twist.  ``v`` (joints,) holds the joint velocities.
    q : (pinocchio's,), v : (joints,)
        Arrays that Pinocchio reads.
    arms : (n, 24), body : (24,), relative : (15,)
        Motion of the links that carry the tips, and of the object; scratch: one relative to the
        other.
    contacts : (N, 15), Wo : (N, 6), wrench : (6, N)
        Contact kinematics; the rows ``[e; (P - x_o) x e]``, world axes; the wrenches on one arm
        about the world's origin (scratch).
    inertia : (6, 6), h_o : (6,), h : (joints,), c : (N,)
        The object's inertia and right-hand sides of the node system.
    q_o : (6,), qdd : (joints,), force : (N,)
        Accelerations and contact forces (positive = pushing).
    torque, gravity_torque : (joints,)
        Control torques; gravity forces of the joints (filled only for gravity compensation).
    weight : (6,), static_force : (N,)
        Wrench that carries the object, and the contact forces for it (gravity compensation).
    power : (1,), energy : (2,)
        Power of control and effects [W]; kinetic and potential energy [J] (at samples only).
    flag : int64 (2,)
        Raised by a callback that failed; raised while a Python controller runs (``BUSY``).
    """

    time: np.ndarray
    position: np.ndarray
    angles: np.ndarray
    twist: np.ndarray
    q: np.ndarray
    v: np.ndarray
    arms: np.ndarray
    body: np.ndarray
    relative: np.ndarray
    contacts: np.ndarray
    Wo: np.ndarray
    wrench: np.ndarray
    inertia: np.ndarray
    h_o: np.ndarray
    h: np.ndarray
    c: np.ndarray
    q_o: np.ndarray
    qdd: np.ndarray
    force: np.ndarray
    torque: np.ndarray
    gravity_torque: np.ndarray
    weight: np.ndarray
    static_force: np.ndarray
    power: np.ndarray
    energy: np.ndarray
    flag: np.ndarray


def make_buffers(arms: int, joints: int, rows: int, configuration: int) -> Buffers:
    """Allocate the buffers of one system."""
    return Buffers(
        time=np.zeros(1),
        position=np.zeros(7),
        angles=np.zeros(joints),
        twist=np.zeros(6),
        q=np.zeros(configuration),
        v=np.zeros(joints),
        arms=np.zeros((arms, BODY_WIDTH)),
        body=np.zeros(BODY_WIDTH),
        relative=np.zeros(RELATIVE_WIDTH),
        contacts=np.zeros((rows, CONTACT_WIDTH)),
        Wo=np.zeros((rows, 6)),
        wrench=np.zeros((6, rows)),
        inertia=np.zeros((6, 6)),
        h_o=np.zeros(6),
        h=np.zeros(joints),
        c=np.zeros(rows),
        q_o=np.zeros(6),
        qdd=np.zeros(joints),
        force=np.zeros(rows),
        torque=np.zeros(joints),
        gravity_torque=np.zeros(joints),
        weight=np.zeros(6),
        static_force=np.zeros(rows),
        power=np.zeros(1),
        energy=np.zeros(2),
        flag=np.zeros(2, dtype=np.int64),
    )


def system_book(plant: Plant, buffers: Buffers, work: NodeWork) -> np.ndarray:
    """Address book of one system; :func:`open_book` is its inverse."""
    return address_book([*plant, *buffers, *work])


@inner_inlined
def open_book(book):
    """Views ``plant, buffers, work`` of the arrays in a system's book (fields in their order)."""
    plant = Plant(
        pointers=ints2(book, 0),
        q_slots=ints1(book, 1),
        circular=ints1(book, 2),
        codes=ints2(book, 3),
        geometry=floats2(book, 4),
        object_mass=floats1(book, 5),
        object_inertia=floats2(book, 6),
        gravity=floats1(book, 7),
        control=ints2(book, 8),
        effects=ints2(book, 9),
        parameters=floats1(book, 10),
        calls=ints1(book, 11),
        dense=ints1(book, 12),
    )
    buffers = Buffers(
        time=floats1(book, 13),
        position=floats1(book, 14),
        angles=floats1(book, 15),
        twist=floats1(book, 16),
        q=floats1(book, 17),
        v=floats1(book, 18),
        arms=floats2(book, 19),
        body=floats1(book, 20),
        relative=floats1(book, 21),
        contacts=floats2(book, 22),
        Wo=floats2(book, 23),
        wrench=floats2(book, 24),
        inertia=floats2(book, 25),
        h_o=floats1(book, 26),
        h=floats1(book, 27),
        c=floats1(book, 28),
        q_o=floats1(book, 29),
        qdd=floats1(book, 30),
        force=floats1(book, 31),
        torque=floats1(book, 32),
        gravity_torque=floats1(book, 33),
        weight=floats1(book, 34),
        static_force=floats1(book, 35),
        power=floats1(book, 36),
        energy=floats1(book, 37),
        flag=ints1(book, 38),
    )
    work = NodeWork(
        dofs=ints1(book, 39),
        rows=ints1(book, 40),
        L=floats3(book, 41),
        Y=floats3(book, 42),
        G=floats3(book, 43),
        Z=floats3(book, 44),
        S=floats2(book, 45),
        y=floats1(book, 46),
        z=floats1(book, 47),
        pivot=floats1(book, 48),
    )
    return plant, buffers, work
