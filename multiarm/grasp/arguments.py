"""Arguments of this package's functions: numbers, arrays, poses and unit vectors, checked."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.scene.values import is_finite

Shape = tuple[Any, ...]
# A normal is a unit vector when its length is off by no more than this; it is then made exact.
UNIT_TOLERANCE = 1e-6
# Messages show arrays of up to this many numbers, and the shape of larger ones.
SHOWN = 7
# How far the product of a rotation matrix with its transpose may be from the identity.
RIGID = 1e-6


def number_of(
    value: Any, needed: str, *, above: float = -math.inf, at_least: float = -math.inf
) -> float:
    """A finite number within its bounds; else a GraspError that begins with ``needed``."""
    if isinstance(value, bool) or not (is_finite(value) and value > above and value >= at_least):
        raise GraspError(f"{needed}, not {value!r}")
    return float(value)


def generator_of(value: Any, name: str) -> np.random.Generator:
    """The generator of random numbers that is passed, or the one of a seed.

    Raises
    ------
    GraspError
        It is neither; the message begins with ``name``.
    """
    try:
        return np.random.default_rng(value)
    except (TypeError, ValueError) as error:
        raise GraspError(
            f"{name} is an integer of at least 0 or a generator, not {value!r}"
        ) from error


def numbers_of(values: Any, needed: str, *shapes: Shape, infinite: bool = False) -> np.ndarray:
    """A copy of the values as an array of floats.

    Parameters
    ----------
    values : array-like
    needed : str
        What they should be; the message begins with it.
    *shapes : tuple
        Allowed shapes.  A length -n stands for n or more, None for any; an ellipsis in front for
        any number of lengths.
    infinite : bool
        Whether numbers may be infinite.

    Raises
    ------
    GraspError
        They are something else.
    """
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise GraspError(f"{needed}, not {values!r}") from error
    if not any(_fits(array.shape, shape) for shape in shapes):
        shown = array.tolist() if array.size <= SHOWN else f"of shape {array.shape}"
        raise GraspError(f"{needed}, not {shown}")
    wrong = np.isnan(array) if infinite else ~np.isfinite(array)
    if wrong.any() and array.ndim < 2:
        raise GraspError(f"{needed}, not {array.tolist()}")
    if wrong.any():
        first = int(np.argwhere(wrong)[0, 0])
        raise GraspError(f"{needed}; number {first + 1} is {array[first].tolist()}")
    return array


def pose_of(values: Any, needed: str) -> np.ndarray:
    """A pose (4, 4), rigid but for seven digits; else a GraspError that begins with ``needed``."""
    pose = numbers_of(values, needed, (4, 4))
    R = pose[:3, :3]
    off = max(np.abs(R.T @ R - np.eye(3)).max(), np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max())
    if off > RIGID or np.linalg.det(R) < 0.0:
        raise GraspError(needed)
    return pose


def _fits(lengths: Shape, shape: Shape) -> bool:
    if shape[:1] == (...,):
        shape = shape[1:]
        lengths = lengths[max(len(lengths) - len(shape), 0) :]
    return len(lengths) == len(shape) and all(
        m is None or (n >= -m if m < 0 else n == m) for n, m in zip(lengths, shape, strict=True)
    )


def unit_vectors(vectors: np.ndarray, remedy: str = "") -> np.ndarray:
    """Vectors (..., d) of length 1 but for rounding, with that taken away.

    Raises
    ------
    GraspError
        One has another length.
    """
    lengths = np.linalg.norm(vectors, axis=-1)
    wrong = np.argwhere(np.abs(lengths - 1.0) > UNIT_TOLERANCE)
    if len(wrong):
        place = tuple(wrong[0])
        number = " of set ".join(str(k + 1) for k in reversed(place)) or "1"
        raise GraspError(
            f"normal {number}, {vectors[place].tolist()}, has length {lengths[place]:.6g}, not "
            f"1{remedy}"
        )
    return vectors / lengths[..., None]
