"""A robot lifts and turns a box with both hands, and its torso takes the rise.

Computed torque drives the box; the joints that it leaves open, 3 of 15, follow a posture of their
own: the torso rises with the box, the arms stay as they are.  Without it the light arms do all the
work: joints share a motion so that their kinetic energy is least.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "torso_lifts_a_box.yaml"
RISE, TURN, DURATION = 0.12, 0.15, 2.0  # [m], [rad] about the vertical, [s]
STIFFNESS, DAMPING = 100.0, 20.0  # [1/s^2], [1/s]


def course(t: float) -> tuple[float, float, float]:
    """Part of the way from 0 to 1, its rate and its second rate: at rest at both ends."""
    s = min(t / DURATION, 1.0)
    way = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    rate = 30.0 * s**2 * (1.0 - s) ** 2 / DURATION
    return way, rate, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / DURATION**2


def main() -> None:
    """Lift the box with the torso, and without."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay-html", type=Path, help="write the run as a web page")
    options = parser.parse_args()
    system = ma.compile_system(ma.load_scene(SCENE))
    start = system.initial_state()
    joints = system.arms["tiago"].joint_names
    print(f"{len(joints)} joints, first {joints[0]}; connections {', '.join(system.frames)}")
    torso = np.eye(len(joints))[joints.index("torso_lift_joint")]

    def lift(torso_rise: float):
        """A control in which the torso takes a part of the rise."""

        def control(t: float, state: ma.State) -> dict[str, np.ndarray]:
            way, rate, second = course(t)
            up, about = np.array([0.0, 0.0, RISE]), np.array([0.0, 0.0, TURN])
            off = start.object_position + way * up - state.object_position
            turned = Rotation.from_quat(state.object_quaternion_xyzw)
            off_turn = (Rotation.from_rotvec(way * about) * turned.inv()).as_rotvec()
            motion = np.concatenate([up, about])
            acceleration = second * motion + DAMPING * (rate * motion - state.object_twist)
            acceleration += STIFFNESS * np.concatenate([off, off_turn])
            q, v = state.joint_positions["tiago"], state.joint_velocities["tiago"]
            wanted = start.joint_positions["tiago"] + torso_rise * way * torso - q
            posture = torso_rise * second * torso + STIFFNESS * wanted
            posture += DAMPING * (torso_rise * rate * torso - v)
            return ma.inverse_dynamics(
                system, state, acceleration, posture_acceleration={"tiago": posture}
            ).torques

        return control

    for torso_rise in (0.0, RISE):
        run = ma.simulate(
            system, DURATION, control=lift(torso_rise), sample_time=0.02,
            integrator="dop853", tolerance=1e-7,
        )  # fmt: skip
        moved = run.joint_positions["tiago"][-1] - run.joint_positions["tiago"][0]
        error = np.linalg.norm(run.object_position[-1] - start.object_position - [0, 0, RISE])
        print(f"{run.status}: the box is {1e3 * error:.2f} mm off its place")
        print(
            f"  the torso rose by {1e3 * moved @ torso:.0f} of {1e3 * RISE:.0f} mm, joints of the "
            f"arms turned by up to {np.abs(moved * (1.0 - torso)).max():.2f} rad"
        )
    for name, wrench in run.wrenches.items():
        print(f"  {name} carries {wrench[-1, 2]:.1f} N of the weight")
    if options.replay_html:
        ma.replay(run, options.replay_html)


if __name__ == "__main__":
    main()
