"""Compiled loops over the parts of an evaluation and of a step, for :mod:`.time_shares`.

Each calls, again and again, the very function that the time loop calls, at one state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from multiarm.assembly.loop_closure import projection_tolerance
from multiarm.dynamics.arrays import OK, open_data
from multiarm.dynamics.equations import finite
from multiarm.dynamics.evaluation import evaluate
from multiarm.dynamics.model import Data
from multiarm.errors import SolverError
from multiarm.integration.projection import project
from multiarm.integration.samples import sample_width, write_sample
from multiarm.integration.stepper import (
    begin_chart,
    combine,
    error_estimate,
    load,
    make_method,
    make_step,
    open_step,
    write_slope,
)
from multiarm.jit.kernels import kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import struct_of
from multiarm.studies.bursts import Burst
from multiarm.studies.evaluation_costs import slope_burst, terms_burst
from multiarm.tableaus import METHODS, RK4

OPEN = 1e-9
"""How far the object is moved off its joints before it is projected [m]."""


def part_bursts(data: Data, integrator: str) -> dict[str, Burst]:
    """The loops over the parts, all at the state in the data."""
    struct, work = data.struct, data.work
    state = data.get_state()
    slopes = make_step(RK4, data.model.layout.joints)
    begin_chart(data.struct, slopes.base, slopes.z)
    pushed = slopes.z.copy()
    pushed[:3] += OPEN
    _kinematics_often(struct, 1)
    L, Y = work.L.copy(), work.Y.copy()
    joints = data.model.layout.joints
    sample = np.zeros(sample_width(data))
    closed = projection_tolerance(data)
    evaluate(data, 0.0, state)  # all that samples are made of

    def checked(function: Callable[..., int], *arguments: Any) -> Burst:
        def burst(count: int) -> None:
            if function(struct, *arguments, count) != OK:
                data.reraise()
                raise SolverError("a part of an evaluation failed in the benchmark")

        return burst

    return {
        "evaluation": slope_burst(data),
        "terms": terms_burst(data),
        "kinematics": checked(_kinematics_often),
        "forces": checked(_forces_often),
        "reload": checked(_reload_often, L, Y, work.L, work.Y),
        "reload and solve": checked(_solve_often, L, Y, work.L, work.Y),
        "state": checked(_pass_often, slopes.z, slopes.base, slopes.slope),
        "sample": checked(_sample_often, sample),
        "arithmetic": _arithmetic_burst(joints, integrator),
        # last: it moves the state in the data, which the next turn's evaluations load again
        "projection": checked(_project_often, pushed, slopes.base, closed),
    }


def _arithmetic_burst(joints: int, integrator: str) -> Burst:
    """Sums over the stages of made-up slopes."""
    tableau = METHODS[integrator]
    method, step = make_method(tableau), make_step(tableau, joints)
    step.k[:] = np.random.default_rng(joints).normal(size=step.k.shape)
    arrays = struct_of(method, step)

    def burst(count: int) -> None:
        _combine_often(arrays, count)
        assert np.all(np.isfinite(step.z_new)), "the sums of finite slopes are finite"

    return burst


@kernel
def _kinematics_often(struct, count):
    status = OK
    for _ in range(count):
        status = call_cfunc(open_data(struct).functions.kinematics, struct, 0.0, 0.0)
    return status


@kernel
def _forces_often(struct, count):
    status = OK
    for _ in range(count):
        status = call_cfunc(open_data(struct).functions.forces, struct, 0.0, 0.0)
    return status


@kernel
def _reload(source, out):
    """Write one stack of matrices into another."""
    for i in range(source.shape[0]):
        for a in range(source.shape[1]):
            for b in range(source.shape[2]):
                out[i, a, b] = source[i, a, b]


@kernel
def _reload_often(struct, L, Y, to_L, to_Y, count):
    for _ in range(count):
        _reload(L, to_L)
        _reload(Y, to_Y)
    return OK


@kernel
def _solve_often(struct, L, Y, to_L, to_Y, count):
    status = OK
    for _ in range(count):
        _reload(L, to_L)
        _reload(Y, to_Y)
        status = call_cfunc(open_data(struct).functions.solve, struct, 0.0, 0.0)
    return status


@kernel
def _pass_often(struct, z, base, slope, count):
    """The state's way into the arrays, and the slope's out of them."""
    data = open_data(struct)
    good = True
    for _ in range(count):
        good = finite(z) and good
        load(z, base, data)
        write_slope(z, data, slope)
    return OK if good else 1


@kernel
def _sample_often(struct, row, count):
    data = open_data(struct)
    for i in range(count):
        write_sample(struct, 1e-3 * i, data.power, row)
    return OK


@kernel
def _combine_often(arrays, count):
    """The sums of a step over its stages, and the estimate of its error."""
    method, step = open_step(arrays)
    error = 0.0
    for _ in range(count):
        for i in range(1, method.stages):
            combine(step, method.A[i], i, 1e-3, step.z_stage)
        combine(step, method.b, method.stages, 1e-3, step.z_new)
        error += error_estimate(method, step, 1e-3, 1e-8)
    return error


@kernel
def _project_often(struct, z, base, closed, count):
    """Projection of a state whose joints are open."""
    data = open_data(struct)
    status = OK
    for _ in range(count):
        load(z, base, data)
        status = project(struct, closed)
    return status
