"""Functions of users: calls of them with a clear error for every result that cannot be used."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from multiarm.errors import USER_FAULTS, ModelError

UserFunction = Callable[[np.ndarray], np.ndarray]


def checked(
    function: Callable, name: str, role: str, shape: tuple[int, ...], spread: bool = False
) -> UserFunction:
    """The function, with a clear error for every unusable result.

    Parameters
    ----------
    function : callable
        Of an array, or of its entries one by one (``spread``).
    name, role : str
        Messages say ``the <role> of <name>``.
    shape : tuple of int
        Of its result; ``()``: one number.
    """
    return partial(_evaluated, function, f"the {role} of {name}", shape, spread)


def shown(x: np.ndarray) -> str:
    """Numbers for a message."""
    return np.array2string(np.asarray(x), precision=6, separator=", ")


def _evaluated(
    function: Callable, subject: str, shape: tuple[int, ...], spread: bool, x: np.ndarray
) -> np.ndarray:
    try:
        value = np.asarray(function(*x) if spread else function(x))
    except USER_FAULTS as error:
        raise ModelError(
            f"{subject} failed at {_place(x)}: {type(error).__name__}: {error}; "
            "correct the function"
        ) from error
    if value.size == 1 and shape == ():
        value = value.reshape(())
    if value.shape != shape or value.dtype.kind not in "fciu":
        what = "one number" if shape == () else f"numbers of shape {shape}"
        got = f"shape {value.shape}" if value.shape != shape else f"{value.dtype}"
        raise ModelError(f"{subject} must return {what}, got {got} at {_place(x)}")
    if not np.all(np.isfinite(value)):
        raise ModelError(f"{subject} is not finite at {_place(x)}: {shown(value)}")
    return value


def _place(x: np.ndarray) -> str:
    """A point for a message; imaginary parts serve differentiation only."""
    if not np.iscomplexobj(x):
        return shown(x)
    return f"{shown(np.real(x))} (called with complex numbers, which differentiate it)"
