"""Make a film of a trajectory: the only place where a replay meets robots and dynamics.

Frames are samples of the trajectory, never interpolations between them, so that what is shown was
computed. Link poses come from each arm's kinematics, contact points and normals from the system's
own evaluation, contact forces and states from the trajectory (`touching`), joints from their
frames (`joints`), and what happened from the trajectory's events (`happenings`).
"""

from __future__ import annotations

import colorsys
import warnings
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from multiarm.assembly.compilation import compile_for_inspection, compile_system
from multiarm.errors import ReplayError
from multiarm.viewer.commands import rgb
from multiarm.viewer.film import Body, Film, along, rotations
from multiarm.viewer.ground import columns, ground_bodies, lowest
from multiarm.viewer.happenings import moments_of
from multiarm.viewer.joints import hinges_of
from multiarm.viewer.mesh import Mesh, capsule, merge
from multiarm.viewer.regions import region_bodies, scene_grasp
from multiarm.viewer.shapes import PLAIN, geometry_mesh, object_mesh
from multiarm.viewer.surfaces import object_size, surface_bodies
from multiarm.viewer.touching import contacts_of

if TYPE_CHECKING:
    from multiarm.arms.arm import Arm
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory

PALETTE = ("#4a80c9", "#f08a45", "#4fa36a", "#9b6bc2", "#d9596a", "#2fa3a8", "#d3a62f", "#7a8797")
OBJECT_COLOR, OBJECT_OPACITY = np.array([0.94, 0.78, 0.60]), 0.5
MOST_FRAMES = 6000


def film_of(
    trajectory: Trajectory, *, fps: float, speed: float, meshes: bool, code: bool = False
) -> Film:
    """Return the film of a trajectory, up to wherever it got.

    Parameters
    ----------
    trajectory : Trajectory
    fps : float
        Frames per second of the viewer; not more than the samples there are.
    speed : float
        Seconds of the trajectory per second of the viewer.
    meshes : bool
        False shows simple bars in place of mesh files: a small page.
    code : bool
        Whether the code that a stored scene names may be loaded.

    Raises
    ------
    ReplayError
        The trajectory has no samples.
    """
    rows = frame_rows(trajectory.time, fps / speed)
    system, missing = _system(trajectory, code)
    colors = arm_colors(system)
    bodies = [_object(trajectory, rows)]
    cache: dict[tuple, Mesh] = {}
    for name in system.arm_names:
        arm, angles = system.arms[name], trajectory.joint_positions[name][rows]
        bodies += _links(arm, angles, colors[name], meshes, cache)
    grasp = None if missing else scene_grasp(system)  # regions depend on all contacts
    if grasp is not None:
        bodies += region_bodies(grasp, trajectory, rows, colors)
    plain = grasp is not None and grasp.body is not None  # its faces are the object's own
    bodies += surface_bodies(system, trajectory, rows, colors, faces=not plain)
    ground = ground_bodies(trajectory, rows, object_size(system))
    bodies += ground
    bases = {name: spec.base.matrix() for name, spec in trajectory.scene.arms.items()}
    floor = min([base[2, 3] for base in bases.values()] + [lowest(body) for body in ground])
    bodies += columns(bases, floor, len(rows))
    contacts = contacts_of(system, trajectory, rows, colors)
    note = "" if trajectory.status == "completed" else trajectory.message
    notes = [f"{trajectory.status}: {note}"] if note else []
    return Film(
        title=trajectory.scene.name,
        time=trajectory.time[rows],
        bodies=bodies,
        contacts=contacts,
        hinges=hinges_of(system, trajectory, rows, colors),
        floor=float(floor),
        note="; ".join([*notes, *missing]),
        moments=moments_of(trajectory, trajectory.time[rows], contacts),
        events=trajectory.events,
    )


def _system(trajectory: Trajectory, code: bool) -> tuple[System, list[str]]:
    """The system to be drawn, and which of its contacts cannot be drawn without code."""
    scene = trajectory.simulated_scene
    if code:
        return compile_system(scene, code=True), []
    system, left = compile_for_inspection(scene)
    unseen = [one for one in left if one.arm]
    if not unseen:
        return system, []
    missing = (
        f"contacts and surfaces of {', '.join(dict.fromkeys(f'arm {one.arm!r}' for one in unseen))}"
        f" that need {', '.join(dict.fromkeys(one.what for one in unseen))} are not drawn, since "
        "code that a result names is not loaded; if you trust its author, allow it with --code "
        "(`code=True` in Python)"
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
    after = np.clip(np.searchsorted(time, wanted), 1, max(1, len(time) - 1))
    after = np.minimum(after, len(time) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(wanted - time[before] < time[after] - wanted, before, after)
    rows = np.unique(nearest)
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


def _links(
    arm: Arm, angles: np.ndarray, color: np.ndarray, meshes: bool, cache: dict[tuple, Mesh]
) -> list[Body]:
    """Return the links of an arm; those without a shape of their own get a stand-in."""
    visuals = [item for item in arm.visual_model().geometryObjects if meshes or not item.meshPath]
    parts = [
        _Part(item.name, item.parentJoint, item.placement, _shared_mesh(item, cache))
        for item in visuals
    ]
    parts += _stand_ins(arm, set(range(arm.model.njoints)) - {part.joint for part in parts})
    poses = np.empty((len(parts), len(angles), 7))
    data = arm.model.createData()
    for k, row in enumerate(angles):
        pin.forwardKinematics(arm.model, data, arm.configuration(row))
        placed = [pin.SE3ToXYZQUAT(data.oMi[p.joint] * p.placement) for p in parts]
        poses[:, k] = np.reshape(placed, (-1, 7))
    names = _distinct([part.name.replace("/", "_") for part in parts])
    return [
        Body(f"arms/{arm.name}/{name}", part.mesh, pose[:, :3], pose[:, 3:], color)
        for name, part, pose in zip(names, parts, poses, strict=True)
    ]


@dataclass(frozen=True)
class _Part:
    """A shape fixed to a joint's moving frame (joint 0: the world)."""

    name: str
    joint: int
    placement: pin.SE3
    mesh: Mesh


def _shared_mesh(item: pin.GeometryObject, cache: dict[tuple, Mesh]) -> Mesh:
    """Return the visual's mesh; the same file for two arms is read once."""
    if not item.meshPath:
        return geometry_mesh(item)
    key = (item.meshPath, *item.meshScale, item.overrideMaterial, *item.meshColor)
    if key not in cache:
        cache[key] = geometry_mesh(item)
    return cache[key]


def _stand_ins(arm: Arm, joints: set[int]) -> list[_Part]:
    """Return bars from each of the `joints` to what it carries: the next joint or the tip."""
    model = arm.model
    ends: dict[int, list[np.ndarray]] = {joint: [] for joint in range(model.njoints)}
    for child in range(1, model.njoints):
        ends[model.parents[child]].append(model.jointPlacements[child].translation)
    ends[arm.tip_joint].append(arm.tip_translation)
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
            parts.append(
                _Part(
                    f"{model.names[joint]}_bar",
                    joint,
                    pin.SE3.Identity(),
                    merge(bars).painted(PLAIN),
                )
            )
    return parts


def _bar(start: np.ndarray, end: np.ndarray, radius: float) -> Mesh:
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
