"""Ten fingers turn a prism farther than one grip reaches: six let go in turns, and come back.

No fingertip has friction.  Four hold the prism from below and above, two on each of its three faces
turn it by 30 degrees.  Then one after the other leaves its face, goes back and takes hold again
elsewhere, while the nine others hold the prism in form closure; and they turn it on.
"""

from __future__ import annotations

import argparse
from itertools import groupby
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "finger_gaiting.yaml"
PERIOD = 0.04  # of the rows of the table [s]
STIFFNESS = 2000.0  # of a slide [N/m]
DISTANCE, RADIUS = 0.06, 0.008  # of a face from the axis, of a fingertip [m]
SPREAD, LIFT = 0.07, 0.01  # of two fingertips from the middle of their face, of one that moves [m]
SQUEEZE = 4.0  # about what each fingertip pushes with [N]
ANGLE = np.radians(30.0)  # of each of the two turns
TURN, REST = 1.2, 0.2  # [s]
# A fingertip unloads, lets go and leaves the face, moves along it, comes back, waits, takes hold.
UNLOADED, AWAY, MOVED, BACK, HOLDS, LOADED = np.cumsum([0.12, 0.12, 0.16, 0.12, 0.08, 0.12])
FIRST = REST + TURN  # when the first one begins [s]
END = FIRST + 6 * LOADED + TURN + REST
FINGERS = [(face, side) for face in "abc" for side in (1, -1)]
NAMES = [f"{face}_{'left' if side > 0 else 'right'}" for face, side in FINGERS]
BEARINGS = ("below_1", "below_2", "below_3", "above")
NORMALS = [np.array([np.cos(a), np.sin(a)]) for a in np.radians([0, 0, 120, 120, 240, 240])]
ALONG = [np.array([-n[1], n[0]]) for n in NORMALS]
HOMES = [side * SPREAD for _, side in FINGERS]  # of the bases, from the middle of the face [m]


def smooth(s: float) -> float:
    """From 0 to 1, at rest at both ends."""
    s = float(np.clip(s, 0.0, 1.0))
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def since(k: int, t: float) -> float:
    """Time since a finger began its regrasp [s]."""
    return t - FIRST - k * LOADED


def angle(t: float) -> float:
    """How far the prism has turned from the middle of its way [rad]."""
    second = FIRST + 6 * LOADED
    return ANGLE * (smooth((t - REST) / TURN) + smooth((t - second) / TURN) - 1.0)


def place(k: int, t: float) -> float:
    """Where a fingertip is along its face, from the middle [m]: opposite its base in mid-turn."""
    before, after = (
        HOMES[k] * np.cos(ANGLE / 2) - sign * (DISTANCE + RADIUS) * np.sin(ANGLE / 2)
        for sign in (-1, 1)
    )
    return before + smooth((since(k, t) - AWAY) / (MOVED - AWAY)) * (after - before)


def height(k: int, t: float) -> float:
    """How far a fingertip is from its face [m]."""
    s = since(k, t)
    return LIFT * (
        smooth((s - UNLOADED) / (AWAY - UNLOADED)) - smooth((s - MOVED) / (BACK - MOVED))
    )


def holding(t: float) -> list[int]:
    """The fingers of the faces that hold the prism at a time."""
    return [k for k in range(6) if not UNLOADED <= since(k, t) < HOLDS]


def wrenches(t: float) -> np.ndarray:
    """What unit pushes of the six do to the prism, body axes: forces, and moments over SPREAD."""
    return np.array([[*-n, place(k, t) / SPREAD] for k, n in enumerate(NORMALS)]).T


def balanced(t: float, fingers: list[int]) -> np.ndarray:
    """Pushes [N] of some fingers that are in balance, as near to SQUEEZE as they can be."""
    W, pushes = wrenches(t)[:, fingers], np.zeros(6)
    even = np.full(len(fingers), SQUEEZE)
    pushes[fingers] = even - np.linalg.pinv(W) @ (W @ even)
    return pushes


def squeeze(t: float) -> np.ndarray:
    """Pushes of the six [N]: one that will let go is unloaded before, and loaded afterwards."""
    pushes = balanced(t, list(range(6)))
    for k in range(6):
        s = since(k, t)
        if 0.0 <= s <= LOADED:
            # it lets go with a tenth of its push, which ends while it leaves the face
            share = 0.9 * smooth(s / UNLOADED) + 0.1 * smooth((s - UNLOADED) / (AWAY - UNLOADED))
            share -= smooth((s - HOLDS) / (LOADED - HOLDS))
            without = balanced(t, [j for j in range(6) if j != k])
            pushes = share * without + (1.0 - share) * pushes
    return pushes


def table() -> pd.DataFrame:
    """Where springs pull the slides to: to the places of the fingertips, and into the faces."""
    rows = []
    for t in PERIOD * np.arange(round(END / PERIOD) + 1):
        c, s = np.cos(angle(t)), np.sin(angle(t))
        turn, pushes, row = np.array([[c, -s], [s, c]]), squeeze(t), {"time": t}
        for k, (n, along) in enumerate(zip(NORMALS, ALONG, strict=True)):
            tip = (DISTANCE + RADIUS + height(k, t)) * n + place(k, t) * along
            target = turn @ (tip - pushes[k] / STIFFNESS * n)
            moved = target - (DISTANCE + RADIUS) * n - HOMES[k] * along
            row |= {f"{NAMES[k]}/along": -along @ moved, f"{NAMES[k]}/reach": -n @ moved}
        for name in BEARINGS:
            row[f"{name}/reach"] = SQUEEZE * (3.0 if name == "above" else 1.0) / STIFFNESS
        rows.append(row)
    return pd.DataFrame(rows)


def grasp(run: ma.Trajectory, i: int) -> ma.grasp.Contacts:
    """The fingertips that hold the prism at a sample: where they are, in its axes."""
    R = Rotation.from_quat(run.object_quaternion_xyzw[i]).as_matrix()
    normals = {name: [*-n, 0.0] for name, n in zip(NAMES, NORMALS, strict=True)}
    normals |= {name: [0, 0, -1.0 if name == "above" else 1.0] for name in BEARINGS}
    names = [*(NAMES[k] for k in holding(run.time[i])), *BEARINGS]
    into = np.array([normals[name] for name in names])
    tips = np.array([run.tip_positions[name][i] for name in names]) - run.object_position[i]
    return ma.grasp.Contacts(tips @ R + RADIUS * into, into, names)


def main() -> None:
    """Turn the prism, and tell how well the fingertips hold it at any time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write-table", action="store_true", help="write the scene's table")
    parser.add_argument("--replay", type=Path, help="write the replay here")
    options = parser.parse_args()
    if options.write_table:
        table().round(7).to_csv(SCENE.with_suffix(".csv"), index=False)
        return
    run = ma.simulate(ma.compile_system(ma.load_scene(SCENE)), progress=True)
    pushes = np.array([run.contact_forces[name][:, 0] for name in NAMES])
    for who, samples in phases(run.time):
        margin = min(ma.grasp.is_form_closure(grasp(run, i)).margin for i in samples)
        least = np.nanmin(pushes[np.ix_(holding(run.time[samples[0]]), samples)])
        span = f"{run.time[samples[0]]:.2f} to {run.time[samples[-1]]:.2f} s"
        held = f"closure margin {margin:.3f}, pushes of {least:.2f} N or more"
        print(f"{span}, {who:7} away: {held}")
    turns = np.degrees(Rotation.from_quat(run.object_quaternion_xyzw).as_rotvec()[:, 2])
    print(f"the prism turned from {turns[0]:.2f} to {turns[-1]:.2f} degrees; {run.message}")
    print(f"largest gap {run.position_drift.max():.0e} m")
    print(run.certificate["text"])
    if options.replay is not None:
        ma.replay(run, options.replay, open_browser=False)


def phases(times: np.ndarray) -> list[tuple[str, list[int]]]:
    """Who is away, and the samples of that time, in order."""
    away = ["".join(NAMES[k] for k in range(6) if k not in holding(t)) or "none" for t in times]
    return [(who, [*samples]) for who, samples in groupby(range(len(times)), away.__getitem__)]


if __name__ == "__main__":
    main()
