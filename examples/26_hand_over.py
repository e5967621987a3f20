"""One arm picks a beam up from the floor, hands it over to another, which puts it down elsewhere.

A controller at 250 Hz moves each flange along a path and says who holds the beam.  Both arms hold
it for a moment: a closed chain that opens again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "hand_over.yaml"
PERIOD = 4e-3  # [s]
STIFFNESS = np.repeat([1500.0, 60.0], 3)  # of a flange [N/m, N m/rad]
DAMPING = np.repeat([150.0, 6.0], 3)  # [N s/m, N m s/rad]
# Where each flange is at some times [s]: x, y, z [m].
PATHS = {
    "left": {0.0: (-0.35, 0.4, 0.35), 1.2: (-0.35, 0.4, 0.1), 1.6: (-0.35, 0.4, 0.1),
             3.2: (-0.1, 0.4, 0.35), 4.6: (-0.1, 0.4, 0.35), 5.6: (-0.3, 0.4, 0.5)},
    "right": {0.0: (0.35, 0.4, 0.35), 2.0: (0.35, 0.4, 0.5), 4.0: (0.1, 0.4, 0.35),
              4.6: (0.1, 0.4, 0.35), 6.4: (0.35, 0.4, 0.1), 7.0: (0.35, 0.4, 0.1),
              8.0: (0.35, 0.4, 0.35)},
}  # fmt: skip
NEVER = {"from": "never", "until": None}
# When each one holds the beam [s].
HOLDS = {"left": (1.4, 4.4), "right": (4.2, 6.8)}


class HandOver:
    """The controller: torques of both arms, and which of them holds the beam."""

    def __init__(self, system: ma.System) -> None:
        self.carrying, self.axes = system, {}
        for arm, tip in system.kinematics(system.initial_state()).tips.items():
            self.axes[arm] = tip.rotation

    def __call__(self, t: float, state: ma.State) -> dict:
        """Springs and dampers at the flanges, and the weight of all that is carried."""
        answer = {"attach": [arm for arm in HOLDS if holds(arm, t)]}
        answer["detach"] = [arm for arm in HOLDS if not holds(arm, t)]
        weight = ma.evaluate(self.carrying, t, state).joint_torques
        carried = 2.0 * 9.81 / max(len(answer["attach"]), 1)
        for arm, tip in self.carrying.kinematics(state).tips.items():
            turned = self.axes[arm] @ tip.rotation.T
            turn = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0],
                                   turned[1, 0] - turned[0, 1]])  # fmt: skip
            wrench = STIFFNESS * np.append(place(arm, t) - tip.position, turn)
            wrench -= DAMPING * tip.twist
            wrench[2] += carried * holds(arm, t)
            answer[arm] = weight[arm] + tip.jacobian.T @ wrench
        return answer


def holds(arm: str, t: float) -> bool:
    """Whether an arm holds the beam at a time."""
    begin, end = HOLDS[arm]
    return begin <= t < end


def place(arm: str, t: float) -> np.ndarray:
    """Where a flange is to be: from point to point, at rest at each."""
    times, points = np.array(list(PATHS[arm])), np.array(list(PATHS[arm].values()))
    k = min(int(np.searchsorted(times, t, side="right")), len(times) - 1)
    s = np.clip((t - times[k - 1]) / (times[k] - times[k - 1]), 0.0, 1.0)
    return points[k - 1] + s**3 * (10.0 - 15.0 * s + 6.0 * s * s) * (points[k] - points[k - 1])


def main() -> None:
    """Hand the beam over, and tell what happened and how accurately."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--replay", type=Path, help="write the replay here")
    asked = options.parse_args()
    # when the arms hold is the controller's business here
    by_command = {f"joints[{k}].{key}": value for k in (0, 1) for key, value in NEVER.items()}
    scene = ma.load_scene(SCENE).replace({**by_command, "control": "gravity_compensation"})
    control = HandOver(ma.compile_system(scene))
    run = ma.simulate(ma.compile_system(scene, control, sample_time=PERIOD), progress=True)
    for event in run.events:
        if event["kind"] in ("attached", "detached"):
            print(f"{event['time']:.3f} s  {event['text']}, {event['energy_loss']:.2e} J lost")
    x, y, z = run.object_position[-1]
    print(f"the beam ends at ({x:.4f}, {y:.4f}, {z:.4f}) m; {run.message}")
    print(run.certificate["text"])
    if asked.replay is not None:
        ma.replay(run, asked.replay, open_browser=False)


if __name__ == "__main__":
    main()
