"""Claims about the study of accuracy: its reference, its points, its ladders, its peers."""

from __future__ import annotations

import importlib.util
import itertools
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pandas
import pytest
from mechanics import single_arm, ur5_pair
from repository import SCENES
from scipy.spatial.transform import Rotation
from study_samples import no_samples

import multiarm as ma
from multiarm.errors import MultiarmError
from multiarm.problems import HARD_CASES, ring_of_arms
from multiarm.results.outcome import Outcome
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.comparison import rotation_apart, sample_state
from multiarm.studies import reference as references
from multiarm.studies import work_precision as studies
from multiarm.studies.differences import open_forces
from multiarm.studies.mujoco_peer import TorqueTape
from multiarm.studies.peers import (
    NOT_INSTALLED,
    PEERS,
    Clock,
    Grid,
    Sample,
    control_torque,
    make_peers,
    sinusoid,
)
from multiarm.studies.reference import Motion, Reference, digits_of, make_reference
from multiarm.studies.settings import (
    BY_ACCURACY,
    COARSEST,
    OURS,
    Setting,
    halved_steps,
    our_ladders,
)
from multiarm.studies.timing import OutOfTime, clocked_run
from multiarm.studies.work_precision import (
    COMPLETED,
    FAILED,
    LEVELS,
    STALE,
    TOO_SLOW,
    Point,
    Study,
    decades,
    run_ours,
    run_peer,
    run_study,
)
from multiarm.studies.work_precision_page import recommendation
from multiarm.tableaus import ADAPTIVE_INTEGRATORS, FIXED_STEP_INTEGRATORS

MUJOCO_IS_HERE = importlib.util.find_spec("mujoco") is not None


def ring(kind: str = "weld", duration: float = 0.1):
    return ring_of_arms(2, kind, duration=duration)


@pytest.fixture(scope="module")
def system():
    return ma.compile_system(ring())


@pytest.fixture(scope="module")
def reference(system) -> Reference:
    return make_reference(system)


def setting(value: float, method="rk4", kind="projection", knob="step", solver=OURS) -> Setting:
    return Setting(solver, method, kind, knob, value)


def point(wall: float, error: float, **more) -> Point:
    errors = {"position": error, "rotation": error / 2, "joints": error / 3, "force": 10 * error}
    about = setting(more.pop("value", wall), **more)
    return Point(about, COMPLETED, wall_time_s=wall, steps=1, evaluations=4, errors=errors)


def study_of(points, digits: float = 1e-13, accuracy: float = 1e-6) -> Study:
    """A study of the ring scene with these points."""
    study = Study.of(ring_of_arms(2, duration=1.0, accuracy=accuracy))
    quantities = dict.fromkeys(("motion", "position", "rotation", "joints", "force"), digits)
    about = {"integrator": "dop853", "tolerance": 1e-14, "check": {}}
    study.reference = Reference(no_samples(), {}, quantities, 0.01, 0.01, about)
    study.points = {item.setting.key: item for item in points}
    return study


class Shifted:
    """The samples of a run, with some channels shifted."""

    path = None

    def __init__(self, run: Trajectory, shifts):
        self.run, self.shifts = run, shifts
        self.samples, self.channels, self.metadata = len(run), dict(run.channels), run.provenance

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        shift = np.broadcast_to(
            self.shifts.get(name, 0.0), (self.samples, *self.channels[name].shape)
        )
        return self.run.read(name, start, stop) + shift[start:stop]

    def trajectory(self) -> Trajectory:
        return Trajectory(self, Outcome("completed", ""))


def measure_ours(system, about: Setting, reference: Reference, limit_s: float) -> Point:
    return run_ours(system, about, limit_s).judged(reference)


# --- the reference --------------------------------------------------------------------------------


@pytest.mark.slow
def test_digits_are_what_another_method_and_the_dense_solver_differ_by(system, reference):
    check = reference.about["check"]
    assert check["solver"] == "dense"
    assert check["integrator"] != reference.about["integrator"]
    run = ma.simulate(
        system, solver="dense", integrator=check["integrator"], tolerance=check["tolerance"],
        stabilization="projection",
    )  # fmt: skip
    differ = reference.errors(run)
    assert {name: reference.digits[name] for name in differ} == differ
    assert reference.digits["motion"] == max(differ[k] for k in ("position", "rotation", "joints"))
    # roundings of a tenth of a second in a system of some metres and some hundred newtons
    assert reference.digits["motion"] < 1e-12
    assert reference.digits["force"] < 1e-10


@pytest.mark.slow
def test_a_wrong_solver_would_show_in_the_digits(system, reference, monkeypatch):
    heavier = ma.compile_system(ring().replace(gravity=[0.0, 0.0, -9.8101]))

    def wrong(system, limit_s, **options):
        dense = options["solver"] == "dense"
        return clocked_run(heavier if dense else system, limit_s, **options)

    monkeypatch.setattr(references, "clocked_run", wrong)
    digits = make_reference(system).digits
    # holding torques follow the weight: what differs are roundings of nothing but the sinusoids
    assert digits["force"] == pytest.approx(1e-4 * 5.0, rel=10.0)
    assert digits["force"] > 1e6 * reference.digits["force"]


def test_a_scene_that_cannot_run_has_no_reference(system, monkeypatch):
    monkeypatch.setattr(references, "PATIENCE", 0.0)
    with pytest.raises(MultiarmError, match="no reference to compare with: dop853 takes longer"):
        make_reference(system)


# --- errors ---------------------------------------------------------------------------------------


def test_errors_of_a_point_are_those_between_two_trajectories(system, reference):
    about = setting(0.01, kind="none")
    found = measure_ours(system, about, reference, 10.0)
    run = ma.simulate(system, integrator="rk4", step=0.01, stabilization="none")
    exact = ma.simulate(
        system, integrator=reference.about["integrator"], tolerance=reference.about["tolerance"]
    )
    turned = Rotation.from_quat(exact.object_quaternion_xyzw).inv() * Rotation.from_quat(
        run.object_quaternion_xyzw
    )
    off = np.linalg.norm(run.object_position - exact.object_position, axis=1)
    expected = {
        "position": off.max(),
        "rotation": turned.magnitude().max(),
        "joints": max(
            np.abs(run.joint_positions[arm] - exact.joint_positions[arm]).max()
            for arm in run.arm_names
        ),
        "force": max(
            np.abs(run.contact_forces[arm] - exact.contact_forces[arm]).max()
            for arm in run.arm_names
        ),
    }
    # SciPy's angles of small rotations are right to 1e-16
    assert found.errors == pytest.approx(expected, rel=1e-6, abs=1e-15)
    assert found.error("motion") == max(found.errors[k] for k in ("position", "rotation", "joints"))
    assert found.gap_m == run.position_drift.max() > 1e-12
    assert found.gap_rate_m_per_s == run.velocity_drift.max()
    assert found.energy_J == np.abs(run.energy_balance).max()
    assert (found.steps, found.evaluations) == (10, run.statistics["evaluations"])


def test_errors_are_those_at_the_worst_time(system):
    exact = ma.simulate(system)
    left, right = exact.arm_names
    place, joint, force = (np.zeros((len(exact), width)) for width in (3, 6, 6))
    place[2], joint[3, 1], force[4, 5] = [3.0, 0.0, 4.0], -2.0, 9.0
    run = Shifted(
        exact,
        {
            "object/position": place,
            f"arms/{right}/joint_position": joint,
            f"arms/{left}/contact_force": force,
        },
    ).trajectory()
    errors = Reference(exact, {}, {}, 0.0, 0.0).errors(run)
    assert errors == pytest.approx({"position": 5.0, "rotation": 0.0, "joints": 2.0, "force": 9.0})


def test_errors_of_a_peer_are_those_of_a_run_with_its_motion(system, reference):
    run = ma.simulate(system, integrator="rk4", step=0.01)
    joints = [run.joint_positions[arm] for arm in run.arm_names]
    motion = np.column_stack([run.object_position, run.object_quaternion_xyzw, *joints])
    motion[::2, 3:7] *= -1.0  # the same rotations
    assert reference.errors(Motion(motion)) == {**reference.errors(run), "force": None}


def test_forces_that_the_equations_leave_open_are_neither_digits_nor_errors():
    scene = HARD_CASES["two_joint_arms"].scene()
    arms = ma.compile_system(scene.replace(run={"duration": 0.02, "output_step": 0.01}))
    exact = ma.simulate(arms)
    undetermined = open_forces(arms, exact)
    reference = Reference(exact, undetermined, {}, 0.0, 0.0)
    for arm in exact.arm_names:
        assert undetermined[arm].any()
        assert not undetermined[arm].all()
    for selected, error in ((undetermined, 0.0), ({a: ~x for a, x in undetermined.items()}, 5.0)):
        shifts = {f"arms/{arm}/contact_force": 5.0 * flags for arm, flags in selected.items()}
        run = Shifted(exact, shifts).trajectory()
        assert reference.errors(run)["force"] == pytest.approx(error)
        assert digits_of(run, exact, undetermined)["force"] == pytest.approx(error)


# --- settings and ladders -------------------------------------------------------------------------


def test_every_integrator_is_studied_with_each_stabilisation():
    ladders = our_ladders(0.01, 1.0, 0.005)
    methods = {ladder[0].method for ladder in ladders}
    assert methods == {BY_ACCURACY, *ADAPTIVE_INTEGRATORS, *FIXED_STEP_INTEGRATORS}
    kinds = {x[0].stabilization for x in ladders if x[0].method == "dop853"}
    assert kinds == {"projection", "feedback", "none"}
    keys = [item.key for ladder in ladders for item in ladder]
    assert len(set(keys)) == len(keys)
    for ladder in ladders:
        values = [item.value for item in ladder]
        assert values == sorted(values, reverse=True)
        assert len({item.series for item in ladder}) == 1


@pytest.mark.parametrize(("output_step", "coarsest"), [(0.01, 0.04), (0.01, 0.003), (0.25, 0.2)])
def test_fixed_steps_are_halved_from_the_coarsest_and_meet_the_outputs(output_step, coarsest):
    steps = halved_steps(output_step, coarsest)
    assert coarsest / 2.0 < steps[0] <= coarsest
    assert [a / b for a, b in itertools.pairwise(steps)] == [2.0] * (len(steps) - 1)
    for step in steps:
        ratio = output_step / step
        assert ratio == round(ratio) or 1.0 / ratio == round(1.0 / ratio)


def test_fixed_steps_follow_from_the_references_own():
    slow, fast = (our_ladders(0.01, 1.0, average)[-1][0] for average in (1e-2, 1e-4))
    assert slow.value <= COARSEST * 1e-2 < 2.0 * slow.value
    assert fast.value <= COARSEST * 1e-4 < 2.0 * fast.value


def test_failing_settings_are_points_with_a_reason(system, reference):
    lost = measure_ours(system, setting(1e-18, "dop853", "feedback", "tolerance"), reference, 10.0)
    assert (lost.status, lost.wall_time_s, lost.error("motion")) == (FAILED, None, None)
    assert "the step became too small" in lost.message
    wrong = measure_ours(system, setting(0.5), reference, 10.0)
    assert wrong.status == FAILED
    assert "longer than the run" in wrong.message
    late = measure_ours(system, setting(1e-6), reference, 0.02)
    assert (late.status, late.message) == (TOO_SLOW, "not done after 0.02 s")


# --- the study ------------------------------------------------------------------------------------


class Law:
    """Makes points by a law instead of runs, and counts them; nothing runs by accuracy."""

    def __init__(self, order: float = 4.0, floor: float = 0.0, seconds: float = 1e-4):
        self.order, self.floor, self.seconds = order, floor, seconds
        self.runs: list[Setting] = []

    def __call__(self, system, about: Setting, limit_s: float) -> Point:
        if about.method == BY_ACCURACY:
            return Point(about, FAILED, "not by accuracy")
        self.runs.append(about)
        error = max(about.value**self.order, self.floor)
        found = point(self.seconds / about.value, error)
        return replace(found, setting=about)


@pytest.fixture
def fast_study(monkeypatch, system, reference):
    """A study of one ladder of Runge-Kutta steps whose points follow a law."""

    def run(law, **options) -> Study:
        ladder = [our_ladders(0.01, 0.1, 0.005)[-1]]
        instant = replace(reference, wall_time_s=0.0)
        monkeypatch.setattr(studies, "make_reference", lambda *_: instant)
        monkeypatch.setattr(studies, "our_ladders", lambda *_: ladder)
        monkeypatch.setattr(studies, "run_ours", law)
        for study in run_study(system.scene, peers=False, **options):
            assert not study.table.empty, "what is shown has a point"
        assert study.finished
        return study

    return run


def values(study: Study) -> list[float]:
    return sorted((item.setting.value for item in study.points.values()), reverse=True)


def halvings(study: Study) -> list[int]:
    """How often the first step was halved for each setting."""
    found = values(study)
    return [round(math.log2(found[0] / value)) for value in found]


def test_a_ladder_ends_in_the_digits_of_the_reference(fast_study, reference):
    results = fast_study(Law(seconds=1e-9))
    places, digits = halvings(results), reference.digits["motion"]
    reached = next(k for k in places if (values(results)[0] / 2**k) ** 4 <= digits)
    assert places[: reached + 1] == list(range(reached + 1))
    assert places[-1] < reached + studies.STRIDES[0]


def test_a_ladder_ends_when_errors_no_longer_fall(fast_study):
    results = fast_study(Law(floor=1e-6, seconds=1e-9))
    places = halvings(results)
    reached = next(k for k in places if (values(results)[0] / 2**k) ** 4 <= 1e-6)
    assert places[: reached + STALE + 1] == list(range(reached + STALE + 1))
    assert places[-1] < reached + STALE + studies.STRIDES[0]


def test_a_ladder_ends_before_runs_take_too_long(fast_study):
    results = fast_study(Law(order=1.0, seconds=0.003))
    last = min(values(results))
    assert 0.003 / last <= studies.LEAST_PATIENCE < 2 * 0.003 / (last / 2)


def test_an_accident_at_the_first_setting_does_not_end_a_ladder(fast_study):
    law = Law(seconds=1e-9)

    def stalled_once(system, about, limit_s):
        found = law(system, about, limit_s)
        return studies.too_slow(about, limit_s) if len(law.runs) == 1 else found

    assert list(fast_study(stalled_once).points) == list(fast_study(Law(seconds=1e-9)).points)


def test_quick_settings_are_repeated_and_slow_ones_are_not(fast_study):
    law = Law(order=1.0, seconds=0.003)
    results = fast_study(law)
    for place, item in zip(halvings(results), results.points.values(), strict=False):
        wall = 0.003 / item.setting.value
        assert item.repeats == law.runs.count(item.setting)
        expected = min(studies.REPEATS, max(1, int(studies.REPEAT_BUDGET / wall + 1e-9)))
        assert item.repeats == (expected if place else max(2, expected))


def test_the_fastest_run_counts(fast_study):
    times = itertools.count()

    def law(system, about, limit_s):
        return replace(point(0.01 / (2 + next(times) % 5), 1e-20), setting=about)

    results = fast_study(law)
    (found,) = results.points.values()
    assert (found.repeats, found.wall_time_s) == (studies.REPEATS, 0.01 / 6)


def test_every_fourth_setting_comes_first_and_half_of_them_are_quick(fast_study):
    order = [item.setting.value for item in fast_study(Law(seconds=1e-9)).points.values()]
    places = [round(math.log2(max(order) / value)) for value in order]
    strides = [next(s for s in studies.STRIDES if place % s == 0) for place in places]
    assert strides == sorted(strides, reverse=True)
    quick = fast_study(Law(seconds=1e-9), quick=True)
    assert all(place % 2 == 0 for place in halvings(quick))
    assert {item.repeats for item in quick.points.values()} == {studies.QUICK_REPEATS}


# --- stages of a study, by a clock that only runs advance -----------------------------------------

DIGITS = {"motion": 1e-12, "position": 1e-12, "rotation": 1e-12, "joints": 1e-12, "force": 1e-9}
exact_run = cache(ma.simulate)


def random_costs(seed: int) -> dict[str, tuple[float, float]]:
    """Method -> order and cost of its coarsest run."""
    rng = np.random.default_rng(seed)
    names = {ladder[0].series for ladder in our_ladders(0.01, 0.1, 0.005)}
    return {name: (rng.uniform(0.5, 6.0), rng.uniform(0.005, 0.1)) for name in sorted(names)}


class World:
    """Runs that follow laws: errors fall and costs rise along each ladder.

    Every run advances the clock by its cost; one of them, by its number, may be interrupted.
    """

    def __init__(self, seed: int, interrupt_at: int | None = None):
        self.now, self.seed, self.runs, self.calls = 0.0, seed, [], 0
        self.interrupt_at = interrupt_at
        self.costs = random_costs(seed)
        ladders = our_ladders(0.01, 0.1, 0.005)
        self.places = {s.key: k for ladder in ladders for k, s in enumerate(ladder)}

    def call(self, seconds: float) -> None:
        self.calls += 1
        if self.calls == self.interrupt_at:
            raise KeyboardInterrupt
        self.now += seconds

    def run(self, system, about: Setting, limit_s: float) -> Point:
        order, cost = self.costs[about.series]
        place = self.places[about.key]
        rng = np.random.default_rng([self.seed, *about.key.encode()])
        wall, luck = cost * 1.6**place * rng.uniform(0.9, 1.1), rng.uniform(0.8, 1.25)
        self.call(min(wall, limit_s))
        self.runs.append(about.key)
        if wall > limit_s:
            return studies.too_slow(about, limit_s)
        error = max(0.1 * 2.0 ** (-order * place), 1e-14) * luck
        exact = exact_run(system)
        shifts = {f"arms/{arm}/contact_force": 100.0 * error for arm in exact.arm_names}
        shifts["object/position"] = error * np.array([1.0, 0.0, 0.0])
        return Point(
            about, COMPLETED, wall_time_s=wall, steps=10, evaluations=40, used="dop853",
            course=Shifted(exact, shifts).trajectory(),
        )  # fmt: skip

    def reference(self, system, _report) -> Reference:
        self.call(60.0)
        about = {"integrator": "dop853", "tolerance": 1e-14, "check": {}}
        return Reference(exact_run(system), {}, DIGITS, 0.005, 1.0, about)


@pytest.fixture
def study_in(monkeypatch, system):
    """Runs a study in a world; keeps the system, and its peers away."""

    def run(world: World) -> Iterator[Study]:
        monkeypatch.setattr(studies, "clock", lambda: world.now)
        monkeypatch.setattr(studies, "run_ours", world.run)
        monkeypatch.setattr(studies, "make_reference", world.reference)
        monkeypatch.setattr(studies, "compile_system", lambda _scene: system)
        return run_study(system.scene, peers=False)

    return run


@pytest.mark.slow
def test_first_results_come_soon_and_claim_no_error_below_their_uncertainty(study_in):
    world = World(3)
    course = study_in(world)
    study = next(course)
    when, first, planned = world.now, study.reference, study.planned
    errors = {key: item.error("motion") for key, item in study.points.items()}
    assert when < studies.FIRST_RESULTS + studies.LEAST_PATIENCE
    assert first.first
    assert first.digits["motion"] > 0.0
    assert {Setting(*key.split("/")[:3], "", 0.0).series for key in errors} == set(world.costs)
    assert planned > len(errors)
    next(course)
    assert world.now >= when + 60.0, "the reference takes its time"
    assert not study.reference.first
    # each run's error is what its law says, once the full reference is there
    for key, before in errors.items():
        after = study.points[key].error("motion")
        assert after > 0.0
        assert abs(before - after) <= 3.0 * first.digits["motion"]
    assert [step.finished for step in course][-1]


@pytest.mark.slow
def test_the_first_of_all_runs_by_accuracy_are_shown_of_a_slow_scene(study_in):
    world = World(0)
    world.costs = {name: (order, 1.0) for name, (order, _) in world.costs.items()}
    study = next(study_in(world))
    assert world.now < 20.0
    assert len(study.points) >= 2


@pytest.mark.parametrize("part", [0.01, 0.9])
def test_an_interrupted_study_has_what_was_measured(study_in, part):
    whole = World(1)
    *_, finished = study_in(whole)
    world, states = World(1, interrupt_at=1 + int(part * whole.calls)), []
    with pytest.raises(KeyboardInterrupt):
        states.extend(study_in(world))
    assert (states == []) == (part == 0.01), "nothing to show before the first results"
    if states:
        study = states[-1]
        assert not study.finished and study.left_out and not finished.left_out
        assert set(study.points) <= set(finished.points)


# --- what is cheapest -----------------------------------------------------------------------------


@pytest.mark.slow
def test_the_cheapest_of_each_decade_is_that_of_brute_force():
    rng = np.random.default_rng(3)
    for _ in range(15):
        digits = 10.0 ** rng.uniform(-12, -8)
        points = [
            replace(
                point(wall, 10.0 ** rng.uniform(-12, 0), value=k + 1.0),
                setting=setting(k + 1.0, solver=OURS if k % 3 else "Drake"),
                status=COMPLETED if rng.uniform() < 0.8 else FAILED,
            )
            for k, wall in enumerate(rng.uniform(0.1, 1.0, size=12))
        ]
        found = {row.level: row for row in decades(study_of(points, digits), "motion").itertuples()}
        for level in LEVELS:
            able = [
                item
                for item in points
                if item.status == COMPLETED and item.errors["position"] <= level - digits
            ]
            ours = [item for item in able if item.setting.solver == OURS]
            peers = [item for item in able if item.setting.solver != OURS]
            if level <= digits or not able:
                assert level not in found
                continue
            best = [min(x, key=lambda p: p.wall_time_s, default=None) for x in (ours, peers)]
            keys = [None if item is None else item.setting.key for item in best]
            row = found[level]
            assert [*pandas.Series([row.key, row.key_peer]).replace({np.nan: None})] == keys
            if all(best):
                assert row.peer_over_ours == best[1].wall_time_s / best[0].wall_time_s


def test_the_recommendation_says_what_to_take_and_what_more_costs():
    by_accuracy = setting(1e-5, BY_ACCURACY, "", "accuracy")
    first = replace(point(3.1e-3, 5e-7), setting=by_accuracy, used="dop853")
    second = point(6.2e-3, 5e-10, method="dop853", kind="none", knob="tolerance")
    assert recommendation(study_of([first, second])) == (
        "For errors below 1e-6 take accuracy 1e-5 (dop853, projection): 3.1 ms for 1 s of motion; "
        "1e-9 costs 2 times that."
    )
    assert second.setting.advice("") == "tolerance 0.0062 (dop853, no stabilization)"


def test_each_quantity_has_the_scenes_own_aim():
    run = {"duration": 0.1, "accuracy": {"position": 1e-4, "rotation": 1e-5, "force": 1e-2}}
    assert Study.of(ring().replace(run=run)).scene["accuracy"] == {
        "motion": 1e-5, "position": 1e-4, "rotation": 1e-5, "joints": 1e-5, "force": 1e-2,
    }  # fmt: skip


# --- peers ----------------------------------------------------------------------------------------


def only(name: str) -> dict[str, str]:
    """One of the peers."""
    return {name: PEERS[name]}


def course_of(
    peers, solver: str, method: str, value: float, reference, system, limit_s: float = 60.0
) -> Point:
    about = Setting(solver, method, "", peers[solver].methods[method], value)
    return run_peer(system, peers[solver], about, limit_s).judged(reference)


@pytest.fixture(scope="module", params=["weld", "ball", "revolute"])
def trial(request):
    """A system, its reference and its peers, for each joint that peers have."""
    own = ma.compile_system(ring(request.param))
    return own, make_reference(own), make_peers(own)[0]


@pytest.mark.slow
def test_pinocchio_converges_to_the_reference(trial):
    own, reference, peers = trial
    fine = course_of(peers, "Pinocchio", "SciPy DOP853", 1e-12, reference, own)
    # a tolerance of a step, over some ten steps
    assert fine.status == COMPLETED, fine.message
    assert fine.error("motion") < 1e-11
    assert fine.gap_m < 1e-11
    coarse = [course_of(peers, "Pinocchio", "RK4", h, reference, own) for h in (2.5e-3, 1.25e-3)]
    order = math.log2(coarse[0].error("motion") / coarse[1].error("motion"))
    assert order == pytest.approx(4.0, abs=0.2)
    assert [item.evaluations for item in coarse] == [160, 320]


@pytest.mark.slow
def test_pinocchios_coordinates_of_a_moving_state_lead_back_to_it(trial):
    own, _, peers = trial
    run, peer = ma.simulate(own), peers["Pinocchio"]
    state = sample_state(own.model.layout, run, len(run) - 1)
    again = peer.state(peer.coordinates(state))
    assert np.max(np.abs(state.object_twist)) > 1e-2
    closed = 1e-9  # [m, m/s] what projection leaves of gaps, of which the object's pose follows
    turned = rotation_apart(again.position[None, 3:7], state.position[None, 3:7])
    assert np.max(np.abs(again.object_position - state.object_position)) < closed
    assert np.max(turned) < closed
    assert np.array_equal(again.position[7:], state.position[7:])
    assert np.max(np.abs(again.velocity - state.velocity)) < closed


@pytest.mark.slow
def test_mujoco_at_its_best_converges_to_the_reference_and_as_shipped_does_not(trial):
    own, reference, peers = trial
    if not MUJOCO_IS_HERE:
        assert make_peers(own, only("MuJoCo")) == ({}, {"MuJoCo": NOT_INSTALLED})
        return
    coarse = [course_of(peers, "MuJoCo", "RK4", h, reference, own) for h in (5e-3, 2.5e-3)]
    order = math.log2(coarse[0].error("motion") / coarse[1].error("motion"))
    assert order > 3.5
    assert coarse[1].error("motion") < 1e-6
    euler = [course_of(peers, "MuJoCo", "Euler", h, reference, own) for h in (5e-3, 2.5e-3)]
    assert euler[0].error("motion") / euler[1].error("motion") == pytest.approx(2.0, rel=0.2)
    soft = course_of(peers, "MuJoCo as shipped", "RK4", 2.5e-3, reference, own)
    assert soft.error("motion") > 100.0 * coarse[1].error("motion")
    assert soft.gap_m > 1e-6 > coarse[1].gap_m


@pytest.mark.slow
def test_peers_follow_a_feedback_controller_and_damping():
    control = {"kind": "joint_pd", "stiffness": 100, "damping": 1,
               "path": [{"time": 0.1, "xyz": [0, 0, 0.51]}]}  # fmt: skip
    scene = ur5_pair(
        {"kind": "weld"}, {"kind": "ball"}, control=control, effects={"joint_damping": 3.0},
        run={"duration": 0.1},
    )  # fmt: skip
    own = ma.compile_system(scene)
    assert sinusoid(own) is None
    reference, (peers, _) = make_reference(own), make_peers(own)
    allowed = {("Pinocchio", "SciPy DOP853", 1e-10): 1e-8}
    if MUJOCO_IS_HERE:
        allowed["MuJoCo", "RK4", 2.5e-3] = 1e-5
    for (solver, method, value), bound in allowed.items():
        found = course_of(peers, solver, method, value, reference, own)
        assert found.error("motion") < bound, solver


@pytest.mark.slow
def test_pinocchio_follows_joints_that_turn_without_end():
    scene = single_arm(
        "kinova", "j2s6s200_end_effector", [1.0, 2.5, 1.5, 0.3, 0.4, 0.5], {"kind": "ball"},
        run={"duration": 0.1},
    )  # fmt: skip
    own = ma.compile_system(scene)
    peers, _ = make_peers(own, only("Pinocchio"))
    found = course_of(peers, "Pinocchio", "SciPy DOP853", 1e-12, make_reference(own), own)
    assert found.error("motion") < 1e-10, found.message


def test_a_scene_that_peers_cannot_express_names_them_with_the_reason():
    system = ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "point_on_plane"}))
    able, refusals = make_peers(system)
    assert able == {}
    assert set(refusals) == set(PEERS)
    missing = {"MuJoCo": MUJOCO_IS_HERE}
    for solver, reason in refusals.items():
        here = missing.get(solver.split()[0], True)
        assert ("point_on_plane" in reason) == here
        assert reason.startswith("cannot express it: ") == here


def test_effects_that_no_peer_has_are_named():
    dragged = ring().replace(effects={"drag": {"quadratic": 0.5}, "joint_damping": 1.0})
    able, refusals = make_peers(ma.compile_system(dragged))
    assert able == {}
    assert refusals == dict.fromkeys(PEERS, "cannot express drag")


def test_joints_in_time_are_refused_for_the_peers():
    able, refusals = make_peers(ma.compile_system(ring().replace({"joints[0].until": 0.5})))
    assert able == {}
    assert set(refusals) == set(PEERS)


def test_peers_that_are_not_installed_are_told_so(system, monkeypatch):
    monkeypatch.delitem(sys.modules, "multiarm.studies.mujoco_peer", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    able, refusals = make_peers(system)
    assert set(able) == {"Pinocchio"}
    assert set(refusals.values()) == {"not installed: pip install mujoco"}


def test_what_a_peer_raises_is_a_failed_point(system, reference):
    peers, _ = make_peers(system, only("Pinocchio"))

    def broken(*_):
        raise RuntimeError("the tree is broken\nsecond line")

    peers["Pinocchio"].follow = broken
    found = course_of(peers, "Pinocchio", "RK4", 0.01, reference, system)
    assert (found.status, found.message) == (FAILED, "RuntimeError: the tree is broken")


def test_a_peer_that_diverges_or_takes_too_long_is_a_point_too(system, reference):
    peers, _ = make_peers(system, only("Pinocchio"))
    late = course_of(peers, "Pinocchio", "RK4", 1e-5, reference, system, limit_s=0.02)
    assert late.status == TOO_SLOW

    def diverging(_clock, grid, start, *_):
        lost = start.copy()
        lost.velocity[:] = np.inf
        for k, state in enumerate((start, start, lost, start)):
            yield Sample(k * grid.interval, state)

    peers["Pinocchio"].follow = diverging
    found = course_of(peers, "Pinocchio", "RK4", 0.01, reference, system)
    assert found.message == "the state is no longer finite after 0.01 s"


def test_sinusoidal_torques_are_the_scenes(system):
    found = sinusoid(system)
    state = system.initial_state()
    for t in (0.0, 0.013, 0.4):
        expected = control_torque(system, t, state)
        assert found.at(np.array([t]))[0] == pytest.approx(expected, abs=1e-12)
        assert found(t) == pytest.approx(expected, abs=1e-12)


def test_a_tape_plays_row_by_row_and_stays_at_its_end():
    target = np.zeros(3)
    tape = TorqueTape(target)
    rows = np.arange(6.0).reshape(2, 3)
    tape.load(rows)
    for row in (0, 1, 1):
        tape.play(0, 0)
        assert target.tolist() == rows[row].tolist()


@pytest.mark.slow
def test_mujoco_asks_for_torques_at_the_times_that_are_on_the_tape(system):
    if not MUJOCO_IS_HERE:
        assert NOT_INSTALLED in make_peers(system)[1].values()
        return
    drive, grid = sinusoid(system), Grid.of(system.scene.run)
    peer = make_peers(system, only("MuJoCo"))[0]["MuJoCo"]
    for method in peer.methods:
        ends = []
        for torques in (drive, lambda t, _state: drive(t)):
            *_, last = peer.follow(Clock(), grid, system.initial_state(), method, 0.005, torques)
            ends.append(last.state.position)
        # roundings of torques end Newton's method an iteration earlier or later
        assert ends[0] == pytest.approx(ends[1], abs=1e-8), method


def test_the_clock_does_not_count_what_is_off_it():
    clock = Clock()
    with clock:
        clock.off_the_clock(lambda: [None] * 200_000)()
        with_it = clock.wall_time_s
    assert with_it < 0.0 <= clock.wall_time_s
    with pytest.raises(OutOfTime), Clock(limit_s=0.0):
        pass


# --- the common scene -----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["weld", "ball"])
def test_the_shipped_scene_is_the_ring_of_the_benchmark(kind):
    def flat(value, path=""):
        if isinstance(value, dict):
            for key, item in value.items():
                yield from flat(item, f"{path}/{key}")
        elif isinstance(value, list | tuple):
            for key, item in enumerate(value):
                yield from flat(item, f"{path}/{key}")
        else:
            yield path, value

    shipped = dict(flat(ma.load_scene(SCENES / f"ring_{kind}.yaml").model_dump(mode="json")))
    built = dict(flat(ring_of_arms(2, kind).model_dump(mode="json")))
    assert shipped.keys() == built.keys()
    for path, value in shipped.items():
        if isinstance(value, float):
            assert value == pytest.approx(built[path], abs=1e-15), path
        else:
            assert value == built[path], path


def test_a_peer_that_cannot_be_loaded_is_not_said_to_be_absent(system, tmp_path, monkeypatch):
    (tmp_path / "broken_peer.py").write_text("from math import no_such_function\n")
    (tmp_path / "absent_peer.py").write_text("raise ModuleNotFoundError(name='mujoco')\n")
    monkeypatch.syspath_prepend(tmp_path)
    able, refusals = make_peers(system, {"A": "absent_peer:Peer", "B": "broken_peer:Peer"})
    assert able == {}
    assert refusals["A"] == NOT_INSTALLED
    assert "no_such_function" in refusals["B"]
