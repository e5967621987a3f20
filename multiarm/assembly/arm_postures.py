"""Postures of arms whose joint has a place on the object, and what is a good one.

The posture is one with which the joint's two frames coincide, or, where there is none, coincide but
for the motions that the joint leaves free.  Of many, the one is taken that is farthest from
singular postures, from the limits of its joints, from the object and from the ground on which the
base stands (:mod:`multiarm.assembly.inverse_kinematics`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multiarm.assembly.inverse_kinematics import (
    LENGTH,
    WHOLE_STARTS,
    InverseKinematics,
    TreeKinematics,
    clearance,
    points_on_links,
)
from multiarm.geometry.records import basis
from multiarm.robots.robot import Robot
from multiarm.scene import JointSpec, ObjectSpec, Scene

# Postures at which the search begins: half a millisecond each.
STARTS = 96
# Parts of the way from the tips to their places by which a base may be moved to reach these.
PARTS_OF_SHIFT = (1.0, 1.2, 1.5, 2.0)
# Angles to the place below this need no words [deg].
NO_TURN = 1.0


@dataclass(frozen=True)
class PostureSearch:
    """The search for a posture with which an arm holds its place on the object.

    Attributes
    ----------
    arm : Robot
    on_tip : ndarray, shape (4, 4)
        The joint's frame in the tip's.
    place : ndarray, shape (4, 4)
        The joint's place in the world.
    free : tuple of int
        Components of the pose that the joint leaves free.
    body : ObjectSpec
    """

    arm: Robot
    on_tip: np.ndarray
    place: np.ndarray
    free: tuple[int, ...]
    body: ObjectSpec

    @classmethod
    def of_joint(cls, scene: Scene, joint: JointSpec, arm: Robot) -> PostureSearch:
        """The search that a joint of a scene asks for."""
        body = scene.all_objects[joint.second.tip]
        return cls(arm, *joint_places(scene, joint), tuple(joint.free or ()), body)

    def best(self, allowed: Callable[[np.ndarray], bool] | None = None) -> np.ndarray | None:
        """The best of the postures found that are ``allowed``, None where none is.

        Where none is found well inside the limits, the whole ranges of the joints are searched.
        The joint's frames are shifted against each other only where they cannot coincide.
        """
        clear_of_object = clear_of(self.body, self.place, meshes=allowed is not None)

        def clear(posture: np.ndarray, _number: int) -> float:
            return clear_of_object(self.arm.files.base, self.arm.skeleton(posture))

        searches = [
            (search, starts)
            for search, starts in self._searches()
            if search.farther_than_it_reaches(self.place) is None
        ]
        return best_posture(searches, self.place, clear, allowed)

    def _searches(self) -> list[tuple[InverseKinematics, int]]:
        """Searches, and their starts: well inside the limits first, and with nothing left free."""
        return [
            (InverseKinematics(self.arm, free, self.on_tip, to_limits), starts)
            for to_limits, starts in ((False, STARTS), (True, WHOLE_STARTS))
            for free in dict.fromkeys([(), self.free])
        ]

    def why_none(self) -> str:
        """What a user may do where :meth:`best` finds nothing."""
        searches = self._searches()
        misses = [
            search.nearest(self.place, np.random.default_rng(0), starts)
            for search, starts in searches
            if search.free == self.free
        ]
        weight = 0.0 if self.free else LENGTH
        miss = min(misses, key=lambda m: float(np.linalg.norm([*m.shifts[0], weight * m.turns[0]])))
        beyond = searches[-1][0].farther_than_it_reaches(self.place)
        if beyond is None:
            total = sum(starts for _, starts in searches)
            text = (
                f"no joint positions were found that bring the tip to its place on the object, in "
                f"{total} searches that began all over the ranges of the joints"
            )
        else:
            text = (
                f"the tip's place on the object is out of reach: it is {beyond[0]:.3f} m from the "
                f"arm's first joint, and the arm stretches to {beyond[1]:.3f} m"
            )
        turn, (away,) = np.rad2deg(miss.turns[0]), miss.shifts
        turned = f" and {turn:.0f} deg" if turn > NO_TURN and not self.free else ""
        shift = helpful_shift(away, self._reaches_from)
        move = "" if shift is None else f"{move_base_by(shift)}, "
        return (
            f"{text}; the nearest posture found leaves {np.linalg.norm(away):.3f} m{turned}; "
            f"{move}let the base be found (base: {{solve: [x, y, yaw]}}) or choose another place"
        )

    def _reaches_from(self, shift: np.ndarray) -> bool:
        """Whether a posture is found with the base moved by a shift (3,) [m]."""
        place = self.place.copy()
        place[:3, 3] -= shift
        return replace(self, place=place).best() is not None


def helpful_shift(
    away: np.ndarray, reaches_from: Callable[[np.ndarray], bool]
) -> np.ndarray | None:
    """A shift of a base (3,) [m] from which its places are reached; None where none is found.

    Along ``away``, from the tips at the nearest posture to their places, and somewhat beyond, since
    links are stretched at its end.  Shifts are in whole millimetres, as messages show them.
    """
    for part in PARTS_OF_SHIFT:
        shift = np.round(part * away, 3)
        if shift.any() and reaches_from(shift):
            return shift
    return None


def move_base_by(shift: np.ndarray) -> str:
    """The remedy that moves a base by (3,) [m]."""
    numbers = ", ".join(f"{x:.3f}" for x in shift + 0.0)
    return f"move the base by [{numbers}] m"


def best_posture(
    searches: Sequence[tuple[TreeKinematics, int]],
    place: np.ndarray,
    clear: Callable[[np.ndarray, int], float],
    allowed: Callable[[np.ndarray], bool] | None = None,
) -> np.ndarray | None:
    """The best posture (n,) of the first of some searches, with their starts, that has one.

    Searches that shift frames against each other count only where these cannot coincide: where
    none that does not has a posture, ``allowed`` or not.
    """
    coincide = False

    def accepted(posture: np.ndarray, _number: int) -> bool:
        nonlocal coincide
        coincide = coincide or not shifted
        return allowed is None or allowed(posture)

    for search, starts in searches:
        shifted = any(k < 3 for target in search.targets for k in target.free)
        if not (coincide and shifted):
            rng = np.random.default_rng(0)
            reach = search.search([place], rng, starts, clear, accepted)
            if reach is not None:
                return reach.postures[0]
    return None


def joint_places(scene: Scene, joint: JointSpec) -> tuple[np.ndarray, np.ndarray]:
    """The joint frame in the tip's frame and its place in the world, z the joint's axis."""
    assert joint.at is not None, "the joint has a place"
    turn = np.eye(4)
    turn[:3, :3] = basis(joint.z_axis)
    on_tip = joint.on_first.matrix() @ joint.start_shift() @ turn
    body = scene.all_objects[joint.second.tip]
    return on_tip, body.pose.matrix() @ joint.at.matrix() @ turn


def clear_of(
    body: ObjectSpec, place: np.ndarray, meshes: bool = False
) -> Callable[[np.ndarray, np.ndarray], float]:
    """How well links keep apart from the object's box, and from the ground.

    Parameters
    ----------
    body : ObjectSpec
    place : ndarray, shape (4, 4)
        The joint's place in the world.
    meshes : bool
        Whether the box of a mesh counts, too.

    Returns
    -------
    callable
        Of the base (4, 4) and the origins of joints and tip (n + 1, 3) in the world: a factor on
        the quality of a posture, see :meth:`InverseKinematics.search`.
    """
    apart = apart_from(body, place[2, 3], meshes)

    def clear(base: np.ndarray, skeleton: np.ndarray) -> float:
        return apart(base, points_on_links(skeleton[:-1]), skeleton[2:-1, 2])

    return clear


def apart_from(
    body: ObjectSpec, height: float, meshes: bool
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], float]:
    """How well links keep apart from the object's box, and from the ground.

    Parameters
    ----------
    height : float
        Of the lowest place that is held [m].
    meshes : bool
        Whether the box of a mesh counts, too.

    Returns
    -------
    callable
        Of the base (4, 4), points on links (k, 3) and heights of joints in the world [m]: a factor
        on the quality of a posture.
    """
    pose = body.pose.matrix()
    solid = body.shape.solid if meshes or body.shape.mesh is None else None
    corners = None if solid is None else solid.bounding_box()

    def apart(base: np.ndarray, points: np.ndarray, heights: np.ndarray) -> float:
        outside = above = np.zeros(0)
        if corners is not None:
            seen = (points - pose[:3, 3]) @ pose[:3, :3]
            outside = np.maximum(corners[0] - seen, seen - corners[1]).max(axis=1)
        if base[2, 2] > 0.9 and base[2, 3] < height:  # upright, and lower than the place
            above = heights - base[2, 3]
        return clearance(outside, above)

    return apart
