r"""A joint between an arm and the object: contacts, frame, relative coordinates and their limits.

Every joint has a frame on the arm and a frame on the object that coincide at the start; their z
axes are the joint's axis or normal.  The arm's frame, relative to the object's and in its axes, has
the origin ``x`` and the rotation ``R`` and moves with the twist

.. math:: \begin{bmatrix} \dot x \\ \omega \end{bmatrix}
    = \begin{bmatrix} R_J^T (v_M - v_J - \omega_o \times (x_M - x_J)) \\
                      R_J^T (\omega_m - \omega_o) \end{bmatrix}

(``M``, ``J`` the two frames, all in world axes on the right).  A joint's relative rates
:math:`\alpha` are the free components of this twist, which determine the others: T has unit rows
there (thesis, 3.8.1).  The coordinate of each rate is the component of ``x`` or of the rotation
vector of ``R``: the angle of a hinge, the displacement of a slider.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from multiarm.contacts.motion import open_body
from multiarm.geometry.records import Contact, Placement
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.rows import Rotation, Vector, as_row, row_of, width
from multiarm.jit.vectors import (
    add,
    add_cross,
    compose,
    cross,
    put,
    rotate,
    rotate_back,
    rotation_vector,
    sub,
)
from multiarm.scene import JointSpec

# :func:`write_relative` writes the turns about single axes from this entry on.
SINGLE_TURN = 6

COMPONENTS = ("slide x", "slide y", "slide z", "turn x", "turn y", "turn z")
UNITS = ("m", "m", "m", "rad", "rad", "rad")


@dataclass(frozen=True)
class JointFrame:
    """Frames of a joint, and its free motions.

    Attributes
    ----------
    on_tip, on_object : ndarray, shape (4, 4)
        Pose of the joint frame in the first body's tip frame, and in the second body's frame, of a
        link that of its tip; z is the axis.
    free : tuple of int
        Components 0 to 5 of the relative twist that serve as rates ``alpha``.
    """

    on_tip: np.ndarray
    on_object: np.ndarray
    free: tuple[int, ...]

    @property
    def places(self) -> tuple[int, ...]:
        """Entries of :func:`write_relative` with the coordinates of the free components.

        The coordinate of a single free turn is its angle; several have the rotation vector.
        """
        alone = sum(k >= 3 for k in self.free) == 1
        return tuple(k + 3 if k >= 3 and alone else k for k in self.free)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the free components, such as ``turn z``."""
        return tuple(COMPONENTS[k] for k in self.free)

    def packed(self, first: Placement, second: Placement) -> np.ndarray:
        """The row for the kernel, shape (24,).

        ``first`` and ``second`` are the bodies' tips in the frames of their links.
        """
        (R_A, p_A), (R_B, p_B) = first, second
        frames = FrameRow(
            on_link=R_A @ self.on_tip[:3, :3],
            origin_on_link=R_A @ self.on_tip[:3, 3] + p_A,
            on_object=R_B @ self.on_object[:3, :3],
            origin_on_object=R_B @ self.on_object[:3, 3] + p_B,
        )
        return as_row(frames)


class FrameRow(NamedTuple):
    """The frames of a joint for kernels: the arm's in its link, the object's in the object."""

    on_link: Rotation
    origin_on_link: Vector  # [m]
    on_object: Rotation
    origin_on_object: Vector  # [m]


open_frames, FRAME_WIDTH = row_of(FrameRow), width(FrameRow)


class Joint(NamedTuple):
    """A joint between an arm and the object.

    contacts : list of Contact
        The arm's geometry in the tip frame.
    frame : JointFrame
        Without free components where the joint's kind does not fix them.
    limits : dict
        By component of the relative motion, see :attr:`multiarm.scene.Joint.free_limits`.
    """

    contacts: list[Contact]
    frame: JointFrame
    limits: dict[int, tuple[float, float]]


@dataclass(frozen=True)
class Limit:
    """The limits of one coordinate, which is 0 where the joint's two frames coincide.

    Attributes
    ----------
    component : int
        A slide along x, y, z (0 to 2) or a turn about x, y, z (3 to 5) of the joint's frame.
    low, high : float
        [m] or [rad].
    """

    component: int
    low: float
    high: float

    @property
    def turns(self) -> bool:
        """Whether the coordinate is an angle."""
        return self.component >= 3

    @property
    def along_axis(self) -> bool:
        """Whether it is the motion along, or about, the joint's axis z."""
        return self.component % 3 == 2

    @property
    def motion(self) -> str:
        """Name of the motion, such as ``turn about z``."""
        return f"{'turn about' if self.turns else 'slide along'} {'xyz'[self.component % 3]}"

    @property
    def unit(self) -> str:
        """The unit of the coordinate: rad or m."""
        return UNITS[self.component]


def limits_of(joint: JointSpec) -> tuple[Limit, ...]:
    """The limits of a scene's joint: none, or one for each coordinate that has them."""
    return tuple(Limit(component, *ends) for component, ends in joint.free_limits.items())


def axis_travel(on_object: np.ndarray, on_tip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn about and slide along the z axis of a joint's frames through K instants.

    ``X = F_object^-1 F_tip`` is a screw about z: its translation is the slide, its rotation the
    turn.

    Parameters
    ----------
    on_object, on_tip : ndarray, shape (K, 4, 4)
        World poses of the joint's frame on the object and of that on the tip.

    Returns
    -------
    turn, slide : ndarray, shape (K,)
        [rad], continuous from instant to instant, the first within half a turn of 0; [m].
    """
    R, p = on_object[:, :3, :3], on_object[:, :3, 3]
    slide = np.einsum("ki,ki->k", R[..., 2], on_tip[:, :3, 3] - p)
    x_tip = on_tip[:, :3, 0]
    along_x, along_y = (np.einsum("ki,ki->k", R[..., j], x_tip) for j in (0, 1))
    return np.unwrap(np.arctan2(along_y, along_x)), slide


@inlined
def unwrapped(x, before, place):
    """A coordinate by its place in :func:`write_relative`.

    A single angle continues past pi from ``before`` (NaN: unknown).
    """
    if place >= SINGLE_TURN and before == before:
        x += 2.0 * math.pi * round((before - x) / (2.0 * math.pi))
    return x


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
    arm, held = open_body(link), open_body(body)
    R_m, R_o = arm.rotation, held.rotation
    frames = open_frames(frame)
    M, J = compose(R_m, frames.on_link), compose(R_o, frames.on_object)
    # from the link's origin to the arm's frame, from the object's origin to its frame, between both
    m, j = rotate(R_m, frames.origin_on_link), rotate(R_o, frames.origin_on_object)
    x = sub(add(sub(arm.origin, held.origin), m), j)
    omega_m, omega_o = arm.spin, held.spin
    v = sub(add_cross(arm.velocity, omega_m, m), held.velocity)
    v = sub(v, cross(omega_o, add(j, x)))
    put(places, 0, rotate_back(J, x))
    put(rates, 0, rotate_back(J, v))
    put(rates, 3, rotate_back(J, sub(omega_m, omega_o)))
    X, Y, Z = rotate_back(J, M[0]), rotate_back(J, M[1]), rotate_back(J, M[2])
    put(places, 3, rotation_vector((X, Y, Z)))
    # the turn about one axis alone needs that axis's entry of the skew part and two of the diagonal
    q = (Y[2] - Z[1], Z[0] - X[2], X[1] - Y[0])
    places[6] = math.atan2(q[0], Y[1] + Z[2])
    places[7] = math.atan2(q[1], X[0] + Z[2])
    places[8] = math.atan2(q[2], X[0] + Y[1])
