"""Two arms pick a body up from the floor: they tilt it, reach below it, and lift it.

Fingertips without friction hold a body only from all sides, and the floor covers one.  The plan
says about which edge the hands tilt the body, with the floor as a third hand, how far, and with
which forces; where nothing can, it says why.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

import multiarm as ma

Polyhedron = ma.grasp.Polyhedron
BASE = np.array([[-0.25, -0.2], [0.25, -0.2], [0.25, 0.2], [-0.25, 0.2]])  # [m]
TOP = np.array([0.5, 0.6])  # of a frustum, over its base
BODIES = {
    "block": Polyhedron.box([0.4, 0.3, 0.3]),
    "wedge": Polyhedron.wedge([0.5, 0.4, 0.3]),
    "frustum": Polyhedron.hull([[*xy, 0.0] for xy in BASE] + [[*(TOP * xy), 0.3] for xy in BASE]),
    "pyramid": Polyhedron.pyramid(BASE, (0.0, 0.0, 0.15)),
}


def main() -> None:
    """Plan, run, and tell what happened and how accurately."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("body", nargs="?", choices=BODIES, default="block")
    options.add_argument("--replay", type=Path, help="write the replay here")
    asked = options.parse_args()
    try:
        plan = ma.grasp.plan_pickup(BODIES[asked.body])
    except ma.grasp.PickupError as error:
        print(error)
        return
    print(plan)
    with tempfile.TemporaryDirectory() as folder:
        scene = plan.to_scene(["ur5", "ur5"], table=Path(folder) / "references.csv", mass=5.0)
        run = ma.simulate(ma.compile_system(scene))
    for event in run.events:
        if event["kind"] == "attached" or event["text"].startswith("floor"):
            print(f"{event['time']:.3f} s  {event['text']}")
    lying = [run.contact_forces[gripper.arm_name] for gripper in plan.grasp.grippers]
    weakest = min(forces.min() for forces in lying)
    print(f"contacts on free faces press with {weakest:.2f} N at least")
    below = min(
        forces[-1].min() for name, forces in run.contact_forces.items() if name.endswith("_below")
    )
    print(f"those below with {below:.2f} N at the end")
    rise = run.object_position[-1, 2] - run.object_position[0, 2]
    print(f"the {asked.body} is lifted by {1e3 * rise:.2f} mm; {run.message}")
    print(run.certificate["text"])
    if asked.replay is not None:
        ma.replay(run, asked.replay, open_browser=False)


if __name__ == "__main__":
    main()
