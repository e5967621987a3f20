"""Claims about control that counts friction: two UR5s press a box between fingertips."""

from __future__ import annotations

import re

import numpy as np
import pytest
from mechanics import state_at
from refusals import assert_wording, refused
from repository import SCENES

import multiarm as ma
from multiarm.control.grip import ANSWERS
from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.failures import require_ok
from multiarm.errors import ControlError, SceneError, SolverError

MASS, END, GRAVITY = 6.0, 0.6, 9.81
PLACES = [(0.06, 0.036), (-0.06, 0.036), (0.0, -0.06)]
SPRING = {
    "stiffness": {"translation": 2000.0, "rotation": 200.0},
    "damping": {"translation": 400.0, "rotation": 40.0},
}
LIFT = [{"time": 2.0, "xyz": [0, 0, 0.7]}]


def gripped(control, mu=0.6, tilt=0.0, **effects):
    """Three spherical fingertips an arm on the ends of a box, whose normals rise by ``tilt``."""
    joints, angle = [], np.radians(tilt)
    for arm, side in (("left", -1.0), ("right", 1.0)):
        normal = [side * np.cos(angle), 0.0, np.sin(angle)]
        face = {"plane": {"point": [side * END, 0, 0], "normal": normal}}
        contacts = [
            {
                "name": f"finger {k + 1}",
                "arm": {"sphere": {"center": [*place, -0.02], "radius": 0.02}},
                "object": face,
            }
            for k, place in enumerate(PLACES)
        ]
        joints.append({"arm": arm, "kind": "contacts", "contacts": contacts})
    return ma.load_scene(SCENES / "two_ur5_box.yaml").replace(
        {"object.mass": MASS},
        joints=joints,
        control=control,
        effects={"contact_friction": mu, "joint_damping": 1.0, **effects},
    )


def compiled(control, **scene):
    return ma.compile_system(gripped(control, **scene))


def computed_torque(**control):
    return {"kind": "computed_torque", **control}


def of_law(system, t, state):
    """The forces that the law commands, (N, 3) of all contacts, and the wrench."""
    with system.borrow() as data:
        laws = data.of_laws
        laws.set_state(t, state)
        require_ok(laws, evaluate_state(laws.struct, 0.0, 0.0))
        rows = laws.arrays.rows
        wrench = laws.arrays.control.object_wrench.copy()
        return rows.static_force.reshape(-1, 3).copy(), rows.W_o.copy(), wrench


def slips(forces):
    """``|t| / n`` of contacts, (..., N) with normal and tangents in turn."""
    parts = forces.reshape(*forces.shape[:-1], -1, 3)
    return np.linalg.norm(parts[..., 1:], axis=-1) / parts[..., 0]


@pytest.fixture(scope="module")
def lifted():
    system = compiled(computed_torque(squeeze=30.0, path=LIFT))
    return system, ma.simulate(system, duration=2.2, accuracy=1e-4, output_step=0.1)


def test_two_hands_of_three_fingertips_lift_a_box_along_its_path(lifted):
    """0.2 m in 2 s, as the quintic says; every contact sticks, and no event tells otherwise."""
    system, run = lifted
    assert run.status == "completed" and run.statistics["contact_events"] == 0
    x = np.minimum(run.time / 2.0, 1.0)
    height = 0.5 + 0.2 * (10 * x**3 - 15 * x**4 + 6 * x**5)
    np.testing.assert_allclose(run.object_position[:, 2], height, atol=1e-4)
    np.testing.assert_allclose(run.object_position[:, :2], 0.0, atol=1e-4)
    for arm in ("left", "right"):
        assert np.all(slips(run.contact_forces[arm]) < (1.0 - 0.2) * 0.6)
    sticking = ("sticking",) * 3
    assert ma.evaluate(system, 1.0, state_at(system, run, 10)).contact_states == {
        "left": sticking,
        "right": sticking,
    }


def test_the_object_accelerates_exactly_as_commanded(lifted):
    system, run = lifted
    for k in (3, 7, 12):
        state, t = state_at(system, run, k), run.time[k]
        x = t / 2.0
        way, rate = 10 * x**3 - 15 * x**4 + 6 * x**5, 30 * (x * (1 - x)) ** 2 / 2.0
        second = 60 * x * (1 - x) * (1 - 2 * x) / 4.0
        z, speed = state.object_position[2], state.object_twist[2]
        expected = 0.2 * second + 20.0 * (0.2 * rate - speed) + 100.0 * (0.5 + 0.2 * way - z)
        found = ma.evaluate(system, t, state).object_acceleration
        np.testing.assert_allclose(found[2], expected, atol=1e-9)


def test_the_law_commands_forces_within_the_margin_that_exert_its_wrench(lifted):
    system, run = lifted
    force, W_o, wrench = of_law(system, run.time[5], state_at(system, run, 5))
    assert np.abs(W_o.T @ force.ravel() - wrench).max() < 1e-10 * np.abs(wrench).max()
    assert np.all(np.linalg.norm(force[:, 1:], axis=1) < 0.8 * 0.6 * force[:, 0])


def test_slips_die_out_in_the_motion_that_the_law_commands():
    """The box moves along its ends: tangents have ``W_o a + W q'' + bias = -delta slip``."""
    system = compiled(computed_torque(relative_damping=7.0))
    state = system.state(object_twist=[0, 0.02, -0.01, 0, 0, 0])
    with system.borrow() as data:
        laws = data.of_laws
        laws.set_state(0.0, state)
        require_ok(laws, evaluate_state(laws.struct, 0.0, 0.0))
        (command,) = laws.law_works
        change = laws.arrays.rows.W_o @ command.acceleration + laws.contact_rows.gap_bias
        for i in range(2):
            contacts = slice(9 * i, 9 * i + 9)
            change[contacts] += laws.work.W[i][:6, :9].T @ command.a_j[6 * i : 6 * i + 6]
        slip = laws.contact_rows.gap_rate.copy()
    assert np.abs(slip).max() > 0.009
    np.testing.assert_allclose(change, -7.0 * slip, atol=1e-9)


@pytest.mark.parametrize("squeeze", [20.0, 60.0])
def test_a_squeeze_is_the_mean_square_of_the_forces_without_weight(squeeze):
    system = ma.compile_system(
        gripped(computed_torque(squeeze=squeeze, friction_margin=0.3)).replace(gravity=None)
    )
    force, _, _ = of_law(system, 0.0, system.initial_state())
    assert np.sum(force**2) / len(force) == pytest.approx(squeeze**2, rel=1e-9)
    pressing = np.concatenate(
        [forces[0::3] for forces in ma.evaluate(system).contact_forces.values()]
    )
    np.testing.assert_allclose(pressing, squeeze, rtol=0.01)


def test_without_a_squeeze_contacts_press_little_more_than_the_margin_needs():
    force, _, _ = of_law(system := compiled(computed_torque()), 0.0, system.initial_state())
    least = MASS * GRAVITY / 6 / (0.8 * 0.6)
    assert np.all(force[:, 0] > least) and np.all(force[:, 0] < 1.01 * least)


def test_internal_forces_of_fingertips_are_those_of_their_normals():
    control = computed_torque(internal_forces={"left": [50.0] * 3, "right": [50.0] * 3})
    force, _, _ = of_law(system := compiled(control), 0.0, system.initial_state())
    np.testing.assert_allclose(force[:, 0], 50.0, rtol=0.01)


def test_an_impedance_holds_the_box_and_gives_way_by_its_stiffness():
    push = [{"on": "object", "at": [0, 0, 0], "axes": "world", "force": [0, 0, 10.0]}]
    system = compiled({"kind": "object_impedance", **SPRING, "squeeze": 40.0})
    run = ma.simulate(system, duration=0.5, accuracy=1e-6)
    assert run.status == "completed" and run.statistics["contact_events"] == 0
    np.testing.assert_allclose(run.object_position[-1], [0, 0, 0.5], atol=1e-8)
    system = compiled(
        {"kind": "object_impedance", **SPRING, "squeeze": 40.0}, external_wrenches=push
    )
    run = ma.simulate(system, duration=6.0, accuracy=1e-6)
    assert run.statistics["contact_events"] == 0
    assert run.object_position[-1, 2] - 0.5 == pytest.approx(10.0 / 2000.0, rel=1e-3)


@pytest.mark.parametrize(
    "control",
    [
        {"kind": "gravity_compensation"},
        {"kind": "joint_pd", "stiffness": 2000, "damping": 200},
    ],
)
def test_gravity_compensation_carries_by_friction_where_a_margin_is_named(control):
    """At rest, with the forces of computed torque; without the margin nothing holds the box."""
    held = compiled({**control, "friction_margin": 0.2, "squeeze": 30.0})
    ev = ma.evaluate(held)
    np.testing.assert_allclose(ev.object_acceleration, 0.0, atol=1e-9)
    moving = compiled(computed_torque(squeeze=30.0))
    for found, expected in zip(
        of_law(held, 0.0, held.initial_state()),
        of_law(moving, 0.0, held.initial_state()),
        strict=True,
    ):
        np.testing.assert_allclose(found, expected, atol=1e-9)
    assert not held.warnings
    falling = ma.evaluate(compiled(control)).object_acceleration
    assert falling[2] == pytest.approx(-GRAVITY)


def test_derivatives_are_those_along_the_motion():
    """The impedance does not depend on the time: ``d a / dt`` is ``da/dx`` times ``dx/dt``."""
    control = {"kind": "object_impedance", **SPRING, "squeeze": 40.0}
    path = [{"time": 0.0, "xyz": [0, 0, 0.52]}, {"time": 1.0, "xyz": [0, 0, 0.52]}]
    system, h = compiled({**control, "path": path}), 1e-3
    run = ma.simulate(system, duration=0.2 + h, accuracy=1e-10, output_step=h)
    k = len(run.time) - 2
    assert run.statistics["contact_events"] == 0
    before, now, after = (ma.evaluate(system, run.time[j], state_at(system, run, j))
                          for j in (k - 1, k, k + 1))  # fmt: skip
    found = ma.derivatives(system, run.time[k], now.state)
    rates = np.concatenate([*now.state.joint_velocities.values()])
    accelerations = np.concatenate([*now.joint_accelerations.values()])
    x_dot = np.concatenate([now.state.object_twist, now.object_acceleration, rates, accelerations])
    change = (after.object_acceleration - before.object_acceleration) / (2 * h)
    along = found.matrix[:6, : len(x_dot)] @ x_dot
    assert np.abs(change).max() > 0.1
    np.testing.assert_allclose(along, change, atol=2e-4 * np.abs(change).max())


def test_friction_that_cannot_carry_names_what_would():
    """Ends that rise by 20 degrees: friction less the margin must be the tangent of this."""
    with refused(ControlError, "control", "friction_margin") as caught:
        compiled(computed_torque(), mu=0.4, tilt=20.0)
    enough = np.tan(np.radians(20.0)) / 0.8
    assert f"such as {enough:.3g} in place of 0.4" in str(caught.value)
    assert compiled(computed_torque(), mu=1.01 * enough, tilt=20.0).model.laws


def test_more_than_friction_can_is_said_where_it_is_asked_for():
    """The reference jumps by 0.3 m across the ends, which stand inclined and carry from below."""
    jump = {"xyz": [0, 0.3, 0.5]}
    path = [{"time": 0.0, **jump}, {"time": 1.0, **jump}]
    system = compiled(computed_torque(path=path), mu=0.3, tilt=-30.0)
    with pytest.raises(SolverError) as caught:
        ma.evaluate(system)
    assert_wording(str(caught.value))
    path = [{"time": 0.05, "xyz": [0, 0, 0.5]}, {"time": 0.3, **jump}]
    system = compiled(computed_torque(path=path, friction_margin=0.5), mu=0.3, tilt=-30.0)
    run = ma.simulate(system, duration=0.3, accuracy=1e-6)
    # just beyond the limit neither forces are found nor a proof that there are none
    assert run.status == "failed" and any(answer in run.message for answer in ANSWERS.values())
    (failure,) = re.findall(r"at t = ([\d.]+) s", run.message)
    assert 0.05 < float(failure) < 0.1
    assert run.statistics["contact_events"] == 0


def test_what_cannot_count_friction_is_refused():
    with refused(ControlError, "control.friction_margin", "contact_friction"):
        compiled(computed_torque(friction_margin=0.2), mu=0.0)
    with refused(SceneError, "squeeze", "friction_margin"):
        gripped({"kind": "gravity_compensation", "squeeze": 10.0})
    with refused(SceneError, "friction_margin", "gravity_compensation"):
        gripped({"kind": "joint_pd", "stiffness": 1, "damping": 1, "friction_margin": 0.1,
                 "gravity_compensation": False})  # fmt: skip
    with refused(SceneError, "friction_margin"):
        gripped(computed_torque(friction_margin=1.0))
    with refused(ControlError, "control"):
        compiled(computed_torque(), mu=0.0)


def test_control_that_needs_no_friction_does_not_count_it(lifted):
    """The rows of laws are those of before, unless friction is needed or asked for."""
    system, _ = lifted
    rows = system.model.unilateral
    assert len(rows.model) == 6 and len(rows.of_laws) == 18
    plain = compiled({"kind": "gravity_compensation"}).model.unilateral
    assert plain.of_laws == plain.model


def test_a_box_is_lifted_off_a_floor_on_which_the_law_does_not_rely():
    """The law sees the fingertips alone, though the floor has friction too."""
    lift, floor = [{"time": 1.0, "xyz": [0, 0, 0.52]}], {"at": {"xyz": [0, 0, 0.3]}, "mu": 0.5}
    system = compiled(computed_torque(squeeze=30.0, path=lift), floor=floor)
    assert len(system.model.unilateral.of_laws) == 18
    run = ma.simulate(system, duration=1.0, accuracy=1e-4, certificate=False)
    assert run.status == "completed" and run.object_position[-1, 2] == pytest.approx(0.52, abs=1e-4)
    assert [event for event in run.events if event["text"] == "floor: corner 1 lets go"]
    assert np.all(run.contact_forces["floor"][-1] == 0.0)
