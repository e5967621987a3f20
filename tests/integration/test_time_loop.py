"""Claims about the loop over time: a step counts when it is complete, and not before."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from event_scenes import ball, box, on_floor
from mechanics import data_of, scene_of, sledge_urdf

import multiarm as ma
from multiarm.dynamics.status import NOT_FINITE
from multiarm.integration.step_control import limited_by_stability
from multiarm.jit.pointers import CFUNC_PROTOTYPE, c_function, function_at
from multiarm.problems.postures import stretched_and_released_scene
from multiarm.results.sinks import MemorySink
from multiarm.simulation.driver import End, state_of
from multiarm.simulation.record import open_sink
from multiarm.simulation.run import begin
from multiarm.simulation.setup import Task, run_spec
from multiarm.tableaus import METHODS


class FailingOutput:
    """Lets the evaluation that follows that of the end of a step fail, once in every third step.

    It is the first stage of the dense output of DOP853, or the state after a jump of the forces.
    ``changed`` are the names of what a run remembers of its steps that has changed by then.
    """

    def __init__(self, driver) -> None:
        self._driver, self._run, self.failures, self.changed = driver, driver.run, 0, set()
        self._functions = driver.run.data.arrays.functions
        self._step, self._attempt, self._at_end, self._failed = -1, None, False, False
        self._advance, driver.advance = driver.advance, self._begin
        self._alive = [self._replace("forces", self._fail), self._replace("record", self._follow)]

    def _begin(self, budget: int):
        self._attempt = None  # events may have been handled
        return self._advance(budget)

    def _replace(self, name: str, prepare: Callable[[], int]):
        original = function_at(getattr(self._functions, name))

        def function(address, size, a, b):
            return prepare() or original(address, size, a, b)

        alive, address = c_function(CFUNC_PROTOTYPE, function)
        setattr(self._functions, name, address)
        return alive

    def _follow(self) -> int:
        """The end of the step is recorded."""
        self._at_end = self._run.data.arrays.time.now > self._run.clock.t
        return 0

    def _fail(self) -> int:
        clock = self._run.clock
        if clock.steps != self._step:
            self._step, self._failed = clock.steps, False
        if (clock.steps, clock.rejected) != self._attempt:
            self._attempt, self._at_end = (clock.steps, clock.rejected), False
            self._before = memory(self._driver)
        if not self._at_end or self._failed or clock.steps % 3:
            return 0
        self._failed, self.failures = True, self.failures + 1
        for name, value in memory(self._driver).items():
            if not np.array_equal(value, self._before[name], equal_nan=True):
                self.changed.add(name)
        return NOT_FINITE


def memory(driver) -> dict[str, np.ndarray]:
    """Copies of what a run remembers of the end of its last step."""
    run = driver.run
    arrays, guards, clock = run.data.arrays, [("reports", run.data.guards)], run.clock
    parts = {f"last_step.{name}": part for name, part in arrays.last_step._asdict().items()}
    parts["last_step.solution"] = arrays.last_step.solution.struct
    of_clock = (
        "t", "steps", "stiff_steps", "smooth_steps", "coupled_steps", "solver_changes",
        "lowest_rank", "highest_rank", "worst_residual", "worst_correction",
    )  # fmt: skip
    parts |= {f"clock.{name}": getattr(clock, name) for name in of_clock}
    if arrays.modes.active:
        modes = driver.events.modes
        guards.append(("guards", modes.guards))
        parts["slides"] = modes.slides.direction
    for which, table in guards:
        for name in ("before", "rate_before", "armed"):
            parts[f"{which}.{name}"] = getattr(table, name)
    return {name: np.array(part) for name, part in parts.items()}


def through_a_singular_posture(_folder):
    return ma.compile_system(stretched_and_released_scene()), 0.3


def rolling_ball(_folder):
    """A ball that slides until it rolls."""
    return ma.compile_system(on_floor(ball(twist=[2.0, 1.0, 0, 0, 0, 0]), mu=0.3)), 0.6


def spinning_box(_folder):
    """A box that slides on four corners, whose slip turns; it does not come to rest."""
    return ma.compile_system(on_floor(box(twist=[0, 1.0, 0, 0, 0, 4.0]), mu=0.3)), 0.3


def spinning_box_with_jumps(folder):
    system, duration = spinning_box(folder)
    model = dataclasses.replace(system.model, breakpoints=np.arange(0.05, duration, 0.05))
    return dataclasses.replace(system, model=model), duration


def two_surfaces_and_a_limit(folder):
    """An ellipsoid that slides around one on a sledge, which passes the limit of its joint."""
    urdf = folder / "sledge.urdf"
    urdf.write_text(sledge_urdf())
    surfaces = {
        "arm": {"ellipsoid": {"semi_axes": [0.2, 0.3, 0.25]}},
        "object": {"ellipsoid": {"semi_axes": [0.1, 0.11, 0.12]}},
    }
    joint = {"arm": "a", "kind": "contacts", "at": {"xyz": [0, 0, 0]}, "contacts": [surfaces]}
    body = {
        "shape": {"box": [0.1, 0.1, 0.1]},
        "mass": 1.0,
        "pose": {"xyz": [0.3, 0, 0]},
        "twist": [0, 0.5, 0, 0, 0, 0],
    }
    arm = {"urdf": str(urdf), "tip": "tip", "posture": [0.0]}
    return ma.compile_system(scene_of({"a": arm}, [joint], object=body, gravity=[0, 0, 0])), 1.0


def outcome(system, duration, fails: bool):
    """Final state, events, and what has let the evaluations fail."""
    method = {"integrator": "dop853", "tolerance": 1e-8}
    spec = run_spec(system.scene.run, {**method, "duration": duration, "output_step": 1e-3})
    sink = MemorySink()
    driver = begin(Task(system, data_of(system), spec, None, np.inf), sink)
    open_sink(sink, system, spec, False)
    failing = FailingOutput(driver) if fails else None
    ending = driver.drive()
    assert ending.end is End.COMPLETED, ending.message
    state = state_of(driver.run, system.model.layout)
    return state, driver.run.log.entries(), failing


@pytest.mark.parametrize(
    "build",
    [
        through_a_singular_posture,
        rolling_ball,
        spinning_box,
        spinning_box_with_jumps,
        two_surfaces_and_a_limit,
    ],
)
def test_a_step_that_fails_after_its_end_was_evaluated_leaves_no_trace(tmp_path, build):
    """The run goes on with a shorter step, to the same end by the same events."""
    system, duration = build(tmp_path)
    state, events, _ = outcome(system, duration, fails=False)
    again, repeated, failing = outcome(system, duration, fails=True)
    assert failing.failures > 3
    assert not failing.changed
    assert [event["kind"] for event in repeated] == [event["kind"] for event in events]
    np.testing.assert_allclose(again.position, state.position, rtol=0, atol=1e-7)
    np.testing.assert_allclose(again.velocity, state.velocity, rtol=0, atol=1e-6)


@pytest.mark.parametrize("share", [0.9, 1.1])
@pytest.mark.parametrize("moved", [0.0, 1e-3, 1.0])
def test_stiffness_is_judged_at_the_projected_end(rng, share, moved):
    """For z' = -lambda z the estimate is lambda, however far projection has ``moved`` the end."""
    tableau, h = METHODS["dopri5"], 0.1
    eigenvalue, stages = share * tableau.stability / h, len(tableau.b)
    z_stage = rng.normal(size=6)
    z_new = z_stage + 1e-6 * rng.normal(size=6)
    z_end = z_new + moved * rng.normal(size=6)
    slopes = np.zeros((stages + 1, 6))
    slopes[stages - 1], slopes[stages] = -eigenvalue * z_stage, -eigenvalue * z_end
    step = SimpleNamespace(k=slopes, z_stage=z_stage, z_new=z_new, tolerance=np.ones(6))
    method = SimpleNamespace(stages=stages, stability=tableau.stability)
    assert limited_by_stability.py_func(method, step, z_end, h) == (share > 1.0)
    if moved and share < 1.0:  # the end before projection has another slope
        assert limited_by_stability.py_func(method, step, z_new, h)
