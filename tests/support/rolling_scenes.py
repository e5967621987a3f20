"""A ball that rolls on a surface which a sledge or a turntable carries."""

from __future__ import annotations

import numpy as np
from mechanics import scene_of

SLEDGE, BALL, RADIUS = 4.0, 1.5, 0.1  # [kg], [kg], [m]


GRAVITY = np.array([0.3, -0.5, -9.7])


CARRIER = """<robot name="carrier"><link name="ground"/>
<joint name="way" type="{kind}"><parent link="ground"/><child link="runner"/>
<axis xyz="{axis}"/><limit lower="-50" upper="50" effort="1000" velocity="100"/></joint>
<link name="runner"><inertial><mass value="4.0"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="mount" type="fixed"><parent link="runner"/><child link="tip"/>
<origin xyz="0 0 0" rpy="{rpy}"/></joint><link name="tip"/></robot>"""


def rolling_scene(urdf, surface, ball_inertia, position, velocity, spin, speed=0.0):
    """A ball of radius ``RADIUS`` that rolls on a surface at the carrier's tip."""
    body = {
        "shape": {"sphere": RADIUS},
        "mass": BALL,
        "inertia": [ball_inertia] * 3,
        "pose": {"xyz": list(map(float, position))},
        "twist": [*map(float, velocity), *map(float, spin)],
    }
    contact = {"arm": surface, "object": {"sphere": {"radius": RADIUS}}, "rolling": True}
    joint = {"arm": "carrier", "kind": "contacts", "contacts": [contact]}
    arms = {"carrier": {"urdf": urdf, "tip": "tip", "velocity": [speed]}}
    return scene_of(arms, [joint], object=body, gravity=GRAVITY.tolist(), run={"solver": "dense"})
