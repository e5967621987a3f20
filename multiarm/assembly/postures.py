"""Joint positions that the program finds: of arms whose joint has a place on the object.

A scene says ``posture: solve``, or gives no posture where the arm's joints at zero are far from the
joint.  The posture is then one with which the joint's two frames coincide at the start, or, where
there is none, coincide but for the motions that the joint leaves free.  Of many, the one is taken
that is farthest from singular postures, from the limits of its joints, from the object and from the
ground on which the base stands (:mod:`multiarm.assembly.inverse_kinematics`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.assembly.inverse_kinematics import InverseKinematics, clearance, points_on_links
from multiarm.errors import SceneError
from multiarm.geometry.records import basis
from multiarm.scene import JointSpec, ObjectSpec, Scene
from multiarm.scene.faults import place
from multiarm.scene.values import SOLVE

# Postures at which the search begins: half a millisecond each.
STARTS = 96
# Joints at zero that bring the tip nearer than this part of the arm's length are assembled instead.
NEAR = 0.1
# Angles to the place below this need no words [deg].
NO_TURN = 1.0


def find_postures(
    scene: Scene, arms: Mapping[str, Arm], written: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Positions [rad, m] of the joints that the scene leaves to the program, by arm.

    Parameters
    ----------
    scene : Scene
    arms : mapping arm -> Arm
    written : mapping arm -> (n,)
        Postures as the scene has them.

    Raises
    ------
    SceneError
        Naming every arm that cannot reach its place, how near it comes, and what to move.
    """
    found, faults = {}, []
    for number, joint in enumerate(scene.joints):
        arm, posture = arms[joint.arm], scene.arms[joint.arm].posture
        where = place(("arms", joint.arm, "posture"))
        if joint.at is None:
            if posture == SOLVE:
                faults.append(
                    f"{where}: 'solve' needs the joint's place on the object: give "
                    f"$.joints[{number}].at"
                )
            continue
        if posture == SOLVE or (posture is None and _is_far(scene, joint, arm, written[joint.arm])):
            positions = _posture(scene, joint, arm)
            if isinstance(positions, str):
                faults.append(f"{where}: {positions} ($.joints[{number}].at)")
            else:
                found[joint.arm] = positions
    if faults:
        raise SceneError(faults)
    return found


def joint_places(scene: Scene, joint: JointSpec) -> tuple[np.ndarray, np.ndarray]:
    """The joint frame in the tip's frame and its place in the world, z the joint's axis."""
    assert joint.at is not None, "the joint has a place"
    turn = np.eye(4)
    turn[:3, :3] = basis(joint.z_axis)
    on_tip = joint.at_tip.matrix() @ joint.start_shift() @ turn
    return on_tip, scene.object.pose.matrix() @ joint.at.matrix() @ turn


def _is_far(scene: Scene, joint: JointSpec, arm: Arm, posture: np.ndarray) -> bool:
    """Whether a posture leaves a gap in the joint that no assembly would close."""
    if joint.as_listed:  # its contacts may be anywhere
        return False
    on_tip, there = joint_places(scene, joint)
    here = arm.tip_pose(posture) @ on_tip
    gap = there[:3, :3].T @ (here[:3, 3] - there[:3, 3])
    gap[[k for k in joint.free or () if k < 3]] = 0.0
    return bool(np.linalg.norm(gap) > NEAR * np.max(arm.levers(on_tip[:3, 3])))


def _posture(scene: Scene, joint: JointSpec, arm: Arm) -> np.ndarray | str:
    """Joint positions, or why there are none."""
    on_tip, there = joint_places(scene, joint)
    clear_of_object = clear_of(scene.object, there)

    def clear(skeleton: np.ndarray, _number: int) -> float:
        return clear_of_object(arm.files.base, skeleton)

    for free in dict.fromkeys([(), joint.free or ()]):
        search = InverseKinematics(arm, free, on_tip)
        reach = search.search([there], np.random.default_rng(0), STARTS, clear)
        if reach is not None:
            return reach.postures[0]
    miss = search.nearest(there, np.random.default_rng(0), STARTS)
    turn = np.rad2deg(miss.turn)
    shift = ", ".join(f"{x:.3f}" for x in miss.shift)
    turned = f" and {turn:.0f} deg" if turn > NO_TURN and not free else ""
    return (
        f"no joint positions within the limits bring the tip to its place on the object; the "
        f"nearest posture leaves {np.linalg.norm(miss.shift):.3f} m{turned}; move the base by "
        f"[{shift}] m{', and turn it,' if turned else ''} or choose another place"
    )


def clear_of(body: ObjectSpec, there: np.ndarray) -> Callable[[np.ndarray, np.ndarray], float]:
    """How well links keep apart from the object's box, and from the ground.

    Parameters
    ----------
    body : ObjectSpec
    there : ndarray, shape (4, 4)
        The joint's place in the world.

    Returns
    -------
    callable
        Of the base (4, 4) and the origins of joints and tip (n + 1, 3) in the world: a factor on
        the quality of a posture, see :meth:`InverseKinematics.search`.
    """
    pose, corners = body.pose.matrix(), _bounding_box(body)

    def clear(base: np.ndarray, skeleton: np.ndarray) -> float:
        outside = above = np.zeros(0)
        if corners is not None:
            seen = (points_on_links(skeleton[:-1]) - pose[:3, 3]) @ pose[:3, :3]
            outside = np.maximum(corners[0] - seen, seen - corners[1]).max(axis=1)
        if base[2, 2] > 0.9 and base[2, 3] < there[2, 3]:  # upright, and lower than its place
            above = skeleton[2:-1, 2] - base[2, 3]
        return clearance(outside, above)

    return clear


def _bounding_box(body: ObjectSpec) -> tuple[np.ndarray, np.ndarray] | None:
    """Least and largest coordinates of the object's shape in its frame [m]; None of a mesh."""
    shape = body.shape
    if shape.box is not None:
        half = 0.5 * np.array(shape.box)
    elif shape.sphere is not None:
        half = np.full(3, shape.sphere)
    elif shape.cylinder is not None:
        radius = shape.cylinder.radius
        half = np.array([radius, radius, 0.5 * shape.cylinder.height])
    elif shape.hull is not None:
        points = np.array(shape.hull)
        return points.min(axis=0), points.max(axis=0)
    else:
        return None
    return -half, half
