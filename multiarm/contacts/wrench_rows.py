r"""A joint that is given by the wrenches it transmits, as contacts.

The wrench on the object is :math:`\gamma` times one contact, or the difference of two (thesis,
appendix C; :func:`multiarm.contacts.screws.zero_pitch`).  Each contact is a plane on the body that
carries the wrench, and a point on the other body that starts on it.

The wrenches say which motions are free at the start; what the joint does when it moves far depends
on the pairs.  They are taken so that a hinge, a slider, a ball or a universal joint stays one:
forces act near the point about which the bodies turn; if there is one direction of turning, they
act where they meet that axis, and couples are made of a push and a pull across it at two places
along it, which keep their direction in the carrying body at any angle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from multiarm.contacts.records import Contact, plane, point
from multiarm.contacts.screws import ZeroPitch, first_largest, zero_pitch

# A factor this near to 1 is 1: the direction was written with the digits of a number.
UNIT_TOLERANCE = 1e-14
# Turns that go with a free motion of unit size count from here on.
TURN_TOLERANCE = 1e-9
# Squared sine of the angle between lines below which they count as parallel.
PARALLEL_TOLERANCE = 1e-12
# Coordinates of the centre that are smaller than this part of the joint's size are 0.
CENTRE_TOLERANCE = 1e-12


def wrench_contacts(joint) -> list[Contact]:
    """Contact records of a joint of kind ``wrenches``, in the joint frame."""
    wrenches = np.array(joint.wrenches)
    centre, axis = _centre_and_axis(wrenches, joint.size)
    contacts = []
    for k, wrench in enumerate(wrenches):
        force, moment = wrench[:3], wrench[3:] - np.cross(centre, wrench[:3])
        pair = zero_pitch(np.concatenate([force, moment]), length=joint.size)
        if axis is not None and pair.e_2 is None:
            pair = replace(pair, p_1=_nearest_to_axis(pair.p_1, pair.e_1, axis))
        elif axis is not None and np.array_equal(pair.e_1, np.array(pair.e_2)):
            pair = _couple(moment, axis, joint.size)
        contacts.append(_wrench_row(f"wrench {k + 1}", pair, centre, joint.carried_by))
    return contacts


def _centre_and_axis(wrenches: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray | None]:
    """Where bodies turn that exert these wrenches, and about what, if there is one direction.

    The centre is the point (nearest to the origin) that turning moves no more than slides do.
    """
    scaled = wrenches / ([1.0] * 3 + [size] * 3)
    scaled /= np.linalg.norm(scaled, axis=1)[:, None]
    free = np.linalg.svd(scaled)[2][len(scaled) :].T  # columns: twists [v; size omega], no work
    ways, weights, mixes = np.linalg.svd(free[3:])
    turns = np.count_nonzero(weights > TURN_TOLERANCE)
    slides = np.linalg.qr(free[:3] @ mixes[turns:].T)[0]
    across = np.eye(3) - slides @ slides.T
    equations, right = [np.zeros((0, 3))], [np.zeros(0)]
    for v, w in zip((free[:3] @ mixes[:turns].T).T, (free[3:] @ mixes[:turns].T).T, strict=True):
        equations.append(across @ np.cross(w / size, np.eye(3)).T)  # v + w x centre is a slide
        right.append(-across @ v)
    found = np.linalg.lstsq(np.vstack(equations), np.concatenate(right), rcond=TURN_TOLERANCE)
    way = ways[:, 0] * np.sign(ways[first_largest(np.abs(ways[:, 0])), 0])
    centre = np.where(np.abs(found[0]) > CENTRE_TOLERANCE * size, found[0], 0.0)
    return centre, way if turns == 1 else None


def _nearest_to_axis(p: np.ndarray, e: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Point of the line through ``p`` along ``e`` that is nearest to the axis through the origin.

    Lines along the axis are equally near everywhere: ``p`` is kept.
    """
    across_e, across_p = e - (e @ axis) * axis, p - (p @ axis) * axis
    square = across_e @ across_e
    return p if square < PARALLEL_TOLERANCE else p - (across_e @ across_p) / square * e


def _couple(moment: np.ndarray, axis: np.ndarray, size: float) -> ZeroPitch:
    """A couple across an axis as a push and a pull across it, ``size`` apart along it.

    At any angle about the axis its direction stays with the body that carries the planes, as that
    of a single force does: rows of both sorts never come to depend on each other.
    """
    gamma = float(np.linalg.norm(moment)) / size
    e, arm = np.cross(moment, axis) / (gamma * size), 0.5 * size * axis
    return ZeroPitch(gamma, e, arm, e, -arm)


def _wrench_row(name: str, pair: ZeroPitch, centre: np.ndarray, carried_by: str) -> Contact:
    def contact(e: np.ndarray, p: np.ndarray) -> Contact:
        p = p + centre
        # e points into the object: out of the arm's plane, against the normal of the object's
        if carried_by == "arm":
            return Contact(name, plane(p, e), point(p))
        return Contact(name, point(p), plane(p, -e))

    weight = 1.0 if abs(pair.gamma - 1.0) < UNIT_TOLERANCE else pair.gamma
    row = contact(pair.e_1, pair.p_1)
    if pair.e_2 is None or pair.p_2 is None:
        return replace(row, weight=weight)
    return replace(row, weight=weight, minus=contact(pair.e_2, pair.p_2))
