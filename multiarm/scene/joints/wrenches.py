r"""A joint given by the wrenches that it transmits.

The wrench on the object is :math:`\gamma` times one contact, or the difference of two (thesis,
appendix C; :func:`multiarm.geometry.screws.zero_pitch`).  Each contact is a plane on the body that
carries the wrench, and a point on the other body that starts on it.  The wrenches determine which
motions are free at the start; the finite motion of the joint depends on the pairs.  They are chosen
so that a hinge, a slider, a ball or a universal joint stays one: forces act near the centre of
rotation; if there is a single axis of rotation, they act where they meet that axis, and couples are
a push and a pull across it at two places along it, which keep their direction in the carrying body
at any angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import model_validator
from typing_extensions import Self

from multiarm.geometry import Contact, plane, point
from multiarm.geometry.screws import ZeroPitch, skew, zero_pitch
from multiarm.scene.faults import invalid
from multiarm.scene.joints.kind import Joint
from multiarm.scene.values import Positive, Vec6

# A wrench that stands out of the span of those before it by less than this fraction of itself is
# taken for a combination of them: as many digits as a person may write.
_SPAN_TOLERANCE = 1e-9
# Wrenches that take part in a combination with less than this weight are not named.
_NAMED_WEIGHT = 1e-6


class WrenchesJoint(Joint):
    """The joint that transmits given wrenches, and leaves every motion on which they do no work.

    Each wrench is written as the difference of two point contacts (thesis, appendix C).
    """

    picture = (
        "a joint given by the forces and moments that it transmits; all other motions are free"
    )
    example = """           # forces and moments, joint frame: a screw
    wrenches:
      - [1, 0, 0, 0, 0, 0]
      - [0, 1, 0, 0, 0, 0]
      - [0, 0, 1, 0, 0, -0.01]
      - [0, 0, 0, 1, 0, 0]
      - [0, 0, 0, 0, 1, 0]"""
    as_listed = True

    kind: Literal["wrenches"] = "wrenches"
    wrenches: tuple[Vec6, ...]
    """A list of [fx, fy, fz, mx, my, mz]. Force [N] and moment [N m] about the origin of the joint
    frame, in that frame, on the object, for one unit of the multiplier."""
    carried_by: Literal["object", "arm"] = "object"
    """The body to which the directions are fixed; with 'between', 'arm' stands for the
    first body and 'object' for the second."""
    size: Positive = 0.1
    """Distance [m] of the two contacts that make a couple."""

    @model_validator(mode="after")
    def _independent(self) -> Self:
        if not self.wrenches:
            raise invalid("'wrenches' is empty; list at least one [fx, fy, fz, mx, my, mz]")
        dependent = _dependent_rows(self.wrenches, self.size)
        if dependent:
            texts = [
                f"wrench {row} is a combination of {_counted(combined)}"
                if combined
                else f"wrench {row} is zero"
                for row, combined in dependent.items()
            ]
            raise invalid(f"{'; '.join(texts)} (counted from 1); remove what adds nothing")
        return self

    def records(self) -> list[Contact]:
        """One row for each wrench that the joint transmits."""
        wrenches = np.array(self.wrenches)
        centre, axis = _centre_and_axis(wrenches, self.size)
        contacts = []
        for k, wrench in enumerate(wrenches):
            force, moment = wrench[:3], wrench[3:] - np.cross(centre, wrench[:3])
            pair = zero_pitch(np.concatenate([force, moment]), length=self.size)
            if axis is not None and pair.e_2 is None:
                pair = replace(pair, p_1=_nearest_to_axis(pair.p_1, pair.e_1, axis))
            elif axis is not None and np.array_equal(pair.e_1, np.array(pair.e_2)):
                pair = _couple(moment, axis, self.size)
            contacts.append(_wrench_row(f"wrench {k + 1}", pair, centre, self.carried_by))
        return contacts


def _dependent_rows(
    wrenches: Sequence[Sequence[float]], length: float
) -> dict[int, tuple[int, ...]]:
    """Wrenches, counted from 1, that are combinations of earlier ones, and which these are.

    None of them when the wrench is zero.  Moments count as forces at the lever arm ``length`` [m].
    """
    scaled = np.array(wrenches, dtype=float) / ([1.0] * 3 + [length] * 3)
    sizes = np.max(np.abs(scaled), axis=1)
    dependent: dict[int, tuple[int, ...]] = {}
    independent: list[int] = []
    for row, size in enumerate(sizes):
        if size == 0.0:
            dependent[row + 1] = ()
            continue
        wrench = scaled[row] / size
        basis = (scaled[independent] / sizes[independent, None]).T  # (6, K)
        weights = np.linalg.lstsq(basis, wrench, rcond=None)[0] if independent else np.zeros(0)
        if np.linalg.norm(wrench - basis @ weights) > _SPAN_TOLERANCE * np.linalg.norm(wrench):
            independent.append(row)
            continue
        parts = [k + 1 for k, w in zip(independent, weights, strict=True) if abs(w) > _NAMED_WEIGHT]
        dependent[row + 1] = tuple(parts)
    return dependent


def _counted(rows: tuple[int, ...]) -> str:
    *first, last = (str(row) for row in rows)
    return f"wrenches {', '.join(first)} and {last}" if first else f"wrench {last}"


def _centre_and_axis(wrenches: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray | None]:
    """Centre of the rotations that these wrenches leave free, and their axis if there is only one.

    The centre is the point nearest to the origin that no free rotation moves, other than along a
    free translation.
    """
    scaled = wrenches / ([1.0] * 3 + [size] * 3)
    scaled /= np.linalg.norm(scaled, axis=1)[:, None]
    free = np.linalg.svd(scaled)[2][len(scaled) :].T  # columns: twists [v; size omega], no work
    ways, weights, mixes = np.linalg.svd(free[3:])
    tolerance = 1e-9  # of the rotation in a free motion of unit size
    turns = np.count_nonzero(weights > tolerance)
    slides = np.linalg.qr(free[:3] @ mixes[turns:].T)[0]
    across = np.eye(3) - slides @ slides.T
    equations, right = [np.zeros((0, 3))], [np.zeros(0)]
    for v, w in zip((free[:3] @ mixes[:turns].T).T, (free[3:] @ mixes[:turns].T).T, strict=True):
        equations.append(across @ skew(w / size))  # v + w x centre is a slide
        right.append(-across @ v)
    solution = np.linalg.lstsq(np.vstack(equations), np.concatenate(right), rcond=tolerance)[0]
    way = ways[:, 0] * np.sign(ways[np.argmax(np.abs(ways[:, 0])), 0])
    return np.where(np.abs(solution) > 1e-12 * size, solution, 0.0), way if turns == 1 else None


def _nearest_to_axis(p: np.ndarray, e: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Point of the line through ``p`` along ``e`` that is nearest to the axis through the origin.

    Lines along the axis, to 1e-6 rad, are equally near everywhere: ``p`` is kept.
    """
    across_e, across_p = e - (e @ axis) * axis, p - (p @ axis) * axis
    square = across_e @ across_e
    return p if square < 1e-12 else p - (across_e @ across_p) / square * e


def _couple(moment: np.ndarray, axis: np.ndarray, size: float) -> ZeroPitch:
    """A couple across an axis as a push and a pull across it, ``size`` apart along it.

    At any angle about the axis its direction stays with the body that carries the planes, as that
    of a single force does: rows of both sorts never become dependent.
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

    weight = 1.0 if abs(pair.gamma - 1.0) < 1e-14 else pair.gamma  # 1 but for rounding
    row = contact(pair.e_1, pair.p_1)
    if pair.e_2 is None or pair.p_2 is None:
        return replace(row, weight=weight)
    return replace(row, weight=weight, minus=contact(pair.e_2, pair.p_2))
