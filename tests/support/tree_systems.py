"""Systems of one robot that is a random tree with several connections."""

from __future__ import annotations

from pathlib import Path

from mechanics import scene_of
from random_structures import random_tree

import multiarm as ma

ROBOT = "tree"


def tree_system(folder: Path, rng, parents, connections) -> ma.System:
    """A tree on a base somewhere; its start does not close the connections.

    ``connections`` are joints by first and second body: ``object``, ``world``, or a link ``l1``,
    ``l2``, ... of :func:`random_structures.random_tree`.
    """
    (folder / "tree.urdf").write_text(random_tree(rng, parents))
    leaves = [f"l{k + 1}" for k in range(len(parents)) if k not in parents]
    frame = lambda size: {  # noqa: E731
        "xyz": rng.uniform(-size, size, 3).tolist(),
        "rpy": rng.uniform(-1.5, 1.5, 3).tolist(),
    }
    robot = {
        "urdf": str(folder / "tree.urdf"),
        "tips": {leaf: leaf for leaf in leaves},
        "posture": [0.0] * len(parents),
        "base": frame(1.0),
    }
    joints = [
        {"between": [name_of(first), name_of(second)], "at": frame(0.3), **joint}
        for (first, second), joint in connections.items()
    ]
    scene = scene_of({}, joints, robots={ROBOT: robot}, gravity=[1, 2, -9])
    return ma.compile_system(scene, assemble=False)


def name_of(body: str) -> str:
    """The name of a body in the scene."""
    return body if body in ("object", "world") else f"{ROBOT}/{body}"
