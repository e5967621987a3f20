"""Linkages of the IFToMM library of multibody benchmarks as robots with loops of their own links.

Every linkage is one tree on a fixed base whose loops are closed by hinges ``between`` two links.  A
scene needs an object: a block that the world holds.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from multiarm.problems.building import DOWN_IN_PLANE, rod_inertia
from multiarm.problems.linkages import BRICARD_BASES, Body, OneFreedom, bricard_poses, planar

ROBOT = "linkage"
Z = (0.0, 0.0, 1.0)


class Part(NamedTuple):
    """A link and the joint that moves it about or along its z axis.

    place : 3 floats, of the joint in the parent [m]; rpy : 3 floats, its turn there [rad]
    mass : [kg]; centre : 3 floats [m]; moments : 3 floats, about the centre [kg m^2]
    """

    name: str
    parent: str
    place: Any
    mass: float
    centre: Any
    moments: Any
    rpy: Any = (0.0, 0.0, 0.0)
    slides: bool = False


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def joint_of(link: str) -> str:
    """Name of the joint that moves a link."""
    return f"{link}_joint"


def link_of(joint: str) -> str:
    """Name of the link that a joint moves."""
    return joint.removesuffix("_joint")


def _text(part: Part) -> str:
    moments = " ".join(
        f"{axes}='{float(moment)!r}'"
        for axes, moment in zip(("ixx", "iyy", "izz"), part.moments, strict=True)
    )
    kind = "prismatic" if part.slides else "continuous"
    limit = "<limit lower='-9' upper='9' effort='1e6' velocity='1e6'/>"
    return (
        f"<link name='{part.name}'><inertial><origin xyz='{_numbers(part.centre)}'/>"
        f"<mass value='{float(part.mass)!r}'/><inertia {moments} ixy='0' ixz='0' iyz='0'/>"
        f"</inertial></link><joint name='{joint_of(part.name)}' type='{kind}'>"
        f"<parent link='{part.parent}'/><child link='{part.name}'/>"
        f"<origin xyz='{_numbers(part.place)}' rpy='{_numbers(part.rpy)}'/>"
        f"<axis xyz='{_numbers(Z)}'/>{limit}</joint>\n"
    )


def linkage_scene(
    path: Path,
    parts: list[Part],
    loops: list[tuple[str, dict[str, Any], str, dict[str, Any]]],
    posture: dict[str, float],
    velocity: dict[str, float],
    **more: Any,
) -> dict[str, Any]:
    """The scene of a linkage on the link ``ground``; its URDF is written to ``path``.

    ``loops`` are hinges: a link, the hinge's pose there, another link, and the pose there.
    ``posture`` and ``velocity`` are of the joints, by the link that they move.
    """
    path.write_text(
        f"<robot name='{ROBOT}'><link name='ground'/>\n{''.join(map(_text, parts))}</robot>\n"
    )
    joints = [
        {
            "between": [f"{ROBOT}/{first}", f"{ROBOT}/{second}"], "name": f"loop_{k}",
            "kind": "revolute", "at_first": on_first, "at": at,
        }
        for k, (first, on_first, second, at) in enumerate(loops)
    ]  # fmt: skip
    joints.append({"between": ["block", "world"], "kind": "weld", "name": "aside", "at": {}})
    return {
        "name": "linkage",
        "gravity": DOWN_IN_PLANE,
        "objects": {"block": {"mass": 1.0, "inertia": [0.01, 0.01, 0.01]}},
        "robots": {
            ROBOT: {
                "urdf": str(path),
                "tips": {part.name: part.name for part in parts},
                "posture": {joint_of(link): value for link, value in posture.items()},
                "velocity": {joint_of(link): value for link, value in velocity.items()},
            }
        },
        "joints": joints,
        **more,
    }


def _rod(name: str, parent: str, place: Any, length: float = 1.0, mass: float = 1.0) -> Part:
    """A thin rod along x from its hinge."""
    return Part(name, parent, place, mass, (0.5 * length, 0, 0), rod_inertia(mass, length))


# --- N four-bar linkages -------------------------------------------------------------------------


def four_bars_scene(path: Path, loops: int, angle: float, rate: float) -> dict[str, Any]:
    """So many parallelograms side by side: parallel cranks of 1 m, 1 m apart (benchmark A02).

    The tip of a crank inside carries one coupler and is held by another.
    """
    parts = [_rod(f"crank_{k}", "ground", (k, 0, 0)) for k in range(loops + 1)]
    parts += [_rod(f"coupler_{k}", f"crank_{k}", (1, 0, 0)) for k in range(loops)]
    tip = {"xyz": [1.0, 0.0, 0.0]}
    hinges = [(f"coupler_{k}", tip, f"crank_{k + 1}", tip) for k in range(loops)]
    turns = {part.name: angle if part.parent == "ground" else -angle for part in parts}
    rates = {part.name: rate if part.parent == "ground" else -rate for part in parts}
    return linkage_scene(path, parts, hinges, turns, rates)


# --- slider and crank ----------------------------------------------------------------------------

CRANK, CONNECTING_ROD = 0.4, 1.1  # [m]
SLIDER = Body(2.0, np.diag([0.02, 0.02, 0.02]))
_SLIDING = (0.0, 0.5 * np.pi, 0.0)  # z of the joint along x of the ground


def _along_rod(angle: complex) -> tuple[complex, complex]:
    """Direction of the connecting rod, from the crank to the slider, at an angle of the crank."""
    sine = -CRANK / CONNECTING_ROD * np.sin(angle)
    return np.sqrt(1.0 - sine * sine), sine


def slider_poses(angle: complex):
    """Poses of crank, connecting rod and slider."""
    c, s = np.cos(angle), np.sin(angle)
    u, v = _along_rod(angle)
    half = 0.5 * CONNECTING_ROD
    return (
        planar(0.5 * CRANK * c, 0.5 * CRANK * s, c, s),
        planar(CRANK * c + half * u, CRANK * s + half * v, u, v),
        planar(CRANK * c + CONNECTING_ROD * u, 0.0 * s, 1.0 + 0.0 * c, 0.0 * s),
    )


def slider_motion() -> OneFreedom:
    """The coordinate is the angle of the crank."""
    rods = [
        Body(m, np.diag(rod_inertia(m, length)))
        for m, length in ((1.0, CRANK), (1.5, CONNECTING_ROD))
    ]
    span = (0.0, 2.0 * np.pi)
    gravity = np.array(DOWN_IN_PLANE)
    return OneFreedom((*rods, SLIDER), slider_poses, gravity, span, periodic=True)


def slider_crank_scene(path: Path, angle: float, rate: float) -> dict[str, Any]:
    """A crank, a connecting rod and a slider along x, through both dead centres."""
    step = 1e-40
    u, v = _along_rod(complex(angle, step))
    turn, turning = float(np.arctan2(v.real, u.real)), float(v.imag / u.real / step)
    x = slider_poses(complex(angle, step))[2][0][0]
    moments = np.diag(SLIDER.inertia)
    parts = [
        _rod("crank", "ground", (0, 0, 0), CRANK),
        _rod("rod", "crank", (CRANK, 0, 0), CONNECTING_ROD, 1.5),
        Part("slider", "ground", (0, 0, 0), SLIDER.mass, (0, 0, 0), moments, _SLIDING, True),
    ]
    # the axis of the hinge is z of the ground, -x of the slider
    on_rod, on_slider = {"xyz": [CONNECTING_ROD, 0.0, 0.0]}, {"rpy": [0.0, -0.5 * np.pi, 0.0]}
    hinge = ("rod", on_rod, "slider", on_slider)
    posture = {"crank": angle, "rod": turn - angle, "slider": float(x.real)}
    velocity = {
        "crank": rate, "rod": (turning - 1.0) * rate, "slider": float(x.imag / step * rate),
    }  # fmt: skip
    return linkage_scene(path, parts, [hinge], posture, velocity)


# --- Bricard's loop ------------------------------------------------------------------------------


def bricard_robot_scene(path: Path) -> dict[str, Any]:
    """Five rods of 1 m and 1 kg on six perpendicular hinges, at rest (benchmark A04)."""
    bar = rod_inertia(1.0, 1.0, 0.1)

    def rod(name: str, parent: str, place: Any, R: Any = None, way: float = 1.0) -> Part:
        turn = (0.0, 0.0, 0.0) if R is None else Rotation.from_matrix(R).as_euler("xyz")
        return Part(name, parent, place, 1.0, (0.5 * way, 0, 0), bar, turn)

    # y of the first rods, along z of the joints that their second rods turn about
    to_y = Rotation.from_euler("x", -90.0, degrees=True).as_matrix()
    parts = [
        rod("rod_1", "ground", (0, 0, 0), BRICARD_BASES[0]),
        rod("rod_2", "rod_1", (1, 0, 0), to_y),
        rod("rod_5", "ground", (0, 0, 1), BRICARD_BASES[1]),
        rod("rod_4", "rod_5", (1, 0, 0), to_y),
        rod("rod_3", "rod_2", (1, 0, 0), to_y.T, way=-1.0),
    ]
    R_2, R_3 = (bricard_poses(0j)[k][1].real for k in (1, 2))
    relative = R_2.T @ R_3
    turn = float(np.arctan2(relative[1, 0], relative[0, 0]))
    posture = {"rod_2": 0.5 * np.pi, "rod_4": -0.5 * np.pi, "rod_3": turn}
    quarter = 0.5 * np.pi
    on_4 = {"xyz": [1.0, 0.0, 0.0], "rpy": [quarter, 0.0, 0.0]}
    closing = ("rod_4", on_4, "rod_3", {"xyz": [-1.0, 0.0, 0.0], "rpy": [-quarter, 0.0, 0.0]})
    return linkage_scene(path, parts, [closing], posture, {})


# --- Andrews' squeezing mechanism ----------------------------------------------------------------


class Squeezer(NamedTuple):
    """Benchmark A03 as the Test Set for Initial Value Problem Solvers has it (Bari, 1998).

    Angles are those of the joints of ``links``, in this order; all places in metres.
    """

    links: tuple[str, ...] = ("K1", "K2", "K3", "K4", "K5", "K6", "K7")
    start: tuple[float, ...] = (
        -0.0617138900142764496, 0.0, 0.455279819163070380, 0.222668390165885885,
        0.487364979543842550, -0.222668390165885885, 1.23054744454982119,
    )  # fmt: skip
    drive: float = 0.033  # [N m], on K1
    accelerations: tuple[float, ...] = (
        14222.4439199541138706, -10666.8329399655854029, 0.0, 0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip
    duration: float = 0.03
    end: tuple[float, ...] = (
        15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948,
        0.5244099658805304, 0.5347301163226948, 1.048080741042263,
    )  # fmt: skip
    A: tuple[float, float] = (-0.06934, -0.00227)
    B: tuple[float, float] = (-0.03635, 0.03273)
    C: tuple[float, float] = (0.014, 0.072)
    on_K3: tuple[float, float] = (0.02, -0.018)  # of the spring
    stiffness: float = 4530.0  # [N/m]
    rest: float = 0.07785  # [m]

    def torques(self, gamma: float) -> dict[str, float]:
        """Of the drive on K1 and of the spring on K3, at the angle of K3."""
        c, s = np.cos(gamma), np.sin(gamma)
        arm = np.array([[c, -s], [s, c]]) @ self.on_K3
        along = arm + self.B - np.array(self.C)
        length = float(np.linalg.norm(along))
        force = -self.stiffness * (length - self.rest) / length * along
        return {"K1": self.drive, "K3": float(arm[0] * force[1] - arm[1] * force[0])}


def squeezer_scene(path: Path) -> dict[str, Any]:
    """Seven bodies and three hinges at the point where K2, K3, K4 and K6 meet."""
    squeezer = Squeezer()

    def part(name: str, parent: str, place: Any, mass: float, centre: Any, moment: float) -> Part:
        return Part(name, parent, (*place, 0.0), mass, (*centre, 0.0), (moment,) * 3)

    rr, d, e, zt, zf, u, ss = 0.007, 0.028, 0.02, 0.04, 0.02, 0.04, 0.035
    parts = [
        part("K1", "ground", (0, 0), 0.04325, (0.00092, 0), 2.194e-6),
        part("K2", "K1", (rr, 0), 0.00365, (-0.0115, 0), 4.410e-7),
        part("K3", "ground", squeezer.B, 0.02373, (0.01043, -0.01874), 5.255e-6),
        part("K5", "ground", squeezer.A, 0.07050, (0.02308, 0.00916), 1.169e-5),
        part("K4", "K5", (zt, 0), 0.00706, (0, -(e - 0.01421)), 5.667e-7),
        part("K7", "ground", squeezer.A, 0.05498, (-0.00449, -0.01228), 1.912e-5),
        part("K6", "K7", (0, -u), 0.00706, (zf - 0.01421, 0), 5.667e-7),
    ]
    at = {"xyz": [-d, 0.0, 0.0]}
    ends = {"K3": (0.0, -ss), "K4": (0.0, -e), "K6": (zf, 0.0)}
    loops = [(name, {"xyz": [*end, 0.0]}, "K2", at) for name, end in ends.items()]
    posture = dict(zip(squeezer.links, squeezer.start, strict=True))
    acting = squeezer.torques(squeezer.start[2])
    torques = {ROBOT: {joint_of(link): value for link, value in acting.items()}}
    control = {"kind": "constant", "torques": torques}
    return linkage_scene(path, parts, loops, posture, {}, gravity=None, control=control)
