"""Two UR5 arms press rubber fingertips against a box, lift it off a table, and let it slip.

Shows contacts that come and go: three fingertips an arm hold the box by friction alone. With enough
of it the box follows the arms; with too little it slips through the fingers and falls back on the
table. Every contact that lets go, slides, sticks or hits is an event of the result
(``--replay FILE.html`` shows the run that slips).
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "two_ur5_box.yaml"
MASS, END, PRESS = 6.0, 0.6, 80.0  # [kg], half the box's length [m], force of each hand [N]
STIFFNESS = np.array([2000.0, 2000.0, 2000.0, 300.0, 300.0, 300.0])  # [N m/rad]
DAMPING = np.array([200.0, 200.0, 200.0, 15.0, 15.0, 15.0])  # [N m s/rad]
INWARD = {"left": np.array([1.0, 0.0, 0.0]), "right": np.array([-1.0, 0.0, 0.0])}


def fingertips(side: float) -> list[dict]:
    """Three spherical fingertips on one end of the box, ``side`` -1 or 1."""
    face = {"plane": {"point": [side * END, 0, 0], "normal": [side, 0, 0]}}
    places = [(0.06, 0.036), (-0.06, 0.036), (0.0, -0.06)]
    return [
        {
            "name": f"finger {k + 1}",
            "arm": {"sphere": {"center": [y, z, -0.02], "radius": 0.02}},
            "object": face,
        }
        for k, (y, z) in enumerate(places)
    ]


def gripped(scene: ma.Scene, mu: float) -> ma.Scene:
    """The scene with fingertips in place of the welds, and a table under the box."""
    return scene.replace(
        {"object.mass": MASS},
        name=f"two UR5s hold a box by friction, mu = {mu:g}",
        joints=[
            {"arm": "left", "kind": "contacts", "contacts": fingertips(-1.0)},
            {"arm": "right", "kind": "contacts", "contacts": fingertips(1.0)},
        ],
        control={"kind": "none"},
        effects={
            "contact_friction": mu,
            "floor": {"at": {"xyz": [0, 0, 0.3]}, "mu": 0.5, "restitution": 0.2},
            "joint_damping": 1.0,
        },
        run={"duration": 1.5, "accuracy": 1e-5},
    )


def follow(system, planned: ma.Trajectory):
    """A controller: follow the planned joint motion, carry the arms, press inward."""
    path = {
        arm: CubicSpline(planned.time, planned.joint_positions[arm]) for arm in planned.arm_names
    }
    gravity = np.array(system.scene.gravity)

    def control(t, state):
        torques = {}
        for name, arm in system.arms.items():
            q, v = state.joint_positions[name], state.joint_velocities[name]
            torques[name] = (
                arm.gravity_torque(q, gravity)
                + STIFFNESS * (path[name](t) - q)
                + DAMPING * (path[name](t, 1) - v)
                + arm.terms(q, v).J[:3].T @ (PRESS * INWARD[name])
            )
        return torques

    return control


def main(arguments: list[str] | None = None) -> None:
    """Simulate with much and with little friction, and tell what happened."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay", metavar="FILE.html", help="write the replay to this file")
    options = parser.parse_args(arguments)

    scene = ma.load_scene(SCENE)
    light = scene.replace({"object.mass": MASS})
    planned = ma.simulate(ma.compile_system(light), duration=1.5, accuracy=1e-4, certificate=False)
    for mu in (0.6, 0.2):
        system = ma.compile_system(gripped(scene, mu))
        run = ma.simulate(system, control=follow(system, planned), certificate=False)
        lifted = run.object_position[-1, 2] - run.object_position[0, 2]
        print(f"mu = {mu:g}: {run.status}, lifted by {1e3 * lifted:.1f} mm")
        for kind, count in Counter(event["kind"] for event in run.events).most_common():
            first = next(event for event in run.events if event["kind"] == kind)
            print(f"  {kind}: {count}, first at {first['time']:.4f} s ({first['text']})")
        print(f"  energy balance {abs(run.energy_balance).max():.1e} J")
    if options.replay:
        print(f"replay: {ma.replay(run, options.replay)}")


if __name__ == "__main__":
    main()
