"""Interpreted kernels: with ``NUMBA_DISABLE_JIT=1`` the same source runs as plain Python.

A debugger then stops in kernels, ``print`` prints anything, an index out of range raises
IndexError, and coverage counts their lines; it takes some hundred times as long.

What this package generates itself (views of structs, packs, calls by address) Python cannot run.
Each such operation has a twin beside it that does the same to Python's and NumPy's objects: a view
is an object with properties, a pack an array of four numbers, and an address of a function is a key
of :mod:`multiarm.jit.pointers`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import config
from numba.extending import intrinsic

# Read once, as Numba does: kernels of both sorts cannot call each other.
INTERPRETED = bool(config.DISABLE_JIT)


def generated(twin: Callable) -> Callable[[Callable], Any]:
    """Decorator like Numba's ``intrinsic``, of a function that types and generates an operation.

    Where kernels are interpreted, ``twin`` is called instead.
    """

    def choose(typing: Callable) -> Any:
        return twin if INTERPRETED else intrinsic(typing)

    return choose
