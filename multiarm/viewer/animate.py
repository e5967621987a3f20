"""From a trajectory to an animation: the only place where a replay meets robots and dynamics.

Frames are samples of the trajectory; between two of them the page interpolates.  Link poses come
from each robot's kinematics, contact points and normals from the system's evaluation, contact
forces, states and events from the trajectory, and the axes of joints from their frames: a joint's
frame has the axis as its z axis (:class:`multiarm.contacts.joint.JointFrame`).

Grasps in form closure by pushing contacts on plane faces also show, on each face, the region in
which a contact keeps the grasp closed; the other contacts stay where they are at the start.
"""

from __future__ import annotations

import colorsys
import warnings
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from multiarm.assembly.compilation import geometry_of
from multiarm.contacts.joint import axis_travel, limits_of
from multiarm.errors import GraspError, ReplayError
from multiarm.geometry.triangle_mesh import TriangleMesh
from multiarm.grasp.body.face import cut_into_triangles
from multiarm.grasp.scenes.judging import SceneGrasp, read_grasp
from multiarm.results.outcome import RunStatus
from multiarm.scene import without_code
from multiarm.scene.control import NoControl
from multiarm.viewer.animation import (
    Animation,
    Body,
    Dial,
    HingeTracks,
    moving,
)
from multiarm.viewer.body_poses import BodyPoses, positions_at
from multiarm.viewer.commands import rgb
from multiarm.viewer.contact_tracks import (
    contacts_of,
    event_places,
    object_size,
    placed,
    surface_bodies,
)
from multiarm.viewer.joints_in_time import holding, places_on_second
from multiarm.viewer.robot_bodies import Shapes, bodies_of_arms, bodies_of_robot
from multiarm.viewer.shapes import object_mesh
from multiarm.viewer.solids import Z_TO_X, box, cylinder

if TYPE_CHECKING:
    from multiarm.contacts.joint import JointFrame
    from multiarm.dynamics.system import System
    from multiarm.grasp.seventh_contact.contact_region import ContactRegion
    from multiarm.results.trajectory import Trajectory
    from multiarm.scene import JointSpec, Scene


PALETTE = ("#4a80c9", "#f08a45", "#4fa36a", "#9b6bc2", "#d9596a", "#2fa3a8", "#d3a62f", "#7a8797")
OBJECT_PALETTE = ("#f0c799", "#a9c8e8", "#b9d8a6", "#d9b8e0", "#e8b4b0", "#b8dcd8")
OBJECT_OPACITY = 0.5
MOST_FRAMES = 6000


def animate(trajectory: Trajectory, *, fps: float, speed: float, meshes: bool) -> Animation:
    """Return the animation of a trajectory, see :func:`multiarm.replay` for what is given.

    A failed run is shown up to its last sample.

    Raises
    ------
    ReplayError
        The trajectory has no samples.
    """
    rows = frame_rows(trajectory.time, fps / speed)
    system, missing = _system(trajectory)
    colors = colors_of(system)
    poses = BodyPoses(system, trajectory, rows)
    links, feet, floors = _robots(system, poses.configurations, colors, Shapes(meshes))
    objects = _objects(trajectory, rows)
    bodies = [*objects, *links]
    grasp = None if missing else scene_grasp(system)  # regions depend on all contacts
    if grasp is not None:
        bodies += region_bodies(grasp, trajectory, rows, colors)
    plain = grasp is not None and grasp.body is not None  # its faces are the object's own
    bodies += surface_bodies(system, trajectory, poses, colors, faces=not plain)
    ground = ground_bodies(trajectory, rows, object_size(system), feet)
    bodies += ground
    floors += [lowest(body) for body in ground]
    floor = min(floors or map(lowest, bodies))
    bodies += columns(feet, floor, len(rows))
    contacts = contacts_of(system, trajectory, rows, colors)
    note = "" if trajectory.status == RunStatus.COMPLETED else trajectory.message
    notes = [f"{trajectory.status}: {note}"] if note else []
    return Animation(
        title=trajectory.scene.name,
        time=trajectory.time[rows],
        bodies=bodies,
        contacts=contacts,
        hinges=hinges_of(system, trajectory, poses, colors),
        floor=float(floor),
        note="; ".join([*notes, *missing]),
        event_places=event_places(trajectory, trajectory.time[rows], contacts),
        events=trajectory.events,
        objects=len(objects),
    )


def _system(trajectory: Trajectory) -> tuple[System, list[str]]:
    """What is to be drawn, at the run's first sample, and what is not for lack of its code."""
    # without its control, whose tables need not exist any more
    scene = trajectory.simulated_scene.model_copy(update={"control": NoControl()})
    scene, left_out = without_code(scene)
    system = geometry_of(scene, positions_at(trajectory, 0))
    not_drawn = [item for item in left_out if item.arm]
    if not not_drawn:
        return system, []
    owners = ", ".join(dict.fromkeys(_joint_words(scene, item.arm) for item in not_drawn))
    missing = (
        f"contacts and surfaces of {owners} that need "
        f"{', '.join(dict.fromkeys(item.what for item in not_drawn))} are not drawn: code that a "
        "result names is not loaded"
    )
    warnings.warn(missing, stacklevel=4)
    return system, [missing]


def _joint_words(scene: Scene, connection: str | None) -> str:
    return f"{'arm' if connection in scene.arms else 'joint'} {connection!r}"


def frame_rows(time: np.ndarray, rate: float) -> np.ndarray:
    """Return the indices of the samples nearest to a uniform `rate` [1/s], first and last too."""
    if len(time) == 0:
        raise ReplayError(
            "the trajectory holds no samples: there is nothing to replay; "
            "run the scene again and look at its message"
        )
    span = time[-1] - time[0]
    count = int(np.ceil(span * rate - 1e-9)) + 1
    if count > MOST_FRAMES:
        warnings.warn(
            f"the replay shows {MOST_FRAMES} of {count} frames, one every "
            f"{span / MOST_FRAMES:.3g} s; replay a shorter run for finer motion",
            stacklevel=3,
        )
        count = MOST_FRAMES
    wanted = np.linspace(time[0], time[-1], count)
    rows = np.unique(np.searchsorted((time[1:] + time[:-1]) / 2, wanted))  # the nearest ones
    return rows[np.diff(time[rows], prepend=-np.inf) > 0]


def colors_of(system: System) -> dict[str, np.ndarray]:
    """Return a colour, sRGB (3,) in 0..1, for each arm, connection, and tip of a robot.

    It is that of the scene, or one of a palette.  A connection has the colour of its tip; where its
    bodies are no tips, one more of the palette.
    """
    scene, colors = system.scene, dict[str, np.ndarray]()
    for name, arm in scene.arms.items():
        colors[name] = _color(arm.color, len(colors))
    for name, robot in scene.robots.items():
        for tip in robot.tips:
            colors[f"{name}/{tip}"] = _color(robot.color, len(colors))
    for name, connection in system.model.connections.items():
        tips = [str(body) for body in (connection.first, connection.second)]
        of_tip = next((colors[tip] for tip in tips if tip in colors), None)
        colors[name] = _color(None, len(colors)) if of_tip is None else of_tip
    return colors


def _color(chosen: tuple[float, ...] | None, place: int) -> np.ndarray:
    return _palette_color(place) if chosen is None else np.array(chosen[:3])


def _palette_color(i: int) -> np.ndarray:
    if i < len(PALETTE):
        return rgb(PALETTE[i])
    return np.array(colorsys.hsv_to_rgb(0.618034 * i % 1.0, 0.55, 0.8))  # hues far apart


def _robots(
    system: System,
    configurations: dict[str, np.ndarray],
    colors: dict[str, np.ndarray],
    shapes: Shapes,
) -> tuple[list[Body], dict[str, np.ndarray], list[float]]:
    """Return links, the poses on which robots with fixed bases stand, and heights of the floor."""
    bodies, feet, floors = [], {}, []
    for group in system.scene.arm_groups:
        arms = [system.arms[name] for name in group.arms]
        links, trunk = bodies_of_arms(arms, configurations, colors, shapes)
        bodies += links + trunk
        feet[group.arms[0]] = foot = arms[0].files.base.copy()
        foot[2, 3] = min([foot[2, 3], *map(lowest, trunk)])
        floors.append(foot[2, 3])
    for name, spec in system.scene.robots.items():
        tips = {tip: colors[f"{name}/{tip}"] for tip in spec.tips}
        links, base = bodies_of_robot(system.arms[name], configurations[name], tips, shapes)
        bodies += links
        foot = system.arms[name].files.base.copy()
        if foot[2, 2] < UPRIGHT or spec.base.floats:  # it stands on nothing
            continue
        foot[2, 3] = min([foot[2, 3], *map(lowest, base)])
        floors.append(foot[2, 3])
        if not spec.base.moves:
            feet[name] = foot
    return bodies, feet, floors


def _objects(trajectory: Trajectory, rows: np.ndarray) -> list[Body]:
    """Return the objects, in the colours of the scene, or in different ones."""
    bodies, motions = [], trajectory.objects
    for place, (name, spec) in enumerate(trajectory.scene.all_objects.items()):
        color, opacity = rgb(OBJECT_PALETTE[place % len(OBJECT_PALETTE)]), OBJECT_OPACITY
        if spec.color is not None:
            color = np.array(spec.color[:3])
            opacity = spec.color[3] if spec.color[3] < 1 else OBJECT_OPACITY
        path = f"objects/{name}" if len(motions) > 1 else "object"
        poses = motions[name].position[rows], motions[name].quaternion_xyzw[rows]
        bodies.append(Body(path, object_mesh(spec), *poses, color, opacity))
    return bodies


# Joints that are drawn as one thing on the object; a cross has two axles.
HINGE_SHAPES = ("axle", "rail", "sleeve", "ball")
CENTRED = 0.05  # an axis that passes the object's centre nearer than this, of its distance


def hinges_of(
    system: System, trajectory: Trajectory, poses: BodyPoses, colors: dict[str, np.ndarray]
) -> list[HingeTracks]:
    """Return the visible joints at the samples of some poses."""
    hinges, time = [], trajectory.time[poses.rows]
    for joint in system.scene.joints:
        if joint.drawn_as not in (*HINGE_SHAPES, "cross"):
            continue
        name = joint.connection
        frame = system.frames[name]
        on_first = poses.of(joint.first) @ frame.on_tip  # (K, 4, 4)
        on_second = poses.of(joint.second) @ frame.on_object
        if joint.intervals:
            places = places_on_second(trajectory, joint, frame.on_object, time)
            on_second = poses.of(joint.second) @ places
        shown = holding(trajectory, joint, time)
        of_joint = _hinges(joint, frame, on_first, on_second, colors[name])
        hinges += [replace(hinge, shown=shown) for hinge in of_joint]
    return hinges


def _hinges(
    joint: JointSpec,
    frame: JointFrame,
    on_first: np.ndarray,
    on_second: np.ndarray,
    color: np.ndarray,
) -> list[HingeTracks]:
    name = joint.connection
    if joint.drawn_as == "cross":  # about the second body's x and the first one's y axis
        axles = (on_second @ Z_TO_X, on_first @ Z_TO_X.T)  # z along x, and along y
        return [
            HingeTracks(name, f"{name}/{k}", "axle", color, *placed(axle))
            for k, axle in enumerate(axles, start=1)
        ]
    turn, slide = axis_travel(on_second, on_first)
    dials = tuple(
        Dial(limit.turns, (limit.low, limit.high), turn if limit.turns else slide)
        for limit in limits_of(joint)
        if limit.along_axis
    )
    place = placed(on_second @ _turned_outwards(frame.on_object))
    return [HingeTracks(name, name, joint.drawn_as, color, *place, dials)]


def _turned_outwards(on_object: np.ndarray) -> np.ndarray:
    """Return the turn about z that points x away from the second body's origin, where a sector is
    visible best; the identity if the axis passes through the origin.
    """
    x, y, _ = on_object[:3, :3].T @ on_object[:3, 3]
    turn, away = np.eye(4), np.hypot(x, y)
    if away > CENTRED * np.linalg.norm(on_object[:3, 3]):
        turn[:2, :2] = np.array([[x, -y], [y, x]]) / away
    return turn


GROUND_COLOR = np.array([0.62, 0.65, 0.69])
# Thickness of the slab over its shorter side, and its margin over the object's size.
GROUND_THICKNESS, GROUND_MARGIN = 0.02, 3.0
FOOT = 0.2  # room of a robot's base on the slab, to each side [m]
# Radius of a column over its height, at least and at most [m]; lower ones are not drawn.
SLENDER, THINNEST, THICKEST, LOWEST = 0.2, 0.03, 0.1, 0.02
UPRIGHT = 0.99  # vertical part of a base's axis z, at least


def ground_bodies(
    trajectory: Trajectory, rows: np.ndarray, size: float, feet: dict[str, np.ndarray]
) -> list[Body]:
    """Return the floor at some samples (`rows`) as a fixed body; an empty list without a floor.

    ``size`` is about half that of the largest object [m].  An unbounded floor is drawn below the
    whole paths of the objects with a margin, and below upright robots, which stand at ``feet``.
    """
    spec = trajectory.scene.effects.floor
    if spec is None:
        return []
    pose = spec.at.matrix()
    paths = np.concatenate([motion.position for motion in trajectory.objects.values()])
    over = (paths - pose[:3, 3]) @ pose[:3, :3]
    middle, sides = np.zeros(3), np.zeros(3)
    if spec.size is None:
        low, high = over.min(axis=0) - GROUND_MARGIN * size, over.max(axis=0) + GROUND_MARGIN * size
        for foot in feet.values():
            if foot[2, 2] >= UPRIGHT:
                at = (foot[:3, 3] - spec.at.matrix()[:3, 3]) @ pose[:3, :3]
                low, high = np.minimum(low, at - FOOT), np.maximum(high, at + FOOT)
        middle[:2] = 0.5 * (low + high)[:2]
        sides[:2] = (high - low)[:2]
    else:
        sides[:2] = spec.size
    sides[2] = GROUND_THICKNESS * sides[:2].min()
    middle[2] = -0.5 * sides[2]
    pose[:3, 3] += pose[:3, :3] @ middle
    return [Body("floor", box(sides), *placed([pose] * len(rows)), GROUND_COLOR)]


def columns(feet: dict[str, np.ndarray], floor: float, frames: int) -> list[Body]:
    """Return a column for each upright robot that stands above the floor's height [m].

    `feet` are poses (4, 4) of the bases, or of the trunks where these are lower, in the world.
    """
    bodies = []
    for name, foot in feet.items():
        height = float(foot[2, 3] - floor)
        if height < LOWEST or foot[2, 2] < UPRIGHT:
            continue
        mesh = cylinder(float(np.clip(SLENDER * height, THINNEST, THICKEST)), height)
        middle = np.eye(4)
        middle[:3, 3] = *foot[:2, 3], floor + 0.5 * height
        bodies.append(Body(f"columns/{name}", mesh, *placed([middle] * frames), GROUND_COLOR))
    return bodies


def lowest(body: Body) -> float:
    """Return the height of a resting body's lowest point [m]."""
    corners = moving(body.mesh.vertices, body.position[:1], body.quaternion_xyzw[:1])
    return float(corners[..., 2].min())


REGION_OPACITY = 0.35
# Height over the face in sizes of the object, so that both are distinct; regions of several
# contacts on one face lie one over the other.
REGION_LIFT = 1e-3


def scene_grasp(system: System) -> SceneGrasp | None:
    """The grasp at the start if it has regions to show; else None."""
    if len(system.model.layout.objects) > 1:  # a grasp is of one object
        return None
    if not any(contact.pushes_only for contact in chain(*system.contacts.values())):
        return None
    try:
        grasp = read_grasp(system)
    except GraspError:
        return None
    return grasp if grasp.only_pushes and grasp.closure else None


def region_bodies(
    grasp: SceneGrasp, trajectory: Trajectory, rows: np.ndarray, colors: dict[str, np.ndarray]
) -> list[Body]:
    """The regions of all contacts at some samples (`rows`), as thin sheets on the object."""
    poses = trajectory.object_position[rows], trajectory.object_quaternion_xyzw[rows]
    bodies = []
    layers: dict[int | None, int] = {}
    for (arm, k), face, region in zip(grasp.rows, grasp.faces, grasp.regions, strict=True):
        if region is None or grasp.body is None:
            continue
        layers[face] = layers.get(face, 0) + 1
        mesh = sheet(region, layers[face] * REGION_LIFT * grasp.body.size)
        bodies.append(Body(f"regions/{arm}/{k + 1}", mesh, *poses, colors[arm], REGION_OPACITY))
    return bodies


def sheet(region: ContactRegion, lift: float) -> TriangleMesh:
    """A region as triangles, lifted off its face by a distance [m]."""
    corners = region.face.at(cut_into_triangles(region.shape).reshape(-1, 2))
    corners = corners + lift * region.face.normal
    return TriangleMesh(corners, np.arange(len(corners)).reshape(-1, 3))
