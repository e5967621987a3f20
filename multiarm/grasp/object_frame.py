r"""The pose of the body from the positions of the fingertips.

In a form-closure grasp the body cannot move while the grippers stand still; so the contact points,
and the face that each touches, determine the pose (R, p_o) of its frame (thesis, 2.4). For contact
k on a face with outward normal :math:`n_k` and offset :math:`h_k` in the body's frame

.. math:: n_k^T R^T (p_k - p_o) = h_k, \qquad k = 1 \dots N .

For three pairs of parallel faces at distances :math:`l_i`, the origin half way between them, h is
l / 2 on both faces of a pair: (2.5)-(2.9) and (2.15)-(2.17) in one. The thesis solves a quadratic
in one component of :math:`n_1`, which breaks when E = 0 in (2.10), and its (2.11)-(2.13) hold for
rectangular blocks only. Here all N equations are solved together, for any body
(:mod:`multiarm.grasp.rotations_from_planes`): no axes are special, oblique and general bodies are
no harder, and all poses that fit are found. Which one is chosen, and how well it is known:
:mod:`multiarm.grasp.frame_solution`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.frame_data import ContactData, contact_data, numbers_of, table_of
from multiarm.grasp.frame_solution import (
    CONTRADICTION,
    DEVIATIONS,
    ROUNDING,
    FrameCandidate,
    ObjectFrame,
    solved,
)

if TYPE_CHECKING:
    from multiarm.grasp.polyhedron import Polyhedron

__all__ = [
    "FrameCandidate",
    "ObjectFrame",
    "object_frame_from_contacts",
    "object_frame_from_faces",
    "object_frame_on_body",
]

# The thesis's numbering: contacts 1 and 7 on face +1, 2 and 3 on +2 and +3, 4 to 6 opposite.
THESIS_FACES = (1, 2, 3, -1, -2, -3, 1)


def object_frame_from_contacts(
    points: Any,
    normals_in_object_frame: Any,
    distances: Any,
    *,
    faces: Sequence[int] = THESIS_FACES,
    point_covariance: Any = None,
    previous: ObjectFrame | Any = None,
    tolerance: float | None = None,
) -> ObjectFrame:
    """Pose of a body with three pairs of parallel faces, thesis (2.5)-(2.17).

    Parameters
    ----------
    points : array-like, shape (N, 3)
        Contact points in the world [m], N >= 7.
    normals_in_object_frame : array-like, shape (3, 3)
        Row i: outward unit normal of face +(i + 1), in object axes.
    distances : array-like, shape (3,)
        Distance between the two faces of each pair [m].
    faces : sequence of int
        Face of each contact: 1, 2, 3, or -1, -2, -3 for the opposite one.  Each occurs.  As in the
        thesis by default: contacts 1 and 7 on +1, 2 on +2, 3 on +3, 4, 5, 6 opposite.
    point_covariance, previous, tolerance
        As in :func:`object_frame_from_faces`.

    Returns
    -------
    ObjectFrame
        Its origin is half way between the faces of every pair.

    Raises
    ------
    GraspError
        Shapes; a pair of faces without a contact on both; contacts of one face that coincide, so
        that fewer than seven remain; distances that no pose fits.
    """
    normals = numbers_of(normals_in_object_frame, (3, 3), "normals_in_object_frame")
    lengths = numbers_of(distances, (3,), "distances")
    if np.any(lengths <= 0.0):
        raise GraspError(f"distances between parallel faces are positive, not {lengths.tolist()}")
    at = table_of(points, "points")
    numbers = _pairs(faces, at)
    pair, side = np.abs(numbers) - 1, np.sign(numbers)
    data = contact_data(
        at, side[:, None] * normals[pair], 0.5 * lengths[pair], point_covariance=point_covariance
    )
    _far_enough(data, numbers, lengths)
    return solved(data, previous, tolerance)


def object_frame_from_faces(
    points: Any,
    normals: Any,
    offsets: Any,
    *,
    polygons: Sequence[Any] | None = None,
    convex: bool = True,
    point_covariance: Any = None,
    previous: ObjectFrame | Any = None,
    tolerance: float | None = None,
) -> ObjectFrame:
    """Pose of any body with plane faces, from N >= 6 contacts.

    Parameters
    ----------
    points : array-like, shape (N, 3)
        Contact points in the world [m].
    normals : array-like, shape (N, 3)
        Row k: outward unit normal of the face that contact k touches, in object axes.
    offsets : array-like, shape (N,)
        ``n_k . b`` for points b of that face, in the object's frame [m].
    polygons : sequence of array-like, shape (K, 3) each, optional
        Corners of that face in the object's frame.
    convex : bool
        The body is convex: no contact lies beyond a face that another one touches.
    point_covariance : float or array-like, optional
        Of the points: one standard deviation [m], one per point (N,), or covariances (3, 3) or
        (N, 3, 3) in world axes [m^2].
    previous : ObjectFrame or array-like, shape (4, 4), optional
        A pose nearby; chooses when several fit.
    tolerance : float, optional
        Largest residual that is taken for noise [m]; five standard deviations, or a hundredth of
        the size of the grasp without ``point_covariance``.

    Returns
    -------
    ObjectFrame

    Raises
    ------
    GraspError
        Shapes, fewer than six contacts, normals that do not span space, data that no pose fits.
    """
    data = contact_data(
        points,
        normals,
        offsets,
        polygons=polygons,
        convex=convex,
        point_covariance=point_covariance,
    )
    return solved(data, previous, tolerance)


def object_frame_on_body(
    points: Any,
    body: Polyhedron,
    faces: Sequence[int],
    *,
    point_covariance: Any = None,
    previous: ObjectFrame | Any = None,
    tolerance: float | None = None,
) -> ObjectFrame:
    """Pose of a polyhedron; contact k touches ``body.faces[faces[k]]``.

    Otherwise as :func:`object_frame_from_faces`, which it calls with the faces' polygons, and with
    what is known of the body: on one that is not convex a contact may lie beyond the plane of a
    face that another one touches.

    Raises
    ------
    GraspError
        Numbers that are those of no face; and as there.
    """
    numbers = _integers(faces)
    wrong = [k for k in numbers.tolist() if k not in range(len(body.faces))]
    if wrong:
        raise GraspError(f"faces of the body are 0 to {len(body.faces) - 1}, not {wrong[0]}")
    touched = [body.faces[k] for k in numbers]
    return object_frame_from_faces(
        points,
        [face.normal for face in touched],
        [face.offset for face in touched],
        polygons=[face.vertices for face in touched],
        convex=body.convex,
        point_covariance=point_covariance,
        previous=previous,
        tolerance=tolerance,
    )


def _integers(faces: Sequence[int]) -> np.ndarray:
    given = np.asarray(list(faces))
    if given.ndim != 1 or given.dtype.kind not in "iuf" or np.any(given != np.round(given)):
        raise GraspError(f"faces are whole numbers, one for each contact, not {list(faces)!r}")
    return given.astype(int)


def _pairs(faces: Sequence[int], points: np.ndarray) -> np.ndarray:
    """Face numbers as an array; every face of the three pairs must be touched."""
    numbers = _integers(faces)
    if len(numbers) != len(points):
        raise GraspError(
            f"each contact needs the number of its face: {len(numbers)} numbers for "
            f"{len(points)} points; seven in the thesis's order need none, others need faces="
        )
    missing = [k for k in (1, 2, 3, -1, -2, -3) if k not in numbers]
    if missing or np.any(np.abs(numbers) > 3) or np.any(numbers == 0):
        raise GraspError(
            f"faces are 1, 2, 3 and -1, -2, -3 for the opposite ones, each with a contact; missing "
            f"in {numbers.tolist()}: {missing}. Form closure needs a contact on each face"
        )
    return numbers


def _far_enough(data: ContactData, numbers: np.ndarray, lengths: np.ndarray) -> None:
    """Seven different contacts; those on opposite faces at least the faces' distance apart."""
    apart = np.linalg.norm(data.points[:, None] - data.points[None], axis=-1)
    same = [
        (i + 1, j + 1)
        for i in range(data.count)
        for j in range(i)
        if numbers[i] == numbers[j] and apart[i, j] <= ROUNDING * data.length
    ]
    if data.count - len(same) < 7:
        if same:
            j, i = sorted(same[0])
            raise GraspError(
                f"contacts {j} and {i}, both on face {numbers[i - 1]}, coincide; seven different "
                f"contacts are needed, two of them apart on one face"
            )
        raise GraspError(f"seven contacts are needed, not {data.count}")
    slack = max(CONTRADICTION * data.length, DEVIATIONS * data.deviation)
    for i, j in np.argwhere(numbers[:, None] + numbers[None] == 0):
        if apart[i, j] < lengths[abs(numbers[i]) - 1] - slack:
            raise GraspError(
                f"contacts {i + 1} and {j + 1} are on faces {numbers[i]} and {numbers[j]}, "
                f"{lengths[abs(numbers[i]) - 1]:.6g} m apart, but only {apart[i, j]:.6g} m from "
                f"each other"
            )
