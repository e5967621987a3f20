"""Claims about loops within one robot: the linkages of the IFToMM library of multibody benchmarks.

Oracles: motions in closed form (``multiarm.problems.linkages``), and the reference solution of the
Test Set for Initial Value Problem Solvers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from linkage_robots import (
    ROBOT,
    Squeezer,
    bricard_robot_scene,
    four_bars_scene,
    link_of,
    slider_crank_scene,
    slider_motion,
    squeezer_scene,
)

import multiarm as ma
from multiarm.problems.linkages import BRICARD_BASES
from multiarm.problems.loops import bricard_motion, parallelogram_motion
from multiarm.scene import parse_scene

# Of the cranks, as in benchmark A02.
UPRIGHT, SPEED = 0.5 * np.pi, -1.0  # [rad], [rad/s]
ACCURACY = 1e-8  # of the runs; what is demanded of them is ten times that


def run_of(
    scene: dict[str, Any], duration: float, **how: Any
) -> tuple[ma.Trajectory, dict[str, np.ndarray]]:
    """The run, and positions of the joints by the links that they move."""
    system = ma.compile_system(parse_scene(scene))
    run = ma.simulate(system, duration, **(how or {"accuracy": ACCURACY}))
    assert run.status == "completed", run.message
    assert np.max(run.position_drift) < 1e-10
    names, positions = system.arms[ROBOT].joint_names, run.joint_positions[ROBOT].T
    return run, {link_of(name): q for name, q in zip(names, positions, strict=True)}


@pytest.mark.parametrize("loops", [1, 4])
def test_parallelograms_side_by_side_swing_as_one(loops, tmp_path):
    """Every loop but the first repeats three of five equations of its hinge, as the first does."""
    run, joints = run_of(four_bars_scene(tmp_path / "four_bars.urdf", loops, UPRIGHT, SPEED), 1.5)
    motion = parallelogram_motion(loops + 1)
    angle = motion.motion(UPRIGHT, SPEED, run.time)
    assert np.ptp(angle) > 1.0
    for k in range(loops + 1):
        np.testing.assert_allclose(joints[f"crank_{k}"], angle, atol=10.0 * ACCURACY)
    np.testing.assert_allclose(run.rank, 6 + 2 * loops)


def test_parallelograms_pass_their_flat_positions(tmp_path):
    """All links lie on a line there, and motions cross: the velocity says which one is followed."""
    run, joints = run_of(four_bars_scene(tmp_path / "four_bars.urdf", 2, UPRIGHT, SPEED), 10.0)
    angle = parallelogram_motion(3).motion(UPRIGHT, SPEED, run.time)
    assert np.min(angle) < -8.0 * np.pi
    for k in range(3):
        np.testing.assert_allclose(joints[f"crank_{k}"], angle, atol=1e-7)


def test_a_slider_passes_both_dead_centres_of_its_crank(tmp_path):
    start, rate = 1.0, 9.0
    run, joints = run_of(slider_crank_scene(tmp_path / "slider.urdf", start, rate), 1.0)
    angle = slider_motion().motion(start, rate, run.time)
    assert np.ptp(angle) > 2.0 * np.pi
    np.testing.assert_allclose(joints["crank"], angle, atol=10.0 * ACCURACY)
    slider = slider_motion().centres(2, angle)[:, 0]
    np.testing.assert_allclose(joints["slider"], slider, atol=10.0 * ACCURACY)


def test_bricards_loop_moves_on_its_curve(tmp_path):
    """Six hinges leave no freedom by count; one equation repeats the others everywhere."""
    run, joints = run_of(bricard_robot_scene(tmp_path / "bricard.urdf"), 2.0)
    motion = bricard_motion()
    s = motion.motion(0.0, 0.0, run.time)
    assert np.ptp(s) > 1.0
    first = [motion.poses(complex(x))[0][1].real for x in s]
    turns = np.unwrap([np.arctan2(*(BRICARD_BASES[0].T @ R)[[1, 0], 0]) for R in first])
    np.testing.assert_allclose(joints["rod_1"], turns, atol=10.0 * ACCURACY)
    np.testing.assert_allclose(run.rank, 6 + 4)


# --- Andrews' squeezing mechanism ----------------------------------------------------------------


def test_the_squeezer_starts_with_the_accelerations_of_the_test_set(tmp_path):
    squeezer, scene = Squeezer(), squeezer_scene(tmp_path / "squeezer.urdf")
    system = ma.compile_system(parse_scene(scene))
    links = map(link_of, system.arms[ROBOT].joint_names)
    found = dict(zip(links, ma.evaluate(system).joint_accelerations[ROBOT], strict=True))
    size = max(np.abs(squeezer.accelerations))
    for link, expected in zip(squeezer.links, squeezer.accelerations, strict=True):
        assert found[link] == pytest.approx(expected, abs=1e-10 * size)


@pytest.mark.slow
def test_the_squeezer_ends_where_the_test_set_says(tmp_path):
    squeezer, scene = Squeezer(), squeezer_scene(tmp_path / "squeezer.urdf")
    system = ma.compile_system(parse_scene(scene))
    links = [link_of(name) for name in system.arms[ROBOT].joint_names]

    def torques(t: float, state: ma.State) -> dict[str, list[float]]:
        gamma = state.joint_positions[ROBOT][links.index("K3")]
        acting = squeezer.torques(gamma)
        return {ROBOT: [acting.get(link, 0.0) for link in links]}

    how = {"integrator": "dop853", "tolerance": 1e-11, "control": torques}
    _, joints = run_of(scene, squeezer.duration, **how)
    for link, expected in zip(squeezer.links, squeezer.end, strict=True):
        assert joints[link][-1] == pytest.approx(expected, abs=1e-8), link
