"""A magnet at a fixed place that pulls the object's centre of mass: f = k d / (|d|^2 + r^2)^(3/2).

d is the way from the object to the magnet [m], k its strength [N m^2], and r keeps the force finite
at the magnet itself [m].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import multiarm as ma
from multiarm.effects import APPLIED, EffectKernel, open_data, set_power, view_of_effect
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import Float, Floats1, struct_at


class Magnet(ma.Effect):
    """In Python: called back at every evaluation."""

    name = "magnet"

    class Spec(ma.Effect.Spec):
        """What stands under ``magnet`` in a scene."""

        at: tuple[float, float, float]  # [m], world axes
        strength: float  # [N m^2]
        softening: float = 0.05  # [m]

    def forces(self, t, state):
        """The force on the object, at its centre of mass."""
        way = np.array(self.spec.at) - state.object_position
        distance = np.sqrt(way @ way + self.spec.softening**2)
        return ma.Loads(object_wrench=[*(self.spec.strength * way / distance**3), 0, 0, 0])


class MagnetNumbers(NamedTuple):
    """What the kernel reads."""

    place: Floats1  # (3,) [m], world axes
    strength: Float  # [N m^2]
    softening: Float  # [m]


open_magnet = view_of_effect(MagnetNumbers)


@cfunc
def pull(address, size, at, _t):
    """Add the force on the first object, and state its power."""
    struct = struct_at(address, size)
    data, magnet, power = open_data(struct), open_magnet(struct, at), 0.0
    squared = magnet.softening**2
    for k in range(3):
        squared += (magnet.place[k] - data.state.poses[0, k]) ** 2
    for k in range(3):
        force = magnet.strength * (magnet.place[k] - data.state.poses[0, k]) / squared**1.5
        data.forces.f_o[k] += force
        power += force * data.state.twists[0, k]
    set_power(struct, at, power)
    return 0


class CompiledMagnet(Magnet):
    """The same as a kernel: nothing in Python is called."""

    name = "compiled_magnet"

    def build(self, context):
        """One kernel with its numbers."""
        spec = self.spec
        numbers = MagnetNumbers(np.array(spec.at), spec.strength, spec.softening)
        return [EffectKernel(self.name, pull, APPLIED, numbers)]
