r"""Harmonic torques: :math:`\tau_j = \tau_{0j} + A_j \sin(2\pi f t + \psi_j)` [N m, N].

The law has :math:`A\cos\psi` and :math:`A\sin\psi`, so that one sine and one cosine serve all
joints.  Constant torques have no A.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.control.gravity_compensation import holding_torque
from multiarm.control.program import ControlContext, ControlProgram
from multiarm.dynamics.arrays import OPEN_LOOP, open_data
from multiarm.dynamics.control_laws import ControlLaw, view_of_law
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import Float, Floats1, struct_at
from multiarm.scene.control import ConstantControl, HarmonicControl


class Harmonic(NamedTuple):
    """Torques of every joint, each (n,) [N m, N]."""

    frequency: Float  # [Hz]
    constant: Floats1
    sine: Floats1  # A cos(psi)
    cosine: Floats1  # A sin(psi)


open_harmonic = view_of_law(Harmonic)


@cfunc
def harmonic(address, size, at, t):
    """Add the torques."""
    struct = struct_at(address, size)
    data, law = open_data(struct), open_harmonic(struct, at)
    angle = 2.0 * math.pi * law.frequency * t
    sine, cosine = math.sin(angle), math.cos(angle)
    for j in range(data.control.torque.size):
        data.control.torque[j] += law.constant[j] + law.sine[j] * sine + law.cosine[j] * cosine
    return 0


def harmonic_program(control: HarmonicControl, context: ControlContext) -> ControlProgram:
    """The law of harmonic torques."""
    constant = context.stacked(control.offset)
    if control.hold:
        constant += holding_torque(context.data, context.start)
    amplitude, phase = context.stacked(control.amplitude), context.stacked(control.phase)
    sine, cosine = amplitude * np.cos(phase), amplitude * np.sin(phase)
    law = ControlLaw(harmonic, Harmonic(control.frequency, constant, sine, cosine))
    return ControlProgram((law,), reach=OPEN_LOOP)


def constant_program(control: ConstantControl, context: ControlContext) -> ControlProgram:
    """The law of constant torques."""
    torques = context.stacked(control.torques)
    zero = np.zeros_like(torques)
    return ControlProgram(
        (ControlLaw(harmonic, Harmonic(0.0, torques, zero, zero)),), reach=OPEN_LOOP
    )
