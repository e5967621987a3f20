"""Claims about controls of one's own: they drive arms as ours do, are found, and refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import pytest
from commands import multiarm
from mechanics import two_arm_block, ur5_pair
from refusals import refused
from sweep_runs import jobs_of, repeatable
from user_classes import empty_registries, offered

import multiarm as ma
from multiarm.control import (
    CARRYING,
    ControlLaw,
    ControlProgram,
    force_columns,
    open_data,
    view_of_law,
)
from multiarm.control.gravity_compensation import carrying_laws
from multiarm.control.laws import PROGRAMS
from multiarm.dynamics.data import Data
from multiarm.dynamics.effect_kernels import keep_forces
from multiarm.dynamics.status import BLOCK_FULL, CALLBACK_FAILED, KERNEL_FAILED, OK
from multiarm.errors import SolverError
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import Float, Floats1, Int, struct_at
from multiarm.scene import CONTROLS, Scene, dump_scene, named_code, parse_scene
from multiarm.scene.control import BUILT_IN
from multiarm.sweeps.executors import run_here, run_in_processes
from multiarm.sweeps.plan import make_plan
from multiarm.sweeps.quantities import measure
from multiarm.sweeps.run import Context

RUN = {"duration": 0.1, "accuracy": 1e-6}
TORQUES = {"left": (3.0, -2.0, 1.0, 0.5, 0.0, 0.0), "right": {"elbow_joint": -4.0}}


@pytest.fixture(autouse=True)
def _only_ours(monkeypatch):
    empty_registries(monkeypatch)


class Pushes(NamedTuple):
    """Constant torques, after a number that the kernel must not take for them."""

    share: Float
    torques: Floats1  # (n,) [N m, N]


open_pushes = view_of_law(Pushes)


@cfunc
def push(address, size, at, _t):
    """Add the torques."""
    struct = struct_at(address, size)
    data, pushes = open_data(struct), open_pushes(struct, at)
    for j in range(data.control.torque.size):
        data.control.torque[j] += pushes.share * pushes.torques[j]
    return 0


class Push(ma.Control):
    """Constant torques, in compiled code."""

    kind: Literal["push"] = "push"
    pushes: dict[str, Any]
    by_joint = ("pushes",)

    def build(self, context):
        """A quarter of the torques, then the rest."""
        torques = context.stacked(self.pushes)
        # one law after the other, each with its own numbers
        laws = [ControlLaw(push, Pushes(share, torques)) for share in (0.25, 0.75)]
        return ControlProgram(tuple(laws))


@cfunc
def stretch(address, size, _at, _t):
    """Pull every joint with 3 N m/rad."""
    data = open_data(struct_at(address, size))
    for j in range(data.control.torque.size):
        data.control.torque[j] -= 3.0 * data.state.joint_positions[j]
    return OK


@cfunc
def differentiate_stretch(address, size, _at, _t):
    """Its derivative."""
    data = open_data(struct_at(address, size))
    positions = force_columns(data).positions
    for j in range(data.control.torque.size):
        data.slopes.torque[j, positions + j] -= 3.0
    return OK


class Stretch(ma.Control):
    """Two springs at every joint, in compiled code that returns a status."""

    kind: Literal["stretch"] = "stretch"

    def build(self, context):
        """The same law twice."""
        return ControlProgram((ControlLaw(stretch, derivative=differentiate_stretch),) * 2)


class Twice(ma.Control):
    """Gravity compensation twice, with the derivatives that it states or with differences."""

    kind: Literal["twice"] = "twice"
    stated: bool

    @property
    def compensates_gravity(self):
        """So the laws have the gravity forces."""
        return True

    def build(self, context):
        """Two laws of one kind."""
        laws = carrying_laws(context) + carrying_laws(context)
        if not self.stated:
            laws = tuple(replace(law, derivative=None, prepare=None) for law in laws)
        return ControlProgram(laws)


class Answer(NamedTuple):
    """What a law returns."""

    number: Int


open_answer = view_of_law(Answer)


@cfunc
def give_up(address, size, at, t):
    """After 0.05 s it has no torques."""
    answer = open_answer(struct_at(address, size), at)
    return answer.number if t > 0.05 else 0


@cfunc
def refuse_derivative(_address, _size, _at, _t):
    """A number that the time loop must not take for its own."""
    return BLOCK_FULL


class GiveUp(ma.Control):
    """A law that fails after a while, and whose derivative always does."""

    kind: Literal["give_up"] = "give_up"
    answer: int = 7

    def build(self, context):
        """One that works before it."""
        pushes = Pushes(1.0, np.ones(len(context.stacked(1.0))))
        return ControlProgram(
            (
                ControlLaw(push, pushes, keep_forces),
                ControlLaw(give_up, Answer(self.answer), refuse_derivative),
            )
        )


class Pull(ma.Control):
    """Springs about the straight arm, in Python."""

    picture = "a rubber band along every arm"
    example = "control: {kind: pull, stiffness: 5.0}"

    kind: Literal["pull"] = "pull"
    stiffness: float
    _calls: int = 0

    def torques(self, t, state):
        """Proportional to the joint positions."""
        self._calls += 1
        return {arm: -self.stiffness * q for arm, q in state.joint_positions.items()}


def scene_of(control, **more) -> Scene:
    more = {"run": RUN, "control": control, "name": "two arms", **more}
    return ur5_pair({"kind": "weld"}, {"kind": "ball"}, **more)


def run_of(control, function=None, **settings) -> ma.Trajectory:
    system = ma.compile_system(scene_of(control), function, **settings)
    return ma.simulate(system, certificate=False)


def require_equal(found: ma.Trajectory, expected: ma.Trajectory) -> None:
    assert np.ptp(expected.object_position, axis=0).max() > 1e-4, "it moves"
    for name in expected.channels:
        np.testing.assert_array_equal(found.read(name), expected.read(name), err_msg=name)


def pull(t, state):
    return {arm: -5.0 * q for arm, q in state.joint_positions.items()}


# --- mechanics ------------------------------------------------------------------------------------


def test_a_compiled_control_of_one_s_own_drives_bit_for_bit_as_ours():
    ma.register_control(Push)
    own = run_of({"kind": "push", "pushes": TORQUES})
    require_equal(own, run_of({"kind": "constant", "torques": TORQUES}))


def test_a_field_named_path_is_no_path_of_the_object():
    """A file of a table, say."""

    class Played(Push):
        kind: Literal["played"] = "played"
        path: str

    ma.register_control(Played)
    run = run_of({"kind": "played", "pushes": TORQUES, "path": "table.csv"})
    numbers, fault = measure(["final_position_error"], run)
    assert fault == ""
    moved = np.linalg.norm(run.object_position[-1] - run.object_position[0])
    assert numbers["final_position_error"] == pytest.approx(moved, rel=1e-12)


def test_derivatives_of_laws_that_can_be_held_are_those_of_all_whatever_status_each_returns():
    ma.register_control(Stretch)
    free = ma.compile_system(scene_of({"kind": "stretch"}))
    found, expected = (
        ma.derivatives(replace(free, model=model), 0.0, free.initial_state()).matrix
        for model in (free.model.with_held_control(), free.model)
    )
    np.testing.assert_array_equal(found, expected)


def test_two_laws_of_one_kind_have_their_derivatives_each_in_its_own_memory():
    ma.register_control(Twice)
    stated, differences = (
        ma.compile_system(scene_of({"kind": "twice", "stated": stated}, gravity=[0, 0, -9.81]))
        for stated in (True, False)
    )
    state = stated.initial_state()
    found, expected = (ma.derivatives(s, 0.0, state).matrix for s in (stated, differences))
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("samples", [{}, {"sample_time": 0.01}])
@pytest.mark.parametrize("step", [None, 0.01])
@pytest.mark.parametrize("answer", [7, CALLBACK_FAILED, KERNEL_FAILED])
def test_what_a_law_returns_beside_success_ends_the_run_and_is_in_its_message(
    samples, step, answer
):
    ma.register_control(GiveUp)
    run = {**RUN, **({"step": step, "integrator": "rk4"} if step else {})}
    if step:
        del run["accuracy"]
    system = ma.compile_system(scene_of({"kind": "give_up", "answer": answer, **samples}, run=run))
    ended = ma.simulate(system, certificate=False)
    assert ended.status == "failed" and 0.039 < ended.time[-1] < 0.061
    assert f"control law `give_up` returned {answer};" in ended.message


def test_what_the_derivative_of_a_law_returns_beside_success_is_an_error():
    ma.register_control(GiveUp)
    system = ma.compile_system(scene_of({"kind": "give_up"}))
    with refused(SolverError, "refuse_derivative"):
        ma.derivatives(system, 0.0, system.initial_state())


@pytest.mark.parametrize(
    "samples", [{}, {"sample_time": 0.01}, {"sample_time": 0.01, "sample_delay": True}]
)
@pytest.mark.parametrize("kind", ["class", "function", "file"])
def test_a_control_in_python_drives_as_a_controller_that_is_given(kind, samples, tmp_path):
    ma.register_control(Pull)
    (tmp_path / "pulls.py").write_text(
        "def pull(t, state):\n"
        "    return {arm: -5.0 * q for arm, q in state.joint_positions.items()}\n"
    )
    control = {
        "class": {"kind": "pull", "stiffness": 5.0},
        "function": {"function": pull},
        "file": {"function": f"{tmp_path}/pulls.py:pull"},
    }[kind]
    expected = run_of({"kind": "none"}, pull, **samples)
    own = run_of({**control, **samples})
    require_equal(own, expected)
    assert own.provenance["control"] == ("pull" if kind == "class" else "function")


def test_every_data_has_its_own_instance_and_threads_give_the_numbers_of_one():
    ma.register_control(Pull)
    scene = scene_of({"kind": "pull", "stiffness": 5.0}, run={**RUN, "arms": "compiled"})
    system = ma.compile_system(scene)
    first, second = Data(system.model), Data(system.model)
    owners = {id(data.callbacks["control"].function.__self__) for data in (first, second)}
    assert len(owners) == 2 and id(scene.control) not in owners
    values = [{"control.stiffness": k} for k in (5.0, 2.0, 5.0)]
    runs = ma.simulate_many(system, parameters=values, threads=2, certificate=False)
    single = [ma.simulate(ma.compile_system(scene.replace(v)), certificate=False) for v in values]
    for found, expected in zip(runs, single, strict=True):
        require_equal(found, expected)
    assert not np.array_equal(runs[0].object_position, runs[1].object_position)
    assert scene.control._calls == 0


def test_a_run_with_a_control_in_python_is_certified():
    ma.register_control(Pull)
    run = ma.simulate(ma.compile_system(scene_of({"kind": "pull", "stiffness": 5.0})))
    assert run.status == "completed" and run.certificate["met"]


def test_a_stepper_and_a_controller_in_its_place_take_the_control_of_the_scene():
    ma.register_control(Pull)
    system = ma.compile_system(scene_of({"kind": "pull", "stiffness": 5.0, "sample_time": 0.01}))
    run, stepper = ma.simulate(system, certificate=False), ma.Stepper(system)
    states = [stepper.advance(0.01).object_position for _ in range(10)]
    np.testing.assert_array_equal(states[-1], run.object_position[-1])

    def brake(_t, state):
        return {"left": -state.joint_velocities["left"]}

    braked = ma.simulate(system, control=brake, certificate=False)
    require_equal(braked, run_of("none", brake))


# --- finding --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_kind_of_ours_has_a_sentence_an_example_and_a_law():
    for name, own in BUILT_IN.items():
        assert own.picture and own.sample().kind == name
        assert (
            parse_scene(dump_scene(scene_of(own.sample()))).control
            == scene_of(own.sample()).control
        )
        assert (own in PROGRAMS) == (name != "none")
    ours = Scene.model_json_schema()["properties"]["control"]["anyOf"][0]
    assert set(ours["discriminator"]["mapping"]) == set(BUILT_IN)


def test_a_scene_with_one_is_written_read_again_and_changed():
    ma.register_control(Pull)
    scene = scene_of({"kind": "pull", "stiffness": 5.0, "sample_time": 0.01})
    assert parse_scene(dump_scene(scene)) == scene
    softer = scene.replace({"control.stiffness": 2.0})
    assert softer.control == Pull(stiffness=2.0, sample_time=0.01)
    assert scene_of(Pull(stiffness=5.0, sample_time=0.01)) == scene


def test_an_installed_kind_is_loaded_when_a_scene_file_is_compiled(tmp_path, monkeypatch):
    ma.register_control(Pull)
    text = dump_scene(scene_of({"kind": "pull", "stiffness": 5.0}))
    CONTROLS.registered.clear()
    offered(monkeypatch, f"controls pull {__name__}:Pull")
    path = tmp_path / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    scene = ma.load_scene(path)
    (code,) = named_code(scene)
    assert code.place == "$.control.kind" and f"({__name__}:Pull)" in code.what
    assert CONTROLS.registered == {} and dump_scene(scene) == text
    strict = ma.load_scene(path, code=False)
    for same in (strict, strict.replace(name="other"), parse_scene(text, code=False)):
        for other in (same, same.replace({"control.stiffness": 2.0})):
            with refused(ma.MultiarmError, "$.control.kind"):
                ma.compile_system(other)
            assert CONTROLS.registered == {}
    looked = multiarm("check", path)
    assert looked.exit_code == 0, looked.output
    assert "control kind 'pull'" in " ".join(looked.output.split()) and CONTROLS.registered == {}
    assert ma.compile_system(scene).scene.control == Pull(stiffness=5.0)
    path.write_text(text.replace("stiffness:", "stifness:"), encoding="utf-8")
    CONTROLS.registered.clear()
    scene = ma.load_scene(path)
    with refused(ma.MultiarmError, "$.control.stifness"):
        ma.compile_system(scene)


@pytest.mark.slow
def test_a_stored_run_is_looked_at_and_replayed_without_the_class(tmp_path):
    ma.register_control(Pull)
    run_of({"kind": "pull", "stiffness": 5.0, "sample_time": 0.01}).save(tmp_path / "run.h5")
    CONTROLS.registered.clear()
    run = ma.load_trajectory(tmp_path / "run.h5")
    assert dump_scene(run.scene) == run.scene_text and run.scene.control.kind == "pull"
    ma.replay(run, tmp_path / "run.html", open_browser=False, meshes=False)
    ma.report(run, tmp_path / "report.html")
    for code in (None, True):
        with refused(ma.MultiarmError, "$.control.kind"):
            ma.compile_system(run.scene, code=code)
    ma.register_control(Pull)
    again = ma.load_trajectory(tmp_path / "run.h5").scene
    require_equal(ma.simulate(ma.compile_system(again), certificate=False), run)


@pytest.mark.slow
def test_workers_of_a_sweep_know_those_that_were_registered_here():
    class Firm(Pull):
        example = ""
        kind: Literal["firm"] = "firm"
        stiffness: float = 10.0

    for own in (Pull, Firm):
        ma.register_control(own)
    over = {"control": [{"kind": "pull", "stiffness": 5.0}, {"kind": "firm"}]}
    plan = make_plan(scene_of("none"), over, keep=["final_z"], run=RUN)
    context, jobs = Context.of(plan), jobs_of(plan)
    here = repeatable(run_here(context, jobs))
    assert [row["status"] for row in here] == ["completed"] * 2
    assert repeatable(run_in_processes(context, jobs, 2)) == here


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "control",
    [
        {"kind": "pul"},
        {"kind": "pul"},
        {"stiffness": 1.0},
        {"kind": "pull"},
        {"kind": "pull", "stiffness": "x"},
        {"kind": "pull", "stiffness": 1, "sample_delay": True},
        {"kind": "push", "pushes": {"lefd": 1.0}},
        {"function": 3},
        {"function": "none.py:pull"},
        {"kind": "function"},
    ],
)  # fmt: skip
def test_faults_of_a_scene_have_their_place(control, tmp_path):
    for own in (Pull, Push):
        ma.register_control(own)
    with refused(ma.MultiarmError, "$.control"):
        ma.compile_system(scene_of(control))


def test_a_function_of_a_scene_file_lies_in_its_folder(tmp_path):
    (tmp_path / "elsewhere.py").write_text("raise RuntimeError('loaded')")
    (tmp_path / "scenes").mkdir()
    path = tmp_path / "scenes" / "scene.yaml"
    text = dump_scene(scene_of("none")) + "control: {function: '../elsewhere.py:pull'}\n"
    path.write_text(text, encoding="utf-8")
    with refused(ma.MultiarmError, "$.control.function"):
        ma.load_scene(path)


def pushes_of(torque):
    """The same torque at twelve joints."""
    return Pushes(1.0, np.full(12, torque))


@pytest.mark.parametrize(
    "body",
    [
        {"torques": lambda self, t, state: 1 / 0},
        {"torques": lambda self, t, state: {"lefd": 1}},
        {"torques": lambda self, t, state: {"left": 1}},
        {"build": lambda self, c: 1 / 0},
        {"build": lambda self, c: 3},
        {"build": lambda self, c: ControlProgram((push,))},
        {"build": lambda self, c: ControlProgram((push,), parameters=np.zeros(12))},
        {"build": lambda self, c: ControlProgram((ControlLaw(pull),))},
        {"build": lambda self, c: ControlProgram((ControlLaw(push, np.zeros(12)),))},
        {"build": lambda self, c: ControlProgram((ControlLaw(push, pushes_of(np.nan)),))},
        {"build": lambda self, c: ControlProgram((ControlLaw(push, pushes_of(1)),))},
        {"build": lambda self, c: ControlProgram((ControlLaw(push, Pushes(1.0, np.eye(12))),))},
        {"build": lambda self, c: ControlProgram((ControlLaw(push, Pushes("1", np.ones(12))),))},
        {"torques": pull, "faults": lambda self, arms: 1 / 0},
        {"build": lambda self, c: ControlProgram((ControlLaw(stretch),), reach=CARRYING)},
    ],
)
def test_what_a_class_does_wrong_is_one_clear_error(body):
    body = {"kind": "odd", "__annotations__": {"kind": Literal["odd"]}, **body}
    ma.register_control(type("Odd", (ma.Control,), {"__module__": __name__, **body}))
    with refused(ma.MultiarmError, "'odd'"):
        ma.evaluate(ma.compile_system(scene_of({"kind": "odd"})))


@pytest.mark.parametrize(
    "body",
    [
        {"__annotations__": {}},
        {"torques": ma.Control.torques},
        {"example": "control: {kind: odd, speed: 1}"},
        {"kind": "joint_pd", "__annotations__": {"kind": Literal["joint_pd"]}},
    ],
)
def test_what_a_class_lacks_is_named_when_it_is_registered(body):
    body = {"kind": "odd", "__annotations__": {"kind": Literal["odd"]}, "torques": pull, **body}
    if not body["__annotations__"]:
        del body["kind"]
    own = type("Odd", (ma.Control,), {"__module__": __name__, **body})
    with refused(ma.MultiarmError, "Odd" if body.get("kind") != "joint_pd" else "'joint_pd'"):
        ma.register_control(own)
    with refused(ma.MultiarmError, "Scene"):
        ma.register_control(Scene)


class Seen(ma.Control):
    """No torques; it shows the system for which it was built."""

    kind: Literal["seen"] = "seen"
    seen: ClassVar[dict[str, Any]] = {}

    def build(self, context):
        """Keep the motions that the joints leave free."""
        self.seen["free"] = {arm: frame.free for arm, frame in context.data.model.frames.items()}
        return ControlProgram()


def test_a_control_is_built_for_the_free_motions_that_assembly_finds():
    """Those of listed contacts are known at the assembled start only."""
    ma.register_control(Seen)
    system = ma.compile_system(two_arm_block(torques=False).replace(control={"kind": "seen"}))
    free = {arm: frame.free for arm, frame in system.frames.items()}
    assert [len(components) for components in free.values()] == [2, 3]
    assert Seen.seen["free"] == free
