"""The event "at rest": when objects stop for good, on what, and what rest costs."""

from __future__ import annotations

import numpy as np
import pytest
from event_scenes import GRAVITY, arm, ball, box, fall_time, on_floor, run, times
from object_scenes import ASIDE, DOWN, objects_scene

import multiarm as ma
from multiarm.scene import parse_scene
from multiarm.simulation import driver
from multiarm.viewer.page import time_line

AT_REST = "at rest"
START = {"start": "as_written"}


def rests(trajectory) -> list[tuple[str, list[str]]]:
    """Who came to rest, and on what, in order of time."""
    return [(e["object"], e["on"]) for e in trajectory.events if e["kind"] == AT_REST]


def feet(upper: str, lower: str, points, height: float, mu: float | None) -> list[dict]:
    """Contacts of points of one object with a plane across z of another one, at a height of it."""
    return [
        {
            "between": [upper, lower], "name": f"{upper}_{lower}_{k}", "kind": "point_on_plane",
            "at": {"xyz": [0, 0, height]}, "at_first": {"xyz": list(point)},
            **({} if mu is None else {"mu": mu}),
        }
        for k, point in enumerate(points)
    ]  # fmt: skip


def block(sizes, xyz, mass: float = 2.0, **more) -> dict:
    """A box with its pose."""
    return {"shape": {"box": list(sizes)}, "mass": mass, "pose": {"xyz": list(xyz)}, **more}


def below(sizes, share: float = 1.0) -> list[tuple[float, float, float]]:
    """Lower corners of a box about its centre, or points nearer to its middle."""
    x, y, z = (0.5 * size for size in sizes)
    return [(share * i * x, share * j * y, -z) for i in (-1, 1) for j in (-1, 1)]


# --- closed forms ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("speed", "mu"), [(1.5, 0.3), (0.2, 0.7)])
def test_a_box_that_slides_rests_after_v_over_mu_g(speed, mu):
    trajectory = run(on_floor(box(twist=[speed, 0, 0, 0, 0, 0]), mu=mu), 1.0, 1e-10)
    (event,) = (e for e in trajectory.events if e["kind"] == AT_REST)
    assert event["time"] == pytest.approx(speed / (mu * GRAVITY), abs=1e-10)
    assert event["where"] == pytest.approx([speed**2 / (2 * mu * GRAVITY), 0, 0.1], abs=1e-9)
    assert (event["object"], event["on"]) == ("object", ["floor"])
    assert event["text"] == "object: at rest on the floor"
    after = trajectory.time > event["time"]
    np.testing.assert_allclose(trajectory.object_twist[after], 0.0, atol=1e-12)


@pytest.mark.parametrize("mu", [None, 0.4])
def test_a_ball_that_bounces_rests_when_the_geometric_series_ends(mu):
    """Without friction nothing but balance keeps it; with friction it could still roll."""
    restitution, height = 0.5, 0.2
    trajectory = run(on_floor(ball(height=height), restitution, mu), 2.0, 1e-8)
    whole = fall_time(height) * (1 + restitution) / (1 - restitution)
    # bounces below the tolerance of a step, a tenth of the accuracy, are not followed
    last = 2 * fall_time(1e-9)
    left = last / (1 - restitution)
    (time,) = times(trajectory, AT_REST)
    assert whole - left - 1e-8 <= time <= whole + 1e-8
    assert rests(trajectory) == [("object", ["floor"])]


def on_slab(speed: float, mu: float, mu_floor: float):
    """A box that slides on a slab, which lies on the floor."""
    sizes, slab = (0.3, 0.2, 0.2), (3.0, 1.0, 0.1)
    objects = {
        "slab": block(slab, [0, 0, 0.05], 5.0),
        "box": block(sizes, [0, 0, 0.2], twist=[speed, 0, 0, 0, 0, 0]),
    }
    effects = {"unilateral_contacts": START, "floor": {"object": "slab", "mu": mu_floor}}
    joints = feet("box", "slab", below(sizes), 0.05, mu)
    return parse_scene(objects_scene(objects, joints, gravity=DOWN, effects=effects, robots=ASIDE))


def test_a_box_rests_on_a_slab_that_the_floor_holds():
    """The slab, which never moves, comes to no rest."""
    trajectory = run(on_slab(1.2, 0.3, 0.5), 0.8, 1e-10)
    assert times(trajectory, AT_REST) == pytest.approx([1.2 / (0.3 * GRAVITY)], abs=1e-10)
    assert rests(trajectory) == [("box", ["slab"])]


def test_a_slab_that_its_load_drags_rests_with_it():
    """The box brakes against the slab, until both slide on the floor as one."""
    m, M, mu, nu, speed = 2.0, 5.0, 0.8, 0.1, 1.2
    trajectory = run(on_slab(speed, mu, nu), 2.0, 1e-8)
    pull = (mu * m - nu * (m + M)) * GRAVITY / M  # acceleration of the slab
    together = speed / (mu * GRAVITY + pull)
    stop = together + pull * together / (nu * GRAVITY)
    assert rests(trajectory) == [("slab", ["floor"]), ("box", ["slab"])]
    assert times(trajectory, AT_REST) == pytest.approx([stop, stop], abs=1e-8)


@pytest.mark.parametrize("mu", [None, 0.4])
def test_a_box_that_an_arm_lets_go_falls_and_rests(mu):
    height, released = 0.05, 0.3
    hand = {**arm("xyz"), "base": {"xyz": [0, 0, height + 0.2]}}
    table = {
        "gravity": DOWN,
        "object": block((0.4, 0.3, 0.2), [0, 0, height + 0.1]),
        "arms": {"hand": hand},
        "joints": [{"arm": "hand", "kind": "weld", "until": released}],
        "control": {"kind": "gravity_compensation"},
        "effects": {"floor": {} if mu is None else {"mu": mu}, "unilateral_contacts": START},
    }
    trajectory = run(parse_scene(table), 1.0, 1e-10)
    assert rests(trajectory) == [("object", ["floor"])]
    assert times(trajectory, AT_REST) == pytest.approx([released + fall_time(height)], abs=1e-10)


# --- what rests, and what does not ----------------------------------------------------------------


def test_a_plank_rests_on_the_two_blocks_below_it():
    plank, base = (1.0, 0.2, 0.04), (0.2, 0.2, 0.2)
    objects = {
        "plank": block(plank, [0, 0, 0.25]),
        "left": block(base, [-0.4, 0, 0.1]),
        "right": block(base, [0.4, 0, 0.1]),
    }
    ends = [[(x, y, -0.02) for y in (-0.1, 0.1)] for x in (-0.4, 0.4)]
    joints = feet("plank", "left", ends[0], 0.1, 0.5) + feet("plank", "right", ends[1], 0.1, 0.5)
    effects = {"unilateral_contacts": START, "floor": {"mu": 0.5}}
    scene = objects_scene(objects, joints, gravity=DOWN, effects=effects, robots=ASIDE)
    trajectory = run(parse_scene(scene), 0.5, 1e-8)
    assert rests(trajectory) == [("plank", ["left", "right"])]
    assert times(trajectory, AT_REST) == pytest.approx([fall_time(0.03)], abs=1e-8)


@pytest.mark.parametrize(
    "scene",
    [
        on_floor(box(), mu=0.3),  # it has not moved
        on_floor(ball(twist=[0.3, 0, 0, 0, 6.0, 0]), mu=0.5),  # it rolls
        on_floor(box(twist=[0, 0, 0, 0, 0, 2.0])),  # it turns, and nothing brakes it
        on_floor(box(twist=[0.1, 0, 0, 0, 0, 0])),  # it slides, and nothing brakes it
    ],
    ids=["stands", "rolls", "turns", "slides"],
)
def test_what_does_not_stop_is_not_told_to_rest(scene):
    assert rests(run(scene, 0.5, 1e-8)) == []


def test_a_box_that_will_be_pushed_is_not_in_balance():
    """Without friction the push moves it at once; friction holds it until then, and beyond."""
    push = {"on": "object", "force": [1.0, 0, 0], "pulse": {"begin": 0.3, "end": 0.4}}
    for mu, on in ((None, []), (0.5, [("object", ["floor"])])):
        scene = on_floor(box(height=0.1), mu=mu, effects={"external_wrenches": [push]})
        assert rests(run(scene, 0.5, 1e-8)) == on


def test_joints_that_hold_are_not_called_rest():
    """A block that a weld catches says "attached"; what then lands on it rests."""
    sizes = (0.2, 0.2, 0.2)
    objects = {"lower": block(sizes, [0, 0, 1.0]), "upper": block(sizes, [0, 0, 1.25])}
    catch = {"between": ["lower", "world"], "kind": "weld", "name": "catch", "from": 0.1}
    joints = [catch, *feet("upper", "lower", below(sizes), 0.1, 0.5)]
    scene = objects_scene(
        objects, joints, gravity=DOWN, effects={"unilateral_contacts": START}, robots=ASIDE
    )
    trajectory = run(parse_scene(scene), 1.0, 1e-10)
    fallen = 0.5 * GRAVITY * 0.1**2  # of the lower one until it is caught
    assert rests(trajectory) == [("upper", ["lower"])]
    assert times(trajectory, AT_REST) == pytest.approx([fall_time(0.05 + fallen)], abs=1e-10)


def test_a_box_leaves_its_rest_and_comes_back():
    """A push beyond friction; the box slides on when it ends, and stops once more."""
    push = {"on": "object", "force": [20.0, 0, 0], "pulse": {"begin": 0.5, "end": 0.7}}
    scene = on_floor(box(twist=[0.5, 0, 0, 0, 0, 0]), mu=0.3, effects={"external_wrenches": [push]})
    trajectory = run(scene, 2.0, 1e-9)
    drag = 0.3 * GRAVITY
    stop = 0.7 + 0.2 * (20.0 / 2.0 - drag) / drag
    assert times(trajectory, AT_REST) == pytest.approx([0.5 / drag, stop], abs=1e-9)
    kinds = [event["kind"] for event in trajectory.events]
    first = kinds.index(AT_REST)
    assert "slides" in kinds[first : kinds.index(AT_REST, first + 1)]


# --- what it costs, and where it is told ----------------------------------------------------------


def test_rest_costs_a_few_steps_however_long_it_lasts():
    """Steps grow until roundings of the load are all of their errors."""
    scene = on_floor(box(twist=[1.5, 0, 0, 0, 0, 0]), mu=0.3)
    steps = [run(scene, T, 1e-8, output_step=10.0).statistics["steps"] for T in (0.6, 100.0)]
    assert steps[1] - steps[0] < 40


def stiff_hand():
    """An arm with stiff and damped joints that lets an object fall."""
    hand = {**arm("xyz", mass=0.01), "base": {"xyz": [0, 0, 0.3]}}
    return parse_scene(
        {
            "gravity": DOWN,
            "object": block((0.4, 0.3, 0.2), [0, 0, 0.15]),
            "arms": {"hand": hand},
            "joints": [{"arm": "hand", "kind": "weld", "until": 0.1}],
            "control": {"kind": "joint_pd", "stiffness": 1e3, "damping": 20.0},
            "effects": {"floor": {"mu": 0.5}, "unilateral_contacts": START},
        }
    )


def test_robots_that_stand_still_beside_an_object_at_rest_cost_a_few_steps(monkeypatch):
    """Stability limits explicit steps to 3 ms; a trial of implicit ones that failed is repeated."""
    judge, judged = driver.Switch._is_faster, []

    def second_time(switch, run):
        judged.append(run.clock.t)
        return len(judged) > 1 and judge(switch, run)

    monkeypatch.setattr(driver.Switch, "_is_faster", second_time)
    monkeypatch.setattr(driver, "TRIAL_STEPS", 1)
    trajectory = run(stiff_hand(), 100.0, 1e-6, output_step=10.0)
    changes = times(trajectory, "method changes")
    assert len(changes) == 3
    assert trajectory.statistics["steps"] < 100 + 2 * changes[2] / 3e-3


def test_files_and_pages_tell_the_rest(tmp_path):
    trajectory = run(on_floor(box(twist=[1.5, 0, 0, 0, 0, 0]), mu=0.3), 0.8, 1e-8)
    trajectory.save(tmp_path / "run.h5")
    again = ma.load_trajectory(tmp_path / "run.h5")
    (event,) = (e for e in again.events if e["kind"] == AT_REST)
    assert event == next(e for e in trajectory.events if e["kind"] == AT_REST)
    rows = time_line(again.events, again.time, 1.0)["rows"]
    assert rows[-1]["words"][1] == "object at rest on the floor"
