"""The contacts of a run in an animation: places from the system, forces and states as recorded.

A channel of forces has a column for each row of W.  Rows that belong to a joint of an arm have no
place and are not shown; rows of friction are arrows only, at their contact's point.

An unbounded contact surface is shown around the point where it is touched at the start, a surface
with a patch only there; a user-defined surface is shown if it is a parametrisation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from multiarm.dynamics.contact_geometry import contact_places
from multiarm.geometry.records import (
    CONE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SPHERE,
    TORUS,
    Contact,
    Surface,
)
from multiarm.geometry.smooth_surfaces import ParametricSurface
from multiarm.geometry.triangle_mesh import TriangleMesh
from multiarm.results.channels import channels_of
from multiarm.results.contact_states import ContactState
from multiarm.results.event_kinds import family_of
from multiarm.results.event_log import Event, timed
from multiarm.scene.bodies import BodyName
from multiarm.viewer.animation import Body, ContactTracks, EventPlace
from multiarm.viewer.body_poses import BodyPoses, pose_at, positions_at
from multiarm.viewer.joints_in_time import PlacedJoints, holding, places_on_second
from multiarm.viewer.solids import revolve

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory


FLOOR_COLOR = np.array([0.36, 0.40, 0.46])


def contacts_of(
    system: System, trajectory: Trajectory, rows: np.ndarray, colors: dict[str, np.ndarray]
) -> list[ContactTracks]:
    """Return the contacts of connections and of the floor at some samples (`rows`) of a run."""
    places = _places(system, trajectory, rows)
    points, normals = (np.array(side) for side in zip(*places, strict=True))  # (K, N, 3)
    tracks, wrenches = [], channels_of(trajectory.channels, "wrench")
    for owner, channel in channels_of(trajectory.channels, "contact_force").items():
        rows_of_w = rows_of(system, owner)
        shown = {k: r for k in rows_of_w if isinstance(r := system.model.records[k], Contact)}
        if not shown:
            continue
        k, records = list(shown), list(shown.values())
        columns = np.array(k) - rows_of_w.start
        labels = trajectory.channels[channel].labels
        if len(labels) != len(rows_of_w):  # contacts of code that was not loaded are missing
            columns = np.array([labels.index(record.name) for record in records])
        tracks.append(
            ContactTracks(
                arm=owner,
                color=colors.get(owner, FLOOR_COLOR),
                point=points[:, k],
                normal=normals[:, k],
                force=trajectory.read(channel)[rows][:, columns],
                state=row_states(trajectory, owner, records, rows),
                names=tuple(record.name for record in records),
                friction=tuple(_is_friction(trajectory, owner, record) for record in records),
                total=trajectory.read(wrenches[owner])[rows, :3] if owner in wrenches else None,
            )
        )
    return tracks


def event_places(
    trajectory: Trajectory, time: np.ndarray, contacts: Sequence[ContactTracks]
) -> list[EventPlace]:
    """Return the events that name a point or a visible contact; `time` is that of frames [s]."""
    tracks = {c.arm: c for c in contacts}
    return [
        EventPlace(float(event["time"]), family_of(event["kind"]), where)
        for event in timed(trajectory.events)
        if (where := _place(event, time, tracks)) is not None
    ]


def row_states(
    trajectory: Trajectory, owner: str, records: Sequence[Contact], rows: np.ndarray
) -> np.ndarray | None:
    """Return the states of contacts at some samples, codes (K, N); None if all are permanent.

    A row of friction has the state of its contact; a contact without a state is touching.  Those of
    a joint that does not hold are open.
    """
    labels, joints = _labels(trajectory, owner), trajectory.scene.joints
    joint = next((joint for joint in joints if joint.connection == owner), None)
    holds = None if joint is None else holding(trajectory, joint, trajectory.time[rows])
    if not labels and holds is None:
        return None
    codes = np.full((len(rows), len(records)), ContactState.TOUCHING)
    for k, record in enumerate(records):
        name = record.parent if record.tangent else record.name
        if name in labels:
            states = trajectory.contact_states[owner][rows]
            codes[:, k] = np.round(states[:, labels.index(name)])
    if holds is not None:
        codes[~holds] = ContactState.OPEN
    return codes


def rows_of(system: System, owner: str) -> range:
    """Rows of W of an arm, a connection, a robot, or of an object's own contacts."""
    layout = system.model.layout
    if owner not in layout.owners:
        return range(layout.contacts, layout.contacts)
    rows = layout.contacts_of(layout.owners.index(owner))
    return range(rows.start, rows.stop)


def _place(
    event: Event, time: np.ndarray, tracks: Mapping[str, ContactTracks]
) -> np.ndarray | None:
    where = event.get("where")
    if where is not None:
        point = np.array(where, dtype=float)
        return point if point.shape == (3,) and np.isfinite(point).all() else None
    track, contact = tracks.get(event.get("arm", "")), event.get("contact")
    if track is None or contact not in track.names:
        return None
    frame = int(np.abs(time - event["time"]).argmin())
    return track.point[frame, track.names.index(contact)]


def _is_friction(trajectory: Trajectory, owner: str, record: Contact) -> bool:
    return bool(record.tangent) and record.parent in _labels(trajectory, owner)


def _labels(trajectory: Trajectory, owner: str) -> tuple[str, ...]:
    """Names of the contacts that have states."""
    channel = channels_of(trajectory.channels, "contact_state").get(owner)
    return () if channel is None else trajectory.channels[channel].labels


def _places(
    system: System, trajectory: Trajectory, rows: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    with system.borrow() as data:
        placed_joints = PlacedJoints(system, trajectory, data)
        return [
            contact_places(
                placed_joints.at(float(trajectory.time[row])),
                system.state(**positions_at(trajectory, row)),
            )
            for row in rows
        ]


SURFACE_OPACITY = 0.45
# Parts of a surface along its profile, and of a grid along each of its two directions.
CELLS = 40


def surface_bodies(
    system: System,
    trajectory: Trajectory,
    poses: BodyPoses,
    colors: dict[str, np.ndarray],
    faces: bool = True,
) -> list[Body]:
    """Return the contact surfaces of joints that are drawn so at the samples of some poses.

    Those of other kinds only serve to define a hinge.
    Plane faces of objects are included if ``faces`` is true.
    """
    ways = [np.ptp(motion.position, axis=0).max() for motion in trajectory.objects.values()]
    extent = max(*ways, object_size(system))
    bodies = []
    for joint in system.scene.joints:
        if joint.drawn_as != "surfaces":
            continue
        name, sides = joint.connection, {"arm": joint.first, "object": joint.second}
        moved = {side: placed(poses.of(body)) for side, body in sides.items()}
        if joint.intervals:  # it takes hold where its bodies are
            written, time = system.frames[name].on_object, trajectory.time[poses.rows]
            places = places_on_second(trajectory, joint, written, time)
            moved["object"] = placed(poses.of(joint.second) @ places @ np.linalg.inv(written))
        records = [record for record in system.contacts[name] if isinstance(record, Contact)]
        touched = _touched(system, name, sides)
        states = row_states(trajectory, name, records, poses.rows)
        for (side, *_), on_surface in _surfaces(records).items():
            k = on_surface[0]
            if sides[side].is_object and not faces and getattr(records[k], side).kind == PLANE:
                continue
            mesh = surface_mesh(getattr(records[k], side), touched[side][k], extent)
            if mesh is None:
                continue
            met = None
            if states is not None:
                met = (states[:, on_surface] != ContactState.OPEN).any(axis=1)
            path = f"surfaces/{name}/{k + 1}_{side}"
            bodies.append(Body(path, mesh, *moved[side], colors[name], SURFACE_OPACITY, met))
    return bodies


def placed(poses: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (K, 3) and quaternions (K, 4), scalar last, of poses (K, 4, 4)."""
    packed = np.array([pin.SE3ToXYZQUAT(pin.SE3(pose)) for pose in poses])
    return packed[:, :3], packed[:, 3:]


def _surfaces(contacts: Sequence[Contact]) -> dict[tuple, list[int]]:
    """Return the contacts of each surface: one surface may be touched at many points."""
    contacts_of_surface: dict[tuple, list[int]] = {}
    for k, contact in enumerate(contacts):
        for side in ("arm", "object"):
            surface: Surface = getattr(contact, side)
            key = (side, surface.kind, surface.origin.tobytes(), surface.axes.tobytes())
            contacts_of_surface.setdefault(key, []).append(k)
    return contacts_of_surface


def surface_mesh(surface: Surface, touched: np.ndarray, extent: float) -> TriangleMesh | None:
    """Return a surface as triangles in its body's frame; None if there is nothing to draw.

    An unbounded one is cut to a size `extent` [m] around the contact point at the start, in the
    body's frame.
    """
    around = surface.axes.T @ (touched - surface.origin)
    local = _unplaced(surface, around, 0.5 * extent)
    if local is None:
        return None
    vertices, triangles = local.vertices @ surface.axes.T + surface.origin, local.triangles
    if surface.patch is not None:
        inside = np.array([surface.patch.excess(p) <= 0.0 for p in vertices])
        triangles = triangles[inside[triangles].all(axis=1)]
    if not len(triangles):
        return None
    return TriangleMesh(vertices, triangles[:, ::-1] if surface.inside else triangles)


def _unplaced(surface: Surface, around: np.ndarray, reach: float) -> TriangleMesh | None:
    """Return a surface in its own frame, `reach` [m] to each side of a point if it is unbounded."""
    a, b, c = surface.sizes
    line = np.linspace(-1.0, 1.0, CELLS + 1)
    if surface.kind == PLANE:
        x, y = np.meshgrid(around[0] + reach * line, around[1] + reach * line, indexing="ij")
        return _grid(np.stack([x, y, np.zeros_like(x)], -1))
    if surface.kind == CYLINDER:
        return revolve(np.column_stack([np.full_like(line, a), around[2] + reach * line]))
    if surface.kind == CONE:
        way = 0.5 * (1.0 + line) * (np.linalg.norm(around) + reach)
        return revolve(np.column_stack([a * way, b * way]))
    if surface.kind == TORUS:
        angle = np.pi * line
        return revolve(np.column_stack([a + b * np.cos(angle), b * np.sin(angle)]))
    if surface.kind in (SPHERE, ELLIPSOID):
        if not a > 0.0:
            return None  # a point: its contact has a mark of its own
        angle = 0.5 * np.pi * line
        ball = revolve(np.column_stack([np.cos(angle), np.sin(angle)]))
        return ball.scaled(np.array([a, a, a] if surface.kind == SPHERE else [a, b, c]))
    if isinstance(surface.function, ParametricSurface):
        return _grid(surface.function.grid(CELLS))
    return None


def _grid(points: np.ndarray) -> TriangleMesh:
    """Return two triangles for each square of a grid of points, (CELLS + 1, CELLS + 1, 3)."""
    corner = np.arange((CELLS + 1) ** 2).reshape(CELLS + 1, CELLS + 1)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    triangles = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    return TriangleMesh(points.reshape(-1, 3), triangles.reshape(-1, 3))


def _touched(system: System, name: str, sides: Mapping[str, BodyName]) -> dict[str, np.ndarray]:
    """Return the contact points of a connection at the start, by side, in its body's frame (N, 3).

    The frame of a link is that of its tip.
    """
    start = system.initial_state()
    rows = [k for k in rows_of(system, name) if isinstance(system.model.records[k], Contact)]
    with system.borrow() as data:
        points = contact_places(data, start)[0][rows]
    poses = {side: pose_at(system, start, body) for side, body in sides.items()}
    return {side: (points - pose[:3, 3]) @ pose[:3, :3] for side, pose in poses.items()}


def object_size(system: System) -> float:
    """Return the largest radius of gyration of an object [m], about its half size."""
    specs = system.scene.all_objects.values()
    return float(np.sqrt(max(np.trace(spec.inertia_matrix()) / spec.mass for spec in specs)))
