r"""Motions of a body that contacts leave: twists, and how they read as sentences (thesis, 2.1).

A twist ``[v; omega]`` about the frame's origin moves the body's point p with
:math:`u = v + \omega \times p` and opens the gap at contact j at the rate
:math:`w_j^T [v; \omega] = e_j \cdot u_j`.  It is a translation, a turn about a line, or a screw
about a line, with the pitch :math:`v \cdot \omega / |\omega|^2`.  A turn about a line leaves every
gap as it is exactly when every normal line meets that line or is parallel to it: so it is with
bodies of revolution, which frictionless contacts can never hold (thesis, 2.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from multiarm.grasp.closure.balances import floor_of
from multiarm.grasp.contacts import Contacts, nearest_to_lines
from multiarm.notation import count_of

# Part of the fastest contact's speed that counts as none.
STILL = 1e-7


def twist_of(contacts: Contacts, direction: np.ndarray) -> np.ndarray:
    """Twist about the frame's origin of a direction in scaled wrench coordinates.

    Its fastest contact point has the speed 1; when all of them rest, ``|omega| length`` is 1.
    """
    direction = direction / np.linalg.norm(direction)
    linear, angular = _split(contacts, direction)
    arms = contacts.points - contacts.centre
    scale = float(np.linalg.norm(linear + _across(angular, arms), axis=1).max())
    if scale <= STILL:
        scale = float(np.linalg.norm(direction[contacts.dimension :]))
    return about_origin(contacts, direction) / scale


def about_origin(contacts: Contacts, direction: np.ndarray) -> np.ndarray:
    """Scaled coordinates of a twist, or of prices of force and moment, about the frame's origin."""
    linear, angular = _split(contacts, direction)
    return np.concatenate([linear - _across(angular, contacts.centre), angular])


def leaving_contacts(contacts: Contacts, motion: np.ndarray) -> tuple[int, ...]:
    """Numbers of the contacts whose gap opens under a twist."""
    velocities = _velocities(contacts, motion)
    turning = float(np.linalg.norm(motion[contacts.dimension :])) * contacts.length
    size = max(float(np.linalg.norm(velocities, axis=1).max()), turning)
    opening = np.sum(contacts.normals * velocities, axis=1)
    return tuple(np.flatnonzero(opening > _still(contacts) * size).tolist())


@dataclass(frozen=True, eq=False)
class Screw:
    """A motion of the body.

    Attributes
    ----------
    kind : {"slide", "turn", "screw"}
    along : ndarray, shape (d,)
        Unit vector of the slide, or of the axis in space.
    point : ndarray, shape (d,)
        Of the axis, nearest to the middle of the contacts; in the plane the centre of the turn [m].
    pitch : float
        Advance along the axis [m/rad].
    """

    kind: Literal["slide", "turn", "screw"]
    along: np.ndarray
    point: np.ndarray
    pitch: float


def screw_of(contacts: Contacts, motion: np.ndarray) -> Screw:
    """What a twist about the frame's origin is; what the contacts hardly feel counts as none."""
    d = contacts.dimension
    angular = motion[d:]
    middle = motion[:d] + _across(angular, contacts.centre)
    turning = float(np.linalg.norm(angular)) * contacts.length
    if turning <= STILL * float(np.linalg.norm(middle)):
        return Screw("slide", middle / np.linalg.norm(middle), contacts.centre, 0.0)
    foot = contacts.centre + _across(angular, middle) / float(angular @ angular)
    if d == 2:
        return Screw("turn", np.zeros(2), foot, 0.0)
    pitch = float(middle @ angular) / float(angular @ angular)
    kind: Literal["turn", "screw"] = "screw"
    if abs(pitch) <= _still(contacts) * contacts.length:
        kind = "turn"
    return Screw(kind, angular / np.linalg.norm(angular), foot, pitch)


def motion_in_words(contacts: Contacts, motion: np.ndarray) -> str:
    """A twist as text: ``slide along (1, 0, 0)``, ``turn about the line through ...``."""
    screw = screw_of(contacts, motion)
    along = vector_in_words(screw.along)
    if screw.kind == "slide":
        return f"slide along {along}"
    point = point_in_words(contacts, screw.point)
    if contacts.dimension == 2:
        return f"turn about the point {point}"
    line = f"the line through {point} along {along}"
    if screw.kind == "turn":
        return f"turn about {line}"
    return f"screw about {line}, {screw.pitch:.4g} m for each radian"


def explanation(contacts: Contacts, motion: np.ndarray, rank: int, borderline: bool) -> str:
    """Why contacts do not hold the body, and how it can move."""
    n, space = contacts.freedoms, "in space" if contacts.dimension == 3 else "in the plane"
    does = motion_in_words(contacts, motion)
    off = leaving_contacts(contacts, motion)
    if contacts.count <= n:
        count = contacts.count
        few = f"{count_of(count, 'contact')} never {'closes' if count == 1 else 'close'}"
        why = f"{few} {space}, at least {n + 1} are needed"
    elif rank < n:
        why = f"the wrenches of the {contacts.count} contacts have rank {rank} of {n}"
    else:
        why = f"no pushes of all {contacts.count} contacts balance"
    how = f"the body can {does}{_which(contacts, off)}"
    sentences = [f"no form closure: {why}; {how}"]
    if not off:
        sentences += [pattern for pattern in (_pattern(contacts, motion),) if pattern]
    if borderline:
        sentences.append("It is borderline: a change within the tolerance may close it")
    return ". ".join(sentences)


def vector_in_words(vector: np.ndarray, size: float = 1.0, digits: int = 4) -> str:
    """Components with some digits; those that are negligible next to ``size`` are 0."""
    shown = np.where(np.abs(vector) > STILL * size, vector, 0.0)
    return "(" + ", ".join(f"{value:.{digits}g}" for value in shown) + ")"


def point_in_words(contacts: Contacts, point: np.ndarray) -> str:
    """A point with four digits of the size of the grasp, and more where this is far away."""
    size = max(float(np.abs(contacts.points).max()), contacts.length)
    return vector_in_words(point, size, 4 + int(np.log10(size / contacts.length)))


def _pattern(contacts: Contacts, motion: np.ndarray) -> str | None:
    """The common property of the normal lines when a motion leaves every gap unchanged."""
    d, p, e = contacts.dimension, contacts.points, contacts.normals
    across = e - np.outer(e @ e[0], e[0])
    if np.abs(across).max() <= STILL:
        return "All normals are parallel: nothing resists a motion across them"
    arms = p - contacts.centre
    meeting, off = nearest_to_lines(arms, e)
    if np.abs(off).max() <= _still(contacts) * contacts.length:
        kind = "sphere" if d == 3 else "circle"
        at = point_in_words(contacts, meeting + contacts.centre)
        return (
            f"All normal lines meet at {at}: no contact with such a normal stops a turn about that "
            f"point, and a {kind} around it cannot be held"
        )
    turns = np.linalg.norm(motion[d:]) * contacts.length > STILL
    if d == 3 and turns and screw_of(contacts, motion).kind == "turn":
        return (
            "All normal lines meet this axis or are parallel to it: contacts of that kind, the "
            "only ones on a body of revolution, never stop the turn"
        )
    return None


def _still(contacts: Contacts) -> float:
    """``STILL``, and the rounding of points far from the origin."""
    return STILL + floor_of(contacts)


def _split(contacts: Contacts, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Velocity of the middle of the contacts and angular velocity of a scaled direction."""
    d = contacts.dimension
    return direction[:d], direction[d:] / contacts.length


def _velocities(contacts: Contacts, motion: np.ndarray) -> np.ndarray:
    """Velocities (N, d) of the contact points of the body."""
    d = contacts.dimension
    middle = motion[:d] + _across(motion[d:], contacts.centre)
    return middle + _across(motion[d:], contacts.points - contacts.centre)


def _across(angular: np.ndarray, arms: np.ndarray) -> np.ndarray:
    """``omega x r``, in the plane too, where omega is the one number ``angular[0]``."""
    if len(angular) == 3:
        return np.cross(angular, arms)
    return angular[0] * np.stack([-arms[..., 1], arms[..., 0]], axis=-1)


def _which(contacts: Contacts, numbers: tuple[int, ...]) -> str:
    """Which contacts a motion leaves, as a subordinate clause."""
    if not numbers:
        return ", all contacts sliding or resting" if contacts.count > 1 else ", the contact slides"
    if len(numbers) == contacts.count:
        return ", away from every contact" if contacts.count > 1 else ", away from the contact"
    return f", away from {', '.join(contacts.names[j] for j in numbers)}"
