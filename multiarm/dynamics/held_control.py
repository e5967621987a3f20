r"""Sampled control: torques are computed at the samples of a digital controller, and held between.

With the sample time :math:`T`, control laws :math:`u` and the state :math:`x` at the end of a step,

.. math::
    \tau(t) = u(kT, x(kT)), \qquad kT \le t < (k + 1) T,

or, with a delay of one sample, :math:`\tau(t) = u((k - 1) T, x((k - 1) T))`.  Before the second
sample there is no earlier one: the torques of the start act, as if the system had been there long.

Laws that are held stand in ``Constants.sampled``; the only row of ``Constants.control`` is then
:func:`hold_torques`.  So a model whose control is evaluated all the time does nothing else than
before.  The time loop sets ``data.control.sampling.due`` at a sample: the first evaluation there
calls the laws, with all terms that they need at hand, and the next ones use what it has stored.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Real

import numpy as np

from multiarm.dynamics.arrays import (
    CARRYING,
    COUPLED,
    DERIVATIVE,
    OPEN_LOOP,
    CalledFunction,
    Constants,
    call_derivative,
    call_listed,
    open_system,
    table_of,
)
from multiarm.dynamics.status import OK
from multiarm.dynamics.variables import ALWAYS, HELD, ONCE, ControlVariables
from multiarm.errors import ControlError
from multiarm.jit.kernels import cfunc, copy
from multiarm.jit.pointers import address_of
from multiarm.jit.structs import struct_at


@dataclass(frozen=True)
class Sampling:
    """When a control is evaluated.

    Attributes
    ----------
    time : float
        From one sample to the next [s].
    delay : bool
        Whether torques act one sample later.

    Raises
    ------
    ControlError
        When the time is not a positive number.
    """

    time: float
    delay: bool = False

    def __post_init__(self) -> None:
        time = self.time
        usable = isinstance(time, Real) and not isinstance(time, bool)
        if not (usable and 0.0 < time < math.inf):
            raise ControlError(
                f"sample_time: must be a time in seconds greater than 0, got {time!r}; leave it "
                f"out for a control that is evaluated all the time"
            )


def with_held_control(
    constants: Constants, laws: np.ndarray, differentiable: bool, delay: bool = False
) -> Constants:
    """Constants with control ``laws`` that are evaluated at samples only.

    ``differentiable``: all of them state their derivatives.
    """
    derivative = address_of(differentiate_held_torques) if differentiable else 0
    holding = CalledFunction(address_of(hold_torques), derivative=derivative)
    reach = constants.control_reach
    if not len(laws):
        reach = OPEN_LOOP
    elif reach == CARRYING:  # the last law is another one now
        reach = COUPLED
    return constants._replace(
        control=table_of([holding]),
        sampled=laws,
        sample_delay=delay,
        control_reach=reach,
    )


@contextmanager
def without_samples(control: ControlVariables) -> Iterator[None]:
    """Within this, sampled laws are evaluated every time and act at once; afterwards as before.

    Torques that a caller holds stay.
    """
    sampling, held = control.sampling, control.held_torques
    due, samples, torques = sampling.due, sampling.samples, held.copy()
    if sampling.mode == ONCE:
        sampling.due = ALWAYS
    try:
        yield
    finally:
        sampling.due, sampling.samples, held[:] = due, samples, torques


@cfunc
def hold_torques(address, size, _at, _t):
    """Write the held torques; where a sample is due, let the laws compute them.

    Returns a status.
    """
    struct = struct_at(address, size)
    model, data, _ = open_system(struct)
    sampling, held = data.control.sampling, data.control.held_torques
    if sampling.due != HELD:
        for k in range(model.sampled.shape[0]):
            status = call_listed(model.sampled, k, struct, data)
            if status != OK:
                return status
        at_once = not model.sample_delay or sampling.samples == 0 or sampling.due == ALWAYS
        for j in range(data.control.torque.size):
            held[0, j] = data.control.torque[j] if at_once else held[1, j]
            held[1, j] = data.control.torque[j]
        sampling.samples += 1
        if sampling.due == ONCE:
            sampling.due = HELD
    copy(held[0], data.control.torque)
    return OK


@cfunc
def differentiate_held_torques(address, size, _at, _t):
    """Let the laws add their derivatives, where they follow the state; returns a status."""
    struct = struct_at(address, size)
    model, data, _ = open_system(struct)
    status = OK
    for k in range(model.sampled.shape[0] if data.control.sampling.due != HELD else 0):
        if status == OK:
            status = call_derivative(model.sampled, k, DERIVATIVE, struct, data)
    return status
