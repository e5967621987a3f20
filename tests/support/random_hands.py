"""Random scenes of fingers on one box, from robots that are written when they are asked for.

Fingers have slides and hinges and hold the box by single contacts, or as a weld does; some of them
cannot move along their contacts, or hardly.  Masses, sizes and places are drawn over many decades.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mechanics import data_of
from random_systems import Box, System, decades, draw_tilt, turned, unit
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.dynamics.contact_geometry import block_inertias
from multiarm.dynamics.solver.dense import SystemSolution

FAR = 1000.0  # [m]


def draw_hand(seed: int, folder: Path) -> ma.Scene:
    """A scene; the robots of its fingers are written into ``folder``."""
    rng = np.random.default_rng(seed)
    box = Box(decades(rng, -2, 1) * rng.uniform(0.4, 1.0, 3), decades(rng, -4, 4), turned(rng))
    place = rng.choice([0.0, 1.0, FAR]) * unit(rng)
    tilt, closed = draw_tilt(rng), rng.random() < 0.5
    axes = [2, 2, 2, 1, 1, 0, 0] if closed else rng.integers(0, 3, rng.integers(1, 6))
    arms, joints, torques = {}, [], {}
    for i, axis in enumerate(axes):
        name = f"finger_{i}"
        point, normal = box.contact(rng, axis)
        frame = np.column_stack([*_along(rng, normal), normal])
        fixed = closed or rng.random() < 0.4
        links = _links(rng, box, fixed, tilt)
        urdf = folder / f"{name}_{seed}.urdf"
        urdf.write_text(_urdf(links))
        tip = np.sum([offset for _, offset, _, _ in links], axis=0)
        arms[name] = {
            "urdf": str(urdf),
            "tip": "tip",
            "base": _pose(place + point - frame @ tip, frame),
        }
        held = _pose(box.turn.T @ point, box.turn.T @ frame)
        welded = not fixed and rng.random() < 0.3
        joints.append(_joint(name, held, welded, 0.2 * box.lever))
        torque = rng.choice([0.0, 1.0]) * decades(rng, -2, 2)
        torques[name] = (torque * rng.standard_normal(len(links))).tolist()
    return ma.Scene(
        name=f"hand {seed}",
        gravity=[0.0, 0.0, -9.81],
        object={
            "shape": {"box": box.size.tolist()}, "mass": box.mass, "pose": _pose(place, box.turn),
        },
        arms=arms,
        joints=joints,
        control={"kind": "constant", "torques": torques},
    )  # fmt: skip


def _along(rng, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x = np.cross(normal, unit(rng))
    x /= np.linalg.norm(x)
    return x, np.cross(normal, x)


def _pose(place: np.ndarray, turn: np.ndarray) -> dict:
    quaternion = Rotation.from_matrix(turn).as_quat()
    return {"xyz": place.tolist(), "quaternion_xyzw": quaternion.tolist()}


def _links(
    rng, box: Box, fixed: bool, tilt: float
) -> list[tuple[str, np.ndarray, np.ndarray, float]]:
    """Kind, place after the link before, axis [frame of the contact, z along it], and mass.

    Fixed fingers slide along the face, or turn about axes through the contact's line; the last one
    may go through the contact itself.  A tilt makes them miss that a little.
    """
    mass, links = decades(rng, -3, 3), []
    for _ in range(rng.choice([1, 1, 2]) if fixed else rng.integers(1, 8)):
        kind = rng.choice(["prismatic", "revolute"])
        offset, axis = box.lever * rng.uniform(0.2, 1.0) * unit(rng), unit(rng)
        if fixed:
            offset[:2] = 0.0
            axis[2] = 0.0 if kind == "prismatic" else axis[2]
            axis = axis / np.linalg.norm(axis)
            axis = axis + [0.0, 0.0, tilt] if kind == "prismatic" else axis
        links.append((str(kind), offset, axis, mass))
        mass *= decades(rng, -1, 0)
    if fixed and rng.random() < 0.5:
        kind, _, axis, mass = links[-1]
        links[-1] = (kind, np.array([tilt * box.lever, 0.0, 0.0]), axis, mass)
    return links


def _urdf(links: list) -> str:
    """Serial chain: each link is a ball of its mass, whose joint is where the link begins."""
    text, ends = "<link name='link_0'/>", np.zeros(3)
    for k, (kind, offset, axis, mass) in enumerate(links, start=1):
        size = max(float(np.linalg.norm(offset)), 1e-3)
        moment = 0.1 * mass * size**2
        text += (
            f"<link name='link_{k}'><inertial><origin xyz='{_numbers(0.5 * offset)}'/>"
            f"<mass value='{mass!r}'/><inertia ixx='{moment!r}' iyy='{moment!r}' izz='{moment!r}'"
            " ixy='0' ixz='0' iyz='0'/></inertial></link>"
            f"<joint name='joint_{k}' type='{kind}'><parent link='link_{k - 1}'/>"
            f"<child link='link_{k}'/><origin xyz='{_numbers(ends)}'/>"
            f"<axis xyz='{_numbers(axis)}'/>"
            "<limit lower='-9' upper='9' effort='1e6' velocity='100'/></joint>"
        )
        ends = offset
    return (
        f"<robot name='finger'>{text}<link name='tip'/><joint name='end' type='fixed'><parent "
        f"link='link_{len(links)}'/><child link='tip'/><origin xyz='{_numbers(ends)}'/></joint>"
        "</robot>"
    )


def _numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


def _joint(arm: str, held: dict, welded: bool, size: float) -> dict:
    """A weld, or one contact of the tip's origin with a face, in the frame ``held``."""
    if welded:
        return {"arm": arm, "kind": "weld", "at": held, "size": size}
    face = {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}
    contact = {"arm": {"point": [0, 0, 0]}, "object": face}
    return {"arm": arm, "kind": "contacts", "at": held, "contacts": [contact]}


def evaluated(scene: ma.Scene, solver: str, arms: str) -> tuple[System, SystemSolution]:
    """The constrained system of a scene at its start as it is solved, and its solution."""
    run = scene.run.model_copy(update={"solver": solver, "arms": arms})
    compiled = ma.compile_system(scene.replace(run=run))
    found = ma.evaluate(compiled)
    data, names = data_of(compiled), compiled.arm_names
    b, work = data.arrays, data.work
    dofs, rows = np.diff(work.first_joint), work.first_contact
    size = float(np.max(np.linalg.norm(b.rows.W_o[:, 3:], axis=1)))
    W_o = [b.rows.W_o[rows[i] : rows[i + 1]].T.copy() for i in range(len(names))]
    W = [work.W[i, :d, : rows[i + 1] - rows[i]].copy() for i, d in enumerate(dofs)]
    system = System(
        M_o=b.bodies.object_inertia.copy(), f_o=b.forces.f_o.copy(),
        M=block_inertias(data),
        f_j=np.split(b.forces.f_j.copy(), work.first_joint[1:-1]),
        c=np.split(b.rows.c.copy(), rows[1:-1]),
        W_o=W_o, W=W, reaction_o=W_o, reaction=W, lever=size,
        reach=[compiled.arms[n].levers(compiled.frames[n].on_tip[:3, 3]) for n in names],
    )  # fmt: skip
    return system, SystemSolution(
        found.object_acceleration, list(found.joint_accelerations.values()),
        list(found.contact_forces.values()), list(found.contact_forces_unique.values()), found.rank,
    )  # fmt: skip
