"""Two mobile robots carry a table through a quarter of a circle.

The bases are joints like any others: they drive along x and y and turn.  Inverse dynamics moves the
table along the arc; of the joint accelerations that do so, it takes those nearest to the ones that
keep the formation, in which the bases drive and the arms hold still.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "two_carts_table.yaml"
RADIUS, TURN, DURATION = 2.0, np.pi / 2, 5.0  # [m], [rad], [s]
STIFFNESS, DAMPING = 25.0, 10.0  # [1/s^2], [1/s]


def heading(t: float) -> tuple[float, float, float]:
    """Angle on the arc [rad], its rate and its second rate: at rest at both ends."""
    s = min(t / DURATION, 1.0)
    angle = TURN * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    rate = TURN * 30.0 * s**2 * (1.0 - s) ** 2 / DURATION
    return angle, rate, TURN * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / DURATION**2


def on_arc(place: np.ndarray, t: float) -> np.ndarray:
    """Position, velocity and acceleration (3, 3) of a point that turns about the arc's centre.

    ``place`` (3,) is where it is at the start; the centre is at the side of the start, in y.
    """
    angle, rate, second = heading(t)
    centre = np.array([0.0, RADIUS, 0.0])
    r = Rotation.from_euler("z", angle).apply(place - centre)
    across = np.cross([0.0, 0.0, 1.0], r)
    return np.array([centre + r, rate * across, second * across - rate**2 * r])


def main() -> None:
    """Carry the table, and print how well."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay-html", type=Path, help="write the run as a web page")
    options = parser.parse_args()
    system = ma.compile_system(ma.load_scene(SCENE))
    start = system.initial_state()
    bases = {name: spec.base.matrix() for name, spec in system.scene.robots.items()}

    def posture(name: str, t: float) -> np.ndarray:
        """Positions, rates and accelerations (3, 16) of a robot's joints in the formation."""
        joints = np.zeros((3, start.joint_positions[name].size))
        joints[0] = start.joint_positions[name]
        course, axes = on_arc(bases[name][:3, 3], t), bases[name][:2, :2]
        course[0] -= bases[name][:3, 3]
        joints[:, :2] = course[:, :2] @ axes  # base_x and base_y are along the base's own axes
        joints[:, 2] = heading(t)
        return joints

    def carry(t: float, state: ma.State) -> dict[str, np.ndarray]:
        """Torques of all robots."""
        angle, rate, second = heading(t)
        position, velocity, acceleration = on_arc(start.object_position, t)
        turned = Rotation.from_quat(state.object_quaternion_xyzw)
        off_turn = (Rotation.from_euler("z", angle) * turned.inv()).as_rotvec()
        off = np.concatenate([position - state.object_position, off_turn])
        off_rate = np.concatenate([velocity, [0.0, 0.0, rate]]) - state.object_twist
        table = np.concatenate([acceleration, [0.0, 0.0, second]])
        robots = {}
        for name, q in state.joint_positions.items():
            place, speed, wanted = posture(name, t)
            errors = STIFFNESS * (place - q) + DAMPING * (speed - state.joint_velocities[name])
            robots[name] = wanted + errors
        return ma.inverse_dynamics(
            system,
            state,
            table + STIFFNESS * off + DAMPING * off_rate,
            posture_acceleration=robots,
        ).torques

    run = ma.simulate(
        system, DURATION, control=carry, sample_time=0.02, integrator="dop853", tolerance=1e-7
    )
    end = on_arc(start.object_position, DURATION)[0]
    error = 1e3 * np.linalg.norm(run.object_position[-1] - end)
    way = np.hypot(*end[:2])
    print(f"{run.status}: the table came {way:.2f} m, and is {error:.1f} mm off its place")
    for name, positions in run.joint_positions.items():
        x, y, yaw = positions[-1, :3]
        arms = np.ptp(positions[:, 3:], axis=0).max()
        print(
            f"{name}: base_x {x:+.2f} m, base_y {y:+.2f} m, base_yaw {yaw:+.2f} rad; "
            f"its other joints moved by up to {arms:.3f} rad"
        )
    for name, wrench in run.wrenches.items():
        force = np.linalg.norm(wrench[:, :3], axis=1)
        print(f"{name}: up to {force.max():.0f} N, {wrench[-1, 2]:.1f} N of the weight at the end")
    print(f"energy balance {np.abs(run.energy_balance).max():.1e} J")
    if options.replay_html:
        ma.replay(run, options.replay_html)


if __name__ == "__main__":
    main()
