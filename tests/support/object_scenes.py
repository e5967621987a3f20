"""Scenes of several objects whose motion is known: pendulums, hinges, slides, friction, impacts.

Every scene is a plain table, as a file has it; no robot takes part.
"""

from __future__ import annotations

from typing import Any

import numpy as np

DOWN = [0.0, 0.0, -9.81]
GRAVITY = 9.81
Y, Z = [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]


ASIDE = {"aside": {"robot": "ur5", "base": {"xyz": [0.0, 5.0, 0.0]}, "tips": {"hand": "tool0"}}}
"""A robot that holds nothing: scenes without joints need one."""


def objects_scene(
    objects: dict[str, dict[str, Any]], joints: list[dict[str, Any]], **more: Any
) -> dict[str, Any]:
    """A scene of these objects without gravity, if none is written."""
    return {"name": "objects", "gravity": None, "objects": objects, "joints": joints, **more}


def body(mass: float, inertia: list[float], xyz: Any, **more: Any) -> dict[str, Any]:
    """An object; ``rpy`` and ``twist`` may be written."""
    pose = {"xyz": [float(x) for x in xyz], "rpy": list(more.pop("rpy", (0.0, 0.0, 0.0)))}
    return {"mass": mass, "inertia": inertia, "pose": pose, **more}


# Of a double pendulum: masses [kg], moments about y [kg m^2], from hinge to centre [m], and from
# hinge to hinge [m].
PENDULUM = {"m": (1.5, 0.8), "I": (0.03, 0.02), "to_centre": (0.3, 0.25), "length": 0.55}


def double_pendulum(angles: list[float], rates: list[float]) -> dict[str, Any]:
    """Two objects that hang from the world by hinges about y, turned about y from hanging."""
    (m, I, a), L = (PENDULUM[key] for key in ("m", "I", "to_centre")), PENDULUM["length"]
    along = [np.array([np.sin(angle), 0.0, np.cos(angle)]) for angle in angles]
    across = [np.array([np.cos(angle), 0.0, -np.sin(angle)]) for angle in angles]
    centres = [-a[0] * along[0], -L * along[0] - a[1] * along[1]]
    velocities = [
        -a[0] * rates[0] * across[0],
        -L * rates[0] * across[0] - a[1] * rates[1] * across[1],
    ]
    objects = {
        name: body(
            m[k], [0.5 * I[k], I[k], 0.7 * I[k]], centres[k], rpy=[0.0, angles[k], 0.0],
            twist=[*velocities[k].tolist(), 0.0, rates[k], 0.0],
        )
        for k, name in enumerate(("upper", "lower"))
    }  # fmt: skip
    hinge = {"kind": "revolute", "axis": Y}
    joints = [
        {"between": ["upper", "world"], "name": "pin", **hinge, "at": {},
         "at_first": {"xyz": [0.0, 0.0, a[0]]}},
        {"between": ["lower", "upper"], "name": "elbow", **hinge,
         "at": {"xyz": [0.0, 0.0, a[0] - L]}, "at_first": {"xyz": [0.0, 0.0, a[1]]}},
    ]  # fmt: skip
    return objects_scene(objects, joints, gravity=DOWN)


def pendulum_accelerations(angles: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Of the angles of :func:`double_pendulum`, by Lagrange's equations (any textbook)."""
    (m, I, a), L = (PENDULUM[key] for key in ("m", "I", "to_centre")), PENDULUM["length"]
    coupling = m[1] * L * a[1]
    c, s = np.cos(angles[0] - angles[1]), np.sin(angles[0] - angles[1])
    M = np.array([
        [I[0] + m[0] * a[0] ** 2 + m[1] * L**2, coupling * c],
        [coupling * c, I[1] + m[1] * a[1] ** 2],
    ])  # fmt: skip
    f = np.array([
        -coupling * s * rates[1] ** 2 - (m[0] * a[0] + m[1] * L) * GRAVITY * np.sin(angles[0]),
        coupling * s * rates[0] ** 2 - m[1] * a[1] * GRAVITY * np.sin(angles[1]),
    ])  # fmt: skip
    return np.linalg.solve(M, f)


# Of each of two like plates: mass [kg], moment about z [kg m^2], from hinge to centre [m].
PLATE = {"m": 1.2, "I": 0.05, "to_centre": 0.3}


def hinged_plates(angle: float, rate: float) -> dict[str, Any]:
    """Two plates on a hinge along z that beat like wings, their common centre at rest."""
    m, I, a = PLATE.values()
    objects = {
        name: body(
            m, [0.6 * I, 0.7 * I, I], [0.0, side * a * np.sin(angle), 0.0],
            rpy=[0.0, 0.0, side * angle],
            twist=[0.0, side * a * np.cos(angle) * rate, 0.0, 0.0, 0.0, side * rate],
        )
        for name, side in (("left", 1.0), ("right", -1.0))
    }  # fmt: skip
    at = {"xyz": [-a, 0.0, 0.0]}
    hinge = {"kind": "revolute", "axis": Z, "at": at, "at_first": at, "name": "hinge"}
    return objects_scene(objects, [{"between": ["left", "right"], **hinge}])


def wing_rate(angle: float, start: float, rate: float) -> float:
    """Rate of the angle of :func:`hinged_plates`; ``(I + m a^2 cos^2) rate^2`` is constant."""
    m, I, a = PLATE.values()
    inertia = [I + m * a**2 * np.cos(x) ** 2 for x in (start, angle)]
    return rate * float(np.sqrt(inertia[0] / inertia[1]))


# Masses [kg] and moments about z [kg m^2] of a peg and its socket.
PEG = {"m": (0.7, 2.1), "I": (0.02, 0.09)}


def peg_in_socket(kind: str, out: float, speed: float, spin: float) -> dict[str, Any]:
    """A peg that slides along x in a socket, both turning about z, their common centre at rest.

    out, speed : how far the peg's centre is from the socket's [m], and its rate [m/s]
    spin : angular velocity about z [rad/s]
    """
    (m, I), joint = PEG.values(), {"kind": kind, "axis": [1.0, 0.0, 0.0], "at": {}, "at_first": {}}
    shares = {"peg": m[1] / sum(m), "socket": -m[0] / sum(m)}
    objects = {
        name: body(
            m[k], [0.4 * I[k], 0.9 * I[k], I[k]], [share * out, 0.0, 0.0],
            twist=[share * speed, share * out * spin, 0.0, 0.0, 0.0, spin],
        )
        for k, (name, share) in enumerate(shares.items())
    }  # fmt: skip
    return objects_scene(objects, [{"between": ["peg", "socket"], "name": "slide", **joint}])


def peg_acceleration(out: float, spin: float, start: float) -> tuple[float, float]:
    """Second derivative of the distance, and spin there, where it was ``spin`` at ``start``.

    The spin follows from the moment of momentum.
    """
    m, I = PEG.values()
    reduced = m[0] * m[1] / sum(m)
    now = spin * (sum(I) + reduced * start**2) / (sum(I) + reduced * out**2)
    return out * now**2, now


SLED = {"m": (1.0, 3.0), "mu": 0.3}  # load and sled


def load_on_sled(speed: float, rail: bool = True) -> dict[str, Any]:
    """A flat load that slides along x on a sled, which a rail along x carries.

    Without the rail both are free, and nothing presses them together.
    """
    m, mu = SLED.values()
    flat = {"load": 0.05, "sled": 0.1}
    moments = [0.02, 0.02, 0.03]
    objects = {
        "load": body(
            m[0], moments, [0.0, 0.0, 0.5 * (flat["sled"] + flat["load"])],
            twist=[speed, 0.0, 0.0, 0.0, 0.0, 0.0],
        ),
        "sled": body(m[1], moments, [0.0, 0.0, 0.0]),
    }  # fmt: skip
    feet = [(0.2, 0.0), (-0.1, 0.15), (-0.1, -0.15)]
    joints = [
        {
            "between": ["load", "sled"], "name": f"foot_{k}", "kind": "point_on_plane", "mu": mu,
            "at": {"xyz": [0.0, 0.0, 0.5 * flat["sled"]]},
            "at_first": {"xyz": [*foot, -0.5 * flat["load"]]},
        }
        for k, foot in enumerate(feet)
    ]  # fmt: skip
    if rail:
        slide = {"kind": "prismatic", "axis": [1.0, 0.0, 0.0], "at": {}, "at_first": {}}
        joints.append({"between": ["sled", "world"], "name": "rail", **slide})
    effects = {"unilateral_contacts": {"start": "as_written"}}
    return objects_scene(objects, joints, gravity=DOWN, effects=effects)


# Of a ball and a plate that it hits: masses [kg], radius, how far off the centre [m], and the
# plate's moment [kg m^2] about the axis across.
HIT = {"m": (0.4, 2.0), "radius": 0.05, "off": 0.2, "moment": 0.06}


def ball_at_plate(speed: float, restitution: float, height: float = 0.1) -> dict[str, Any]:
    """A ball that flies down at a free plate at rest, above a place off its centre along x."""
    m, radius, off, moment = HIT.values()
    half = 0.01
    objects = {
        "ball": body(
            m[0], [4e-4] * 3, [off, 0.0, half + radius + height],
            twist=[0.0, 0.0, -speed, 0.0, 0.0, 0.0],
        ),
        "plate": body(m[1], [0.05, moment, 0.1], [0.0, 0.0, 0.0]),
    }  # fmt: skip
    contact = {
        "between": ["ball", "plate"], "name": "hit", "kind": "point_on_plane",
        "tip_radius": radius, "at": {"xyz": [0.0, 0.0, half]}, "at_first": {},
    }  # fmt: skip
    effects = {"unilateral_contacts": {"start": "as_written", "restitution": restitution}}
    return objects_scene(objects, [contact], effects=effects)


def hit_impulse(speed: float, restitution: float) -> float:
    """Impulse of :func:`ball_at_plate` [N s], by Newton's law of restitution."""
    m, _, off, moment = HIT.values()
    return (1.0 + restitution) * speed / (1.0 / m[0] + 1.0 / m[1] + off**2 / moment)
