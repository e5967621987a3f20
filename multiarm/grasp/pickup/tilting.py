r"""Equilibrium of a body that hands and the floor push, without friction.

At a pose X of the body in the world, hands push with their contacts, and the floor with contacts at
vertices of the body whose normals point up, :math:`e = R^T e_z` in the body's frame.  The contacts
carry the weight G when

.. math::
    W(X)\, \lambda = G \begin{bmatrix} R^T e_z \\ c \times R^T e_z \end{bmatrix},
    \qquad \lambda \ge f G ,

with the centre of mass c.  Where in addition ``rank W = 6`` and every force is positive, the weight
presses the body into its contacts: whichever way it moved first, some contacts would do work, or
its weight would.  So the hands and the floor, as a third hand, hold it.

**What pushes anywhere on some faces can do.**  The wrench of a push is affine in its place on a
plane face, so pushes at the corners of the parts that can be reached generate the wrenches of all.
If these, with the floor at two vertices, do not carry the weight, nothing tilts the body about the
edge between them; the twist that proves it (:mod:`multiarm.grasp.forces.force_distribution`) is a
motion of the body on which no push does work, and which lifts the weight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.forces.force_distribution import ForceDistribution, distribute_forces
from multiarm.programs import linear_program

UP = np.array([0.0, 0.0, 1.0])


def floor_contacts(body: Polyhedron, pose: np.ndarray, vertices: Sequence[int]) -> Contacts:
    """Contacts of the floor with vertices of a body at a pose (4, 4), in the body's frame."""
    up = pose[:3, :3].T @ UP
    names = [f"the floor at corner {v}" for v in vertices]
    return Contacts.along(body.vertices[list(vertices)], [up] * len(vertices), names)


def weight_load(body: Polyhedron, pose: np.ndarray) -> np.ndarray:
    """The wrench (6,) that carries a body of the weight 1 at a pose (4, 4), in its frame."""
    up = pose[:3, :3].T @ UP
    return np.concatenate([up, np.cross(body.centre, up)])


def carried(
    body: Polyhedron, pose: np.ndarray, contacts: Contacts, least: float
) -> ForceDistribution:
    """Forces of least norm, over the weight, with which contacts carry a body at a pose (4, 4)."""
    load = weight_load(body, pose)
    return distribute_forces(contacts, load, minimum=least, objective="norm")


def weakest_force(body: Polyhedron, pose: np.ndarray, contacts: Contacts) -> float:
    """The largest f with forces of at least f that carry a body, over the weight.

    Negative where contacts would have to pull; minus infinity where no forces do.
    """
    W = contacts.wrenches
    rows = np.column_stack([W, W.sum(axis=1)])  # forces are f more than the variables
    cost = np.append(np.zeros(len(contacts)), -1.0)
    solution = linear_program(cost, equal=(rows, weight_load(body, pose)), signed=1)
    return -np.inf if solution.x is None else float(solution.x[-1])


def all_pushes(body: Polyhedron, parts: Mapping[int, np.ndarray]) -> Contacts:
    """Contacts at all corners of parts of faces, one at least, by their numbers."""
    points = [corner for part in parts.values() for corner in part]
    normals = [-body.normals[k] for k, part in parts.items() for _ in part]
    return Contacts.along(points, normals)
