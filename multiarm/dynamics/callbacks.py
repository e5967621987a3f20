"""Callbacks: Python functions that compiled code calls in an evaluation.

*User functions* ``f(t, state)``: controllers, wrenches, effects, moments of joints.  They get the
time and a copy of the state being evaluated; the result is checked and copied into an array that
kernels read.

A run is certified by repeating it with the same function.  A function with a memory (it integrates,
counts or draws random numbers) gives other results then, and the two runs are different motions.
To detect this, the arguments and results of calls 1, 2, 4, 8 ... are recorded and can be repeated.

*The dense solver* (:mod:`multiarm.dynamics.solver.dense`) is called in place of the node algorithm.
"""

from __future__ import annotations

import itertools
import math
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from multiarm.dynamics.arrays import CalledFunction, open_data, table_of
from multiarm.dynamics.kinematics import inertias_in
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.solver.dense import solve_dense
from multiarm.dynamics.solver.node import NodeWork
from multiarm.dynamics.solver.solution import DENSE, write_solution
from multiarm.dynamics.state import State, fill_by_arm
from multiarm.dynamics.status import (
    BLOCK_INERTIA,
    BLOCK_NOT_FINITE,
    NOT_FINITE,
    OBJECT_INERTIA,
    OK,
)
from multiarm.dynamics.variables import ALWAYS, Variables
from multiarm.errors import USER_FAULTS, ControlError, MultiarmError
from multiarm.jit.kernels import cfunc
from multiarm.jit.pointers import PythonCallback, address_of, call_python
from multiarm.jit.structs import struct_at

ControlFunction = Callable[[float, State], Mapping[str, np.ndarray]]

# Keys of what a controller says to timed joints.
ATTACH, DETACH = "attach", "detach"
# Owners of the user functions that this thread is calling.
_running: ContextVar[tuple[object, ...]] = ContextVar("running", default=())


class UserCallback(PythonCallback):
    """A user function that compiled code calls.

    Every Data has its own instance, so that threads can share one function.

    Parameters
    ----------
    function : callable
        ``f(t, state)``, with the time [s] and a :class:`multiarm.dynamics.state.State` of its own.
    name : str
        For error messages, such as "the controller".
    read : callable
        ``read(result)`` returns the result as a new vector, or raises ``ControlError``.
    out : ndarray
        The vector is copied here.
    layout : Layout
    variables : Variables
        With the state being evaluated.
    owner : object
        The control or effect that has the function.  The function must not evaluate a system with
        the same owner: it would call itself.
    """

    def __init__(
        self,
        function: Callable[[float, State], Any],
        name: str,
        read: Callable[[Any], np.ndarray],
        out: np.ndarray,
        layout: Layout,
        variables: Variables,
        owner: object,
    ) -> None:
        self._owner = owner
        self.function, self.name, self._read = function, name, read
        self._out, self._layout, self._variables = out, layout, variables
        self._count = 0
        self._recorded: list[tuple[float, State, np.ndarray]] = []
        super().__init__(self._write, variables.status)

    def forget(self) -> None:
        """Delete the recorded calls, before another run."""
        self._count = 0
        self._recorded.clear()

    def remembers(self) -> bool:
        """Whether repeated calls give other results than the recorded ones.

        Calls that raise an exception now are left out.
        """
        difference = largest = 0.0
        for t, state, expected in reversed(self._recorded):
            try:
                repeated = self._call(t, state.copy())
            except MultiarmError:
                continue
            largest = max(largest, float(np.max(np.abs(expected), initial=0.0)))
            difference = max(difference, float(np.max(np.abs(repeated - expected), initial=0.0)))
        return difference > 1e-9 * largest

    def _write(self) -> None:
        b = self._variables
        t = b.time.now
        state = State(b.state.configuration.copy(), b.state.velocity.copy(), self._layout)
        self._count += 1
        record = self._count & (self._count - 1) == 0  # a power of two
        before = state.copy() if record else None  # the function may write into its own
        result = self._call(t, state)
        if before is not None:
            self._recorded.append((t, before, result))
        self._out[:] = result

    def _call(self, t: float, state: State) -> np.ndarray:
        running = _running.get()
        if self._owner in running:
            raise ControlError(
                f"{self.name} evaluates a system that it is part of, and would be called for ever; "
                f"let it evaluate one without it, such as `multiarm.compile_system(scene)`"
            )
        token = _running.set((*running, self._owner))
        try:
            result = self.function(t, state)
        except MultiarmError:
            raise
        except USER_FAULTS as error:
            raise ControlError(
                f"{self.name} raised {type(error).__name__}: {error} (at t = {t:.6g} s)"
            ) from error
        finally:
            _running.reset(token)
        try:
            return self._read(result)
        except ControlError as error:
            raise ControlError(f"{error} (at t = {t:.6g} s)") from None


class ControlCallback(UserCallback):
    """A controller, whose answer has torques, and may have commands to timed joints.

    Parameters
    ----------
    function, name, layout, variables, owner
        See :class:`UserCallback`.
    timed : sequence of str
        The joints that can be commanded.

    Attributes
    ----------
    commands : list of (str, bool)
        Joints that are to hold, and not to hold, since they were taken last.
    notify : callable
        Called when there are commands.
    """

    def __init__(
        self,
        function: ControlFunction,
        name: str,
        layout: Layout,
        variables: Variables,
        owner: object,
        timed: Sequence[str],
    ) -> None:
        out = variables.control.torque
        super().__init__(function, name, self._read_answer, out, layout, variables, owner)
        self._timed, self._said = timed, list[tuple[str, bool]]()
        self._recorded_words: list[list[tuple[str, bool]]] = []
        self.listen(lambda: None)

    def listen(self, notify: Callable[[], None]) -> None:
        """Forget commands, and call a function where there are others."""
        self.commands: list[tuple[str, bool]] = []
        self.notify = notify

    def forget(self) -> None:
        """Delete the recorded calls, before another run."""
        super().forget()
        self._recorded_words.clear()

    def remembers(self) -> bool:
        """Whether repeated calls give other torques or commands than the recorded ones."""
        if super().remembers():
            return True
        for (t, state, _), said in zip(self._recorded, self._recorded_words, strict=True):
            try:
                self._call(t, state.copy())
            except MultiarmError:
                continue
            if self._said != said:
                return True
        return False

    def _write(self) -> None:
        super()._write()
        if len(self._recorded) > len(self._recorded_words):
            self._recorded_words.append(list(self._said))
        if self._said:
            self.commands += self._said
            self.notify()

    def _read_answer(self, answer: Any) -> np.ndarray:
        """The torques of an answer, (n,); what it says to joints is kept."""
        self._said.clear()
        if isinstance(answer, Mapping) and not {ATTACH, DETACH}.isdisjoint(answer):
            for key, holds in ((ATTACH, True), (DETACH, False)):
                names = answer.get(key, ())
                names = [names] if isinstance(names, str) else names
                if not isinstance(names, Iterable):
                    raise ControlError(
                        f"{self.name} must say {key!r} with the name of a joint or a list of "
                        f"names, it said {names!r}"
                    )
                self._said += [(name, holds) for name in names]
            self._require_usable()
            answer = {key: value for key, value in answer.items() if key not in (ATTACH, DETACH)}
        stacked = np.zeros(self._layout.rate_count)
        fill_by_arm(f"{self.name}'s torques", self._layout, stacked, answer, ControlError)
        return stacked

    def _require_usable(self) -> None:
        for name, holds in self._said:
            if name not in self._timed:
                verb = "attaches" if holds else "detaches"
                joints = ", ".join(map(repr, self._timed)) or "(none; write `from` or `until`)"
                raise ControlError(
                    f"{self.name} {verb} {name!r}; joints that can be commanded are {joints}"
                )
        if self._said and self._variables.control.sampling.mode == ALWAYS:
            raise ControlError(
                f"{self.name} commands joints, which a control can do at its samples only; give it "
                "a `sample_time`"
            )


@dataclass(frozen=True)
class PythonControl:
    """A controller in Python.

    Attributes
    ----------
    function : callable
        ``f(t, state) -> {arm: torques}``; arms that it leaves out get no torque.
    who : str
        For messages.
    in_scene : bool
        It is that of the scene, not one in its place.
    instance : callable, optional
        Makes a function of its own for each Data; None: all share ``function``.
    """

    function: ControlFunction
    who: str = "the controller"
    in_scene: bool = False
    instance: Callable[[], ControlFunction] | None = None

    @property
    def laws(self) -> np.ndarray:
        """``Constants.control``."""
        return table_of([CalledFunction(address_of(call_controller))])

    def connect(
        self, layout: Layout, variables: Variables, timed: Sequence[str]
    ) -> ControlCallback:
        """The callback that writes the torques, and commands the ``timed`` joints."""
        function = self.function if self.instance is None else self.instance()
        return ControlCallback(function, self.who, layout, variables, self.function, timed)


@cfunc
def call_controller(address, size, _at, _t):
    """Let the controller in Python write all torques."""
    call_python(open_data(struct_at(address, size)).functions.control)
    return 0


class Solved(Protocol):
    """A Data that is solved."""

    @property
    def arrays(self) -> Variables:
        """Its variables."""

    @property
    def work(self) -> NodeWork:
        """The workspace of its solver."""


class DenseSolver:
    """Solves for ``a_o, a_j, force`` in a Data by the dense solver, when it is called.

    How it is called, and what it returns, is in the Data: ``arrays.dense``.

    Attributes
    ----------
    reactions : tuple of ndarray, optional
        With sliding friction: the objects' rows (N, 6 F) and the blocks' matrices (n, d, m) of the
        contact forces.  None: contact forces act along the constraints, as in projections.
    """

    reactions: tuple[np.ndarray, np.ndarray] | None = None

    def __init__(self, data: Solved) -> None:
        self._data = weakref.proxy(data)  # which has this

    def __call__(self) -> None:
        """Solve once."""
        b, work = self._data.arrays, self._data.work
        dofs = work.first_joint
        blocks = range(len(dofs) - 1)
        inertias = inertias_in(work)
        terms = b.bodies.object_inertia, b.rows.W_o, work.W, b.rows.c, b.forces.f
        b.dense.status, b.status.block = _status_of(b.bodies.object_inertia, inertias, terms)
        if b.dense.status != OK:
            return
        W_o, W = _by_block(work, b.rows.W_o, work.W)
        reaction_o, reaction = (None, None)
        if self.reactions is not None:
            reaction_o, reaction = _by_block(work, *self.reactions)
        solution = solve_dense(
            M_o=b.bodies.object_inertia,
            f_o=b.forces.f_o,
            M=inertias,
            f_j=[b.forces.f_j[dofs[i] : dofs[i + 1]] for i in blocks],
            W_o=W_o,
            W=W,
            c=[b.rows.c[work.first_contact[i] : work.first_contact[i + 1]] for i in blocks],
            reaction_o=reaction_o,
            reaction=reaction,
            tolerance=b.dense.tolerance,
        )
        b.accelerations.a_o[:] = solution.object_acceleration
        b.accelerations.a_j[:] = np.concatenate(solution.joint_accelerations)
        b.rows.force[:] = np.concatenate(solution.contact_forces)
        write_solution(
            b, DENSE, 0, b.rows.force.size - solution.rank, math.inf, solution.motion_unique
        )
        b.deficient.undetermined[:] = 0
        b.deficient.undetermined[list(solution.undetermined_blocks)] = 1


def _by_block(work: NodeWork, on_object: np.ndarray, on_blocks: np.ndarray) -> tuple[list, list]:
    sizes = zip(on_blocks, np.diff(work.first_joint), np.diff(work.first_contact), strict=True)
    blocks = [matrix[:d, :m] for matrix, d, m in sizes]
    bounds = itertools.pairwise(work.first_contact)
    return [on_object[first:end].T for first, end in bounds], blocks


def _status_of(
    object_inertia: np.ndarray, inertias: list[np.ndarray], terms: tuple[np.ndarray, ...]
) -> tuple[int, int]:
    """Why the equations cannot be solved, and the block of ``BLOCK_INERTIA, BLOCK_NOT_FINITE``."""
    if not np.all(np.diag(object_inertia) > 0.0):
        return OBJECT_INERTIA, 0
    for i, inertia in enumerate(inertias):
        if not np.all(np.isfinite(inertia)):
            return BLOCK_NOT_FINITE, i
        if not np.all(np.diag(inertia) > 0.0):
            return BLOCK_INERTIA, i
    finite = all(np.all(np.isfinite(term)) for term in terms)
    return (OK if finite else NOT_FINITE), 0
