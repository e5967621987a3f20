r"""Unilateral contacts that open, close, stick and slip: motion that is smooth between events.

A scene with unilateral constraints (:mod:`multiarm.contacts.unilateral`) has rows that are active
at some times only: contacts that only push, two tangents for each that has friction, the points of
the object that can touch the floor, joints at their limits, joints held by dry friction.  Which
rows are active at a time is a *mode*.  In one mode the motion is smooth, and it is simulated as
that of any other scene: a mode is a :class:`multiarm.dynamics.model.Data` with its active rows,
which shares state, arms and effects with all others (:mod:`multiarm.events.modes`).

*Guards* (:mod:`multiarm.events.kernels`) say after every step whether the mode still holds: gaps of
open contacts are not negative, closed contacts push, sticking ones stay within the cone of
friction, sliding ones still slide.  Where one changes its sign inside a step, the time is found on
the step's dense output, the step is repeated to end there, and a *transition*
(:mod:`multiarm.events.transition`) decides what comes next: an impact, if something hits, and then
which contacts push, slide, stick or open, as the solution of a complementarity problem
(:mod:`multiarm.events.complementarity`).

References: F. Pfeiffer, C. Glocker, Multibody Dynamics with Unilateral Contacts, Wiley 1996;
B. Brogliato, Nonsmooth Mechanics, 3rd ed., Springer 2016.  Sliding friction in the node algorithm:
S.Y. Ho's thesis (CUHK 1995), the footnote to 4.9.
"""
