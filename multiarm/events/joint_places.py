"""Where joints are on their bodies that take hold of them wherever these are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.contacts.motion import BodyMotion
from multiarm.contacts.table import ContactTable, copy_geometry, pack
from multiarm.contacts.unilateral import TimedJoint
from multiarm.dynamics.data import Data
from multiarm.dynamics.model import Model
from multiarm.geometry.records import Contact
from multiarm.jit.rows import fields_of


class FrameMotion(NamedTuple):
    """A joint's frame on one of its bodies, in world axes."""

    rotation: np.ndarray  # (3, 3)
    origin: np.ndarray  # (3,) [m]
    velocity: np.ndarray  # (3,) of the origin [m/s]


def with_own_places(full: Data) -> Data:
    """A view of a Data in which joints can be placed elsewhere."""
    constants = full.model.constants
    own = full.view(
        full.model.with_constants(
            contacts=ContactTable(*(array.copy() for array in constants.contacts)),
            joint_frames=constants.joint_frames.copy(),
        )
    )
    own.replace_arrays(sample=full.arrays.sample)
    return own


def frame_motions(data: Data, model: Model, connection: str) -> tuple[FrameMotion, FrameMotion]:
    """The frames of a joint on both bodies, at the kinematics in the data."""
    bodies, frames = (
        fields_of(BodyMotion, data.arrays.bodies.motion),
        model.frames_on_bodies(connection),
    )
    first, second = model.bodies_of(connection)

    def motion(body: int, rotation: np.ndarray, origin: np.ndarray) -> FrameMotion:
        R, lever = bodies.rotation[body], bodies.rotation[body] @ origin
        velocity = bodies.velocity[body] + np.cross(bodies.spin[body], lever)
        return FrameMotion(R @ rotation, bodies.origin[body] + lever, velocity)

    return (
        motion(first, frames.on_link, frames.origin_on_link),
        motion(second, frames.on_object, frames.origin_on_object),
    )


def place_joint(data: Data, written: Model, joint: TimedJoint, as_written: bool) -> None:
    """Move a joint on its second body to where it is on the first, at the kinematics in the data.

    ``written`` is the model as the scene has it, where the joint returns to if it is
    ``as_written``; that of ``data`` has own places.
    """
    connection, bodies = joint.connection, fields_of(BodyMotion, data.arrays.bodies.motion)
    if as_written:
        before = written.frames_on_bodies(connection)
        _move_joint(data, written, connection, before.on_object, before.origin_on_object)
        return
    on_first, _ = frame_motions(data, written, connection)
    second = written.bodies_of(connection)[1]
    R = bodies.rotation[second]
    rotation = R.T @ on_first.rotation @ joint.offset[:3, :3]
    origin = on_first.origin + on_first.rotation @ joint.offset[:3, 3] - bodies.origin[second]
    _move_joint(data, written, connection, rotation, R.T @ origin)


def place_joint_at(data: Data, written: Model, joint: TimedJoint, at: np.ndarray) -> None:
    """Move a joint on its second body to a pose (4, 4) there, see :func:`place_on_second`."""
    frames = written.frames_on_bodies(joint.connection)
    before = _pose(frames.on_object, frames.origin_on_object)
    of_tip = written.frames[joint.connection].on_object
    now = before @ np.linalg.solve(of_tip, at @ _pose(joint.axes, np.zeros(3)))
    _move_joint(data, written, joint.connection, now[:3, :3], now[:3, 3])


def _move_joint(
    data: Data, written: Model, connection: str, rotation: np.ndarray, origin: np.ndarray
) -> None:
    before, now = (model.frames_on_bodies(connection) for model in (written, data.model))
    now.on_object[:], now.origin_on_object[:] = rotation, origin
    turn = now.on_object @ before.on_object.T
    shift = now.origin_on_object - turn @ before.origin_on_object
    rows = written.layout.contacts_of(written.layout.owners.index(connection))
    records = {
        row: record
        for row, record in enumerate(written.records[rows], start=rows.start)
        if isinstance(record, Contact)
    }
    moved = [record.moved_on_bodies(None, (turn, shift)) for record in records.values()]
    packed = pack(moved).table
    for k, row in enumerate(records):
        copy_geometry(packed, k, data.model.constants.contacts, row)


def place_on_second(data: Data, written: Model, joint: TimedJoint) -> np.ndarray:
    """The joint's pose (4, 4) on its second body, as ``at`` of a scene has it."""
    connection = joint.connection
    now, before = (
        _pose(frames.on_object, frames.origin_on_object)
        for frames in (model.frames_on_bodies(connection) for model in (data.model, written))
    )
    of_tip = written.frames[connection].on_object  # the same as ``before``, in the tip's frame
    return of_tip @ np.linalg.solve(before, now) @ _pose(joint.axes.T, np.zeros(3))


def _pose(rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, origin
    return pose
