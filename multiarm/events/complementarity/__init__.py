r"""Which contacts push, slide, stick or let go: the complementarity problem of one instant.

Between two events a fixed set of rows is active and the motion is smooth. At an event this package
decides what every candidate does from then on. With x the forces of the candidate rows and y their
rates,

.. math:: y = D x + b,

D the symmetric response (rate of each row to a unit force in each row), b the rates without these
forces, each unit obeys a law of its own (:mod:`multiarm.events.complementarity.units`): a contact
pushes and never pulls, dry friction opposes slip within its bound. An impact is the same problem,
with impulses for forces and velocities for accelerations.

How it is solved. Without friction the problem is convex and is solved by pivoting
(:mod:`~multiarm.events.complementarity.convex`), in finitely many steps, singular D included. With
friction Newton's method on the exact cones finds the modes
(:mod:`~multiarm.events.complementarity.newton`). Where a solution need not exist, or need not be
the only one (Painleve), all modes are tried (:mod:`~multiarm.events.complementarity.enumeration`),
and what was found is told by name. Nothing is regularised. Where the forces are not determined, the
smallest that obey the laws are taken, which also says which rows can be held from now on without
looking at signs (:mod:`~multiarm.events.complementarity.selection`).

References: Cottle, Pang, Stone, *The Linear Complementarity Problem*, 1992; Loetstedt, "Coulomb
friction in two-dimensional rigid body systems", ZAMM 61, 1981; Alart, Curnier, "A mixed formulation
for frictional contact problems", CMAME 92, 1991.
"""

from multiarm.events.complementarity.solution import Alternative, Solution, Verdict
from multiarm.events.complementarity.solving import solve
from multiarm.events.complementarity.units import Bounded, Friction, Mode, Push, Sliding, Unit

__all__ = [
    "Alternative",
    "Bounded",
    "Friction",
    "Mode",
    "Push",
    "Sliding",
    "Solution",
    "Unit",
    "Verdict",
    "solve",
]
