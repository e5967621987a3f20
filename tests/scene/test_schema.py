"""Claims about the schema for editors: it accepts what loads, and refuses what does not."""

from __future__ import annotations

import json
import re
from typing import Any, Literal

import pytest
import yaml
from commands import multiarm
from jsonschema import Draft202012Validator
from pydantic import Field
from refusals import refused
from repository import DATA, ROOT, SCENES

import multiarm as ma
from multiarm.cli.schema import schema_text
from multiarm.errors import SceneError, SweepError
from multiarm.geometry import Contact
from multiarm.geometry.records import plane, sphere
from multiarm.scene import EFFECTS, JOINTS, SURFACES, parse_scene
from multiarm.scene.control import RecordedControl
from multiarm.scene.joints import BUILT_IN
from multiarm.scene.loading import parse_yaml
from multiarm.scene.parameters import example_of, parameters_of
from multiarm.scene.run import StabilizationSpec
from multiarm.scene.surfaces import SurfaceGeometry
from multiarm.sweeps.spec import parse_sweep

FILES = {
    "scene": SCENES / "scene.schema.json",
    "sweep": ROOT / "examples" / "sweeps" / "sweep.schema.json",
}
EXAMPLES = sorted((ROOT / "examples").glob("s*/*.yaml"))
GOLDEN = json.loads((DATA / "golden_scenes.json").read_text(encoding="utf-8"))
SCENE = """
object: {shape: {box: [0.6, 0.5, 0.4]}, mass: 5.0}
arms: {left: {robot: textbook_6r, tip: tool}}
joints: [{arm: left, kind: weld}]
"""


def stored(sort: str) -> dict:
    return json.loads(FILES[sort].read_text(encoding="utf-8"))


def faults(data: Any, sort: str = "scene", schema: dict | None = None) -> list[str]:
    """Places that an independent validator finds wrong."""
    validator = Draft202012Validator(schema or stored(sort))
    return [error.json_path for error in validator.iter_errors(data)]


def scene_with(**parts: str) -> dict:
    """A scene with some parts in place of its own, as YAML."""
    return {**yaml.safe_load(SCENE), **{name: parse_yaml(text) for name, text in parts.items()}}


@pytest.mark.parametrize("sort", FILES)
def test_stored_schema_is_what_the_command_writes(sort):
    assert json.loads(schema_text(sort, built_in=True)[0]) == stored(sort), (
        f"write it again: multiarm schema {sort} --built-in --out {FILES[sort].relative_to(ROOT)}"
    )


@pytest.mark.parametrize("sort", FILES)
def test_schema_is_one_of_the_draft_that_it_names(sort):
    schema = stored(sort)
    assert schema["$schema"] == Draft202012Validator.META_SCHEMA["$id"]
    Draft202012Validator.check_schema(schema)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_name_their_schema_and_fit(path):
    text = path.read_text(encoding="utf-8")
    named = re.match(r"# yaml-language-server: \$schema=(\S+)\n", text)
    schema = json.loads((path.parent / named[1]).read_text(encoding="utf-8"))
    assert faults(parse_yaml(text), schema=schema) == []


@pytest.mark.parametrize("name", GOLDEN)
def test_scenes_of_all_sorts_fit(name):
    assert faults(GOLDEN[name]["scene"]) == []


@pytest.mark.parametrize("kind", BUILT_IN)
def test_examples_of_joints_fit(kind):
    (entry,) = yaml.safe_load(example_of(BUILT_IN[kind]))["joints"]
    assert faults({**yaml.safe_load(SCENE), "joints": [entry]}) == []


@pytest.mark.parametrize(
    ("part", "text"),
    [
        ("control", "gravity_compensation"),
        ("control", "none"),
        ("control", "null"),
        ("control", "{kind: joint_pd, stiffness: 10, damping: {left: [1, 1, 1, 1, 1, 1]}}"),
        ("control", "{kind: computed_torque, damping: {translation: [1, 2, 3], rotation: 1}}"),
        ("control", "{kind: computed_torque, stiffness: 4}"),
        ("effects", "{joint_damping: urdf, joint_friction: 0.1}"),
        ("effects", "{joint_damping: {left: urdf}, joint_friction: {left: urdf}}"),
        ("effects", "{joint_friction: {torque: 0.1, model: set_valued}}"),
        ("effects", "{actuator_lag: {left: 0.01}}"),
        ("effects", "{contact_friction: 0.5, joint_limits: urdf, contact_compliance: 1e5}"),
        ("effects", "{drag: {linear: 3}, floor: {}, external_wrenches: null}"),
        ("effects", "{external_wrenches: [{on: object, function: 'pull.py:pull'}]}"),
        ("run", "{accuracy: 1e-6, stabilization: feedback}"),
        ("run", "{accuracy: {position: 1e-6}, stabilization: {kind: feedback, alpha: 10}}"),
        ("object", "{shape: {sphere: 0.2}, mass: 1, inertia: [1, 1, 1], color: '#ff8800'}"),
        ("object", "{shape: {mesh: {file: a.stl, scale: 2}}, mass: 1, inertia: [1, 1, 1]}"),
        ("object", "{shape: {sphere: 0.2}, mass: 1, inertia: [1, 0, 0, 1, 0, 1]}"),
        ("robots", "{r: {robot: tiago_pro, base: {moves: [x, yaw], limits: {x: [0, 1]}}}}"),
        ("robots", "{r: {mjcf: r.xml, tips: {a: hand}, mimic: {j: {of: k}}, posture: solve}}"),
        ("joints", "[{between: [object, world], kind: ball, at_first: {}, name: pivot}]"),
        ("arms", "{left: {robot: textbook_6r, tip: tool, posture: {joint_1: 0.1}}}"),
        ("arms", "{left: {robot: textbook_6r, tip: tool, posture: [0.1], color: [1, 0, 0]}}"),
    ],
)  # fmt: skip
def test_what_scenes_may_abbreviate_fits(part, text):
    assert faults(scene_with(**{part: text})) == []


@pytest.mark.parametrize(
    ("part", "text", "place"),
    [
        ("gravity", "[0, 0]", "$.gravity"),
        ("gravity", "down", "$.gravity"),
        ("control", "gravity", "$.control"),
        ("control", "joint_pd", "$.control"),
        ("control", "{kind: constant}", "$.control"),
        ("robots", "{r: {robot: ur5, base: {moves: [roll]}}}", "$.robots.r.base.moves"),
        ("robots", "{r: {robot: ur5, mimic: {j: {}}}}", "$.robots.r.mimic.j"),
        ("joints", "[{kind: weld}]", "$.joints[0]"),
        ("joints", "[{kind: weld, arm: left, between: [left, world]}]", "$.joints[0]"),
        ("joints", "[{kind: weld, between: [left]}]", "$.joints[0]"),
        ("joints", "[{arm: left}]", "$.joints[0]"),
        ("joints", "[{arm: left, kind: welt}]", "$.joints[0]"),
        ("joints", "[{arm: left, kind: ball, sise: 1}]", "$.joints[0]"),
        ("effects", "{drga: {linear: 1}}", "$.effects"),
        ("effects", "{joint_damping: udrf}", "$.effects.joint_damping"),
        ("effects", "{joint_friction: urfd}", "$.effects.joint_friction"),
        ("effects", "{floor: {mu: -1}}", "$.effects.floor"),
        ("run", "{duration: 0}", "$.run.duration"),
        ("run", "{duration: '1 s'}", "$.run.duration"),
        ("run", "{accuracy: 0}", "$.run.accuracy"),
        ("run", "{integrator: euler}", "$.run.integrator"),
        ("run", "{stabilization: feedbak}", "$.run.stabilization"),
        ("object", "{shape: {box: [1, 1]}, mass: 1}", "$.object.shape.box"),
        ("object", "{shape: {}, mass: 1}", "$.object.shape"),
        ("object", "{shape: {box: [1, 1, 1]}}", "$.object"),
        ("object", "{shape: {box: [1, 1, 1]}, mass: -1}", "$.object.mass"),
        ("object", "{shape: {box: [1, 1, 1]}, mass: 1, color: red}", "$.object.color"),
        ("arms", "{left: {robot: textbook_6r, tip: [tool]}}", "$.arms.left.tip"),
        ("speed", "1", "$"),
    ],
)
def test_what_does_not_load_does_not_fit(part, text, place):
    data = scene_with(**{part: text})
    assert any(found.startswith(place) for found in faults(data))
    with pytest.raises(SceneError):
        parse_scene(data)


@pytest.mark.parametrize(
    ("data", "fits"),
    [
        ({"over": {"object.mass": [1, 2]}}, True),
        ({"over": {"object.mass": {"linspace": [1, 2, 3]}}, "keep": ["wall_time", "f.py:g"]}, True),
        ({"over": {"a, b": {"rows": [[1, 2]]}}, "keep": [{"function": "f.py:g"}]}, True),
        ({"over": {"object.mass": {"normal": {"mean": 0, "deviation": 1}}}, "repeat": 3}, True),
        ({"over": {"object.mass": 3}}, False),
        ({"over": {"object.mass": {"linspace": [1, 2, 3], "values": [1]}}}, False),
        ({"over": {"object.mass": [1]}, "keep": ["wall time"]}, False),
        ({"over": {"object.mass": [1]}, "repeat": 0}, False),
        ({"over": {"object.mass": [1]}, "combine": "both"}, False),
        ({"repeat": 1}, False),
    ],
)
def test_sweeps_that_load_fit_and_others_do_not(data, fits):
    assert (faults(data, "sweep") == []) is fits
    if fits:
        parse_sweep(data)
    else:
        with pytest.raises(SweepError):
            parse_sweep(data)


def test_no_text_explains_two_keys_of_a_part():
    for name, part in stored("scene")["$defs"].items():
        texts = [key["description"] for key in part.get("properties", {}).values()
                 if "description" in key]  # fmt: skip
        assert len(set(texts)) == len(texts), name


def test_keys_of_one_dimension_have_one_unit():
    units = {
        (part, key.name): key.unit
        for part in (RecordedControl, StabilizationSpec, SurfaceGeometry)
        for key in parameters_of(part)
    }
    assert units[RecordedControl, "stiffness"] == "N m/rad"
    assert units[RecordedControl, "damping"] == "N m s/rad"
    assert units[StabilizationSpec, "alpha"] == units[StabilizationSpec, "beta"] == "1/s"
    assert units[SurfaceGeometry, "hessian"] == "1/m"


def test_tables_explain_their_keys_with_units():
    tables = stored("scene")["$defs"]
    assert tables["RunSpec"]["properties"]["duration"]["description"] == "Simulated time [s]."
    assert "[kg m^2]" in tables["ObjectSpec"]["properties"]["inertia"]["description"]
    silent = [
        f"{name}.{key}"
        for name, table in tables.items()
        for key, own in table.get("properties", {}).items()
        if key != "kind" and "description" not in own
    ]
    assert silent == []


@pytest.fixture
def user_kinds(monkeypatch):
    """One user class of each sort, as if registered."""

    class Latch(ma.Joint):
        """A latch.

        Attributes
        ----------
        travel : float
            How far it gives [m].
        """

        kind: Literal["latch"] = "latch"
        travel: float

        def records(self):
            return [Contact("tip", sphere([0, 0, 0], 0.0), plane([0, 0, 0], [0, 0, 1]))]

    class Breeze(ma.Effect):
        """A breeze."""

        name = "breeze"

        class Spec(ma.Effect.Spec):
            """Its strength."""

            strength: float
            """How hard it blows [N]."""

    class Saddle(ma.Surface):
        """A saddle."""

        name = "saddle"
        bend: float = Field(description="How it bends [1/m].")

        def record(self):
            return plane([0, 0, 0], [0, 0, 1])

    for registry, own in ((JOINTS, Latch), (EFFECTS, Breeze), (SURFACES, Saddle)):
        monkeypatch.setitem(registry.registered, registry.name_of(own), own)


def test_user_kinds_have_their_place_with_their_parameters(user_kinds):
    schema = json.loads(schema_text("scene")[0])
    joint = "[{arm: left, kind: latch, travel: 0.1}]"
    contact = (
        "[{arm: left, kind: contacts, contacts: [{arm: {point: [0, 0, 0]}, "
        "object: {saddle: {bend: 1}}}]}]"
    )
    for part, text in (
        ("joints", joint),
        ("effects", "{breeze: {strength: 2}}"),
        ("joints", contact),
    ):
        good = scene_with(**{part: text})
        assert faults(good, schema=schema) == []
        assert faults(good) != [], "the stored schema has built-in kinds only"
        worse = re.sub(r"(travel|strength|bend): [\d.]+", r"\1: much", text)
        assert faults(scene_with(**{part: worse}), schema=schema) != []
    assert faults(scene_with(effects="{breze: {strength: 2}}"), schema=schema) != []
    for documented in ("How far it gives [m].", "How hard it blows [N].", "How it bends [1/m]."):
        assert documented in json.dumps(schema["$defs"])


def test_a_missing_value_is_explained_by_how_its_documentation_begins(user_kinds):
    for part, text, meaning in (
        ("joints", "[{arm: left, kind: latch}]", "how far it gives [m]"),
        ("effects", "{breeze: {}}", "how hard it blows [N]"),
        ("object", "{shape: {sphere: 1}}", "its mass [kg]"),
    ):
        with refused(SceneError, f"({meaning})"):
            parse_scene(scene_with(**{part: text}))


def test_schema_goes_to_a_file_or_to_the_terminal_without_codes(tmp_path):
    path = tmp_path / "own.json"
    assert multiarm("schema", "sweep", "--out", path).exit_code == 0
    printed = multiarm("schema", "sweep", columns=40).stdout
    assert printed == path.read_text(encoding="utf-8")
    refused = multiarm("schema", "--out", tmp_path / "no" / "a.json")
    assert refused.exit_code == 2 and "there is no folder" in refused.stderr
