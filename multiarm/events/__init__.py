r"""Unilateral contacts that open, close, stick and slip: a hybrid system.

Which of the rows of a scene's unilateral constraints (:mod:`multiarm.contacts.unilateral`) are
active is a *mode*.  In one mode the motion is smooth and is integrated like that of any scene.  All
modes have one :class:`multiarm.dynamics.data.Data`, in which the active rows are selected where a
mode is entered (:mod:`multiarm.dynamics.row_selection`, :mod:`multiarm.events.modes`).

*Guards* (:mod:`multiarm.dynamics.guards`) check after every step whether the mode still holds: gaps
of open contacts are not negative, closed contacts push, sticking ones stay within the friction
cone, sliding ones still slide.  Where one changes its sign inside a step, the time is located on
the step's dense output (:mod:`multiarm.integration.event_location`), the step is repeated to end
there, and a *transition* (:mod:`multiarm.events.transition`) determines the next mode: an impact,
if something hits, and then which contacts push, slide, stick or open, as the solution of a
complementarity problem (:mod:`multiarm.events.complementarity`).

References: F. Pfeiffer, C. Glocker, Multibody Dynamics with Unilateral Contacts, Wiley 1996;
B. Brogliato, Nonsmooth Mechanics, 3rd ed., Springer 2016.  Sliding friction in the node algorithm:
S.Y. Ho's thesis (CUHK 1995), the footnote to 4.9.
"""
