"""Where joints are on their bodies that take hold of them wherever these are."""

from __future__ import annotations

import numpy as np

from multiarm.contacts.motion import BodyMotion
from multiarm.contacts.table import ContactTable, move_on_object, on_object
from multiarm.contacts.unilateral import TimedJoint
from multiarm.dynamics.data import Data
from multiarm.dynamics.model import Model
from multiarm.geometry.poses import pose_matrix
from multiarm.jit.rows import fields_of
from multiarm.jit.vectors import cross


class JointFrame:
    """A joint's frame on its first or on its second body, world axes, at the kinematics in a Data.

    Parameters
    ----------
    data : Data
    connection : str
    second : bool
    """

    def __init__(self, data: Data, connection: str, second: bool) -> None:
        model = data.model
        frames, body = model.frames_on_bodies(connection), model.bodies_of(connection)[second]
        self._axes = frames.on_object if second else frames.on_link
        self._place = frames.origin_on_object if second else frames.origin_on_link
        self.body = fields_of(BodyMotion, data.arrays.bodies.motion[body])

    @property
    def rotation(self) -> np.ndarray:
        """Its axes, (3, 3)."""
        return self.body.rotation @ self._axes

    @property
    def origin(self) -> np.ndarray:
        """Its origin, (3,) [m]."""
        return self.body.origin + self.body.rotation @ self._place

    @property
    def velocity(self) -> np.ndarray:
        """That of its origin, (3,) [m/s]."""
        return self.body.velocity + cross(self.body.spin, self.body.rotation @ self._place)


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


class JointPlace:
    """Where a joint is on its second body that takes hold of its bodies wherever they are.

    Parameters
    ----------
    data : Data
        With own places, see :func:`with_own_places`.
    written : Model
        As the scene has it.
    joint : TimedJoint

    Attributes
    ----------
    assigned : ndarray, shape (4, 4), or None
        The pose where it has been put, itself; None: where the scene has it.
    """

    assigned: np.ndarray | None

    def __init__(self, data: Data, written: Model, joint: TimedJoint) -> None:
        self._data, self._written, self._joint = data, written, joint
        layout, name = written.layout, joint.connection
        rows, first = layout.contacts_of(layout.owners.index(name)), written.frames[name]
        self._moved = on_object(written.constants.contacts, range(rows.start, rows.stop))
        self._first, self._second = (JointFrame(data, name, second) for second in (False, True))
        self._frames, before = data.model.frames_on_bodies(name), written.frames_on_bodies(name)
        self._turn, self._origin = before.on_object.copy(), before.origin_on_object.copy()
        self.assigned = None
        # from the joint's frame on its second body to that of ``at`` in a scene
        self._of_scene = first.on_object @ _inverse(self._turn, self._origin)

    def take_hold(self) -> None:
        """Hold the bodies where they are, at the kinematics in the data."""
        offset, body, rotation = self._joint.offset, self._second.body, self._first.rotation
        origin = self._first.origin + rotation @ offset[:3, 3] - body.origin
        to_body = body.rotation.T
        self._move(to_body @ rotation @ offset[:3, :3], to_body @ origin)
        self.assigned = self._seen_by_scene()

    def return_to_scene(self) -> None:
        """Be where the scene has it."""
        self._move(self._turn, self._origin)
        self.assigned = None

    @property
    def pose(self) -> np.ndarray:
        """Pose (4, 4) on the second body, as ``at`` of a scene has it."""
        return self._seen_by_scene() if self.assigned is None else self.assigned

    @pose.setter
    def pose(self, pose: np.ndarray) -> None:
        of_body = np.linalg.solve(self._of_scene, pose)
        self._move(of_body[:3, :3] @ self._joint.axes, of_body[:3, 3])
        self.assigned = pose

    def _seen_by_scene(self) -> np.ndarray:
        pose = self._of_scene @ pose_matrix(self._frames.on_object, self._frames.origin_on_object)
        pose[:3, :3] = pose[:3, :3] @ self._joint.axes.T
        return pose

    def _move(self, turn: np.ndarray, origin: np.ndarray) -> None:
        self._frames.on_object[:], self._frames.origin_on_object[:] = turn, origin
        by = turn @ self._turn.T
        place = by, origin - by @ self._origin
        table = self._data.model.constants.contacts
        move_on_object(self._written.constants.contacts, self._moved, place, table)


def _inverse(rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
    return pose_matrix(rotation.T, -rotation.T @ origin)
