"""One step of an explicit Runge-Kutta method, and of semi-implicit Euler."""

from __future__ import annotations

from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.coordinates import chart_places
from multiarm.dynamics.status import OK
from multiarm.integration.step import combine, open_step, stage_slope
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import struct_at


@cfunc
def explicit_step(address, size, t, h):
    """Stages after the first, then ``z_new``; returns a status."""
    method, step = open_step(struct_at(address, size))
    for i in range(1, method.stages):
        combine(step, method.A[i], i, h, step.z_stage)
        status = stage_slope(step, t + method.c[i] * h, step.z_stage, step.k[i])
        if status != OK:
            return status
    combine(step, method.b, method.stages, h, step.z_new)
    return OK


@cfunc
def semi_implicit_step(address, size, _t, h):
    """New velocities from the old accelerations, then positions with the new velocities."""
    _, step = open_step(struct_at(address, size))
    z, new, k = step.z, step.z_new, step.k[0]
    velocity = chart_places(open_data(step.system)).velocity
    for i in range(velocity, z.size):
        new[i] = z[i] + h * k[i]
    for i in range(velocity):  # the chart's rotation vectors begin at zero
        new[i] = z[i] + h * new[velocity + i]
    return OK
