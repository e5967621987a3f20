r"""Which contacts push, slide, stick or open: the complementarity problem of one instant.

At an event this package determines the contact mode of every unilateral constraint: :func:`solve`
takes the response of the rows, their free rates and contact laws
(:mod:`multiarm.events.complementarity.problem`), and returns a
:class:`ComplementaritySolution` that certifies itself by its residual and verdict. An impact is the
same problem, with impulses for forces and velocities for accelerations.

Without friction the problem is convex and is solved by pivoting, in finitely many steps, singular D
included. With friction Newton's method on the exact cones finds the modes, and where it does not
compiled iterations do: a proximal point method, smoothed laws, Gauss-Seidel sweeps
(:mod:`~multiarm.events.complementarity.impulses`, which steps in time call with plain arrays).
Where a solution need not exist, or need not be the only one (Painleve), others are looked for
(:mod:`~multiarm.events.complementarity.solution`).
Nothing is regularised. Where the forces are not determined, those of minimum norm that obey the
laws are taken, which also gives the active set
(:mod:`~multiarm.events.complementarity.active_set`).

References: Cottle, Pang, Stone, *The Linear Complementarity Problem*, 1992; Loetstedt, "Coulomb
friction in two-dimensional rigid body systems", ZAMM 61, 1981; Alart, Curnier, "A mixed formulation
for frictional contact problems", CMAME 92, 1991.
"""

from multiarm.events.complementarity.problem import (
    Bounded,
    ContactLaw,
    ContactMode,
    Friction,
    Push,
    Sliding,
)
from multiarm.events.complementarity.solution import (
    NO_SOLUTION,
    Alternative,
    ComplementaritySolution,
    Verdict,
    describe,
    find_impulses,
    solve,
)

__all__ = [
    "NO_SOLUTION",
    "Alternative",
    "Bounded",
    "ComplementaritySolution",
    "ContactLaw",
    "ContactMode",
    "Friction",
    "Push",
    "Sliding",
    "Verdict",
    "describe",
    "find_impulses",
    "solve",
]
