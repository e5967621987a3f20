r"""Many choices of seven contacts at once: how evenly does each of them balance?

Seven wrenches of rank 6 have one balance of sum 1,

.. math::
    \begin{bmatrix} W \\ 1 \cdots 1 \end{bmatrix} \lambda =
    \begin{bmatrix} 0 \\ 1 \end{bmatrix} ,

and close the body when all of it is positive.  The smallest push ranks choices; what is chosen is
then judged by `is_form_closure`.
"""

from __future__ import annotations

import numpy as np

from multiarm.grasp.contacts import wrenches_of
from multiarm.grasp.polyhedron import Polyhedron

# Below this determinant (moments over the body's size) a choice is dependent and of no use.
DEPENDENT = 1e-12
# Choices in one go: some 50 MB.
CHUNK = 50_000


def smallest_pushes(body: Polyhedron, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Smallest push of each choice of seven contacts, shape (K,); 0 when they are dependent.

    Parameters
    ----------
    body : Polyhedron
        Its centre and size make wrenches comparable.
    points, normals : ndarray, shape (K, 7, 3)
        Places, and unit normals into the body.
    """
    smallest = np.zeros(len(points))
    for first in range(0, len(points), CHUNK):
        part = slice(first, first + CHUNK)
        W = wrenches_of((points[part] - body.centre) / body.size, normals[part])  # (6, K, 7)
        A = np.concatenate([np.moveaxis(W, 0, 1), np.ones((W.shape[1], 1, 7))], axis=1)
        usable = np.flatnonzero(np.abs(np.linalg.det(A)) > DEPENDENT)
        target = np.zeros((7, 1))
        target[6] = 1.0
        pushes = np.linalg.solve(A[usable], target)[..., 0]  # (K, 7)
        smallest[first + usable] = pushes.min(axis=1)
    return smallest
