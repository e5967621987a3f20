"""User functions that an evaluation calls: controllers, wrenches, effects.

``f(t, state)`` is called from compiled code with the time and a copy of the state being evaluated.
Its answer is checked and copied into an array that the kernels read.

A rerun that checks a run calls the function from the beginning again.  One that integrates, counts
or draws random numbers then answers differently, and the two runs are not the same motion.  So some
calls are kept with their answers, the 1st, 2nd, 4th, 8th ..., and can be repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.dynamics.arrays import Variables, open_data
from multiarm.dynamics.state import Layout, State
from multiarm.errors import USER_FAULTS, ControlError, MultiarmError
from multiarm.jit.kernels import cfunc
from multiarm.jit.pointers import PythonCallback, address_of, call_python
from multiarm.jit.structs import struct_at

ControlFunction = Callable[[float, State], Mapping[str, np.ndarray]]

# No control law: see ``Constants.control``.
NO_CONTROL = np.zeros((0, 2), dtype=np.int64)

# Owners of the user functions under way in this thread.
_running: ContextVar[tuple[object, ...]] = ContextVar("running", default=())

# Answers that differ by less than this, relative to the largest of those kept, are the same.
SAME = 1e-9


class UserCallback(PythonCallback):
    """A user function that compiled code calls.

    Threads may call one function: each has an instance of this for itself.

    Parameters
    ----------
    function : callable
        ``f(t, state)``, with the time [s] and a :class:`multiarm.dynamics.state.State` of its own.
    name : str
        What it is, such as "the controller".
    read : callable
        ``read(answer, t)`` turns an answer into a new vector; raises ``ControlError`` for one that
        cannot be used.
    out : ndarray
        Where that is copied.
    layout : Layout
    variables : Variables
        Where the state being evaluated is.
    owner : object
        What calls it; the function must not evaluate a system that this is part of.
    """

    def __init__(
        self,
        function: Callable[[float, State], Any],
        name: str,
        read: Callable[[Any, float], np.ndarray],
        out: np.ndarray,
        layout: Layout,
        variables: Variables,
        owner: object,
    ) -> None:
        self._owner = owner
        self.function, self.name, self._read = function, name, read
        self._out, self._layout, self._variables = out, layout, variables
        self._count = 0
        self._kept: list[tuple[float, State, np.ndarray]] = []
        super().__init__(self._write_answer, variables.status)

    def forget(self) -> None:
        """Forget the calls that were kept: another run begins."""
        self._count = 0
        self._kept.clear()

    def remembers(self) -> bool:
        """Whether the function now answers kept calls differently.

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
        b = self._variables
        t = b.time.now
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
        running = _running.get()
        if self._owner in running:
            raise ControlError(
                f"{self.name} evaluates a system that it is part of, and would be called for ever; "
                f"let it evaluate one without it, such as `multiarm.compile_system(scene)`"
            )
        token = _running.set((*running, self._owner))
        try:
            answer = self.function(t, state)
        except MultiarmError:
            raise
        except USER_FAULTS as error:
            raise ControlError(
                f"{self.name} raised {type(error).__name__}: {error} (at t = {t:.6g} s)"
            ) from error
        finally:
            _running.reset(token)
        return self._read(answer, t)


@dataclass(frozen=True)
class PythonControl:
    """A controller in Python.

    Attributes
    ----------
    function : callable
        ``f(t, state) -> {arm: torques}``; arms that it leaves out get no torque.
    """

    function: ControlFunction

    @property
    def laws(self) -> np.ndarray:
        """``Constants.control``."""
        return np.array([[address_of(call_controller), 0]], dtype=np.int64)

    def connect(self, layout: Layout, variables: Variables) -> UserCallback:
        """The callback that writes the torques."""

        def read(torques: object, t: float) -> np.ndarray:
            return _read_torques(torques, layout, t)

        out = variables.torque
        function = self.function
        who = "the controller"
        return UserCallback(function, who, read, out, layout, variables, owner=function)


@cfunc
def call_controller(address, size, _at, _t):
    """Let the controller in Python write all torques."""
    call_python(open_data(struct_at(address, size)).functions.control)
    return 0


def _read_torques(torques: object, layout: Layout, t: float) -> np.ndarray:
    """Torques of all joints (n,) from those by arm; arms that are left out get none."""
    if not isinstance(torques, Mapping):
        raise ControlError(
            f"the controller returned {type(torques).__name__}; return a dict arm -> torques"
        )
    stacked = np.zeros(layout.joints)
    views = layout.split_joints(stacked)
    for arm, values in torques.items():
        if arm not in views:
            raise ControlError(
                f"the controller returned torques for an unknown arm {arm!r}; "
                f"arms are {', '.join(views)}"
            )
        try:
            vector = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            raise ControlError(
                f"the controller's torques for arm {arm!r} are not numbers: {values!r}"
            ) from None
        if vector.shape != views[arm].shape:
            raise ControlError(
                f"the controller returned shape {vector.shape} for arm {arm!r}, "
                f"expected {views[arm].shape}: one torque a joint"
            )
        if not np.all(np.isfinite(vector)):
            raise ControlError(
                f"the controller returned a torque that is not finite for arm {arm!r} at "
                f"t = {t:.6g} s: {vector.tolist()}"
            )
        views[arm][:] = vector
    return stacked
