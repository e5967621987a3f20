"""A parallel gripper, whose fingers are four-bar linkages, holds a box and lifts it.

The robot's file is a tree: the hinge that closes each linkage is a joint between two of its links,
and the right drive copies the left one.  How hard the pads press follows from virtual work: with
cranks of length L at an angle a from the middle line, both pads together move by 2 L cos(a) a
radian of the drive, so that a torque presses with F = torque / (2 L cos(a)).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "four_bar_gripper.yaml"
CRANK, OPEN = 0.055, 0.7  # length [m] of the cranks, their angle [rad] where the drive is at 0
TORQUE = 1.0  # [N m] of the drive
RISE, STIFFNESS, DAMPING = 0.1, 2000.0, 150.0  # [m], [N/m], [N s/m] of the lift


def main() -> None:
    """Lift the box, and compare the force of the pads with that of virtual work."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay-html", type=Path, help="write the run as a web page")
    options = parser.parse_args()
    system = ma.compile_system(ma.load_scene(SCENE))
    start = system.initial_state()
    joints = system.arms["gripper"].joint_names
    lift, drive = joints.index("base_z"), joints.index("left_driver_joint")
    holding = ma.inverse_dynamics(system, start, np.zeros(6)).torques["gripper"][lift]

    def grip(torque: float):
        """A control that lifts the gripper, and gives its drive a torque."""

        def control(t: float, state: ma.State) -> dict[str, np.ndarray]:
            q, v = state.joint_positions["gripper"], state.joint_velocities["gripper"]
            s, torques = min(t, 1.0), np.zeros(len(joints))
            down = start.joint_positions["gripper"][lift] - RISE * s**2 * (3.0 - 2.0 * s)
            torques[lift] = holding + STIFFNESS * (down - q[lift]) - DAMPING * v[lift]
            torques[drive] = torque
            return {"gripper": torques}

        return control

    run = ma.simulate(system, control=grip(TORQUE))
    print(f"{run.status}: the box rose by {1e3 * np.ptp(run.object_position[:, 2]):.1f} mm")
    print(f"{system.constraint_count} rows, of which {ma.evaluate(system).rank} are independent")
    for name in ("left_hinge", "right_hinge"):
        force = np.linalg.norm(run.wrenches[name][:, :3], axis=1)
        print(f"{name} carries up to {force.max():.1f} N")
    print(f"largest gap of any joint {run.position_drift.max():.0e} m")
    pressed, loose = (
        ma.evaluate(system.with_control(grip(torque))).wrenches["gripper/right"][0]
        for torque in (TORQUE, 0.0)
    )
    angle = OPEN - start.joint_positions["gripper"][drive]
    expected = TORQUE / (2.0 * CRANK * np.cos(angle))
    print(f"the torque presses with {pressed - loose:.4f} N; by virtual work {expected:.4f} N")
    if options.replay_html:
        ma.replay(run, options.replay_html)


if __name__ == "__main__":
    main()
