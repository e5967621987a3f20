"""The methods of integration: what the driver and the time loop know of each.

A method is a tableau (:mod:`multiarm.tableaus`) and the kernel that makes a step of its kind, with
work arrays of its own.  The kernel is called by address with the struct of coefficients, step and
work: it is compiled when a method of its kind is first used, and the loop knows no method's name.
An explicit Runge-Kutta method is nothing but its tableau; another kind is a module with its step,
and a line in :data:`STEP_KINDS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from multiarm.dynamics.data import Data
from multiarm.integration.explicit import explicit_step, semi_implicit_step
from multiarm.integration.rosenbrock import make_rosenbrock, rosenbrock_step
from multiarm.integration.step import Coefficients, Step, coefficients, make_step
from multiarm.integration.variational import make_variational, variational_step
from multiarm.jit.kernels import Kernel
from multiarm.jit.pointers import address_of
from multiarm.jit.structs import struct_of
from multiarm.tableaus import EXPLICIT, ROSENBROCK, SEMI_IMPLICIT, VARIATIONAL, Tableau

WorkArrays = tuple[Any, ...]


def _no_work(_data: Data, _step: Step) -> WorkArrays:
    return ()


class StepKind(NamedTuple):
    """How methods of one kind make a step.

    Attributes
    ----------
    step : Kernel
        Called by address with the struct of a :class:`Stepping`, time and length of the step; it
        reads ``z`` and ``k[0]``, writes ``z_new`` and the other slopes, and returns a status.
    make_work : callable
        ``make_work(data, step)`` allocates its work arrays.
    """

    step: Kernel
    make_work: Callable[[Data, Step], WorkArrays] = _no_work


STEP_KINDS: Mapping[int, StepKind] = MappingProxyType(
    {
        EXPLICIT: StepKind(explicit_step),
        SEMI_IMPLICIT: StepKind(semi_implicit_step),
        ROSENBROCK: StepKind(rosenbrock_step, make_rosenbrock),
        VARIATIONAL: StepKind(variational_step, make_variational),
    }
)


@dataclass(frozen=True)
class Stepping:
    """A method with arrays for the steps of a system.

    Attributes
    ----------
    tableau : Tableau
    coefficients : Coefficients
        The tableau in the kernels' form.
    step : Step
    work : tuple of NamedTuple
        Further arrays of its kind; the ``memory`` of each is what steps write.
    struct : ndarray
        The argument of kernels: coefficients, step and work.
    """

    tableau: Tableau
    coefficients: Coefficients
    step: Step
    work: WorkArrays
    struct: np.ndarray

    def restart(self) -> None:
        """Forget the steps of another run; tolerances, gains and chart are those of the next."""
        for part in (self.step, *self.work):
            for array in part.memory:
                array.fill(0.0)
        self.step.stage.begin()


_address = cache(address_of)


def make_stepping(data: Data, tableau: Tableau) -> Stepping:
    """Allocate for the steps of a system; compiles the step of this kind if need be."""
    effects, kind = data.model.effects, STEP_KINDS[tableau.kind]
    works = 1 + len(effects.works)
    step = make_step(tableau, data.model.layout, data.struct, effects.states, works)
    known, work = coefficients(tableau, _address(kind.step)), kind.make_work(data, step)
    return Stepping(tableau, known, step, work, struct_of(known, step, *work))


def stepping_of(data: Data, tableau: Tableau) -> Stepping:
    """The arrays for a run, which those before have left in the Data."""
    key = "stepping", tableau.name
    if key not in data.cache:
        data.cache[key] = make_stepping(data, tableau)
    else:
        data.cache[key].restart()
    return data.cache[key]
