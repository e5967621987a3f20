"""Systems with known mechanics, and plain NumPy statements of what the kernels compute.

Except for ``kernel_rows`` and ``project_velocity``, nothing here calls the package's kernels: gaps
come from poses and surfaces as a textbook draws them, rates from their differences, poses from
Pinocchio's kinematics.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
from repository import WORKED
from scipy.spatial.transform import Rotation

import multiarm as ma
import multiarm.robots.backends
from multiarm.contacts.kernel import (
    CONTACT_WIDTH,
    ROW_LANES,
    ContactRow,
    ContactSearch,
    make_search,
    write_row,
    write_rows_in_closed_form,
)
from multiarm.contacts.matrices import contact_matrices
from multiarm.contacts.motion import BODY_WIDTH, BodyMotion
from multiarm.contacts.surfaces import user_surface_callback
from multiarm.contacts.table import PAIR, Code, ContactTable, pack
from multiarm.dynamics.contact_geometry import place_state
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.variables import Status
from multiarm.geometry.records import (
    CONE,
    CYLINDER,
    PLANE,
    SPHERE,
    SURFACE_ON_OBJECT,
    TORUS,
)
from multiarm.integration.projection import project_velocities
from multiarm.jit.kernels import kernel
from multiarm.jit.pointers import PythonCallback
from multiarm.jit.rows import fields_of
from multiarm.jit.structs import count_entries, struct_of, view
from multiarm.scene import parse_scene

EPS = np.finfo(float).eps
G = [0.0, 0.0, -9.81]

UR5_POSTURE = [-0.264381, -1.509346, 1.788302, 2.862637, -1.306415, 0.0]
UR5_WRIST_SINGULAR = [-0.264381, -1.509346, 1.788302, 2.862637, 0.0, 0.0]
PANDA_POSTURE = [0.0, -0.4015, 0.0, -2.362, 0.0, 2.7459, 0.7854]
PANDA_FINGERS = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}


# --- scenes --------------------------------------------------------------------------------------


def scene_of(arms: dict, joints: list[dict], **more):
    """A scene from plain tables, with a heavy lopsided box where nothing else is said."""
    box = {
        "shape": {"box": [1.2, 0.6, 0.4]},
        "mass": 20.0,
        "inertia": [1.2, 0.1, -0.2, 2.4, 0.15, 2.9],
        "pose": {"xyz": [0, 0, 0.5]},
    }
    return parse_scene({"gravity": G, "object": box, "arms": arms, "joints": joints, **more})


def ur5_pair(left: dict, right: dict, **more):
    """Two UR5s at the ends of a box; ``left`` and ``right`` are their joints."""
    arms = {
        "left": {
            "robot": "ur5",
            "tip": "tool0",
            "posture": UR5_POSTURE,
            "base": {"xyz": [-1.1, 0, 0]},
        },
        "right": {
            "robot": "ur5",
            "tip": "tool0",
            "posture": UR5_POSTURE,
            "base": {"xyz": [1.1, 0, 0], "rpy": [0, 0, math.pi]},
        },
    }
    return scene_of(arms, [{"arm": "left", **left}, {"arm": "right", **right}], **more)


def panda_trio(joint: dict, **more):
    """Three Pandas around a plate, all joined to it by the same kind of joint."""
    arms = {}
    for k, name in enumerate(("east", "north_west", "south_west")):
        angle = 2 * math.pi * k / 3
        arms[name] = {
            "robot": "panda",
            "tip": "panda_hand_tcp",
            "posture": PANDA_POSTURE,
            "lock": PANDA_FINGERS,
            "base": {
                "xyz": [0.95 * math.cos(angle), 0.95 * math.sin(angle), 0],
                "rpy": [0, 0, angle + math.pi],
            },
        }
    return scene_of(arms, [{"arm": name, **joint} for name in arms], **more)


def single_arm(robot: str, tip: str, posture, joint: dict, **more):
    """One arm that holds a small object at its tip."""
    arm = {"robot": robot, "tip": tip, "posture": posture}
    body = {"shape": {"box": [0.2, 0.3, 0.1]}, "mass": 2.0}
    return scene_of({"arm": arm}, [{"arm": "arm", **joint}], object=body, **more)


ARM = {"robot": "ur5", "tip": "tool0", "posture": UR5_POSTURE, "base": {"xyz": [-1.1, 0, 0]}}


def over_floor(gap, ends=None, **friction):
    """An arm holds a heavy box by a ball joint, whose bottom is a gap above the floor."""
    body = {"shape": {"box": [0.6, 0.5, 0.4]}, "mass": 50.0, "pose": {"xyz": [0, 0, 0.5]}}
    effects = {"floor": {"at": {"xyz": [0, 0, 0.3 - gap]}, **friction}}
    if ends is not None:  # damping, so that velocities count at rest
        effects |= {"joint_limits": {"range": ends}, "joint_damping": 2.0}
    joint = {"arm": "arm", "kind": "ball"}
    return ma.compile_system(
        scene_of(
            {"arm": ARM}, [joint], object=body, gravity=[0, 0, -9.81], effects=effects,
        )
    )  # fmt: skip


def planar_pair(robot, posture, joint, solver="dense"):
    """Two planar arms, which move in the plane z = 0, hold a disc."""
    arms = {
        "left": {"robot": robot, "tip": "tip", "base": {"xyz": [-0.8, 0, 0]}, "posture": posture},
        "right": {
            "robot": robot, "tip": "tip", "posture": posture,
            "base": {"xyz": [0.8, 0, 0], "rpy": [0, 0, math.pi]},
        },
    }  # fmt: skip
    body = {"shape": {"cylinder": {"radius": 0.2, "height": 0.05}}, "mass": 3.0}
    joints = [{"arm": name, **joint} for name in arms]
    return scene_of(arms, joints, object=body, gravity=[0.5, -9.81, 0.0], run={"solver": solver})


def two_arm_block(torques: bool = True, **more):
    """The worked example: two arms of six joints hold a block by four and three fingertips."""
    data = WORKED["two_arm_block_system"]["inputs"]
    arms, joints = {}, []
    for i, name in enumerate(("one", "two")):
        base = data["base"][i]
        quaternion = Rotation.from_matrix(base["R"]).as_quat().tolist()
        arms[name] = {
            "robot": "textbook_6r",
            "tip": "tool",
            "base": {"xyz": base["p"], "quaternion_xyzw": quaternion},
            "posture": data["q"][i],
            "velocity": data["qd"][i],
        }
        contacts = [
            {
                "arm": {"sphere": {"center": centre, "radius": data["rho"]}},
                "object": {"plane": {"point": point, "normal": (-np.array(e)).tolist()}},
            }
            for centre, point, e in zip(data["pm"][i], data["po"][i], data["eo"][i], strict=True)
        ]
        joints.append({"arm": name, "kind": "contacts", "contacts": contacts})
    body = {
        "shape": {"box": [1.2, 1.0, 0.8]},
        "mass": data["mo"],
        "inertia": data["Io"],
        "pose": {
            "xyz": data["xo"],
            "quaternion_xyzw": Rotation.from_matrix(data["Ro"]).as_quat().tolist(),
        },
        "twist": data["vo"],
    }
    control = {"kind": "none"}
    if torques:
        control = {"kind": "constant", "torques": dict(zip(arms, data["tau"], strict=True))}
    return scene_of(arms, joints, object=body, control=control, **more)


def two_arm_block_twice():
    """The worked example with the first fingertip of each arm written twice."""
    scene = two_arm_block()
    twice = [
        joint.model_copy(update={"contacts": (*joint.contacts, joint.contacts[0])})
        for joint in scene.joints
    ]
    return scene.replace(joints=[joint.model_dump(exclude_unset=True) for joint in twice])


def random_state(system, rng, turn: float = 0.3, speed: float = 1.0):
    """A state off the constraints: everything moved by up to ``turn``, random velocities."""
    start = system.initial_state()
    shake = lambda value: value + rng.uniform(-turn, turn, value.size)  # noqa: E731
    rotation = Rotation.from_quat(start.object_quaternion_xyzw)
    return system.state(
        object_position=shake(start.object_position),
        object_quaternion_xyzw=(
            Rotation.from_rotvec(rng.uniform(-turn, turn, 3)) * rotation
        ).as_quat(),
        joint_positions={arm: shake(q) for arm, q in start.joint_positions.items()},
        object_twist=speed * rng.standard_normal(6),
        joint_velocities={
            arm: speed * rng.standard_normal(q.size) for arm, q in start.joint_positions.items()
        },
    )


def project_velocity(system, state):
    """The state with velocities on the constraints, as a run projects them (thesis, 4.2).

    The correction is the one that loses the least kinetic energy: an inelastic impact that closes
    all gap rates.
    """
    with system.borrow() as data:
        place_state(data, 0.0, state)
        require_ok(data, update_kinematics(data.struct))
        require_ok(data, project_velocities(data.struct))
        return data.get_state()


def state_at(system, run, k):
    """Sample ``k`` of a run as a state."""
    return system.state(
        run.object_position[k],
        run.object_quaternion_xyzw[k],
        {arm: q[k] for arm, q in run.joint_positions.items()},
        run.object_twist[k],
        {arm: v[k] for arm, v in run.joint_velocities.items()},
    )


def moved_state(system, state, t: float):
    """The state after ``t`` when nothing accelerates: v_o' = 0 (world axes, classical), q'' = 0."""
    turn = Rotation.from_rotvec(t * state.object_twist[3:])
    return system.state(
        object_position=state.object_position + t * state.object_twist[:3],
        object_quaternion_xyzw=(turn * Rotation.from_quat(state.object_quaternion_xyzw)).as_quat(),
        joint_positions={
            arm: q + t * state.joint_velocities[arm] for arm, q in state.joint_positions.items()
        },
        object_twist=state.object_twist,
        joint_velocities=state.joint_velocities,
    )


# --- gaps, as a textbook draws them --------------------------------------------------------------


def pose(rotation, translation) -> np.ndarray:
    """Homogeneous transform (4, 4)."""
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = rotation, translation
    return X


def plain_gap(contact, X_WT: np.ndarray, X_WO: np.ndarray) -> float:
    """Gap of one contact from the poses of tip and object [m], positive = apart.

    For a point or a ball against a plane, sphere, cylinder, cone or torus, and for rows made of
    such contacts; ``oracles`` has everything else.
    """
    if contact.is_combined:
        single = replace(contact, weight=1.0, minus=None)
        taken = plain_gap(contact.minus, X_WT, X_WO) if contact.minus is not None else 0.0
        return contact.weight * (plain_gap(single, X_WT, X_WO) - taken)
    guide, tip = contact.guide, contact.follower
    assert tip.is_tip and not contact.tangent
    X_WP, X_WS = (X_WT, X_WO) if contact.surface_body == SURFACE_ON_OBJECT else (X_WO, X_WT)
    p = (np.linalg.inv(X_WS) @ X_WP @ np.append(tip.origin, 1.0))[:3] - guide.origin
    axis = guide.axes[:, 2]
    along, across = axis @ p, np.linalg.norm(np.cross(axis, p))
    if guide.kind == PLANE:
        clear = along
    elif guide.kind == CYLINDER:
        clear = across - guide.sizes[0]
    elif guide.kind == CONE:
        sine, cosine = guide.sizes[:2]
        clear = cosine * across - sine * along
    elif guide.kind == TORUS:
        clear = math.hypot(across - guide.sizes[0], along) - guide.sizes[1]
    else:
        assert guide.kind == SPHERE
        clear = np.linalg.norm(p) - guide.sizes[0]
    return (-clear if guide.inside else clear) - tip.sizes[0]


def plain_gaps(system, state) -> np.ndarray:
    """Gaps of all contacts of a system, arm after arm."""
    X_WO = pose(Rotation.from_quat(state.object_quaternion_xyzw).as_matrix(), state.object_position)
    return np.array(
        [
            plain_gap(contact, system.arms[arm].tip_pose(state.joint_positions[arm]), X_WO)
            for arm in system.arm_names
            for contact in system.contacts[arm]
        ]
    )


_FIRST = np.array([3, -32, 168, -672, 0, 672, -168, 32, -3]) / 840.0
_SECOND = np.array([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9]) / 5040.0


def difference(function, step: float = 1e-4):
    """Derivative at 0 to order 4."""
    values = {k: function(k * step) for k in (-2, -1, 1, 2)}
    return (8.0 * (values[1] - values[-1]) - values[2] + values[-2]) / (12.0 * step)


def first_difference(function, h: float):
    """Derivative at 0 to order 8."""
    return sum(w * function(k * h) for w, k in zip(_FIRST, range(-4, 5), strict=True) if w) / h


def second_difference(function, h: float):
    """Second derivative at 0 to order 8."""
    return sum(w * function(k * h) for w, k in zip(_SECOND, range(-4, 5), strict=True)) / h**2


# --- the kernel on bodies of one's own -----------------------------------------------------------


def body_row(X: np.ndarray, twist=None) -> np.ndarray:
    """A body's kinematics as the kernel takes it, with zero accelerations."""
    row = np.zeros(BODY_WIDTH)
    motion = fields_of(BodyMotion, row)
    motion.rotation[:], motion.origin[:] = X[:3, :3], X[:3, 3]
    if twist is not None:
        motion.velocity[:], motion.spin[:] = twist[:3], twist[3:]
    return row


_open_table, _open_search = view(ContactTable), view(ContactSearch, count_entries(ContactTable))


@kernel
def write_row_alone(struct, k, arm, body, rows, parts):
    """A row of the table in the struct of this and a search."""
    write_row(k, arm, body, _open_table(struct), rows, parts, _open_search(struct))


@kernel
def write_rows_together(struct, count, arm, body, packs, rows):
    """The first rows of this table that are in closed form, as an evaluation writes them."""
    relative = _open_search(struct).relative
    write_rows_in_closed_form(0, count, arm, body, _open_table(struct), relative, packs, rows)


def kernel_rows(contacts, X_WT, X_WO, twist_T=None, twist_O=None, near=None):
    """What the kernels make of contacts on two moving bodies, one row (column of W) a contact.

    ``near`` (N, 3) are points of the guiding surfaces, in their bodies' frames, near which contacts
    of two surfaces are looked for.
    """
    (table, surfaces), n = pack(contacts), len(contacts)
    arm, body = body_row(X_WT, twist_T), body_row(X_WO, twist_O)
    rows, parts = np.zeros((n, CONTACT_WIDTH)), np.zeros((len(table.codes) - n, CONTACT_WIDTH))
    search = make_search(np.zeros((len(table.shapes), 3)))
    answer = PythonCallback(user_surface_callback(surfaces, search.query), Status())
    search.user.callback = answer.address
    struct = struct_of(table, search)
    codes, columns = fields_of(Code, table.codes), fields_of(ContactRow, rows)
    for k in range(n):
        first = codes.first_part[k]
        for piece in (k, codes.normal_part[k] or k, *range(first, first + codes.parts[k])):
            if codes.kind[piece] == PAIR:
                search.guesses[codes.shape[piece]] = near[k]
        write_row_alone(struct, k, arm, body, rows, parts)
    answer.reraise()
    write_rows_together(struct, n, arm, body, np.zeros(ROW_LANES), rows)
    W = contact_matrices(table, np.vstack([rows, parts]), np.arange(n), arm, body, arm)
    return SimpleNamespace(
        phi=columns.gap, phi_dot=columns.gap_rate, c=-columns.gap_bias, normals=columns.normal,
        W_m=W.W_m, W_o=W.W_o, W_m_dot=W.W_m_dot, W_o_dot=W.W_o_dot,
    )  # fmt: skip


def carried(X: np.ndarray, twist, t: float) -> np.ndarray:
    """Pose after ``t`` at constant velocity of the origin and constant angular velocity (world)."""
    turn = Rotation.from_rotvec(t * np.asarray(twist)[3:]).as_matrix()
    return pose(turn @ X[:3, :3], X[:3, 3] + t * np.asarray(twist)[:3])


def random_pose(rng) -> np.ndarray:
    """A rotation drawn uniformly, an origin within a metre or so."""
    return pose(Rotation.random(random_state=rng).as_matrix(), rng.standard_normal(3))


def body_twist(X: np.ndarray, twist) -> np.ndarray:
    """A twist in world axes expressed in the body's."""
    R = X[:3, :3]
    return np.concatenate([R.T @ twist[:3], R.T @ twist[3:]])


# --- the equations of motion, from differences ---------------------------------------------------


def plain_system(system, state, torque=None):
    """M, h, W, c of the whole system (object first) with W and c from differences of plain gaps.

    Only Pinocchio's inertia and bias of each arm enter besides poses; see :func:`moved_state`.
    """
    names, scene = system.arm_names, system.scene
    gravity = np.array(scene.gravity or (0.0, 0.0, 0.0))
    size = 6 + system.model.layout.rate_count
    M, h = np.zeros((size, size)), np.zeros(size)
    R = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
    omega, inertia = state.object_twist[3:], R @ scene.object.inertia_matrix() @ R.T
    M[:3, :3], M[3:6, 3:6] = scene.object.mass * np.eye(3), inertia
    h[:3], h[3:6] = scene.object.mass * gravity, -np.cross(omega, inertia @ omega)
    at = 6
    for name in names:
        q, v = state.joint_positions[name], state.joint_velocities[name]
        arm = system.arms[name]
        n = slice(at, at + arm.dof)
        M[n, n], h[n] = plain_arm(arm, q, v, gravity)
        if torque is not None:
            h[n] += torque[name]
        at += arm.dof
    W = np.array([first_difference(_gaps_along(system, state, e), 2e-3) for e in np.eye(size)])
    c = -second_difference(lambda t: plain_gaps(system, moved_state(system, state, t)), 3e-3)
    return M, h, W, c


def plain_arm(arm, q, v, gravity):
    """Inertia and minus the bias of one arm, from a fresh Pinocchio model."""

    model = arm.model.copy()
    model.gravity.linear = np.array(gravity, float)
    data, configuration = model.createData(), arm.configuration(q)
    M = np.column_stack(
        [
            pin.rnea(model, data, configuration, np.zeros(model.nv), e)
            - pin.rnea(model, data, configuration, np.zeros(model.nv), np.zeros(model.nv))
            for e in np.eye(model.nv)
        ]
    )
    return M, -pin.rnea(model, data, configuration, np.array(v), np.zeros(model.nv))


def _gaps_along(system, state, direction):
    """Gaps as a function of the displacement along one generalised direction."""
    there = system.state(
        state.object_position, state.object_quaternion_xyzw, state.joint_positions, direction[:6],
        system.model.layout.split_joints(direction[6:]),
    )  # fmt: skip
    return lambda t: plain_gaps(system, moved_state(system, there, t))


def solve_plain(M, h, W, c):
    """Accelerations and least-norm contact forces of the whole system.

    The unknowns are scaled by the inertia so that metres and radians, grams and tonnes weigh alike.
    """
    size, count = W.shape
    d = 1.0 / np.sqrt(np.diag(M))
    A = np.zeros((size + count, size + count))
    A[:size, :size] = d[:, None] * M * d
    A[:size, size:], A[size:, :size] = -d[:, None] * W, (d[:, None] * W).T
    x = np.linalg.lstsq(A, np.concatenate([d * h, c]), rcond=1e-8)[0]
    return d * x[:size], x[size:]


def stacked(evaluation):
    """Object's and joints' accelerations in one vector, and contact forces in one."""
    return (
        np.concatenate([evaluation.object_acceleration, *evaluation.joint_accelerations.values()]),
        np.concatenate(list(evaluation.contact_forces.values())),
    )


def chain_urdf(kinds: str) -> str:
    """A URDF of hinges (x, y, z), unlimited hinges (X, Y, Z) and slides (u, v, w along x, y, z).

    Every second inner link is massless.
    """
    axes = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1", "u": "1 0 0", "v": "0 1 0", "w": "0 0 1"}
    inertial = (
        "<inertial><origin xyz='0.03 -0.02 0.15'/><mass value='2.5'/><inertia ixx='0.02'"
        " ixy='0.001' ixz='0' iyy='0.03' iyz='-0.002' izz='0.01'/></inertial>"
    )
    text = "<link name='base'/>"
    for k, kind in enumerate(kinds, start=1):
        heavy = k == len(kinds) or k % 2 == 1
        slides = "prismatic" if kind in "uvw" else "continuous" if kind.isupper() else "revolute"
        text += (
            f"<link name='link_{k}'>{inertial if heavy else ''}</link>"
            f"<joint name='joint_{k}' type='{slides}'>"
            f"<parent link='{'base' if k == 1 else f'link_{k - 1}'}'/><child link='link_{k}'/>"
            f"<origin xyz='0.05 0.02 0.3' rpy='0.1 0.2 -0.3'/><axis xyz='{axes[kind.lower()]}'/>"
            "<limit lower='-6' upper='6' effort='100' velocity='5'/></joint>"
        )
    text += (
        "<link name='tip'/><joint name='tip_joint' type='fixed'><parent link='link_"
        f"{len(kinds)}'/><child link='tip'/><origin xyz='0.1 0 0.2' rpy='0.3 0 0.5'/></joint>"
    )
    return f"<robot name='chain'>{text}</robot>"


def sledge_urdf(mass: float = 3.0) -> str:
    return f"""<robot name="sledge"><link name="ground"/>
<joint name="rail" type="prismatic"><parent link="ground"/><child link="runner"/>
<axis xyz="1 0 0"/><limit lower="-50" upper="50" effort="7" velocity="100"/>
<dynamics damping="0.8" friction="0.6"/></joint>
<link name="runner"><inertial><mass value="{mass}"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="mount" type="fixed"><parent link="runner"/><child link="tip"/></joint>
<link name="tip"/></robot>"""


def slides() -> str:
    text, parent = "<link name='ground'/>", "ground"
    inertia = "ixx='0.1' ixy='0' ixz='0' iyy='0.1' iyz='0' izz='0.1'"
    for name, axis in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1")):
        text += (
            f"<link name='{name}_cart'><inertial><mass value='1'/><inertia {inertia}/></inertial>"
            f"</link><joint name='{name}' type='prismatic'><parent link='{parent}'/>"
            f"<child link='{name}_cart'/><axis xyz='{axis}'/>"
            "<limit lower='-50' upper='50' effort='100' velocity='100'/></joint>"
        )
        parent = f"{name}_cart"
    return (
        f"<robot name='gantry'>{text}<link name='tip'/><joint name='mount' type='fixed'>"
        "<parent link='z_cart'/><child link='tip'/></joint></robot>"
    )


def object_terms(
    mass: float,
    inertia: np.ndarray,
    rotation: np.ndarray,
    twist: np.ndarray,
    gravity: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    r"""Inertia and bias of the object about its centre of mass (thesis, 3.2).

    .. math:: I_o = \begin{bmatrix} m I & 0\\ 0 & R I_b R^T\end{bmatrix},\qquad
       b_o = \begin{bmatrix} -m g \\ \omega\times R I_b R^T\omega\end{bmatrix},\qquad
       I_o \dot v_o + b_o = f

    Parameters
    ----------
    mass : float
        [kg]
    inertia : ndarray, shape (3, 3)
        About the centre of mass, object axes [kg m^2].
    rotation : ndarray, shape (3, 3)
        Object to world.
    twist : ndarray, shape (6,)
        Velocity of the centre of mass and angular velocity, world axes.
    gravity : ndarray, shape (3,)
        [m/s^2], world axes.

    Returns
    -------
    inertia, bias : ndarray, shapes (6, 6) and (6,)
        With ``v_o'`` classical: there is no ``m omega x v`` term (the printed (3.2) has one).
    """
    world = rotation @ inertia @ rotation.T
    full = np.zeros((6, 6))
    full[:3, :3] = mass * np.eye(3)
    full[3:, 3:] = world
    omega = twist[3:]
    return full, np.concatenate([-mass * gravity, np.cross(omega, world @ omega)])


def arrays_by_name(group: tuple, name: str) -> dict[str, Any]:
    """The arrays and numbers of a ``NamedTuple``, and of the groups in it."""
    arrays: dict[str, Any] = {}
    for field, part in group._asdict().items():
        of_field = f"{name}.{field}"
        arrays |= arrays_by_name(part, of_field) if isinstance(part, tuple) else {of_field: part}
    return arrays


def data_of(system):
    """The Data that the last evaluation or run of a system has used, or a new one."""
    with system.borrow() as data:
        return data


SHORT = {"duration": 0.2, "output_step": 0.02}


def true_error(system, run, **settings):
    """Worst difference [m, rad] to a run by the other method at a tolerance near rounding."""
    name = "dop853" if run.statistics["integrator"] == "dopri5" else "dopri5"
    step = np.diff(run.time).max()
    settings = {"duration": run.time[-1], "output_step": step, **settings}
    exact = ma.simulate(system, integrator=name, tolerance=1e-12, **settings)
    assert exact.status == "completed" and len(exact) == len(run)
    turn = Rotation.from_quat(run.object_quaternion_xyzw).inv()
    turn = turn * Rotation.from_quat(exact.object_quaternion_xyzw)
    shift = np.linalg.norm(run.object_position - exact.object_position, axis=1)
    joints = [
        np.abs(run.joint_positions[arm] - exact.joint_positions[arm]).max() for arm in run.arm_names
    ]
    return max(shift.max(), turn.magnitude().max(), *joints)
