"""Optimal control: two arms swing a box to another place, with the least torques.

The torques of all joints are a table over time, of 132 numbers.  SciPy's L-BFGS minimises the
distance from the target, the speed there, and the effort.  Every round takes one run and one walk
backward along it, which gives the derivatives by all numbers at once; differences would take 133
runs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "two_ur5_box.yaml"
TIMES = np.linspace(0.0, 1.0, 11)  # [s] of the table's rows
SHIFT = np.array([0.0, 0.12, 0.08])  # [m] to the target
SPEED = 0.2  # [s] a speed of 1 m/s at the end is as bad as so many metres
EFFORT = 1e-7  # [m^2 / (N m)^2] of a torque beyond those that hold the box


def main() -> None:
    """Find the torques, and show the run that they make."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=60, help="at most, of the search")
    parser.add_argument("--replay-html", type=Path, help="write the run as a web page")
    options = parser.parse_args()
    scene = ma.load_scene(SCENE)
    start = ma.compile_system(scene)
    names = [f"{arm}/{joint}" for arm in start.arm_names for joint in start.arms[arm].joint_names]
    target = start.initial_state().object_position + SHIFT
    holding = ma.inverse_dynamics(start, start.initial_state(), np.zeros(6)).torques
    rest = np.tile(np.concatenate(list(holding.values())), (len(TIMES), 1))

    def miss(_t: float, state: ma.State) -> tuple[float, np.ndarray]:
        """How far the box is from resting at the target, squared, and the derivatives of it."""
        error, slope = state.object_position - target, np.zeros(12 + 2 * rest.shape[1])
        slope[:3], slope[6:12] = 2.0 * error, 2.0 * SPEED**2 * state.object_twist
        return error @ error + SPEED**2 * state.object_twist @ state.object_twist, slope

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "torques.csv"

        def system_with(extra: np.ndarray) -> ma.System:
            table = np.column_stack([TIMES, rest + extra.reshape(rest.shape)])
            np.savetxt(file, table, "%.17g", ",", header=",".join(["time", *names]), comments="")
            control = {"kind": "recorded", "file": str(file), "interpolation": "linear"}
            return ma.compile_system(scene.replace(control=control), like=start)

        def cost(extra: np.ndarray) -> tuple[float, np.ndarray]:
            g = ma.gradient(system_with(extra), TIMES[-1], final=miss, accuracy=1e-6)
            by_table = np.hstack(list(g.by_torque_table(TIMES).values())).ravel()
            return g.value + EFFORT * extra @ extra, by_table + 2.0 * EFFORT * extra

        began = time.perf_counter()
        found = minimize(
            cost, np.zeros(rest.size), jac=True, method="L-BFGS-B",
            options={"maxiter": options.rounds, "ftol": 1e-9},
        )  # fmt: skip
        took = time.perf_counter() - began
        run = ma.simulate(system_with(found.x), TIMES[-1], accuracy=1e-6)
    left = 1e3 * np.linalg.norm(run.object_position[-1] - target)
    print(f"{rest.size} torques, {found.nfev} gradients in {took:.1f} s")
    print(f"target {1e3 * np.linalg.norm(SHIFT):.0f} mm away, missed by {left:.1f} mm")
    print(f"speed at the end {1e3 * np.linalg.norm(run.object_twist[-1, :3]):.1f} mm/s")
    print(f"torques beyond those of rest: up to {np.abs(found.x).max():.0f} N m")
    used = 100.0 * run.limit_use[["effort", "speed", "range"]].max()
    print("effort, speed and range: up to {:.0f}, {:.0f}, {:.0f} % of a limit".format(*used))
    print(f"the run is certified: {run.certificate['met']}")
    if options.replay_html:
        ma.replay(run, options.replay_html)


if __name__ == "__main__":
    main()
