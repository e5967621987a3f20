"""Torques on a tape, played by compiled code.

A program that is called back for its torques should not wait for Python when they are known
beforehand: they are written row by row, in the order in which it asks, and a compiled function
copies the next row to where the program reads it.
"""

from __future__ import annotations

import numpy as np
from numba import cfunc, types

from multiarm.jit.structs import floats_at, struct_at

_NEXT, _WIDTH, _LAST = 1, 2, 3


class TorqueTape:
    """Rows of torques that :attr:`play` copies to ``target``, one a call; the last one stays.

    Parameters
    ----------
    target : ndarray, shape (n,)
        Where the program reads its torques; must stay where it is.

    Attributes
    ----------
    play : ctypes function ``void (void *, void *)``
        It looks at none of its arguments.
    """

    def __init__(self, target: np.ndarray):
        assert target.flags.c_contiguous and target.dtype == np.float64
        # address of the next row's tape, next row, width, last row; address of the target
        self._state = np.array([0, 0, target.size, 0, target.ctypes.data], dtype=np.int64)
        self._rows = np.zeros((0, target.size))
        self._target = target
        address = self._state.ctypes.data

        @cfunc(types.void(types.intp, types.intp))
        def play(_model, _data):
            state = struct_at(address, 5)
            width = state[_WIDTH]
            row = floats_at(state[0] + 8 * width * state[_NEXT], width)
            out = floats_at(state[4], width)
            for i in range(width):
                out[i] = row[i]
            state[_NEXT] = min(state[_NEXT] + 1, state[_LAST])

        self._function = play
        self.play = play.ctypes

    def load(self, rows: np.ndarray) -> None:
        """Put rows (K, n) on the tape, and go to the first."""
        self._rows = np.ascontiguousarray(rows, dtype=float)
        self._state[0] = self._rows.ctypes.data
        self._state[_NEXT], self._state[_LAST] = 0, len(rows) - 1

    @property
    def played(self) -> int:
        """Number of the next row."""
        return int(self._state[_NEXT])
