"""Joints that take hold with contacts that hold both ways and rub; evaluations of placed joints."""

from __future__ import annotations

import numpy as np
import pytest

import multiarm as ma
from multiarm.errors import SceneError


def two_boxes(joint: dict, speed: float, **run) -> ma.Scene:
    """A heavy box, and one that passes it with a speed along x."""
    box = {"shape": {"box": [0.1, 0.1, 0.1]}}
    return ma.Scene(
        objects={
            "large": {**box, "mass": 3.0, "pose": {"xyz": [0, 0, 0]}},
            "small": {
                **box, "mass": 1.0, "pose": {"xyz": [0.2, 0, 0]}, "twist": [speed, 0, 0, 0, 0, 0],
            },
        },
        joints=[{"between": ["small", "large"], "name": "grab", **joint}],
        run={"duration": 0.3, "accuracy": 1e-8, **run},
    )  # fmt: skip


def grips(run: ma.Trajectory) -> list[dict]:
    """The events of joints that take hold or let go."""
    return [event for event in run.events if "energy_loss" in event]


@pytest.mark.parametrize("mu", [0.3, 2.0])
def test_a_weld_that_rubs_takes_hold_by_an_impact(mu):
    speed = 0.37
    system = ma.compile_system(two_boxes({"kind": "weld", "from": 0.1, "mu": mu}, speed))
    run = ma.simulate(system)
    (event,) = grips(run)
    reduced = 3.0 * 1.0 / 4.0
    # both move along x, on the line of their centres: nothing turns
    assert event["energy_loss"] == pytest.approx(0.5 * reduced * speed**2, rel=1e-9)
    np.testing.assert_allclose(event["impulse"][:3], [reduced * speed, 0, 0], atol=1e-9)
    for name in ("small", "large"):
        np.testing.assert_allclose(
            run.objects[name].twist[-1], [speed / 4.0, 0, 0, 0, 0, 0], atol=1e-9
        )
    assert run.certificate["met"]


@pytest.mark.parametrize("speed", [1e-8, 1e-7, 3e-6])
def test_a_slide_that_rubs_takes_hold_of_bodies_that_hardly_move(speed):
    slide = {"kind": "prismatic", "axis": [1, 0, 0], "from": 0.1, "mu": 0.3}
    run = ma.simulate(ma.compile_system(two_boxes(slide, speed, accuracy=1e-4)))
    assert run.status == "completed" and len(grips(run)) == 1


def test_an_evaluation_places_joints_anew_each_time():
    system = ma.compile_system(two_boxes({"kind": "weld", "from": [[0, 1], [2, 3]]}, 0.0))
    fresh = ma.compile_system(system.scene)
    moved = system.state(
        objects={"small": {"position": [0.3, 0.1, 0.2]}, "large": {"position": [0, 0, 0]}}
    )
    half = np.sqrt(0.5)
    turned = system.state(
        objects={
            "small": {"position": [0, 0.4, 0], "quaternion_xyzw": [0, 0, half, half]},
            "large": {"position": [0, 0, 0]},
        }
    )  # fmt: skip
    for t, state in ((2.5, moved), (2.5, turned), (0.5, None), (1.5, None), (2.5, moved)):
        again, expected = ma.evaluate(system, t, state), ma.evaluate(
            ma.compile_system(fresh.scene), t, state
        )  # fmt: skip
        assert again.position_residual < 1e-13
        np.testing.assert_allclose(
            again.contact_terms["grab"].W_o, expected.contact_terms["grab"].W_o, atol=1e-14
        )


def test_coordinates_count_from_the_turn_in_which_a_joint_takes_hold():
    hinge = {"kind": "revolute", "axis": [0, 0, 1], "from": 0.1, "limits": [-1.0, 1.0]}
    table = two_boxes(hinge, 0.0).model_dump(exclude_defaults=True)
    table["objects"]["small"]["twist"] = [0, 0, 0, 0, 0, 34.0]
    run = ma.simulate(ma.compile_system(ma.Scene(**table)), 0.101)
    assert not [event for event in run.events if event["kind"] == "passes its limit"]
    assert np.all(np.abs(run.relative_position["grab"][-1]) < 0.1)


def test_only_the_last_of_several_pairs_lasts_for_good():
    with pytest.raises(SceneError, match="only the last pair may end with 'never'"):
        two_boxes({"kind": "weld", "from": [[0.1, "never"], [1, 2]]}, 0.0)
    with pytest.raises(SceneError, match="times of pairs must increase; 1 comes after 3"):
        two_boxes({"kind": "weld", "from": [[3, {"touching": "floor"}], [1, 2]]}, 0.0)
