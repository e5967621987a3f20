"""Two hands of three fingertips lift a box by friction, carry it, put it down, and let it go.

Computed torque presses the box from both ends, with forces within the cones of friction, and moves
it along a path: off the floor, across, and down again.  A control of the object never lets go of
it, so that a second run begins where the first one ends: it takes the hands' torques over, and
draws the hands away from the box.  Both runs are certified.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "lift_by_friction.yaml"
HANDS = {"left": -1.0, "right": 1.0}  # ends of the box along x
CLOSED = 0.62  # of the flanges from the centre of the box, along x [m]
AWAY, RATE = 0.05, 20.0  # of the hands from the box [m], of their drives' springs [1/s]
RELEASE, OPENING, END = 0.4, 1.0, 1.2  # [s]


def last_state(system: ma.System, run: ma.Trajectory) -> ma.State:
    """The state in which a run ends."""
    return system.state(
        run.object_position[-1],
        run.object_quaternion_xyzw[-1],
        {arm: positions[-1] for arm, positions in run.joint_positions.items()},
        run.object_twist[-1],
        {arm: velocities[-1] for arm, velocities in run.joint_velocities.items()},
    )


def smooth(share: float) -> float:
    """From 0 to 1, at rest at both ends."""
    share = min(max(share, 0.0), 1.0)
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def open_hands(system: ma.System, run: ma.Trajectory) -> Callable[..., dict[str, np.ndarray]]:
    """A controller: from the torques at the end of a run to springs that draw the hands away."""
    begin, held, closed, way = run.time[-1], {}, {}, {}
    gravity = np.array(system.scene.gravity)
    for hand, side in HANDS.items():
        held[hand], closed[hand] = run.joint_torques[hand][-1], run.joint_positions[hand][-1]
        J = system.arms[hand].terms(closed[hand], np.zeros(6)).J
        way[hand] = np.linalg.solve(J, [side * AWAY, 0, 0, 0, 0, 0])

    def control(t, state):
        release, opening = smooth((t - begin) / RELEASE), smooth((t - begin) / OPENING)
        torques = {}
        for hand, arm in system.arms.items():
            q, v = state.joint_positions[hand], state.joint_velocities[hand]
            wanted = closed[hand] + opening * way[hand]
            springs = arm.terms(q, v).M @ (RATE**2 * (wanted - q) - 2.0 * RATE * v)
            free = arm.gravity_torque(q, gravity) + springs
            torques[hand] = (1.0 - release) * held[hand] + release * free
        return torques

    return control


def main() -> None:
    """Lift, carry and put down the box, and open the hands."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replay-html", type=Path, help="write the first run as a web page")
    parser.add_argument("--replay-opening", type=Path, help="write the second one as a web page")
    options = parser.parse_args()
    system = ma.compile_system(ma.load_scene(SCENE))
    run = ma.simulate(system)
    opened = ma.simulate(
        system,
        END,
        state=last_state(system, run),
        start_time=run.time[-1],
        control=open_hands(system, run),
    )
    rise, across = np.ptp(run.object_position[:, 2]), np.ptp(run.object_position[:, 1])
    print(f"{run.status}: the box rose by {1e3 * rise:.2f} mm, {1e3 * across:.2f} mm across")
    print(run.certificate["text"])
    print(f"opening {opened.status}: {opened.certificate['text']}")
    floor = [event for event in run.events if event["text"].startswith("floor")]
    leaves = max(event["time"] for event in floor if event["time"] < 1.0)
    touches = min(event["time"] for event in floor if event["time"] > 1.0)
    print(f"corners of the box leave the floor at {leaves:.3f} s, and touch it at {touches:.3f} s")
    in_air = (run.time > leaves) & (run.time < touches)
    forces = np.concatenate([run.contact_forces[hand][in_air] for hand in HANDS])
    parts = forces.reshape(-1, 3)  # a force along the normal, and two of friction
    push, friction = parts[:, 0], np.linalg.norm(parts[:, 1:], axis=1)
    print(f"fingertips press with {push.min():.1f} to {push.max():.1f} N in between, ", end="")
    print(f"and need a friction of {np.max(friction / push):.3f} at most")
    last = max(event["time"] for event in opened.events if event["kind"] == "lets go")
    shift = np.linalg.norm(opened.object_position - run.object_position[-1], axis=1).max()
    away = min(side * opened.tip_positions[hand][-1, 0] for hand, side in HANDS.items()) - CLOSED
    print(
        f"the last fingertip lets go at {last:.2f} s, the hands end {1e3 * away:.1f} mm away, ",
        end="",
    )
    print(f"and the box moves by {1e3 * shift:.4f} mm meanwhile")
    for page, one in ((options.replay_html, run), (options.replay_opening, opened)):
        if page:
            ma.replay(one, page)


if __name__ == "__main__":
    main()
