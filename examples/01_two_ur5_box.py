"""Two UR5 arms, welded to a box, lift it and turn it.

Shows the whole way: scene file, compiled system, one certified evaluation, a run to a named
accuracy, the numbers that judge it, and the replay (``--replay FILE.html``).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "two_ur5_box.yaml"


def main(arguments: list[str] | None = None) -> None:
    """Simulate, print the figures, and write the replay when asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay", metavar="FILE.html", help="write the replay to this file")
    options = parser.parse_args(arguments)

    system = ma.compile_system(ma.load_scene(SCENE))
    start = ma.evaluate(system)
    print(f"constraints {system.constraint_count}, residuals {start.residuals}")

    trajectory = ma.simulate(system, accuracy=1e-6)
    x, y, z = trajectory.object_position[-1]
    print(f"{trajectory.status}: {trajectory.statistics['steps']} steps, ", end="")
    print(f"{trajectory.statistics['evaluations']} evaluations")
    print(f"the box ends at ({x:.6f}, {y:.6f}, {z:.6f}) m")
    print(f"largest gap {trajectory.position_drift.max():.1e} m, ", end="")
    print(f"energy balance {abs(trajectory.energy_balance).max():.1e} J")
    for arm, wrench in trajectory.wrenches.items():
        carried = np.linalg.norm(wrench[:, :3], axis=1).max()
        at_contact = abs(trajectory.contact_forces[arm]).max()
        print(f"{arm}: force up to {carried:.1f} N on the box, {at_contact:.1f} N at a contact")
    if options.replay:
        print(f"replay: {ma.replay(trajectory, options.replay)}")


if __name__ == "__main__":
    main()
