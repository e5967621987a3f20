"""Claims about the derivatives of a step in the matrix of a whole system: they are those of whole
evaluations, and cost no evaluation.
"""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import (
    UR5_POSTURE,
    chain_urdf,
    data_of,
    first_difference,
    over_floor,
    panda_trio,
    random_state,
    scene_of,
    ur5_pair,
)
from steps import (
    CLOSED,
    FORWARD,
    ORDER_8,
    Slope,
    assert_derivatives,
    coupled,
    derivatives_of,
    state_of,
    step_of_the_package,
)
from user_classes import empty_registries

import multiarm as ma
from multiarm.dynamics.coordinates import load_chart
from multiarm.dynamics.status import OK
from multiarm.integration.projection import project
from multiarm.problems import HARD_CASES

WELD, BALL, PLANAR = {"kind": "weld"}, {"kind": "ball"}, {"kind": "planar"}
SPRINGS = {"contact_compliance": {"stiffness": 2e5, "damping": 2e3}}
END = {"arm": {"shoulder_lift_joint": [-3.0, UR5_POSTURE[1]]}}
SIX_FEET = [[x, y, -0.2] for x in (-0.3, 0.1, 0.3) for y in (-0.2, 0.2)]
FEET = [[0.3, 0.2, -0.2], [-0.3, 0.2, -0.2], [0.0, -0.2, -0.2]]


def python_control(t, state):
    """Springs between the arms, with a force that changes with the time."""
    q, v = state.joint_positions, state.joint_velocities
    pull = 30.0 * (q["right"] - q["left"]) - 4.0 * v["left"] + 5.0 * np.sin(3.0 * t)
    return {"left": pull, "right": -pull - 3.0 * state.object_twist}


class Tether(ma.Effect):
    """A spring from the object to the left arm's joints, as a user writes it."""

    name = "tether"

    def forces(self, t, state):
        pull = 40.0 * state.object_position - 3.0 * state.object_twist[3:]
        return ma.Loads([*-pull, 0, 0, t], {"left": 7.0 * state.joint_velocities["right"]})


@pytest.fixture(autouse=True)
def user_classes(monkeypatch):
    empty_registries(monkeypatch)
    ma.register_effect(Tether)


def hanging_box(tmp):
    """An arm of five joints welded to a box: it cannot be solved on its own."""
    file = tmp / "chain.urdf"
    file.write_text(chain_urdf("xuZyw"))
    arm = {"urdf": str(file), "tip": "tip", "posture": [0.3, 0.1, -0.4, 0.5, -0.05]}
    return ma.compile_system(scene_of({"arm": arm}, [{"arm": "arm", **WELD}]))


SPRING = {
    "stiffness": {"translation": [800, 900, 1000], "rotation": [100, 200, 300]},
    "damping": {"translation": 100, "rotation": [10, 20, 30]},
}
MOVING = {"kind": "computed_torque"}
WEIGHT = {"gravity": [1, 2, -9]}


SCENES = {
    "computed torque": lambda tmp: ma.compile_system(
        ur5_pair(WELD, BALL, control=MOVING, effects={"joint_damping": 2.0}).replace(**WEIGHT)
    ),
    "object impedance": lambda tmp: ma.compile_system(
        ur5_pair(WELD, BALL, control={"kind": "object_impedance", **SPRING}).replace(**WEIGHT)
    ),
    "computed torque that squeezes": lambda tmp: ma.compile_system(
        ur5_pair(WELD, WELD, control={**MOVING, "squeeze": 30.0}).replace(**WEIGHT)
    ),
    "object impedance that squeezes": lambda tmp: ma.compile_system(
        ur5_pair(
            WELD, WELD, control={"kind": "object_impedance", **SPRING, "squeeze": 30.0}
        ).replace(**WEIGHT)
    ),
    "computed torque that holds poses": lambda tmp: ma.compile_system(
        ur5_pair(WELD, PLANAR, control={**MOVING, "relative_stiffness": 40.0}).replace(**WEIGHT)
    ),
    "object impedance that holds poses": lambda tmp: ma.compile_system(
        panda_trio(
            BALL, control={"kind": "object_impedance", **SPRING, "relative_stiffness": 40.0}
        ).replace(**WEIGHT)
    ),
    "gravity compensation beside drives that couple": lambda tmp: coupled(
        ma.compile_system(
            ur5_pair(WELD, BALL, control={"kind": "gravity_compensation"}).replace(**WEIGHT)
        )
    ),
    "controller in Python": lambda tmp: ma.compile_system(ur5_pair(WELD, BALL)).with_control(
        python_control
    ),
    "effect in Python": lambda tmp: ma.compile_system(ur5_pair(WELD, BALL, effects={"tether": {}})),
    "dense solver": lambda tmp: ma.compile_system(
        ur5_pair(WELD, BALL, effects={"joint_damping": 2.0})
    ).with_solver("dense"),
    "compliant contacts": lambda tmp: ma.compile_system(ur5_pair(WELD, BALL, effects=SPRINGS)),
    "deficient arm": hanging_box,
    "sliding on the floor": lambda tmp: over_floor(0.0, points=FEET, mu=0.3),
    "sliding on more corners than it needs": lambda tmp: over_floor(0.0, mu=0.3),
    "spinning on four corners": lambda tmp: over_floor(0.0, mu=0.3),
    "spinning on six corners": lambda tmp: over_floor(0.0, points=SIX_FEET, mu=0.3),
    "on the floor": lambda tmp: over_floor(0.0, points=FEET),
    "at the end of a joint": lambda tmp: over_floor(0.1, END),
}


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_in_the_full_matrix_are_those_of_whole_evaluations(name, tmp_path, rng):
    """By all of the state and by the time, with feedback on the drift, at no further evaluation."""
    system, alpha, beta = SCENES[name](tmp_path), 30.0, 50.0
    state = system.initial_state()
    if system.model.unilateral is None:
        state = random_state(system, rng, turn=0.05, speed=1.0)
    elif name.startswith(("sliding", "spinning")):
        state.velocity[[0, 1, *range(6, 12)]] = rng.uniform(-0.5, 0.5, 8)
        state.velocity[5] = 0.4 if name.startswith("spinning") else 0.0
    exact = Slope(system, state, alpha, beta)
    assert exact.data.arrays.solution.motion_unique == (not name.startswith("spinning"))
    stepping = step_of_the_package(system, state, 1e-3, alpha, beta)
    assert not stepping.work[0].derived.block_by_block
    n = 6 + system.model.layout.rate_count
    J = exact.jacobian(stepping.step.tolerance.size)[n:]
    by_time = first_difference(lambda s: exact(s, exact.z), 1e-3)
    bound = FORWARD if name.endswith("Python") else 10.0 * ORDER_8
    assert_derivatives(np.hstack(derivatives_of(system, stepping)), J, bound)
    atol = 1e-5 * np.max(np.abs(by_time)) + 1e-3
    np.testing.assert_allclose(stepping.work[0].time_slope, by_time, rtol=0, atol=atol)
    assert stepping.step.stage.evaluations == 1 + 7


@pytest.mark.parametrize("name", ["bricard", "parallelogram", "duplicated_rows"])
def test_derivatives_of_dependent_constraints_are_those_of_their_rank(name):
    """By all of the state, also off the joints, where the solver takes other constraints for
    dependent as soon as they differ by its tolerance: differences have to stay below that.
    """
    displacement, roundings = 1e-7, 1e-4
    system = ma.compile_system(HARD_CASES[name].scene())
    n = 6 + system.model.layout.rate_count
    run = ma.simulate(system, 0.3, integrator="dop853", tolerance=1e-11, output_step=0.1)
    for k in range(4):
        state = state_of(system, run, k)
        for gain in (0.0, 30.0):
            slope = Slope(system, state, gain, gain)
            J = slope.jacobian(2 * n, displacement)[n:]
            stepping = step_of_the_package(system, state, 1e-3, gain, gain)
            assert slope.data.arrays.solution.dependent > 0
            assert_derivatives(np.hstack(derivatives_of(system, stepping)), J, roundings)
            assert stepping.step.stage.evaluations == 1 + 7


PROJECTED = {
    "four_bar": HARD_CASES["four_bar"].scene,
    "bricard": HARD_CASES["bricard"].scene,
    "parallelogram": HARD_CASES["parallelogram"].scene,
    "moving welds": lambda: ur5_pair(WELD, BALL, control=MOVING, effects={"joint_damping": 2.0}),
    "springs": lambda: ur5_pair(WELD, BALL, effects=SPRINGS),
}


@pytest.mark.parametrize("name", PROJECTED)
def test_derivatives_of_projected_stages_are_those_of_projected_evaluations(name):
    """By all of the state, of which displacements off the joints are projected back.

    A projected stage counts as two evaluations where arms are deficient, and keep the factors of
    the projection, else as three.
    """
    displacement, bound = (1e-7, 1e-4) if name == "bricard" else (1e-3, 1e-7)
    system = ma.compile_system(PROJECTED[name]())
    n = system.model.layout.nv
    run = ma.simulate(system, 0.2, integrator="dop853", tolerance=1e-11, output_step=0.1)
    for k in range(3):
        state = state_of(system, run, k)
        slope = Slope(system, state, projects=True)
        J = slope.jacobian(2 * n, displacement)
        stepping = step_of_the_package(system, state, 1e-3, projects=True)
        full, deficient = stepping.work[2], slope.data.arrays.solution.coupled_blocks > 0
        exact = np.hstack([full.by_position, full.by_velocity[:, :n]])
        assert_derivatives(exact, J[n:], bound)
        of_rates = full.projection[:n]
        assert_derivatives(np.hstack([of_rates[:, 2 * n :], of_rates[:, n : 2 * n]]), J[:n], bound)
        assert deficient == (name in HARD_CASES)
        assert stepping.step.stage.evaluations == (2 if deficient else 3) * (1 + 7)


@pytest.mark.parametrize("name", ["four_bar", "bricard"])
def test_projected_stages_leave_rodas5p_its_order(name):
    """One step has an error of order 6: the rates of positions are those of projected velocities,
    and their derivatives count. Without these it is of order 4.
    """
    system = ma.compile_system(HARD_CASES[name].scene())
    data, closely = data_of(system), {"integrator": "dop853", "tolerance": 1e-13}
    run = ma.simulate(system, 0.2, output_step=0.2, **closely)
    start, lengths, errors = state_of(system, run, 1), (0.04, 0.02, 0.01), []
    for h in lengths:
        end = state_of(system, ma.simulate(system, h, output_step=h, state=start, **closely), 1)
        step = step_of_the_package(system, start, h, projects=True).step
        load_chart(step.z_new, step.base, data.arrays)
        assert project(data.struct, CLOSED) == OK
        wrong = data.arrays.state.configuration - end.position
        errors.append(np.max(np.abs([*wrong, *(data.arrays.state.velocity - end.velocity)])))
    slope = np.polyfit(np.log(lengths), np.log(errors), 1)[0]
    assert slope == pytest.approx(6.0, abs=0.4), errors


def test_a_step_that_was_rejected_leaves_its_derivatives_to_the_next_one():
    """Every attempt has seven stages; an accepted step has its derivatives, its end, its projection
    (which counts as two) besides."""
    push = {"on": "object", "force": [500, 0, 0], "sinusoid": {"frequency": 15.0}}
    sticking = {"torque": 30.0, "speed": 0.01}
    effects = {"external_wrenches": [push], "joint_friction": sticking}
    system = ma.compile_system(ur5_pair(WELD, BALL, effects=effects))
    run = ma.simulate(
        system, 0.1, integrator="rodas5p", tolerance=1e-7, output_step=0.1, certificate=False
    )
    s = run.statistics
    assert s["rejected_steps"] >= 3
    of_ends = s["evaluations"] - 11 * s["steps"] - 7 * s["rejected_steps"]
    assert 0 <= of_ends <= 8  # start, first length, two samples
