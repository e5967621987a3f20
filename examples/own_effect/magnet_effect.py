"""A magnet at a fixed place that pulls the object's centre of mass: f = k d / (|d|^2 + r^2)^(3/2).

d is the way from the object to the magnet [m], k its strength [N m^2], and r keeps the force finite
at the magnet itself [m].
"""

from __future__ import annotations

import numpy as np

import multiarm as ma
from multiarm.effects import APPLIED, POWER, EffectKernel, open_system
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, ints1, struct_at


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


@cfunc
def pull(address, size, at, _t):
    """Own array: place of the magnet, strength, softening."""
    struct = struct_at(address, size)
    _, data, _ = open_system(struct)
    slots, magnet = ints1(struct, int(at)), floats1(struct, int(at) + 1)
    squared = magnet[4] ** 2
    for k in range(3):
        squared += (magnet[k] - data.position[k]) ** 2
    power = 0.0
    for k in range(3):
        force = magnet[3] * (magnet[k] - data.position[k]) / squared**1.5
        data.h_o[k] += force
        power += force * data.twist[k]
    data.power[slots[POWER]] = power
    return 0


class CompiledMagnet(Magnet):
    """The same as a kernel: nothing in Python is called."""

    name = "compiled_magnet"

    def build(self, context):
        """One kernel, with one array."""
        spec = self.spec
        numbers = np.array([*spec.at, spec.strength, spec.softening])
        return [EffectKernel(self.name, pull, APPLIED, (numbers,))]
