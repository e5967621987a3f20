"""Single steps of an implicit method, and their derivatives as whole matrices."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from mechanics import data_of, first_difference

import multiarm as ma
from multiarm.dynamics.effect_kernels import EffectProgram
from multiarm.dynamics.model import effect_constants
from multiarm.dynamics.status import OK
from multiarm.events.evaluation import enter_mode_at
from multiarm.integration.step import Stage, evaluate_slope
from multiarm.jit.pointers import function_at
from multiarm.results.event_log import EventLog
from multiarm.simulation.setup import Task, prepare, run_spec


def coupled(system):
    """The same system with effects that are not declared local."""
    return replace(system, model=system.model.with_constants(local_effects=False))


def without_derivatives(system):
    """The same system with laws and effects that state no derivatives."""
    kernels = (replace(kernel, derivative=None) for kernel in system.model.effects.kernels)
    effects = EffectProgram(tuple(kernels))
    laws = tuple(replace(law, derivative=None) for law in system.model.laws)
    control = system.model.constants.control.copy()  # which has the addresses of derivatives
    constants = system.model.constants._replace(control=control, **effect_constants(effects))
    model = replace(system.model, effects=effects, laws=laws, constants=constants)
    return replace(system, model=model)


# Gap to which projected stages are closed [m].
CLOSED = 1e-13


def step_of_the_package(system, state, h, alpha=0.0, beta=0.0, projects=False):
    """The arrays of one step of length ``h`` from time 0; with gains of the drift feedback."""
    method = {"integrator": "rodas5p", "tolerance": 1.0, "stabilization": "none"}
    spec = run_spec(system.scene.run, {**method, "duration": h, "output_step": h})
    data = data_at(system, state)
    run = prepare(Task(system, data, spec, state, np.inf), None, EventLog())
    stepping = run.stepping
    step, struct = stepping.step, stepping.struct
    step.k[0] = step.slope
    step.stage.alpha, step.stage.beta = alpha, beta
    step.stage.projects, step.stage.gap = projects, CLOSED
    make = function_at(stepping.coefficients.step)
    assert make(struct.ctypes.data, struct.size, 0.0, h) == OK
    return stepping


def data_at(system, state):
    """Data, evaluated at a state; with unilateral contacts those of its mode."""
    if system.model.unilateral is not None:
        return enter_mode_at(data_of(system), 0.0, state).data
    ma.evaluate(system, 0.0, state)
    return data_of(system)


def state_of(system, run, k):
    """The state of a sample."""
    q, v = ({arm: x[k] for arm, x in of_arms.items()} for of_arms in (
        run.joint_positions, run.joint_velocities
    ))  # fmt: skip
    pose = run.object_position[k], run.object_quaternion_xyzw[k]
    parts = "position", "quaternion_xyzw", "twist"
    bases = {
        robot: {part: getattr(base, part)[k] for part in parts} for robot, base in run.bases.items()
    }
    return system.state(*pose, q, run.object_twist[k], v, bases=bases)


class Slope:
    """The rate of a step's state by evaluations of the whole system, at any state and time."""

    def __init__(self, system, state, alpha=0.0, beta=0.0, projects=False):
        self.data = data_at(system, state)
        inner, works = self.data.effect_states(), np.zeros(self.data.arrays.effects.power.size)
        layout = system.model.layout
        shift, self.base = np.zeros(layout.nv), np.zeros(layout.nq)
        layout.joint_rates(shift)[:] = layout.joint_positions(state.position)
        for poses, base_poses, shifts in (
            (layout.poses(state.position), layout.poses(self.base), layout.twists(shift)),
            (layout.base_poses(state.position), layout.base_poses(self.base),
             layout.base_twists(shift)),
        ):  # fmt: skip
            for pose, base_pose, of_frame in zip(poses, base_poses, shifts, strict=True):
                of_frame[:3], base_pose[3:] = pose[:3], pose[3:]
        self.z = np.concatenate([shift, state.velocity, inner, works])
        self.stage = Stage(alpha=alpha, beta=beta, projects=projects, gap=CLOSED, latest=np.inf)

    def __call__(self, t, z):
        slope = np.zeros(z.size)
        assert evaluate_slope(self.data.struct, self.stage, t, z, self.base, slope) == OK
        return slope

    def jacobian(self, size, displacement=1e-3):
        """Derivatives by the first ``size`` entries of the state, by differences of order 8."""
        along = lambda e: lambda s: self(0.0, self.z + s * e)  # noqa: E731
        return np.column_stack(
            [first_difference(along(e), displacement) for e in np.eye(self.z.size)[:size]]
        )


# What differences leave, relative to the largest entry of a column: of order 8 with displacements
# of 1e-3, roundings of 1e-15 / 1e-3 of accelerations that are up to 1e3 times as large as their
# derivatives; the steps' own, forward ones with displacements of 1e-7; these where they are
# differences of accelerations in which the terms of the weight cancel.
ORDER_8, FORWARD, CANCELLING = 2e-9, 2e-5, 1e-4


def assert_derivatives(found, J, bound):
    """Column by column, relative to the largest entry or to 1."""
    scale = np.maximum(np.max(np.abs(J), axis=0), 1.0)
    assert np.max(np.abs(found - J) / scale) < bound


def derivatives_of(system, stepping):
    """Of accelerations, inner rates and powers, by positions and by velocities and inner states."""
    work, blocks, full = stepping.work
    if not work.derived.block_by_block:
        return full.by_position, full.by_velocity
    layout, works = system.model.layout, stepping.step.z.size - stepping.step.tolerance.size
    n, size = 6 + layout.rate_count, stepping.step.tolerance.size
    d, m, e = blocks.d, blocks.m, blocks.e
    found, own, own_columns = np.zeros((size + works, size)), 2 * d + e, []
    u, of_object = blocks.couplings, [*range(6), *range(n, n + 6)]
    chi = np.zeros((u, size))
    chi[:, of_object] = blocks.by_object[:u, :12]
    found[size:, of_object] = blocks.by_object[u:, :12]
    for i, (first, last) in enumerate(itertools.pairwise(layout.first_joint)):
        joints, states = np.arange(first, last), blocks.states[i, : blocks.counts[i]]
        columns = np.r_[6 + joints, n + 6 + joints, 2 * n + states]
        local = np.r_[: last - first, d : d + last - first, 2 * d : 2 * d + states.size]
        chi[:, columns] = blocks.on_object[i][:, local]
        own_columns.append((columns, local))
    found[n : n + 6] = chi[:6]
    for i, (first, last) in enumerate(itertools.pairwise(layout.first_joint)):
        A, (columns, local) = blocks.derivatives[i], own_columns[i]
        rows = n + 6 + np.arange(first, last)
        found[np.ix_(rows, columns)] = A[: last - first, local]
        found[np.ix_(rows, np.r_[:6, n : n + 6])] = A[: last - first, own : own + 12]
        found[rows] += A[: last - first, own + 13 :] @ chi
        states = columns[2 * (last - first) :]
        found[np.ix_(states, columns)] = A[d + m : d + m + states.size, local]
        found[np.ix_(states, of_object)] = A[d + m : d + m + states.size, own : own + 12]
        found[states] += A[d + m : d + m + states.size, own + 19 :] @ chi[6:]
        found[size:, columns] += A[d + m + e :, local]
        found[size:, of_object] += A[d + m + e :, own : own + 12]
        found[size:] += A[d + m + e :, own + 19 :] @ chi[6:]
    return found[n:, :n], found[n:, n:]
