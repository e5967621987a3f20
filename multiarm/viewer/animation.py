"""An animation: what a replay shows, independent of renderers and of robot libraries.

It is a list of bodies (a mesh and its pose at every frame), the contacts of each arm (point,
normal, force at every frame), the axes of its joint, and the events.  `animate` makes it from a
trajectory, `drawing` draws it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from multiarm.results.channels import OPEN
from multiarm.results.event_log import Event, Family
from multiarm.viewer.mesh import Mesh

SPIKE = 3.0  # times the usual force


@dataclass(frozen=True)
class Body:
    """A rigid shape in motion.

    Parameters
    ----------
    name : str
        Path in the scene tree, such as ``arms/left/forearm_link``.
    mesh : Mesh
        Shape in the body's frame [m].
    position : array, shape (K, 3)
        Origin of the body's frame at each frame of the animation, world axes [m].
    quaternion_xyzw : array, shape (K, 4)
        Its orientation.
    color : array, shape (3,)
        Tint, sRGB in 0..1; it multiplies the colours of the mesh.
    opacity : float
        1 hides what is inside.
    touched : bool array, shape (K,), optional
        False in frames in which nothing touches this surface: it is faint then.
    """

    name: str
    mesh: Mesh
    position: np.ndarray
    quaternion_xyzw: np.ndarray
    color: np.ndarray
    opacity: float = 1.0
    touched: np.ndarray | None = None


@dataclass(frozen=True)
class ContactTracks:
    """The N contacts of one arm, or of the object with the floor.

    Parameters
    ----------
    arm : str
        The arm, or "floor".
    color : array, shape (3,)
        sRGB in 0..1.
    point : array, shape (K, N, 3)
        World position [m].
    normal : array, shape (K, N, 3)
        Unit vector into the object, world axes.
    force : array, shape (K, N)
        Force along the normal [N]; positive pushes the object.
    state : int array, shape (K, N), optional
        Codes of `channels.CONTACT_STATES`; absent for permanent contacts.
    names : tuple of str
        Of the contacts, as in events.
    friction : tuple of bool
        True for a row of friction at another contact's point: an arrow without a mark.
    """

    arm: str
    color: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    force: np.ndarray
    state: np.ndarray | None = None
    names: tuple[str, ...] = ()
    friction: tuple[bool, ...] = ()


@dataclass(frozen=True)
class Dial:
    """A coordinate of a joint that has limits.

    Parameters
    ----------
    turns : bool
        An angle [rad]; otherwise a slide [m].
    limits : (float, float)
        From the start, which is 0.
    value : array, shape (K,)
    """

    turns: bool
    limits: tuple[float, float]
    value: np.ndarray


@dataclass(frozen=True)
class HingeTracks:
    """The visible form of a joint: an axle, a rail, a sleeve or a ball.

    Parameters
    ----------
    arm : str
    name : str
        Its path below the joints' node, such as ``left`` or ``left/2``.
    shape : "axle", "rail", "sleeve" or "ball"
        The tip turns about the axis, slides along it, does both, or turns every way.
    color : array, shape (3,)
        sRGB in 0..1.
    position : array, shape (K, 3)
        A point of the axis, or the ball's centre, world [m].
    quaternion_xyzw : array, shape (K, 4)
        Frame on the body that carries the axis: z is the axis, and an angle is counted from x.
    dials : tuple of Dial
        The coordinates that have limits.
    """

    arm: str
    name: str
    shape: str
    color: np.ndarray
    position: np.ndarray
    quaternion_xyzw: np.ndarray
    dials: tuple[Dial, ...] = ()


@dataclass(frozen=True)
class EventPlace:
    """The place of an event.

    Parameters
    ----------
    time : float
        [s], as that of the frames.
    family : Family
        Of the kind of event.
    where : array, shape (3,)
        World position [m].
    """

    time: float
    family: Family
    where: np.ndarray


@dataclass(frozen=True)
class Animation:
    """A moving scene of K frames.

    Parameters
    ----------
    title : str
    time : array, shape (K,)
        Time of each frame [s], increasing.
    bodies : list of Body
        The first is the common object.
    contacts : list of ContactTracks
    hinges : list of HingeTracks
    floor : float
        Height of the floor [m].
    note : str
        Shown in the viewer, such as why the run ended early; may be empty.
    event_places : list of EventPlace
        Events that are shown at a place.
    events : list of dict
        As in `Trajectory.events`.
    """

    title: str
    time: np.ndarray
    bodies: list[Body]
    contacts: list[ContactTracks] = field(default_factory=list)
    hinges: list[HingeTracks] = field(default_factory=list)
    floor: float = 0.0
    note: str = ""
    event_places: list[EventPlace] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    @property
    def peak_force(self) -> float:
        """The largest magnitude of a contact force in the animation [N]; 0 without any."""
        return float(self._peaks().max())

    @property
    def force_scale(self) -> float:
        """The force that the longest arrow stands for [N]; 0 without any force.

        It is the peak, or the 95th percentile over the frames if the peak is a spike next to which
        all other arrows would vanish. Larger forces are drawn at full length.
        """
        usual = float(np.percentile(self._peaks(), 95))
        return usual if 0 < SPIKE * usual < self.peak_force else self.peak_force

    def _peaks(self) -> np.ndarray:
        """Return the largest force of each frame, shape (K,) [N]."""
        peaks = [np.abs(c.force).max(axis=1, initial=0.0) for c in self.contacts]
        return np.max(peaks, axis=0) if peaks else np.zeros(len(self.time))

    def arrow_lengths(self, contacts: ContactTracks) -> np.ndarray:
        """Return forces over `force_scale`, shape (K, N), within -1..1; 0 for an open contact."""
        scale = self.force_scale
        lengths = np.clip(contacts.force / scale, -1, 1) if scale else 0 * contacts.force
        return lengths if contacts.state is None else np.where(contacts.state == OPEN, 0.0, lengths)

    def extent(self) -> np.ndarray:
        """Return points whose hull holds every body and contact at every frame, shape (P, 3)."""
        points = [c.point.reshape(-1, 3) for c in self.contacts]
        for body in self.bodies:
            R = rotations(body.quaternion_xyzw)  # (K, 3, 3)
            corners = np.einsum("kij,cj->kci", R, body.mesh.bounds()) + body.position[:, None]
            points.append(corners.reshape(-1, 3))
        return np.concatenate(points)

    def tails(self, longest: float) -> np.ndarray:
        """Return the outer ends of force arrows of at most the length `longest` [m], (P, 3)."""
        ends = [
            c.point - longest * np.abs(self.arrow_lengths(c))[..., None] * c.normal
            for c in self.contacts
        ]
        return np.concatenate([np.empty((0, 3)), *(e.reshape(-1, 3) for e in ends)])

    def size(self) -> float:
        """Return the diagonal of the bounding box [m], to which all glyphs are scaled."""
        return float(np.linalg.norm(np.ptp(self.extent(), axis=0)))


def rotations(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """Return the rotation matrices, shape (K, 3, 3), of unit quaternions, shape (K, 4)."""
    v, w = quaternion_xyzw[:, :3], quaternion_xyzw[:, 3, None, None]
    V = np.cross(np.eye(3)[None], v[:, None])  # V @ a = v x a
    return np.eye(3) + 2 * w * V + 2 * V @ V


def continuous(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """Return the quaternions, shape (K, 4), with signs such that neighbours are closest.

    q and -q are the same rotation, but interpolation between them goes the long way round.
    """
    flips = np.sign(np.einsum("ki,ki->k", quaternion_xyzw[1:], quaternion_xyzw[:-1]))
    signs = np.cumprod(np.concatenate([[1.0], np.where(flips < 0, -1.0, 1.0)]))
    return quaternion_xyzw * signs[:, None]


def along(directions: np.ndarray) -> np.ndarray:
    """Return quaternions (K, N, 4), continuous in k, that turn z onto unit `directions` (K, N, 3).

    Each frame is the last one turned by the smallest rotation: the spin about the direction,
    which is free, never jumps.
    """
    quaternions = np.empty((*directions.shape[:2], 4))
    last_direction = np.tile([0.0, 0.0, 1.0], (directions.shape[1], 1))
    last = np.tile([0.0, 0.0, 0.0, 1.0], (directions.shape[1], 1))
    for k, direction in enumerate(directions):
        last = _product(_smallest_turns(last_direction, direction), last)
        last /= np.linalg.norm(last, axis=1, keepdims=True)
        quaternions[k], last_direction = last, direction
    return quaternions


def _smallest_turns(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the quaternions (N, 4) of the smallest rotations of unit vectors a to b (N, 3)."""
    turns = np.column_stack([np.cross(a, b), 1 + np.einsum("ni,ni->n", a, b)])
    for i in np.flatnonzero(turns[:, 3] < 1e-9):  # opposite: half a turn about any axis across
        turns[i, :3] = np.cross(a[i], np.eye(3)[np.argmin(np.abs(a[i]))])
        turns[i, 3] = 0.0
    return turns / np.linalg.norm(turns, axis=1, keepdims=True)


def _product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the quaternion products p q, shape (N, 4), scalar last."""
    p_xyz, p_w, q_xyz, q_w = p[:, :3], p[:, 3:], q[:, :3], q[:, 3:]
    xyz = p_w * q_xyz + q_w * p_xyz + np.cross(p_xyz, q_xyz)
    return np.column_stack([xyz, p_w * q_w - np.sum(p_xyz * q_xyz, axis=1, keepdims=True)])
