"""Random scenes of robots that are trees, as plain tables in the form of scene files.

Every scene is assembled: joint frames are put where forward kinematics has the links, with their
free displacements drawn too, and the velocities of the start satisfy all equations.  Scenes whose
equations are close to losing rank are drawn again; rows that are exactly redundant are welcome.
Files of random robots are written to a folder.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from joint_equations import FINGERTIPS, joint_axis, reach, turned_to
from scipy.spatial.transform import Rotation
from tree_models import (
    DIFFERENTIAL,
    MOVES,
    OBJECT,
    WORLD,
    BodyFrame,
    Connection,
    TreeScene,
    TreeState,
    body_frame,
    connection_ends,
    constant_torques,
    object_tables,
    pose_of,
    read_tree_scene,
    robot_tables,
    start_of,
)
from tree_oracle import Motions, collect, least_change

ROWS = {
    "weld": 6, "ball": 3, "revolute": 5, "prismatic": 5, "cylindrical": 4, "universal": 4,
    "planar": 3, "point_on_plane": 1, "point_on_cylinder": 1, "point_on_sphere": 1,
}  # fmt: skip
# Singular values of the equations that count are this part of the largest, or more.
WELL_CONDITIONED = 3e-3
EXACTLY_REDUNDANT = 1e-9
ATTEMPTS = 200
# Robots with several tips: our cart, the others of example-robot-data.
REAL_ROBOTS: dict[str, dict[str, str]] = {
    "baxter": {"left": "left_gripper", "right": "right_gripper"},
    "tiago_dual": {"left": "arm_left_7_link", "right": "arm_right_7_link"},
    "tiago_pro": {"left": "arm_left_7_link", "right": "arm_right_7_link"},
    "talos": {"left": "gripper_left_base_link", "right": "gripper_right_base_link"},
    "pr2": {"left": "l_gripper_tool_frame", "right": "r_gripper_tool_frame"},
    "g1_29dof_rev_1_0": {"left": "left_rubber_hand", "right": "right_rubber_hand"},
    "allegro_left_hand": {
        "index": "link_3.0_tip", "middle": "link_7.0_tip", "ring": "link_11.0_tip",
        "thumb": "link_15.0_tip",
    },
    "dual_arm_cart": {"left": "left_tool", "right": "right_tool"},
    "panda": {"left": "panda_leftfinger", "right": "panda_rightfinger"},
    "anymal_b_simple": {"lf": "LF_FOOT", "rf": "RF_FOOT", "lh": "LH_FOOT", "rh": "RH_FOOT"},
}  # fmt: skip


class RandomTrees(NamedTuple):
    """A scene, its Pinocchio models, its start and the torques of its drives."""

    scene: dict[str, Any]
    trees: TreeScene
    state: TreeState
    torques: dict[str, np.ndarray]


# --- robots --------------------------------------------------------------------------------------


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    quaternion = rng.standard_normal(4)
    return Rotation.from_quat(quaternion / np.linalg.norm(quaternion)).as_matrix()


def random_pose(rng: np.random.Generator, size: float) -> pin.SE3:
    return pin.SE3(random_rotation(rng), rng.uniform(-size, size, 3))


def random_moments(rng: np.random.Generator, mass: float, size: float) -> np.ndarray:
    """Inertia (3, 3) of eight particles in a cube, about their centre [kg m^2]."""
    places = rng.uniform(-size, size, (8, 3))
    places -= places.mean(axis=0)
    squares = mass / 8.0 * places.T @ places
    return np.trace(squares) * np.eye(3) - squares


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def _link_text(rng: np.random.Generator, name: str) -> str:
    mass = float(10.0 ** rng.uniform(-0.5, 0.6))
    moments = random_moments(rng, mass, 0.1)
    i, k = np.triu_indices(3)
    entries = " ".join(
        f"i{axes}='{float(value)!r}'"
        for axes, value in zip(("xx", "xy", "xz", "yy", "yz", "zz"), moments[i, k], strict=True)
    )
    return (
        f"<link name='{name}'><inertial><origin xyz='{_numbers(rng.uniform(-0.1, 0.1, 3))}'/>"
        f"<mass value='{mass!r}'/><inertia {entries}/></inertial></link>\n"
    )


def _joint_text(rng: np.random.Generator, k: int, parent: int, mimic: str) -> str:
    kind = rng.choice(["revolute", "continuous", "prismatic"], p=[0.55, 0.2, 0.25])
    axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.5 else rng.standard_normal(3)
    rpy = Rotation.from_matrix(random_rotation(rng)).as_euler("xyz")
    xyz = rng.uniform(0.1, 0.3) * random_rotation(rng)[0]
    return _placed_joint(k, parent, str(kind), axis, (xyz, rpy), mimic)


def _placed_joint(
    k: int, parent: int, kind: str, axis: Any, origin: tuple[Any, Any], mimic: str = ""
) -> str:
    xyz, rpy = origin
    return (
        f"<joint name='joint_{k}' type='{kind}'><parent link='link_{parent}'/>"
        f"<child link='link_{k}'/><origin xyz='{_numbers(xyz)}' rpy='{_numbers(rpy)}'/>"
        f"<axis xyz='{_numbers(axis / np.linalg.norm(axis))}'/>{mimic}"
        "<limit lower='-9' upper='9' effort='1e6' velocity='100'/></joint>\n"
    )


def random_tree(
    rng: np.random.Generator, path: Path, joints: int, *, branches: bool = True, mimic: bool = False
) -> None:
    """Write a URDF of ``link_0`` to ``link_n``; a mimic joint copies one before it."""
    text = _link_text(rng, "link_0")
    follower = int(rng.integers(2, joints + 1)) if mimic and joints > 1 else 0
    for k in range(1, joints + 1):
        forks = branches and k > 1 and rng.random() < 0.4
        parent = int(rng.integers(0, k)) if forks else k - 1
        copied = ""
        if k == follower:
            multiplier, offset = rng.uniform(-1.5, 1.5), rng.uniform(-0.5, 0.5)
            leader = int(rng.integers(1, k))
            copied = (
                f"<mimic joint='joint_{leader}' multiplier='{float(multiplier)!r}' "
                f"offset='{float(offset)!r}'/>"
            )
        text += _link_text(rng, f"link_{k}") + _joint_text(rng, k, parent, copied)
    path.write_text(f"<robot name='{path.stem}'>\n{text}</robot>\n")


def random_hand(rng: np.random.Generator, path: Path, fingers: list[int], copies: bool) -> None:
    """Write a URDF of a palm ``link_0`` with chains of so many joints.

    With ``copies`` the first joint of the last finger copies one of a finger before it.
    """
    text, k = _link_text(rng, "link_0"), 0
    for finger, joints in enumerate(fingers):
        for j in range(joints):
            k += 1
            mimic = ""
            if copies and finger == len(fingers) - 1 and j == 0:
                mimic = f"<mimic joint='joint_{rng.integers(1, k)}' multiplier='0.8' offset='0.1'/>"
            text += _link_text(rng, f"link_{k}")
            text += _joint_text(rng, k, k - 1 if j else 0, mimic)
    path.write_text(f"<robot name='{path.stem}'>\n{text}</robot>\n")


def planar_chain(rng: np.random.Generator, path: Path, joints: int) -> None:
    """Write a URDF of ``link_0`` to ``link_n`` that move in planes across z."""
    text = _link_text(rng, "link_0")
    for k in range(1, joints + 1):
        angle, slides = rng.uniform(-np.pi, np.pi), rng.random() < 0.25
        kind, axis = ("prismatic", [np.cos(angle), np.sin(angle), 0.0]) if slides else (
            "revolute", [0.0, 0.0, 1.0],
        )  # fmt: skip
        origin = rng.uniform(-0.3, 0.3, 3), [0.0, 0.0, rng.uniform(-np.pi, np.pi)]
        text += _link_text(rng, f"link_{k}") + _placed_joint(k, k - 1, kind, axis, origin)
    path.write_text(f"<robot name='{path.stem}'>\n{text}</robot>\n")


def _leaves(path: Path) -> list[str]:
    """Links of a random tree that no joint leaves, then the others that joints move."""
    model = pin.buildModelFromUrdf(str(path))
    parents = {model.parents[i] for i in range(1, model.njoints)}
    numbers = range(1, model.njoints)
    ends = [frame for i in numbers if i not in parents for frame in _links_on(model, i)]
    return ends + [frame for i in numbers if i in parents for frame in _links_on(model, i)]


def _links_on(model: pin.Model, joint: int) -> list[str]:
    body = pin.FrameType.BODY
    return [f.name for f in model.frames if f.type == body and f.parentJoint == joint]


def tree_robot(
    rng: np.random.Generator, path: Path, tips: int, *, moves: bool = False, mimic: bool = False
) -> dict[str, Any]:
    """The table of a random robot with so many tips; fewer where it has not so many links."""
    random_tree(rng, path, int(rng.integers(max(3, 2 * tips), 5 + 2 * tips)), mimic=mimic)
    links = _leaves(path)[:tips]
    spec = {
        "urdf": str(path),
        "base": pose_of(random_pose(rng, 0.5)),
        "tips": {f"tip_{k}": link for k, link in enumerate(links)},
    }
    return _with_moves(rng, spec) if moves else spec


def _with_moves(rng: np.random.Generator, spec: dict[str, Any]) -> dict[str, Any]:
    """The robot on a base that moves along and about random axes of its own."""
    chosen = [move for move in MOVES if rng.random() < 0.6] or ["yaw"]
    mass = float(rng.uniform(1.0, 30.0))
    moments = random_moments(rng, mass, 0.3)
    base = {**spec["base"], "moves": chosen, "mass": mass, "inertia": moments.tolist()}
    return {**spec, "base": base}


def _floating(rng: np.random.Generator, spec: dict[str, Any]) -> dict[str, Any]:
    """The robot on a base that floats."""
    mass = float(rng.uniform(1.0, 30.0))
    moments = random_moments(rng, mass, 0.3)
    base = {**spec["base"], "moves": "free", "mass": mass, "inertia": moments.tolist()}
    return {**spec, "base": base}


def _on_wheels(rng: np.random.Generator, spec: dict[str, Any]) -> dict[str, Any]:
    """The robot on a base that does not slip sideways."""
    mass = float(rng.uniform(1.0, 30.0))
    moments = random_moments(rng, mass, 0.3)
    base = {"moves": DIFFERENTIAL, "mass": mass, "inertia": moments.tolist()}
    return {**spec, "base": {**spec["base"], **base}}


def _on_some_base(rng: np.random.Generator, spec: dict[str, Any]) -> dict[str, Any]:
    """The robot on a base that is fixed, moves, floats or stands on wheels."""
    on_base = [lambda _, spec: spec, _with_moves, _floating, _on_wheels][rng.integers(4)]
    return on_base(rng, spec)


def _arm(rng: np.random.Generator, path: Path) -> dict[str, Any]:
    """The table of an arm of three to seven joints as scenes have it without robots."""
    count = int(rng.integers(3, 8))
    random_tree(rng, path, count, branches=False)
    return {"urdf": str(path), "tip": f"link_{count}", "base": pose_of(random_pose(rng, 0.5))}


def real_robot(rng: np.random.Generator, name: str, *, moves: bool = False) -> dict[str, Any]:
    """The table of one of ``REAL_ROBOTS``."""
    spec = {"robot": name, "base": pose_of(random_pose(rng, 0.5)), "tips": dict(REAL_ROBOTS[name])}
    return _with_moves(rng, spec) if moves else spec


# --- joints --------------------------------------------------------------------------------------


def random_kind(rng: np.random.Generator, most_rows: int = 6) -> dict[str, Any]:
    """A kind of joint with its parameters."""
    kind = str(rng.choice([kind for kind, rows in ROWS.items() if rows <= most_rows]))
    joint: dict[str, Any] = {"kind": kind}
    if kind in ("revolute", "prismatic", "cylindrical", "point_on_cylinder"):
        joint["axis"] = rng.standard_normal(3).tolist()
    if kind in ("planar", "point_on_plane"):
        joint["normal"] = rng.standard_normal(3).tolist()
    if kind in FINGERTIPS:
        joint["tip_radius"] = float(rng.uniform(0.0, 0.02))
    if kind in ("point_on_cylinder", "point_on_sphere"):
        joint["radius"] = float(rng.uniform(0.1, 0.3))
        joint["inside"] = bool(rng.random() < 0.3)
    return joint


def free_displacement(rng: np.random.Generator, joint: dict[str, Any]) -> pin.SE3:
    """Pose of the joint frame on FIRST in that on SECOND: any that the kind leaves free."""
    kind, turn, shift = joint["kind"], np.eye(3), np.zeros(3)
    about_z = Rotation.from_euler("z", rng.uniform(-1.0, 1.0)).as_matrix()
    if kind in ("ball", *FINGERTIPS):
        turn = random_rotation(rng)
    elif kind in ("revolute", "cylindrical", "planar"):
        turn = about_z
    elif kind == "universal":
        turn = Rotation.from_euler("XY", rng.uniform(-0.8, 0.8, 2)).as_matrix()
    if kind in ("prismatic", "cylindrical", "point_on_cylinder"):
        shift[2] = rng.uniform(-0.2, 0.2)
    if kind in ("planar", "point_on_plane"):
        shift[:2] = rng.uniform(-0.2, 0.2, 2)
    if kind == "point_on_plane":
        shift[2] = joint["tip_radius"]
    if kind == "point_on_cylinder":
        shift[:2] = reach(joint) * about_z[:2, 0]
    if kind == "point_on_sphere":
        shift = reach(joint) * turn[:, 0]
    axes = turned_to(joint_axis(joint)) if kind != "universal" else np.eye(3)
    return pin.SE3(axes @ turn @ axes.T, axes @ shift)


Displaced = Callable[[dict[str, Any]], tuple[pin.SE3, pin.SE3]]


def close_joints(scene: dict[str, Any], state: TreeState, displaced: Displaced) -> None:
    """Put the frames of joints without ``at`` where the bodies are.

    ``displaced`` gives the joint frame on FIRST, and its pose in that on SECOND.
    """
    trees = read_tree_scene(scene)
    motions = Motions(trees, state)

    def pose(end: BodyFrame) -> pin.SE3:
        frame = motions.frame(end)
        return pin.SE3(frame.rotation, frame.origin)

    for joint in (joint for joint in scene["joints"] if "at" not in joint):
        ends = connection_ends(joint, trees.objects)
        first, second = (pose(body_frame(end, trees)) for end in ends)
        on_first, displacement = displaced(joint)
        joint["at_tip" if "arm" in joint else "at_first"] = pose_of(on_first)
        S = first * on_first * displacement.inverse()
        joint["at"] = pose_of(second.inverse() * S)


# --- scenes --------------------------------------------------------------------------------------


def _object(rng: np.random.Generator) -> dict[str, Any]:
    mass = float(10.0 ** rng.uniform(-0.3, 1.3))
    return {
        "mass": mass,
        "inertia": random_moments(rng, mass, 0.4).tolist(),
        "pose": pose_of(random_pose(rng, 0.5)),
    }


def holds(robots: dict[str, dict[str, Any]]) -> list[str]:
    """All tips, as joints name them."""
    return [f"{name}/{tip}" for name, spec in robots.items() for tip in spec["tips"]]


def with_posture(rng: np.random.Generator, scene: dict[str, Any]) -> None:
    """Draw postures that obey mimic joints, but for those written, and lists of torques."""
    trees, torques = read_tree_scene(scene), {}
    for name, robot in trees.robots.items():
        q = rng.uniform(-1.0, 1.0, len(robot.joints))
        of_base = 7 if robot.floats else 0
        lower = np.maximum(robot.model.lowerPositionLimit[of_base:], -10.0)
        upper = np.minimum(
            robot.model.upperPositionLimit[of_base:], 10.0
        )  # none: the largest float
        q = np.where(
            upper > lower, (lower + upper + 0.9 * q * np.minimum(upper - lower, 2.0)) / 2.0, q
        )
        for mimic in robot.mimics:  # leaders stand before their followers
            leader = q[robot.joints.index(mimic.leader)]
            q[robot.joints.index(mimic.joint)] = mimic.multiplier * leader + mimic.offset
        q = np.array(robot_tables(scene)[name].setdefault("posture", q.tolist()))
        torques[name] = rng.uniform(-3.0, 3.0, q.size).tolist()
    if torques:
        scene["control"] = {"kind": "constant", "torques": torques}


def finish(rng: np.random.Generator, scene: dict[str, Any]) -> RandomTrees | None:
    """The scene with postures, closed joints and velocities.

    None where it is ill-conditioned, where a joint is between bodies that cannot move apart, or
    where no acceleration keeps all joints closed at the velocities drawn.
    """
    scene = {"name": "random trees", "gravity": [0.0, 0.0, -9.81], **scene}
    with_posture(rng, scene)
    trees = read_tree_scene(scene)
    if any(_is_rigid(connection) for connection in trees.connections):
        return None
    close_joints(
        scene,
        start_of(scene, trees),
        lambda joint: (random_pose(rng, 0.05), free_displacement(rng, joint)),
    )
    trees = read_tree_scene(scene)
    drawn = start_of(scene, trees)
    motions = Motions(trees, drawn)
    couplings = collect(trees, motions.frame, motions.coordinates.size, motions.coordinates.rates)
    values = np.linalg.svd(couplings.A, compute_uv=False) / np.linalg.norm(couplings.A, 2)
    if np.any((values > EXACTLY_REDUNDANT) & (values < WELL_CONDITIONED)):
        return None
    state = in_motion(rng, scene, trees)
    if not _moves_on(trees, state):
        return None
    return RandomTrees(scene, trees, state, constant_torques(scene, trees))


def in_motion(rng: np.random.Generator, scene: dict[str, Any], trees: TreeScene) -> TreeState:
    """Draw velocities that keep the joints of a scene closed, write them, and give the start."""
    drawn = start_of(scene, trees)
    rates = {name: rng.uniform(-1.0, 1.0, q.size) for name, q in drawn.joint_positions.items()}
    objects, bases = (
        {name: {**frame, "twist": rng.uniform(-1.0, 1.0, 6)} for name, frame in frames.items()}
        for frames in (drawn.objects, drawn.bases)
    )
    state = least_change(trees, TreeState(objects, drawn.joint_positions, rates, bases))
    for name, table in object_tables(scene).items():
        table["twist"] = state.objects[name]["twist"].tolist()
    for name, spec in robot_tables(scene).items():
        spec["velocity"] = state.joint_velocities[name].tolist()
        if name in state.bases:
            spec["base"]["twist"] = state.bases[name]["twist"].tolist()
    return state


def _moves_on(trees: TreeScene, state: TreeState) -> bool:
    """Whether some accelerations keep the joints closed, where equations repeat others."""
    motions = Motions(trees, state)
    couplings = collect(trees, motions.frame, motions.coordinates.size, motions.coordinates.rates)
    a = np.linalg.lstsq(couplings.A, -couplings.gamma, rcond=EXACTLY_REDUNDANT)[0]
    left = np.abs(couplings.A @ a + couplings.gamma)
    return bool(np.max(left, initial=0.0) < 1e-9 * max(1.0, np.max(np.abs(a), initial=0.0)))


def _is_rigid(connection: Connection) -> bool:
    """Whether a link that no joint moves takes part, or both ends are on one body."""
    first, second = connection.first, connection.second
    resting = any(end.body != WORLD and end.joint == 0 for end in (first, second))
    return resting or first[:2] == second[:2]


def arms_only(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Two to four arms as scenes have them without robots: chains of three to seven joints."""
    arms, joints = {}, []
    for k in range(int(rng.integers(2, 5))):
        arms[f"arm_{k}"] = _arm(rng, folder / f"arm_{k}.urdf")
        joints.append({"arm": f"arm_{k}", **random_kind(rng)})
    return {"object": _object(rng), "arms": arms, "joints": joints}


def several_tips(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """One or two robots on fixed bases; each of their one to four tips holds the object."""
    robots = {
        f"robot_{k}": tree_robot(rng, folder / f"robot_{k}.urdf", int(rng.integers(1, 5)))
        for k in range(int(rng.integers(1, 3)))
    }
    joints = [{"arm": tip, **random_kind(rng)} for tip in holds(robots)]
    return {"object": _object(rng), "robots": robots, "joints": joints}


def moving_bases(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Robots whose bases move, beside one that is fixed or an arm."""
    robots = {"cart": tree_robot(rng, folder / "cart.urdf", int(rng.integers(1, 4)), moves=True)}
    scene = several_tips(rng, folder) if rng.random() < 0.5 else arms_only(rng, folder)
    joints = [{"arm": tip, **random_kind(rng)} for tip in holds(robots)]
    return {
        **scene,
        "robots": {**robots, **scene.get("robots", {})},
        "joints": [*scene["joints"], *joints],
    }


def floating_bases(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """One or two robots that float, some with a tip held by the world; one fixed or on wheels."""
    several = _floating(
        rng, tree_robot(rng, folder / "float.urdf", int(rng.integers(2, 4)), mimic=True)
    )
    robots = {"float": several, "helper": tree_robot(rng, folder / "helper.urdf", 1)}
    if rng.random() < 0.5:
        robots["helper"] = _on_wheels(rng, robots["helper"])
    if rng.random() < 0.5:
        robots["second"] = _floating(rng, tree_robot(rng, folder / "second.urdf", 1))
    first, *tips = holds(robots)
    joints = [{"arm": tip, **random_kind(rng)} for tip in tips]
    if rng.random() < 0.6:
        joints.append({"between": [first, WORLD], **random_kind(rng, most_rows=3)})
    return {"object": _object(rng), "robots": robots, "joints": joints}


def wheels(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """One or two robots that do not slip sideways, and one on a fixed base."""
    robots = {
        name: tree_robot(rng, folder / f"{name}.urdf", int(rng.integers(1, 3)))
        for name in ("cart", "truck")[: int(rng.integers(1, 3))]
    }
    robots = {name: _on_wheels(rng, robot) for name, robot in robots.items()}
    robots["helper"] = tree_robot(rng, folder / "helper.urdf", 1)
    joints = [{"arm": tip, **random_kind(rng)} for tip in holds(robots)]
    return {"object": _object(rng), "robots": robots, "joints": joints}


def surroundings(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Tips, and sometimes the object, that are held by the world."""
    robots = {
        "crane": tree_robot(rng, folder / "crane.urdf", 3, moves=bool(rng.random() < 0.5)),
        "porter": tree_robot(rng, folder / "porter.urdf", 1),
    }
    first, *tips = holds(robots)
    joints = [{"arm": tip, **random_kind(rng)} for tip in tips]
    joints.append({"between": [first, WORLD], **random_kind(rng, most_rows=3)})
    if rng.random() < 0.6:
        joints.append({"between": [OBJECT, WORLD], **random_kind(rng, most_rows=3)})
    if rng.random() < 0.5:
        again = {"between": [tips[0], WORLD], "name": "rail"}
        joints.append({**again, **random_kind(rng, most_rows=1)})
    return {"object": _object(rng), "robots": robots, "joints": joints}


def inner_loops(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Joints between two links of one robot, tips or not."""
    path, count = folder / "linkage.urdf", int(rng.integers(6, 11))
    random_tree(rng, path, count)
    links = _leaves(path)
    robot: dict[str, Any] = {
        "urdf": str(path),
        "base": pose_of(random_pose(rng, 0.5)),
        "tips": {"tip": links[0]},
    }
    if rng.random() < 0.4:
        robot = _with_moves(rng, robot)
    joints = [{"arm": "linkage/tip", **random_kind(rng)}]
    for _ in range(int(rng.integers(1, 3))):
        first, second = rng.choice(links, 2, replace=False)
        first = "tip" if first == links[0] else first
        second = "tip" if second == links[0] else second
        between = [f"linkage/{first}", f"linkage/{second}"]
        if all(joint.get("between") != between for joint in joints):
            joints.append({"between": between, **random_kind(rng, most_rows=4)})
    return {"object": _object(rng), "robots": {"linkage": robot}, "joints": joints}


def hands(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Two hands whose fingers share no joint; some are connected with each other or coupled."""
    robots, joints = {}, []
    for k, copies in enumerate((False, bool(rng.random() < 0.5))):
        fingers, path = rng.integers(2, 5, rng.integers(2, 5)).tolist(), folder / f"hand_{k}.urdf"
        random_hand(rng, path, fingers, copies)
        ends = np.cumsum(fingers)
        robots[f"hand_{k}"] = {
            "urdf": str(path),
            "base": pose_of(random_pose(rng, 0.5)),
            "tips": {f"tip_{finger}": f"link_{end}" for finger, end in enumerate(ends)},
        }
    joints = [{"arm": tip, **random_kind(rng, 3)} for tip in holds(robots)]
    if rng.random() < 0.5:
        first, second = rng.choice(list(robots["hand_0"]["tips"]), 2, replace=False)
        pair = [f"hand_0/{first}", f"hand_0/{second}"]
        joints.append({"between": pair, **random_kind(rng, 2)})
    return {"object": _object(rng), "robots": robots, "joints": joints}


def mimic_joints(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Couplings of a file, couplings of the scene, and locked joints."""
    robots = {
        "hand": tree_robot(rng, folder / "hand.urdf", int(rng.integers(2, 5)), mimic=True),
        "helper": tree_robot(rng, folder / "helper.urdf", 2, moves=True),
    }
    names = [f"joint_{k}" for k in range(1, 4)]
    leader, follower = names[0], names[int(rng.integers(1, 3))]
    robots["helper"]["mimic"] = {follower: {"of": leader, "multiplier": -1.2, "offset": 0.1}}
    if rng.random() < 0.5:
        robots["hand"]["lock"] = {"joint_1": 0.3}
    joints = [{"arm": tip, **random_kind(rng)} for tip in holds(robots)]
    return {"object": _object(rng), "robots": robots, "joints": joints}


def real_robots(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """A robot that people use, sometimes on a base that moves, and a random one."""
    name = str(rng.choice(list(REAL_ROBOTS)))
    robots = {
        "real": real_robot(rng, name, moves=bool(rng.random() < 0.5)),
        "helper": tree_robot(rng, folder / "helper.urdf", 1),
    }
    joints = [{"arm": tip, **random_kind(rng)} for tip in holds(robots)]
    return {"object": _object(rng), "robots": robots, "joints": joints}


OBJECTS = ("beam", "plate", "box", "rod")


def joints_of_objects(rng: np.random.Generator, names: list[str]) -> list[dict[str, Any]]:
    """Chains and loops of objects: joints of all kinds among them, some with the world.

    Now and then two objects are welded twice, so that six rows say nothing new.
    """
    joints: list[dict[str, Any]] = []

    def add(first: str, second: str, most_rows: int = 6, **kind: Any) -> None:
        drawn = kind or random_kind(rng, most_rows)
        joints.append({"between": [first, second], "name": f"joint_{len(joints)}", **drawn})

    for k in range(1, len(names)):
        if rng.random() < 0.8:  # else no joint leads to those before it
            pair = [names[int(rng.integers(k))], names[k]]
            rng.shuffle(pair)
            if rng.random() < 0.15:
                add(*pair, kind="weld")
                add(*pair, kind="weld")
            else:
                add(*pair)
    if len(names) > 2 and rng.random() < 0.5:
        add(names[-1], names[0], most_rows=3)
    if rng.random() < 0.4:
        add(str(rng.choice(names)), WORLD, most_rows=5)
    return joints


def several_objects(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Two to four objects with joints among them, and robots of all sorts that hold them.

    The first robot has two tips, which hold two objects.
    """
    names = list(OBJECTS[: int(rng.integers(2, 5))])
    porter = tree_robot(rng, folder / "porter.urdf", 2, mimic=bool(rng.random() < 0.3))
    robots = {"porter": _on_some_base(rng, porter)}
    if rng.random() < 0.4:
        robots["helper"] = tree_robot(rng, folder / "helper.urdf", int(rng.integers(1, 3)))
    held = [str(name) for name in rng.permutation(names)]
    joints = [
        {"arm": tip, "object": held[k % len(held)], **random_kind(rng)}
        for k, tip in enumerate(holds(robots))
    ]
    scene: dict[str, Any] = {"robots": robots}
    if rng.random() < 0.5:
        scene["arms"] = {"arm": _arm(rng, folder / "arm.urdf")}
        joints.append({"arm": "arm", "object": str(rng.choice(names)), **random_kind(rng)})
    joints += joints_of_objects(rng, names)
    return {"objects": {name: _object(rng) for name in names}, **scene, "joints": joints}


def objects_alone(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Two to four objects that no robot holds; a robot may stand aside, held by the world."""
    names = list(OBJECTS[: int(rng.integers(2, 5))])
    scene: dict[str, Any] = {"joints": joints_of_objects(rng, names)}
    if rng.random() < 0.6:
        aside = tree_robot(rng, folder / "aside.urdf", 1)
        scene["robots"] = {"aside": _floating(rng, aside) if rng.random() < 0.5 else aside}
        (tip,) = holds(scene["robots"])
        scene["joints"].append({"between": [tip, WORLD], **random_kind(rng, most_rows=3)})
    return {"objects": {name: _object(rng) for name in names}, **scene}


def hand_shakes(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Two or three robots of all sorts that hold each other, and objects.

    The robots are a pair, joined once or twice, a chain, a ring, or the first and the last of three
    are joined past that between them.  The first may be an arm; joints are at tips or other links.
    An object is held by several of them, by one, or by none.
    """
    names = ["left", "right", "third"][: int(rng.integers(2, 4))]
    scene: dict[str, Any] = {"robots": {}}
    ends: dict[str, list[str]] = {}
    for k, name in enumerate(names):
        path = folder / f"{name}.urdf"
        if k == 0 and rng.random() < 0.3:
            scene["arms"], ends[name] = {name: _arm(rng, path)}, [name]
            continue
        robot = tree_robot(rng, path, 2, mimic=bool(rng.random() < 0.25))
        scene["robots"][name] = _on_some_base(rng, robot)
        ends[name] = holds({name: robot})
        if rng.random() < 0.3:
            ends[name].append(f"{name}/{rng.choice(_leaves(path)[2:])}")
    objects = list(OBJECTS[: int(rng.integers(1, 3))])
    joints = _shakes(rng, names, ends)
    past = len(joints) == 1 and len(names) == 3
    for name in names:
        for tip in ends[name]:
            if rng.random() < 0.4 or (past and name == "right" and tip == ends[name][0]):
                most = int(rng.choice([3, 6]))
                held = str(rng.choice(objects))
                joints.append({"between": [tip, held], **random_kind(rng, most)})
    if rng.random() < 0.25:
        tip = str(rng.choice(ends[names[-1]]))
        joints.append({"between": [tip, WORLD], **random_kind(rng, most_rows=3)})
    if rng.random() < 0.2:
        pair = ends[names[-1]][:2]
        joints.append({"between": pair, "name": "loop", **random_kind(rng, most_rows=2)})
    if len(objects) > 1 and rng.random() < 0.5:
        joints.append({"between": objects, **random_kind(rng)})
    return {"objects": {name: _object(rng) for name in objects}, **scene, "joints": joints}


def _shakes(
    rng: np.random.Generator, names: list[str], ends: dict[str, list[str]]
) -> list[dict[str, Any]]:
    """The joints between robots of :func:`hand_shakes`."""
    if len(names) == 2:
        pairs = [(0, 1)] * int(rng.choice([1, 1, 2]))
    else:
        pairs = [[(0, 1), (1, 2)], [(0, 1), (1, 2), (2, 0)], [(0, 2)]][rng.integers(3)]
    joints = []
    for k, pair in enumerate(pairs):
        between = [str(rng.choice(ends[names[i]])) for i in rng.permutation(pair)]
        closes = len(pairs) == 3 or (len(names) == 2 and k == 1)
        kind = random_kind(rng, most_rows=3 if closes else 6)
        joints.append({"between": between, "name": f"shake_{k}", **kind})
    if len(names) == 2 and rng.random() < 0.1:
        pair = joints[0]["between"]
        joints = [{"between": pair, "name": name, "kind": "weld"} for name in ("shake", "again")]
    return joints


def stretched_arms(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """UR5s whose elbows are stretched out, whose wrists are straight, or both."""
    arms, joints = {}, []
    for k in range(int(rng.integers(2, 4))):
        posture = rng.uniform(-1.5, 1.5, 6)
        straight = [(), (2,), (4,), (2, 4)][rng.integers(4)] if k else (2,)
        posture[list(straight)] = 0.0
        arms[f"arm_{k}"] = {
            "robot": "ur5", "tip": "tool0", "posture": posture.tolist(),
            "base": pose_of(random_pose(rng, 0.5)),
        }  # fmt: skip
        joints.append({"arm": f"arm_{k}", **random_kind(rng)})
    joints[0] = {"arm": "arm_0", "kind": "weld"}
    return {"object": _object(rng), "arms": arms, "joints": joints}


def planar_arms(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Arms that move in one plane, in which welds and balls hold the object several times over.

    Now and then a joint is written twice.
    """
    plane = random_rotation(rng)
    arms, joints = {}, []
    for k in range(int(rng.integers(2, 5))):
        path, count = folder / f"arm_{k}.urdf", int(rng.integers(2, 5))
        planar_chain(rng, path, count)
        base = pose_of(pin.SE3(plane, rng.uniform(-0.5, 0.5, 3)))
        arms[f"arm_{k}"] = {"urdf": str(path), "tip": f"link_{count}", "base": base}
        joints.append({"arm": f"arm_{k}", "kind": str(rng.choice(["weld", "ball"]))})
    if rng.random() < 0.3:
        again = {"between": ["arm_0", OBJECT], "name": "again"}
        joints.append({**again, "kind": joints[0]["kind"]})
    return {"object": _object(rng), "arms": arms, "joints": joints}


FAMILIES: dict[str, Callable[[np.random.Generator, Path], dict[str, Any]]] = {
    family.__name__: family
    for family in (
        arms_only, several_tips, moving_bases, wheels, surroundings, inner_loops, mimic_joints,
        hands, real_robots,
    )
}  # fmt: skip
OF_SEVERAL_OBJECTS = {family.__name__: family for family in (several_objects, objects_alone)}
OF_ROBOTS_JOINED = {"hand_shakes": hand_shakes}
SINGULAR = {family.__name__: family for family in (stretched_arms, planar_arms)}
# With those of robots that float, of whose state the base's motion is a part, of objects, of robots
# that hold each other, and of arms that cannot follow all that their joints ask for.
ALL_FAMILIES = {
    **FAMILIES,
    "floating_bases": floating_bases,
    **OF_SEVERAL_OBJECTS,
    **OF_ROBOTS_JOINED,
    **SINGULAR,
}


def draw_trees(family: str, rng: np.random.Generator, folder: Path) -> RandomTrees:
    """A well-conditioned scene of a family; files of its robots are in ``folder``."""
    for _ in range(ATTEMPTS):
        drawn = finish(rng, ALL_FAMILIES[family](rng, folder))
        if drawn is not None:
            return drawn
    raise RuntimeError(f"{family}: no scene of {ATTEMPTS} is well-conditioned")


def draw_moving_trees(family: str, rng: np.random.Generator, folder: Path) -> RandomTrees:
    """As :func:`draw_trees`, a scene that is no rigid structure: it moves from the start on."""
    while True:
        drawn = draw_trees(family, rng, folder)
        rates = [frame["twist"] for frame in drawn.state.objects.values()]
        rates += drawn.state.joint_velocities.values()
        if np.max(np.abs(np.concatenate(rates))) > 0.1:
            return drawn
