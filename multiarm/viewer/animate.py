"""From a trajectory to an animation: the only place where a replay meets robots and dynamics.

Frames are samples of the trajectory; between two of them the page interpolates.  Link poses come
from each arm's kinematics, contact points and normals from the system's evaluation, contact forces,
states and events from the trajectory, and the axes of joints from their frames: a joint's frame has
the axis as its z axis (:class:`multiarm.contacts.joint.JointFrame`).

Grasps in form closure by pushing contacts on plane faces also show, on each face, the region in
which a contact keeps the grasp closed; the other contacts stay where they are at the start.
"""

from __future__ import annotations

import colorsys
import warnings
from collections import Counter
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from multiarm.assembly.compilation import geometry_of
from multiarm.contacts.joint import axis_travel, limits_of
from multiarm.errors import GraspError, ReplayError
from multiarm.geometry.triangle_mesh import TriangleMesh, merge
from multiarm.grasp.body.face import cut_into_triangles
from multiarm.grasp.scenes.judging import SceneGrasp, read_grasp
from multiarm.results.outcome import RunStatus
from multiarm.scene import without_code
from multiarm.scene.control import NoControl
from multiarm.scene.faults import counted
from multiarm.viewer.animation import (
    Animation,
    Body,
    Dial,
    HingeTracks,
    along,
    moving,
    rotations,
)
from multiarm.viewer.commands import rgb
from multiarm.viewer.contact_tracks import (
    contacts_of,
    event_places,
    object_size,
    placed,
    surface_bodies,
)
from multiarm.viewer.shapes import PLAIN, geometry_mesh, is_mesh_file, object_mesh
from multiarm.viewer.solids import Z_TO_X, box, capsule, cylinder

if TYPE_CHECKING:
    from multiarm.arms.arm import Arm
    from multiarm.contacts.joint import JointFrame
    from multiarm.dynamics.system import System
    from multiarm.grasp.seventh_contact.contact_region import ContactRegion
    from multiarm.results.trajectory import Trajectory
    from multiarm.scene import JointSpec


PALETTE = ("#4a80c9", "#f08a45", "#4fa36a", "#9b6bc2", "#d9596a", "#2fa3a8", "#d3a62f", "#7a8797")
OBJECT_COLOR, OBJECT_OPACITY = np.array([0.94, 0.78, 0.60]), 0.5
WHITE = np.ones(3)  # a tint that leaves colours as they are
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
    colors = arm_colors(system)
    bodies = [_object(trajectory, rows)]
    angles = {name: trajectory.joint_positions[name][rows] for name in system.arm_names}
    shapes = _Shapes(meshes)
    feet = {}  # of each robot: where it stands
    for group in system.scene.arm_groups:
        arms = [system.arms[name] for name in group.arms]
        links, trunk = _robot_bodies(arms, angles, colors, shapes)
        bodies += links + trunk
        feet[group.arms[0]] = foot = arms[0].files.base.copy()
        foot[2, 3] = min([foot[2, 3], *map(lowest, trunk)])
    grasp = None if missing else scene_grasp(system)  # regions depend on all contacts
    if grasp is not None:
        bodies += region_bodies(grasp, trajectory, rows, colors)
    plain = grasp is not None and grasp.body is not None  # its faces are the object's own
    bodies += surface_bodies(system, trajectory, rows, colors, faces=not plain)
    ground = ground_bodies(trajectory, rows, object_size(system))
    bodies += ground
    floor = min([foot[2, 3] for foot in feet.values()] + [lowest(body) for body in ground])
    bodies += columns(feet, floor, len(rows))
    contacts = contacts_of(system, trajectory, rows, colors)
    note = "" if trajectory.status == RunStatus.COMPLETED else trajectory.message
    notes = [f"{trajectory.status}: {note}"] if note else []
    return Animation(
        title=trajectory.scene.name,
        time=trajectory.time[rows],
        bodies=bodies,
        contacts=contacts,
        hinges=hinges_of(system, trajectory, rows, colors),
        floor=float(floor),
        note="; ".join([*notes, *missing]),
        event_places=event_places(trajectory, trajectory.time[rows], contacts),
        events=trajectory.events,
    )


def _system(trajectory: Trajectory) -> tuple[System, list[str]]:
    """What is to be drawn, at the run's first sample, and what is not for lack of its code."""
    # without its control, whose tables need not exist any more
    scene = trajectory.simulated_scene.model_copy(update={"control": NoControl()})
    start = {
        "object_position": trajectory.object_position[0],
        "object_quaternion_xyzw": trajectory.object_quaternion_xyzw[0],
        "joint_positions": {arm: q[0] for arm, q in trajectory.joint_positions.items()},
    }
    scene, left_out = without_code(scene)
    system = geometry_of(scene, start)
    not_drawn = [item for item in left_out if item.arm]
    if not not_drawn:
        return system, []
    arms = ", ".join(dict.fromkeys(f"arm {item.arm!r}" for item in not_drawn))
    missing = (
        f"contacts and surfaces of {arms} that need "
        f"{', '.join(dict.fromkeys(item.what for item in not_drawn))} are not drawn: code that a "
        "result names is not loaded"
    )
    warnings.warn(missing, stacklevel=4)
    return system, [missing]


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


def arm_colors(system: System) -> dict[str, np.ndarray]:
    """Return a colour, sRGB (3,) in 0..1, for each arm: its own, or one of a palette."""
    chosen = {name: spec.color for name, spec in system.scene.arms.items()}
    return {
        name: np.array(color[:3]) if color is not None else _palette_color(i)
        for i, (name, color) in enumerate(chosen.items())
    }


def _palette_color(i: int) -> np.ndarray:
    if i < len(PALETTE):
        return rgb(PALETTE[i])
    return np.array(colorsys.hsv_to_rgb(0.618034 * i % 1.0, 0.55, 0.8))  # hues far apart


def _object(trajectory: Trajectory, rows: np.ndarray) -> Body:
    spec = trajectory.scene.object
    color, opacity = OBJECT_COLOR, OBJECT_OPACITY
    if spec.color is not None:
        color = np.array(spec.color[:3])
        opacity = spec.color[3] if spec.color[3] < 1 else OBJECT_OPACITY
    return Body(
        "object",
        object_mesh(spec),
        trajectory.object_position[rows],
        trajectory.object_quaternion_xyzw[rows],
        color,
        opacity,
    )


def _robot_bodies(
    arms: list[Arm],
    angles: dict[str, np.ndarray],
    colors: dict[str, np.ndarray],
    shapes: _Shapes,
) -> tuple[list[Body], list[Body]]:
    """Return the links of a robot in the colours of its arms, and its trunk.

    The trunk, of several arms only, are the links that no arm moves, in the robot's own colours.
    """
    first = arms[0]
    if len(arms) == 1:
        parts = shapes.parts(first, shapes.visuals(first))
        return _bodies(first, parts, angles[first.name], colors[first.name]), []
    bodies, visuals = [], {arm.name: shapes.visuals(arm) for arm in arms}
    carried = {item.name for arm in arms for item in visuals[arm.name] if item.parentJoint > 0}
    trunk = [item for item in visuals[first.name] if item.name not in carried]
    for arm in arms:
        parts = shapes.parts(arm, [item for item in visuals[arm.name] if item.parentJoint > 0])
        if trunk:  # else the bars from the base to the arms stand for it
            parts = [part for part in parts if part.joint > 0]
        bodies += _bodies(arm, parts, angles[arm.name], colors[arm.name])
    fixed = shapes.seen(first, trunk, subdued=False)
    robot = "+".join(arm.name for arm in arms)
    return bodies, _bodies(first, fixed, angles[first.name], WHITE, robot)


def _bodies(
    arm: Arm, parts: list[_Part], angles: np.ndarray, color: np.ndarray, name: str = ""
) -> list[Body]:
    """Return parts as bodies that move with an arm's joints, below ``arms/name``."""
    poses = np.empty((len(parts), len(angles), 7))
    data = arm.model.createData()
    for k, row in enumerate(angles):
        pin.forwardKinematics(arm.model, data, arm.configuration(row))
        placed = [pin.SE3ToXYZQUAT(data.oMi[p.joint] * p.placement) for p in parts]
        poses[:, k] = np.reshape(placed, (-1, 7))
    names = _distinct([part.name.replace("/", "_") for part in parts])
    return [
        Body(f"arms/{name or arm.name}/{link}", part.mesh, pose[:, :3], pose[:, 3:], color)
        for link, part, pose in zip(names, parts, poses, strict=True)
    ]


@dataclass(frozen=True)
class _Part:
    """A shape fixed to a joint's moving frame (joint 0: the world)."""

    name: str
    joint: int
    placement: pin.SE3
    mesh: TriangleMesh


class _Shapes:
    """The visuals of arms; a mesh file is read once."""

    def __init__(self, meshes: bool) -> None:
        self._meshes = meshes  # False leaves mesh files out
        self._of_files: dict[tuple, TriangleMesh] = {}

    def visuals(self, arm: Arm) -> list[pin.GeometryObject]:
        """Return all visuals of an arm's robot and tool."""
        items = arm.visual_model().geometryObjects
        return [item for item in items if self._meshes or not is_mesh_file(item)]

    def parts(self, arm: Arm, visuals: list[pin.GeometryObject]) -> list[_Part]:
        """Return visuals of an arm as parts; bars replace links without a shape."""
        parts = self.seen(arm, visuals)
        return parts + _bars(arm, set(range(arm.model.njoints)) - {part.joint for part in parts})

    def seen(
        self, arm: Arm, visuals: list[pin.GeometryObject], subdued: bool = True
    ) -> list[_Part]:
        """Return visuals as parts; a warning names those that cannot be shown."""
        parts: list[_Part] = []
        lost: dict[str, None] = {}  # each file once
        for item in visuals:
            try:
                mesh = self._mesh(item, subdued)
            except ValueError as error:
                shape = item.meshPath if is_mesh_file(item) else "a shape"
                lost[f"{shape} of link '{item.name.rpartition('_')[0]}' ({error})"] = None
                continue
            parts.append(_Part(item.name, item.parentJoint, item.placement, mesh))
        if lost:
            warnings.warn(
                f"{arm.files.urdf.name}: the replay leaves out {counted([*lost], 3)}; a joint with "
                "no shape left has a bar",
                stacklevel=2,
            )
        return parts

    def _mesh(self, item: pin.GeometryObject, subdued: bool) -> TriangleMesh:
        if not is_mesh_file(item):
            return geometry_mesh(item, subdued)
        color = (item.overrideMaterial, *item.meshColor)
        key = (item.meshPath, *item.meshScale, *color, subdued)
        if key not in self._of_files:
            self._of_files[key] = geometry_mesh(item, subdued)
        return self._of_files[key]


def _bars(arm: Arm, joints: set[int]) -> list[_Part]:
    """Return bars from each of the `joints` to the next joint or the tip."""
    model = arm.model
    ends: dict[int, list[np.ndarray]] = {joint: [] for joint in range(model.njoints)}
    for child in range(1, model.njoints):
        ends[model.parents[child]].append(model.jointPlacements[child].translation)
    ends[arm.tip.joint].append(arm.tip.translation)
    base = arm.files.base[:3, 3]  # joint 0 is the world, where the arm begins at its base
    starts = {joint: base if joint == 0 else np.zeros(3) for joint in joints}
    reach = sum(np.linalg.norm(e - starts.get(j, base * (j == 0))) for j in ends for e in ends[j])
    parts = []
    for joint, start in starts.items():
        bars = [
            _bar(start, end, 0.03 * reach)
            for end in ends[joint]
            if np.linalg.norm(end - start) > 1e-3 * reach
        ]
        if bars:
            shape = merge(bars).painted(PLAIN)
            parts.append(_Part(f"{model.names[joint]}_bar", joint, pin.SE3.Identity(), shape))
    return parts


def _bar(start: np.ndarray, end: np.ndarray, radius: float) -> TriangleMesh:
    span = end - start
    length = float(np.linalg.norm(span))
    pose = np.eye(4)
    pose[:3, :3] = rotations(along(span[None, None] / length)[0])[0]
    pose[:3, 3] = (start + end) / 2
    return capsule(radius, length).moved(pose)


def _distinct(names: list[str]) -> list[str]:
    """Number the names that occur more than once: a node of the scene tree has one name."""
    counts = Counter(names)
    seen: Counter[str] = Counter()
    result = []
    for name in names:
        seen[name] += 1
        result.append(name if counts[name] == 1 else f"{name}_{seen[name]}")
    return result


# Joints that are drawn as one thing on the object; a cross has two axles.
HINGE_SHAPES = ("axle", "rail", "sleeve", "ball")
CENTRED = 0.05  # an axis that passes the object's centre nearer than this, of its distance


def hinges_of(
    system: System, trajectory: Trajectory, rows: np.ndarray, colors: dict[str, np.ndarray]
) -> list[HingeTracks]:
    """Return the visible joints at some samples (`rows`) of a run."""
    object_poses = np.tile(np.eye(4), (len(rows), 1, 1))
    object_poses[:, :3, :3] = rotations(trajectory.object_quaternion_xyzw[rows])
    object_poses[:, :3, 3] = trajectory.object_position[rows]
    hinges = []
    for joint in system.scene.joints:
        if joint.drawn_as not in (*HINGE_SHAPES, "cross"):
            continue
        arm, frame = system.arms[joint.arm], system.frames[joint.arm]
        angles = trajectory.joint_positions[joint.arm][rows]
        tip_poses = np.array([arm.tip_pose(row) for row in angles])
        hinges += _hinges(joint, frame, object_poses, tip_poses, colors[joint.arm])
    return hinges


def _hinges(
    joint: JointSpec,
    frame: JointFrame,
    object_poses: np.ndarray,
    tip_poses: np.ndarray,
    color: np.ndarray,
) -> list[HingeTracks]:
    on_object, on_tip = object_poses @ frame.on_object, tip_poses @ frame.on_tip  # (K, 4, 4)
    if joint.drawn_as == "cross":  # about the object's x and the arm's y axis
        axles = (on_object @ Z_TO_X, on_tip @ Z_TO_X.T)  # z along x, and along y
        return [
            HingeTracks(joint.arm, f"{joint.arm}/{k}", "axle", color, *placed(axle))
            for k, axle in enumerate(axles, start=1)
        ]
    turn, slide = axis_travel(on_object, on_tip)
    dials = tuple(
        Dial(limit.turns, (limit.low, limit.high), turn if limit.turns else slide)
        for limit in limits_of(joint)
        if limit.along_axis
    )
    place = placed(on_object @ _turned_outwards(frame.on_object))
    return [HingeTracks(joint.arm, joint.arm, joint.drawn_as, color, *place, dials)]


def _turned_outwards(on_object: np.ndarray) -> np.ndarray:
    """Return the turn about z that points x away from the object's centre, where a sector is
    visible best; the identity if the axis passes through the centre.
    """
    x, y, _ = on_object[:3, :3].T @ on_object[:3, 3]
    turn, away = np.eye(4), np.hypot(x, y)
    if away > CENTRED * np.linalg.norm(on_object[:3, 3]):
        turn[:2, :2] = np.array([[x, -y], [y, x]]) / away
    return turn


GROUND_COLOR = np.array([0.62, 0.65, 0.69])
# Thickness of the slab over its shorter side, and its margin over the object's size.
GROUND_THICKNESS, GROUND_MARGIN = 0.02, 3.0
# Radius of a column over its height, at least and at most [m]; lower ones are not drawn.
SLENDER, THINNEST, THICKEST, LOWEST = 0.2, 0.03, 0.1, 0.02


def ground_bodies(trajectory: Trajectory, rows: np.ndarray, size: float) -> list[Body]:
    """Return the floor at some samples (`rows`) as a fixed body; an empty list without a floor.

    ``size`` is about half that of the object [m].  An unbounded floor is drawn below the whole path
    of the object with a margin.
    """
    spec = trajectory.scene.effects.floor
    if spec is None:
        return []
    pose = spec.at.matrix()
    over = (trajectory.object_position - pose[:3, 3]) @ pose[:3, :3]
    middle, sides = np.zeros(3), np.zeros(3)
    if spec.size is None:
        low, high = over.min(axis=0), over.max(axis=0)
        middle[:2] = 0.5 * (low + high)[:2]
        sides[:2] = (high - low)[:2] + 2.0 * GROUND_MARGIN * size
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
        if height < LOWEST or foot[2, 2] < 0.99:
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
