"""Claims about control of several objects: weights are carried, some are moved along paths.

The references are forces of least norm from NumPy's pseudo-inverse of all contacts, inverse
dynamics, which is other code, and differences.
"""

from __future__ import annotations

import numpy as np
import pytest
from held_boxes import (
    ON_HINGE,
    SLIDE,
    TO_WORLD,
    WELD,
    box_in_each_hand,
    compiled,
    moving_state,
    two_boxes,
)
from refusals import refused
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.control.joint_pd import path_point
from multiarm.dynamics.coordinates import retract
from multiarm.dynamics.equations import evaluate_state, update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.state import State
from multiarm.errors import ControlError, SceneError
from multiarm.geometry.stencils import CENTRAL_4
from multiarm.scene import parse_scene

STEP = 1e-4  # of differences [m, rad; m/s, rad/s]: truncation 1e-12, roundings 1e-10
DIFFERENCES = 1e-7
AT_REST = 1e-10  # [m/s^2, rad/s^2]
SPRING = {
    "kind": "object_impedance",
    "object": "plate",
    "stiffness": {"translation": [900.0, 800.0, 700.0], "rotation": [20.0, 15.0, 10.0]},
    "damping": {"translation": 120.0, "rotation": 4.0},
    "relative_stiffness": 25.0,
}
PATH = [{"time": 0.4, "xyz": [0.05, 0.04, 0.55], "rpy": [0.1, -0.2, 0.15]}]
NEAR = [{"time": 0.4, "xyz": [-0.24, 0.04, 0.53], "rpy": [0.1, -0.2, 0.15]}]


@pytest.mark.parametrize(
    "joints", [[WELD], [WELD, TO_WORLD]], ids=["carried", "hinged to the world"]
)
def test_gravity_compensation_carries_all_objects_with_the_least_forces(joints):
    system = compiled(two_boxes(*joints), control="gravity_compensation")
    start = system.initial_state()
    evaluation = ma.evaluate(system, 0.0, start)
    assert np.abs(evaluation.accelerations).max() < AT_REST
    with system.borrow() as data:
        data.set_state(0.0, start)
        require_ok(data, evaluate_state(data.struct, 0.0, 0.0))
        W_o = data.arrays.rows.W_o.copy()
        forces = data.arrays.rows.static_force.copy()
    weight = np.zeros((2, 6))
    weight[:, 2] = [8.0 * 9.81, 2.0 * 9.81]
    np.testing.assert_allclose(forces, np.linalg.pinv(W_o.T) @ weight.ravel(), atol=1e-9)


def test_weight_that_no_contact_carries_is_left_to_its_object():
    system = compiled(two_boxes(), control="gravity_compensation")
    evaluation = ma.evaluate(system, 0.0, system.initial_state())
    beam, plate = evaluation.uncarried_wrench.reshape(2, 6)
    np.testing.assert_allclose(beam, 0.0, atol=1e-9)
    np.testing.assert_allclose(plate, [0, 0, 2.0 * 9.81, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(
        evaluation.object_accelerations["plate"], [0, 0, -9.81, 0, 0, 0], atol=1e-9
    )
    np.testing.assert_allclose(evaluation.object_accelerations["beam"], 0.0, atol=1e-9)


def assert_differences(system: ma.System, t: float) -> None:
    """Derivatives of accelerations in motion are those of differences."""
    state = moving_state(system, 3)
    layout, derivatives = state.layout, ma.derivatives(system, t, state)

    def accelerations(displacement, change):
        position = retract(layout, state.position, displacement)
        displaced = State(position, state.velocity + change, layout)
        return ma.evaluate(system, t, displaced).accelerations

    zero, found = np.zeros(layout.nv), derivatives.matrix[: layout.nv]
    for columns, moves in ((layout.displacement_columns, True), (layout.velocity_columns, False)):
        for l, column in enumerate(columns):
            slope = np.zeros(layout.nv)
            for offset, weight in zip(CENTRAL_4.offsets, CENTRAL_4.weights, strict=True):
                step = np.zeros(layout.nv)
                step[l] = offset * STEP
                pair = (step, zero) if moves else (zero, step)
                slope += weight / STEP * accelerations(*pair)
            size = max(1.0, np.abs(slope).max())
            np.testing.assert_allclose(found[:, column], slope, atol=DIFFERENCES * size)


@pytest.mark.parametrize("control", ["gravity_compensation", SPRING], ids=["gravity", "spring"])
def test_derivatives_of_control_are_those_of_differences(control):
    assert_differences(compiled(two_boxes(WELD), control=control), 0.0)


def test_the_spring_takes_the_object_that_it_names_to_the_end_of_its_path():
    goal = [0.1, 0.0, 0.62]
    path = [{"time": 0.5, "xyz": goal}]
    system = compiled(two_boxes(WELD), control={**SPRING, "path": path})
    run = ma.simulate(system, duration=3.0, accuracy=1e-5)
    assert run.status == "completed", run.message
    np.testing.assert_allclose(run.objects["plate"].position[-1], goal, atol=1e-4)
    apart = np.linalg.norm(run.objects["plate"].position - run.objects["beam"].position, axis=1)
    np.testing.assert_allclose(apart, np.hypot(0.1, 0.06), atol=1e-9)


# --- computed torque -----------------------------------------------------------------------------

GAINS = {
    "stiffness": {"translation": [90, 100, 110], "rotation": 70},
    "damping": {"translation": 17, "rotation": [13, 14, 15]},
}
DRIVEN = {
    "carries one": (two_boxes(WELD), {"object": "beam", "path": PATH}),
    "through one": (two_boxes(WELD), {"object": "plate", "path": PATH}),
    "one swings": (two_boxes(ON_HINGE), {"object": "beam", "path": PATH}),
    "one slides": (box_in_each_hand(SLIDE), {"object": "first", "path": NEAR}),
    "both": (box_in_each_hand(), {"objects": {"first": NEAR, "second": None}}),
    "one of two": (box_in_each_hand(), {"object": "second"}),
}


def driven(name: str, **more) -> ma.System:
    scene, control = DRIVEN[name]
    return compiled(scene, control={"kind": "computed_torque", **control, **GAINS, **more})


def commanded(system: ma.System, t: float, state: State) -> dict[str, np.ndarray]:
    """The accelerations of the objects that have a path or are to stay."""
    starts, accelerations = system.initial_state().objects, {}
    for name, path in system.scene.control.paths([*starts]).items():
        begin = Rotation.from_quat(starts[name].quaternion_xyzw)
        shift, turn, x = np.zeros(3), np.zeros(3), t / 0.4
        if path:
            shift = np.array(path[0].xyz) - starts[name].position
            turn = (Rotation.from_matrix(path[0].matrix()[:3, :3]) * begin.inv()).as_rotvec()
        way, rate, second = (
            x**3 * (10 - 15 * x + 6 * x**2),
            30 * x**2 * (1 - x) ** 2 / 0.4,
            60 * x * (1 - x) * (1 - 2 * x) / 0.16,
        )
        both, moving = np.concatenate([shift, turn]), state.objects[name]
        rest = Rotation.from_rotvec(way * turn) * begin
        ahead = starts[name].position + way * shift - moving.position
        turned = (rest * Rotation.from_quat(moving.quaternion_xyzw).inv()).as_rotvec()
        accelerations[name] = second * both
        accelerations[name] += np.array([90, 100, 110, 70, 70, 70]) * [*ahead, *turned]
        accelerations[name] += np.array([17, 17, 17, 13, 14, 15]) * (rate * both - moving.twist)
    return accelerations


@pytest.mark.parametrize("name", DRIVEN)
def test_objects_accelerate_exactly_as_commanded(name):
    system, t = driven(name), 0.15
    state = moving_state(system, 8)
    ev = ma.evaluate(system, t, state)
    for moved, expected in commanded(system, t, state).items():
        size = np.max(np.abs(expected))
        np.testing.assert_allclose(
            ev.object_accelerations[moved], expected, atol=1e-9 * size + 1e-9
        )


@pytest.mark.parametrize("name", ["carries one", "one swings", "one slides", "one of two"])
def test_what_is_not_commanded_follows_as_by_inverse_dynamics(name):
    """Without damping of what is left open, the objects that follow accelerate least."""
    system, t = driven(name, relative_damping=0.0), 0.15
    state = moving_state(system, 8)
    ev = ma.evaluate(system, t, state)
    answer = ma.inverse_dynamics(system, state, commanded(system, t, state))
    for arm, torques in answer.torques.items():
        np.testing.assert_allclose(ev.joint_torques[arm], torques, atol=1e-6)


def test_what_a_slide_leaves_open_dies_out():
    """The box that follows is damped where the slide leaves it free: e' = -10 e."""
    scene, control = box_in_each_hand(SLIDE), {"kind": "computed_torque", "object": "first"}
    scene["objects"]["second"]["twist"] = [0.1, 0, 0, 0, 0, 0]
    run = ma.simulate(compiled(scene, control=control), duration=0.4, accuracy=1e-7)
    assert run.status == "completed", run.message
    speed = run.objects["second"].twist[:, 0]
    assert speed[0] > 0.02  # the start shares the speed among both boxes
    np.testing.assert_allclose(speed, speed[0] * np.exp(-10.0 * run.time), atol=1e-6)


@pytest.mark.parametrize("name", ["carries one", "both", "one swings"])
def test_objects_follow_their_paths_to_the_accuracy_of_the_run(name):
    system = driven(name)
    run = ma.simulate(system, duration=0.6, accuracy=1e-7, output_step=0.6)
    assert run.status == "completed", run.message
    for moved, path in system.scene.control.paths([*run.objects]).items():
        goal = path[-1].xyz if path else run.objects[moved].position[0]
        np.testing.assert_allclose(run.objects[moved].position[-1], goal, atol=1e-6)


@pytest.mark.parametrize("name", ["both", "one swings", "one slides"])
def test_derivatives_of_computed_torque_are_those_of_differences(name):
    assert_differences(driven(name), 0.15)


# --- squeeze -------------------------------------------------------------------------------------

LAWS = {
    "computed torque": {"kind": "computed_torque", "object": "beam"},
    "spring": {**SPRING, "object": "beam"},
}


@pytest.mark.parametrize("law", LAWS)
def test_arms_press_the_object_that_is_moved(law):
    """With 30 N along the line of the grips, and nothing between the boxes changes."""
    plain, pressed = (
        compiled(two_boxes(WELD), control={**LAWS[law], "squeeze": squeeze})
        for squeeze in (0.0, 30.0)
    )
    state = moving_state(plain, 4)
    before, after = (ma.evaluate(system, 0.0, state) for system in (plain, pressed))
    R = Rotation.from_quat(state.objects["beam"].quaternion_xyzw).as_matrix()
    for arm, side in (("left", 1.0), ("right", -1.0)):
        more = after.wrenches[arm] - before.wrenches[arm]
        np.testing.assert_allclose(more[:3], R @ [30.0 * side, 0, 0], atol=1e-7)
    np.testing.assert_allclose(
        after.wrenches["plate-beam"], before.wrenches["plate-beam"], atol=1e-7
    )
    np.testing.assert_allclose(after.accelerations, before.accelerations, atol=1e-8)


def test_forces_that_are_named_press_as_far_as_they_are_internal_to_all():
    rng = np.random.default_rng(2)
    named = {"left": (10 * rng.standard_normal(6)).tolist(), "plate-beam": [5.0] * 6}
    plain = compiled(two_boxes(WELD), control=LAWS["computed torque"])
    pressed = compiled(
        two_boxes(WELD), control={**LAWS["computed torque"], "internal_forces": named}
    )
    before, after = ma.evaluate(plain), ma.evaluate(pressed)
    W_o = before.W_o
    desired = np.concatenate([named["left"], np.zeros(6), named["plate-beam"]])
    expected = desired - np.linalg.pinv(W_o) @ (W_o @ desired)
    more = [after.contact_forces[name] - before.contact_forces[name] for name in before.wrenches]
    np.testing.assert_allclose(np.concatenate(more), expected, atol=1e-7)


@pytest.mark.parametrize("law", LAWS)
def test_derivatives_with_a_squeeze_are_those_of_differences(law):
    assert_differences(compiled(two_boxes(WELD), control={**LAWS[law], "squeeze": 30.0}), 0.0)


# --- paths of springs in the joints --------------------------------------------------------------

SERVO = {"kind": "joint_pd", "stiffness": 20000.0, "damping": 900.0}


@pytest.mark.parametrize(
    ("scene", "paths"),
    [
        (two_boxes(WELD), {"object": "plate", "path": [{"time": 0.4, "xyz": [0.1, 0.03, 0.6]}]}),
        (
            box_in_each_hand(),
            {"objects": {"first": NEAR, "second": [{"time": 0.3, "xyz": [0.25, 0, 0.5]},
                                                   {"time": 0.6, "xyz": [0.25, 0.05, 0.5]}]}},
        ),
        (box_in_each_hand(SLIDE), {"object": "first",
                                   "path": [{"time": 0.4, "xyz": [-0.23, 0, 0.5]}]}),
    ],
    ids=["carried", "both", "slides"],
)  # fmt: skip
def test_joints_lead_objects_along_their_paths(scene, paths):
    system = compiled(scene, control={**SERVO, **paths})
    run = ma.simulate(system, duration=1.0, accuracy=1e-5)
    assert run.status == "completed", run.message
    for name, path in system.scene.control.paths([*run.objects]).items():
        end = run.objects[name]
        np.testing.assert_allclose(end.position[-1], path[-1].xyz, atol=2e-3)
        turn = Rotation.from_quat(end.quaternion_xyzw[-1]).inv()
        turned = Rotation.from_matrix(path[-1].matrix()[:3, :3]) * turn
        assert turned.magnitude() < 5e-3


def test_a_reference_of_the_joints_passes_the_poses_of_both_objects():
    """Also where one passes a pose in the middle of the other's way."""
    second = [{"time": 0.1, "xyz": [0.22, 0, 0.5]}, {"time": 0.7, "xyz": [0.25, 0.05, 0.5]}]
    system = compiled(
        box_in_each_hand(), control={**SERVO, "objects": {"first": NEAR, "second": second}}
    )
    np.testing.assert_allclose(system.model.breakpoints, [0.0, 0.1, 0.4, 0.7])
    law, times = system.model.laws[0].numbers, [0.0, 0.1, 0.25, 0.4, 0.7, 0.9]
    n = system.model.layout.rate_count
    with system.borrow() as data:
        for t in times:
            angles = [path_point(t, law.bounds, law.coefficients, j)[0] for j in range(n)]
            state = system.initial_state().copy()
            state.layout.joint_positions(state.position)[:] = angles
            for name, (position, quaternion) in poses_at(system, t).items():
                state.objects[name].position[:] = position
                state.objects[name].quaternion_xyzw[:] = quaternion
            data.set_state(t, state)
            require_ok(data, update_kinematics(data.struct))
            np.testing.assert_allclose(data.contact_rows.gap, 0.0, atol=1e-7)


def poses_at(system: ma.System, t: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Poses of both objects, by quintics from pose to pose."""
    poses = {}
    for name, path in system.scene.control.paths(["first", "second"]).items():
        start = system.initial_state().objects[name]
        times = [0.0, *(waypoint.time for waypoint in path)]
        places = [start.position, *(np.array(waypoint.xyz) for waypoint in path)]
        turns = [Rotation.from_quat(start.quaternion_xyzw)]
        turns += [Rotation.from_matrix(waypoint.matrix()[:3, :3]) for waypoint in path]
        s = min(max(int(np.searchsorted(times, t, side="right")) - 1, 0), len(path) - 1)
        x = np.clip((t - times[s]) / (times[s + 1] - times[s]), 0.0, 1.0)
        way = x**3 * (10 - 15 * x + 6 * x**2)
        turn = (turns[s + 1] * turns[s].inv()).as_rotvec()
        place = places[s] + way * (places[s + 1] - places[s])
        poses[name] = place, (Rotation.from_rotvec(way * turn) * turns[s]).as_quat()
    return poses


def test_an_empty_list_is_an_empty_entry():
    for kind in ({"kind": "computed_torque"}, SERVO):
        nothing, empty = (
            parse_scene(box_in_each_hand(control={**kind, "objects": {"first": NEAR, "second": e}}))
            for e in (None, [])
        )
        assert nothing == empty


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("control", "place"),
    [
        ({**SPRING, "object": "plank"}, "$.control.object"),
        ({"kind": "computed_torque"}, "$.control.object"),
        ({"kind": "computed_torque", "objects": {"plank": None}}, "$.control.objects.plank"),
        ({"kind": "computed_torque", "objects": {}}, "$.control"),
        ({"kind": "computed_torque", "objects": {"beam": PATH}, "path": PATH}, "$.control"),
        ({**SERVO, "path": PATH}, "$.control.object"),
        ({**SERVO, "object": "beam"}, "$.control.object"),
    ],
)
def test_controls_that_do_not_say_which_object_are_refused(control, place):
    with refused(SceneError, place):
        parse_scene(two_boxes(WELD, control=control))


@pytest.mark.parametrize(
    ("joints", "control", "name"),
    [
        ([ON_HINGE], {"object": "plate"}, "plate"),
        ([], {"objects": {"beam": None, "plate": None}}, "plate"),
    ],
)
def test_an_object_that_no_contacts_move_in_every_direction_is_refused(joints, control, name):
    with pytest.raises(ControlError, match=f"on the object '{name}'"):
        compiled(two_boxes(*joints), control={"kind": "computed_torque", **control})


def test_paths_that_would_open_a_joint_are_refused():
    """A turn about z, of one of two boxes in line: 0.05 m from the axis it is 0.05 sin(0.4) m."""
    turned = [{"time": 0.4, "xyz": [-0.2, 0, 0.5], "rpy": [0, 0, 0.4]}]
    control = {"kind": "computed_torque", "objects": {"first": turned, "second": None}}
    with pytest.raises(ControlError, match=r"at 0\.\d+ s the path of .* open the joint 'slide' by"):
        compiled(box_in_each_hand(SLIDE), control=control)
    along = [{"time": 0.4, "xyz": [-0.23, 0, 0.5], "rpy": [0.5, 0, 0]}]
    compiled(
        box_in_each_hand(SLIDE), control={**control, "objects": {"first": along, "second": None}}
    )
