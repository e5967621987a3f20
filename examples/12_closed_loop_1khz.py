"""A digital controller at 1 kHz, closed around two arms that hold a box: faster than real time.

The controller is plain NumPy with a memory.  It reads encoders of finite resolution, takes the
joints' speeds from their differences, and holds its torques for a millisecond, while somebody
pushes the box.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "two_ur5_box.yaml"
PERIOD = 1e-3  # [s]
RESOLUTION = 2.0 * np.pi / 2**17  # of the encoders [rad]
STIFFNESS, DAMPING = 2000.0, 100.0  # [N m/rad], [N m s/rad]
PUSH = {"on": "object", "force": [0.0, 200.0, 0.0], "pulse": {"begin": 0.2, "end": 0.3}}


class JointServo:
    """Springs and dampers about a posture, with the torques that hold it."""

    def __init__(self, posture: dict, feedforward: dict) -> None:
        self.posture, self.feedforward = posture, feedforward
        self.before: dict = {}

    def torques(self, measured: dict) -> dict:
        """What it answers to measured joint angles."""
        found = {}
        for arm, angles in measured.items():
            speed = (angles - self.before.get(arm, angles)) / PERIOD
            spring = STIFFNESS * (self.posture[arm] - angles)
            found[arm] = self.feedforward[arm] + spring - DAMPING * speed
        self.before = measured
        return found


def encoders(state: ma.State) -> dict:
    """Joint angles as the encoders count them."""
    return {
        arm: RESOLUTION * np.round(angles / RESOLUTION)
        for arm, angles in state.joint_positions.items()
    }


def close_loop(stepper: ma.Stepper, servo: JointServo, count: int) -> None:
    """Measure, answer, advance."""
    for _ in range(count):
        stepper.advance(PERIOD, servo.torques(encoders(stepper.state)))


def main() -> None:
    """Close the loop, and tell how far the box was pushed and how fast that was."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--replay", type=Path, help="write the replay here")
    asked = options.parse_args()
    scene = ma.load_scene(SCENE).replace(
        control="gravity_compensation", effects={"external_wrenches": [PUSH]}
    )
    system = ma.compile_system(scene, arms="compiled")
    start = system.initial_state()
    feedforward = dict(ma.evaluate(system).joint_torques)
    stepper = ma.Stepper(system, accuracy=1e-5, record=True, output_step=0.01)
    close_loop(stepper, JointServo(encoders(start), feedforward), 300)  # compiles what is not yet
    stepper.reset()
    began = time.perf_counter()
    close_loop(stepper, JointServo(encoders(start), feedforward), 1000)
    took = time.perf_counter() - began
    run = stepper.trajectory()
    away = 1e3 * np.linalg.norm(run.object_position - start.object_position, axis=1)  # [mm]
    print(f"{stepper.time:.1f} s at {1 / PERIOD:.0f} Hz: {stepper.time / took:.1f} times real time")
    print(f"the box is pushed by {away.max():.2f} mm and ends {away[-1]:.3f} mm away")
    left = stepper.contact_forces["left"]
    print(f"the left grip of {left.size} contacts carries up to {abs(left).max():.0f} N")
    if asked.replay is not None:
        ma.replay(run, asked.replay, open_browser=False)


if __name__ == "__main__":
    main()
