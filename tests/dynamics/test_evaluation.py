"""What an evaluation promises beside its numbers: it stays as it is, and its wrenches add up."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from functools import cached_property

import numpy as np
import pytest
from event_scenes import arm, ball, ball_on_plate, box, on_floor
from mechanics import (
    UR5_WRIST_SINGULAR,
    arrays_by_name,
    data_of,
    two_arm_block_twice,
    ur5_pair,
)
from repository import SCENES

import multiarm as ma
from multiarm.spatial import quaternion_to_matrix

LATER = [
    name
    for name, value in vars(ma.Evaluation).items()
    if isinstance(value, cached_property) and not name.startswith("_")
]
PUSH = {"on": "object", "force": [3.0, -2.0, 5.0], "torque": [0.3, 0.2, -0.1], "axes": "world"}
DEPTH = 1e-3  # [m] by which a compliant contact is pressed


def welded():
    return ma.load_scene(SCENES / "two_ur5_box.yaml")


def grasped():
    return ma.load_scene(SCENES / "grasped_block.yaml")


def sliding_box():
    return on_floor(box(twist=[1.0, 0.3, 0, 0, 0, 0.2]), mu=0.3)


def compiled(scene, solver):
    return ma.compile_system(scene).with_solver(solver)


def singular_state(system):
    return system.state(joint_positions={"left": UR5_WRIST_SINGULAR})


def other_state(system):
    """A moving state near the start; where contacts come and go, positions stay."""
    state = system.initial_state()
    rng = np.random.default_rng(3)
    if system.model.unilateral is None:
        state.position[:] += 0.1 * rng.standard_normal(state.position.size)
        state.position[3:7] /= np.linalg.norm(state.position[3:7])
    state.velocity[6:] += 0.01 * rng.standard_normal(state.velocity.size - 6)
    return state


def overwrite(system) -> None:
    """Leave nothing in the arrays that an evaluation writes."""
    data = data_of(system)
    b = data.arrays
    arrays = {**arrays_by_name(b, "arrays"), **arrays_by_name(data.coupled, "coupled")}
    for array in (*arrays.values(), data.work.M, data.work.W):
        if isinstance(array, np.ndarray) and array is not b.bodies.pointers:
            array[:] = 0 if array.dtype == np.int64 else np.nan
    addresses = data.arrays.functions.struct.copy()
    solved = b.last_step.solution
    for numbers in (b.time, b.status, b.solution, b.check, solved, data.coupled.status):
        numbers.struct[:] = 0
    np.testing.assert_array_equal(data.arrays.functions.struct, addresses)


def everything(ev: ma.Evaluation) -> dict:
    """All that an evaluation tells, in plain numbers and words."""
    told = {
        field.name: getattr(ev, field.name)
        for field in fields(ev)
        if not field.name.startswith("_") and field.name != "state"
    }
    told |= {name: getattr(ev, name) for name in LATER}
    told["state"] = [ev.state.position, ev.state.velocity]
    told["residuals"] = vars(ev.residuals)
    spaces = {name: ev.motion_space(name) for name in ev.joint_accelerations}
    told["motion"] = {name: [space.T, space.T_dot] for name, space in spaces.items()}
    told["rates"] = {name: ev.relative_rates(name) for name in ev.joint_accelerations}
    told["internal"] = ev.internal_forces().basis
    told["decomposition"] = ev.force_decomposition().moving
    return told


def assert_same(found, expected, where="") -> None:
    if isinstance(expected, dict):
        assert list(found) == list(expected), where
        for key in expected:
            assert_same(found[key], expected[key], f"{where}/{key}")
    elif isinstance(expected, tuple | list):
        assert len(found) == len(expected), where
        for k, (one, other) in enumerate(zip(found, expected, strict=True)):
            assert_same(one, other, f"{where}/{k}")
    elif isinstance(expected, np.ndarray):
        np.testing.assert_array_equal(found, expected, err_msg=where)
    else:
        assert found == expected, where


CASES = {
    "welded": (welded, "node", lambda s: s.initial_state()),
    "dense": (welded, "dense", lambda s: s.initial_state()),
    "singular": (lambda: ur5_pair({"kind": "weld"}, {"kind": "ball"}), "node", singular_state),
    "repeated": (two_arm_block_twice, "node", lambda s: s.initial_state()),
    "grasped": (grasped, "node", lambda s: s.initial_state()),
    "sliding": (sliding_box, "node", lambda s: s.initial_state()),
}


@pytest.mark.parametrize("case", CASES)
def test_an_evaluation_stays_what_it_was(case):
    scene, solver, place = CASES[case]
    system = compiled(scene(), solver)
    state = place(system)
    fresh = everything(ma.evaluate(compiled(scene(), solver), 0.1, state))
    ev = ma.evaluate(system, 0.1, state)
    ma.evaluate(system, 0.2, other_state(system))
    if case != "dense":
        ma.simulate(system, 0.003, accuracy=1e-4, certificate=False)
    overwrite(system)
    state.position[:] = state.velocity[:] = np.nan
    assert_same(everything(ev), fresh)


@pytest.mark.parametrize("case", CASES)
def test_residuals_are_roundings(case):
    scene, solver, place = CASES[case]
    system = compiled(scene(), solver)
    ev = ma.evaluate(system, 0.0, place(system))
    size = max(np.max(np.abs(force)) for force in ev.contact_forces.values())
    largest = max(vars(ev.residuals).values())
    assert 0.0 < largest < 1e-9 * size
    # four corners that slide in different directions: how they share the weight changes the motion
    assert ("friction leaves the motion open" in ev.message) == (case == "sliding")


def test_what_is_computed_later_differs_between_two_states():
    system = ma.compile_system(welded())
    here, there = ma.evaluate(system), ma.evaluate(system, 0.0, other_state(system))
    for name in ("contact_points", "contact_normals", "wrenches"):
        assert not np.allclose(getattr(here, name)["left"], getattr(there, name)["left"]), name
    assert not np.allclose(here.contact_terms["left"].phi, there.contact_terms["left"].phi)


def test_an_evaluation_can_be_read_while_its_system_runs():
    system = ma.compile_system(welded())
    fresh = everything(ma.evaluate(ma.compile_system(welded())))
    ev, told = ma.evaluate(system), []
    trajectory = ma.simulate(
        system,
        0.05,
        accuracy=1e-4,
        certificate=False,
        progress=lambda t: told.append(everything(ev)),
    )
    assert trajectory.status == "completed" and told
    assert_same(told[0], fresh)


def test_threads_with_a_system_each_read_their_evaluations():
    systems = [ma.compile_system(welded()) for _ in range(2)]
    states = [systems[0].initial_state(), other_state(systems[0])]
    fresh = [everything(ma.evaluate(systems[0], 0.0, state)) for state in states]

    def work(k: int) -> list[dict]:
        kept = [ma.evaluate(systems[k], 0.0, state) for state in 5 * states]
        return [everything(ev) for ev in kept]

    with ThreadPoolExecutor(2) as pool:
        for found in pool.map(work, range(2)):
            for k, own in enumerate(found):
                assert_same(own, fresh[k % 2])


def test_an_evaluation_in_a_line_or_two():
    ev = ma.evaluate(ma.compile_system(welded()))
    text = repr(ev)
    largest = max(np.max(np.abs(force)) for force in ev.contact_forces.values())
    assert f"rank={ev.rank}" in text and f"{largest:.3g} N" in text and text.count("\n") <= 1


def pushed():
    return welded().replace(effects={"external_wrenches": [PUSH]})


def sliding_and_pushed():
    return on_floor(
        box(twist=[1.0, 0.3, 0, 0, 0, 0.2]), mu=0.3, effects={"external_wrenches": [PUSH]}
    )


def ball_on_a_spring():
    soft = {"contact_compliance": {"stiffness": 1e4, "damping": 30.0}}
    return ball_on_plate(arm("z"), ball(mass=2.0), effects=soft)


BALANCED = {
    "welded": welded,
    "three pandas": lambda: ma.load_scene(SCENES / "three_panda_plate.yaml"),
    "hinged": lambda: ma.load_scene(SCENES / "hinged_box.yaml"),
    "pushed": pushed,
    "grasped": grasped,
    "sliding": sliding_box,
    "sliding and pushed": sliding_and_pushed,
    "on a spring": ball_on_a_spring,
}


def test_results_that_have_arrays_are_compared_by_identity():
    system = ma.compile_system(ma.load_scene(SCENES / "two_ur5_box.yaml"))
    derivatives = ma.derivatives(system)
    for result in (system.initial_state(), derivatives, derivatives.object_acceleration):
        equal = replace(result, layout=result.layout)
        assert result != equal and len({result, equal}) == 2


@pytest.mark.parametrize("case", BALANCED)
def test_wrenches_loads_and_weight_accelerate_the_object(case):
    system = ma.compile_system(BALANCED[case]())
    state = other_state(system)
    state.velocity[:6] += [0.1, 0.05, 0.0, 0.0, 0.0, 0.4]
    if case == "on a spring":
        state.position[2] -= DEPTH
    ev = ma.evaluate(system, 0.0, state)
    R = quaternion_to_matrix(state.object_quaternion_xyzw)
    body, omega = system.scene.object, state.object_twist[3:]
    inertia = R @ body.inertia_matrix() @ R.T
    force = body.mass * np.array(system.scene.gravity)
    moment = -np.cross(omega, inertia @ omega)
    if "pushed" in case:
        force, moment = force + PUSH["force"], moment + PUSH["torque"]
    total = sum(ev.wrenches.values())
    moved = np.concatenate(
        [
            body.mass * ev.object_acceleration[:3] - force,
            inertia @ ev.object_acceleration[3:] - moment,
        ]
    )
    largest = max(np.max(np.abs(own)) for own in ev.contact_forces.values())
    assert largest > 0.1 * body.mass
    np.testing.assert_allclose(total, moved, atol=1e-9 * largest)
    assert list(ev.wrenches) == list(ev.contact_forces)


def test_a_sliding_box_is_dragged_by_mu_times_what_carries_it():
    ev = ma.evaluate(ma.compile_system(sliding_box()))
    normal, tangential = ev.normal_forces["floor"], ev.tangential_forces["floor"]
    assert normal.shape == (len(ev.contact_states["floor"]),) and tangential.shape[1] == 2
    np.testing.assert_allclose(np.linalg.norm(tangential, axis=1), 0.3 * normal, rtol=1e-9)
    assert normal.sum() == pytest.approx(2.0 * 9.81)
    # along the tangents that are told
    tangents = ev.contact_normals["floor"].reshape(-1, 3, 3)[:, 1:]
    drag = np.einsum("kt,ktx->x", tangential, tangents)
    np.testing.assert_allclose(drag, ev.wrenches["floor"][:3] - [0, 0, 2.0 * 9.81], atol=1e-9)


def test_without_friction_all_forces_are_normal():
    ev = ma.evaluate(ma.compile_system(welded()))
    for name, force in ev.contact_forces.items():
        np.testing.assert_array_equal(ev.normal_forces[name], force)
        assert ev.tangential_forces[name].shape == (force.size, 2)
        assert not ev.tangential_forces[name].any()


def test_a_state_at_which_no_contact_mode_holds_is_told():
    """A box a millimetre below the floor: every corner would have to be closed, and is not."""
    system = compiled(on_floor(box(), mu=0.3), "node")
    assert ma.evaluate(system).contradictions == () and not ma.evaluate(system).message
    state = system.initial_state()
    state.position[2] -= 1e-3
    for ev in (ma.evaluate(system, 0.0, state), ma.derivatives(system, 0.0, state).evaluation):
        below = [f"floor/corner {k}" for k in (1, 3, 5, 7)]
        assert list(ev.contradictions) == below
        assert ev.message.startswith("no contact mode holds at this state: ")
        assert all(name in ev.message for name in below)
