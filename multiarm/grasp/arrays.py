"""Arrays of numbers as users give them."""

from __future__ import annotations

from typing import Any

import numpy as np

from multiarm.errors import GraspError


def array_of(values: Any, refusal: str) -> np.ndarray:
    """The values as an array of floats, own memory; a GraspError that says ``refusal`` if not."""
    try:
        return np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise GraspError(refusal) from error
