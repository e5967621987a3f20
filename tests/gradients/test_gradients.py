"""Claims about derivatives of whole runs: forward sensitivities and adjoint gradients.

The independent answers are closed forms (a sledge on a spring), differences of runs of high
accuracy, matrix exponentials, and each of the two directions for the other.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from mechanics import (
    difference,
    planar_pair,
    random_state,
    scene_of,
    sledge_urdf,
    state_at,
    ur5_pair,
)
from random_scenes import random_scene
from refusals import refused
from repository import SCENES
from scipy.integrate import quad
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.assembly.start import project_start
from multiarm.errors import ModelError, SceneError, SolverError
from multiarm.gradients import linearised_run as linearised_module
from multiarm.gradients.collocation import COUNT, NODES, WEIGHTS, Collocation
from multiarm.gradients.gradient import _AdjointSolver
from multiarm.gradients.gradient import _solved_with_error as _backward
from multiarm.gradients.interpolation import DEGREES, Series, nodes
from multiarm.gradients.linearised_run import LinearisedRun
from multiarm.gradients.phase import Phase
from multiarm.gradients.run_series import RunSeries
from multiarm.gradients.segments import PATIENCE, RICHARDSON, WHOLE, CollocatedPanel, Panel, Segment
from multiarm.gradients.sensitivities import _ForwardSolver
from multiarm.gradients.sensitivities import _solved_with_error as _forward
from multiarm.gradients.variational_equation import (
    Parameter,
    VariationalEquation,
    displaced,
    displacement,
)
from multiarm.scene.changes import value_at

CARRIAGE, BODY, SPRING, DAMPER, REST = 3.0, 2.0, 50.0, 4.0, 0.2  # [kg, kg, N/m, N s/m, m]
WELD = {"kind": "weld"}
OPEN_LOOP = {
    "kind": "harmonic",
    "frequency": 0.7,
    "hold": True,
    "amplitude": {arm: [9.0, -6.0, 5.0, 3.0, -2.0, 2.0] for arm in ("left", "right")},
    "phase": {arm: [0.3, 0.2, -0.5, 0.0, 1.0, -1.0] for arm in ("left", "right")},
}


@pytest.fixture
def sledge(tmp_path):
    """A sledge with a body, drawn by the spring of its control to where it was written."""
    urdf = tmp_path / "sledge.urdf"
    urdf.write_text(sledge_urdf(CARRIAGE))
    arm = {"urdf": str(urdf), "tip": "tip", "posture": [0.0]}
    body = {"shape": {"box": [0.1, 0.1, 0.1]}, "mass": BODY, "pose": {"xyz": [0, 0, 0]}}
    control = {
        "kind": "joint_pd", "stiffness": SPRING, "damping": DAMPER, "gravity_compensation": False,
    }  # fmt: skip
    scene = scene_of(
        {"a": arm}, [{"arm": "a", **WELD}], object=body, control=control, gravity=[0, 0, 0]
    )
    return ma.compile_system(scene)


def end_of(system, duration, state=None, t=0.0):
    """The state at the end of a run of high accuracy."""
    run = ma.simulate(
        system, duration, state=state, accuracy=1e-11, certificate=False, start_time=t,
        output_times=[t + duration],
    )  # fmt: skip
    return state_at(system, run, -1)


def by_parameter(scene, path, duration, step=1e-3):
    """The derivative of the end of a run by a number of its scene, from other scenes' runs."""
    value = value_at(scene, path)
    middle = end_of(ma.compile_system(scene), duration)
    amount = step * abs(value) if abs(value) > 1e-6 else step

    def end(shift):
        return end_of(ma.compile_system(scene.replace({path: value + shift})), duration)

    return difference(lambda shift: displacement(middle, end(shift)), amount)


def close(found, expected, tolerance):
    size = np.abs(expected).max()
    np.testing.assert_allclose(found / size, expected / size, atol=tolerance)


def height(t, state):
    """A scalar in which everything takes part."""
    turn = state.object_quaternion_xyzw[0]
    return state.object_position[2] + turn + 0.3 * state.object_twist[1] + math.sin(
        state.joint_positions["left"][2] + 0.1 * state.joint_velocities["right"][1]
    )  # fmt: skip


# --- the parts ------------------------------------------------------------------------------------


def test_collocation_is_of_order_nine():
    A = np.array([[0.0, 1.0], [-4.0, -0.3]])
    errors = []
    for length in (1.6, 0.8):
        end, _ = Collocation(np.stack([A] * COUNT), length).forward(
            np.eye(2), np.zeros((COUNT, 2, 2))
        )
        errors.append(np.abs(end - expm(length * A)).max())
    # the local error falls with the power of the order and one
    assert 9 + 0.7 < math.log2(errors[0] / errors[1]) < 9 + 1.3


def test_the_backward_map_is_the_transposed_forward_map():
    rng = np.random.default_rng(1)
    A, slopes = rng.standard_normal((COUNT, 5, 5)), rng.standard_normal((COUNT, 5))
    b, start, mu = (
        rng.standard_normal((COUNT, 5, 1)),
        rng.standard_normal((5, 1)),
        rng.standard_normal(5),
    )
    collocation, weights = Collocation(A, 0.7), 0.7 * WEIGHTS
    end, stages = collocation.forward(start, b)
    before, by_stage = collocation.backward(mu, slopes)
    at_end = mu @ end[:, 0] + np.einsum("i,id,idk->", weights, slopes, stages)
    at_start = before @ start[:, 0] + np.einsum("i,id,idk->", weights, by_stage, b)
    assert at_end == pytest.approx(at_start, rel=1e-12)


def test_fast_motions_die_out_within_one_panel():
    fast = Collocation(np.full((COUNT, 1, 1), -1e7), 1.0)
    end, _ = fast.forward(np.ones((1, 1)), np.zeros((COUNT, 1, 1)))
    assert abs(end[0, 0]) < 1e-6
    assert NODES[-1] == 1.0


@pytest.mark.parametrize("length", [0.8, 1.6])
@pytest.mark.parametrize("rate", [-1e2, -1e4, -1e6])
def test_the_error_of_a_panel_in_halves_is_not_underestimated_where_damping_is_strong(rate, length):
    """``y' = rate (y - sin 3t) + 3 cos 3t``: the order falls to that of the stages."""

    def end(start, h, y):
        t = start + NODES * h
        b = 3.0 * np.cos(3.0 * t) - rate * np.sin(3.0 * t)
        A = np.full((COUNT, 1, 1), rate)
        return Collocation(A, h).forward(np.array([[y]]), b[:, None, None])[0][0, 0]

    start = 0.4
    y = math.sin(3.0 * start)
    whole, half = end(start, length, y), 0.5 * length
    halves = end(start + half, half, end(start, half, y))
    error = abs(halves - math.sin(3.0 * (start + length)))
    assert error <= 3.0 * abs(whole - halves) / RICHARDSON + 1e-15
    assert error > 1e-14


def test_panels_are_divided_as_long_as_that_lessens_their_error():
    for factor, most in ((1.0, PATIENCE), (0.1, 20)):  # 20 halvings leave a millionth of the run
        halving, times = WHOLE, 0
        while halving := halving.next(factor**times, 0.5**times):
            times += 1
        assert times == most


def test_segments_at_a_kink_are_no_shorter_than_is_allowed():
    """The series of t^1.5 is wrong by 2^-1.5 as much over half of a segment that begins at zero."""
    root, shortest = SimpleNamespace(at=lambda times: (np.array(times)[:, None] ** 1.5, None)), 1e-3
    segments = linearised_module._planned_segments(Panel(0.0, 1.0), root, 0, 1e-18, shortest)
    assert 0.5 * shortest < min(panel.length for panel, _ in segments) <= shortest


@pytest.mark.parametrize("degree", DEGREES)
def test_a_series_is_its_function_to_within_its_defect(degree):
    def function(t):
        return np.array([[np.exp(t), np.sin(3 * t)], [1.0, 1.0 / (2.0 + t)]])

    at = nodes(0.2, 0.9, degree)
    series = Series(0.2, 0.9, np.stack([function(t) for t in at]))
    times = np.linspace(at[0], at[-1], 23).tolist()
    values, defects = series.at(times)
    error = np.abs(values - np.stack([function(t) for t in times])).max()
    bound = series.defect.max()
    assert error <= bound + 1e-14 and np.abs(defects).max() <= bound + 1e-15
    assert bound < 10.0 ** (-0.7 * degree) + 1e-14


def test_the_error_of_a_series_is_solved_for_with_the_solution():
    """To first order, what a solution changes by when the series loses its highest degrees."""
    panel, degree = Panel(0.0, 0.2), DEGREES[0]

    def variation(t):
        A = np.array([[0.0, 1.0], [-40.0 * np.cos(25.0 * t), -1.0]])
        beta, slope = np.array([[0.0], [np.sin(25.0 * t)]]), np.array([np.cos(20.0 * t), 0.0])
        return VariationalEquation(
            A, np.zeros((2, 0)), beta, free, np.zeros((2, 1)), slope, 0.0, np.zeros((2, 1)),
            np.zeros((2, 0)),
        )  # fmt: skip

    class Free:
        """All displacements of one coordinate and its rate are free."""

        constraint, independent = np.zeros((0, 2)), True

    free = Free()

    whole, less = (Segment(panel, [variation(t) for t in nodes(*panel, degree)]) for _ in range(2))
    less._series._coefficients[-2:] = 0.0
    end, nothing = np.array([0.3, -1.0]), np.zeros(2)
    full, short = (_backward(CollocatedPanel(own, panel), end, nothing) for own in (whole, less))
    close(full.start_error, full.start - short.start, 0.02)
    close(full.integral_errors[1:], (full.integrals - short.integrals)[1:], 0.02)
    S = np.column_stack([np.eye(2), [0.1, 0.2]])
    full, short = (
        _forward(CollocatedPanel(own, panel), S, np.zeros((2, 3))) for own in (whole, less)
    )
    close(full[1], full[0] - short[0], 0.02)


# --- closed forms ---------------------------------------------------------------------------------


def test_a_sledge_on_a_spring_moves_as_its_closed_form(sledge):
    """x(t) = e^(-dt) (x0 cos wt + (v0 + d x0) / w sin wt), from beside the spring's rest."""
    mass, times = CARRIAGE + BODY, [0.4, 1.0]

    def x(t, x0=REST, v0=0.5, spring=SPRING, damper=DAMPER, m=mass):
        d = damper / (2.0 * m)
        w = math.sqrt(spring / m - d * d)
        return math.exp(-d * t) * (x0 * math.cos(w * t) + (v0 + d * x0) / w * math.sin(w * t))

    start = sledge.state([REST, 0, 0], None, {"a": [REST]}, [0.5, 0, 0, 0, 0, 0], {"a": [0.5]})
    parameters = ["object.mass", "control.stiffness", "control.damping"]
    S = ma.sensitivities(sledge, times, state=start, parameters=parameters, accuracy=1e-8)
    q = S.joint_positions["a"]
    numbers = {"x0": REST, "v0": 0.5, "spring": SPRING, "damper": DAMPER, "m": mass}

    def slope(name):
        """The derivatives of x at the times by one of the numbers."""
        return [difference(lambda h, t=t: x(t, **{name: numbers[name] + h}), 1e-3) for t in times]

    # sledge and body move together: half of the admissible displacement each
    both = q.d_joint_positions["a"][:, 0, 0] + q.d_object_pose[:, 0, 0]
    rates = q.d_joint_velocities["a"][:, 0, 0] + q.d_object_twist[:, 0, 0]
    np.testing.assert_allclose(both, slope("x0"), atol=1e-8)
    np.testing.assert_allclose(rates, slope("v0"), atol=1e-8)
    for path, name in zip(parameters, ("m", "spring", "damper"), strict=True):
        np.testing.assert_allclose(q.parameters[path][:, 0], slope(name), rtol=1e-6)


def test_the_integral_of_a_sledges_square_has_its_gradient(sledge):
    mass = CARRIAGE + BODY
    start = sledge.state([REST, 0, 0], None, {"a": [REST]})

    def cost(spring=SPRING, x0=REST, T=1.0):
        d = DAMPER / (2.0 * mass)
        w = math.sqrt(spring / mass - d * d)

        def x(t):
            return math.exp(-d * t) * x0 * (math.cos(w * t) + d / w * math.sin(w * t))

        return quad(lambda t: x(t) ** 2, 0.0, T, epsabs=1e-14)[0]

    g = ma.gradient(
        sledge, 1.0, running=lambda t, state: state.joint_positions["a"][0] ** 2, state=start,
        parameters=["control.stiffness"], accuracy=1e-8,
    )  # fmt: skip
    assert g.value == pytest.approx(cost(), rel=1e-8)
    expected = difference(lambda h: cost(spring=SPRING + h), 0.1)
    assert g.parameters["control.stiffness"] == pytest.approx(expected, rel=1e-6)
    # the start moves as a whole: the sledge's part and the body's
    whole = g.start.d_joint_positions["a"][0] + g.start.d_object_pose[0]
    assert whole == pytest.approx(difference(lambda h: cost(x0=REST + h), 1e-3), rel=1e-6)


def test_the_integral_of_a_scalar_of_time_alone_is_as_exact(sledge):
    """Nothing moves here: panels must be short enough for the integral itself."""
    g = ma.gradient(
        sledge, 1.0, running=lambda t, state: math.cos(30.0 * t) + 2.0 + state.object_position[0],
        accuracy=1e-9, parameters=["object.mass"],
    )  # fmt: skip
    assert g.value == pytest.approx(math.sin(30.0) / 30.0 + 2.0, rel=3e-9)
    assert g.parameters["object.mass"] == 0.0


# --- differences of runs --------------------------------------------------------------------------

CHAINS = {
    "open loop": ur5_pair(WELD, WELD, control=OPEN_LOOP),
    "closed loop": ma.load_scene(SCENES / "two_ur5_box.yaml"),
    "hinge and ball": ur5_pair(
        {"kind": "revolute"}, {"kind": "ball"}, control=OPEN_LOOP,
        effects={
            "joint_damping": 2.0,
            "joint_friction": {"torque": 3.0, "model": "smooth", "speed": 0.1},
        },
    ),
    "drag and load": ur5_pair(
        WELD, {"kind": "prismatic"}, control=OPEN_LOOP,
        effects={
            "drag": {"linear": 20.0, "quadratic": [8.0, 5.0, 6.0]},
            "external_wrenches": [
                {"on": "object", "force": [0, 30, -20], "pulse": {"begin": 0.1, "end": 0.35}}
            ],
        },
    ),
    "dependent constraints": planar_pair("planar_3r", [0.6, -1.1, 0.5], WELD, solver="node"),
}  # fmt: skip


@pytest.mark.parametrize("name", CHAINS)
def test_gradients_by_the_start_are_differences_of_runs(name):
    system, T = ma.compile_system(CHAINS[name]), 0.5
    start = system.initial_state()
    rng = np.random.default_rng(3)
    g = ma.gradient(system, T, final=height, accuracy=1e-9, state=start)
    assert g.error < 1e-6
    admissible = ma.derivatives(system, 0.0, start).motions.admissible()
    for _ in range(2):
        direction = admissible @ rng.standard_normal(len(admissible))
        direction /= np.abs(direction).max()

        def moved(amount, direction=direction):
            return height(T, end_of(system, T, displaced(start, amount * direction)))

        # the start is put on the joints again, which errs with the square of the step
        expected = difference(moved, 2e-4)
        assert g.start.matrix @ direction == pytest.approx(
            expected, abs=1e-6 * np.abs(g.start.matrix).max()
        )


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("open loop", "object.mass"),
        ("open loop", "object.inertia[1][1]"),
        ("open loop", "control.frequency"),
        ("open loop", "control.amplitude.left[2]"),
        ("open loop", "arms.left.base.xyz[1]"),
        ("closed loop", "control.stiffness.left[1]"),
        ("closed loop", "object.pose.xyz[0]"),
        ("hinge and ball", "effects.joint_damping"),
        ("drag and load", "effects.drag.quadratic[0]"),
        ("drag and load", "effects.external_wrenches[0].force[1]"),
        ("drag and load", "gravity[2]"),
    ],
)
def test_sensitivities_by_numbers_of_the_scene_are_differences_of_runs(name, path):
    scene, T = CHAINS[name], 0.5
    system = ma.compile_system(scene)
    S = ma.sensitivities(system, [0.2, T], parameters=[path], accuracy=1e-9)
    close(S.matrix[-1, :, -1], by_parameter(scene, path, T), 1e-6)
    g = ma.gradient(system, T, final=height, parameters=[path], accuracy=1e-9)
    assert g.parameters[path] == pytest.approx(
        slope_of(height, S.states[-1]) @ S.matrix[-1, :, -1], rel=1e-6
    )


def slope_of(function, state):
    axes = np.eye(12 + 2 * state.layout.rate_count)
    return np.array(
        [difference(lambda h, e=e: function(0.5, displaced(state, h * e))) for e in axes]
    )


@pytest.mark.parametrize(
    ("name", "path", "beginning"),
    [
        ("open loop", "object.mass", "another state"),
        ("open loop", "object.pose.xyz[0]", "another state"),
        ("open loop", "arms.left.base.xyz[1]", "another state"),
        ("open loop", "arms.right.posture[1]", "another state"),
        ("closed loop", "control.stiffness.left[1]", "another state"),
        ("closed loop", "object.pose.xyz[0]", "the scene's start"),
        ("hinge and ball", "effects.joint_friction.torque", "another state"),
        ("drag and load", "effects.external_wrenches[0].force[1]", "another state"),
        ("drag and load", "object.pose.xyz[2]", "another state"),
        ("dependent constraints", "gravity[1]", "another state"),
        ("dependent constraints", "arms.left.base.xyz[0]", "the scene's start"),
        ("dependent constraints", "arms.left.base.xyz[0]", "another state"),
    ],
)
def test_derivatives_from_a_given_state_are_differences_of_runs_from_it(name, path, beginning):
    """Also by numbers that move the joints: the state is put on them, as that of any run.

    From the scene's start also by numbers that move no joint: the test above.
    """
    scene, T, begin, state = CHAINS[name], 0.3, 0.0, None
    system = ma.compile_system(scene)
    state = system.initial_state()
    if beginning == "another state":
        begin, wild = 0.1, random_state(system, np.random.default_rng(5), turn=0.03, speed=0.2)
        with system.borrow() as data:
            state = project_start(data, scene, wild)[0]
    value = value_at(scene, path)
    size = abs(value) if abs(value) > 0.05 else 0.3
    asked = {"parameters": {path: size}, "accuracy": 1e-9, "state": state, "start_time": begin}
    S = ma.sensitivities(system, [begin, begin + T], **asked)
    middle = end_of(system, T, state, begin)

    def end(shift):
        moved = ma.compile_system(scene.replace({path: value + shift}))
        return displacement(middle, end_of(moved, T, state, begin))

    expected = difference(end, 1e-3 * size)
    # differences of runs of accuracy 1e-11
    assert np.abs(S.matrix[-1, :, -1] - expected).max() < 1e-6 * np.abs(expected).max() + 1e-11 / (
        1e-3 * size
    )
    g = ma.gradient(system, T, final=height, **asked)
    assert g.parameters[path] == pytest.approx(
        slope_of(height, S.states[-1]) @ S.matrix[-1, :, -1], rel=1e-6
    )


@pytest.mark.parametrize(
    ("path", "change"), [("arms.right.posture[1]", 1e-2), ("control.amplitude.left[2]", 1.0)]
)
def test_a_start_or_its_accelerations_that_jump_with_a_number_are_refused(path, change):
    """A posture that is sought may be another one in a scene nearby, and what holds it too."""
    scene = CHAINS["open loop"]
    system = ma.compile_system(scene)
    jumped = ma.compile_system(scene.replace({path: value_at(scene, path) + change}))
    parameter = Parameter(system, "object.mass")
    parameter.systems[2:] = [jumped, jumped]
    for state in (None, system.initial_state()):
        with refused(SceneError, "object.mass"):
            parameter.of_start(0.0, state, Phase(None))


PLACE_OF_A_JOINT = "joints[1].at.xyz[2]"


def pair_with_written_joints():
    """Two arms whose joints' places on the object are numbers of the scene."""
    joints = [{"kind": "ball"}, {"kind": "revolute"}]
    for joint, frame in zip(
        joints, ma.compile_system(ur5_pair(*joints)).frames.values(), strict=True
    ):
        turn = Rotation.from_matrix(frame.on_object[:3, :3])
        joint["at"] = {"xyz": frame.on_object[:3, 3].tolist(), "rpy": turn.as_euler("xyz").tolist()}
    return ur5_pair(*joints, control=OPEN_LOOP)


def test_which_numbers_move_the_joints_does_not_depend_on_what_was_evaluated_before():
    """Changes of gaps count from 100 roundings of the scene's coordinates on, at its start."""
    system = ma.compile_system(pair_with_written_joints())
    parameter, state = Parameter(system, PLACE_OF_A_JOINT), system.initial_state()
    motions = ma.derivatives(system, 0.0, state).motions
    _, expected = parameter.at(0.0, state, motions, Phase(None))
    assert np.abs(expected).max() > 0.1
    ma.evaluate(system, 0.0, system.state(object_position=[1e13, 0.0, 0.0]))
    _, offset = parameter.at(0.0, state, motions, Phase(None))
    np.testing.assert_array_equal(offset, expected)


def test_numbers_that_move_the_joints_move_the_run_with_them():
    """Where a contact's place is a number of the scene, nearby motions obey other constraints."""
    scene, path, T = pair_with_written_joints(), PLACE_OF_A_JOINT, 0.4
    system = ma.compile_system(scene)
    # the start is assembled by iterations, which is smooth to about this part
    smooth = 1e-5
    S = ma.sensitivities(system, [T], parameters={path: 0.3}, accuracy=1e-9)
    expected = by_parameter(scene, path, T, 3e-4)
    close(S.matrix[-1, :, -1], expected, smooth)
    g = ma.gradient(system, T, final=height, parameters={path: 0.3}, accuracy=1e-9)
    assert g.parameters[path] == pytest.approx(
        slope_of(height, S.states[-1]) @ expected, rel=smooth
    )


SERVO = {"kind": "joint_pd", "stiffness": 300, "damping": 20, "gravity_compensation": False}
VANISHING = {
    # by symmetry a sideways pull does not lift
    "cancels": (ma.load_scene(SCENES / "two_ur5_box.yaml").replace(control=SERVO), "gravity[0]"),
    # joints that are written at the arms' tips go with them
    "follows": (
        ma.load_scene(SCENES / "two_ur5_box.yaml").replace(control=SERVO), "arms.left.base.xyz[2]",
    ),
    # arms in a plane do not feel a pull across it
    "is a rounding": (
        planar_pair("planar_2r", [0.7, -1.4], {"kind": "revolute"}).replace(gravity=[0, -9.81, 0]),
        "gravity[2]",
    ),
}  # fmt: skip


@pytest.mark.parametrize("accuracy", [1e-6, 1e-9])
@pytest.mark.parametrize("name", VANISHING)
def test_derivatives_that_vanish_are_found_without_ever_shorter_panels(name, accuracy):
    scene, path = VANISHING[name]
    system, asked = ma.compile_system(scene), {"parameters": [path], "accuracy": accuracy}
    found = ma.gradient(system, 0.1, final=lambda t, state: state.object_position[2], **asked)
    assert abs(found.parameters[path]) < 1e-10
    assert found.error <= max(accuracy, 1e-8)
    assert len(found.times) < 100
    forward = ma.sensitivities(system, [0.1], **asked)
    assert abs(forward.object_pose.parameters[path][0, 2]) < 1e-10
    assert forward.error <= max(accuracy, 1e-8)


def test_forward_and_backward_agree_at_a_later_start():
    system = ma.compile_system(CHAINS["drag and load"])
    state = end_of(system, 0.2)
    S = ma.sensitivities(system, [0.5], state=state, start_time=0.2, accuracy=1e-8)
    g = ma.gradient(system, 0.3, final=height, state=state, start_time=0.2, accuracy=1e-8)
    close(slope_of(height, S.states[-1]) @ S.matrix[-1], g.start.matrix, 1e-6)
    np.testing.assert_allclose(g.trajectory.time[[0, -1]], [0.2, 0.5])


@pytest.mark.slow
def test_no_digit_of_a_chaotic_runs_derivatives_is_claimed():
    """Errors grow as large as the motion within six seconds, and hardly within the first."""
    system = ma.compile_system(ma.load_scene(SCENES / "ring_weld.yaml"))
    asked = {"parameters": ["object.mass"], "accuracy": 1e-6}
    g = ma.gradient(system, 6.0, final=lambda t, state: state.object_position[2], **asked)
    assert g.error > 0.1 and g.digits == 0
    assert g.message.startswith("no digit is right: motions separate so fast until t = 6 s")
    assert g.message in repr(g) and g.message in g._repr_html_()
    early = ma.gradient(system, 1.0, final=lambda t, state: state.object_position[2], **asked)
    assert early.error <= 1e-6 and early.digits >= 4 and not early.message


@pytest.mark.slow
def test_the_error_contains_what_the_error_of_the_run_changes():
    """Where motions separate, against derivatives along a run of high accuracy."""
    system = ma.compile_system(ma.load_scene(SCENES / "ring_weld.yaml"))
    asked = {"times": [3.0], "parameters": ["object.mass"]}
    exact = ma.sensitivities(system, **asked, accuracy=1e-8).matrix
    for accuracy in (1e-4, 1e-6):
        S = ma.sensitivities(system, **asked, accuracy=accuracy)
        missed = (np.abs(S.matrix - exact).max(axis=1) / np.abs(exact).max(axis=1)).max()
        # the difference of two runs is an estimate; errors of the series are bounds
        assert missed <= 3.0 * S.error and S.error <= 20.0 * missed


# --- torques --------------------------------------------------------------------------------------


@pytest.mark.parametrize("interpolation", ["linear", "cubic", "hold"])
def test_gradients_by_a_table_of_torques_are_differences_of_runs(tmp_path, interpolation):
    times, T = np.array([0.0, 0.15, 0.3, 0.4]), 0.4
    names = [f"{arm}/{joint}" for arm in ("left", "right") for joint in ARM_JOINTS]
    held = ma.inverse_dynamics(
        ma.compile_system(ur5_pair(WELD, WELD)), None, np.zeros(6)
    ).torques  # fmt: skip
    rest = np.concatenate([held["left"], held["right"]])
    rng = np.random.default_rng(7)
    table = rest + rng.uniform(-8.0, 8.0, (len(times), 12))

    def system_with(values):
        file = tmp_path / "torques.csv"
        np.savetxt(
            file, np.column_stack([times, values]), "%.17g", ",", header=",".join(["time", *names]),
            comments="",
        )  # fmt: skip
        control = {"kind": "recorded", "file": str(file), "interpolation": interpolation}
        return ma.compile_system(ur5_pair(WELD, WELD, control=control))

    g = ma.gradient(system_with(table), T, final=height, accuracy=1e-9)
    found = g.by_torque_table(times, interpolation)
    largest = max(np.abs(own).max() for own in found.values())
    for row, joint in ((0, 1), (1, 2), (2, 8)):

        def end(amount, row=row, joint=joint):
            moved = table.copy()
            moved[row, joint] += amount
            return height(T, end_of(system_with(moved), T))

        arm, k = ("left", joint) if joint < 6 else ("right", joint - 6)
        assert found[arm][row, k] == pytest.approx(difference(end, 0.5), abs=2e-6 * largest)


ARM_JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint",
    "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip


# --- how it is asked ------------------------------------------------------------------------------


def test_a_scalar_may_bring_its_own_derivatives():
    system = ma.compile_system(CHAINS["open loop"])

    def speed(t, state):
        return float(state.object_twist @ state.object_twist)

    def with_slope(t, state):
        slope = np.zeros(12 + 2 * state.layout.rate_count)
        slope[6:12] = 2.0 * state.object_twist
        return speed(t, state), slope

    plain = ma.gradient(system, 0.3, final=speed, running=speed, accuracy=1e-8)
    given = ma.gradient(system, 0.3, final=with_slope, running=with_slope, accuracy=1e-8)
    assert given.value == pytest.approx(plain.value, rel=1e-10)
    close(given.start.matrix, plain.start.matrix, 1e-8)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-6])
@pytest.mark.parametrize("name", ["open loop", "hinge and ball"])
def test_estimated_errors_are_as_large_as_the_errors(name, tolerance):
    """Along one run of high accuracy, against the derivatives of high accuracy along it."""
    system, T = ma.compile_system(CHAINS[name]), 0.4
    exact = ma.sensitivities(system, [T], accuracy=1e-9, parameters=["object.mass"])
    linearised = LinearisedRun(system, 0.0, T, 1e-9, None, ["object.mass"], np.array([T]))
    linearised.tolerance = linearised.panel_tolerance = tolerance
    found, _ = linearised.to_accuracy(
        lambda linearisation, report: _ForwardSolver(linearised, linearisation).solve(report),
        lambda *_: None,
    )
    sizes = np.maximum(np.abs(exact.matrix[0]).max(axis=0), 1.0)
    missed = (np.abs(found.at[T] - exact.matrix[0]).max(axis=0) / sizes).max()
    assert found.error <= tolerance and missed <= 5.0 * found.error + 1e-8

    target = height_with_slope
    g = ma.gradient(system, T, final=target, accuracy=1e-9, parameters=["object.mass"])
    linearised = LinearisedRun(system, 0.0, T, 1e-9, None, ["object.mass"], np.zeros(0))
    linearised.tolerance = linearised.panel_tolerance = tolerance

    def solve(linearisation, report):
        return _AdjointSolver(linearised, linearisation, *target(T, linearisation.state(T))).solve(
            report
        )

    back, _ = linearised.to_accuracy(solve, lambda *_: None)
    missed = np.abs(back.start - g.start.matrix).max() / np.abs(g.start.matrix).max()
    assert back.error <= tolerance and missed <= 5.0 * back.error + 1e-8
    by_mass, exact_by_mass = back.by_parameters[0], g.parameters["object.mass"]
    assert abs(by_mass - exact_by_mass) <= 5.0 * back.error * max(1.0, abs(exact_by_mass)) + 1e-8


def height_with_slope(t, state):
    return height(t, state), slope_of(height, state)


def test_a_run_that_turns_sharply_is_a_series_all_the_same():
    """Near a singular posture, shortly after 0.3 s; a panel that is too long shows no progress."""
    scene = random_scene(np.random.default_rng(1))
    system, T = ma.compile_system(scene), 0.5
    motion = RunSeries(system, 0.0, T, 1e-6, None, np.zeros(0))
    times = np.linspace(0.305, 0.37, 40).tolist()
    run = ma.simulate(system, T, accuracy=1e-6, output_times=times, certificate=False)
    states = [motion.states([t])[0] for t in times]
    speeds = np.array([state.object_twist for state in states])
    np.testing.assert_allclose(speeds, run.object_twist, atol=1e-5)


def test_little_memory_gives_the_same_numbers(monkeypatch):
    system = ma.compile_system(CHAINS["open loop"])
    free = ma.gradient(system, 0.3, final=height, accuracy=1e-7)
    monkeypatch.setattr(linearised_module, "MOST_KEPT", 0.0)
    bounded = ma.gradient(system, 0.3, final=height, accuracy=1e-7)
    np.testing.assert_array_equal(bounded.start.matrix, free.start.matrix)


def test_progress_is_reported():
    seen = []
    system = ma.compile_system(CHAINS["open loop"])
    ma.gradient(system, 0.3, final=height, accuracy=1e-6, progress=lambda *told: seen.append(told))
    assert seen and seen[-1][0] == seen[-1][1] and "derivatives" in seen[-1][2]


def test_results_show_themselves():
    system = ma.compile_system(CHAINS["open loop"])
    g = ma.gradient(system, 0.2, final=height, parameters=["object.mass"], accuracy=1e-6)
    S = ma.sensitivities(system, [0.1, 0.2], parameters=["object.mass"], accuracy=1e-6)
    assert "object.mass: " in repr(g) and "estimated error" in g._repr_html_()
    assert repr(S) == "Sensitivities(36 components at 2 times, by 37 columns)"
    assert "object.mass" in S._repr_html_()
    assert S.object_twist.d_joint_velocities["left"].shape == (2, 6, 6)
    assert g.start.d_joint_velocities["left"].shape == (6,)
    with refused(ModelError, "object.size"):
        S.object_pose.parameters["object.size"]
    with refused(ModelError, "object.size"):
        g.parameters["object.size"]


# --- what is refused ------------------------------------------------------------------------------


def assert_refused(error, place, scene, **asked):
    with refused(error, place):
        ma.gradient(ma.compile_system(scene), 0.2, **{"final": height, **asked})


def test_runs_without_such_derivatives_are_refused_with_the_reason():
    pair = CHAINS["open loop"]
    sampled = pair.replace(
        control={"kind": "joint_pd", "stiffness": 100.0, "damping": 5.0, "sample_time": 0.01}
    )
    assert_refused(SolverError, "`sample_time`", sampled)
    lagging = pair.replace(effects={"actuator_lag": {"time_constant": 0.01}})
    assert_refused(SolverError, "lagging drives", lagging)
    falling = ma.load_scene(SCENES / "two_ur5_box.yaml").replace(
        effects={"floor": {}}, control={"kind": "none"}
    )
    with refused(SolverError, "floor"):
        ma.gradient(ma.compile_system(falling), 2.0, final=height)


def test_a_run_ends_at_the_last_time_whatever_its_duration_rounds_to():
    times, begin = [0.9], 0.2
    assert begin + (times[-1] - begin) < times[-1]
    S = ma.sensitivities(ma.compile_system(CHAINS["open loop"]), times, start_time=begin)
    assert S.time[-1] == times[-1]
    assert S.trajectory.time[-1] == pytest.approx(times[-1], rel=1e-15)  # a rounding


def test_wrong_questions_are_answered_with_the_remedy():
    pair = CHAINS["open loop"]
    assert_refused(SceneError, "'object.mass'", pair, parameters="object.mass")
    assert_refused(SolverError, "accuracy", pair, accuracy=-1.0)
    assert_refused(SceneError, "run.duration", pair, parameters=["run.duration"])
    assert_refused(SceneError, "object.pose", pair, parameters=["object.pose"])
    assert_refused(SceneError, "object.mass", pair, parameters={"object.mass": 1e6})
    assert_refused(SolverError, "object.mass", pair, parameters={"object.mass": -1})
    assert_refused(SceneError, "'mas'", pair, parameters=["object.mas"])
    for final in (
        None, lambda t, s: "high", lambda t, s: (1.0, np.zeros(3)), "height", lambda t, s: 1 / 0,
        lambda t: 1.0,
    ):  # fmt: skip
        assert_refused(ModelError, "", pair, final=final)
    system = ma.compile_system(pair)
    with refused(SceneError, "'times'"):
        ma.sensitivities(system, ["a"])
    with refused(SceneError, "times"):
        ma.sensitivities(system, [-0.1, 0.2])
    for duration in (0.0, math.inf, 10**400):
        with refused(SolverError, "duration"):
            ma.gradient(system, duration, final=height)
    assert_refused(SolverError, "accuracy", pair, accuracy=math.inf)
    for start_time in (math.nan, 10**400, "noon"):
        assert_refused(SceneError, "'start_time'", pair, start_time=start_time)
        with refused(SceneError, "'start_time'"):
            ma.sensitivities(system, [0.2], start_time=start_time)
    g = ma.gradient(system, 0.2, final=height, accuracy=1e-6)
    with refused(ModelError, "'lineal'"):
        g.by_torque_table([0.0, 0.2], "lineal")
    with refused(ModelError):
        g.by_torque_table([0.0])
