r"""The motion that a joint leaves free, in coordinates that a person would read off it.

Every joint has a frame on the arm and a frame on the object that coincide when the joint is as it
was at the start; their z axes are the joint's axis or normal.  The arm's frame, seen from the
object's and in its axes, stands at ``x`` with the rotation ``R`` and moves with the twist

.. math:: \begin{bmatrix} \dot x \\ \omega \end{bmatrix}
    = \begin{bmatrix} R_J^T (v_M - v_J - \omega_o \times (x_M - x_J)) \\
                      R_J^T (\omega_m - \omega_o) \end{bmatrix}

(``M``, ``J`` the two frames, all in world axes on the right).  A joint's relative rates
:math:`\alpha` are those components that stay free, with the others determined by them: T has unit
rows there (thesis, 3.8.1).  Beside each rate stands the component of ``x`` or of the rotation
vector of ``R``: the angle of a hinge, the slide of a slider.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from multiarm.contacts.kernel import ORIGIN_AT, SPIN, VELOCITY
from multiarm.jit.kernels import kernel
from multiarm.jit.vectors import (
    add,
    add_cross,
    compose,
    cross,
    norm,
    put,
    rotate,
    rotate_back,
    rotation,
    scale,
    sub,
    vec,
)

# A row of joint frames: the arm's in its link (rotation row by row, origin), the object's in it.
ON_LINK, ON_OBJECT, FRAME_WIDTH = 0, 12, 24

# From here on, :func:`write_relative` leaves the turns about single axes.
SINGLE_TURN = 6

COMPONENTS = ("slide x", "slide y", "slide z", "turn x", "turn y", "turn z")
UNITS = ("m", "m", "m", "rad", "rad", "rad")


@dataclass(frozen=True)
class JointFrame:
    """Where a joint is, and which of its motions stay free.

    Attributes
    ----------
    on_tip, on_object : ndarray, shape (4, 4)
        Pose of the joint frame in the arm's tip frame, and in the object's frame; z is the axis.
    free : tuple of int
        Components 0 to 5 of the relative twist that serve as rates ``alpha``.
    """

    on_tip: np.ndarray
    on_object: np.ndarray
    free: tuple[int, ...]

    @property
    def places(self) -> tuple[int, ...]:
        """Where :func:`write_relative` leaves the coordinates of the free components.

        A single free turn is told by its angle, several by the rotation vector.
        """
        alone = sum(k >= 3 for k in self.free) == 1
        return tuple(k + 3 if k >= 3 and alone else k for k in self.free)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the free components, such as ``turn z``."""
        return tuple(COMPONENTS[k] for k in self.free)

    def packed(self, tip_rotation: np.ndarray, tip_translation: np.ndarray) -> np.ndarray:
        """The row for the kernel, shape (24,); the tip's frame is given in that of its link."""
        row = np.empty(FRAME_WIDTH)
        row[ON_LINK : ON_LINK + 9] = (tip_rotation @ self.on_tip[:3, :3]).ravel()
        row[ON_LINK + 9 : ON_LINK + 12] = tip_rotation @ self.on_tip[:3, 3] + tip_translation
        row[ON_OBJECT : ON_OBJECT + 9] = self.on_object[:3, :3].ravel()
        row[ON_OBJECT + 9 : ON_OBJECT + 12] = self.on_object[:3, 3]
        return row


@kernel
def write_relative(frame, link, body, rates, places):
    """Write all six rates [m/s, rad/s] and coordinates [m, rad] of one joint.

    The coordinates are the translation, the rotation vector, and the turns about x, y and z alone
    (the twist in a swing-twist decomposition: a hinge's angle, up to a full turn).

    Parameters
    ----------
    frame : (24,)
        From :meth:`JointFrame.packed`.
    link, body : (24,)
        Kinematics of the link that carries the tip, and of the object.
    rates : (6,), places : (9,), written
    """
    R_m, R_o = rotation(link, 0), rotation(body, 0)
    M, J = compose(R_m, rotation(frame, ON_LINK)), compose(R_o, rotation(frame, ON_OBJECT))
    # the arm's frame from its link's origin, and from the object's frame; it from the object's
    m, j = rotate(R_m, vec(frame, ON_LINK + 9)), rotate(R_o, vec(frame, ON_OBJECT + 9))
    x = sub(add(sub(vec(link, ORIGIN_AT), vec(body, ORIGIN_AT)), m), j)
    omega_m, omega_o = vec(link, SPIN), vec(body, SPIN)
    v = sub(add_cross(vec(link, VELOCITY), omega_m, m), vec(body, VELOCITY))
    v = sub(v, cross(omega_o, add(j, x)))
    put(places, 0, rotate_back(J, x))
    put(rates, 0, rotate_back(J, v))
    put(rates, 3, rotate_back(J, sub(omega_m, omega_o)))
    # R = exp(theta): its skew part is 2 sin |theta| along theta, its trace 1 + 2 cos |theta|; the
    # turn about one axis alone needs that axis's entry and two of the diagonal
    X, Y, Z = rotate_back(J, M[0]), rotate_back(J, M[1]), rotate_back(J, M[2])
    q = (Y[2] - Z[1], Z[0] - X[2], X[1] - Y[0])
    sine, cosine = 0.5 * norm(q), 0.5 * (X[0] + Y[1] + Z[2] - 1.0)
    put(places, 3, scale(0.5 if sine < 1e-12 else 0.5 * math.atan2(sine, cosine) / sine, q))
    places[6] = math.atan2(q[0], Y[1] + Z[2])
    places[7] = math.atan2(q[1], X[0] + Z[2])
    places[8] = math.atan2(q[2], X[0] + Y[1])
