"""A humanoid rises from a squat with a box in both hands, and goes down again.

Nothing holds it: its base floats, and its feet stand on the ground by contacts that only push and
grip by friction, four at each.  Springs and dampers in the joints follow a table of hips, knees and
ankles; on top, the drives carry the weight of robot and box, against the forces of the feet.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "humanoid_lifts_a_box.yaml"
FEET = ("g1/left_foot-world", "g1/right_foot-world")


def main() -> None:
    """Lift the box, and look at the forces below the feet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay-html", type=Path, help="write the run as a web page")
    options = parser.parse_args()
    scene = ma.load_scene(SCENE)
    run = ma.simulate(ma.compile_system(scene), certificate=False)
    height, base = run.object_position[:, 2], run.bases["g1"].position[:, 2]
    print(
        f"{run.status}: the box rose by {1e3 * np.ptp(height):.0f} mm, the robot's base by ", end=""
    )
    print(f"{1e3 * np.ptp(base):.0f} mm; the box ends {1e3 * (height[-1] - height[0]):+.1f} mm off")
    # a contact has a force along its normal, and two of friction
    forces = np.hstack([run.contact_forces[foot] for foot in FEET]).reshape(len(run.time), -1, 3)
    push, friction = forces[..., 0], np.linalg.norm(forces[..., 1:], axis=-1)
    print(
        f"each of {push.shape[1]} contacts below the feet pushes with {push.min():.1f} to ", end=""
    )
    print(f"{push.max():.1f} N, and needs a friction of {np.max(friction / push):.3f} at most")
    upright = np.searchsorted(run.time, 2.0)
    carried = -sum(run.wrenches[foot][upright, 2] for foot in FEET)  # wrenches on the ground
    robot = carried / 9.81 - scene.object.mass
    print(f"upright they carry {carried:.2f} N: {robot:.2f} kg of robot and ", end="")
    print(f"{scene.object.mass:.0f} kg of box")
    use = run.limit_use
    most = use.loc[use["effort"].idxmax()]
    print(f"the drives give up to {100 * most['effort']:.0f} % of their torque ({most['joint']})")
    if options.replay_html:
        ma.replay(run, options.replay_html)


if __name__ == "__main__":
    main()
