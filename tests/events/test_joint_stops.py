"""Joints at the ends of their range, and joints with set-valued dry friction."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from loose_scenes import cart_with_box, happened, slider
from mechanics import ur5_pair
from scipy.optimize import brentq

import multiarm as ma
from multiarm.results.event_log import change
from multiarm.scene.text import parse_yaml

MASS = 5.0  # [kg] cart and box


def run(data: dict, **how):
    return ma.simulate(ma.compile_system(ma.Scene(**data)), certificate=False, **how)


# --- ends of the range ----------------------------------------------------------------------------


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_a_cart_stops_at_the_end_of_its_rail(tmp_path, restitution):
    limits = {"range": {"cart": {"slide": [-1.0, 0.8]}}, "restitution": restitution}
    data = cart_with_box(tmp_path, {"joint_limits": limits}, velocity=0.5)
    trajectory = run(data, duration=3.0)
    assert trajectory.status == "completed", trajectory.message
    hit = happened(trajectory)[0]
    assert hit["time"] == pytest.approx(0.8 / 0.5, abs=1e-9)
    assert "cart: slide" in hit["text"] and "its upper limit" in hit["text"]
    assert hit["before"]["gap_rate_m_s"] == pytest.approx(-0.5, abs=1e-10)
    assert hit["after"]["gap_rate_m_s"] == pytest.approx(0.5 * restitution, abs=1e-10)
    assert hit["after"]["impulse_N_s"] == pytest.approx(MASS * 0.5 * (1 + restitution), rel=1e-9)
    assert change(hit).endswith(" N s")
    assert trajectory.joint_velocities["cart"][-1, 0] == pytest.approx(-0.5 * restitution, abs=1e-9)
    lost = trajectory.effect_works["impacts"][-1]
    assert lost == pytest.approx(-0.5 * MASS * 0.25 * (1 - restitution**2), abs=1e-9)
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-9
    assert np.max(trajectory.joint_positions["cart"]) < 0.8 + 1e-9


def test_a_joint_beyond_its_limit_is_named_with_its_arm(tmp_path):
    limits = {"range": {"cart": {"slide": [-1.0, 0.8]}}}
    system = ma.compile_system(ma.Scene(**cart_with_box(tmp_path, {"joint_limits": limits})))
    state = system.initial_state()
    state.position[0] += 0.9
    state.joint_positions["cart"][:] = 0.9
    ev = ma.evaluate(system, 0.0, state)
    assert ev.contradictions == ("cart/slide",)
    assert "cart/slide" in ev.message


def test_limits_of_the_robots_file_stop_a_joint_too(tmp_path):
    rail = {"lower": -0.3, "upper": 0.2}
    data = cart_with_box(tmp_path, {"joint_limits": "urdf"}, velocity=-0.5, cart=rail)
    trajectory = run(data, duration=1.0)
    (hit,) = happened(trajectory)
    assert hit["time"] == pytest.approx(0.6, abs=1e-9)
    assert trajectory.joint_positions["cart"][-1, 0] == pytest.approx(-0.3, abs=1e-9)


def test_a_joint_leaves_its_limit_when_it_is_pulled_away(tmp_path):
    """A force presses against the stop and turns round: until then the stop pushes back."""
    limits = {"range": {"cart": {"slide": [-1.0, 0.0]}}}
    control = {
        "kind": "harmonic",
        "amplitude": {"cart": 10.0},
        "frequency": 0.5,
        "hold": False,
    }
    trajectory = run(cart_with_box(tmp_path, {"joint_limits": limits}, control=control))
    pressed = trajectory.joint_positions["cart"][trajectory.time <= 1.0, 0]
    assert np.max(np.abs(pressed)) < 2e-9
    # x'' = (A / M) sin(pi t) from rest at t = 1
    t = trajectory.time[-1]
    x = (10.0 / MASS) * (-(t - 1.0) / math.pi - np.sin(math.pi * t) / math.pi**2)
    assert trajectory.joint_positions["cart"][-1, 0] == pytest.approx(x, abs=1e-8)


def test_an_elbow_stops_with_a_held_box():
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"})
    start = ma.compile_system(scene).initial_state().joint_positions["left"][2]
    ends = {"range": {"left": {"elbow_joint": [start - 0.02, start + 0.02]}}}
    trajectory = ma.simulate(
        ma.compile_system(scene.replace(effects={"joint_limits": ends})),
        duration=0.4,
        accuracy=1e-7,
        certificate=False,
    )
    assert trajectory.status == "completed", trajectory.message
    hit = happened(trajectory)[0]
    assert "left" in hit["text"] and "elbow_joint" in hit["text"]
    assert hit["after"]["gap_rate_rad_s"] == pytest.approx(0.0, abs=1e-9)
    assert hit["after"]["impulse_N_m_s"] > 0.0
    elbow = trajectory.joint_positions["left"][:, 2]
    assert np.all(np.abs(elbow - start) < 0.02 + 1e-7)
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-4


# --- dry friction ---------------------------------------------------------------------------------


def harmonic(amplitude: float, frequency: float) -> dict:
    return {
        "kind": "harmonic",
        "amplitude": {"cart": amplitude},
        "frequency": frequency,
        "hold": False,
    }


def dry(torque) -> dict:
    return {"joint_friction": {"torque": torque, "model": "set_valued"}}


def test_a_joint_slips_when_the_load_exceeds_its_friction_and_sticks_when_it_rests(tmp_path):
    amplitude, frequency, friction = 10.0, 0.5, 6.0
    data = cart_with_box(tmp_path, dry(friction), control=harmonic(amplitude, frequency))
    trajectory = run(data, duration=1.2)
    slips, sticks = happened(trajectory)[:2]
    omega = 2 * math.pi * frequency
    begin = math.asin(friction / amplitude) / omega

    def speed(t):
        pushed = amplitude / omega * (math.cos(omega * begin) - math.cos(omega * t))
        return (pushed - friction * (t - begin)) / MASS

    end = brentq(speed, 0.6, 1.2, xtol=1e-14)
    assert (slips["kind"], sticks["kind"]) == ("joint slips", "joint sticks")
    assert slips["time"] == pytest.approx(begin, abs=1e-9)
    assert sticks["time"] == pytest.approx(end, abs=1e-8)
    moving = (trajectory.time > begin + 1e-6) & (trajectory.time < end - 1e-6)
    expected = [speed(t) for t in trajectory.time[moving]]
    np.testing.assert_allclose(trajectory.joint_velocities["cart"][moving, 0], expected, atol=1e-8)
    still = trajectory.joint_velocities["cart"][~moving, 0]
    assert np.max(np.abs(still)) < 1e-9
    travelled = trajectory.joint_positions["cart"][-1, 0]
    work = trajectory.effect_works["joint_friction"][-1]
    assert work == pytest.approx(-friction * travelled, abs=1e-8)
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-8


def test_a_lagging_drive_that_starts_at_its_command_overcomes_friction_at_once(tmp_path):
    """10 N against 4 N move 5 kg: the mode of the start is that of the torque that acts there."""
    system = ma.compile_system(
        ma.Scene(
            **cart_with_box(
                tmp_path,
                {**dry(4.0), "actuator_lag": {"time_constant": 0.1, "start": "command"}},
                control={"kind": "constant", "torques": {"cart": 10.0}},
            )
        )
    )
    for evaluation in (ma.evaluate(system), ma.derivatives(system).evaluation):
        assert evaluation.joint_accelerations["cart"][0] == pytest.approx(1.2, rel=1e-12)
    trajectory = ma.simulate(system, duration=0.2, certificate=False)
    assert not happened(trajectory)
    speeds = trajectory.joint_velocities["cart"][:, 0]
    np.testing.assert_allclose(speeds, 1.2 * trajectory.time, atol=1e-9)


def test_a_joint_below_its_threshold_never_moves(tmp_path):
    trajectory = run(cart_with_box(tmp_path, dry(10.001), control=harmonic(10.0, 0.5)))
    assert happened(trajectory) == []
    assert np.max(np.abs(trajectory.joint_positions["cart"])) == pytest.approx(0.0, abs=1e-12)


def test_a_cart_slides_to_rest_under_dry_friction_of_its_urdf(tmp_path):
    data = cart_with_box(tmp_path, dry("urdf"), velocity=0.6, cart={"friction": 3.0})
    trajectory = run(data)
    (sticks,) = happened(trajectory)
    assert sticks["time"] == pytest.approx(0.6 * MASS / 3.0, abs=1e-9)
    way = 0.5 * 0.6**2 * MASS / 3.0
    assert trajectory.joint_positions["cart"][-1, 0] == pytest.approx(way, abs=1e-9)


def test_two_arms_with_dry_friction_in_all_joints_rest_under_small_torques():
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"}).replace(
        gravity=None,
        object={"shape": {"box": [1.2, 0.4, 0.4]}, "mass": 10.0},
        effects=dry(2.0),
        control={"kind": "constant", "torques": {"left": 1.5, "right": -1.2}},
    )
    system = ma.compile_system(scene)
    trajectory = ma.simulate(system, duration=0.2, accuracy=1e-7, certificate=False)
    assert trajectory.status == "completed", trajectory.message
    assert happened(trajectory) == []
    for arm in ("left", "right"):
        assert np.max(np.abs(trajectory.joint_velocities[arm])) < 1e-9


def test_stick_slip_is_that_of_a_spring_and_a_block(tmp_path):
    """A PD spring pulls the cart back; each half swing loses 2 c / k of its width."""
    friction, stiffness = 2.0, 200.0
    control = {"kind": "joint_pd", "stiffness": stiffness, "damping": 0.0}
    data = cart_with_box(tmp_path, dry(friction), velocity=0.5, control=control)
    trajectory = run(data, duration=4.0)
    omega, shift = math.sqrt(stiffness / MASS), friction / stiffness
    width = math.hypot(0.5 / omega, shift) - shift  # first turning point
    (sticks,) = happened(trajectory)  # where it turns at once, it does not stick
    first = (math.pi / 2 - math.atan2(shift, 0.5 / omega)) / omega
    half_swings = 0
    while stiffness * width > friction:
        width, half_swings = abs(width - 2 * shift), half_swings + 1
    assert sticks["time"] == pytest.approx(first + half_swings * math.pi / omega, abs=1e-7)
    rest = abs(trajectory.joint_positions["cart"][-1, 0])
    assert rest == pytest.approx(width, abs=1e-8)
    assert half_swings == 3


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"range": {"crat": {"slide": [0, 1]}}}, "unknown arm 'crat'; did you mean 'cart'?"),
        ({"range": {"cart": {"slid": [0, 1]}}}, "unknown joint 'slid'; did you mean 'slide'?"),
        ({"range": {"cart": {"slide": [1, 0]}}}, "the lower end 1 is not below 0"),
        ({"range": {"cart": {"slide": [1, 2]}}}, "'cart/slide' starts at 0, below its lower end 1"),
        ({"range": "urfd"}, "$.effects.joint_limits.range: unknown value 'urfd'"),
        ({"range": 3}, "$.effects.joint_limits.range: must be a table"),
        ({"restitution": 1.5}, "$.effects.joint_limits.restitution: must be at most 1, got 1.5"),
        ({"restitution": "0.5"}, "$.effects.joint_limits.restitution: must be a number"),
        ({"restitution": True}, "$.effects.joint_limits.restitution: must be a number"),
        (
            {"range": {"cart": {"slide": ["-1", 1]}}},
            "$.effects.joint_limits.range.cart.slide[0]: must be a number",
        ),
        (
            {"range": {"cart": {"slide": [-1, True]}}},
            "$.effects.joint_limits.range.cart.slide[1]: must be a number",
        ),
        (
            {"range": {"cart": {"slide": [float("nan"), 1]}}},
            "$.effects.joint_limits.range.cart.slide[0]: must be a number",
        ),
    ],
)
def test_bad_limits_are_told(tmp_path, limits, words):
    with pytest.raises(ma.MultiarmError) as caught:
        ma.compile_system(ma.Scene(**cart_with_box(tmp_path, {"joint_limits": limits})))
    assert words in str(caught.value)


def test_a_range_may_be_open_at_one_end(tmp_path):
    limits = {"range": {"cart": {"slide": [-math.inf, 0.8]}}}
    system = ma.compile_system(ma.Scene(**cart_with_box(tmp_path, {"joint_limits": limits})))
    stops = [record.name for record in system.model.unilateral.records["cart"]]
    assert [name for name in stops if "limit" in name] == ["slide at its upper limit"]


def test_a_robot_without_a_range_is_told(tmp_path):
    text = Path(slider(tmp_path)).read_text().replace('type="prismatic"', 'type="continuous"')
    (tmp_path / "wheel.urdf").write_text(text)
    data = cart_with_box(tmp_path, {"joint_limits": "urdf"})
    data["arms"]["cart"]["urdf"] = str(tmp_path / "wheel.urdf")
    (warning,) = (line for line in ma.Scene(**data).warnings if "gives no joint a range" in line)
    remedy = warning.rpartition("write '")[2].rstrip("'")
    remedy = parse_yaml(remedy.replace("joint", "slide").replace("lower, upper", "-1, 1"))
    data["effects"] = {"joint_limits": {"range": remedy}}
    assert ma.Scene(**data).effects.joint_limits.range == {"cart": {"slide": (-1.0, 1.0)}}
