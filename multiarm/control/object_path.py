r"""The reference of laws that move the object: from rest to rest through poses.

From one waypoint to the next the object moves along a line and about a fixed axis, with the part

.. math:: s(x) = 10 x^3 - 15 x^4 + 6 x^5, \qquad x = (t - t_s) / (t_{s+1} - t_s),

of the displacement :math:`\Delta p` and the rotation vector :math:`\Delta\theta` (world axes); so
:math:`p_r = p_s + s\,\Delta p`, :math:`R_r = \exp(s\,\Delta\theta)\,R_s`, the reference's twist is
:math:`\dot s\,[\Delta p; \Delta\theta]` and its acceleration :math:`\ddot s\,[\Delta p;
\Delta\theta]`.  Before the first waypoint and after the last one it rests.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.piecewise import segment_at
from multiarm.geometry.frame_motion import FrameMotion
from multiarm.jit.kernels import inlined, kernel, plain
from multiarm.jit.structs import Floats1, Floats2, Floats3
from multiarm.jit.vectors import add_scaled, scale, vec
from multiarm.scene import Pose, Waypoint
from multiarm.spatial import difference, matrix_to_quaternion, retracted


class PosePath(NamedTuple):
    """A path of S segments between poses."""

    times: Floats1  # (S + 1,) [s], of the waypoints
    positions: Floats2  # (S, 3) at the begin of each segment [m]
    shifts: Floats2  # (S, 3) displacement to the next waypoint [m]
    quaternions: Floats2  # (S, 4) xyzw, at the begin of each segment
    turns: Floats2  # (S, 3) rotation vector to the next waypoint, world axes [rad]


def pose_path(times: Sequence[float], poses: Sequence[np.ndarray]) -> PosePath:
    """The path through poses (4, 4) at times [s]."""
    quaternions = np.array([matrix_to_quaternion(pose[:3, :3]) for pose in poses])
    turns = np.array([difference(begin, end) for begin, end in pairwise(quaternions)])
    positions = np.array([pose[:3, 3] for pose in poses])
    return PosePath(
        np.array(times), positions[:-1], np.diff(positions, axis=0), quaternions[:-1], turns
    )


class PosePaths(NamedTuple):
    """Paths of P objects, each filled up with segments of rest at its end."""

    times: Floats2  # (P, S + 1)
    positions: Floats3  # (P, S, 3)
    shifts: Floats3
    quaternions: Floats3  # (P, S, 4)
    turns: Floats3

    @classmethod
    def of(cls, paths: Sequence[PosePath]) -> PosePaths:
        """The table of some paths."""
        segments = max((len(path.shifts) for path in paths), default=1)
        longer = [_resting_on(path, segments) for path in paths]
        return cls(*(np.array(parts) for parts in zip(*longer, strict=True)))


def _resting_on(path: PosePath, segments: int) -> PosePath:
    """The path with segments of a second each in which the object rests, after its end."""
    more = segments - len(path.shifts)
    times = np.append(path.times, path.times[-1] + 1.0 + np.arange(more))
    end = path.positions[-1] + path.shifts[-1]
    at_rest = retracted(path.quaternions[-1], path.turns[-1])
    none = np.zeros((more, 3))
    return PosePath(
        times,
        np.vstack([path.positions, np.tile(end, (more, 1))]),
        np.vstack([path.shifts, none]),
        np.vstack([path.quaternions, np.tile(at_rest, (more, 1))]),
        np.vstack([path.turns, none]),
    )


def pose_of(motion: FrameMotion) -> Pose:
    """Pose of an object in a state."""
    return Pose(xyz=motion.position.tolist(), quaternion_xyzw=motion.quaternion_xyzw.tolist())


def route(start: np.ndarray, path: Sequence[Waypoint]) -> tuple[list[float], list[np.ndarray]]:
    """Times and poses (4, 4) of a path; one that does not begin at time 0 begins at ``start``."""
    times = [waypoint.time for waypoint in path]
    poses = [waypoint.matrix() for waypoint in path]
    if times[0] > 0.0:
        times.insert(0, 0.0)
        poses.insert(0, start)
    return times, poses


@plain
def quintic(x):
    """Part of the way from rest to rest in the part ``x`` of the time, and its derivatives by x."""
    part = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
    return part, 30.0 * (x * (1.0 - x)) ** 2, 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)


@inlined
def path_of(paths, p):
    """One path of a table with the fields of :class:`PosePaths`."""
    return PosePath(
        paths.times[p], paths.positions[p], paths.shifts[p], paths.quaternions[p], paths.turns[p]
    )


@kernel
def reference_pose(t, path):
    """Reference of the object at ``t``: position (3,), quaternion (4,), and how it moves.

    It moves along ``shift`` and about ``turn``, the displacement and the rotation vector of its
    segment; ``rate`` [1/s] and ``second`` [1/s^2] are the derivatives of the part that is covered.
    ``path`` has the fields of :class:`PosePath`.
    """
    s = segment_at(path.times, t)
    begin, length = path.times[s], path.times[s + 1] - path.times[s]
    x = min(max((t - begin) / length, 0.0), 1.0)
    part, rate, second = quintic(x)
    shift, turn = vec(path.shifts[s], 0), vec(path.turns[s], 0)
    position = add_scaled(vec(path.positions[s], 0), part, shift)
    quaternion = retracted(path.quaternions[s], scale(part, turn))
    return position, quaternion, shift, turn, rate / length, second / length**2


def reference_motion(t: float, path: PosePath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reference of the object at ``t``: quaternion xyzw (4,), twist (6,), acceleration (6,)."""
    _, quaternion, shift, turn, rate, second = reference_pose(t, path)
    displacement = np.array([*shift, *turn])
    return np.array(quaternion), rate * displacement, second * displacement
