"""Two arms carry a stack of two boxes, and we read what the weld between the boxes carries.

First the stack is one body of the same mass and inertia, whose path the joints' springs follow.
Its joint positions are recorded and played back to the arms that hold two boxes: they move as the
one body does, and between them acts a wrench, F = m (a - g) on the upper box.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "two_arms_stack.yaml"
PATH = [{"time": 1.0, "xyz": [0.0, 0.1, 0.6333]}, {"time": 2.0, "xyz": [0.0, 0.0, 0.5333]}]


def one_body(scene: ma.Scene) -> ma.Scene:
    """The scene with one body in place of its objects."""
    bodies = scene.objects.values()
    masses = np.array([body.mass for body in bodies])
    places = np.array([body.pose.xyz for body in bodies])
    centre = masses @ places / masses.sum()
    inertia = np.zeros((3, 3))
    for body, r in zip(bodies, places - centre, strict=True):
        inertia += body.inertia_matrix() + body.mass * (r @ r * np.eye(3) - np.outer(r, r))
    body = {"mass": masses.sum(), "inertia": inertia, "pose": {"xyz": centre}}
    shift = np.array(scene.objects["lower"].pose.xyz) - centre
    joints = [
        {"arm": joint.arm, "kind": "weld", "at": joint.at.model_copy(update={"xyz": xyz})}
        for joint in scene.joints[:2]
        for xyz in [(np.array(joint.at.xyz) + shift).tolist()]
    ]
    return scene.replace(objects=None, object=body, joints=joints)


def main() -> None:
    """Carry the stack as one body, then as two."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay-html", type=Path, help="write the run as a web page")
    options = parser.parse_args()
    scene = ma.load_scene(SCENE).replace(
        {"run.duration": 2.0, "run.output_step": 0.005}, effects={}
    )
    springs = {key: getattr(scene.control, key) for key in ("stiffness", "damping")}
    body = one_body(scene)
    leading = ma.compile_system(body.replace({"control.path": PATH}))
    led = ma.simulate(leading)
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "joints.csv"
        columns = {"time": led.time} | {
            f"{arm}/{joint}": positions[:, k]
            for arm, positions in led.joint_positions.items()
            for k, joint in enumerate(leading.arms[arm].joint_names)
        }
        rows = np.column_stack([*columns.values()])
        np.savetxt(table, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.17g")
        recorded = {"kind": "recorded", "file": str(table), "quantity": "position", **springs}
        control = {**recorded, "interpolation": "cubic"}
        one = ma.simulate(ma.compile_system(body.replace(control=control)))
        two = ma.simulate(ma.compile_system(scene.replace(control=control)))
    lower, upper = two.objects["lower"], two.objects["upper"]
    turned = np.abs(lower.quaternion_xyzw - one.object_quaternion_xyzw).max()
    masses = [box.mass for box in scene.objects.values()]
    centre = np.average([lower.position, upper.position], axis=0, weights=masses)
    apart = np.abs(centre - one.object_position).max()
    print(f"{two.status}: the stack rose by {1e3 * np.ptp(upper.position[:, 2]):.1f} mm")
    print(f"two boxes and one body are apart by {apart:.0e} m, turned by {turned:.0e}")
    force = two.wrenches["upper-lower"][:, :3]  # on the lower box
    acceleration = np.gradient(upper.twist[:, :3], two.time, axis=0)
    needed = masses[1] * (acceleration - np.array(scene.gravity))
    k = np.argmax(-force[:, 2])
    print(f"the weld carries up to {-force[k, 2]:.2f} N; m (a - g) is {needed[k, 2]:.2f} N")
    if options.replay_html:
        ma.replay(two, options.replay_html)


if __name__ == "__main__":
    main()
