"""Claims about what a newcomer sees first: the example scripts and the README's code."""

from __future__ import annotations

import re
import runpy
import shutil
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from repository import ROOT, SCENES

import multiarm as ma
from multiarm.grasp.scenes import LEAST_SHARE
from multiarm.scene import REGISTRIES
from multiarm.scene.robots import find_robot
from multiarm.tableaus import ADAPTIVE_INTEGRATORS, FIXED_STEP_INTEGRATORS

README = (ROOT / "README.md").read_text(encoding="utf-8")
NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"


@pytest.fixture
def printed(capsys, monkeypatch):
    """Run the ``main()`` of an example, with these words on its command line; what it prints."""

    def run(name: str, *words: object) -> str:
        script = ROOT / "examples" / name
        monkeypatch.setattr(sys, "argv", [str(script), *map(str, words)])
        runpy.run_path(str(script))["main"]()
        return capsys.readouterr().out

    return run


@pytest.fixture
def workshop(tmp_path, monkeypatch) -> Path:
    """A folder to work in that has the examples' scenes, like a checkout."""
    shutil.copytree(SCENES, tmp_path / "examples" / "scenes")
    for own in REGISTRIES:
        monkeypatch.setattr(own, "registered", {})
    monkeypatch.chdir(tmp_path)
    return tmp_path


def figures(pattern: str, text: str) -> list[tuple[float, ...]]:
    """The numbers at every ``#`` of a pattern, wherever it is found in a text."""
    found = re.findall(pattern.replace("#", rf"\s*({NUMBER})"), text)
    assert found, f"{pattern!r} is not in {text!r}"
    rows = [row if isinstance(row, tuple) else (row,) for row in found]
    return [tuple(float(number) for number in row) for row in rows]


def assert_within_limits(text: str) -> None:
    ((effort, speed, position),) = figures("range: up to#,#,# % of a limit", text)
    assert 0.0 < max(effort, speed, position) <= 100.0


def assert_same_print(actual: str, expected: str) -> None:
    """The same words, and the same numbers to the last digit that is expected."""
    assert re.split(NUMBER, actual) == re.split(NUMBER, expected)
    pairs = zip(re.findall(NUMBER, actual), re.findall(NUMBER, expected), strict=True)
    for got, wanted in pairs:
        mantissa, _, exponent = wanted.partition("e")
        unit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
        assert abs(float(got) - float(wanted)) <= 0.51 * unit, f"{got} instead of {wanted}"


def test_every_example_is_run_here():
    scripts = {path.name for path in (ROOT / "examples").glob("*.py")}
    assert scripts == set(re.findall(r'printed\(\s*"(\w+\.py)"', Path(__file__).read_text()))


@pytest.mark.slow
def test_two_ur5_box_lifts_the_box_without_gaps(printed, tmp_path):
    text = printed("01_two_ur5_box.py", "--replay", tmp_path / "run.html")
    assert "constraints 12," in text and "completed: " in text
    assert max(figures("arm=#, object=#, constraint=#", text)[0]) < 1e-9
    ((x, y, z),) = figures(r"ends at \(#, #, #\) m", text)
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert z == pytest.approx(0.65, abs=1e-3)  # the path's last pose, up to the controller's error
    ((gap, imbalance),) = figures("largest gap # m, energy balance # J", text)
    assert 0.0 <= gap < 1e-10
    assert 0.0 <= imbalance < 1e-4
    left, right = figures("force up to # N on the box, # N at a contact", text)
    assert left == pytest.approx(right, rel=0.05)  # arms and grips are symmetric
    assert left[0] >= 0.5 * 20.0 * 9.81  # each carries half of the box
    assert (tmp_path / "run.html").stat().st_size > 10_000


@pytest.mark.slow
def test_three_panda_plate_converges_with_the_accuracy(printed):
    text = printed("02_three_panda_plate.py")
    rows = np.array(figures(r"(?m)^#\s+# +# s# m$", text))
    accuracy, evaluations, _, distance = rows.T
    np.testing.assert_array_equal(accuracy, [1e-3, 1e-5, 1e-7])
    assert np.all(np.diff(evaluations) > 0)
    assert np.all(distance < accuracy)


def test_all_fingertips_of_the_corner_grippers_push(printed):
    text = printed("03_corner_grippers_block.py")
    assert text.startswith("completed: ")
    for arm in ("left", "right"):
        ranges = figures(rf"(?m)^{arm} +fingertip # on face [xyz]# N to# N$", text)
        assert [row[0] for row in ranges] == [1, 2, 3, 4]
        assert all(0.0 < least <= largest < 700.0 for _, least, largest in ranges)
    ((least,),) = figures("all fingertips push with # N or more", text)
    assert least > 0.0
    ((gap, end),) = figures("largest gap # m over # s", text)
    assert 0.0 <= gap < 1e-10
    assert end == 3.0


def test_hinged_box_is_led_by_its_waypoints_and_squeezed(printed):
    text = printed("04_hinged_box.py")
    assert text.startswith("completed: ")
    rows = figures(r"(?m)^at# s: box# m off, hinge at# rad$", text)
    assert [row[0] for row in rows] == [1.0, 2.0, 3.0]
    assert all(error < 1e-6 for _, error, _ in rows)
    assert max(abs(angle) for _, _, angle in rows) > 0.1  # the hinge does turn
    ((imbalance,),) = figures("energy balance# J", text)
    assert 0.0 <= imbalance < 1e-4
    left, right = np.array(figures(r"squeezes with \(#,#,#\) N", text))
    np.testing.assert_allclose(left, [30.0, 0.0, 0.0], atol=0.02)
    np.testing.assert_allclose(left + right, 0.0, atol=0.02)
    assert max(figures("arm=#, object=#, constraint=#", text)[0]) < 1e-9


@pytest.mark.slow
def test_any_joint_is_the_same_hinge_three_times(printed):
    text = printed("05_any_joint.py")
    hinges = figures(r"turned by# rad, box# m from the first hinge", text)
    assert len(hinges) == 3
    angles, apart = np.array(hinges).T
    np.testing.assert_allclose(angles, angles[0], atol=1e-6)
    assert abs(angles[0]) > 0.01  # it does turn
    assert np.all(apart < 1e-9)
    assert [rows for (rows,) in figures(r"(?m):# rows; free:", text)] == [5, 5, 5, 1, 3]
    assert text.count("completed, ") == 5
    assert max(gap for (gap,) in figures("largest gap# m", text)) < 1e-11


@pytest.mark.slow
def test_what_accuracy_costs_meets_what_it_asks_for(printed):
    text = printed("06_what_accuracy_costs.py")
    rows = np.array(figures(r"asked#: met, estimated# m and# rad, \w+,# evaluations", text))
    asked, metres, radians, evaluations = rows.T
    np.testing.assert_array_equal(asked, [1e-3, 1e-6, 1e-9])
    assert np.all(np.maximum(metres, radians) <= asked) and np.all(np.diff(evaluations) > 0)
    steps = [count for _, count in figures(r"damping#: \w+,# steps", text)]
    assert steps[0] > steps[1] > steps[2]
    assert "damping 1e+06: rodas5p" in text
    assert figures(r"(?m)^# steps of# ms: completed$", text) == [(20000.0, 2.0)]
    first, last = figures(r"first quarter#, of the last# of", text)[0]
    assert max(abs(first), abs(last)) < 1e-5  # it neither grows nor falls
    assert_within_limits(text)


def test_a_magnet_in_python_and_a_compiled_one_move_the_object_alike(printed, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))  # the example adds its package's folder
    monkeypatch.setattr("multiarm.scene.EFFECTS.registered", {})
    text = printed("07_own_effect.py")
    moved = figures("completed, moves the object by# mm, does# mJ of work, .* balanced to# J", text)
    assert moved[0][:2] == moved[1][:2] and moved[0][0] > 1.0
    assert max(imbalance for *_, imbalance in moved) < 1e-5
    assert "$.effects.magnet.strenght: unknown key 'strenght'; did you mean 'strength'?" in text


def test_a_grasp_without_friction_is_designed_run_and_found_by_touch(printed):
    text = printed("10_form_closure_grasp.py")
    assert text.startswith("7 contacts hold the body: form closure")
    pushes = np.array([float(x) for x in re.search(r"pushes of (.*)", text)[1].split()])
    # thesis, Example 2.1: contact 7 at twice the least distance; both fronts are one balance
    np.testing.assert_allclose(pushes, [0.25, 0.15, 0.05, 0.25, 0.15, 0.1, 0.05], atol=1e-3)
    ((area,),) = figures(r"anywhere in# m\^2 of the top", text)
    assert 0.0 < area < 1.2 * 0.8
    assert figures(r"may slip by# mm at once", text)[0][0] > 1.0
    forces = np.array([float(x) for x in re.search(r"pressing, by (.*) N", text)[1].split()])
    assert forces.min() >= 1.0
    assert forces[5] - forces[2] - forces[6] == pytest.approx(5.0 * 9.81, abs=0.2)
    ((end, weakest),) = figures(r"completed after# s; the weakest contact presses with# N", text)
    mass, contacts = ma.load_scene(SCENES / "grasped_block.yaml").object.mass, 7
    assert end == 10.0
    assert weakest >= LEAST_SHARE * mass * 9.81 / contacts  # as the design promises
    assert "off by less than 1e-9 m: True" in text


@pytest.mark.slow
def test_a_sweep_goes_on_where_it_was_ended(printed, tmp_path):
    text = printed("11_sweep.py", "--plot", tmp_path / "sweep.png")
    assert "ended half way: True" in text
    assert figures(r"(?m)^# of# runs: \{'completed':#\}$", text) == [(32.0, 32.0, 32.0)]
    rows = np.array(figures(r"# kg: contact forces up to# N, off its path by# mm", text))
    np.testing.assert_array_equal(rows[:, 0], [5.0, 20.0, 35.0, 50.0])
    assert np.all(np.diff(rows[:, 1]) > 0.0)  # heavier boxes press harder
    assert "once more: completed" in text
    assert (tmp_path / "sweep.png").stat().st_size > 10_000


@pytest.mark.slow
def test_many_runs_tell_where_the_box_ends(printed, tmp_path):
    text = printed("09_many_runs.py", "--runs", 12, "--plot", tmp_path / "ends.png")
    assert figures("(?m)^# runs of# s in# s: completed$", text)[0][:2] == (12.0, 5.0)
    ((x, z, *_),) = figures(r"ends at \(#,#\) mm on average; it is led to \(#,#\) mm", text)
    assert abs(x) < 1.0 and 620.0 < z < 645.0  # the arms are soft and carry their own weight too
    ((sideways, up),) = figures("spread# mm sideways,# mm in height", text)
    assert 0.0 < sideways < up < 10.0
    ((sag,),) = figures("sag by# mm", text)
    assert 0.1 < sag < 2.0
    assert (tmp_path / "ends.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_digital_controller_holds_a_box_that_is_pushed(printed, tmp_path):
    text = printed("12_closed_loop_1khz.py", "--replay", tmp_path / "run.html")
    ((end, rate, factor),) = figures("(?m)^# s at# Hz:# times real time$", text)
    assert (end, rate) == (1.0, 1000.0) and factor > 0.0
    ((largest, last),) = figures("pushed by# mm and ends# mm away", text)
    assert 2.5 < largest < 7.5 and last < 0.1
    # two contacts of the left grip share half of the box's 196 N
    assert figures("grip of# contacts carries up to# N", text)[0] == (6.0, 49.0)
    assert (tmp_path / "run.html").stat().st_size > 10_000


@pytest.mark.slow
def test_a_regulator_brings_a_box_back(printed):
    text = printed("13_regulator.py")
    assert "held by its torques: unstable, 12 states" in text
    assert figures("with the regulator: stable, slowest motion dies out in# s", text)[0][0] < 0.2
    held, regulated = figures("pushed by up to# mm,# mm away at the end", text)
    assert held[1] > 100.0 and 1.0 < regulated[0] < 50.0 and regulated[1] < 0.1


@pytest.mark.slow
def test_two_arms_swing_a_box_to_its_target(printed):
    text = printed("15_swing_a_box.py")
    ((away, missed),) = figures("target# mm away, missed by# mm", text)
    assert away > 140.0 and missed < 3.0
    assert figures("speed at the end# mm/s", text)[0][0] < 30.0
    assert "the run is certified: True" in text
    assert_within_limits(text)


@pytest.mark.slow
def test_crocoddyl_swings_the_box_too(printed):
    pytest.importorskip("crocoddyl")
    text = printed("16_crocoddyl.py")
    assert "solved: True" in text
    assert figures("simulated, it misses# mm", text)[0][0] < 0.5
    assert figures("speed at the end# mm/s", text)[0][0] < 1.0


@pytest.mark.slow
def test_a_load_is_weighed_by_how_it_moves(printed):
    text = printed("14_weigh_a_load.py")
    assert_within_limits(text)
    ((misfit, rounding),) = figures("misfit# steps, by rounding alone#", text)
    assert misfit == pytest.approx(rounding, rel=0.1)
    ((mass, error, true),) = figures(r"mass# kg \+-#, true#", text)
    assert abs(mass - true) < 5.0 * error < 0.01
    found = figures(r"centre of mass [xyz]# mm \+-#, true#", text)
    assert len(found) == 3 and all(abs(x - true) < 5.0 * error < 10.0 for x, error, true in found)


@pytest.mark.slow
def test_a_torso_takes_the_rise_where_its_posture_says_so(printed):
    text = printed("17_torso_lifts_a_box.py")
    assert text.count("completed: ") == 2
    assert max(row[0] for row in figures("the box is# mm off", text)) < 0.2
    alone, led = (row[0] for row in figures("the torso rose by# of 120 mm", text))
    assert abs(alone) < 12.0 and led > 108.0
    carried = [row[0] for row in figures("carries# N of the weight", text)]
    assert sum(carried) == pytest.approx(3.0 * 9.81, abs=0.2)


@pytest.mark.slow
def test_two_carts_carry_a_table_along_an_arc(printed):
    text = printed("18_two_carts_carry_a_table.py")
    ((way, error),) = figures("completed: the table came# m, and is# mm off", text)
    assert way == pytest.approx(2.0 * np.sqrt(2.0), abs=0.01) and error < 2.0
    bases = figures("base_x# m, base_y# m, base_yaw# rad", text)
    # a quarter of a circle of 2 m about (0, 2) m, from (-1.35, 0) and, turned round, (1.35, 0) m
    assert bases[0] == pytest.approx((2.0 + 1.35, 2.0 - 1.35, np.pi / 2), abs=0.02)
    assert bases[1] == pytest.approx((-2.0 + 1.35, -2.0 - 1.35, np.pi / 2), abs=0.02)
    assert max(row[0] for row in figures("moved by up to# rad", text)) < 0.1
    weights = [row[0] for row in figures("N,# N of the weight", text)]
    assert sum(weights) == pytest.approx(12.0 * 9.81, abs=1.0)


@pytest.mark.slow
def test_pads_of_a_linkage_press_as_virtual_work_says(printed):
    text = printed("19_four_bar_gripper.py")
    assert "completed: the box rose by 100.0 mm" in text
    ((rows, rank),) = figures("# rows, of which# are independent", text)
    assert (rows, rank) == (20, 12)
    ((pressed, expected),) = figures("presses with# N; by virtual work# N", text)
    assert pressed == pytest.approx(expected, rel=1e-4)
    assert figures("largest gap of any joint# m", text)[0][0] < 1e-11


@pytest.mark.slow
def test_four_arms_push_a_peg_into_a_socket_that_does_not_feel_it(printed):
    text = printed("20_peg_and_socket.py")
    ((depth, rise),) = figures("completed: the peg went# mm into the socket,# mm higher", text)
    assert (depth, rise) == pytest.approx((150.0, 100.0), abs=2e-3)
    ((across, along, about),) = figures("up to# N across the peg,# N along it,# N m about it", text)
    assert across > 1.0 and along < 1e-10 and about < 1e-10
    assert figures("it moves by# m meanwhile", text)[0][0] < 1e-6
    assert figures("largest gap of any joint# m", text)[0][0] < 1e-11


@pytest.mark.slow
def test_a_stack_moves_as_one_body_and_its_weld_carries_the_upper_box(printed):
    text = printed("21_stack_of_boxes.py")
    ((rise,),) = figures("completed: the stack rose by# mm", text)
    assert rise == pytest.approx(100.0, abs=3.0)
    ((apart, turned),) = figures("are apart by# m, turned by#", text)
    assert max(apart, turned) < 1e-8
    ((carried, needed),) = figures(r"carries up to# N; m \(a - g\) is# N", text)
    assert carried == pytest.approx(needed, abs=0.05) and carried > 6.0 * 9.81


@pytest.mark.slow
def test_a_humanoid_lifts_a_box_on_feet_that_only_push(printed):
    text = printed("22_humanoid_lifts_a_box.py")
    ((box, base, off),) = figures("completed: the box rose by# mm, .* by# mm; .* ends# mm", text)
    assert 150.0 < base < 170.0 and box == pytest.approx(base, abs=5.0) and abs(off) < 1.0
    ((contacts, least, most, friction),) = figures(
        "each of# contacts below the feet pushes with# to# N, and needs a friction of# at", text
    )
    assert contacts == 8 and 0.0 < least < most and friction < 0.05
    ((weight, robot, load),) = figures("they carry# N:# kg of robot and# kg of box", text)
    model = pin.buildModelFromUrdf(str(find_robot("g1_29dof_rev_1_0").urdf))
    assert robot == pytest.approx(sum(part.mass for part in model.inertias), abs=0.01)
    assert weight == pytest.approx(9.81 * (robot + load), abs=0.05)
    assert figures("up to# % of their torque", text)[0][0] < 100.0


@pytest.mark.slow
def test_a_free_flyer_turns_without_angular_momentum(printed):
    text = printed("23_free_flyer.py")
    full, half = figures("completed, the body turned by# degrees about y,# about others", text)
    assert full[0] < -40.0 and half[0] == pytest.approx(full[0], rel=0.01)
    assert max(full[1], half[1]) < 1e-9
    assert max(off for (off,) in figures("the joints are# rad off", text)) < 1e-8
    ((spin, momentum),) = figures(r"up to# rad/s, .* never more than# kg m\^2/s", text)
    assert spin > 1.0 and momentum < 1e-12


@pytest.mark.slow
def test_two_hands_turn_a_cube_between_fingertips_that_roll(printed):
    text = printed("24_two_hands_turn_a_cube.py")
    ((turned, left),) = figures("completed: the cube turned by# degrees, and back to#", text)
    assert turned == pytest.approx(np.degrees(0.35), abs=0.01) and abs(left) < 1e-6
    assert "\nmet: " in text
    ((rolls, slips),) = figures("roll with up to# mm/s, and slip with# m/s", text)
    assert rolls > 1.0 and slips < 1e-12
    pushes = dict(re.findall(rf"near/(\w+) +pushes with ({NUMBER}) to", text))
    thumb, *fingers = (float(pushes[name]) for name in ("thumb", "index", "middle", "ring"))
    # two thumbs carry half of the cube each, and what the fingers press
    assert min(fingers) > 0.5 and thumb == pytest.approx(sum(fingers) + 0.15 * 9.81, abs=0.03)
    assert figures("a friction of# would", text)[0][0] < 0.05


@pytest.mark.slow
def test_two_hands_lift_a_box_by_friction_and_let_it_go(printed):
    text = printed("25_lift_by_friction.py")
    ((rise, across),) = figures("completed: the box rose by# mm,# mm across", text)
    assert (rise, across) == pytest.approx((200.0, 250.0), abs=0.1)
    assert "\nmet: " in text and "\nopening completed: met: " in text
    ((leaves, touches),) = figures("leave the floor at# s, and touch it at# s", text)
    assert 0.0 < leaves < 0.1 and 3.0 < touches < 3.5
    ((least, most),) = figures("press with# to# N in between", text)
    ((friction,),) = figures("need a friction of# at", text)
    # six fingertips share the weight, with a fifth of the friction left
    assert 6.0 * 9.81 / 6.0 / most < friction < 0.8 * 0.6 and least > 30.0
    ((last, away, shift),) = figures("lets go at# s, the hands end# mm away, .* by# mm", text)
    # the hands go along a tangent of their joints: second order of 50 mm in arms of half a metre
    assert 3.6 < last < 4.6 and away == pytest.approx(50.0, abs=2.5) and shift < 0.1


@pytest.mark.slow
def test_a_beam_is_handed_over(printed):
    text = printed("26_hand_over.py")
    grips = re.findall(rf"({NUMBER}) s  (\w+): (attached|detached), ({NUMBER}) J lost", text)
    said = [(float(time), arm, kind) for time, arm, kind, _ in grips]
    assert said == [
        (1.4, "left", "attached"),
        (4.2, "right", "attached"),
        (4.4, "left", "detached"),
        (6.8, "right", "detached"),
    ]
    assert all(0.0 <= float(lost) < 1e-3 for *_, lost in grips)
    ((x, y, z),) = figures(r"the beam ends at \(#,#,#\) m", text)
    # the paths of the flanges lead from -0.25 m to 0.25 m; springs give way
    assert (x, y, z) == pytest.approx((0.25, 0.4, 0.05), abs=5e-3) and "\nmet: " in text


@pytest.mark.slow
@pytest.mark.parametrize("body", ["block", "wedge", "frustum"])
def test_a_body_is_picked_up_by_tilting(printed, body):
    text = printed("28_pick_up_by_tilting.py", body)
    ((tilt,),) = figures("by# deg, then", text)
    assert 5.0 < tilt <= 30.0
    times = [time for (time,) in figures(r"(?m)^# s  floor: corner \d lets go", text)]
    ((attached,),) = figures(r"(?m)^# s  gripper_\d_below: attached", text)
    assert sum(time < attached for time in times) == 2
    ((until,),) = figures("floor presses until# s", text)
    assert attached < until < 0.65 * 4.5
    ((count, longest),) = figures("events list# openings of the hands' contacts, of# ms", text)
    assert 0.0 <= longest < 1.0
    assert sum(time > attached for time in times) == 2
    assert count == {"block": 0, "wedge": 4, "frustum": 0}[body] and "not listed" not in text
    ((weakest,),) = figures("free faces press with# N", text)
    ((below,),) = figures("those below with# N", text)
    assert min(weakest, below) > 0.07 * 5.0 * 9.81
    ((rise,),) = figures("is lifted by# mm", text)
    assert rise == pytest.approx(100.0, abs=0.1) and "\nmet: " in text


def test_a_flat_pyramid_is_not_picked_up(printed):
    text = printed("28_pick_up_by_tilting.py", "pyramid")
    assert text.count("every push on its free faces turns it down") == 4


@pytest.mark.slow
def test_fingers_regrasp_a_prism_in_form_closure(printed):
    text = printed("27_finger_gaiting.py")
    rows = re.findall(rf"({NUMBER}) to ({NUMBER}) s, (\w+) +away: closure margin ({NUMBER})", text)
    away = [who for _, _, who, _ in rows if who != "none"]
    assert away == [f"{face}_{side}" for face in "abc" for side in ("left", "right")]
    assert [who for _, _, who, _ in rows[::2]] == 7 * ["none"]
    assert all(float(margin) > 0.04 for *_, margin in rows)
    # nobody pulls; those that take hold begin with no force
    assert "pulled" not in text
    assert min(least for (least,) in figures("pushes of# N or more", text)) > -0.005
    ((gap,),) = figures("largest gap# m", text)
    assert gap < 1e-12
    ((begin, end),) = figures("the prism turned from# to# degrees", text)
    assert (begin, end) == pytest.approx((-30.0, 30.0), abs=0.01) and "\nmet: " in text


def test_the_table_of_the_fingers_is_the_one_that_the_example_writes():
    example = runpy.run_path(str(ROOT / "examples" / "27_finger_gaiting.py"))
    written = np.loadtxt(SCENES / "finger_gaiting.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(written, example["table"](), atol=2e-7)
    scene = ma.load_scene(SCENES / "finger_gaiting.yaml")
    for k, joint in enumerate(scene.joints[:6]):
        away = [
            example["FIRST"] + k * example["LOADED"] + example[s] for s in ("UNLOADED", "HOLDS")
        ]
        (_, lets_go), (takes_hold, _) = ((i.begin, i.end) for i in joint.intervals)
        assert [lets_go, takes_hold] == pytest.approx(away, abs=1e-9)
    assert scene.run.duration == pytest.approx(example["END"], abs=1e-9)


@pytest.mark.slow
def test_ten_lines_of_the_readme_print_what_it_says(workshop, capsys):
    match = re.search(r"^```python\n(.*?)^```\n\s*^```text\n(.*?)^```$", README, re.M | re.S)
    assert match is not None, "the README shows Python and right below what it prints"
    code, expected = match.groups()
    assert sum(bool(line.strip()) for line in code.splitlines()) <= 10
    exec(compile(code, "README.md", "exec"), {})
    assert_same_print(capsys.readouterr().out, expected)
    written = {path.name for path in workshop.iterdir() if path.is_file()}
    assert written == set(re.findall(r'"([\w.]+\.(?:h5|html))"', code))


def test_links_of_the_readme_lead_somewhere():
    targets = re.findall(r"\]\(([^)#]+)\)", README)
    local = [target for target in targets if "://" not in target]
    assert len(local) > 20 and [target for target in local if not (ROOT / target).exists()] == []


def test_pages_on_joints_control_and_methods_name_all_of_them():
    catalogue = {
        "how_to/joints.md": "multiarm joints",
        "how_to/control.md": "multiarm controls",
        "how_to/effects.md": "multiarm effects --list",
    }
    for page, command in catalogue.items():  # the build of the pages runs the command
        assert f"```{{command-output}} {command}\n" in (ROOT / "docs" / page).read_text(), page
    choosing = (ROOT / "docs" / "choosing.md").read_text(encoding="utf-8")
    names = [*ADAPTIVE_INTEGRATORS, *FIXED_STEP_INTEGRATORS]
    assert [name for name in names if choosing.count(f"| `{name}` |") < 1] == []


@pytest.mark.slow
def test_grip_by_friction_lifts_the_box_or_lets_it_slip(printed):
    text = printed("08_grip_by_friction.py")
    found = figures(r"mu = #: completed, lifted by# mm", text)
    assert [mu for mu, _ in found] == [0.6, 0.2]
    assert found[0][1] > 90.0 and found[1][1] < 30.0
    assert "lets go" in text and "slides" in text
    assert max(figures("energy balance# J", text))[0] < 1e-5
