r"""Control laws: compiled functions with named numbers, which an evaluation calls by address.

Laws are called one after the other, and each adds its torques to ``data.control.torque``.  A law
has the signature of :func:`multiarm.jit.kernels.cfunc`.  Its numbers are a ``NamedTuple``,
constants of the model, which stand at the end of the system's struct; it opens them by
:func:`view_of_law`.

.. code-block:: python

    class Spring(NamedTuple):
        stiffness: Floats1  # (n,) [N m/rad, N/m]

    open_spring = view_of_law(Spring)

    @cfunc
    def pull(address, size, at, t):
        struct = struct_at(address, size)
        data, spring = open_data(struct), open_spring(struct, at)
        for j in range(data.control.torque.size):
            data.control.torque[j] -= spring.stiffness[j] * data.state.joint_positions[j]
        return 0

    ControlLaw(pull, Spring(stiffness))

*Its derivative*, where it states one, is a function of the same signature.  It adds the derivatives
of the law's torques to ``data.slopes.torque`` (n, columns), by the columns of
:func:`multiarm.dynamics.coordinates.force_columns`, without those by the time.

.. code-block:: python

    @cfunc
    def differentiate_pull(address, size, at, t):
        struct = struct_at(address, size)
        data, spring = open_data(struct), open_spring(struct, at)
        positions = force_columns(data).positions
        for j in range(data.control.torque.size):
            data.slopes.torque[j, positions + j] -= spring.stiffness[j]
        return 0

    ControlLaw(pull, Spring(stiffness), differentiate_pull)

*Multipliers.*  A law that distributes wrenches w over the arms couples them by Lagrange multipliers
s alone, six an object, those of the wrench balance :math:`F_s = \sum_i r_i - w = 0`: the torques of
an arm, and its part :math:`r_i` of the wrenches, are functions of its own state, the objects', and
of s.  (Contact forces of least norm with :math:`W_o \lambda = w` are :math:`\lambda = W_o^T s`, so
that :math:`r_i = W_{oi} W_{oi}^T s`.)  The last law of a control that is ``CARRYING``
(:class:`multiarm.control.program.ControlProgram`) states its ``share_derivative``: this adds the
derivatives of its torques at fixed s, and those by s, to ``data.slopes.torque``, and the
derivatives of :math:`F_s` to ``data.slopes.balance`` (6 F, columns).

*Its work*, where it has any, is a ``NamedTuple`` of arrays that it writes.  Each
:class:`multiarm.dynamics.data.Data` has its own, made by the classmethod ``of(data)``; they follow
the numbers in the struct, and the law opens them by :func:`view_of_work`.

Effects are built in the same way (:mod:`multiarm.dynamics.effect_kernels`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from multiarm.dynamics.arrays import CalledFunction, table_of
from multiarm.errors import ModelError
from multiarm.jit.kernels import Kernel, inlined
from multiarm.jit.pointers import address_of
from multiarm.jit.structs import count_entries, make_struct, misfit, struct_of, view_at

# ``Constants.control`` without a law.
NO_CONTROL = table_of(())


def view_of_law(holder: type) -> Callable[[Any, Any], Any]:
    """Function of kernels ``(struct, at) -> view`` of a law's numbers."""
    open_view = view_at(holder)

    @inlined
    def open_law(struct, at):
        return open_view(struct, int(at))

    return open_law


def view_of_work(holder: type, numbers: type | None = None) -> Callable[[Any, Any], Any]:
    """Function of kernels ``(struct, at) -> view`` of the work of a law with these numbers."""
    before = 0 if numbers is None else count_entries(numbers)
    open_view = view_at(holder)

    @inlined
    def open_work(struct, at):
        return open_view(struct, int(at) + before)

    return open_work


@dataclass(frozen=True, eq=False)
class ControlLaw:
    """A compiled law and its numbers.

    Attributes
    ----------
    kernel : Kernel
        Decorated with :func:`multiarm.jit.kernels.cfunc`, called with address and size of the
        system's struct, the place ``at`` of the numbers there (a float), and the time [s].  It
        returns 0; any other answer ends the evaluation, and the run's message has it.
    numbers : NamedTuple
        Numbers, and contiguous arrays of float64 or int64.  All threads share them: a law reads
        them only.  Empty for a law without numbers.
    derivative : Kernel, optional
        The derivatives of its torques, see above; absent: they are differences.  It is called right
        after the law, with all that this has written, and returns 0, or ``SINGULAR``
        (:mod:`multiarm.dynamics.status`) where it has none at this state: differences take its
        place.
    work : class of a NamedTuple, optional
        What it writes, see above.
    prepare : callable, optional
        ``prepare(data, work)``, called before derivatives are taken: makes what these need.
    share_derivative : Kernel, optional
        Like ``derivative``, at fixed multipliers, see above.
    answers : mapping int -> str
        What answers of it other than 0 stand for, and what to do, as messages say it.
    reads_inertias : bool
        Whether it reads the inertias of blocks, ``work.M``: these are then written in every
        evaluation, and no block is eliminated by factors.
    """

    kernel: Kernel
    numbers: Any = ()
    derivative: Kernel | None = None
    work: Any = None
    prepare: Callable[[Any, Any], None] | None = None
    share_derivative: Kernel | None = None
    reads_inertias: bool = False
    answers: Mapping[int, str] = field(default_factory=dict)

    @cached_property
    def struct(self) -> np.ndarray:
        """Its part of the system's struct."""
        return struct_of(self.numbers) if self.numbers else make_struct(())

    def require_usable(self, who: str) -> None:
        """Raise a ``ModelError`` where kernels could not be called, or read what is not there."""
        for kernel in filter(None, (self.kernel, self.derivative, self.share_derivative)):
            if not isinstance(kernel, Kernel) or not kernel.is_called_by_address:
                raise ModelError(f"{who} returned a law that is no `multiarm.jit.kernels.cfunc`")
        if isinstance(self.numbers, tuple) and not self.numbers:
            return
        named = isinstance(self.numbers, tuple) and hasattr(self.numbers, "_fields")
        if not named or not hasattr(type(self.numbers), "__annotations__"):
            raise ModelError(
                f"{who} returned a law whose numbers are {type(self.numbers).__name__}; return a "
                f"NamedTuple whose fields are annotated with `multiarm.jit.structs.Floats1` or the "
                f"like"
            )
        fault = misfit(self.numbers)
        if fault:
            raise ModelError(f"{who} returned a law with wrong numbers: {fault}")
        if not all(np.all(np.isfinite(entry)) for entry in self.numbers):
            raise ModelError(f"{who} returned a law with numbers that are not finite")


def are_differentiable(laws: Sequence[ControlLaw]) -> bool:
    """Whether all laws state the derivatives of their torques."""
    return all(law.derivative is not None for law in laws)


def law_table(laws: Sequence[ControlLaw], first: int) -> np.ndarray:
    """``Constants.control``; ``first`` is the place of the first law's numbers in the struct."""
    rows, at = [], first
    for law in laws:
        rows.append(CalledFunction(address_of(law.kernel), at))
        at += len(law.numbers) + (0 if law.work is None else count_entries(law.work))
    return table_of(rows)
