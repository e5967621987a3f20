"""Random scenes whose joints take hold and let go, and what their runs have to obey.

    python tests/support/random_schedules.py --number 100 --accuracy 1e-4

Exits with 1 when a run ends early without a reason, gains energy or breaks a law, and lists it.

Families: ``objects`` that fly and couple, ``rails`` (light arms of slides and hinges), ``arms``
(UR5s, with a floor or without), ``pads`` (fingertips with friction, corner grippers) and
``satellites`` (robots that float).  A run is judged by what holds without knowing the motion:
energy, momentum, closed gaps.

Joints with a place of their own may take hold across a tenth of a millimetre.  Closing it moves
weights, which is not in the energy balance.
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
import time
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from event_scenes import arm
from object_scenes import ASIDE
from random_friction_scenes import HANDS, fingertips, hand
from scipy.spatial.transform import Rotation
from timed_scenes import Table, switches

import multiarm as ma
from multiarm.events.taking_hold import LARGEST_GAP
from multiarm.scene import parse_scene

DOWN = [0.0, 0.0, -9.81]
REASONS = {
    "far": "would take hold across",
    "fast": "more than its 'speed_limit'",
    "paradox": "no solution (Painleve)",
    "lost grip": "all of whose contacts are open",
}
"""Why a run may end before its time, and what its message has then."""
HELD = ("weld", "weld", "ball", "revolute", "prismatic", "universal", "cylindrical", "planar")
# Energy that may be gained at a switch, and from one sample to the next, of the largest [1]; change
# of the momentum, of its largest part [1]; gap of what holds [m].
SWITCH, RISE, MOMENTUM, GAP = 2e-11, 1e-5, 1e-6, 1e-12
SLOW = 20.0  # such runs are shown [s]


def draw(family: str, seed: int) -> Table:
    """A scene of a family; the same for the same seed."""
    rng = np.random.default_rng([list(FAMILIES).index(family), seed])
    duration = _number(rng, 0.2, 0.6)
    scene = FAMILIES[family](rng, duration)
    scene["name"] = f"{family} {seed}"
    return scene | {"run": {"duration": duration, "output_step": duration / 25}}


# --- parts ----------------------------------------------------------------------------------------


def _number(rng: np.random.Generator, low: float, high: float) -> float:
    """Three digits, so that scenes can be read."""
    return float(f"{rng.uniform(low, high):.3g}")


def _numbers(rng: np.random.Generator, size: float, count: int) -> list[float]:
    return [_number(rng, -size, size) for _ in range(count)]


def _times(rng: np.random.Generator, duration: float, from_start: float = 0.4) -> Table:
    """When a joint holds: one to three pairs of times, from the start on or not."""
    number = int(rng.integers(1, 4))
    times = np.sort(rng.uniform(0.0, duration, 2 * number)).round(4).tolist()
    if rng.random() < from_start:
        times[0] = 0.0
    if len(set(times)) < len(times):  # equal after rounding
        times = [k * duration / (2 * number) for k in range(2 * number)]
    pairs: list[list[Any]] = [list(pair) for pair in zip(times[::2], times[1::2], strict=True)]
    if rng.random() < 0.5:
        pairs[-1][1] = "never"
    if len(pairs) == 1 and rng.random() < 0.5:
        return {"from": pairs[0][0], "until": pairs[0][1]}
    return {"from": pairs}


def _hold(rng: np.random.Generator) -> Table:
    """A kind of joint and its axis; what has no axis has none."""
    kind = str(rng.choice(HELD))
    axis = [round(float(x), 3) for x in rng.standard_normal(3)]
    return {"kind": kind, "axis": axis} if kind in ("revolute", "prismatic") else {"kind": kind}


def _body(rng: np.random.Generator, xyz: Any, moving: float = 1.0, turned: bool = True) -> Table:
    sizes = [_number(rng, 0.1, 0.5) for _ in range(3)]
    rpy = _numbers(rng, 3.0, 3) if turned else [0.0] * 3
    return {
        "shape": {"box": sizes}, "mass": _number(rng, 0.3, 5.0),
        "pose": {"xyz": [float(x) for x in xyz], "rpy": rpy},
        "twist": [*_numbers(rng, moving, 3), *_numbers(rng, 3.0 * moving, 3)],
    }  # fmt: skip


def _control(rng: np.random.Generator, stiff: float) -> Table:
    """None, springs and dampers, or gravity compensation."""
    kind = str(rng.choice(["none", "none", "joint_pd", "gravity_compensation"]))
    if kind == "none":
        return {}
    if kind == "gravity_compensation":
        return {"control": {"kind": kind}}
    springs = {"stiffness": _number(rng, 0.1, 1.0) * stiff, "damping": 0.05 * stiff}
    return {"control": {"kind": kind, **springs}}


# --- families -------------------------------------------------------------------------------------


def objects_scene(rng: np.random.Generator, duration: float) -> Table:
    """Two to four objects that fly without gravity; some couple for some of the time."""
    names = [f"body{k}" for k in range(rng.integers(2, 5))]
    objects = {name: _body(rng, _numbers(rng, 1.0, 3)) for name in names}
    joints = []
    for k in range(int(rng.integers(1, len(names) + 2))):
        pair = [str(name) for name in rng.choice(names, 2, replace=False)]
        joints.append({"between": pair, "name": f"joint{k}", **_hold(rng), **_times(rng, duration),
                       "at_first": {"xyz": _numbers(rng, 0.3, 3)}})  # fmt: skip
    return {"gravity": None, "objects": objects, "joints": joints, "robots": ASIDE}


def rails_scene(rng: np.random.Generator, duration: float) -> Table:
    """Two to four light arms of slides and hinges take an object in turns."""
    arms, joints = {}, []
    for k in range(int(rng.integers(2, 5))):
        kinds = str(rng.choice(["x", "xy", "xyz", "xZ", "yX", "zXY", "xyzXYZ", "XYZ"]))
        name = f"arm{k}"
        arms[name] = arm(
            kinds, velocity=_numbers(rng, 1.0, len(kinds)), mass=_number(rng, 0.3, 3.0),
            base={"xyz": _numbers(rng, 0.5, 3), "rpy": _numbers(rng, 1.0, 3)},
            posture=_numbers(rng, 0.5, len(kinds)),
        )  # fmt: skip
        times = _times(rng, duration, 0.0)
        joints.append({"arm": name, **_hold(rng), **times})
    effects = {"joint_damping": _number(rng, 0.1, 2.0)} if rng.random() < 0.5 else {}
    return {"gravity": DOWN if rng.random() < 0.5 else None, "object": _body(rng, [0, 0, 0]),
            "arms": arms, "joints": joints, "effects": effects,
            **_control(rng, 50.0)}  # fmt: skip


def _floor(rng: np.random.Generator) -> Table:
    """A floor, with friction or without."""
    restitution = float(rng.choice([0.0, 0.0, 0.5]))
    floor: Table = {"restitution": restitution}
    if rng.random() < 0.7:
        floor["mu"] = _number(rng, 0.1, 0.9)
    return {"floor": floor, "unilateral_contacts": {"restitution": restitution,
                                                    "start": "as_written"}}  # fmt: skip


def arms_scene(rng: np.random.Generator, duration: float) -> Table:
    """Two to four UR5s take a box in turns; it flies, or rests on a floor with friction."""
    on_floor = bool(rng.random() < 0.5)
    body = _body(rng, [0, 0, 0.5], turned=not on_floor)
    if on_floor:
        body["pose"]["xyz"] = [0.0, 0.0, 0.5 * body["shape"]["box"][2]]
        body["twist"] = [*_numbers(rng, 0.5, 2), 0.0, 0.0, 0.0, 0.0]
    arms, joints = {}, []
    for k in range(int(rng.integers(2, 5))):
        angle = 0.5 * math.pi * k
        name = f"arm{k}"
        side = np.array([math.cos(angle), math.sin(angle), 0.0])
        arms[name] = hand(1.0, np.array([0.3, 0.0, 0.5])) | {
            "velocity": _numbers(rng, 0.5, 6),
            "base": {"xyz": (1.1 * side).tolist(), "rpy": [0.0, 0.0, angle + math.pi]},
        }
        joints.append({"arm": name, **_hold(rng), **_times(rng, duration, 0.0)})
    effects: Table = _floor(rng) if on_floor else {}
    if rng.random() < 0.5:
        effects["joint_damping"] = _number(rng, 0.1, 3.0)
    return {"gravity": DOWN, "object": body, "arms": arms, "joints": joints, "effects": effects,
            **_control(rng, 400.0)}  # fmt: skip


def pads_scene(rng: np.random.Generator, duration: float) -> Table:
    """Hands with fingertips or corner grippers, whose contacts come and go with the joint."""
    half, height = _number(rng, 0.2, 0.4), 0.5
    arms, joints = {}, []
    for name, side in HANDS.items():
        arms[name] = hand(side, np.array([side * half, 0.0, height]))
        sort = str(rng.choice(["pads", "pads", "corner_gripper", "weld"]))
        joint: Table = {"arm": name, "kind": sort}
        if sort == "pads":
            contacts = fingertips(int(rng.integers(1, 5)), side, half, _number(rng, 0.0, 6.0))
            joint = {"arm": name, "kind": "contacts", "contacts": contacts}
            if rng.random() < 0.3:
                joint["at"] = {}
        joints.append({**joint, **_times(rng, duration, 0.7)})
    if all(joint["kind"] != "weld" for joint in joints):  # something that carries it
        joints.append({"between": ["object", "world"], "name": "stand",
                       "kind": str(rng.choice(["weld", "ball"])),
                       **_times(rng, duration, 0.5)})  # fmt: skip
    press = {"on": "left/wrist_3_link", "axes": "world", "force": [_number(rng, 5, 60), 0.0, 0.0]}
    effects: Table = {
        "unilateral_contacts": {"restitution": float(rng.choice([0.0, 0.0, 0.3])),
                                "start": "as_written"},
        "contact_friction": {"mu": _number(rng, 0.2, 0.9)},
        "joint_damping": _number(rng, 0.2, 3.0),
    }  # fmt: skip
    if rng.random() < 0.5:
        effects["external_wrenches"] = [press]
    sizes = [2 * half, _number(rng, 0.2, 0.5), _number(rng, 0.2, 0.5)]
    body = {"shape": {"box": sizes}, "mass": _number(rng, 0.5, 5.0),
            "pose": {"xyz": [0.0, 0.0, height]}}  # fmt: skip
    springs = {"kind": "joint_pd", "stiffness": _number(rng, 100, 1000), "damping": 20.0,
               "gravity_compensation": bool(rng.random() < 0.5)}  # fmt: skip
    return {"gravity": DOWN, "object": body, "arms": arms, "joints": joints, "effects": effects,
            "control": springs}  # fmt: skip


def satellites_scene(rng: np.random.Generator, duration: float) -> Table:
    """One or two robots that float, and one or two objects, without gravity."""
    robots, joints, bodies = {}, [], []
    objects = {f"body{k}": _body(rng, _numbers(rng, 0.8, 3)) for k in range(rng.integers(1, 3))}
    for k in range(int(rng.integers(1, 3))):
        name = f"sat{k}"
        base = {"moves": "free", "mass": _number(rng, 5, 40), "inertia": [3.0, 3.0, 2.0],
                "xyz": [1.5 * (-1) ** k, 0.0, 0.0], "rpy": _numbers(rng, 1.0, 3),
                "twist": _numbers(rng, 0.5, 6)}  # fmt: skip
        robots[name] = {"robot": "ur5", "base": base, "tips": {"hand": "tool0"}}
        bodies.append(f"{name}/hand")
    for k in range(int(rng.integers(1, 4))):
        first = str(rng.choice(bodies))
        others = [body for body in [*objects, *bodies] if body != first]
        joints.append({"between": [first, str(rng.choice(others))], "name": f"joint{k}",
                       **_hold(rng), **_times(rng, duration)})  # fmt: skip
    effects = {"joint_damping": _number(rng, 0.1, 2.0)} if rng.random() < 0.5 else {}
    return {"gravity": None, "objects": objects, "robots": robots, "joints": joints,
            "effects": effects, **_control(rng, 100.0)}  # fmt: skip


FAMILIES = {
    "objects": objects_scene,
    "rails": rails_scene,
    "arms": arms_scene,
    "pads": pads_scene,
    "satellites": satellites_scene,
}
FLYING = ("objects", "satellites")
"""Families without forces from outside: they keep their momentum."""


# --- judgement ------------------------------------------------------------------------------------


class Verdict(NamedTuple):
    """How a run ended, and its figures.

    Attributes
    ----------
    end : str
        "completed", a key of :data:`REASONS`, or "failed".
    message : str
    switches : int
    gained : float
        Largest energy gained at a switch, of the largest energy or work [1].
    driven : bool
        Something does work from outside.
    risen : float
        Largest rise of the energy from one sample to the next, of the largest energy; without
        works of drives and external forces.
    unbalanced : float
        Of the energy balance, of the largest energy.
    left : float
        The same at the end, less what the closing of gaps can do.
    gap : float
        Largest gap of what holds [m].
    momentum : float
        Largest change of the momentum, of its largest part; 0 where it is not kept.
    """

    end: str
    message: str
    switches: int
    gained: float
    driven: bool
    risen: float
    unbalanced: float
    left: float
    gap: float
    momentum: float

    def faults(self, accuracy: float) -> list[str]:
        """What is wrong."""
        bounds = {"gained": SWITCH, "left": accuracy, "gap": GAP, "momentum": MOMENTUM}
        bounds |= {} if self.driven else {"risen": RISE}
        figures = self._asdict()
        broken = [f"{k} {figures[k]:.1e}" for k, bound in bounds.items() if not figures[k] <= bound]
        return [f"failed: {self.message}", *broken] if self.end == "failed" else broken


def judge(table: Table, accuracy: float) -> Verdict:
    """Run a scene and judge it."""
    system = ma.compile_system(parse_scene(table))
    run = ma.simulate(system, accuracy=accuracy, certificate=False)
    end = "completed"
    if run.status != "completed":
        end = next((key for key, text in REASONS.items() if text in run.message), "failed")
    kinetic = run.kinetic_energy
    works = [np.ptp(work) for work in (run.potential_energy, *run.effect_works.values())]
    size = max(float(np.max(kinetic)), *map(float, works), 1e-3)
    losses = [e["energy_loss"] for e in switches(run)]
    passive = sum(
        (run.effect_works[name] for name in run.effect_works if name in PASSIVE), 0.0 * kinetic
    )
    driven = bool(np.max(np.abs(run.work - passive)) > 1e-12 * size)
    own = run.energy - (run.work - passive)  # as if nothing did work from outside
    weight = 9.81 * sum(body.mass for body in system.scene.all_objects.values())
    has_places = not all(joint.located for joint in system.model.timed_joints)
    closing = len(losses) * weight * LARGEST_GAP * has_places
    return Verdict(
        end,
        run.message,
        len(losses),
        max(-min(losses, default=0.0), 0.0) / size,
        driven,
        max(float(np.max(np.diff(own), initial=0.0)), 0.0) / size,
        float(np.max(np.abs(run.energy_balance))) / size,
        max(abs(float(run.energy_balance[-1])) - closing, 0.0) / size,
        float(np.max(run.position_drift)),
        momentum_change(system, run) if table["name"].split()[0] in FLYING else 0.0,
    )


PASSIVE = ("impacts", "joint_damping", "contact_friction")
"""Works of what can only take energy."""


def momentum_change(system: ma.System, run: ma.Trajectory) -> float:
    """Largest change of linear and angular momentum about the origin, each by its largest part."""
    samples = len(run)
    linear, angular = np.zeros((samples, 3)), np.zeros((samples, 3))
    size = np.zeros((samples, 2))
    parts = []
    for name, body in system.scene.all_objects.items():
        motion = run.objects[name]
        R = Rotation.from_quat(motion.quaternion_xyzw).as_matrix()
        p = body.mass * motion.twist[:, :3]
        spin = np.einsum("kij,jl,kml,km->ki", R, body.inertia_matrix(), R, motion.twist[:, 3:])
        parts.append((p, np.cross(motion.position, p) + spin))
    for name, robot in system.arms.items():
        if not robot.floats:
            continue
        model, data = robot.model, robot.model.createData()
        base = run.bases[name]
        rows = []
        for k in range(samples):
            R = Rotation.from_quat(base.quaternion_xyzw[k]).as_matrix()
            q = np.concatenate(
                [base.position[k], base.quaternion_xyzw[k], run.joint_positions[name][k]]
            )
            # the base's joints: a translation along world axes, and a ball in its own
            rates = run.joint_velocities[name][k]
            v = np.concatenate([base.twist[k, :3], R.T @ base.twist[k, 3:], rates])
            h = pin.computeCentroidalMomentum(model, data, q, v)
            rows.append((h.linear, h.angular + np.cross(data.com[0], h.linear)))
        parts.append((np.array([p for p, _ in rows]), np.array([L for _, L in rows])))
    for p, L in parts:
        linear, angular = linear + p, angular + L
        size += np.column_stack([np.linalg.norm(p, axis=1), np.linalg.norm(L, axis=1)])
    changes = [np.max(np.abs(part - part[0])) for part in (linear, angular)]
    return float(
        max(change / max(np.max(s), 1e-9) for change, s in zip(changes, size.T, strict=True))
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--family", choices=list(FAMILIES), action="append", help="all if none")
    parser.add_argument("--number", type=int, default=100, help="scenes of each family")
    parser.add_argument("--seed", type=int, default=0, help="of the first")
    parser.add_argument("--accuracy", type=float, default=1e-4)
    parser.add_argument("--limit", type=int, default=300, help="of a run [s of CPU time]")
    options = parser.parse_args()
    faults = 0
    for family in options.family or FAMILIES:
        ends: Counter[str] = Counter()
        worst: dict[str, tuple[float, int]] = {}
        switched = 0
        for seed in range(options.seed, options.seed + options.number):
            began = time.process_time()
            signal.setitimer(signal.ITIMER_PROF, options.limit)
            try:
                verdict = judge(draw(family, seed), options.accuracy)
            except Exception as error:
                ends[type(error).__name__] += 1
                faults += 1
                print(family, seed, type(error).__name__, str(error)[:300], flush=True)
                continue
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0.0)
            ends[verdict.end] += 1
            switched += verdict.switches
            took, wrong = time.process_time() - began, verdict.faults(options.accuracy)
            faults += bool(wrong)
            if wrong or took > SLOW:
                words = "; ".join(wrong) or verdict.message
                print(family, seed, verdict.end, f"{took:.1f} s", words[:300], flush=True)
            figures = verdict._asdict()
            for key in ("gained", "risen", "unbalanced", "left", "gap", "momentum"):
                if figures[key] > worst.get(key, (-1.0, 0))[0]:
                    worst[key] = figures[key], seed
        shown = ", ".join(f"{key} {value:.1e} ({seed})" for key, (value, seed) in worst.items())
        print(f"{family}: {dict(ends)}, {switched} switches; largest: {shown}", flush=True)
    print("nothing is wrong" if not faults else f"{faults} runs are wrong")
    return int(faults > 0)


def too_long(_number: int, _frame: Any) -> None:
    raise TimeoutError("took longer than --limit")


if __name__ == "__main__":
    signal.signal(signal.SIGPROF, too_long)
    sys.exit(main())
