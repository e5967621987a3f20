"""Viscous friction in the joints: ``tau_j = -d_j q'_j`` [N m s/rad, N s/m]."""

from __future__ import annotations

from multiarm.lowlevel import kernel


@kernel
def add_joint_damping(velocity, parameters, at, h):
    """Add the damping forces to ``h``; returns their power [W], never positive.

    ``parameters[at:]``: one coefficient a joint.
    """
    power = 0.0
    for j in range(h.size):
        force = -parameters[at + j] * velocity[j]
        h[j] += force
        power += force * velocity[j]
    return power
