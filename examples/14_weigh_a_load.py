"""What two arms hold, from how they move: mass and centre of mass of a box are identified.

The arms carry the weight of the box that is expected, and shake the true one with springs and
dampers about moving postures, while encoders record their joints.  Gauss and Newton's method
(SciPy) then finds the box whose simulated run fits the record.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "two_ur5_box.yaml"
TRUE = np.array([20.0, 0.05, -0.03, 0.02])  # [kg, m, m, m] mass, centre of mass against the middle
GUESS = np.array([10.0, 0.0, 0.0, 0.0])  # whose weight the arms carry
RESOLUTION = 2.0 * np.pi / 2**17  # of the encoders [rad]
TIMES = np.linspace(0.0, 1.0, 51)  # [s]
STIFFNESS, DAMPING = 400.0, 40.0  # [N m/rad], [N m s/rad]
SHAKE = 0.03 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])  # [rad] a joint


def carried(box: np.ndarray) -> ma.System:
    """Both arms and a box of this mass and centre of mass."""
    mass, *shift = box
    scene = ma.load_scene(SCENE)
    middle = np.array(scene.object.pose.xyz)
    return ma.compile_system(
        scene.replace({"object.mass": mass, "object.pose.xyz": middle + shift})
    )


def shaken(box: np.ndarray, held: dict[str, np.ndarray], accuracy: float) -> ma.Trajectory:
    """A run in which both arms shake the box, with torques ``held`` [N m] beside the springs."""
    system = carried(box)
    posture = system.initial_state().joint_positions

    def servo(t: float, state: ma.State) -> dict[str, np.ndarray]:
        moved = SHAKE * np.sin(2.0 * np.pi * t) ** 2
        return {
            arm: held[arm]
            + STIFFNESS * (posture[arm] + moved - q)
            - DAMPING * state.joint_velocities[arm]
            for arm, q in state.joint_positions.items()
        }

    return ma.simulate(
        system, TIMES[-1], control=servo, sample_time=0.004, output_times=TIMES,
        accuracy=accuracy, certificate=False,
    )  # fmt: skip


def joint_angles(run: ma.Trajectory) -> np.ndarray:
    """Those of both arms, shape (samples, 12) [rad]."""
    return np.hstack([run.joint_positions[arm] for arm in run.arm_names])


def main() -> None:
    """Record a run of the true box, and find the box again."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    system = carried(GUESS)
    held = ma.inverse_dynamics(system, system.initial_state(), np.zeros(6)).torques
    run = shaken(TRUE, held, 1e-6)
    record = RESOLUTION * np.round(joint_angles(run) / RESOLUTION)

    def misfit(box: np.ndarray) -> np.ndarray:
        """Differences of a box's run and the record, in steps of the encoders."""
        return (joint_angles(shaken(box, held, 1e-8)) - record).ravel() / RESOLUTION

    fit = least_squares(misfit, GUESS, x_scale=[10.0, 0.05, 0.05, 0.05], diff_step=1e-4)
    spread = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)) / 12.0)
    used = 100.0 * run.limit_use[["effort", "speed", "range"]].max()
    print("effort, speed and range: up to {:.0f}, {:.0f}, {:.0f} % of a limit".format(*used))
    print(f"encoders of {1e6 * RESOLUTION:.0f} urad, {record.size} readings, {fit.nfev} rounds")
    print(f"misfit {np.sqrt(np.mean(fit.fun**2)):.3f} steps, by rounding alone {12**-0.5:.3f}")
    print(f"mass {fit.x[0]:.4f} kg +- {spread[0]:.4f}, true {TRUE[0]:.4f}")
    millimetres = 1e3 * fit.x[1:], 1e3 * spread[1:], 1e3 * TRUE[1:]
    for axis, found, error, true in zip("xyz", *millimetres, strict=True):
        print(f"centre of mass {axis} {found:.3f} mm +- {error:.3f}, true {true:.3f}")


if __name__ == "__main__":
    main()
