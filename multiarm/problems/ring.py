"""A ring of UR5 arms around a disc: any number of arms, three kinds of joint."""

from __future__ import annotations

import math
from functools import partial

from multiarm.errors import ModelError
from multiarm.problems.building import DOWN, tip_pose
from multiarm.problems.case import HardCase, sound
from multiarm.scene import Scene

# Start of every arm in the ring scene: tool0 is 0.55 m in front of its base.
RING_POSTURE = (-0.23, -1.2776, 1.3374, 0.4754, 1.372, -0.1166)
_REACH = 0.55


def ring_of_arms(
    arms: int = 2,
    kind: str = "weld",
    *,
    duration: float = 1.0,
    accuracy: float = 1e-6,
    frequency: float = 4.0,
) -> Scene:
    """``arms`` UR5 arms around a disc: the scene of the benchmarks.

    The bases stand on a circle of radius ``max(0.8, 0.25 / sin(pi / n))`` m and face inward; the
    disc is 0.05 m thick, weighs 2.5 kg an arm, its centre of mass is 25 mm below the grips.  The
    torques hold everything statically and add sinusoids of 3 N m (joints 1 - 3) and 1 N m
    (joints 4 - 6; by balls 0.5 N m in joint 6, which spins freely and would pass its speed limit).
    The equilibrium is unstable in open loop.

    Parameters
    ----------
    arms : int
        At least 2.
    kind : str
        Kind of all joints: weld, ball or revolute (about the tool's z axis).
    duration, accuracy, frequency : float
        [s], [m, rad], [Hz]
    """
    if arms < 2 or kind not in ("weld", "ball", "revolute"):
        raise ModelError(
            f"a ring has at least 2 arms and weld, ball or revolute joints, not {arms} and {kind!r}"
        )
    radius = max(0.8, 0.25 / math.sin(math.pi / arms))
    names = [f"arm{i}" for i in range(arms)]
    amplitude = [3.0, 3.0, 3.0, 1.0, 1.0, 0.5 if kind == "ball" else 1.0]
    heading = {name: 2.0 * math.pi * i / arms for i, name in enumerate(names)}
    height = float(tip_pose("ur5", "tool0", RING_POSTURE)[2, 3])
    return Scene(
        name=f"{arms} UR5 arms around a disc, {kind} joints",
        gravity=DOWN,
        object={
            "shape": {"cylinder": {"radius": radius - _REACH, "height": 0.05}},
            "mass": 2.5 * arms,
            "pose": {"xyz": [0.0, 0.0, height - 0.025]},
        },
        arms={
            name: {
                "robot": "ur5",
                "tip": "tool0",
                "posture": list(RING_POSTURE),
                "base": {
                    "xyz": [-radius * math.cos(angle), -radius * math.sin(angle), 0.0],
                    "rpy": [0.0, 0.0, angle],
                },
            }
            for name, angle in heading.items()
        },
        joints=[{"arm": name, "kind": kind} for name in names],
        control={
            "kind": "harmonic",
            "frequency": frequency,
            "amplitude": dict.fromkeys(names, amplitude),
            "phase": {name: [0.7 * i + 1.3 * j for j in range(6)] for i, name in enumerate(names)},
        },
        run={"duration": duration, "accuracy": accuracy},
    )


_ACCURACY = 1e-6

CASES = (
    HardCase(
        "eight_welded",
        "Eight arms welded to one disc",
        "Eight welds hold six freedoms: 42 of 48 contact forces only squeeze the disc, and the "
        "equilibrium is unstable. A solver of the whole system is slow here and badly scaled.",
        partial(ring_of_arms, 8, accuracy=_ACCURACY),
        sound(_ACCURACY),
    ),
    HardCase(
        "sixty_four_arms",
        "Sixty-four arms welded to one disc",
        "384 joints and 384 contacts on one body: what grows with the cube of the arms takes "
        "minutes, and roundings of 64 arms meet in the object.",
        partial(ring_of_arms, 64, accuracy=_ACCURACY),
        sound(_ACCURACY),
    ),
)
