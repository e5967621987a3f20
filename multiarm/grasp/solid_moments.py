r"""Volume, centre and inertia of a solid from the loops around its faces.

They are sums over the signed tetrahedra between a point inside and the triangles
:math:`(v_1, v_k, v_{k+1})` of all loops; those of dents and of holes, whose loops run the other way
round, are negative, so that no face has to be cut up.  With corners a, b, c of a triangle about the
point and :math:`s = a + b + c`

.. math::
    V = \sum \tfrac{1}{6} a \cdot (b \times c), \qquad
    \int x \, dV = \sum \tfrac{V_i}{4} s, \qquad
    \int x x^T dV = \sum \tfrac{V_i}{20} (a a^T + b b^T + c c^T + s s^T).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class MassProperties:
    """Mass properties of a solid of constant density.

    Attributes
    ----------
    mass : float
        [kg]
    centre : ndarray, shape (3,)
        Centre of mass in the body's frame [m].
    inertia : ndarray, shape (3, 3)
        About the centre of mass, in the body's axes [kg m^2].
    """

    mass: float
    centre: np.ndarray
    inertia: np.ndarray


@dataclass(frozen=True)
class Moments:
    """Moments of the volume of a solid.

    Attributes
    ----------
    volume : float
        [m^3]
    centre : ndarray, shape (3,)
        [m]
    second : ndarray, shape (3, 3)
        Integral of ``x x^T`` about the centre [m^5].
    """

    volume: float
    centre: np.ndarray
    second: np.ndarray

    def of_mass(self, mass: float) -> MassProperties:
        """Mass properties when a mass is spread evenly over the volume."""
        inertia = np.trace(self.second) * np.eye(3) - self.second
        return MassProperties(mass, self.centre, inertia * (mass / self.volume))


def moments(vertices: np.ndarray, loops: Sequence[Sequence[int]]) -> Moments:
    """Moments of the solid that loops of corners (V, 3) bound."""
    middle = vertices.mean(axis=0)
    fans = [(loop[0], loop[k], loop[k + 1]) for loop in loops for k in range(1, len(loop) - 1)]
    corners = (vertices - middle)[np.array(fans)]  # (T, 3 corners, 3)
    volumes = np.linalg.det(corners) / 6.0
    sums = corners.sum(axis=1)
    volume = float(volumes.sum())
    centre = volumes @ sums / (4.0 * volume) if volume else np.zeros(3)
    about = np.einsum("t,tki,tkj->ij", volumes, corners, corners)
    about += np.einsum("t,ti,tj->ij", volumes, sums, sums)
    return Moments(volume, centre + middle, about / 20.0 - volume * np.outer(centre, centre))
