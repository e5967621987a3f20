"""A regulator for two arms that hold a box: designed on the linearised system, then simulated.

The arms hold the box with the torques of the posture and nothing else: a push sends it off.  A
linear-quadratic regulator (LQR) on the minimal coordinates brings it back.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.linalg import solve_continuous_are

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "two_ur5_box.yaml"
PUSH = {"on": "object", "force": [0.0, 100.0, 0.0], "pulse": {"begin": 0.2, "end": 0.3}}
POSITIONS, VELOCITIES, TORQUES = 2000.0, 20.0, 1e-3  # weights


def regulator(linear: ma.LinearSystem) -> np.ndarray:
    """Feedback matrix K of torques ``-K y`` that cost least."""
    half = len(linear.A) // 2
    Q = np.diag([POSITIONS] * half + [VELOCITIES] * half)
    R = TORQUES * np.eye(len(linear.input_names))
    X = solve_continuous_are(linear.A, linear.B, Q, R)
    return np.linalg.solve(R, linear.B.T @ X)


def main() -> None:
    """Linearise, design, and push the box with and without the regulator."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--replay", type=Path, help="write the replay here")
    asked = options.parse_args()
    scene = ma.load_scene(SCENE).replace(effects={"external_wrenches": [PUSH]})
    system = ma.compile_system(scene)
    start = system.initial_state()
    hold = ma.inverse_dynamics(system, start, np.zeros(6)).torques
    held = system.with_control(lambda t, state: hold)
    linear = ma.linearise(held)
    print(f"held by its torques: {linear.stability}, {len(linear.A)} states")

    K, layout = regulator(linear), start.layout

    def control(t: float, state: ma.State) -> dict[str, np.ndarray]:
        feedback = layout.split_joints(-K @ linear.coordinates_of(state))
        return {arm: hold[arm] + feedback[arm] for arm in hold}

    regulated = system.with_control(control)
    near = ma.linearise(regulated)
    slowest = max(mode.time_constant for mode in near.modes)
    print(f"with the regulator: {near.stability}, slowest motion dies out in {slowest:.2f} s")
    for name, own in (("held", held), ("regulated", regulated)):
        run = ma.simulate(own, 1.0, accuracy=1e-5)
        away = 1e3 * np.linalg.norm(run.object_position - start.object_position, axis=1)
        print(f"{name}: pushed by up to {away.max():.2f} mm, {away[-1]:.2f} mm away at the end")
    if asked.replay is not None:
        ma.replay(run, asked.replay, open_browser=False)


if __name__ == "__main__":
    main()
