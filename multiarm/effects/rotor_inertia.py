r"""Inertia of the drives: :math:`M_{jj} \to M_{jj} + n_j^2 J_j` [kg m^2, kg].

A rotor of inertia ``J`` with a gear of ratio ``n`` turns ``n`` times as fast as its joint, and
its kinetic energy is :math:`\tfrac12 n^2 J \dot q^2`.  The gyroscopic moments of rotors whose axes
are turned by the arm are left out, as usual for large gear ratios (M.W. Spong, J. Dyn. Sys. Meas.
Control 109, 1987; R. Featherstone, Rigid Body Dynamics Algorithms, 2008, 9.6).

Pinocchio adds these numbers to the diagonal of M, so that an evaluation does nothing more: the arm
is built with them, and no kernel is called.
"""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.effect_kernels import EffectKernel
from multiarm.effects.building import BuildContext
from multiarm.scene import gain_vector


def build(_spec, _context: BuildContext) -> list[EffectKernel]:
    """No kernel."""
    return []


def of_arm(spec, arm: str, joint_names: tuple[str, ...]) -> np.ndarray:
    """Inertias of the drives of one arm, as seen from its joints, shape (n,) [kg m^2, kg]."""
    return gain_vector(spec, arm, joint_names)
