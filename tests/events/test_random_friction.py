"""Claims about random scenes with friction: a sample of those that are judged every night."""

from __future__ import annotations

import numpy as np
import pytest
from friction_laws import CREATED, LAWS, judge_energy, judge_laws
from friction_oracle import Oracle
from friction_time_stepping import step_through
from judge_friction import beside_stepping, distance, judge_certificate
from random_friction_scenes import DOWN, FAMILIES, draw
from run_friction_scenes import PROVEN, simulate_table

from multiarm.errors import SolverError
from multiarm.scene import parse_scene

GRAVITY = -DOWN[2]
# Family, seed and accuracy.
RUNS = [
    ("thrown", 1, 1e-6), ("thrown", 3, 1e-6), ("thrown", 7, 1e-4), ("corner", 1, 1e-6),
    ("corner", 4, 1e-4), ("corner", 8, 1e-6), ("dry_joints", 2, 1e-6), ("dry_joints", 5, 1e-4),
    ("dry_joints", 19, 1e-4),  # a joint that turns back, and back again, within one step
    ("mixed", 37, 1e-4),  # redundant fingertips that rest, some of them with friction at its bound
    ("fingertips", 4, 1e-6), ("fingertips", 7, 1e-4), ("stack", 1, 1e-6), ("mixed", 1, 1e-6),
    ("fingertips", 5, 1e-6), ("fingertips", 9, 1e-6),
]  # fmt: skip
# Contacts stick and slip in turns here: events alone do not lead through.
CHATTERING = [
    ("fingertips", 6, 1e-6), ("fingertips", 9, 1e-4), ("stack", 5, 1e-4), ("stack", 9, 1e-4),
    ("mixed", 0, 1e-4), ("stack", 4, 1e-5), ("stack", 11, 1e-4),
]  # fmt: skip
DIRECTION, POWER = "friction not against slip", "friction power"


@pytest.mark.parametrize("family", FAMILIES)
def test_the_same_seed_draws_the_same_scene_and_it_can_be_read(family):
    for seed in range(5):
        table = draw(family, seed)
        assert table == draw(family, seed) != draw(family, seed + 1)
        parse_scene(table)


@pytest.mark.slow
@pytest.mark.parametrize(("family", "seed", "accuracy"), RUNS)
def test_a_run_completes_and_breaks_no_law_in_any_sample(family, seed, accuracy):
    table = draw(family, seed)
    trajectory = simulate_table(table, accuracy)
    assert trajectory.status == "completed", trajectory.message
    laws, energy = judge_laws(table, trajectory, accuracy), judge_energy(trajectory)
    broken = {law: value for law, value in laws.items() if value > LAWS}
    del energy["balance"]  # which has the errors of the integration
    created = {works: value for works, value in energy.items() if value > CREATED}
    assert not broken and not created


def test_a_box_that_begins_to_slide_is_also_between_steps_where_it_should_be():
    table, accuracy = draw("thrown", 3), 1e-4
    coarse, fine = (simulate_table(table, a) for a in (accuracy, 1e-7))
    assert [event["text"] for event in coarse.events] == [
        "floor: corner 5 slides", "floor: corner 7 slides",
    ]  # fmt: skip
    motion, reference = (next(iter(run.objects.values())) for run in (coarse, fine))
    np.testing.assert_allclose(motion.position, reference.position, rtol=0, atol=accuracy)
    np.testing.assert_allclose(motion.twist, reference.twist, rtol=0, atol=10.0 * accuracy)


@pytest.mark.slow
@pytest.mark.parametrize(("family", "seed", "accuracy"), CHATTERING)
def test_a_run_completes_whose_contacts_chatter(family, seed, accuracy):
    table = draw(family, seed)
    trajectory = simulate_table(table, accuracy)
    assert trajectory.status == "completed", trajectory.message
    laws = judge_laws(table, trajectory, accuracy)
    assert not {law: x for law, x in laws.items() if x > LAWS}


class _Changed:
    """A recorded run of which something is changed."""

    def __init__(self, trajectory, **changes):
        self._trajectory = trajectory
        vars(self).update(changes)

    def __getattr__(self, name):
        return getattr(self._trajectory, name)

    def __len__(self):
        return len(self._trajectory)


@pytest.fixture(scope="module")
def sliding():
    """A box that begins to slide on two of its corners, and its run."""
    table = draw("thrown", 3)
    return table, simulate_table(table, 1e-6)


def _with_forces(trajectory, change):
    forces = trajectory.contact_forces["floor"].copy()
    change(forces)
    return _Changed(trajectory, contact_forces={**trajectory.contact_forces, "floor": forces})


def _pull(forces):
    forces[:, 0::3] *= -1.0


def _outside(forces):
    forces[:, 1::3] *= 1.001
    forces[:, 2::3] *= 1.001


def _with_the_slip(forces):
    forces[:, 1::3] *= -1.0
    forces[:, 2::3] *= -1.0


@pytest.mark.parametrize(
    ("change", "laws"),
    [
        (_pull, {"pull", "cone"}),
        (_outside, {"cone"}),
        (_with_the_slip, {DIRECTION, POWER, "creeps"}),
    ],
)
def test_the_judge_sees_forces_that_break_a_law(sliding, change, laws):
    table, trajectory = sliding
    figures = judge_laws(table, _with_forces(trajectory, change), 0.0)
    assert all(figures[law] > 1e-5 for law in laws), figures


@pytest.mark.parametrize(("lift", "law"), [(-1e-8, "overlap"), (1e-8, "force at a gap")])
def test_the_judge_sees_a_box_that_is_not_where_its_forces_are(sliding, lift, law):
    table, trajectory = sliding
    name, motion = next(iter(trajectory.objects.items()))
    lifted = _Changed(motion, position=motion.position + [0.0, 0.0, lift])
    figures = judge_laws(table, _Changed(trajectory, objects={name: lifted}), 0.0)
    assert figures[law] == pytest.approx(1e-8, rel=1e-3)


@pytest.mark.slow
def test_the_judge_sees_dry_joints_with_another_friction():
    table = draw("dry_joints", 5)
    trajectory = simulate_table(table, 1e-4)
    friction = table["effects"]["joint_friction"]["torque"]
    friction["left"] = [1.001 * torque for torque in friction["left"]]
    assert judge_laws(table, trajectory, 1e-4)["dry torque not against the rate"] > 1e-5


def test_the_judge_sees_works_that_grow(sliding):
    _, trajectory = sliding
    works = {"effects/contact_friction/work": np.linspace(0.0, 1e-6, len(trajectory))}

    def channel(name):
        return works[name] if name in works else trajectory.channel(name)

    assert judge_energy(_Changed(trajectory, channel=channel))["contact_friction"] > CREATED


def test_a_rod_that_no_accelerations_are_possible_for_jams_or_is_refused_with_the_proof():
    table = draw("thrown", 4)
    jammed = simulate_table(table, 1e-6)
    assert jammed.status == "completed" and jammed.events[0]["kind"] == "jams"
    table["run"]["painleve"] = "stop"
    with pytest.raises(SolverError) as refused:
        simulate_table(table, 1e-6)
    assert PROVEN in str(refused.value)


# --- the time stepping ----------------------------------------------------------------------------


def _flat(speed: float, mu: float):
    table = draw("thrown", 0)
    box = {"shape": {"box": [0.4, 0.3, 0.2]}, "mass": 2.0, "pose": {"xyz": [0.0, 0.0, 0.1]}}
    table["objects"] = {"box": box | {"twist": [speed, 0.0, 0.0, 0.0, 0.0, 0.0]}}
    table["effects"]["floor"] = {"mu": mu}
    return table


def test_the_time_stepping_stops_a_sliding_box_where_coulomb_does():
    speed, mu, h = 0.5, 0.4, 5e-4
    stepped = step_through(Oracle(_flat(speed, mu)), 0.2, h)
    way = speed**2 / (2.0 * mu * GRAVITY)
    np.testing.assert_allclose(stepped.state.positions[0], [way, 0.0, 0.1], atol=speed * h)
    np.testing.assert_allclose(stepped.state.velocity, 0.0, atol=1e-9)
    assert stepped.residual < 1e-9


def test_errors_of_the_time_stepping_are_of_first_order(sliding):
    table, trajectory = sliding
    k = len(trajectory) // 2
    errors = [
        distance(trajectory, step_through(Oracle(table), float(trajectory.time[k]), h).state, k)
        for h in (4e-4, 2e-4, 1e-4)
    ]
    ratios = np.array(errors[:-1]) / errors[1:]
    np.testing.assert_allclose(ratios, 2.0, rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "seed", "h"),
    [
        ("thrown", 0, 1e-4),  # restitution with friction: halved
        ("corner", 4, 1e-4),
        ("dry_joints", 3, 2e-4),
        ("fingertips", 4, 2e-4),
    ],
)
def test_a_run_ends_where_the_time_stepping_does(family, seed, h):
    """It is late by a step at an impact, which changes speeds by up to 10 m/s or rad/s."""
    assert beside_stepping(draw(family, seed), 1e-6, h).apart < 10.0 * h


@pytest.mark.slow
@pytest.mark.parametrize(("family", "seed"), [("thrown", 1), ("corner", 1), ("dry_joints", 1)])
def test_no_certificate_is_false(family, seed):
    met, error = judge_certificate(family, seed)
    assert met and error < 1e-4
