"""Compiled robots in one system, by themselves, and what their terms are compared with."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from multiarm.robots.compiled import backend as compiled_backend
from multiarm.robots.compiled.backend import CompiledBackend
from multiarm.robots.compiled.packing import make_tables
from multiarm.robots.compiled.tables import Wanted
from multiarm.robots.robot import Robot, RobotFiles
from multiarm.robots.terms import LinkTerms

GRAVITY = np.array([1.0, -2.0, -9.0])


def arm_of(urdf, tip, base=None, locked=None, rotors=None, name="arm", **more) -> Robot:
    base = np.eye(4) if base is None else base
    files = RobotFiles(Path(urdf), (), base, {"": tip}, locked or {}, **more)
    return Robot(name, files, rotor_inertia=rotors)


def random_base(rng, away=1.0) -> np.ndarray:
    base = np.eye(4)
    base[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    base[:3, 3] = away * rng.uniform(-1, 1, 3)
    return base


class Compiled:
    """Compiled robots in one system, and their state."""

    def __init__(self, structures, links, gravity=GRAVITY) -> None:
        self.structures, places = structures, list(range(len(structures)))
        first = np.cumsum([0] + [tree.dof for tree in structures])
        rows = compiled_backend.body_links(structures, places, links)
        floats = [tree.base_floats for tree in structures]
        self.bases = np.cumsum([0, *floats])[:-1].tolist()
        tables = make_tables(structures, first[:-1].tolist(), rows, gravity, self.bases)
        wanted = Wanted(gravity_torque=True, poses=True, factors=True, inertias=True)
        self.tables = tables._replace(wanted=wanted)
        robots = {str(k): tree for k, tree in enumerate(structures)}
        self.backend = CompiledBackend(self.tables, places, robots, links)
        self.angles, self.rates = np.zeros(first[-1]), np.zeros(first[-1])
        self.bodies = np.full((len(links), 24), np.nan)
        self.base_poses = np.zeros((sum(floats), 7))
        self.backend.bind(self.angles, self.rates, self.base_poses, self.bodies)
        self.parts = [slice(a, b) for a, b in pairwise(first)]

    def draw(self, rng) -> None:
        self.angles[:] = rng.uniform(-3, 3, self.angles.size)
        self.rates[:] = rng.uniform(-3, 3, self.rates.size)
        for tree, part in zip(self.structures, self.parts, strict=True):
            if tree.base_floats:
                self.angles[part][:6] = 0.0
        self.base_poses[:] = rng.normal(size=self.base_poses.shape)
        self.base_poses[:, 3:] /= np.linalg.norm(self.base_poses[:, 3:], axis=1, keepdims=True)

    def state_of(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and pose of the base of robot number k, for a reference."""
        pose = self.base_poses[self.bases[k]] if self.structures[k].base_floats else np.zeros(7)
        return self.angles[self.parts[k]][None], self.rates[self.parts[k]][None], pose[None]

    def terms(self) -> list[LinkTerms]:
        self.backend.update(with_coriolis=True)
        return [self.backend.terms(k) for k in range(len(self.parts))]


def largest_difference(terms: LinkTerms, expected: LinkTerms) -> dict[str, float]:
    """Of each quantity, relative to its largest entry (to 1 where that is smaller)."""
    return {
        name: float(
            np.max(np.abs(value - reference), initial=0.0)
            / max(np.max(np.abs(reference), initial=0.0), 1.0)
        )
        for name, value, reference in zip(LinkTerms._fields, terms, expected, strict=True)
    }
