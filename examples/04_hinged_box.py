"""Two UR5 arms, one welded and one hinged to a box, move it along a path and squeeze it.

Shows control in terms of the object: how closely it follows its waypoints, what the hinge does
meanwhile, how much of the contact forces is squeeze, and inverse dynamics by itself.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "hinged_box.yaml"


def main() -> None:
    """Simulate, judge the waypoints, and ask for the torques of one acceleration."""
    system = ma.compile_system(ma.load_scene(SCENE))
    trajectory = ma.simulate(system)
    print(f"{trajectory.status}: {trajectory.statistics['evaluations']} evaluations")
    for waypoint in system.scene.control.path:
        k = np.argmin(abs(trajectory.time - waypoint.time))
        error = np.linalg.norm(trajectory.object_position[k] - waypoint.xyz)
        hinge = trajectory.relative_position["right"][k, 0]
        print(f"at {waypoint.time:g} s: box {error:.1e} m off, hinge at {hinge:+.4f} rad")
    print(f"energy balance {abs(trajectory.energy_balance).max():.1e} J")

    start = system.initial_state()
    evaluation = ma.evaluate(system, 0.0, start)
    for arm, forces in evaluation.force_decomposition().squeezing.items():
        x, y, z = forces @ evaluation.contact_normals[arm]
        print(f"{arm}: squeezes with ({x:.2f}, {y:.2f}, {z:.2f}) N")

    lift = ma.inverse_dynamics(system, start, object_acceleration=[0, 0, 2.0, 0, 0, 0])
    print(f"to lift at 2 m/s^2, residuals {lift.residuals}")
    for arm, torques in lift.torques.items():
        print(f"{arm}: {' '.join(f'{torque:.2f}' for torque in torques)} N m")


if __name__ == "__main__":
    main()
