r"""Forces over contacts: how the contacts share a wrench (thesis, 3.4 and 3.7.3).

The contact forces :math:`\lambda` with :math:`W \lambda = w` are

.. math:: \lambda = W^+ w + A y, \qquad W A = 0 ,

the forces of least norm and internal forces.  Which y is best depends on the question:

- none, or coordinates that the user names: :mod:`.internal_forces`;
- forces between bounds of least norm, or whose largest is smallest, and torques of which the
  largest share of a limit is smallest: :mod:`.distribution`;
- in the loop of a run, the internal part of desired forces: :mod:`.compiled`, and with friction
  those in the middle of its cones: :mod:`.friction`.
"""
