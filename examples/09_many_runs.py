"""Where does the box end if its mass and the drives are not known exactly?  Many runs tell.

Two UR5 arms lift a box; their controller knows neither its weight nor their own. Every run has
another mass, other stiffness of both arms and another push at the start (``--plot ENDS.png`` draws
all of them).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "two_ur5_box.yaml"
STIFFNESS = np.array([2000.0, 2000.0, 2000.0, 300.0, 300.0, 300.0])  # [N m/rad]
TARGET = (0.0, 0.65)  # [m] where the box is led to: x, z


def draw_lots(system: ma.System, runs: int) -> tuple[list[ma.State], list[dict]]:
    """Starts and parameters of all runs, at random."""
    rng = np.random.default_rng(1)
    states, parameters = [], []
    for _ in range(runs):
        push = {arm: rng.normal(0.0, 0.05, 6) for arm in system.arm_names}  # [rad/s]
        states.append(system.state(joint_velocities=push))
        stiffness = {arm: rng.normal(1.0, 0.15) * STIFFNESS for arm in system.arm_names}
        mass = rng.normal(20.0, 4.0)  # [kg]
        parameters.append({"object.mass": mass, "control.stiffness": stiffness})
    return states, parameters


def plot(path: str, masses: np.ndarray, runs: list[ma.Trajectory]) -> None:
    """Ways of the box's centre from the side, and where they end."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shade = plt.Normalize(masses.min(), masses.max())
    figure, (ways, ends) = plt.subplots(1, 2, figsize=(10, 4.6), layout="constrained")
    for mass, run in zip(masses, runs, strict=True):
        x, _, z = 1e3 * run.object_position.T
        ways.plot(x, z, color=plt.cm.viridis(shade(mass)), lw=0.7, alpha=0.7)
        ends.plot(x[-1], z[-1], "o", color=plt.cm.viridis(shade(mass)), ms=5, mec="white", mew=0.5)
    for axes, title in ((ways, "ways of the box's centre"), (ends, "where they end")):
        axes.set(title=title, xlabel="x / mm", ylabel="z / mm")
        axes.grid(color="0.9")
    ways.plot(*(1e3 * np.array(TARGET)), "+", color="crimson", ms=12, mew=2, label="target")
    ways.legend(frameon=False)
    figure.colorbar(plt.cm.ScalarMappable(shade, "viridis"), ax=ends, label="mass / kg")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments: list[str] | None = None) -> None:
    """Simulate all runs, print where the box ends, and draw it when asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--plot", metavar="ENDS.png", help="draw all runs to this file")
    options = parser.parse_args(arguments)

    scene = ma.load_scene(SCENE)
    blind = {**vars(scene.control), "gravity_compensation": False}
    system = ma.compile_system(
        scene.replace(control=blind), arms="compiled"
    )  # so that threads help
    states, parameters = draw_lots(system, options.runs)
    began = time.perf_counter()
    runs = ma.simulate_many(
        system, accuracy=1e-4, states=states, parameters=parameters, certificate=False,
        progress=True,
    )  # fmt: skip
    spent = time.perf_counter() - began
    statuses = {run.status for run in runs}
    print(f"{len(runs)} runs of {runs[0].time[-1]:g} s in {spent:.1f} s: {', '.join(statuses)}")

    masses = np.array([own["object.mass"] for own in parameters])
    ends = np.array([run.object_position[-1] for run in runs])
    x, _, z = 1e3 * ends.mean(axis=0)
    print(f"the box ends at ({x:.1f}, {z:.1f}) mm on average; it is led to (0.0, 650.0) mm")
    sideways, _, up = 1e3 * ends.std(axis=0)
    print(f"spread {sideways:.1f} mm sideways, {up:.1f} mm in height")
    print(f"a kilogram more lets it sag by {-1e3 * np.polyfit(masses, ends[:, 2], 1)[0]:.2f} mm")
    if options.plot:
        plot(options.plot, masses, runs)
        print(f"plot: {options.plot}")


if __name__ == "__main__":
    main()
