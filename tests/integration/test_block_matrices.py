"""Claims about the derivatives of a step arm by arm: they are those of whole evaluations, also
where arms differ; what is declared to act locally does; and what is not is never differentiated so.
"""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import (
    chain_urdf,
    data_of,
    first_difference,
    panda_trio,
    random_state,
    scene_of,
    single_arm,
    ur5_pair,
)  # fmt: skip
from repository import SCENES as SCENE_FILES
from steps import (
    CANCELLING,
    FORWARD,
    ORDER_8,
    Slope,
    assert_derivatives,
    coupled,
    derivatives_of,
    step_of_the_package,
    without_derivatives,
)  # fmt: skip

import multiarm as ma
from multiarm.dynamics.arrays import CARRYING, COUPLED, LOCAL, OPEN_LOOP
from multiarm.problems import ring_of_arms
from multiarm.scene.control import BUILT_IN as CONTROLS
from multiarm.scene.effects import BUILT_IN as EFFECTS
from multiarm.tableaus import METHODS

WELD, BALL = {"kind": "weld"}, {"kind": "ball"}
CHAINS = {"a": ("xuZyw", "ball"), "b": ("zyxzyx", "weld"), "c": ("zyxyzxy", "ball")}
SPRINGS = {"kind": "joint_pd", "stiffness": 300.0, "damping": 20.0, "gravity_compensation": False}


def swing(*arms: str, joints: int = 6, amplitude: float = 8.0):
    """Torques that change with the time, on these arms."""
    own = {arm: [amplitude] * joints for arm in arms}
    return {"kind": "harmonic", "frequency": 1.0, "amplitude": own}


def three_arms(tmp_path, control, **effects):
    """Arms with five, six and seven joints, three or six contacts, hold a box of 4 kg."""
    arms, joints = {}, []
    for k, (name, (kinds, joint)) in enumerate(CHAINS.items()):
        file = tmp_path / f"{name}.urdf"
        file.write_text(chain_urdf(kinds))
        posture = [0.4, -0.3, 0.5, 0.2, -0.4, 0.3, 0.1][: len(kinds)]
        base = {"xyz": [0.9 * k - 0.9, 0.4 * k, 0.0], "rpy": [0, 0, 0.7 * k]}
        arms[name] = {"urdf": str(file), "tip": "tip", "posture": posture, "base": base}
        joints.append({"arm": name, "kind": joint})
    body = {"shape": {"box": [0.2, 0.3, 0.1]}, "mass": 4.0, "pose": {"xyz": [0, 0.4, 1.2]}}
    return ma.compile_system(scene_of(arms, joints, object=body, control=control, effects=effects))


def everything(tmp_path, control):
    """Smooth friction, drag, rotors, lagging drives of two arms, and a load on a link."""
    return three_arms(
        tmp_path,
        control,
        joint_friction={"torque": 2.0, "speed": 0.3},
        joint_damping=40.0,
        drag={"linear": [3.0, 4.0, 5.0], "quadratic": 2.0, "angular": 0.3, "wind": [1.0, 0, 0]},
        rotor_inertia=0.05,
        actuator_lag={"time_constant": {"a": 0.05, "c": [0.02, 0, 0.03, 0.04, 0, 0.02, 0.1]}},
        external_wrenches=[
            {"on": "b/link_4", "at": [0.1, 0, 0], "force": [9, -8, 7], "axes": "body"},
            {"on": "object", "at": [0, 0.1, 0], "force": [5, 6, 7], "axes": "body"},
            {"on": "object", "torque": [1, 2, 0], "sinusoid": {"frequency": 2.0}},
        ],
    )


def egg_on_a_face(_tmp_path):
    """One arm is welded to the box, the other touches its end with a surface of two curvatures."""
    egg = {"ellipsoid": {"center": [0, 0, -0.05], "semi_axes": [0.06, 0.04, 0.05]}}
    face = {"plane": {"point": [0.6, 0, 0], "normal": [1, 0, 0]}}
    contacts = {"arm": "right", "kind": "contacts", "contacts": [{"arm": egg, "object": face}]}
    scene = ma.load_scene(SCENE_FILES / "hinged_box.yaml")
    return ma.compile_system(
        scene.replace(
            gravity=None,
            joints=[{"arm": "left", "kind": "weld"}, contacts],
            control={"kind": "none"},
            effects={"joint_damping": 5.0},
        )
    )


SCENES = {
    "harmonic": lambda tmp: everything(tmp, swing("b")),
    "springs": lambda tmp: everything(tmp, SPRINGS),
    "carried": lambda tmp: everything(tmp, {**SPRINGS, "gravity_compensation": True}),
    "egg on a face": egg_on_a_face,
}


def used(stepping) -> bool:
    """Whether the step has differentiated arm by arm."""
    return bool(stepping.work[0].derived.block_by_block)


# --- the derivatives, and runs with them ---------------------------------------------------------


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_arm_by_arm_are_those_of_whole_evaluations(name, tmp_path, rng):
    """Of accelerations, drives' torques and powers, by all of the state and by the time."""
    system = SCENES[name](tmp_path)
    state = random_state(system, rng, turn=0.05, speed=1.0)
    n, exact = 6 + system.model.layout.rate_count, Slope(system, state)
    own, plain, whole = (
        step_of_the_package(s, state, 1e-3)
        for s in (system, without_derivatives(system), coupled(system))
    )
    assert used(own) and used(plain) and not used(whole)
    J = exact.jacobian(own.step.tolerance.size)[n:]
    by_time = first_difference(lambda s: exact(s, exact.z), 1e-3)
    assert (np.max(np.abs(by_time)) > 1.0) == (name != "egg on a face")
    coarse = CANCELLING if name == "carried" else FORWARD
    in_full = coarse if name == "carried" else ORDER_8
    for stepping, bound in ((own, ORDER_8), (plain, coarse), (whole, in_full)):
        assert_derivatives(np.hstack(derivatives_of(system, stepping)), J, bound)
        atol = 1e-5 * np.max(np.abs(by_time)) + 1e-3
        np.testing.assert_allclose(stepping.work[0].time_slope, by_time, rtol=0, atol=atol)
    slopes = whole.step.k[:8]
    scale = np.max(np.abs(slopes), axis=0) + 1.0
    np.testing.assert_allclose(own.step.k[:8] / scale, slopes / scale, rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_know_the_feedback_on_the_drift(name, tmp_path, rng):
    """Of gaps and their rates, with gains that are far larger than all else."""
    system, alpha, beta = SCENES[name](tmp_path), 300.0, 500.0
    state = random_state(system, rng, turn=0.05, speed=1.0)
    n, exact = 6 + system.model.layout.rate_count, Slope(system, state, alpha, beta)
    own = step_of_the_package(system, state, 1e-3, alpha, beta)
    assert used(own)
    found = np.hstack(derivatives_of(system, own))  # the next step has the same arrays
    J = exact.jacobian(own.step.tolerance.size)[n:]
    free = np.hstack(derivatives_of(system, step_of_the_package(system, state, 1e-3)))
    assert np.max(np.abs(J - free)) > 1e4
    # gaps, times beta^2, make the accelerations up to ten times as large
    assert_derivatives(found, J, 10.0 * ORDER_8)


@pytest.mark.parametrize("name", ["harmonic", "springs", "carried"])
def test_a_run_is_the_same_with_either_derivatives(name, tmp_path):
    system = SCENES[name](tmp_path)
    run = {"duration": 0.4, "integrator": "rodas5p", "tolerance": 1e-9, "output_step": 0.1}
    found, known = ma.simulate(system, **run), ma.simulate(coupled(system), **run)
    np.testing.assert_allclose(found.object_position, known.object_position, rtol=0, atol=1e-9)
    for arm in found.arm_names:
        q, v = found.joint_positions[arm], found.joint_velocities[arm]
        np.testing.assert_allclose(q, known.joint_positions[arm], rtol=0, atol=1e-9)
        np.testing.assert_allclose(v, known.joint_velocities[arm], rtol=0, atol=2e-8)
    np.testing.assert_allclose(found.work, known.work, rtol=0, atol=1e-7)
    assert np.max(np.abs(found.work)) > (0.5 if name == "carried" else 1.0)


def test_drives_near_their_limits_carry_as_much_as_those_far_from_them(tmp_path, rng):
    """Derivatives are those of torques within the limits, however near these are."""
    carrying = {**SPRINGS, "gravity_compensation": True}
    free = three_arms(tmp_path, carrying)
    state = random_state(free, rng, turn=0.05)
    torques = ma.evaluate(free, 0.0, state).joint_torques
    limits = {arm: (np.abs(own) + 0.01).tolist() for arm, own in torques.items()}
    near = three_arms(tmp_path, carrying, torque_limits=limits)
    n = 6 + free.model.layout.rate_count
    found, expected = (
        np.hstack(derivatives_of(system, step_of_the_package(system, state, 1e-3)))[:n]
        for system in (near, free)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_torques_that_are_held_carry_nothing(tmp_path, rng):
    """Between the samples no torque follows the contacts, whatever its laws are."""
    carrying = {**SPRINGS, "gravity_compensation": True, "sample_time": 0.01}
    system = three_arms(tmp_path, carrying)
    assert system.model.constants.control_reach == COUPLED
    state = random_state(system, rng, turn=0.05)
    run = {"duration": 0.03, "integrator": "rodas5p", "tolerance": 1e-9, "output_step": 0.03}
    found, known = (ma.simulate(s, state=state, **run) for s in (system, coupled(system)))
    np.testing.assert_allclose(found.object_twist[-1], known.object_twist[-1], atol=1e-8)


def test_contacts_that_cannot_carry_every_wrench_are_differentiated_whole(rng):
    """The forces of least norm are those of least squares, which s does not describe."""
    carrying = {**SPRINGS, "gravity_compensation": True}
    posture = [0.3, -1.2, 1.4, -0.5, 0.4, 0.2]
    scene = single_arm("ur5", "tool0", posture, BALL, control=carrying, gravity=[0, 0, -9.81])
    system = ma.compile_system(scene)
    assert not used(step_of_the_package(system, random_state(system, rng, turn=0.05), 1e-3))


def test_the_gains_of_drift_feedback_may_grow_as_steps_get_shorter(tmp_path):
    """An error of the derivatives of the gaps would not decrease with the steps."""
    system = SCENES["harmonic"](tmp_path)
    run = {"duration": 0.1, "integrator": "rodas5p", "tolerance": 1e-10, "output_step": 0.1}
    found, known = (
        ma.simulate(s, stabilization="feedback", **run) for s in (system, coupled(system))
    )
    assert found.status == "completed", found.message
    assert found.statistics["steps"] < 1.1 * known.statistics["steps"]
    difference = np.abs(found.object_position[-1] - known.object_position[-1])
    assert np.max(difference) < 1e-9


def test_the_order_is_5_with_lagging_drives_and_for_the_works(tmp_path, monkeypatch):
    system, duration = everything(tmp_path, swing("b")), 0.1
    run = {"duration": duration, "output_step": duration}
    exact = ma.simulate(system, integrator="dop853", tolerance=1e-13, **run)
    monkeypatch.setitem(METHODS, "rk4", METHODS["rodas5p"]._replace(error_order=0))
    errors, steps = [], [48, 64, 96]
    for n in steps:
        found = ma.simulate(system, integrator="rk4", step=duration / n, **run)
        twist = np.max(np.abs(found.object_twist[-1] - exact.object_twist[-1]))
        works, known = found.effect_works, exact.effect_works
        each = [abs(works[name][-1] - known[name][-1]) for name in known]
        errors.append([twist, abs(found.work[-1] - exact.work[-1]), np.max(each)])
    slopes = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    np.testing.assert_allclose(slopes, 5.0, atol=0.25)


# --- what is local -------------------------------------------------------------------------------

LOCAL_EFFECTS = {
    "joint_damping": 30.0,
    "joint_friction": {"torque": 3.0},
    "rotor_inertia": 0.1,
    "torque_limits": 5.0,
    "actuator_lag": 0.02,
    "drag": {"linear": 3.0, "quadratic": 2.0, "angular": 0.5, "wind": [1.0, 0, 0]},
    "external_wrenches": [
        {"on": "left/wrist_2_link", "at": [0, 0.1, 0], "force": [5, 6, 7], "axes": "body"},
        {"on": "object", "at": [0, 0.1, 0], "force": [5, 6, 7], "axes": "body"},
    ],
}
# Their contacts open and close, in modes with solutions of their own.
WITH_EVENTS = {
    "unilateral_contacts", "contact_friction", "contact_compliance", "floor", "joint_limits",
}  # fmt: skip


def test_every_effect_of_ours_is_judged():
    assert set(LOCAL_EFFECTS) | WITH_EVENTS == set(EFFECTS)


def forces(system, state):
    """Right-hand sides, torques and rates of effects' states by owner: left, right, object."""
    ma.evaluate(system, 0.1, state)
    data, last = data_of(system), system.model.layout.first_joint[1]
    b = data.arrays
    joints = np.array([j for own in system.model.effects.kernels for j in own.state_joints])
    rates = b.effects.state_rates if joints.size else joints
    left, right = rates[joints < last], rates[joints >= last]
    return {
        "left": np.concatenate([b.forces.f_j[:last], b.control.torque[:last], left]),
        "right": np.concatenate([b.forces.f_j[last:], b.control.torque[last:], right]),
        "object": b.forces.f_o.copy(),
    }


def moved(system, state, owner):
    """The state with one arm, or the object, elsewhere and faster."""
    other = state.copy()
    if owner == "object":
        other.object_position[:] += 0.01
        other.object_twist[:] += 0.3
    else:
        other.joint_positions[owner][:] += 0.02
        other.joint_velocities[owner][:] += 0.2
    return other


def couplings(system, state):
    """Who feels a displacement of somebody else."""
    here = forces(system, state)
    return {
        (owner, other)
        for owner in here
        for other, value in forces(system, moved(system, state, owner)).items()
        if other != owner and not np.array_equal(value, here[other])
    }


@pytest.mark.parametrize("name", LOCAL_EFFECTS)
def test_a_local_effect_acts_on_nobody_else(name, rng):
    effects = {name: LOCAL_EFFECTS[name]}
    system = ma.compile_system(ur5_pair(WELD, BALL, control=SPRINGS, effects=effects))
    assert system.model.constants.local_effects and system.model.constants.control_reach == LOCAL
    state = random_state(system, rng, turn=0.05)
    assert not couplings(system, state)


@pytest.mark.parametrize("name", LOCAL_EFFECTS)
def test_the_power_of_a_local_effect_is_that_of_its_forces(name, rng):
    """The derivatives of powers are those of forces times velocities."""
    scene = ur5_pair(WELD, BALL, control=SPRINGS)
    free = ma.compile_system(scene)
    system = ma.compile_system(scene.replace(effects={name: LOCAL_EFFECTS[name]}))
    state, forces = random_state(system, rng, turn=0.05), []
    for evaluated in (system, free):
        ma.evaluate(evaluated, 0.0, state)
        b = data_of(evaluated).arrays
        forces.append(np.concatenate([b.forces.f_o, b.forces.f_j - b.control.torque]))
    b = data_of(system).arrays
    power = (forces[0] - forces[1]) @ state.velocity
    assert len(b.effects.power) == 1 or b.effects.power[0] == pytest.approx(power, rel=1e-9)
    assert b.effects.power[-1] == pytest.approx(
        power + b.control.torque @ b.state.joint_rates, rel=1e-9
    )


def test_effects_of_users_and_functions_are_not_local(tmp_path):
    file = tmp_path / "gusts.py"
    file.write_text("def gust(t, state):\n    return [1.0, 0, 0, 0, 0, 0]\n")
    wrench = {"on": "object", "function": f"{file}:gust"}
    scene = ur5_pair(WELD, BALL, effects={"external_wrenches": [wrench]})
    assert not ma.compile_system(scene, code=True).model.constants.local_effects


CONTROLS_OF_ARMS = {
    "none": (OPEN_LOOP, {"kind": "none"}),
    "constant": (OPEN_LOOP, {"kind": "constant", "torques": {"left": [1.0] * 6}}),
    "harmonic": (OPEN_LOOP, swing("left")),
    "joint_pd": (LOCAL, SPRINGS),
    "gravity_compensation": (CARRYING, {"kind": "gravity_compensation"}),
    "joint_pd that carries": (CARRYING, {**SPRINGS, "gravity_compensation": True}),
    "computed_torque": (COUPLED, {"kind": "computed_torque"}),
    "object_impedance": (
        COUPLED,
        {"kind": "object_impedance", "stiffness": {"translation": 500, "rotation": 50},
         "damping": {"translation": 50, "rotation": 5}},
    ),
}  # fmt: skip


TABLE = {"kind": "recorded"}
FOLLOWED = {**TABLE, "quantity": "position", "stiffness": 200.0, "damping": 20.0}
RECORDED = {
    "recorded torques": (OPEN_LOOP, TABLE),
    "recorded positions": (LOCAL, {**FOLLOWED, "gravity_compensation": False}),
    "recorded positions that carry": (CARRYING, {**FOLLOWED, "gravity_compensation": True}),
}


@pytest.mark.parametrize("name", [*CONTROLS_OF_ARMS, *RECORDED])
def test_a_control_says_what_its_torques_depend_on(name, tmp_path, rng):
    reach, control = (CONTROLS_OF_ARMS | RECORDED)[name]
    if name in RECORDED:
        table = tmp_path / "table.csv"
        table.write_text("time,left/elbow_joint\n0,1.0\n1,0.5\n2,0.7\n")
        control = {**control, "file": str(table)}
    system = ma.compile_system(ur5_pair(WELD, BALL, control=control))
    state = random_state(system, rng, turn=0.05)
    if name != "none":
        assert system.model.constants.control_reach == reach
    assert (not couplings(system, state)) == (reach <= LOCAL)
    assert used(step_of_the_package(system, state, 1e-3)) == (reach <= CARRYING)
    moved, torques = random_state(system, rng, turn=0.05), []
    for own in (state, moved):
        torques.append(np.concatenate(list(ma.evaluate(system, 0.1, own).joint_torques.values())))
    assert np.array_equal(*torques) == (reach == OPEN_LOOP)


def test_every_control_of_ours_is_judged():
    """A function is a user's."""
    assert {name.split()[0] for name in CONTROLS_OF_ARMS} | {"recorded", "function"} == set(
        CONTROLS
    )


def test_a_controller_in_python_is_not_local_and_a_sampled_one_holds_torques(rng):
    def control(t, state):
        return {"left": 5.0 * state.joint_positions["right"]}

    system = ma.compile_system(ur5_pair(WELD, BALL, control=SPRINGS))
    state = random_state(system, rng, turn=0.05)
    assert not used(step_of_the_package(system.with_control(control), state, 1e-3))
    sampled = system.with_control(control, sample_time=0.01)
    assert used(step_of_the_package(sampled, state, 1e-3))


# --- where it is not possible, and what it costs -------------------------------------------------


def test_deficient_arms_and_the_dense_solver_are_differentiated_as_a_whole(tmp_path, rng):
    """Six contacts and five joints: the arm cannot be solved on its own."""
    file = tmp_path / "chain.urdf"
    file.write_text(chain_urdf("xuZyw"))
    arm = {"urdf": str(file), "tip": "tip", "posture": [0.3, 0.1, -0.4, 0.5, -0.05]}
    scene = scene_of({"arm": arm}, [{"arm": "arm", **WELD}], effects={"joint_damping": 2.0})
    stiff = ma.compile_system(ur5_pair(WELD, BALL, effects={"joint_damping": 2.0}))
    for system in (ma.compile_system(scene), stiff.with_solver("dense")):
        state = random_state(system, rng, turn=0.05)
        assert not used(step_of_the_package(system, state, 1e-3))
    assert used(step_of_the_package(stiff, random_state(stiff, rng, turn=0.05), 1e-3))


def test_evaluations_of_a_step_do_not_grow_with_the_arms():
    """The beginning and seven more stages; where an effect states no derivative, 2 n displacements
    of all arms and the way back.
    """
    counts = {}
    for n in (2, 5):
        system = ma.compile_system(ring_of_arms(n).replace(effects={"joint_damping": 100.0}))
        state = system.initial_state()
        counts[n] = [
            step_of_the_package(own, state, 1e-3).step.stage.evaluations
            for own in (system, without_derivatives(system))
        ]
    assert counts == {n: [1 + 7, 1 + 12 + 1 + 7] for n in (2, 5)}
    control = swing("east", joints=7)
    trio = ma.compile_system(panda_trio(WELD, control=control, effects={"actuator_lag": 0.05}))
    count = step_of_the_package(trio, trio.initial_state(), 1e-3).step.stage.evaluations
    assert count == 1 + 7
