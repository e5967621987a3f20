"""Three numbers for the axes of a body or of the world, or one that stands for all."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from multiarm.scene.values import fault, number_list
from multiarm.scene.words import shown

__all__ = ["axis_numbers"]


def axis_numbers(axes: str, value: Any) -> tuple[float, ...]:
    """Return three numbers from one for all of some ``axes``, or three, refusing negative ones."""
    value = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(value, (list, tuple)) and len(value) == 3:
        numbers = tuple(number_list(value))
    elif isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value):
        numbers = (float(value),) * 3
    else:
        raise fault(f"must be a number, or a list of 3 for {axes}, got {shown(value)}")
    if min(numbers) < 0.0:
        raise fault(f"must not be negative, got {shown(value)}")
    return numbers
