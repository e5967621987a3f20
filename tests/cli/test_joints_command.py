"""Claims about the catalogue as people read it: `multiarm joints`."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import yaml
from commands import command

from multiarm.cli.joint_cards import joint_section, surface_section
from multiarm.geometry.screws import free_motions, wrenches_in_frame
from multiarm.scene import ContactSpec, Geometry, Joint
from multiarm.scene.joints import BUILT_IN
from multiarm.scene.parameters import parameters_of

KINDS = sorted(BUILT_IN)
SURFACES = list(Geometry.model_fields)
# Constraint rows of the joints that mechanisms are made of, as textbooks count them.
ROWS = {
    "weld": 6, "revolute": 5, "prismatic": 5, "cylindrical": 4, "universal": 4, "ball": 3,
    "planar": 3, "point_on_plane": 1, "point_on_cylinder": 1, "point_on_sphere": 1,
    "corner_gripper": 4,
}  # fmt: skip
FREE_MOTIONS = {
    "weld": [],
    "ball": ["turn about x, y and z"],
    "revolute": ["turn about z"],
    "prismatic": ["slide along z"],
    "cylindrical": ["slide along z", "turn about z"],
    "universal": ["turn about x and y"],
    "planar": ["slide along x and y", "turn about z"],
    "point_on_plane": ["slide along x and y", "turn about x, y and z"],
    "corner_gripper": ["2 motions along several axes at once"],
}
LENGTHS = {"size", "radius", "tip_radius", "circle_radius", "tube_radius", "length"}

joints = command("joints", 100)


def flowing(text: str) -> str:
    """Text without line breaks and the columns' padding."""
    return " ".join(text.split())


@pytest.fixture(scope="module")
def cards():
    return joint_section().cards


def test_every_kind_and_surface_of_the_schema_is_in_the_catalogue(cards):
    assert set(cards) == set(BUILT_IN)
    assert list(surface_section().cards) == SURFACES


@pytest.mark.parametrize("name", sorted(SURFACES))
def test_every_example_of_a_surface_is_a_contact_with_it(name):
    (joint,) = yaml.safe_load(surface_section().cards[name].example)["joints"]
    (written,) = joint["contacts"]
    contact = ContactSpec.model_validate(written)
    shapes = {contact.arm.shape, contact.object.shape}
    assert name in shapes


@pytest.mark.parametrize("kind", sorted(ROWS))
def test_rows_are_those_of_the_textbook_and_all_independent(kind, cards):
    shown = cards[kind].further
    assert shown["rows"] == shown["rank"] == len(shown["row_names"]) == ROWS[kind]


@pytest.mark.parametrize("kind", sorted(FREE_MOTIONS))
def test_free_motions_are_those_of_the_textbook(kind, cards):
    assert cards[kind].further["free"] == FREE_MOTIONS[kind]


@pytest.mark.parametrize("kind", sorted(k for k, own in BUILT_IN.items() if own.free is not None))
def test_recorded_coordinates_are_the_free_motions(kind, cards):
    told = " ".join(cards[kind].further["free"])
    slides, turns = (re.search(f"{verb} ([xyz, and]+)", told) for verb in ("along", "about"))
    found = [k for k, axis in enumerate("xyz") if slides and axis in slides[1].replace("and", "")]
    found += [k for k, axis in enumerate("xyz", 3) if turns and axis in turns[1].replace("and", "")]
    assert tuple(found) == BUILT_IN[kind].free


def test_a_fingertip_on_a_round_face_slides_across_its_normal(cards):
    for kind in ("point_on_cylinder", "point_on_sphere"):
        assert cards[kind].further["free"] == ["slide along y and z", "turn about x, y and z"]


def test_wrenches_of_a_screw_leave_one_motion_along_and_about_its_axis(cards):
    screw = cards["wrenches"].further
    assert (screw["rows"], screw["rank"]) == (5, 5)
    assert screw["free"] == ["1 motion along several axes at once"]


def test_free_motions_are_found_in_any_frame_and_unit(rng):
    hinge = np.eye(6)[:, :5]  # all but the moment about z
    assert free_motions(hinge).words() == ["turn about z"]
    frame, turn = np.eye(4), np.linalg.qr(rng.standard_normal((3, 3)))[0]
    frame[:3, :3], frame[:3, 3] = turn * np.linalg.det(turn), [1.0, -2.0, 0.5]
    moved = wrenches_in_frame(np.linalg.inv(frame), hinge @ rng.standard_normal((5, 5)))
    back = wrenches_in_frame(frame, moved) * 10.0 ** rng.uniform(-6, 6, 5)
    assert free_motions(back).words() == ["turn about z"]
    doubled = free_motions(np.column_stack([hinge, 3.0 * hinge[:, 1]]))
    assert doubled.rank == 5
    assert doubled.independent.tolist() == [True, False, True, True, True, False]


def test_a_force_through_a_frame_has_no_moment_in_it(rng):
    frame, force = np.eye(4), rng.standard_normal(3)
    frame[:3, :3] = np.eye(3)[[1, 2, 0]]
    frame[:3, 3] = at = np.array([1.0, -2.0, 0.5])
    seen = wrenches_in_frame(frame, np.concatenate([force, np.cross(at, force)])[:, None])[:, 0]
    np.testing.assert_allclose(seen, [*(frame[:3, :3].T @ force), 0, 0, 0], atol=1e-15)


def test_parameters_carry_the_defaults_of_the_schema(cards):
    for kind, model in BUILT_IN.items():
        for parameter in cards[kind].parameters:
            field = model.model_fields[parameter.name]
            if parameter.default in ("required", "none", "identity"):
                assert field.is_required() == (parameter.default == "required")
                continue
            shown = yaml.safe_load(parameter.default)
            assert json.loads(json.dumps(field.default)) == shown


def test_every_parameter_has_a_meaning_and_every_length_a_unit(cards):
    owners = [*cards.values(), *surface_section().cards.values()]
    parameters = [(owner, p) for owner in owners for p in owner.parameters]
    parameters += [("all", p) for p in [*parameters_of(Joint), *parameters_of(ContactSpec)]]
    assert len(parameters) > 40
    for owner, parameter in parameters:
        assert parameter.meaning, (owner, parameter)
        assert parameter.unit == "m" or parameter.name not in LENGTHS, (owner, parameter)


def test_contacts_are_told_from_the_records(cards):
    assert cards["weld"].further["made_of"] == "6 points on 3 planes"
    assert cards["revolute"].further["made_of"] == "4 points on a cylinder, 1 point on a plane"
    assert "hollow sphere" in cards["point_on_sphere"].further["made_of"]
    assert "2 directions without slip" in cards["contacts"].further["made_of"]


def test_surfaces_are_a_section_of_their_own():
    result = joints("surfaces")
    assert result.exit_code == 0, result.output
    for word in (*SURFACES, "half_angle", "rolling", "patch"):
        assert word in result.stdout
    assert "door hinge" not in result.stdout


def test_file_that_cannot_be_written_is_found_first(tmp_path):
    result = joints("--json", tmp_path / "no" / "a.json")
    assert result.exit_code == 2 and "there is no folder" in result.stderr
