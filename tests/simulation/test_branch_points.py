"""Claims about linkages that pass positions in which two of their motions cross.

Oracle: the motion of one degree of freedom in closed form, in which no constraint appears.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from linkages import LINKAGES, STEP, compiled, state_on
from mechanics import data_of

import multiarm as ma
from multiarm.dynamics.equations import evaluate_state, keeps_factors
from multiarm.dynamics.solver.bounds import NEAR_LOSS
from multiarm.dynamics.status import OK
from multiarm.integration.methods import make_stepping
from multiarm.integration.near_singular import OFFSET, ZONE, evaluate_on_branch
from multiarm.integration.step import begin_chart, write_slope
from multiarm.integration.step_control import choose_stage_projection
from multiarm.problems import loops
from multiarm.problems.postures import stretched_and_released_scene
from multiarm.tableaus import METHODS

DURATION = 1.5
STARTS = 5
# Settings of a run, and how far it may be from the closed form [m] and in energy (relative).
# A run of an accuracy may be off by ten times that, where crossing motions magnify roundings by
# 1e-8; RK4 with N steps by 1e-3 s at 10 rad/s by (10 * 1e-3)^4 a step, N = 1500 of them.
RUNS = {
    "1e-4": ({"accuracy": 1e-4}, 1e-3),
    "1e-6": ({"accuracy": 1e-6}, 1e-5),
    "1e-9": ({"accuracy": 1e-9}, 1e-8),
    "rk4": ({"integrator": "rk4", "step": 1e-3}, 1500 * 1e-8),
}


@cache
def starts(name):
    """Random coordinates and rates, the same in every run of the tests."""
    rng = np.random.default_rng(20)
    fast = LINKAGES[name][3]
    return tuple(
        (float(rng.uniform(0.3, 2.8)), float(rng.uniform(*fast) * rng.choice([-1.0, 1.0])))
        for _ in range(STARTS)
    )


@cache
def closed_form(name, k):
    """Times, coordinates and the object's centres of the motion from a random start."""
    motion = LINKAGES[name][1]()
    times = np.linspace(0.0, DURATION, 76)
    coordinates = motion.motion(*starts(name)[k], times)
    return times, coordinates, motion.centres(LINKAGES[name][2], coordinates)


def passages(name, coordinates):
    """How often the linkage lies flat: the four-bar once in a turn, the parallelogram twice."""
    turns = (coordinates - math.pi) / (2 * math.pi) if name == "four_bar" else coordinates / math.pi
    return int(np.sum(np.diff(np.floor(turns)) != 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("settings", RUNS)
@pytest.mark.parametrize("name", LINKAGES)
def test_crossing_motions_are_passed_on_the_one_that_the_state_is_on(name, settings):
    run, bound = RUNS[settings]
    crossed = 0
    for k, start in enumerate(starts(name)):
        times, coordinates, centres = closed_form(name, k)
        crossed += passages(name, coordinates)
        trajectory = ma.simulate(
            compiled(name), DURATION, output_step=0.02, state=state_on(name, *start), **run
        )
        assert trajectory.status == "completed", (start, trajectory.message)
        np.testing.assert_allclose(trajectory.time, times, atol=1e-12)
        np.testing.assert_allclose(
            trajectory.object_position, centres, atol=bound, err_msg=str(start)
        )
        scale = np.max(trajectory.kinetic_energy)
        assert np.max(np.abs(trajectory.energy_balance)) < 10 * bound * scale, start
        assert np.max(trajectory.position_drift) < 1e-12, start
        assert trajectory.statistics["residual_max"] < 1e-5, start
        assert np.all(trajectory.rank >= 6)
    assert crossed >= 2 * STARTS


def test_fixed_steps_near_a_loss_of_rank_do_not_depend_on_the_samples():
    """Samples within a step may be nearer to the loss than its end, or farther."""
    start = state_on("four_bar", math.pi - 1.0, 6.0)
    stepper = ma.Stepper(compiled("four_bar"), start, integrator="rk4", step=1e-2)
    stepper.advance(0.02)
    run = stepper._run
    step, data = run.stepping.step, run.data.arrays
    assert data.last_step.solution.margin == data.solution.margin < NEAR_LOSS
    data.solution.margin = 2.0 * NEAR_LOSS  # of a sample
    choose_stage_projection(step, run.clock, run.settings)
    assert step.stage.projects and step.stage.gap == run.settings.gap_tolerance > 0.0
    data.last_step.solution.margin, data.solution.margin = 2.0 * NEAR_LOSS, 0.5 * NEAR_LOSS
    choose_stage_projection(step, run.clock, run.settings)
    assert not step.stage.projects


# --- starts in the flat position -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "flat", "rate", "accuracy"),
    [("parallelogram", 0.0, 3.0, 1e-6), ("four_bar", math.pi, 6.0, 1e-4)],
)
def test_a_start_in_the_flat_position_goes_on_with_the_motion_that_it_has(
    name, flat, rate, accuracy
):
    trajectory = ma.simulate(
        compiled(name), 0.5, accuracy=accuracy, state=state_on(name, flat, rate)
    )
    motion, body = LINKAGES[name][1](), LINKAGES[name][2]
    assert trajectory.status == "completed"
    expected = motion.centres(body, motion.motion(flat, rate, trajectory.time))
    np.testing.assert_allclose(trajectory.object_position, expected, atol=10 * accuracy)
    assert trajectory.rank[0] == 6 and np.all(trajectory.rank[5:25] == 7)
    (told,) = [event for event in trajectory.events if event["kind"].startswith("rank")]
    assert told["kind"] == "rank rises" and "arm" not in told
    assert told["time"] <= trajectory.statistics["largest_step_s"]  # the end of the first step
    assert told["text"] == "rank rises from 6 to 7 independent constraints"


def test_a_start_at_rest_in_the_flat_position_tells_of_its_rank_and_keeps_the_joints():
    """Nothing says which way to go; whichever is taken, joints and energy are kept."""
    trajectory = ma.simulate(
        compiled("parallelogram"), 1.0, accuracy=1e-6, state=state_on("parallelogram", 0.0, 0.0)
    )
    assert trajectory.status == "completed"
    assert trajectory.rank[0] == 6 and trajectory.rank[-1] == 7
    assert [e["text"] for e in trajectory.events if e["kind"].startswith("rank")] == [
        "rank rises from 6 to 7 independent constraints"
    ]
    assert np.max(trajectory.position_drift) < 1e-12
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-5 * np.max(trajectory.kinetic_energy)
    assert np.max(trajectory.kinetic_energy) > 5.0  # it falls


def test_arms_of_one_joint_say_so_at_the_start():
    trajectory = ma.simulate(compiled("four_bar"), 0.01, accuracy=1e-6)
    lost = [event for event in trajectory.events if event["kind"] == "loses a direction"]
    assert [(event["time"], event["arm"]) for event in lost] == [(0.0, "crank"), (0.0, "rocker")]
    for event in lost:
        expected = f"{event['arm']}: its 1 joint leaves 4 of 5 directions without motion"
        assert event["text"] == expected


# --- accelerations near the flat position --------------------------------------------------------


def accelerations(name, coordinate, rate, closed):
    """Object's acceleration on the closed form; ``closed`` < 0: not interpolated."""
    system = compiled(name)
    data_of(system).set_state(0.0, state_on(name, coordinate, rate))
    assert evaluate_on_branch(data_of(system).struct, closed, False, 0.0, 0.0) == OK
    return data_of(system).arrays.accelerations.a_o.copy(), system


def exact_acceleration(name, coordinate, rate):
    """Acceleration of the object's centre: c' s'' + c'' s'^2, c'' from differences of c'."""
    motion, body = LINKAGES[name][1](), LINKAGES[name][2]
    slope = lambda s: np.imag(motion.poses(complex(s, STEP))[body][0]) / STEP  # noqa: E731
    A, A_s, V_s = motion.series(coordinate)
    second = -(0.5 * A_s * rate**2 + V_s) / A
    h = 2e-3
    weights = {1: 45.0, 2: -9.0, 3: 1.0}
    bend = sum(
        w * (slope(coordinate + k * h) - slope(coordinate - k * h)) for k, w in weights.items()
    )
    return slope(coordinate) * second + bend / (60.0 * h) * rate**2


@pytest.mark.parametrize("off", [1e-9, -1e-8, 1e-6, 1e-4, -1e-4, 1e-3, -5e-3])
@pytest.mark.parametrize(
    ("name", "flat", "rate"), [("four_bar", math.pi, 6.0), ("parallelogram", 0.0, -4.0)]
)
def test_acceleration_near_the_flat_position_is_interpolated_to_order_six(name, flat, rate, off):
    """The six states are at most 3 OFFSET away, so that degree 5 leaves OFFSET^6 / 20; were the
    formula exact to degree 3 only, OFFSET^4 / 6 would be left: a thousand times the bound."""
    found, system = accelerations(name, flat + off, rate, 1e-13)
    exact = exact_acceleration(name, flat + off, rate)
    scale = np.linalg.norm(exact)
    bound = 50.0 * OFFSET**6 + 1e-10  # sixth derivatives by the linkage's angle, roundings
    np.testing.assert_allclose(found[:3], exact, atol=bound * scale)
    assert data_of(system).arrays.solution.margin < ZONE


@pytest.mark.parametrize(("off", "further"), [(1e-6, 13), (0.5, 5)])
def test_an_evaluation_near_the_flat_position_counts_as_those_that_it_takes(off, further):
    """Six neighbours are projected, which counts as one, and evaluated; then the state again.
    Far from it two neighbours show that the rank is lost everywhere, which before a run is unknown.
    """
    _, system = accelerations("four_bar", math.pi + off, 6.0, 1e-13)
    arrays = data_of(system).arrays
    assert keeps_factors(arrays)
    assert arrays.interpolation.numbers.evaluations == further
    stepping = make_stepping(data_of(system), METHODS["dop853"])
    step = stepping.step
    begin_chart(data_of(system).struct, step.base, step.z)
    step.stage.projects, step.stage.gap = True, 1e-13
    assert write_slope(stepping.struct, 0.0, step.z, step.slope) == OK
    assert step.stage.evaluations == 2 + further


@pytest.mark.parametrize("off", [1e-9, -1e-8])
def test_the_constraints_of_the_state_alone_do_not_say_how_it_goes_on_there(off):
    """Where a rank is lost the least forces choose an acceleration off both motions."""
    exact = exact_acceleration("four_bar", math.pi + off, 6.0)
    alone, _ = accelerations("four_bar", math.pi + off, 6.0, -1.0)
    assert np.linalg.norm(alone[:3] - exact) > 1e-3 * np.linalg.norm(exact)


def test_interpolation_leaves_the_state_as_it_was():
    state = state_on("four_bar", math.pi + 1e-4, 6.0)
    _, system = accelerations("four_bar", math.pi + 1e-4, 6.0, 1e-13)
    b = data_of(system).arrays
    np.testing.assert_array_equal(
        np.concatenate([b.state.poses[0], b.state.joint_positions]), state.position
    )
    np.testing.assert_array_equal(
        np.concatenate([b.state.twists[0], b.state.joint_rates]), state.velocity
    )


def test_far_from_the_flat_position_nothing_is_interpolated():
    found, system = accelerations("four_bar", math.pi + 0.5, 6.0, 1e-13)
    assert data_of(system).arrays.solution.margin > ZONE
    assert evaluate_state(data_of(system).struct, 0.0, 0.0) == OK
    np.testing.assert_array_equal(found, data_of(system).arrays.accelerations.a_o)


# --- arms that pass singular postures, loops that are closed too often ---------------------------


def test_stretched_elbows_are_passed_and_told():
    system = ma.compile_system(stretched_and_released_scene())
    trajectory = ma.simulate(system, 0.2, output_step=1e-3)
    assert trajectory.status == "completed"
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-5 * np.max(trajectory.kinetic_energy)
    for arm in ("left", "right"):
        (event,) = [event for event in trajectory.events if event["arm"] == arm]
        assert event["kind"] == "passes a singular posture"
        words = f"{arm}: passed a singular posture, little motion along its own reach"
        assert event["text"] == words
        elbow = trajectory.joint_positions[arm][:, 2]
        straight = np.interp(0.0, -elbow, trajectory.time)
        assert elbow[0] > 0.2 and elbow[-1] < -0.2
        # told at the end of the step that passed it
        longest = trajectory.statistics["largest_step_s"]
        assert straight <= event["time"] <= straight + longest


def test_bricards_loop_is_closed_once_too_often_all_along():
    trajectory = ma.simulate(ma.compile_system(loops.bricard_scene()), 2.0)
    assert trajectory.status == "completed"
    moved = np.max(trajectory.kinetic_energy)
    assert moved > 1.0
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-9 * moved
    assert np.max(trajectory.position_drift) < 1e-11
    assert sum(f.shape[1] for f in trajectory.contact_forces.values()) == 10
    assert np.all(trajectory.rank == 9)
    statistics = trajectory.statistics
    assert (statistics["lowest_rank"], statistics["highest_rank"]) == (9, 9)
    assert not [event for event in trajectory.events if event["kind"].startswith("rank")]
