"""Claims about ``multiarm effects``, and about what ``multiarm check`` says of effects."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import commands
import numpy as np
import pytest
from commands import finite_json, promised_keys
from page_reader import Page
from repository import SCENES
from study_samples import sample_ledger

import multiarm as ma
from multiarm.cli import effects as command
from multiarm.effects.defaults import defaults
from multiarm.scene import EFFECTS, dump_scene
from multiarm.simulation.comparison import rotation_apart
from multiarm.studies import effect_costs
from multiarm.studies.effect_costs import (
    CANDIDATE,
    FORCE,
    JOINTS,
    PATH,
    PRESENT,
    SETTING,
    TURN,
    Entry,
    Ledger,
    changes,
    ledger,
    paired_difference,
    without,
)
from multiarm.studies.effect_costs_page import (
    render,
    sentence,
    summary,
)

effects, check = (commands.command(name, 160) for name in ("effects", "check"))
RING = ma.load_scene(SCENES / "ring_weld.yaml").replace(effects={"joint_damping": 0.5})
SHORT = RING.replace(run={"duration": 0.3, "output_step": 0.01, "accuracy": 1e-6})


@pytest.fixture
def own(monkeypatch):
    """Register effects for one test."""
    monkeypatch.setattr(EFFECTS, "registered", {})

    def effect(name: str, **body) -> None:
        body = {"forces": lambda self, t, state: ma.Loads(), **body, "name": name}
        ma.register_effect(type(name.title(), (ma.Effect,), body))

    return effect


@pytest.fixture
def scene_file(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(dump_scene(SHORT), encoding="utf-8")
    return path


# --- the study ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def found() -> Ledger:
    return ledger(SHORT, repeats=3)


def entry_of(found: Ledger, name: str) -> Entry:
    return next(entry for entry in found.entries if entry.name == name)


def of_kind(found: Ledger, kind: str) -> list[Entry]:
    return [entry for entry in found.entries if entry.kind == kind]


def test_every_effect_and_every_setting_has_an_entry(found):
    assert [(entry.name, entry.kind) for entry in found.entries] == [
        ("gravity", PRESENT), ("joint_damping", PRESENT), ("stabilization", SETTING),
        ("recording", SETTING), ("certificate", SETTING),
    ]  # fmt: skip
    assert not any(entry.trouble for entry in found.entries)
    assert found.asked_by_scene and found.asked[PATH] == 1e-6


def test_changes_are_the_largest_differences_of_two_runs_at_their_time(found):
    a, b = (ma.simulate(ma.compile_system(s)) for s in (SHORT, SHORT.replace(effects={})))
    path = np.linalg.norm(a.object_position - b.object_position, axis=1)
    turn = rotation_apart(a.object_quaternion_xyzw, b.object_quaternion_xyzw)
    entry = entry_of(found, "joint_damping")
    for quantity, course in ((PATH, path), (TURN, turn)):
        change = entry.changes[quantity]
        assert change.value == pytest.approx(course.max(), rel=1e-9)
        assert change.time == a.time[np.argmax(course)]
    for quantity, values in (
        (JOINTS, [(a.joint_positions, b.joint_positions)]),
        (FORCE, [(a.contact_forces, b.contact_forces)]),
    ):
        ((one, two),) = values
        worst = {arm: np.abs(one[arm] - two[arm]).max() for arm in a.arm_names}
        change = entry.changes[quantity]
        assert change.value == pytest.approx(max(worst.values()), rel=1e-9)
        assert change.arm == max(worst, key=worst.get)


def test_forces_that_only_one_of_two_runs_has_are_not_compared():
    short = SHORT.replace(run={"duration": 0.05, "output_step": 0.01, "accuracy": 1e-6})
    a, b = (ma.simulate(ma.compile_system(s)) for s in (short, short.replace(gravity=None)))
    system = ma.compile_system(short)
    name = f"arms/{a.arm_names[0]}/contact_force"
    channel, values = a.channels[name], a.channel(name)

    class Rough(ma.Trajectory):
        """The second run, with forces of friction in between that are huge."""

        @property
        def channels(self):
            labels = [text for k in channel.labels for text in (f"{k}, friction", k)]
            more = replace(channel, shape=(len(labels),), labels=tuple(labels))
            return {**super().channels, name: more}

        def read(self, asked, start=0, stop=None):
            found = super().read(asked, start, stop)
            if asked != name:
                return found
            return np.stack([np.full_like(found, 1e9), found], axis=2).reshape(len(found), -1)

    rough = Rough(b._store, b._outcome)
    assert rough.read(name).shape[1] == 2 * values.shape[1]
    plain, found = (changes(system, a, run) for run in (b, rough))
    assert found == plain
    assert changes(ma.compile_system(short.replace(gravity=None)), rough, a)[FORCE] == plain[FORCE]


def test_what_is_counted_is_what_the_scene_needs_more_than_the_variant(found):
    a = ma.simulate(ma.compile_system(SHORT))
    b = ma.simulate(ma.compile_system(SHORT), stabilization="none")
    counts = [run.statistics["evaluations"] for run in (a, b)]
    assert counts[0] > counts[1]
    assert found.run["evaluations"] == counts[0]
    assert entry_of(found, "stabilization").evaluations == counts[0] - counts[1]
    certificate = entry_of(found, "certificate")
    assert certificate.evaluations == sum(
        attempt["evaluations"] for attempt in a.certificate["attempts"][1:]
    )


def test_recording_and_stabilization_do_not_move_what_they_are_about(found):
    for name in ("recording", "stabilization"):
        assert entry_of(found, name).changes[PATH].value < 1e-7
    assert found.can_go(entry_of(found, "recording")) is False, "only effects can go"


def test_ends_at_different_times_are_not_compared():
    def ended(status: str, end: float) -> SimpleNamespace:
        channels = {
            "object/position": np.full((2, 3), end),
            "object/quaternion_xyzw": np.array([[0.0, 0.0, 0.0, 1.0]] * 2),
        }
        return SimpleNamespace(
            status=status, time=np.array([0.0, end]), channels={}, channel=channels.get
        )

    run, failed = ended("completed", 1.0), ended("failed", 0.5)
    assert effect_costs.last_changes(None, run, run)[PATH].value == 0.0
    assert effect_costs.last_changes(None, run, failed) == {}


def test_an_effect_named_like_a_setting_is_compared_at_all_times():
    variants = effect_costs.variants_of(SHORT, {"recording": {}})
    named = {(v.name, v.kind): v.ends_only for v in variants if v.name == "recording"}
    assert named == {("recording", SETTING): True, ("recording", CANDIDATE): False}


def test_an_effect_that_does_nothing_can_go_and_is_said_to(own):
    own("nothing", build=lambda self, site: [])
    scene = SHORT.replace(effects={"joint_damping": 0.5, "nothing": {}})
    result = ledger(scene, repeats=1)
    nothing = entry_of(result, "nothing")
    assert result.can_go(nothing)
    assert not result.can_go(entry_of(result, "joint_damping"))
    assert nothing.changes[PATH].value == 0.0
    assert sentence(result, nothing).endswith(", changes nothing beyond the noise: leave it out")
    doubtful = replace(result, run={**result.run, "certified": False})
    assert not doubtful.can_go(nothing), "the run that it is compared with misses the accuracy"
    assert "leave it out" not in sentence(doubtful, nothing)
    assert "nothing is undecided" in summary(doubtful)


@pytest.mark.slow
def test_an_effect_without_which_the_scene_does_not_run_is_told(own):
    own("magnet")

    def build(self, site):
        if "magnet" not in site.scene.effects.named:
            raise ma.MultiarmError("effects.yoke: needs a magnet")
        return []

    own("yoke", build=build)
    scene = SHORT.replace(effects={"magnet": {}, "yoke": {}})
    entry = entry_of(ledger(scene, repeats=1), "magnet")
    assert entry.trouble == "effects.yoke: needs a magnet"
    assert entry.share is None and not entry.changes


@pytest.mark.slow
def test_a_variant_that_fails_on_the_way_is_compared_up_to_there(own):
    def forces(self, t, _state):
        if t > 0.1 and "joint_damping" not in self.site.scene.effects.named:
            raise RuntimeError("too loose")
        return ma.Loads()

    def build(self, site):
        self.site = site
        return ma.Effect.build(self, site)

    own("brittle", forces=forces, build=build)
    scene = SHORT.replace(effects={"joint_damping": 0.5, "brittle": {}})
    result = ledger(scene, repeats=1)
    entry = entry_of(result, "joint_damping")
    assert entry.trouble.startswith("the run fails: ") and "too loose" in entry.trouble
    assert 0.0 < entry.changes[PATH].time < 0.13
    assert not result.can_go(entry)


@pytest.mark.slow
def test_candidates_are_added_with_their_usual_parameters(own, monkeypatch):
    own("breeze", default={}, forces=lambda self, t, s: ma.Loads([0.1, 0, 0, 0, 0, 0]))
    monkeypatch.setattr(
        effect_costs, "defaults", lambda _: {"joint_damping": 1.0, "breeze": {}, "x": 1}
    )
    result = ledger(SHORT, candidates=True, repeats=1)
    added = of_kind(result, CANDIDATE)
    assert [entry.name for entry in added] == ["breeze", "x"], "what the scene has is no candidate"
    breeze, broken = added
    exact = ma.simulate(
        ma.compile_system(SHORT.replace(effects={**SHORT.effects.named, "breeze": {}}))
    )
    still = ma.simulate(ma.compile_system(SHORT))
    moved = np.linalg.norm(exact.object_position - still.object_position, axis=1).max()
    assert breeze.changes[PATH].value == pytest.approx(moved, rel=1e-9)
    assert breeze.evaluations == exact.statistics["evaluations"] - still.statistics["evaluations"]
    assert "unknown effect 'x'" in broken.trouble


def test_an_unforeseen_error_in_one_variant_does_not_hide_the_others(own, monkeypatch):
    def compiled(scene):
        if "buggy" in scene.effects.named:
            raise ZeroDivisionError("a bug")
        return ma.compile_system(scene)

    own("buggy")
    monkeypatch.setattr(effect_costs, "compile_system", compiled)
    monkeypatch.setattr(effect_costs, "defaults", lambda _: {"buggy": {}})
    result = ledger(SHORT, candidates=True, repeats=1)
    assert entry_of(result, "buggy").trouble == "ZeroDivisionError: a bug"
    assert entry_of(result, "joint_damping").trouble == ""


def test_a_scene_that_asks_for_no_accuracy_is_measured_all_the_same():
    run = {"duration": 0.1, "integrator": "rk4", "step": 1e-3, "stabilization": "none"}
    result = ledger(RING.replace(run=run), repeats=1)
    assert not result.asked_by_scene
    assert [entry.name for entry in of_kind(result, SETTING)] == ["recording"]


def test_a_scene_that_does_not_run_is_refused(own):
    def forces(self, t, _state):
        if t > 0.1:
            raise RuntimeError("no further")
        return ma.Loads()

    own("wall", forces=forces)
    with pytest.raises(ma.MultiarmError, match=r"the scene itself does not run: .*no further"):
        ledger(SHORT.replace(effects={"wall": {}}), repeats=1)


def test_leaving_out_keeps_the_others():
    scene = RING.replace(gravity=[0, 0, -1.0])
    assert without(scene, "gravity").gravity is None
    assert without(scene, "gravity").effects == scene.effects
    assert without(scene, "joint_damping").effects.named == {}
    assert without(scene, "joint_damping").gravity == scene.gravity


@pytest.mark.parametrize(
    ("shape", "area", "lowest"),
    [
        ({"box": [0.4, 0.6, 0.2]}, [0.12, 0.08, 0.24], 1.0 - 0.1),
        ({"sphere": 0.25}, [0.25, 0.25, 0.25], 1.0 - 0.25),
        ({"cylinder": {"radius": 0.1, "height": 0.5}}, [0.1, 0.1, 0.04], None),
    ],
)
def test_usual_parameters_fit_the_scene(shape, area, lowest):
    body = {"shape": shape, "mass": 1.0, "pose": {"xyz": [0.0, 0.0, 1.0]}}
    scene = RING.replace(effects={}, object=body)
    found = defaults(scene)
    for name, spec in found.items():
        assert scene.replace(effects={name: spec}).effects.named.keys() == {name}
    assert found["drag"]["area"] == pytest.approx(area)
    assert ("floor" in found) == (lowest is not None)
    if lowest is not None:
        assert found["floor"]["at"]["xyz"] == pytest.approx([0.0, 0.0, lowest])


def test_a_floor_is_below_a_box_that_is_turned():
    pose = {"xyz": [0.0, 0.0, 1.0], "rpy": [np.pi / 4, 0.0, 0.0]}
    body = {"shape": {"box": [0.4, 0.2, 0.2]}, "mass": 1.0, "pose": pose}
    height = defaults(RING.replace(effects={}, object=body))["floor"]["at"]["xyz"][2]
    assert height == pytest.approx(1.0 - 0.1 * np.sqrt(2.0))


# --- estimates ------------------------------------------------------------------------------------


def test_a_difference_in_noise_is_recovered_within_its_uncertainty():
    random = np.random.default_rng(7)
    inside, n, shift, widths = 0, 25, 0.02, []
    for _ in range(200):
        drift = np.cumsum(random.normal(0.0, 0.3, n))  # hits both of a pair
        a = 1.0 + shift + drift + random.normal(0.0, 0.03, n)
        b = 1.0 + drift + random.normal(0.0, 0.03, n)
        estimate = paired_difference(a, b)
        inside += abs(estimate.value - shift) <= estimate.uncertainty
        widths.append(estimate.uncertainty)
    assert inside >= 176, "two standard errors, 95 in 100, quartiles of 25 pairs being uncertain"
    assert np.mean(widths) < 0.03, "the drift does not count"


def test_equal_contestants_are_within_noise_and_different_ones_are_not():
    random = np.random.default_rng(3)
    a = random.normal(1.0, 0.01, 40)
    assert paired_difference(a, random.permutation(a)).within_noise
    assert not paired_difference(a + 0.1, random.permutation(a)).within_noise
    assert paired_difference(a, a).within_noise


# --- words ----------------------------------------------------------------------------------------


def test_the_summary_says_what_to_keep_and_what_to_leave_out():
    assert summary(sample_ledger()) == (
        "Leave out drag: without it nothing changes beyond the noise. "
        "Keep joint_damping (3 % of the time, the object's path by 41 mm), "
        "friction (time within the noise, left & <right>'s contact forces by 3.2 N) and "
        "limits (saves 5 % of the time, the object's path by 2000 mm). "
        "doubtful is undecided, as its run does not meet the requested accuracy; "
        "floor: the scene does not run without it: the object <falls>; "
        "rotor_inertia (added): 20 % more time, would change the object's path by 500 mm; "
        "lag (added): 20 % more time, would change nothing beyond the noise: leave it out."
    )


# --- the command ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_prints_writes_and_draws(scene_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(effect_costs, "defaults", lambda _: {"rotor_inertia": 0.2, "drag": "thick"})
    result = effects(
        scene_file, "--duration", "0.1", "--rounds", 1, "--html", "page.html", "--plot",
        "plot.svg", "--json", "figures.json", "--candidates",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    for word in ("gravity", "joint_damping", "stabilization", "recording", "certificate"):
        assert re.search(rf"^ *{word} ", result.stdout, re.M), word
    assert "Accuracy (requested): object's path 1e-06 m" in " ".join(result.stdout.split())
    found = finite_json((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert promised_keys(command) == set(found)
    assert found["scene"]["duration_s"] == 0.1
    assert found["entries"][1]["name"] == "joint_damping"
    assert found["entries"][1]["changes"]["path"]["value"] > 1e-6
    assert re.search(r"^ *\+ rotor_inertia ", result.stdout, re.M)
    assert "drag: the scene does not run with it: $.effects.drag: must be a table" in result.stdout
    assert found["summary"] in " ".join(result.stdout.split())
    assert "<svg" in (tmp_path / "plot.svg").read_text(encoding="utf-8")
    assert "joint_damping" in (tmp_path / "page.html").read_text(encoding="utf-8")
    assert {path.name for path in tmp_path.iterdir()} == {
        "scene.yaml", "page.html", "plot.svg", "figures.json",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nowhere.yaml",), "no scene file at"),
        (("SCENE", "--html", "nowhere/page.html"), "--html: cannot write"),
        (("SCENE", "--json", "SCENE"), "is the file that is read"),
        (("SCENE", "--duration", "-1"), "duration"),
        (("--list", "--html", "page.html"), "--html: 'page.html' would not be written"),
        (("--list", "--plot", "plot.svg"), "--plot: 'plot.svg' would not be written"),
        (("SCENE", "--rounds", "0"), "Invalid value for '--rounds'"),
    ],
)
def test_bad_input_is_named_before_the_work(words, message, scene_file, monkeypatch):
    monkeypatch.chdir(scene_file.parent)
    monkeypatch.setattr(effect_costs, "ledger", None)
    result = effects(*(scene_file.name if word == "SCENE" else word for word in words))
    assert result.exit_code == 2, result.output
    assert message in " ".join(result.stderr.split())


def test_ctrl_c_ends_the_study(scene_file, monkeypatch):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(effect_costs, "clocked_run", interrupted)
    result = effects(scene_file)
    assert result.exit_code == 1
    assert "interrupted" in result.stderr


# --- check ----------------------------------------------------------------------------------------


def test_check_names_the_effects_with_their_parameters_and_times_none(scene_file, tmp_path):
    target = tmp_path / "check.json"
    result = check(scene_file, "--json", target)
    assert result.exit_code == 0, result.output
    effects = ma.load_scene(scene_file).effects.model_dump(mode="json", exclude_none=True)
    found = finite_json(target.read_text(encoding="utf-8"))["effects"]
    assert found == {"gravity": [0.0, 0.0, -9.81], **effects}
    assert re.search(r"joint_damping +0\.5", result.stdout)
    assert "\N{MICRO SIGN}s" not in result.stdout


def test_check_says_when_no_effect_acts(tmp_path):
    path = tmp_path / "bare.yaml"
    bare = SHORT.replace(effects={}, gravity=None, control={"kind": "none"})
    path.write_text(dump_scene(bare), encoding="utf-8")
    result = check(path, "--json", tmp_path / "check.json")
    assert result.exit_code == 0, result.output
    assert "only control acts" in result.stdout
    assert finite_json((tmp_path / "check.json").read_text(encoding="utf-8"))["effects"] == {}


# --- the page -------------------------------------------------------------------------------------


def test_the_page_has_every_entry_and_names_on_it_are_no_markup():
    text = render(sample_ledger())
    page = Page(text)
    assert page.tags.count("tr") == 1 + len(sample_ledger().entries)
    assert page.tags.count("svg") == 1
    assert "<title>arms &amp; &lt;disc&gt; · multiarm effects</title>" in text
    assert "the object &lt;falls&gt;" in text
    assert "a: &lt;b&gt;" in text
