r"""From the grippers of a grasp to hands on arms: rigid fingers, and the contacts that they make.

A hand's frame ``corner`` is the gripper's frame; in the joint it coincides with the corner of the
object.  The hand comes from outside, along a mean of the inward normals of the faces that it
touches, so that its palm and its fingers stay on the outer side of all of them; how it is turned
about this direction is left to the search for postures.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.face import frame_of
from multiarm.grasp.face_contacts import FaceContacts, Gripper
from multiarm.spatial import matrix_to_quaternion

# Fingers of a small gripper are at least so long [m]; those of a large one grow with it.
SHORTEST, SLENDER = 0.1, 0.6
# The palm clears every face that the gripper touches by so many radii of a fingertip.
CLEAR = 6.0
# Digits of lengths in a scene, and of directions.
DIGITS, DIRECTION_DIGITS = 12, 15


def approach(grasp: FaceContacts, gripper: Gripper, level: float = 1.0) -> np.ndarray:
    """Direction (3,) along which a gripper comes to the body, in the body's frame.

    Parameters
    ----------
    level : float
        Weight of the faces that look up or down, relative to the others: with a small one the hand
        comes from the side.

    Raises
    ------
    GraspError
        The gripper touches faces around so sharp an edge that no direction clears them all.
    """
    faces = sorted({grasp.faces[j] for j in gripper.contacts})
    inward = -np.array([grasp.body.faces[k].normal for k in faces])
    weights = np.where(np.abs(inward[:, 2]) > 0.7, level, 1.0)
    direction = weights @ inward
    length = float(np.linalg.norm(direction))
    if length < 1e-6 or np.min(inward @ direction) < 0.05 * length:
        raise GraspError(
            f"gripper '{gripper.name}' touches faces that look away from each other; no rigid hand "
            "reaches them from one side"
        )
    return direction / length


def hand_pose(
    grasp: FaceContacts, gripper: Gripper, turn: float, tip_radius: float, level: float = 1.0
) -> np.ndarray:
    """Pose (4, 4) of the mount in the body's frame; its z axis points to the corner.

    It stands off as far as slender fingers need that stay clear of all faces that are touched.

    Parameters
    ----------
    turn : float
        About that axis [rad].
    level : float
        As for :func:`approach`.
    """
    z = approach(grasp, gripper, level)
    faces = sorted({grasp.faces[j] for j in gripper.contacts})
    steepest = min(float(-grasp.body.faces[k].normal @ z) for k in faces)
    stand_off = max(
        SHORTEST, SLENDER * grasp.gripper_size(gripper.name), CLEAR * tip_radius / steepest
    )
    side = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    side /= np.linalg.norm(side)
    x = np.cos(turn) * side + np.sin(turn) * np.cross(z, side)
    return frame_of(z, x, gripper.corner - stand_off * z)


def fingers(
    grasp: FaceContacts, gripper: Gripper, mount: np.ndarray, tip_radius: float, mass: float
) -> dict[str, Any]:
    """The hand as a scene writes it under ``tool: {fingers: ...}``.

    Parameters
    ----------
    mount : ndarray, shape (4, 4)
        From :func:`hand_pose`.
    """
    return {
        "tips": _rounded(_tips(grasp, gripper, tip_radius)),
        "radius": tip_radius,
        "corner": pose_table(np.linalg.solve(mount, gripper.frame)),
        "mass": mass,
    }


def contacts(grasp: FaceContacts, gripper: Gripper, tip_radius: float) -> list[dict[str, Any]]:
    """The gripper's contacts as a scene writes them, in the frame of the corner."""
    R = gripper.frame[:3, :3]
    tips = _tips(grasp, gripper, tip_radius)
    written = []
    for j, tip in zip(gripper.contacts, tips, strict=True):
        outward = -R.T @ grasp.contacts.normals[j]
        face = grasp.body.faces[grasp.faces[j]]
        corners = (face.vertices - gripper.corner) @ R
        plane: dict[str, Any] = {
            "point": _rounded(corners[0]),
            "normal": _rounded(outward, DIRECTION_DIGITS),
        }
        patch = _patch(corners, outward)
        if patch is not None:
            plane["patch"] = patch
        written.append(
            {
                "name": f"{grasp.contacts.names[j]} on {face.name}",
                "arm": {"sphere": {"center": _rounded(tip), "radius": tip_radius}},
                "object": {"plane": plane},
            }
        )
    return written


def pose_table(pose: np.ndarray) -> dict[str, list[float]]:
    """A pose (4, 4) as a scene writes it."""
    quaternion = matrix_to_quaternion(pose[:3, :3])
    return {"xyz": _rounded(pose[:3, 3]), "quaternion_xyzw": _rounded(quaternion, DIRECTION_DIGITS)}


def require_room(grasp: FaceContacts, tip_radius: float) -> None:
    """Refuse fingertips that overlap, or that do not fit onto their faces.

    Raises
    ------
    GraspError
        Naming the contacts, how far apart they are, and the remedy.
    """
    points, names = grasp.contacts.points, grasp.contacts.names
    centres = points - tip_radius * grasp.contacts.normals
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    apart[np.diag_indices(len(centres))] = np.inf
    i, j = divmod(int(np.argmin(apart)), len(centres))
    if apart[i, j] < 2.0 * tip_radius:
        raise GraspError(
            f"fingertips of radius {tip_radius:g} m do not fit: those of {names[i]} and {names[j]} "
            f"would be {apart[i, j]:.3g} m apart; choose a smaller tip_radius or larger grippers"
        )


def _tips(grasp: FaceContacts, gripper: Gripper, tip_radius: float) -> np.ndarray:
    """Centres of the fingertips in the gripper's frame, outside the faces."""
    chosen = list(gripper.contacts)
    centres = grasp.contacts.points[chosen] - tip_radius * grasp.contacts.normals[chosen]
    return (centres - gripper.corner) @ gripper.frame[:3, :3]


def _patch(corners: np.ndarray, normal: np.ndarray) -> dict[str, Any] | None:
    """The face as a box in the corner's axes, where it is a rectangle along them."""
    axis = int(np.argmax(np.abs(normal)))
    if abs(normal[axis]) < 1.0 - 1e-9 or len(corners) != 4:
        return None
    low, high = corners.min(axis=0), corners.max(axis=0)
    at_low, at_high = np.abs(corners - low) < 1e-9, np.abs(corners - high) < 1e-9
    if not np.all(at_low | at_high):
        return None
    bounds = [
        [None if k == axis else round(float(end[k]), DIGITS) for k in range(3)]
        for end in (low, high)
    ]
    return {"min": bounds[0], "max": bounds[1]}


def _rounded(values: np.ndarray, digits: int = DIGITS) -> Any:
    return (np.round(values, digits) + 0.0).tolist()
