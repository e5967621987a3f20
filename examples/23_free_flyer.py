"""A free-flying robot turns by moving its arms, though its angular momentum stays zero all along.

The robot holds a box in both hands and swings it in rounds: down and in, up and out.  Its joints
come back to where they were, its body does not, as a falling cat turns: how far depends on the way
of the joints alone, not on their speed.  Pinocchio computes the momentum from the robot's file.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pandas
import pinocchio as pin
from scipy.spatial.transform import Rotation

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "free_flyer.yaml"


def angular_momentum(system: ma.System, run: ma.Trajectory) -> np.ndarray:
    """Of robot and box about the origin [kg m^2/s], shape (samples, 3)."""
    model = pin.buildModelFromUrdf(str(SCENE.with_suffix(".urdf")), pin.JointModelFreeFlyer())
    data, joints = model.createData(), system.arms["sat"].joint_names
    assert tuple(model.names)[2:] == joints
    box, base = system.scene.object, run.bases["sat"]
    momentum = np.empty((len(run.time), 3))
    for k in range(len(run.time)):
        # Pinocchio writes the velocity of a base in the axes of the base
        R = Rotation.from_quat(base.quaternion_xyzw[k]).as_matrix()
        twist = base.twist[k].reshape(2, 3) @ R
        q = [base.position[k], base.quaternion_xyzw[k], run.joint_positions["sat"][k]]
        v = [*twist, run.joint_velocities["sat"][k]]
        h = pin.computeCentroidalMomentum(model, data, np.concatenate(q), np.concatenate(v))
        R = Rotation.from_quat(run.object_quaternion_xyzw[k]).as_matrix()
        v_box, omega = run.object_twist[k].reshape(2, 3)
        momentum[k] = h.angular + np.cross(data.com[0], h.linear)
        momentum[k] += R @ box.inertia_matrix() @ R.T @ omega
        momentum[k] += np.cross(run.object_position[k], box.mass * v_box)
    return momentum


def main() -> None:
    """Swing the box, at full and at half speed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay-html", type=Path, help="write the run as a web page")
    options = parser.parse_args()
    scene = ma.load_scene(SCENE)
    system = ma.compile_system(scene)
    run = ma.simulate(system, accuracy=1e-8, certificate=False)
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "slow.csv"
        rows = pandas.read_csv(scene.control.file)
        rows.assign(time=2.0 * rows["time"]).to_csv(table, index=False)
        half = ma.compile_system(scene.replace({"control.file": str(table)}))
        slow = ma.simulate(half, 2.0 * scene.run.duration, certificate=False)
    for name, one in (("full", run), ("half", slow)):
        turn = np.degrees(Rotation.from_quat(one.bases["sat"].quaternion_xyzw[-1]).as_rotvec())
        off = np.abs(np.diff(one.joint_positions["sat"][[0, -1]], axis=0)).max()
        print(
            f"{name} speed: {one.status}, the body turned by {turn[1]:.2f} degrees about y, ",
            end="",
        )
        print(f"{np.hypot(*turn[[0, 2]]):.0e} about others; the joints are {off:.0e} rad off")
    largest = np.abs(angular_momentum(system, run)).max()
    spin = np.abs(run.bases["sat"].twist[:, 4]).max()
    print(f"the body spins with up to {spin:.2f} rad/s, ", end="")
    print(f"and the angular momentum is never more than {largest:.0e} kg m^2/s")
    if options.replay_html:
        ma.replay(run, options.replay_html)


if __name__ == "__main__":
    main()
