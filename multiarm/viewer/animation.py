"""An animation: what a replay shows, independent of renderers and of robot libraries.

It is a list of bodies (a mesh and its pose at every frame), the contacts of each arm or connection
(point, normal, force at every frame), the axes of its joint, and the events. `animate` makes it
from a trajectory, `drawing` draws it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from multiarm.geometry.triangle_mesh import TriangleMesh
from multiarm.results.contact_states import ContactState
from multiarm.results.event_kinds import Family
from multiarm.results.event_log import Event
from multiarm.results.limit_use import ROUNDED_SHARE

SPIKE = 3.0  # times the usual force


@dataclass(frozen=True)
class Body:
    """A rigid shape in motion; its poses have shapes (K, 3) and (K, 4), a row for each frame."""

    name: str  # path in the scene tree, such as ``arms/left/forearm_link``
    mesh: TriangleMesh  # in the body's frame [m]
    position: np.ndarray  # of the origin of the body's frame, world axes [m]
    quaternion_xyzw: np.ndarray
    color: np.ndarray  # tint, sRGB in 0..1, shape (3,); it multiplies the colours of the mesh
    opacity: float = 1.0  # 1 hides what is inside
    touched: np.ndarray | None = None  # (K,): False while nothing touches it, and it is faint


@dataclass(frozen=True)
class ContactTracks:
    """The N contacts of one arm or connection, or of the object with the floor."""

    arm: str  # or the connection, or "floor"
    color: np.ndarray  # sRGB in 0..1, shape (3,)
    point: np.ndarray  # world position [m], shape (K, N, 3)
    # unit vector into the object, or the connection's second body, world axes, shape (K, N, 3)
    normal: np.ndarray
    force: np.ndarray  # along the normal [N], shape (K, N); positive pushes that body
    # codes of `channels.ContactState`, shape (K, N); absent for permanent contacts
    state: np.ndarray | None = None
    names: tuple[str, ...] = ()  # as in events
    # True for a row of friction at another contact's point: an arrow without a mark
    friction: tuple[bool, ...] = ()
    total: np.ndarray | None = None  # force of all contacts on that body, world [N], shape (K, 3)


@dataclass(frozen=True)
class Dial:
    """A coordinate of a joint that has limits."""

    turns: bool  # an angle [rad]; otherwise a slide [m]
    limits: tuple[float, float]  # from the start, which is 0
    value: np.ndarray  # shape (K,)

    @property
    def passed_at(self) -> tuple[float, float]:
        """Values beyond which a limit is passed: a stop that is touched is not."""
        low, high = self.limits
        slack = ROUNDED_SHARE * (high - low) / 2.0  # of the share, as in `Trajectory.limit_use`
        return low - slack, high + slack


@dataclass(frozen=True)
class HingeTracks:
    """The visible form of a joint.

    An "axle": the first body turns about the axis; a "rail": it slides along it; a "sleeve": both;
    a "ball": it turns every way.
    """

    arm: str  # or the connection
    name: str  # its path below the joints' node, such as ``left`` or ``left/2``
    shape: str  # "axle", "rail", "sleeve" or "ball"
    color: np.ndarray  # sRGB in 0..1, shape (3,)
    position: np.ndarray  # of a point of the axis, or of the ball's centre, world [m], shape (K, 3)
    # of the body that carries the axis: z is the axis, an angle is counted from x; shape (K, 4)
    quaternion_xyzw: np.ndarray
    dials: tuple[Dial, ...] = ()
    shown: np.ndarray | None = None  # whether it holds, (K,) of truth values; None: always


@dataclass(frozen=True)
class EventPlace:
    """The place of an event."""

    time: float  # [s], as that of the frames
    family: Family
    where: np.ndarray  # world position [m], shape (3,)


@dataclass(frozen=True)
class Animation:
    """A moving scene of K frames."""

    title: str
    time: np.ndarray  # of each frame [s], increasing, shape (K,)
    bodies: list[Body]  # the objects are the first ones
    contacts: list[ContactTracks] = field(default_factory=list)
    hinges: list[HingeTracks] = field(default_factory=list)
    floor: float = 0.0  # its height [m]
    note: str = ""  # shown in the viewer, such as why the run ended early
    event_places: list[EventPlace] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)  # as in `Trajectory.events`
    objects: int = 1  # number of the objects

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
        if contacts.state is None:
            return lengths
        return np.where(contacts.state == ContactState.OPEN, 0.0, lengths)

    def extent(self) -> np.ndarray:
        """Return points whose hull holds every body and contact at every frame, shape (P, 3)."""
        points = [c.point.reshape(-1, 3) for c in self.contacts]
        for body in self.bodies:
            corners = moving(body.mesh.bounds(), body.position, body.quaternion_xyzw)
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
    return Rotation.from_quat(quaternion_xyzw).as_matrix()


def moving(points: np.ndarray, position: np.ndarray, quaternion_xyzw: np.ndarray) -> np.ndarray:
    """Return points (P, 3) of a body, whose poses are (K, 3) and (K, 4), in the world (K, P, 3)."""
    return np.einsum("kij,pj->kpi", rotations(quaternion_xyzw), points) + position[:, None]


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
    last = Rotation.identity(directions.shape[1])
    for k, direction in enumerate(directions):
        last = Rotation.from_quat(_smallest_turns(last_direction, direction)) * last
        quaternions[k], last_direction = last.as_quat(), direction
    return quaternions


def _smallest_turns(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the quaternions (N, 4) of the smallest rotations of unit vectors a to b (N, 3)."""
    turns = np.column_stack([np.cross(a, b), 1 + np.einsum("ni,ni->n", a, b)])
    for i in np.flatnonzero(turns[:, 3] < 1e-9):  # opposite: half a turn about any axis across
        turns[i, :3] = np.cross(a[i], np.eye(3)[np.argmin(np.abs(a[i]))])
        turns[i, 3] = 0.0
    return turns / np.linalg.norm(turns, axis=1, keepdims=True)
