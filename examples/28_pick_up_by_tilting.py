"""Two arms pick a body up from the floor: they tilt it, reach below it, and lift it.

Fingertips without friction hold a body only from all sides, and the floor covers one.  The plan
says about which edge the hands tilt the body, with the floor as a third hand, how far, and with
which forces; where none was found, it says why.

Late fingertips take hold with a small impact, in which other contacts may open for a moment.
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


def openings(run: ma.Trajectory, arms: list[str]) -> list[float]:
    """How long contacts of arms that had pressed were open, each time that is listed [s]."""
    opened: dict[tuple[str, str], float] = {}
    seconds = []
    for event in run.events:
        contact = event.get("arm", ""), event.get("contact", "")
        if contact[0] not in arms or "after" not in event:
            continue
        if event["kind"] == "lets go":
            opened[contact] = event["time"]
        elif event["after"].get("state") != "open" and contact in opened:
            seconds.append(event["time"] - opened.pop(contact))
    if all(event["kind"] != "not listed" for event in run.events):
        seconds += [run.time[-1] - begin for begin in opened.values()]
    return seconds


def main() -> None:
    """Plan, run, and tell what happened and how accurately."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("body", nargs="?", choices=BODIES, default="block")
    parser.add_argument("--replay", type=Path, help="write the replay here")
    options = parser.parse_args()
    try:
        plan = ma.grasp.plan_pickup(BODIES[options.body])
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
    presses = run.contact_forces["floor"].max(axis=1) > 0.0
    print(f"the floor presses until {run.time[presses][-1]:.2f} s, at samples")
    hands = [name for name in run.contact_forces if name != "floor"]
    times = openings(run, hands)
    longest = 1e3 * max(times, default=0.0)
    print(f"events list {len(times)} openings of the hands' contacts, of {longest:.3f} ms at most")
    early = [run.contact_forces[gripper.arm_name] for gripper in plan.grasp.grippers]
    weakest = min(forces.min() for forces in early)
    print(f"at samples, those on free faces press with {weakest:.2f} N at least")
    below = min(
        forces[-1].min() for name, forces in run.contact_forces.items() if name.endswith("_below")
    )
    print(f"those below with {below:.2f} N at the end")
    rise = run.object_position[-1, 2] - run.object_position[0, 2]
    print(f"the {options.body} is lifted by {1e3 * rise:.2f} mm; {run.message}")
    print(run.certificate["text"])
    if options.replay is not None:
        ma.replay(run, options.replay, open_browser=False)


if __name__ == "__main__":
    main()
