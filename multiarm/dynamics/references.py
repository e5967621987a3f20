"""The kinds of Data of a scene, and how compiled code gets from one to another.

A *view* of a Data (:meth:`multiarm.dynamics.data.Data.view`) has its state, the motion of its
bodies, its effects, and **its forces and accelerations**: whatever assembles ``forces.f`` or solves
in one of them replaces what the others have (:class:`multiarm.dynamics.data.SharedData`).  The
addresses of functions and the work of control laws are a view's own; so are rows, their sample and
the workspace of the solver where it has other rows (:class:`multiarm.dynamics.data.RowData`), and
the samples of a control that is sampled otherwise.

==================  ==================================  ============================================
Data                rows of W                           made by, and for
==================  ==================================  ============================================
``full``            all                                 ``Data(model)``: evaluations and runs; with
                                                        unilateral contacts: gaps and guards
``closed``          those of the joints, all closed     ``Data.closed``: inverse dynamics
``of_laws``         the same; where control counts      ``Data.of_laws``: what control laws
                    friction, tangents besides          evaluate
``modes.data``      those that hold in a mode           ``events.modes.Modes``, a ``RowSelection``:
                                                        the run and its steps
``modes.data        tangents of the contacts that       the same: directions of slip
.tangents``         slide
``modes             those that hold in all modes        the same: decisions at events
.bilateral``
``modes             none                                the same: decisions where rows are redundant
.unconstrained``
of springs          compliant contacts                  ``effects.contact_compliance``: their forces
at the start        those that are closed there         ``assembly.start``: the projection of it
==================  ==================================  ============================================

All but the first are views of it.  Inverse dynamics, paths of joints and comparisons view a model
with other constants.  A :class:`~multiarm.simulation.Stepper` has a Data of its own, whose control
is held.

Kernels open the struct of another Data at its address, which is in numbers of the first
(:func:`multiarm.jit.structs.referenced`): :class:`References` keep alive what is there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from multiarm.jit.structs import Numbers

R = TypeVar("R", bound="References")


@dataclass(frozen=True, eq=False)
class Reference:
    """A struct, and who owns the memory to which it refers."""

    struct: np.ndarray
    owner: Any

    @property
    def address(self) -> int:
        """For kernels, see :func:`multiarm.jit.structs.referenced`."""
        return self.struct.ctypes.data


class References(Numbers):
    """Numbers of which some are addresses of structs: these live as long as the numbers do."""

    def __init__(self, **values: float) -> None:
        super().__init__(**values)
        self.references: dict[str, Reference] = {}

    def refer(self, **references: Reference) -> None:
        """Set addresses by the names of their fields."""
        for name, reference in references.items():
            setattr(self, name, reference.address)
        self.references |= references

    def copy(self: R) -> R:
        """A copy of the numbers, which refers to the same structs."""
        copy = super().copy()
        copy.references = dict(self.references)
        return copy
