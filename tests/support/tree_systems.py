"""Systems of one robot that is a random tree with several connections, without a scene file."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from mechanics import scene_of
from random_structures import random_tree
from scipy.spatial.transform import Rotation

from multiarm.arms.arm import Arm, ArmFiles
from multiarm.assembly import joints as assembled_joints
from multiarm.assembly.model import uncontrolled_model
from multiarm.assembly.robots import Robots, arm_backends
from multiarm.assembly.start import written_start
from multiarm.contacts.joint import Joint, JointFrame
from multiarm.dynamics.connections import LINK, THE_OBJECT, THE_WORLD, Body, Connection
from multiarm.dynamics.data import Data
from multiarm.dynamics.system import StartReport, System

ROBOT = "tree"


def body_of(name: str) -> Body:
    """``object``, ``world``, or the link of a tip."""
    return {"object": THE_OBJECT, "world": THE_WORLD}.get(name) or Body(LINK, ROBOT, name)


def tree_system(monkeypatch, folder: Path, rng, parents, connections) -> System:
    """A tree on a base somewhere.

    ``connections`` are kinds of joints by first and second body: ``object``, ``world``, or a link
    ``l1``, ``l2``, ... of :func:`random_structures.random_tree` (``l0``: the root).
    """
    (folder / "tree.urdf").write_text(random_tree(rng, parents))
    tips = {name for pair in connections for name in pair} - {"object", "world"}
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-1, 1, 3)
    files = ArmFiles(folder / "tree.urdf", (), base, {tip: tip for tip in sorted(tips)}, {})
    arm = Arm(ROBOT, files)
    placeholder = {"robot": "ur5", "tip": "tool0", "posture": [0.0] * 6}
    kinds = [{"arm": f"a{k}", **joint} for k, joint in enumerate(connections.values())]
    scene = scene_of({joint["arm"]: placeholder for joint in kinds}, kinds, gravity=[1, 2, -9])
    pairs, joints = {}, {}
    for (first, second), spec in zip(connections, scene.joints, strict=True):
        name = f"{first}-{second}"
        pairs[name] = Connection(name, body_of(first), body_of(second))
        at = np.eye(4)
        at[:3, :3], at[:3, 3] = (
            Rotation.random(random_state=rng).as_matrix(),
            rng.uniform(-0.3, 0.3, 3),
        )
        joints[name] = Joint(spec.placed(at), JointFrame(*spec.frames(at), ()), {})
    resolved = SimpleNamespace(joints=(), velocity=np.zeros(arm.dof))
    robots = Robots({ROBOT: resolved}, {ROBOT: arm}, {ROBOT: np.zeros(arm.dof)}, ())
    monkeypatch.setattr(assembled_joints, "scene_connections", lambda *_: pairs)
    rows = assembled_joints.contact_rows(scene, robots, joints)
    data = Data(uncontrolled_model(scene, robots, joints, rows, arm_backends(scene, robots)))
    return System(scene, data.model, StartReport(), written_start(scene, robots, rows.layout))
