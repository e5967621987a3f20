"""Claims about derivatives of runs in which joints take hold and let go.

Oracles: closed forms of carts that couple; Richardson's differences of runs of accuracy 1e-11; each
of the two directions, forward and backward, for the other.  An integral of velocities is a change
of places, which do not jump.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from event_scenes import arm, ball
from mechanics import UR5_POSTURE
from object_scenes import ASIDE
from refusals import refused
from timed_scenes import FALL, Table, carts, last_state, objects_on_rails, pendulum

import multiarm as ma
from multiarm.errors import SceneError, SolverError
from multiarm.gradients.course import phases
from multiarm.gradients.linearised_run import LinearisedRun
from multiarm.gradients.variational_equation import closing_of, displaced, displacement
from multiarm.scene import parse_scene
from multiarm.scene.changes import value_at

ACCURACY = 1e-10
"""Of the runs that are differentiated."""
DIFFERENCES, DIRECTIONS = 1e-7, 1e-10
"""Largest relative differences: from differences of runs, between the two directions."""
SPRINGS = {"kind": "joint_pd", "stiffness": 5.0, "damping": 0.4, "gravity_compensation": False}


def end_of(system, duration, state=None):
    run = ma.simulate(
        system, duration, state=state, accuracy=1e-11, certificate=False, output_times=[duration]
    )
    assert run.status == "completed", run.message
    return last_state(system, run)


def richardson(change, step):
    """The derivative of a vector by a number, from changes by four values of it."""
    far, near = ((change(h) - change(-h)) / (2.0 * h) for h in (step, 0.5 * step))
    return (4.0 * near - far) / 3.0


def check(
    table: Table, duration: float, paths: list[str], step: float = 1e-3, put: bool = False
) -> Any:
    """Sensitivities of the end, after a comparison with differences and with gradients.

    ``put``: a joint puts nearby motions on it, whose places jump, so that they are no integrals.
    """
    scene = parse_scene(table)
    system = ma.compile_system(scene)
    start = system.initial_state()
    S = ma.sensitivities(system, [duration], parameters=paths, accuracy=ACCURACY)
    end, matrix, size = S.states[0], S.matrix[0], len(S.matrix[0])

    def by_number(path, at_end=True):
        value = value_at(scene, path)

        def change(shift):
            other = ma.compile_system(scene.replace({path: value + shift}), like=system)
            if at_end:
                return displacement(end, end_of(other, duration))
            return displacement(start, other.initial_state())

        return richardson(change, step)

    def by_start(direction):
        def change(shift):
            moved = end_of(system, duration, displaced(start, shift * direction))
            return displacement(end, moved)

        return richardson(change, step)

    def same(found, expected):
        size = np.abs(expected).max()
        np.testing.assert_allclose(found / size, expected / size, atol=DIFFERENCES)

    for path in paths:
        same(matrix[:, S.columns[path].start], by_number(path))
    rng = np.random.default_rng(1)
    along_joints = ma.derivatives(system).motions.admissible()
    direction = along_joints @ rng.standard_normal(size)
    same(matrix[:, :size] @ direction, by_start(direction))
    weights, along = rng.standard_normal((2, size))
    moving = np.zeros(size, bool)  # places whose rates are the velocities
    moving[S.rows["joint_positions"]] = moving[S.rows["object_pose"]] = True
    for turn in system.model.layout.turns:
        moving[system.model.layout.displacement_columns[turn]] = False
    of_places = np.where(moving & (not put), along, 0.0)

    def speed(t, state):
        slope, layout = np.zeros(size), state.layout
        slope[layout.velocity_columns] = of_places[layout.displacement_columns]
        return float(slope[layout.velocity_columns] @ state.velocity), slope

    g = ma.gradient(
        system, duration, final=lambda t, state: (0.0, weights), running=speed, parameters=paths,
        accuracy=ACCURACY,
    )  # fmt: skip
    of_start = np.array([by_number(path, at_end=False) for path in paths]).reshape(-1, size).T
    begin = np.hstack([along_joints, of_start])
    forward = weights @ matrix + of_places @ (matrix - begin)
    backward = [*g.start.matrix, *g.parameters.values()]
    np.testing.assert_allclose(g.value, of_places @ displacement(start, end), atol=1e-8)
    tolerance = max(DIRECTIONS, S.error + g.error)
    np.testing.assert_allclose(
        backward, forward, rtol=tolerance, atol=tolerance * np.abs(forward).max()
    )
    return S


# --- closed forms ---------------------------------------------------------------------------------


def test_carts_that_couple():
    """Without forces: the object goes on with the speed that all momentum gives it."""
    light, heavy, body, speed, other, couples, duration = 1.0, 2.0, 3.0, 0.4, -0.7, 0.3, 0.8
    rails = {
        "light": {"mass": light, "velocity": speed, "x": -0.3},
        "heavy": {"mass": heavy, "velocity": other, "x": 0.5, "joint": {"from": couples}},
    }
    paths = ["joints[1].from", "object.mass", "arms.heavy.velocity[0]"]
    system = ma.compile_system(parse_scene(carts(speed, rails)))
    S = ma.sensitivities(system, [couples, duration], parameters=paths, accuracy=ACCURACY)
    before, total = light + body, light + body + heavy
    after = (before * speed + heavy * other) / total
    left = duration - couples
    by_mass = (speed - after) / total
    expected = [
        [left * 0.0 + speed - after, left * by_mass, left * heavy / total],
        [0.0, by_mass, heavy / total],
    ]
    columns = [S.columns[path].start for path in paths]
    at_end = S.matrix[1][:, columns]
    pose, twist = S.rows["object_pose"].start, S.rows["object_twist"].start
    np.testing.assert_allclose(at_end[[pose, twist]], expected, atol=1e-9)
    # at the switch itself, states are those before it
    np.testing.assert_allclose(S.matrix[0][[pose, twist]][:, columns], 0.0, atol=1e-9)
    # the start's velocity of the other cart, whose place on the object moves with it
    cart = list(S.layout.names).index("heavy")
    by_cart = S.matrix[1][:, S.columns["joint_velocities"].start + cart]
    np.testing.assert_allclose(by_cart[[pose, twist]], [expected[0][2], expected[1][2]], atol=1e-9)
    place = S.matrix[1][S.rows["joint_positions"].start + cart, columns[2]]
    np.testing.assert_allclose(place, couples + left * heavy / total, atol=1e-9)


RAILS: Table = {
    "light": {"mass": 1.0, "velocity": 0.4, "x": -0.3},
    "heavy": {"mass": 2.0, "velocity": -0.7, "x": 0.5},
}


def coupling_carts(begin: Any, speed: float = -0.7, **more: Any) -> ma.System:
    """A light cart with the object of 3 kg at 0.4 m/s, and a heavy one that couples to it."""
    heavy = RAILS["heavy"] | {"velocity": speed, "joint": {"from": begin, **more}}
    return ma.compile_system(parse_scene(carts(0.4, RAILS | {"heavy": heavy})))


def velocity(t, state):
    """Of the object along x."""
    return state.object_twist[0]


COUPLED = (4.0 * 0.4 - 2.0 * 0.7) / 6.0
"""The speed of the carts that have coupled [m/s]."""


def test_an_integral_of_what_jumps_by_the_time_of_the_switch():
    """The mean speed: it is the first one for longer."""
    paths = ["joints[1].from", "arms.heavy.velocity[0]"]
    g = ma.gradient(coupling_carts(0.2), 0.3, running=velocity, parameters=paths, accuracy=ACCURACY)
    np.testing.assert_allclose(g.value, 0.4 * 0.2 + COUPLED * 0.1, atol=1e-12)
    np.testing.assert_allclose([*g.parameters.values()], [0.4 - COUPLED, 0.1 / 3.0], atol=1e-10)
    np.testing.assert_allclose(g.start.matrix[0], 0.0, atol=1e-10)


def test_an_integral_of_what_jumps_where_a_function_tells_when():
    """As the object comes to 0.08 m, which it does earlier from nearer or with more speed."""
    system = coupling_carts({"when": lambda t, state: 0.08 - state.object_position[0]})
    g = ma.gradient(system, 0.3, running=velocity, accuracy=ACCURACY)
    layout, kept = system.model.layout, ma.derivatives(system).motions.admissible()
    shift = np.zeros(len(kept))
    places = np.flatnonzero(kept[0])  # the object and the light cart
    shift[places] = 1.0
    np.testing.assert_allclose(g.start.matrix @ shift, -(0.4 - COUPLED) / 0.4, atol=1e-10)
    faster = np.zeros(len(kept))
    faster[layout.velocity_columns] = shift[layout.displacement_columns]
    left = 0.1 * 4.0 / 6.0
    np.testing.assert_allclose(g.start.matrix @ faster, left + COUPLED * 0.2 / 0.4, atol=1e-10)
    light = list(layout.names).index("light")
    before = g.times < 0.2
    expected = (left + COUPLED * (0.2 - g.times[before]) / 0.4) / 4.0
    np.testing.assert_allclose(g.torque_density[before, light], expected, atol=1e-10)


def test_errors_of_derivatives_that_come_of_the_start_alone_or_vanish():
    """Without forces nothing else tells what size they have."""
    paths = ["joints[1].from", "arms.light.velocity[0]"]
    table = carts(0.4, {"light": RAILS["light"]})
    system = ma.compile_system(parse_scene(table))
    along, across = (lambda t, state, i=i: state.object_position[i] for i in (0, 1))
    g = ma.gradient(system, 0.2, final=along, parameters=paths[1:])
    np.testing.assert_allclose(g.parameters[paths[1]], 0.2 / 4.0, rtol=1e-9)
    assert g.error < 1e-8 and not g.message
    g = ma.gradient(coupling_carts(0.1), 0.2, final=across, parameters=paths)
    np.testing.assert_allclose([*g.parameters.values()], 0.0, atol=1e-12)
    assert g.error < 1e-8 and not g.message


# --- differences of runs --------------------------------------------------------------------------


def handed_over(**more: Any) -> Table:
    """An object that goes from arm to arm on rails, each with a spring."""
    rails = {
        "a": {"mass": 1.0, "velocity": 0.9, "x": -0.3, "joint": {"until": 0.5}},
        "b": {"mass": 2.0, "velocity": -0.2, "x": 0.5, "joint": {"from": 0.3, "until": 0.9}},
        "c": {"mass": 1.5, "velocity": 0.3, "x": 0.4, "joint": {"from": 0.7}},
    }
    for name, times in more.items():
        rails[name]["joint"] = times
    return carts(0.9, rails, control=SPRINGS)


def test_a_hand_over_from_arm_to_arm():
    paths = [f"joints[{k}].{key}" for k, key in ((0, "until"), (1, "from"), (2, "from"))]
    check(handed_over(), 1.0, ["object.mass", *paths])


def test_a_hand_over_at_one_time():
    """By its time itself there is no derivative: which comes first would depend on it."""
    table = handed_over(a={"until": 0.5}, b={"from": 0.5, "until": 0.9})
    check(table, 0.8, ["joints[2].from"])
    system = ma.compile_system(parse_scene(table))
    with refused(SolverError, "joints[0].until"):
        ma.gradient(system, 0.8, final=ahead, parameters=["joints[0].until"])


def ahead(t, state):
    """Where the object is, from 0.2 m; falls as it comes there."""
    return 0.2 - state.object_position[0]


def test_a_hand_over_by_functions():
    """Both at the zero of the same function, then one by one that knows the time."""
    table = handed_over(
        a={"until": {"when": ahead}},
        b={"from": {"when": ahead}, "until": {"when": lambda t, state: ahead(t, state) + 0.4 - t}},
        c={"from": 0.4},
    )
    check(table, 0.7, ["joints[2].from"])


def test_times_of_pairs():
    table = handed_over(b={"from": [[0.3, 0.6], [0.65, "never"]]})
    check(table, 0.7, ["joints[1].from[0][1]", "joints[1].from[1][0]"])


def swings_down(t, state):
    """The angle of a pendulum, from 0.2 rad."""
    x, _, z = state.object_position
    return math.atan2(-x, -z) - 0.2


@pytest.mark.parametrize("begin", [0.3, {"when": swings_down}], ids=["timed", "located"])
def test_a_pendulum_that_is_caught(begin):
    """By a ball joint, wherever the arm is then."""
    catcher = arm("xz", velocity=[-0.6, 0.9], mass=0.8, base={"xyz": [0.3, 0.0, -0.2]})
    joint = {"arm": "catcher", "name": "grip", "kind": "ball", "from": begin}
    paths = ["arms.catcher.base.xyz[0]", "joints[1].from"] if begin == 0.3 else ["object.mass"]
    check(pendulum(0.5, -1.2, {"catcher": catcher}, [joint]), 0.6, paths)


def test_a_joint_that_repeats_others():
    """An arm of one hinge about the pivot welds to the pendulum: five rows are redundant."""
    catcher = arm("Y", velocity=[1.5], mass=1.0, inertia=0.3)
    joint = {"arm": "catcher", "name": "grip", "kind": "weld", "from": 0.2}
    check(pendulum(0.7, -0.4, {"catcher": catcher}, [joint]), 0.5, ["joints[1].from"])


def test_states_follow_redundant_joints_whatever_their_roundings():
    """Rows that repeat others but for roundings of the state ask for no motion of their own."""
    rider = {"rider": arm("Y", velocity=[-0.4], mass=1.0, inertia=0.3)}
    table = pendulum(0.7, -0.4, rider, [{"arm": "rider", "kind": "weld"}])
    system = ma.compile_system(parse_scene(table))
    state = system.initial_state()
    exact = closing_of(ma.derivatives(system, 0.0, state).motions)
    rounding = 1e-11 * np.random.default_rng(2).standard_normal(len(exact))
    rounded = closing_of(ma.derivatives(system, 0.0, displaced(state, rounding)).motions)
    assert not ma.derivatives(system).motions.independent
    np.testing.assert_allclose(rounded, exact, atol=1e-8 * np.abs(exact).max())


def test_a_joint_whose_frames_meet():
    """Two carts couple where their frames meet, and nearby motions do so elsewhere."""
    coupling = {
        "kind": "weld", "at": {"xyz": [0.4, 0, 0]}, "at_first": {"xyz": [1.0, 0, 0]},
        "from": {"when": lambda t, state: apart(state) - 0.6},
    }  # fmt: skip

    def apart(state):
        return state.objects["cart1"].position[0] - state.objects["cart0"].position[0]

    check(objects_on_rails([1.0, 2.0], [1.5, -0.4], coupling), 0.8, ["objects.cart0.mass"])


def test_a_joint_whose_frames_meet_at_one_time_only():
    """Nearby motions are put on the joint where they miss it."""
    begin, angle, rate = 0.1, 0.3, -1.0
    rider = {"rider": arm("Y", velocity=[rate], mass=1.0, inertia=0.3)}
    free = pendulum(angle, rate, rider, [{"arm": "rider", "kind": "weld"}])
    place = end_of(ma.compile_system(parse_scene(free)), begin).object_position
    drop = 0.5 * FALL * begin**2
    catcher = {"catcher": arm("xz", mass=0.8, base={"xyz": [place[0], 0.0, place[2] + drop]})}
    grip = {"arm": "catcher", "name": "grip", "kind": "ball", "at": {}, "from": begin}
    table = pendulum(angle, rate, rider | catcher, [{"arm": "rider", "kind": "weld"}, grip])
    check(table, 0.3, ["joints[2].from"], step=2e-5, put=True)


def test_bodies_that_turn():
    """Two free bodies that turn about all axes are joined by a hinge, and part again."""
    bodies = {
        "p": {"mass": 1.3, "inertia": [0.1, 0.2, 0.25], "twist": [0.3, 0.1, -0.2, 1.0, -0.7, 0.4],
              "pose": {"xyz": [0, 0, 0], "rpy": [0.2, 0.1, -0.4]}},
        "q": {"mass": 0.7, "inertia": [0.05, 0.06, 0.08], "twist": [-0.3, 0.2, 0.1, -0.5, 0.9, 0.6],
              "pose": {"xyz": [0.5, 0.2, 0.1], "rpy": [0.5, -0.3, 0.8]}},
    }  # fmt: skip
    hinge = {"between": ["p", "q"], "name": "hinge", "kind": "revolute", "axis": [0, 0, 1],
             "from": 0.1, "until": 0.3}  # fmt: skip
    table = {"gravity": [0, 0, -9.81], "objects": bodies, "joints": [hinge]}
    check(table, 0.4, ["joints[0].from", "joints[0].until"])


def test_two_ur5s_hand_a_box_over():
    """One holds it and swings, the other takes hold of it, the first lets go."""
    robot = {"robot": "ur5", "tip": "tool0", "posture": UR5_POSTURE}
    arms = {
        "left": {**robot, "base": {"xyz": [-1.1, 0.0, 0.0]},
                 "velocity": [0.3, -0.2, 0.3, 0.2, -0.3, 0.4]},
        "right": {**robot, "base": {"xyz": [1.1, 0.0, 0.0], "rpy": [0.0, 0.0, math.pi]}},
    }  # fmt: skip
    table = {
        "gravity": [0.0, 0.0, -9.81],
        "object": {"shape": {"box": [0.4, 0.3, 0.2]}, "mass": 3.0, "pose": {"xyz": [0, 0, 0.5]}},
        "arms": arms,
        "joints": [{"arm": "left", "kind": "weld", "until": 0.08},
                   {"arm": "right", "kind": "weld", "from": 0.05}],
        "control": {"kind": "joint_pd", "stiffness": 60.0, "damping": 2.0,
                    "gravity_compensation": True},
    }  # fmt: skip
    check(table, 0.1, ["joints[0].until", "joints[1].from"])


# --- what has no derivatives ----------------------------------------------------------------------


def refuse(table, duration, *places, error=SolverError, paths=(), **more):
    system = ma.compile_system(parse_scene(table))
    with refused(error, *places):
        ma.gradient(system, duration, final=ahead, parameters=paths, **more)


def test_switches_at_one_time_for_different_reasons():
    table = handed_over(a={"until": {"when": lambda t, state: 0.5 - t}}, b={"from": 0.5})
    refuse(table, 0.8, "0.5 s", "b: attached", "a: detached")


def test_a_joint_that_has_taken_hold_before_the_start():
    refuse(handed_over(), 0.8, "'b'", "0.3 s", start_time=0.35)


@pytest.mark.parametrize("late", [0.0, 1e-13], ids=["exactly", "nearly"])
def test_a_time_at_the_start_or_the_end(late):
    """No step leads from a time to one that is so near."""
    for begin, duration in ((0.1 + late, 0.2), (0.3 + late, 0.2), (0.3 - late, 0.2)):
        system = coupling_carts(begin, at={"xyz": [0.5, 0, 0]})
        with refused(SceneError, "joints[1].from"):
            ma.gradient(
                system, duration, final=ahead, parameters=["joints[1].from"], start_time=0.1
            )


@pytest.mark.parametrize("start_time", [0.0, 1.5])
def test_a_joint_that_lets_go_and_takes_hold_at_once(start_time):
    """Its next interval has begun when a function lets it go."""
    end = start_time + 0.17
    pairs = [[0, {"when": lambda t, state: end - t}], [max(0.1, start_time - 0.5), end + 0.13]]
    rails = RAILS | {"light": RAILS["light"] | {"joint": {"from": pairs}}}
    refuse(carts(0.4, rails), 0.2, "'light'", f"{end:g} s", start_time=start_time)


def test_switches_that_are_too_near_to_each_other():
    table = handed_over(a={"until": 0.3 + 2e-9})
    refuse(table, 0.5, "0.3 s", "2.0e-09 s", "b: attached", "a: detached")


def test_a_nearby_run_with_other_switches():
    """Its phases are none that could be compared, however many times there are."""
    system = ma.compile_system(parse_scene(handed_over()))
    run = ma.simulate(system, 0.6, accuracy=1e-9)

    def at(t):
        return system.initial_state()

    ours = phases(system, run, 0.0, at)
    assert [phase.time for phase in phases(system, run, 0.0, at, ours)] == [-math.inf, 0.3, 0.5]
    for like in (ours[:2], [*ours, ours[1]], [ours[0], ours[2], ours[1]]):
        with refused(SolverError):
            phases(system, run, 0.0, at, like)


def test_matrices_are_kept_by_phase():
    """At the time of a switch both phases have a node where time has no more digits."""
    system = coupling_carts(0.2)
    linearised = LinearisedRun(system, 0.0, 0.3, 1e-9, None, (), np.zeros(0))
    state, (first, second) = linearised.state(0.0), linearised._run.phases
    free, coupled = (linearised._equation_at_node(0.2, state, p).motions for p in (first, second))
    assert len(coupled.constraint) > len(free.constraint)


def test_a_function_that_grazes_zero():
    """The third power of what passes through zero; the run finds its root all the same."""
    table = handed_over(b={"from": {"when": lambda t, state: (0.3 - t) ** 3}})
    refuse(table, 0.4, "'b' takes hold")


def test_a_joint_that_takes_hold_when_a_contact_closes():
    joint = {"between": ["object", "world"], "name": "catch", "kind": "weld",
             "from": {"touching": "floor"}}  # fmt: skip
    table = {"gravity": [0, 0, -9.81], "object": ball(height=0.02), "joints": [joint],
             "robots": ASIDE, "effects": {"floor": {}}}  # fmt: skip
    refuse(table, 0.2, "touches")


def test_contacts_that_are_closed():
    """A ball that rests on the floor is held by the world."""
    joint = {"between": ["object", "world"], "name": "hold", "kind": "weld", "from": 0.1}
    table = {"gravity": [0, 0, -9.81], "object": ball(radius=0.1, mass=2.0), "joints": [joint],
             "robots": ASIDE, "effects": {"floor": {"mu": 0.5}}}  # fmt: skip
    refuse(table, 0.2, "'hold'")
