"""A peg slides into a socket: two objects, each in the hand of an arm, and a joint between them.

The arm of the socket holds it with springs; that of the peg carries it and gives way, so that a
push moves it.  A cylindrical joint transmits neither a force along its axis nor a moment about it:
what the push does goes into motion and into the dampers of the arm's joints.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "peg_and_socket.yaml"


def main() -> None:
    """Push the peg, and look at what the socket feels."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay-html", type=Path, help="write the run as a web page")
    options = parser.parse_args()
    scene = ma.load_scene(SCENE)
    run = ma.simulate(ma.compile_system(scene))
    peg, socket = run.objects["peg"], run.objects["socket"]
    depth = np.ptp(peg.position[[0, -1], 0] - socket.position[[0, -1], 0])
    print(f"{run.status}: the peg went {1e3 * depth:.1f} mm deeper into the socket")
    wrench = run.wrenches["peg-socket"]  # on the socket, world axes
    x, y, z, w = peg.quaternion_xyzw.T
    axis = np.column_stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x**2 + y**2)])
    along = np.sum(wrench[:, :3] * axis, axis=1)
    across = np.linalg.norm(wrench[:, :3] - along[:, None] * axis, axis=1)
    print(f"the socket feels up to {across.max():.2f} N across the peg, ", end="")
    print(f"{np.abs(along).max():.1e} N along it")
    push = scene.effects.external_wrenches[0].force[0]
    work = run.channel("effects/external_wrenches/work")[-1]
    end = peg.position[:, 0] - 0.15 * axis[:, 0]  # where it pushes, along its force
    print(f"the push did {work:.4f} J; force times way is {push * (end[-1] - end[0]):.4f} J")
    print(f"largest gap of any joint {run.position_drift.max():.0e} m")
    if options.replay_html:
        ma.replay(run, options.replay_html)


if __name__ == "__main__":
    main()
