"""Functions of the user's that an evaluation asks: controllers, wrenches from outside.

``f(t, state)`` is called from compiled code with the time and a copy of the state being evaluated.
Its answer is checked and copied into an array that the kernels read.

A rerun that checks a run asks again from the beginning.  A function that integrates, counts or
draws random numbers then answers otherwise, and the two runs are not the same motion.  So some
questions are kept with their answers, the 1st, 2nd, 4th, 8th ..., and can be put once more.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from multiarm.dynamics.arrays import BUSY, Buffers
from multiarm.dynamics.state import Layout, State
from multiarm.errors import USER_FAULTS, ControlError, MultiarmError
from multiarm.jit.pointers import PythonCallback

# Answers that differ by less than this, relative to the largest of those kept, are the same.
SAME = 1e-9


class Asked(PythonCallback):
    """A function of the user's, to be called from compiled code; ``name`` says which.

    Systems of several threads may ask one function: each has an instance of this for itself.

    Parameters
    ----------
    function : callable
        ``f(t, state)``, with the time [s] and a :class:`multiarm.dynamics.state.State` of its own.
    name : str
        What it is, such as "the controller".
    read : callable
        Turns an answer into a new vector; raises ``ControlError`` for one that cannot be used.
    out : ndarray
        Where that is copied.
    layout : Layout
    buffers : Buffers
    """

    def __init__(
        self,
        function: Callable[[float, State], Any],
        name: str,
        read: Callable[[Any], np.ndarray],
        out: np.ndarray,
        layout: Layout,
        buffers: Buffers,
    ) -> None:
        self.function, self.name, self._read = function, name, read
        self._out, self._layout, self._buffers = out, layout, buffers
        self._count, self._kept = 0, []  # type: ignore[var-annotated]
        super().__init__(self._write_answer, buffers.flag)

    def remembers(self) -> bool:
        """Whether the function answers kept questions otherwise than it did.

        Those that it cannot answer any more are left out.
        """
        apart = largest = 0.0
        for t, state, given in reversed(self._kept):
            try:
                found = self._answer(t, state.copy())
            except MultiarmError:
                continue
            largest = max(largest, float(np.max(np.abs(given), initial=0.0)))
            apart = max(apart, float(np.max(np.abs(found - given), initial=0.0)))
        return apart > SAME * largest

    def _write_answer(self) -> None:
        t, b = float(self._buffers.time[0]), self._buffers
        position, velocity = np.concatenate([b.position, b.angles]), np.concatenate([b.twist, b.v])
        state = State(position, velocity, self._layout)
        self._count += 1
        keep = self._count & (self._count - 1) == 0  # a power of two
        question = state.copy() if keep else None
        answer = self._answer(t, state)
        if question is not None:
            self._kept.append((t, question, answer))
        self._out[:] = answer

    def _answer(self, t: float, state: State) -> np.ndarray:
        self._buffers.flag[BUSY] = 1
        try:
            answer = self.function(t, state)
        except MultiarmError:
            raise
        except USER_FAULTS as error:
            raise ControlError(
                f"{self.name} raised {type(error).__name__}: {error} (at t = {t:.6g} s)"
            ) from error
        finally:
            self._buffers.flag[BUSY] = 0
        return self._read(answer)
