"""Long runs in few points: what a figure can show, at a cost that does not grow with the run.

`decimate` walks through the samples in blocks and keeps the smallest and the largest value of
each interval of time, so that a peak of a single sample among millions is still drawn, and
memory does not depend on the length of the run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from multiarm.results.trajectory import Trajectory

POINTS = 1600
BLOCK_SAMPLES = 8192


def decimate(
    trajectory: Trajectory,
    names: Sequence[str],
    combine: Callable[..., np.ndarray] | None = None,
    points: int = POINTS,
) -> tuple[np.ndarray, np.ndarray]:
    """A run in at most about `points` points that keep every peak.

    Parameters
    ----------
    trajectory : Trajectory
    names : sequence of str
        Channels, handed to `combine` block by block in this order.
    combine : callable, optional
        Blocks of the channels, shapes (k, ...), to columns, shape (k, m). By default the
        channels' columns side by side. Blocks come in order of time.
    points : int
        A shorter run is returned as it is.

    Returns
    -------
    time : ndarray, shape (p,)
    values : ndarray, shape (p, m)
        In each interval the smallest and the largest value, in the order in which they occur;
        the first and the last sample are exact.
    """
    combine = combine or (lambda *blocks: np.column_stack([_columns(block) for block in blocks]))
    width = max(1, -(-2 * len(trajectory) // points)) if len(trajectory) > points else 1
    times: list[np.ndarray] = []
    columns: list[np.ndarray] = []
    last: tuple[np.ndarray, ...] = ()
    for time, *blocks in trajectory.blocks(
        "time", *names, samples=width * max(1, BLOCK_SAMPLES // width)
    ):
        values = combine(*blocks)
        if width > 1:
            if not times:
                times, columns = [time[:1]], [values[:1]]
            last = time[-1:], values[-1:]
            time, values = _extremes(time, values, width)
        times.append(time)
        columns.append(values)
    if not times:
        return np.empty(0), combine(*(trajectory.read(name) for name in names))
    if last:
        times.append(last[0])
        columns.append(last[1])
    return np.concatenate(times), np.concatenate(columns)


class RotationSinceStart:
    """Rotation vectors of R(t) R(0)^T, without jumps when the angle exceeds half a turn.

    A rotation vector is an axis times an angle in [0, pi]. Past half a turn the axis flips;
    flipping it back makes the angle continuous up to whole turns, which `unwrap` removes.

    ``start`` is the quaternion xyzw of R(0), shape (1, 4), or (0, 4) of a run without samples.
    """

    def __init__(self, start: np.ndarray):
        self._start = start
        self._axis, self._angle = np.zeros(3), 0.0

    def __call__(self, quaternions: np.ndarray) -> np.ndarray:
        """The next quaternions in time, shape (k, 4), to vectors in world axes, (k, 3) [rad]."""
        if not len(quaternions):
            return np.empty((0, 3))
        vector, scalar = _relative(quaternions, self._start[0])
        sine = np.linalg.norm(vector, axis=1)
        angle = 2 * np.arctan2(sine, scalar)
        axis = vector / np.where(sine > 0, sine, 1)[:, None]
        before = np.vstack([self._axis, axis[:-1]])
        flips = np.where(np.einsum("ij,ij->i", axis, before) < 0, -1.0, 1.0)
        signs = np.cumprod(flips)
        turned = np.unwrap(np.concatenate([[self._angle], signs * angle]))[1:]
        self._axis, self._angle = signs[-1] * axis[-1], turned[-1]
        return (signs * turned)[:, None] * axis


def _relative(q: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vector part and scalar part (not negative) of q * conj(start), xyzw."""
    vector = start[3] * q[:, :3] - q[:, 3:] * start[:3] - np.cross(q[:, :3], start[:3])
    scalar = q[:, 3] * start[3] + q[:, :3] @ start[:3]
    sign = np.where(scalar < 0, -1.0, 1.0)
    return sign[:, None] * vector, sign * scalar


def _extremes(time: np.ndarray, values: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    starts = np.arange(0, len(time), width)
    ends = np.minimum(starts + width, len(time)) - 1
    padded = np.concatenate([values, np.repeat(values[-1:], len(starts) * width - len(time), 0)])
    groups = padded.reshape(len(starts), width, values.shape[1])
    low, high = groups.min(axis=1), groups.max(axis=1)
    rising = groups.argmin(axis=1) <= groups.argmax(axis=1)
    pairs = np.stack([np.where(rising, low, high), np.where(rising, high, low)], axis=1)
    points = pairs.reshape(2 * len(starts), -1)
    return np.column_stack([time[starts], time[ends]]).ravel(), points


def _columns(block: np.ndarray) -> np.ndarray:
    return block.reshape(len(block), math.prod(block.shape[1:]))
