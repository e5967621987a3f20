"""Two hands turn a cube between their fingertips, by 20 degrees and back.

Every finger ends in a sphere that rolls on a face of the cube: a push along the normal, and no slip
in the two directions of the face.  Computed torque moves the cube along a path, and of the forces
that do nothing to the cube it commands a grip: three fingers of each hand against its thumb.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "two_hands_cube.yaml"
RADIUS = 0.012  # of the fingertips [m]


def main() -> None:
    """Turn the cube, and look at where the fingertips touch it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay-html", type=Path, help="write the run as a web page")
    options = parser.parse_args()
    system = ma.compile_system(ma.load_scene(SCENE))
    run = ma.simulate(system)
    cube = Rotation.from_quat(run.object_quaternion_xyzw)
    turns = np.degrees(cube.as_rotvec()[:, 2])
    print(
        f"{run.status}: the cube turned by {turns.max():.2f} degrees, and back to {turns[-1]:.0e}"
    )
    print(run.certificate["text"])
    up, slip, rolled = cube.as_matrix()[:, :, 2], {}, {}
    for name, position in run.tip_positions.items():
        v_o, omega_o = np.split(run.object_twist, 2, axis=1)
        v, omega = np.split(run.tip_twists[name], 2, axis=1)
        inward = up if name.endswith("thumb") else -up  # thumbs are below the cube
        r = RADIUS * inward  # from the centre of the fingertip to where it touches
        lever = position + r - run.object_position
        slip[name] = v + np.cross(omega, r) - v_o - np.cross(omega_o, lever)
        rolled[name] = np.linalg.norm(
            v - v_o - np.cross(omega_o, position - run.object_position), axis=1
        )
    largest = max(np.abs(speeds).max() for speeds in slip.values())
    rolling = max(speeds.max() for speeds in rolled.values())
    print(f"fingertips roll with up to {1e3 * rolling:.1f} mm/s, ", end="")
    print(f"and slip with {largest:.0e} m/s at most")
    needed = 0.0
    for name, forces in run.contact_forces.items():
        push, across = forces[:, 0], np.linalg.norm(forces[:, 1:], axis=1)
        needed = max(needed, np.max(across / push))
        if name.startswith("near/"):
            print(f"  {name:12} pushes with {push.min():.2f} to {push.max():.2f} N")
    print(f"a friction of {needed:.3f} would hold it")
    if options.replay_html:
        ma.replay(run, options.replay_html)


if __name__ == "__main__":
    main()
