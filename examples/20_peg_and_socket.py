"""Four arms push a peg into a socket: two objects, two arms at each, and a joint between them.

Computed torque has a path for each object.  A cylindrical joint transmits neither a force along its
axis nor a moment about it, so that the socket does not feel how the peg goes in.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "peg_and_socket.yaml"


def main() -> None:
    """Lift peg and socket, push one into the other, and look at what the socket feels."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay-html", type=Path, help="write the run as a web page")
    options = parser.parse_args()
    run = ma.simulate(ma.compile_system(ma.load_scene(SCENE)))
    peg, socket = run.objects["peg"], run.objects["socket"]
    depth = np.ptp((peg.position - socket.position)[[0, -1], 0])
    print(f"{run.status}: the peg went {1e3 * depth:.3f} mm into the socket, ", end="")
    print(f"{1e3 * np.ptp(socket.position[:, 2]):.3f} mm higher than it began")
    wrench = run.wrenches["peg-socket"]  # on the socket, world axes
    axis = Rotation.from_quat(peg.quaternion_xyzw).as_matrix()[:, :, 2]
    along, about = (np.sum(part * axis, axis=1) for part in np.split(wrench, 2, axis=1))
    across = np.linalg.norm(wrench[:, :3] - along[:, None] * axis, axis=1)
    print(f"the socket feels up to {across.max():.2f} N across the peg, ", end="")
    print(f"{np.abs(along).max():.1e} N along it, {np.abs(about).max():.1e} N m about it")
    lifted = run.time > 1.2
    print(f"it moves by {np.ptp(socket.position[lifted], axis=0).max():.1e} m meanwhile")
    print(f"largest gap of any joint {run.position_drift.max():.0e} m")
    if options.replay_html:
        ma.replay(run, options.replay_html)


if __name__ == "__main__":
    main()
