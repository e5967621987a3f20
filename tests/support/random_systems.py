"""Random constrained systems as matrices, drawn from geometry.

Contacts at faces of a box, arms of slides and hinges with random inertias.  Each family aims at one
way of being hard; all draw masses, sizes and loads over many decades.  ``draw(family, seed)`` gives
the same system again, whenever it is called.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag


@dataclass
class System:
    """Matrices of :func:`multiarm.dynamics.solver.dense.solve_dense`, and the units of its
    coordinates.

    reaction_o, reaction : lists like W_o, W
        Where contact forces act: along the constraints without friction.
    reach : list of (n_i,)
        What each joint may move at the contacts by a unit rate: 1 of slides, metres of hinges.
    lever : float
        Largest moment of a unit push on the object [m].
    """

    M_o: np.ndarray
    f_o: np.ndarray
    M: list[np.ndarray]
    f_j: list[np.ndarray]
    W_o: list[np.ndarray]
    W: list[np.ndarray]
    c: list[np.ndarray]
    reaction_o: list[np.ndarray]
    reaction: list[np.ndarray]
    reach: list[np.ndarray]
    lever: float

    @property
    def sliding(self) -> bool:
        """Whether forces act along other directions than the constraints."""
        return self.reaction_o is not self.W_o


# --- geometry ------------------------------------------------------------------------------------


@dataclass
class Box:
    """A turned box of random size and mass."""

    size: np.ndarray
    mass: float
    turn: np.ndarray

    @property
    def lever(self) -> float:
        return float(np.linalg.norm(self.size)) / 2.0

    def inertia(self) -> np.ndarray:
        moments = self.mass / 12.0 * (np.sum(self.size**2) - self.size**2)
        return block_diag(self.mass * np.eye(3), self.turn @ np.diag(moments) @ self.turn.T)

    def contact(self, rng, axis=None) -> tuple[np.ndarray, np.ndarray]:
        """Point on a face about the centre, and the normal into the box."""
        axis = rng.integers(3) if axis is None else axis
        side = rng.choice([-1.0, 1.0])
        point = rng.uniform(-0.5, 0.5, 3) * self.size
        point[axis] = 0.5 * side * self.size[axis]
        return self.turn @ point, -side * self.turn[:, axis]


def turned(rng) -> np.ndarray:
    Q, R = np.linalg.qr(rng.standard_normal((3, 3)))
    Q *= np.sign(np.diag(R))
    return Q if np.linalg.det(Q) > 0.0 else -Q


def unit(rng) -> np.ndarray:
    x = rng.standard_normal(3)
    return x / np.linalg.norm(x)


def decades(rng, low: float, high: float) -> float:
    return float(10.0 ** rng.uniform(low, high))


def wrench(point, normal) -> np.ndarray:
    return np.concatenate([normal, np.cross(point, normal)])


def draw_box(rng) -> Box:
    return Box(decades(rng, -3, 1) * rng.uniform(0.3, 1.0, 3), decades(rng, -6, 4), turned(rng))


def joint(rng, box: Box, contact=None, tilt: float = 0.0) -> tuple[np.ndarray, float]:
    """Twist of a joint at the object's centre, and its reach.

    With a contact, one that does not move along its normal: a slide along the face, or a hinge
    whose axis meets the normal's line; tilted by an angle.
    """
    if rng.random() < 0.5:  # slide
        axis = unit(rng)
        if contact is not None:
            point, normal = contact
            axis = np.cross(normal, axis)
            axis = axis / np.linalg.norm(axis) + tilt * normal
        return np.concatenate([axis, np.zeros(3)]), 1.0
    reach = box.lever * decades(rng, 0, 1)
    axis, at = unit(rng), reach * unit(rng)
    if contact is not None:
        point, normal = contact
        beside = rng.choice([0.0, 1.0]) * rng.uniform(-1, 1)  # or through the point itself
        at = point + reach * (beside * normal + tilt * np.cross(normal, axis))
    return np.concatenate([np.cross(at, axis), axis]), reach


def inertia(rng, reach: np.ndarray, mass: float, light: float = 0.0) -> np.ndarray:
    """Inertia matrix of joints of these reaches; some of their links lighter by up to ``light``."""
    n = len(reach)
    Q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    links = reach * 10.0 ** (0.5 * light * (rng.random(n) < 0.4) * rng.random(n))
    M = mass * links[:, None] * (Q * 10.0 ** rng.uniform(-1, 1, n)) @ Q.T * links
    return 0.5 * (M + M.T)


def assemble(rng, box: Box, arms: list, light: float = 0.0, friction: float = 0.0) -> System:
    """A system of arms given as (contacts, joints); loads, inertias and ``c`` are drawn.

    The object, the joints and the accelerations that the constraints ask for may rest.
    """
    weight = box.mass * 9.81
    lift = rng.choice([0.0, 1.0]) * weight * np.concatenate([unit(rng), box.lever * unit(rng)])
    torque = decades(rng, -2, 3) * rng.choice([0.0, 1.0])
    moving = rng.choice([0.0, 1.0]) * decades(rng, -1, 2)
    accelerated = moving * np.concatenate([unit(rng), unit(rng) / box.lever])
    names = ("M", "f_j", "W_o", "W", "c", "reach", "reaction_o", "reaction")
    rows: dict[str, list] = {name: [] for name in names}
    for contacts, joints in arms:
        W_o = np.array([wrench(*contact) for contact in contacts]).T
        J = np.array([twist for twist, _ in joints]).T
        reach = np.array([r for _, r in joints])
        mass = decades(rng, -3, 3)
        M = inertia(rng, reach, mass, light)
        W = -J.T @ W_o
        rows["M"].append(M)
        rows["W_o"].append(W_o)
        rows["W"].append(W)
        rows["reach"].append(reach)
        rows["f_j"].append(reach * (torque + 9.81 * mass) * rng.standard_normal(len(reach)))
        joints_accelerated = moving * rng.standard_normal(len(reach)) / reach
        rows["c"].append(W_o.T @ accelerated + W.T @ joints_accelerated)
        drag = np.array(
            [wrench(p, np.cross(n, friction * rng.uniform() * unit(rng))) for p, n in contacts]
        ).T
        rows["reaction_o"].append(W_o + drag)
        rows["reaction"].append(W - J.T @ drag)
    if not friction:
        rows |= {"reaction_o": rows["W_o"], "reaction": rows["W"]}
    lever = max(np.max(np.linalg.norm(W_o[3:], axis=0)) for W_o in rows["W_o"]) or box.lever
    return System(M_o=box.inertia(), f_o=lift, lever=float(lever), **rows)


# --- families ------------------------------------------------------------------------------------


def generic(rng) -> System:
    """Arms of one to eight joints at one to six contacts: none is special."""
    box = draw_box(rng)
    arms = [
        (
            [box.contact(rng) for _ in range(rng.integers(1, 7))],
            [joint(rng, box) for _ in range(rng.integers(1, 9))],
        )
        for _ in range(rng.integers(1, 13))
    ]
    return assemble(rng, box, arms)


def draw_tilt(rng) -> float:
    """Exactly aligned, up to rounding, or nearly so."""
    return float(rng.choice([0.0, 0.0, 1e-15, 1e-12, 1e-10, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3]))


def finger(rng, box: Box, tilt: float, axis=None) -> tuple:
    """An arm of one to three joints that cannot move along its one contact."""
    contact = box.contact(rng, axis)
    joints = [joint(rng, box, contact, tilt) for _ in range(rng.choice([1, 1, 1, 2, 3]))]
    return [contact], joints


def enclosing(rng, box: Box, tilt: float, count: int) -> list:
    """Fingers that cannot move along their contacts: three, two, one, and more."""
    axes = [2, 2, 2, 1, 1, 0, *rng.integers(0, 3, max(0, count - 6))]
    return [finger(rng, box, tilt, axis) for axis in axes[:count]]


def form_closure(rng) -> System:
    """Enclosed by fingers of which none can move along its contact."""
    box = draw_box(rng)
    return assemble(rng, box, enclosing(rng, box, 0.0, rng.integers(6, 13)))


def nearly_aligned(rng) -> System:
    """Some or all fingers can hardly move along their contacts."""
    box = draw_box(rng)
    return assemble(rng, box, enclosing(rng, box, draw_tilt(rng), rng.integers(1, 10)))


def closure_with_moving_arms(rng) -> System:
    """Form closure by some fingers, other arms are free to move."""
    box = draw_box(rng)
    arms = enclosing(rng, box, 0.0, rng.integers(1, 8))
    for _ in range(rng.integers(1, 5)):
        contacts = [box.contact(rng) for _ in range(rng.integers(1, 4))]
        arms.append((contacts, [joint(rng, box) for _ in range(rng.integers(1, 8))]))
    return assemble(rng, box, [arms[i] for i in rng.permutation(len(arms))])


def partly_immovable(rng) -> System:
    """Arms that move along some of their contacts and not, or hardly, along others."""
    box = draw_box(rng)
    arms = []
    for _ in range(rng.integers(1, 7)):
        contacts = [box.contact(rng) for _ in range(rng.integers(1, 5))]
        fixed = contacts[rng.integers(len(contacts))]
        tilt = draw_tilt(rng)
        arms.append((contacts, [joint(rng, box, fixed, tilt) for _ in range(rng.integers(1, 7))]))
    return assemble(rng, box, arms)


def repeated(rng) -> System:
    """Contacts up to three times, exactly or nearly, in one arm."""
    box, tilt = draw_box(rng), draw_tilt(rng)
    arms = []
    for _ in range(rng.integers(1, 7)):
        contacts = [box.contact(rng) for _ in range(rng.integers(1, 5))]
        for point, normal in list(contacts):
            for _ in range(rng.integers(0, 3)):
                other = normal + tilt * np.cross(normal, unit(rng))
                contacts.append((point + tilt * box.lever * unit(rng), other))
        arms.append((contacts[:8], [joint(rng, box) for _ in range(rng.integers(1, 9))]))
    return assemble(rng, box, arms)


def weld(rng, box: Box) -> list:
    """Six contacts of a rigid grasp at one place of the box."""
    place, _ = box.contact(rng)
    frame, spread = turned(rng), 0.2 * box.lever
    points = [(1, 0, 0), (-1, 1, 0), (-1, -1, 0), (1, 0, 0), (-1, 0, 0), (0, 0, 0)]
    return [
        (place + spread * frame @ point, frame[:, axis])
        for point, axis in zip(points, (2, 2, 2, 1, 1, 0), strict=True)
    ]


def welds(rng) -> System:
    """Rigid grasps, by arms of one to eight joints."""
    box = draw_box(rng)
    arms = [
        (weld(rng, box), [joint(rng, box) for _ in range(rng.integers(1, 9))])
        for _ in range(rng.integers(1, 7))
    ]
    return assemble(rng, box, arms)


def singular_postures(rng) -> System:
    """Arms with joints that move alike, exactly or nearly."""
    box = draw_box(rng)
    arms = []
    for _ in range(rng.integers(1, 7)):
        joints = [joint(rng, box) for _ in range(rng.integers(1, 7))]
        tilt = draw_tilt(rng)
        alike, reach = joints[0]
        other, other_reach = joint(rng, box)
        near = alike / reach + tilt * other / other_reach
        joints.append((near * reach, reach))
        contacts = weld(rng, box)[: rng.integers(1, 7)]
        arms.append((contacts, joints))
    return assemble(rng, box, arms)


def light_links(rng) -> System:
    """Links up to a million times lighter than others of their arm."""
    box = draw_box(rng)
    arms = []
    for _ in range(rng.integers(1, 7)):
        contacts = [box.contact(rng) for _ in range(rng.integers(1, 7))]
        arms.append((contacts, [joint(rng, box) for _ in range(rng.integers(1, 9))]))
    return assemble(rng, box, arms, light=-6.0)


def sliding(rng) -> System:
    """Friction turns the forces away from the normals; some arms cannot move along theirs."""
    box = draw_box(rng)
    arms = enclosing(rng, box, 0.0, rng.integers(1, 5))
    for _ in range(rng.integers(1, 4)):
        joints = [joint(rng, box) for _ in range(rng.integers(3, 8))]
        arms.append(([box.contact(rng) for _ in range(rng.integers(1, 4))], joints))
    return assemble(rng, box, arms, friction=0.3)


FAMILIES: dict[str, Callable] = {
    family.__name__: family
    for family in (
        generic, form_closure, nearly_aligned, closure_with_moving_arms, partly_immovable,
        repeated, welds, singular_postures, light_links, sliding,
    )
}  # fmt: skip


def draw(family: str, seed: int) -> System:
    return FAMILIES[family](np.random.default_rng(seed))
