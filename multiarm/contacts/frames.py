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
from multiarm.lowlevel import kernel

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
def _axis(body, frame, at, j, k):
    """Entry ``k`` of the world direction of axis ``j`` of a joint frame."""
    return (
        body[3 * k] * frame[at + j]
        + body[3 * k + 1] * frame[at + 3 + j]
        + body[3 * k + 2] * frame[at + 6 + j]
    )


@kernel
def _R(frame, link, body, i, j):
    """Entry of the rotation from the arm's joint frame to the object's."""
    r = 0.0
    for k in range(3):
        r += _axis(body, frame, ON_OBJECT, i, k) * _axis(link, frame, ON_LINK, j, k)
    return r


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
    for k in range(3):
        m = link[3 * k] * frame[9] + link[3 * k + 1] * frame[10] + link[3 * k + 2] * frame[11]
        j = body[3 * k] * frame[21] + body[3 * k + 1] * frame[22] + body[3 * k + 2] * frame[23]
        # scratch: the arm's frame from its link's origin, then from the object's frame
        places[3 + k] = m
        places[k] = link[ORIGIN_AT + k] - body[ORIGIN_AT + k] + m - j
        rates[3 + k] = j
    w0, w1, w2 = link[SPIN], link[SPIN + 1], link[SPIN + 2]
    u0, u1, u2 = body[SPIN], body[SPIN + 1], body[SPIN + 2]
    m0, m1, m2 = places[3], places[4], places[5]
    x0, x1, x2 = places[0], places[1], places[2]
    j0, j1, j2 = rates[3] + x0, rates[4] + x1, rates[5] + x2  # from the object's origin
    v0 = link[VELOCITY] + w1 * m2 - w2 * m1 - body[VELOCITY] - (u1 * j2 - u2 * j1)
    v1 = link[VELOCITY + 1] + w2 * m0 - w0 * m2 - body[VELOCITY + 1] - (u2 * j0 - u0 * j2)
    v2 = link[VELOCITY + 2] + w0 * m1 - w1 * m0 - body[VELOCITY + 2] - (u0 * j1 - u1 * j0)
    s0, s1, s2 = w0 - u0, w1 - u1, w2 - u2
    for i in range(3):
        a0, a1 = _axis(body, frame, ON_OBJECT, i, 0), _axis(body, frame, ON_OBJECT, i, 1)
        a2 = _axis(body, frame, ON_OBJECT, i, 2)
        places[i] = a0 * x0 + a1 * x1 + a2 * x2
        rates[i] = a0 * v0 + a1 * v1 + a2 * v2
        rates[3 + i] = a0 * s0 + a1 * s1 + a2 * s2
    # R = exp(theta): its skew part is 2 sin |theta| along theta, its trace 1 + 2 cos |theta|; the
    # turn about one axis alone needs that axis's entry and two of the diagonal
    r0, r1, r2 = (
        _R(frame, link, body, 0, 0),
        _R(frame, link, body, 1, 1),
        _R(frame, link, body, 2, 2),
    )
    q0 = _R(frame, link, body, 2, 1) - _R(frame, link, body, 1, 2)
    q1 = _R(frame, link, body, 0, 2) - _R(frame, link, body, 2, 0)
    q2 = _R(frame, link, body, 1, 0) - _R(frame, link, body, 0, 1)
    sine, cosine = 0.5 * math.sqrt(q0 * q0 + q1 * q1 + q2 * q2), 0.5 * (r0 + r1 + r2 - 1.0)
    scale = 0.5 if sine < 1e-12 else 0.5 * math.atan2(sine, cosine) / sine
    places[3], places[4], places[5] = scale * q0, scale * q1, scale * q2
    places[6] = math.atan2(q0, r1 + r2)
    places[7] = math.atan2(q1, r0 + r2)
    places[8] = math.atan2(q2, r0 + r1)
