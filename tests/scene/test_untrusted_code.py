"""Claims about code that files name: looking runs none of it, a run says what it loads.

Every module here writes a line into a file named ``marker`` when it is imported and when one of its
functions is called, so that an empty place proves that nothing was executed.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from commands import multiarm
from mechanics import slides
from refusals import refused

import multiarm as ma
from multiarm.errors import SceneError, SweepError
from multiarm.scene import CONTROLS, EFFECTS, parse_scene
from multiarm.sweeps.plan import SweepPlan, make_plan
from multiarm.sweeps.run import Context, run
from multiarm.sweeps.spec import parse_sweep

MARKING = """
from pathlib import Path
from typing import Literal
import multiarm as ma

def mark(what):
    with (Path({folder!r}) / "marker").open("a") as file:
        file.write(what + "\\n")

mark("imported")

def dome(p):
    mark("called")
    return (p @ p) ** 0.5 - 0.3

def push(t, state):
    mark("called")
    return [0.1, 0, 0, 0, 0, 0]

def steer(t, state):
    mark("called")
    return {{"held": [0.1] * len(state.joint_positions["held"])}}

def number(trajectory):
    mark("called")
    return 1.0

class Helm(ma.Control):
    kind: Literal["helm"] = "helm"
    turn: float = 0.0

    def torques(self, t, state):
        mark("called")
        return {{}}

class Magnet(ma.Effect):
    name = "magnet"

    class Spec(ma.Effect.Spec):
        strength: float = 1.0

    def forces(self, t, state):
        mark("called")
        return ma.Loads()
"""
SCENE = """
object: {{shape: {{box: [0.2, 0.2, 0.2]}}, mass: 1.0}}
arms:
  held: {{urdf: gantry.urdf, tip: tip}}
  touching: {{urdf: gantry.urdf, tip: tip, base: {{xyz: [0, 0, 0.3]}}}}
joints:
  - {{arm: held, kind: weld}}
  - arm: touching
    kind: contacts
    contacts:
      - {{arm: {{point: [0, 0, 0]}}, object: {surface}}}
      - arm: {{point: [0, 0.1, 0]}}
        object: {{plane: {{point: [0, 0.1, 0], normal: [0, 1, 0]}}}}
effects: {effects}
run: {{duration: 0.02, integrator: rk4, step: 0.005}}
"""
PLANE = "{plane: {point: [0, 0, 0.3], normal: [0, 0, 1]}}"
# kind -> surface of the first contact, effects, what is said to be loaded, at which place
KINDS = {
    "surface": (
        "{surface: {distance: 'shapes.py:dome', length: 0.3}}", "{}",
        "the function 'dome' of {folder}/shapes.py",
        "$.joints[1].contacts[0].object.surface.distance",
    ),
    "wrench": (
        PLANE, "{external_wrenches: [{on: object, function: 'shapes.py:push'}]}",
        "the function 'push' of {folder}/shapes.py", "$.effects.external_wrenches[0].function",
    ),
    "module": (
        PLANE, "{external_wrenches: [{on: object, function: 'strange_module:push'}]}",
        "the function 'push' of strange_module", "$.effects.external_wrenches[0].function",
    ),
    "effect": (
        PLANE, "{magnet: {strength: 2.0}}",
        "the effect 'magnet' of package 'strange' (strange_module:Magnet)", "$.effects.magnet",
    ),
    "controller": (
        PLANE, "{}\ncontrol: {function: 'shapes.py:steer', sample_time: 0.01}",
        "the function 'steer' of {folder}/shapes.py", "$.control.function",
    ),
    "control": (
        PLANE, "{}\ncontrol: {kind: helm, turn: 0.2}",
        "the control kind 'helm' of package 'strange' (strange_module:Helm)", "$.control.kind",
    ),
}  # fmt: skip


def told(result) -> str:
    return " ".join(result.stderr.split())


@dataclass(frozen=True)
class Stranger:
    """A folder of files that came from somebody else."""

    folder: Path
    kind: str
    what: str
    place: str

    @property
    def scene(self) -> Path:
        return self.folder / "scene.yaml"

    @property
    def result(self) -> Path:
        return self.folder / "run.h5"

    def marks(self) -> set[str]:
        marker = self.folder / "marker"
        return set(marker.read_text().split()) if marker.exists() else set()

    def forget(self) -> None:
        """Let this process be as one that has not loaded anything."""
        (self.folder / "marker").unlink(missing_ok=True)
        sys.modules.pop("strange_module", None)
        EFFECTS.registered.clear()
        CONTROLS.registered.clear()


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Where the modules of the stranger are; the installed package is below."""
    installed = tmp_path / "installed"
    about = installed / "strange-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: strange\nVersion: 1.0\n")
    offers = "[multiarm.effects]\nmagnet = strange_module:Magnet\n"
    offers += "[multiarm.controls]\nhelm = strange_module:Helm\n"
    (about / "entry_points.txt").write_text(offers)
    for file in (installed / "strange_module.py", tmp_path / "shapes.py"):
        file.write_text(MARKING.format(folder=str(tmp_path)))
    (tmp_path / "gantry.urdf").write_text(slides())
    monkeypatch.syspath_prepend(installed)
    for own in (CONTROLS, EFFECTS):
        monkeypatch.setattr(own, "registered", {})
    monkeypatch.setitem(sys.modules, "strange_module", None)
    del sys.modules["strange_module"]
    return tmp_path


def written(folder: Path, kind: str) -> Stranger:
    surface, effects, what, place = KINDS[kind]
    (folder / "scene.yaml").write_text(SCENE.format(surface=surface, effects=effects))
    return Stranger(folder, kind, what.format(folder=folder), place)


@pytest.fixture(params=KINDS)
def stranger(request, folder) -> Stranger:
    return written(folder, request.param)


of_a_function_and_of_a_class = pytest.mark.parametrize(
    "stranger", ["surface", "effect"], indirect=True
)


@pytest.fixture
def stored(stranger) -> Stranger:
    """The same with a result, in a process that has loaded nothing."""
    result = multiarm("run", stranger.scene, "--out", stranger.result, "--quiet")
    assert result.exit_code == 0, result.output
    assert stranger.marks() == {"imported", "called"}
    stranger.forget()
    return stranger


# --- looking ------------------------------------------------------------------------------------


def test_a_look_at_a_scene_runs_nothing_and_says_what_it_left_out(stranger):
    scene = ma.load_scene(stranger.scene)
    assert ma.load_scene(stranger.scene, code=False) == scene
    assert scene.replace(name="other").may_load_code
    figures = stranger.folder / "check.json"
    result = multiarm("check", stranger.scene, "--json", figures)
    assert result.exit_code == 0, result.output
    assert f"{stranger.place}: " in told(result)
    assert f"{stranger.what} is not loaded" in told(result)
    found = json.loads(figures.read_text())
    assert len(found["not_looked_at"]) == 1
    assert found["arms"].keys() == {"held", "touching"}
    assert "held" in [joint["arm"] for joint in found["joints"]]
    assert (found["freedom"] is None) == (stranger.kind == "surface")
    assert multiarm("joints").exit_code == 0
    assert stranger.marks() == set()


@of_a_function_and_of_a_class
def test_what_compiles_a_scene_loads_its_code_and_says_so_unless_refused(stranger):
    result = multiarm("grasp", "check", stranger.scene, "--no-code")
    assert result.exit_code == 2
    assert f"{stranger.place}: {stranger.what} is not loaded" in told(result)
    assert stranger.marks() == set()
    result = multiarm("grasp", "check", stranger.scene)
    assert result.exit_code == 0, result.output
    assert f"loading {stranger.what}" in told(result)
    assert "imported" in stranger.marks()


@of_a_function_and_of_a_class
def test_a_fault_elsewhere_in_the_scene_loads_nothing_either(stranger):
    stranger.scene.write_text(stranger.scene.read_text().replace("mass: 1.0", "mass: -1.0"))
    with refused(SceneError, "$.object.mass"):
        ma.load_scene(stranger.scene)
    assert stranger.marks() == set()


@pytest.mark.slow
def test_a_look_at_a_result_runs_nothing_and_draws_the_rest(stored, request):
    if stored.kind != "surface":  # figures take a report most of its time
        request.getfixturevalue("without_figures")
    page, report = stored.folder / "replay.html", stored.folder / "report.html"
    result = multiarm("replay", stored.result, "--html", page)
    assert result.exit_code == 0, result.output
    needs = stored.kind == "surface"
    assert (f"need {stored.what} are not drawn" in told(result)) == needs
    trajectory = ma.load_trajectory(stored.result)
    assert trajectory.scene.name == "scene"
    with refused(SceneError, stored.place):
        ma.compile_system(trajectory.scene)
    ma.report(trajectory, report)
    assert stored.marks() == set()
    assert ma.compile_system(trajectory.scene, code=True).scene == trajectory.scene
    assert "imported" in stored.marks()


def test_a_replay_draws_what_it_draws_of_a_run_in_this_process(folder):
    from multiarm.viewer.animate import animate

    surface = written(folder, "surface")
    made = ma.simulate(ma.compile_system(ma.load_scene(surface.scene)))
    read = ma.load_trajectory(made.save(surface.result))
    (folder / "shapes.py").write_text("raise RuntimeError('loaded once more')")
    options = {"fps": 100, "speed": 1, "meshes": False}
    whole = animate(made, **options)
    with pytest.warns(UserWarning, match="are not drawn"):
        part = animate(read, **options)
    assert "is not loaded" in part.note and whole.note == ""
    assert [len(one.names) for one in whole.contacts] == [6, 2]
    assert [one.names for one in part.contacts] == [whole.contacts[0].names, ("contact 2",)]
    for drawn in ("point", "normal", "force"):
        own, expected = getattr(part.contacts[1], drawn), getattr(whole.contacts[1], drawn)
        assert own[:, 0] == pytest.approx(expected[:, 1], abs=1e-12)


@pytest.mark.slow
def test_a_joint_of_which_nothing_is_left_is_looked_at_too(folder):
    surface = written(folder, "surface")
    text = surface.scene.read_text().replace(
        "effects: {}", "effects: {unilateral_contacts: {restitution: 0.3}}"
    )
    first, _, rest = text.partition("      - arm: {point: [0, 0.1, 0]}\n")
    surface.scene.write_text(first + rest.partition("\n")[2])
    assert multiarm("run", surface.scene, "--out", surface.result).exit_code == 0
    surface.forget()
    assert multiarm("check", surface.scene).exit_code == 0
    page = folder / "replay.html"
    assert multiarm("replay", surface.result, "--html", page).exit_code == 0
    assert surface.marks() == set()


# --- sweeps -------------------------------------------------------------------------------------

SWEEP = "over: {object.mass: [1.0, 2.0]}\nkeep: [final_z, 'shapes.py:number']\n"


@pytest.mark.slow
@of_a_function_and_of_a_class
def test_a_stored_sweep_is_looked_at_without_its_code_and_run_again_with_it(stranger):
    over, out, page = (stranger.folder / name for name in ("s.yaml", "s.sweep", "a.html"))
    over.write_text(SWEEP)
    words = ["sweep", stranger.scene, "--over", over, "--out", out, "--workers", 1]
    result = multiarm(*words, "--no-code")
    assert result.exit_code == 2
    assert f"{stranger.place}: {stranger.what} is not loaded" in told(result)
    assert f"$.keep[1]: the function 'number' of {stranger.folder}/shapes.py" in told(result)
    assert not out.exists() and stranger.marks() == set()
    result = multiarm(*words)
    assert result.exit_code == 0, result.output
    assert f"loading {stranger.what}" in told(result)
    assert f"loading the function 'number' of {stranger.folder}/shapes.py" in told(result)
    assert stranger.marks() == {"imported", "called"}
    stranger.forget()
    sweep = ma.load_sweep(out)
    assert sweep.table["number"].tolist() == [1.0, 1.0]
    assert sweep.summary().done == 2 and sweep.scene_of(2).object.mass == 2.0
    with refused(SceneError, stranger.place):
        sweep.trajectory(1)
    for command in ("replay", "report"):
        result = multiarm(command, out, "--run", 1, "--html", page)
        assert result.exit_code == 2
        assert f"which needs {stranger.what}" in told(result) and "code=True" in told(result)
    assert stranger.marks() == set()
    assert ma.load_sweep(out, code=True).trajectory(2).status == "completed"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("over", "what"),
    [
        ("effects.magnet: [{strength: 1.0}]", "the effect 'magnet' of package 'strange'"),
        ("effects: [{magnet: {}}]", "the effect 'magnet' of package 'strange'"),
        (
            "effects.external_wrenches: [[{on: object, function: 'shapes.py:push'}]]",
            "the function 'push' of {folder}/shapes.py",
        ),
    ],
)
def test_code_that_the_values_of_a_sweep_name_is_told_and_refused_too(folder, over, what):
    plain = written(folder, "wrench")
    plain.scene.write_text(SCENE.format(surface=PLANE, effects="{}"))
    (folder / "s.yaml").write_text(f"over: {{{over}}}\nkeep: [final_z]\n")
    words = ["sweep", plain.scene, "--over", folder / "s.yaml", "--out", folder / "s.sweep"]
    result = multiarm(*words, "--no-code")
    assert result.exit_code == 2 and what.format(folder=folder) in told(result)
    assert plain.marks() == set()
    result = multiarm(*words, "--workers", 1)
    assert result.exit_code == 0, result.output
    assert f"loading {what.format(folder=folder)}" in told(result)
    assert "called" in plain.marks()


@of_a_function_and_of_a_class
def test_a_sweep_of_a_scene_without_its_code_runs_none(stranger):
    (stranger.folder / "s.yaml").write_text(SWEEP)
    scene, out = ma.load_scene(stranger.scene, code=False), stranger.folder / "s.sweep"
    for over in (stranger.folder / "s.yaml", {"object.mass": [1.0]}):
        with refused(SceneError, stranger.place):
            ma.sweep(scene, over, out=out, workers=1)
    plan = SweepPlan(scene, parse_sweep({"over": {"object.mass": [1.0]}}))
    row = run(Context.of(plan), 1, {"object.mass": 1.0})  # as any worker would carry it out
    assert row["status"] == "failed" and stranger.place in row["message"]
    assert not out.exists() and stranger.marks() == set()


def test_functions_that_only_a_sweep_names_are_refused_with_the_scenes_code(folder):
    plain = written(folder, "wrench")
    plain.scene.write_text(SCENE.format(surface=PLANE, effects="{}"))
    (folder / "s.yaml").write_text(SWEEP)
    scene = ma.load_scene(plain.scene, code=False)
    with refused(SceneError, "$.keep[1]", "shapes.py"):
        make_plan(scene, folder / "s.yaml")
    assert plain.marks() == set()
    functions_in_hand = ["final_z", lambda trajectory: 1.0]
    make_plan(scene, folder / "s.yaml", keep=functions_in_hand)


# --- running ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_says_what_it_loads_or_refuses_it(stranger):
    words = ["run", stranger.scene, "--out", stranger.result]
    result = multiarm(*words, "--no-code")
    assert result.exit_code == 2
    assert f"{stranger.place}: {stranger.what} is not loaded" in told(result)
    assert "no `--no-code`" in told(result)
    with pytest.raises(SceneError) as caught:
        ma.compile_system(ma.load_scene(stranger.scene, code=False))
    assert f"{stranger.place}: {stranger.what} is not loaded" in str(caught.value)
    changed = ma.load_scene(stranger.scene, code=False).replace(name="other")
    with refused(SceneError, stranger.place):
        ma.compile_system(changed)
    assert stranger.marks() == set() and not stranger.result.exists()
    page = stranger.folder / "replay.html"
    result = multiarm(*words, "--replay-html", page, "--json", stranger.folder / "run.json")
    assert result.exit_code == 0, result.output
    assert told(result).count(f"loading {stranger.what}") == 1
    assert page.exists() and "are not drawn" not in told(result)
    assert stranger.marks() == {"imported", "called"}


@pytest.mark.parametrize("command", ["accuracy", "effects"])
def test_a_study_of_a_scene_refuses_as_a_run_does(command, folder):
    wrench = written(folder, "wrench")
    result = multiarm(command, wrench.scene, "--no-code")
    assert result.exit_code == 2 and f"{wrench.what} is not loaded" in told(result)
    assert wrench.marks() == set()


def test_an_effect_that_its_package_refuses_is_told_at_its_place(folder):
    effect = written(folder, "effect")
    effect.scene.write_text(effect.scene.read_text().replace("strength: 2.0", "strenght: 2.0"))
    scene = ma.load_scene(effect.scene)
    with refused(SceneError, "$.effects.magnet.strenght"):
        ma.compile_system(scene)


# --- what may be named --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        ("numpy:os.system", "'os.system' is not a plain name"),
        ("shapes.py:Path.unlink", "'Path.unlink' is not a plain name"),
        ("../shapes.py:push", "its file is not in the folder"),
        ("/usr/lib/shapes.py:push", "its file is not in the folder"),
        ("linked.py:push", "its file is not in the folder"),
    ],
)
def test_a_file_names_code_by_plain_names_and_no_files_elsewhere(function, reason, folder):
    inner = folder / "inner"
    inner.mkdir()
    for name in ("gantry.urdf", "shapes.py"):
        (inner / name).write_text((folder / name).read_text())
    (inner / "linked.py").symlink_to(folder / "shapes.py")
    wrench = f"{{external_wrenches: [{{on: object, function: '{function}'}}]}}"
    (inner / "scene.yaml").write_text(SCENE.format(surface=PLANE, effects=wrench))
    with pytest.raises(SceneError) as caught:
        ma.load_scene(inner / "scene.yaml")
    (fault,) = caught.value.faults
    assert fault.startswith("$.effects.external_wrenches[0].function: cannot load the function")
    assert reason in fault
    (inner / "plain.yaml").write_text(SCENE.format(surface=PLANE, effects="{}"))
    (inner / "s.yaml").write_text(f"over: {{object.mass: [1]}}\nkeep: ['{function}']\n")
    with pytest.raises(SweepError) as caught:
        ma.sweep(inner / "plain.yaml", inner / "s.yaml", out=folder / "s.sweep")
    assert any(reason in fault for fault in caught.value.faults)
    assert not (folder / "marker").exists()


def test_what_is_named_in_python_may_be_anywhere(folder):
    text = written(folder, "wrench").scene.read_text()
    text = text.replace("'shapes.py", f"'{folder}/shapes.py").replace("gantry", f"{folder}/gantry")
    assert ma.simulate(ma.compile_system(parse_scene(text, Path("/")))).status == "completed"


# --- functions that end the program -------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "code"), [("surface", ""), ("wrench", "0"), ("effect", "'enough'")]
)
def test_a_function_that_ends_the_program_fails_the_run(kind, code, folder):
    # a surface is not told the time; a start takes some 550 calls of it, the run 2600 more
    late = "COUNT.append(1) or len(COUNT) > 2700" if kind == "surface" else "t > 0.012"
    line = f"if {late}: import sys; sys.exit({code})"
    for file in (folder / "shapes.py", folder / "installed" / "strange_module.py"):
        text = MARKING.format(folder=str(folder)).replace('mark("called")', line)
        file.write_text("COUNT = []\n" + text)
    one = written(folder, kind)
    result = multiarm("run", one.scene, "--out", one.result)
    assert result.exit_code == 1, result.output
    trajectory = ma.load_trajectory(one.result)
    assert trajectory.status == "failed" and trajectory.time[-1] > 0.0
    name = {"surface": "the distance of the surface", "wrench": "external_wrenches[0]",
            "effect": "the effect 'magnet'"}[kind]  # fmt: skip
    assert trajectory.message.startswith("at t = ")
    assert name in trajectory.message and "SystemExit" in trajectory.message


@pytest.mark.parametrize("kind", ["surface", "effect"])
def test_a_module_that_ends_the_program_on_import_is_an_error(kind, folder):
    for file in (folder / "shapes.py", folder / "installed" / "strange_module.py"):
        file.write_text("import sys\nsys.exit()\n")
    one = written(folder, kind)
    result = multiarm("run", one.scene, "--out", one.result)
    assert result.exit_code == 2
    assert one.place in told(result) and "SystemExit" in told(result)


def test_controllers_quantities_and_effects_that_are_built_end_no_program(folder, monkeypatch):
    monkeypatch.setattr(EFFECTS, "registered", {})
    scene = ma.load_scene(written(folder, "wrench").scene).replace(effects={})

    def leave(t, state):
        raise SystemExit(0)

    with refused(ma.MultiarmError, "the controller"):
        ma.simulate(ma.compile_system(scene), control=leave)

    class Leaving(ma.Effect):
        name = "leaving"

        def build(self, site):
            raise SystemExit(0)

    ma.register_effect(Leaving)
    with refused(ma.MultiarmError, "effects.leaving"):
        ma.compile_system(scene.replace(effects={"leaving": {}}))
    (folder / "shapes.py").write_text("import sys\ndef number(trajectory):\n    sys.exit()\n")
    (folder / "s.yaml").write_text(SWEEP)
    found = ma.sweep(scene, folder / "s.yaml", out=folder / "s.sweep", workers=1)
    assert found.status_counts == {"failed": 2}
    assert "quantity 'number' raised SystemExit" in found.table["message"][0]
