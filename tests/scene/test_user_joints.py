"""Claims about joints and surfaces of one's own: they move as ours do, are found, and refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
import pytest
from commands import multiarm
from mechanics import kernel_rows, random_pose, ur5_pair
from refusals import refused
from sweep_runs import jobs_of, repeatable
from user_classes import empty_registries, offered

import multiarm as ma
from multiarm.errors import SceneError
from multiarm.geometry import (
    Contact,
    ParametricSurface,
    SignedDistanceSurface,
    plane,
    point,
    smooth,
    sphere,
)
from multiarm.scene import (
    REGISTRIES,
    Geometry,
    dump_scene,
    named_code,
    parse_scene,
)
from multiarm.simulation.inspection import inspect_system
from multiarm.spatial import matrix_to_quaternion
from multiarm.sweeps.executors import run_here, run_in_processes
from multiarm.sweeps.plan import make_plan
from multiarm.sweeps.run import Context

RUN = {"duration": 0.1, "accuracy": 1e-6}


@pytest.fixture(autouse=True)
def _only_ours(monkeypatch):
    empty_registries(monkeypatch)


class Hitch(ma.Joint):
    """A ball joint, written as ours is.

    Attributes
    ----------
    width : float
        How wide it looks [m].
    """

    picture = "the coupling of a trailer"
    example = "width: 0.2"
    free = (3, 4, 5)

    kind: Literal["hitch"] = "hitch"
    width: float = 0.1

    def records(self):
        """Three planes through one point."""
        zero, names = np.zeros(3), ("ball 1", "ball 2", "ball 3")
        return [
            Contact(name, point(zero), plane(zero, normal))
            for name, normal in zip(names, np.eye(3), strict=True)
        ]


class Egg(ma.Surface):
    """An ellipsoid by its parametrisation, whose poles lie on the x axis."""

    name = "egg"
    picture = "a boiled egg"
    example = "object: {egg: {half: [0.1, 0.07, 0.05]}}"

    half: tuple[float, float, float]

    def record(self):
        """Outward normal: x_u x x_v."""
        a, b, c = self.half

        def at(u, v):
            return np.array([a * np.sin(v), b * np.cos(u) * np.cos(v), c * np.sin(u) * np.cos(v)])

        return smooth(
            ParametricSurface(at, (-math.pi, math.pi), (-1.4, 1.4), length=min(self.half))
        )


class Marble(ma.Surface):
    """A sphere by its signed distance."""

    name = "marble"

    radius: float
    inside: bool = False

    def record(self):
        """The distance of its centre, less the radius."""

        def distance(p):
            return (p @ p) ** 0.5 - self.radius

        return smooth(SignedDistanceSurface(distance, length=self.radius), inside=self.inside)


class Rest(ma.Joint):
    """A fingertip on an egg, both of its own parameters."""

    example = """
    egg: {half: [0.1, 0.07, 0.05]}
    at: {xyz: [0, 0, -0.05]}"""
    drawn_as = "surfaces"

    kind: Literal["rest"] = "rest"
    egg: Egg

    def records(self):
        """One contact, which only pushes."""
        return [Contact("tip", sphere([0, 0, 0], 0.01), self.egg.record(), pushes_only=True)]

    def offset(self):
        """The egg's centre below the tip."""
        return np.array([0.0, 0.0, -0.01 - self.egg.half[2]])


def scene_of(left: dict, **more):
    return ur5_pair(left, {"kind": "weld"}, run=RUN, name="two arms", **more)


def touching(geometry: dict, **more) -> dict:
    """A joint of a fingertip on a surface about the joint frame."""
    contact = {"arm": {"sphere": {"radius": 0.01, "center": [0, 0, 0.06]}}, "object": geometry}
    return {"kind": "contacts", "at": {"xyz": [-0.6, 0, 0]}, "contacts": [{**contact, **more}]}


def joint_of(records, kind: str = "odd", **body):
    """A registered kind with these records."""
    body = {"kind": kind, "__annotations__": {"kind": Literal[kind]}, "records": records, **body}
    return ma.register_joint(type(f"Own{kind}", (ma.Joint,), {"__module__": __name__, **body}))


class Rail(ma.Joint):
    """Slides along x, not along the axis z, from some way on."""

    example = """
    reach: [-0.1, 0.2]
    at: {xyz: [0, 0, 0]}"""
    free = (0,)
    limited: ClassVar[dict[str, int]] = {"reach": 0}

    kind: Literal["rail"] = "rail"
    reach: tuple[float, float] | None = None
    begin: float = 0.0

    def records(self):
        """Two points on a line along x, and one beside it."""
        places = {"y": ([0, 0, 0], [0.1, 0, 0]), "z": ([0, 0, 0], [0.1, 0, 0], [0, 0.1, 0])}
        normals = {"y": [0, 1, 0], "z": [0, 0, 1]}
        return [
            Contact(f"{axis} {k}", point(at), plane(at, normals[axis]))
            for axis, points in places.items()
            for k, at in enumerate(points)
        ]

    def offset(self):
        """Of the object from the tip, along the rail."""
        return np.array([self.begin, 0.0, 0.0])


# --- mechanics ------------------------------------------------------------------------------------


def test_a_ball_of_one_s_own_moves_bit_for_bit_as_ours():
    ma.register_joint(Hitch)
    own, ours = (
        ma.simulate(ma.compile_system(scene_of({"kind": kind}))) for kind in ("hitch", "ball")
    )
    assert np.ptp(ours.object_position, axis=0).max() > 1e-4, "it moves"
    assert own.channels == ours.channels and own.events == ours.events
    for name in ours.channels:
        np.testing.assert_array_equal(own.read(name), ours.read(name), err_msg=name)
    assert own.relative_motion_labels == ours.relative_motion_labels


@pytest.mark.parametrize(
    ("own", "ours"),
    [
        ({"egg": {"half": [0.1, 0.07, 0.05]}}, {"ellipsoid": {"semi_axes": [0.1, 0.07, 0.05]}}),
        ({"marble": {"radius": 0.05}}, {"sphere": {"radius": 0.05}}),
    ],
    ids=["parametrisation", "signed distance"],
)
def test_rows_of_a_surface_of_one_s_own_are_those_of_ours(own, ours, rng):
    for surface in (Egg, Marble):
        ma.register_surface(surface)
    rolling = [scene_of(touching(g, rolling=True)).joints[0].placed(np.eye(4)) for g in (own, ours)]
    for _ in range(4):
        X_WO, shift = random_pose(rng), np.eye(4)
        shift[:3, 3] = rng.uniform(-0.01, 0.01, 3)
        twists = rng.normal(size=(2, 6))
        found, exact = (kernel_rows(rows, X_WO @ shift, X_WO, *twists) for rows in rolling)
        np.testing.assert_allclose(found.W_o, exact.W_o, atol=1e-9)
        np.testing.assert_allclose(found.phi, exact.phi, atol=1e-12)
        np.testing.assert_allclose(found.c, exact.c, atol=1e-6 * np.abs(exact.c).max())


def test_a_joint_of_one_s_own_on_a_surface_of_one_s_own_moves_as_ours_do():
    ma.register_joint(Rest)
    half = [0.1, 0.07, 0.05]
    own = scene_of({"kind": "rest", "egg": {"half": half}})
    pose = ma.compile_system(own).model.joints["left"].frame.on_object
    at = {"xyz": pose[:3, 3].tolist(), "quaternion_xyzw": _quaternion(pose[:3, :3])}
    tip = {"arm": {"sphere": {"radius": 0.01}}, "object": {"ellipsoid": {"semi_axes": half}}}
    ours = scene_of({"kind": "contacts", "at": at, "contacts": [{**tip, "name": "tip"}]})
    found, exact = (ma.simulate(ma.compile_system(scene)) for scene in (own, ours))
    assert np.ptp(exact.object_position, axis=0).max() > 1e-4, "it moves"
    np.testing.assert_allclose(found.object_position, exact.object_position, atol=1e-7)
    force = np.abs(exact.contact_forces["left"]).max()
    np.testing.assert_allclose(
        found.contact_forces["left"], exact.contact_forces["left"], atol=1e-4 * force
    )


def _quaternion(rotation) -> list[float]:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_quat().tolist()


# --- how they are found ---------------------------------------------------------------------------


def test_they_appear_in_the_list_and_in_full(tmp_path):
    ma.register_joint(Hitch)
    ma.register_surface(Egg)
    listed = multiarm("joints", "--json", tmp_path / "all.json")
    assert listed.exit_code == 0, listed.output
    for word in ("hitch", "the coupling of a trailer", "egg", "a boiled egg"):
        assert word in listed.stdout
    found = json.loads((tmp_path / "all.json").read_text(encoding="utf-8"))
    card, ball = found["joints"]["hitch"], found["joints"]["ball"]
    for key in ("rows", "rank", "free", "made_of", "row_names"):
        assert card[key] == ball[key]
    (width,) = card["parameters"]
    assert width == {
        "name": "width",
        "default": "0.1",
        "meaning": "How wide it looks.",
        "unit": "m",
    }
    assert card["example"].endswith("kind: hitch\n    width: 0.2")
    assert [p["name"] for p in found["surfaces"]["egg"]["parameters"]] == ["half", "patch"]
    one = multiarm("joints", "hitch")
    assert "turn about x, y and z" in one.stdout and "half" not in one.stdout


def test_a_kind_whose_free_motions_depend_on_the_scene_is_listed_too():
    ma.register_joint(Rest)
    one = multiarm("joints", "rest")
    assert one.exit_code == 0 and "depend on the scene" in one.stdout
    assert "1 fingertip on a surface" in one.stdout


def test_an_installed_one_is_listed_and_a_broken_one_is_a_warning(monkeypatch):
    offered(monkeypatch, f"joints hitch {__name__}:Hitch", "surfaces bomb not_there:Bomb")
    listed = multiarm("joints")
    assert listed.exit_code == 0 and "the coupling of a trailer" in listed.stdout
    assert "surface 'bomb': an installed package (not_there:Bomb) cannot be" in listed.stderr


def test_messages_offer_them_and_place_faults_of_their_parameters():
    ma.register_joint(Hitch)
    ma.register_surface(Egg)
    wrong = [
        (
            {"kind": "hich"},
            "$.joints[0].kind: unknown joint kind 'hich'; did you mean 'hitch'?",
        ),
        ({}, "$.joints[0]: 'kind' is missing; kinds are 'weld'"),
        ({"kind": "hitch", "widht": 1}, "$.joints[0].widht: unknown key 'widht'; did you mean 'wi"),
        ({"kind": "hitch", "width": "b"}, "$.joints[0].width: "),
        ({"kind": "hitch", "width": math.nan}, "$.joints[0].width: must be finite"),
        ({"kind": "hitch", "at": {"xyz": [0]}}, "$.joints[0].at.xyz: must be a list of 3 numbers"),
        (touching({"eg": {}}), "contacts[0].object.eg: unknown surface 'eg'; did you mean 'egg'?"),
        (touching({"egg": {}}), "$.joints[0].contacts[0].object.egg.half: is missing"),
        (touching({"egg": {"half": [1, 1]}}), "contacts[0].object.egg.half[2]: is missing"),
        (touching({"egg": None}), "contacts[0].object: needs exactly one of 'point'"),
    ]
    for joint, expected in wrong:
        with pytest.raises(ma.MultiarmError) as caught:
            scene_of(joint)
        (fault,) = caught.value.faults
        assert expected in fault


def test_a_scene_with_them_is_written_read_again_and_changed():
    ma.register_joint(Hitch)
    ma.register_surface(Egg)
    half = [0.1, 0.07, 0.05]
    for joint in ({"kind": "hitch", "width": 0.3}, touching({"egg": {"half": half}})):
        scene = scene_of(joint)
        assert parse_scene(dump_scene(scene)) == scene
    egg = scene.joints[0].contacts[0].object
    assert isinstance(egg, Geometry) and egg.value == Egg(half=half) and egg.shape == "egg"
    longer = scene.replace({"joints[0].contacts[0].object.egg.half[0]": 0.2})
    assert longer.joints[0].contacts[0].object.value.half == (0.2, 0.07, 0.05)
    wider = scene_of({"kind": "hitch"}).replace({"joints[0].width": 0.2})
    assert wider.joints[0] == Hitch(arm="left", width=0.2)


@pytest.mark.slow
def test_an_installed_class_is_loaded_when_a_scene_file_is_compiled(tmp_path, monkeypatch):
    ma.register_joint(Hitch)
    ma.register_surface(Marble)
    hitch, marble = {"kind": "hitch"}, touching({"marble": {"radius": 0.05}})
    texts = [dump_scene(scene_of(joint)) for joint in (hitch, marble)]
    places = "$.joints[0].kind", "$.joints[0].contacts[0].object.marble"
    for own in REGISTRIES:
        own.registered.clear()
    offered(monkeypatch, f"joints hitch {__name__}:Hitch", f"surfaces marble {__name__}:Marble")
    path = tmp_path / "scene.yaml"
    for text, place in zip(texts, places, strict=True):
        path.write_text(text, encoding="utf-8")
        scene = ma.load_scene(path)
        (code,) = named_code(scene)
        assert code.place == place and code.arm == "left" and f"({__name__}:" in code.what
        assert all(own.registered == {} for own in REGISTRIES)
        assert dump_scene(scene) == text
        with refused(ma.MultiarmError, "$.joints[0]"):
            ma.compile_system(ma.load_scene(path, code=False))
        looked = multiarm("check", path)
        assert looked.exit_code == 0, looked.output
        assert code.what.split(" of ")[0] in " ".join(looked.output.split())
        assert all(own.registered == {} for own in REGISTRIES)
        assert ma.compile_system(scene).contacts["left"]
        for own in REGISTRIES:
            own.registered.clear()


def test_a_fault_of_an_installed_class_has_its_place_when_it_is_loaded(tmp_path, monkeypatch):
    ma.register_joint(Hitch)
    text = dump_scene(scene_of({"kind": "hitch"})).replace("kind: hitch", "kind: hitch, widht: 1")
    offered(monkeypatch, f"joints hitch {__name__}:Hitch")
    registry_of(Hitch).registered.clear()
    path = tmp_path / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    scene = ma.load_scene(path)
    with refused(ma.MultiarmError, "$.joints[0].widht"):
        ma.compile_system(scene)


def registry_of(own: type):
    group = "joints" if issubclass(own, ma.Joint) else "surfaces"
    return next(one for one in REGISTRIES if one.group == f"multiarm.{group}")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("own", "joint"),
    [(Hitch, {"kind": "hitch"}), (Marble, touching({"marble": {"radius": 0.05}}))],
    ids=["joint", "surface"],
)
def test_a_stored_run_is_looked_at_and_replayed_without_the_class(own, joint, tmp_path):
    register = ma.register_joint if own is Hitch else ma.register_surface
    register(own)
    ma.simulate(ma.compile_system(scene_of(joint))).save(tmp_path / "run.h5")
    registry_of(own).registered.clear()
    run = ma.load_trajectory(tmp_path / "run.h5")
    assert dump_scene(run.scene) == run.scene_text
    with pytest.warns(UserWarning, match="need the (joint kind|surface) '.*' of a package that is"):
        ma.replay(run, tmp_path / "run.html", open_browser=False, meshes=False)
    assert (tmp_path / "run.html").stat().st_size > 1000
    for code in (None, True):
        with refused(ma.MultiarmError, "$.joints[0]"):
            ma.compile_system(run.scene, code=code)
    register(own)
    again = ma.load_trajectory(tmp_path / "run.h5").scene
    assert ma.compile_system(again).contacts["left"]


@pytest.mark.slow
def test_workers_of_a_sweep_know_those_that_were_registered_here():
    class Loose(Hitch):
        kind: Literal["loose"] = "loose"

    for own in (Hitch, Loose):
        ma.register_joint(own)
    over = {"joints[0].kind": ["hitch", "loose"]}
    plan = make_plan(scene_of({"kind": "ball"}), over, keep=["final_z"], run=RUN)
    context, jobs = Context.of(plan), jobs_of(plan)
    here = repeatable(run_here(context, jobs))
    assert len(here) == 2
    assert repeatable(run_in_processes(context, jobs, 2)) == here


# --- rolling in any order of the rows -------------------------------------------------------------


def two_contacts(*order: str, parent: str = "a") -> list[Contact]:
    """Rows of two contacts, of which the first one rolls along both tangents."""
    a, b = (
        Contact(name, point([x, 0, 0]), plane([x, 0, 0], [0, 0, 1]), pushes_only=True)
        for name, x in (("a", 0.0), ("b", 0.1))
    )
    tangents = {
        f"a{k}": replace(a, name=f"a{k}", tangent=k, parent=parent, pushes_only=False)
        for k in (1, 2)
    }
    rows = {"a": a, "b": b, **tangents}
    return [rows[name] for name in order]


ORDERS = [("a", "a1", "a2", "b"), ("a", "b", "a1", "a2"), ("b", "a", "a2", "a1")]


@pytest.mark.parametrize("order", ORDERS, ids=" ".join)
def test_the_contact_that_a_tangent_names_rolls_and_the_one_before_it_slides(order):
    joint_of(lambda self: two_contacts(*order))
    scene = scene_of({"kind": "odd", "mu": 0.3})
    mu = {contact.name: contact.mu for contact in scene.joints[0].placed(np.eye(4))}
    assert mu == {"a": None, "b": 0.3, "a1": None, "a2": None}
    opening = {"unilateral_contacts": {"contacts": ["left/a"]}}
    with pytest.raises(SceneError, match="contact 'left/a' rolls"):
        ma.compile_system(scene_of({"kind": "odd"}, effects=opening))


def test_forces_of_contacts_do_not_depend_on_the_order_of_the_rows():
    forces = []
    for number, order in enumerate(ORDERS):
        joint_of(lambda self, order=order: two_contacts(*order), kind=f"odd{number}")
        ev = ma.evaluate(ma.compile_system(scene_of({"kind": f"odd{number}"})))
        names = [name for name in order if name in ("a", "b")]
        normal = dict(zip(names, ev.normal_forces["left"], strict=True))
        tangential = dict(zip(names, ev.tangential_forces["left"], strict=True))
        forces.append([normal["a"], normal["b"], *tangential["a"], *tangential["b"]])
    assert np.abs(forces[0][2:4]).max() > 1e-3
    assert forces[0][4:] == [0.0, 0.0]
    for others in forces[1:]:
        np.testing.assert_allclose(others, forces[0], atol=1e-9 * np.abs(forces[0]).max())


def test_a_tangent_without_a_name_of_its_contact_belongs_to_the_one_before_it():
    joint_of(lambda self: two_contacts("b", "a", "a1", "a2", parent=""))
    placed = scene_of({"kind": "odd", "mu": 0.3}).joints[0].placed(np.eye(4))
    assert [contact.mu for contact in placed] == [0.3, None, None, None]


# --- what is refused ------------------------------------------------------------------------------


GOOD = [Contact("a", point(np.zeros(3)), plane(np.zeros(3), [0, 0, 1]))]


@pytest.mark.parametrize(
    "records",
    [
        lambda self: 1 / 0,
        lambda self: 3,
        lambda self: [3],
        lambda self: [],
        lambda self: [Contact("a", point([0, 0, math.nan]), GOOD[0].object)],
        lambda self: [Contact("a", 3, GOOD[0].object)],
        lambda self: [replace(GOOD[0], mu=-1.0)],
        lambda self: [replace(GOOD[0], name=None)],
        lambda self: [replace(GOOD[0], arm=sphere([0, 0, 0], -0.01))],
        lambda self: [replace(GOOD[0], minus=Contact("b", 3, 4))],
        lambda self: two_contacts("a", "b", "a1", parent="c"),
        lambda self: two_contacts("a1", "a"),
        lambda self: two_contacts("a1", "a", parent=""),
        lambda self: [GOOD[0], replace(GOOD[0], tangent=1, weight=2.0)],
        lambda self: [GOOD[0], replace(GOOD[0], tangent=1, minus=GOOD[0])],
    ],
)
def test_records_that_cannot_be_are_one_clear_error(records):
    joint_of(records)
    with refused(ma.MultiarmError, "joint of arm 'left'"):
        ma.compile_system(scene_of({"kind": "odd"}))


@pytest.mark.parametrize("offset", [3.0, [0, 0], [0, 0, math.inf]])
def test_an_offset_is_three_numbers(offset):
    joint_of(lambda self: GOOD, offset=lambda self: offset)
    with refused(ma.MultiarmError, "joint of arm 'left'"):
        ma.compile_system(scene_of({"kind": "odd"}))


@pytest.mark.parametrize("name", ["record", "shape", "copy"])
def test_a_surface_may_have_the_name_of_anything_else(name):
    ma.register_surface(type("Other", (Marble,), {"name": name}))
    scene = scene_of(touching({name: {"radius": 0.05}}))
    assert parse_scene(dump_scene(scene)) == scene
    assert len(scene.joints[0].placed(np.eye(4))) == 1


@pytest.mark.parametrize("free", [(3, 4), (0, 1, 2), (3, 3, 4)])
def test_motions_that_a_kind_calls_free_are_those_that_its_contacts_leave(free):
    joint_of(Hitch.records, free=free)
    with refused(ma.MultiarmError, "joint of arm 'left'"):
        ma.compile_system(scene_of({"kind": "odd"}))


def test_free_motions_of_a_joint_that_takes_hold_later_are_those_where_it_closes():
    """A point on the side of a ball, which is above it at the start."""
    on_ball = Contact("side", point([0.1, 0, 0]), sphere([0, 0, 0], 0.1))
    joint_of(lambda self: [on_ball], free=(1, 2, 3, 4, 5))
    weld = {"kind": "weld"}
    at = ma.compile_system(ur5_pair(weld, weld)).frames["right"].on_object.copy()
    at[:3, 3] += at[:3, :3] @ [0.1, 0.0, -0.4]
    place = {"xyz": at[:3, 3], "quaternion_xyzw": matrix_to_quaternion(at[:3, :3])}
    later = {"kind": "odd", "at": place, "from": 1.0}
    system = ma.compile_system(ur5_pair(weld, later))
    assert system.frames["right"].free == (1, 2, 3, 4, 5)


@pytest.mark.parametrize(
    "found",
    [lambda: 1 / 0, lambda: "egg"],
)
def test_a_surface_that_cannot_be_is_one_clear_error(found):
    odd = type("Odd", (ma.Surface,), {"name": "odd", "record": lambda self: found()})
    ma.register_surface(odd)
    with refused(ma.MultiarmError, "surface 'odd'"):
        ma.compile_system(scene_of(touching({"odd": {}})))


class Nameless(ma.Joint):
    """Says no kind."""

    def records(self):
        """Good ones."""
        return GOOD


class Idle(ma.Joint):
    """Has a kind, and nothing else."""

    kind: Literal["idle"] = "idle"


class Vague(Nameless):
    """Has a field of an unknown type."""

    kind: Literal["vague"] = "vague"
    size: Nobody  # noqa: F821


class Misled(Nameless):
    """Limits what it does not have."""

    kind: Literal["misled"] = "misled"
    limited: ClassVar[dict[str, int]] = {"reach": 2}


class Flat(ma.Surface):
    """Has a name, and nothing else."""

    name = "flat"


@pytest.mark.parametrize(
    ("register", "own"),
    [
        (ma.register_joint, Nameless),
        (ma.register_joint, Idle),
        (ma.register_joint, Misled),
        (ma.register_joint, Vague),
        (ma.register_joint, dict),
        (ma.register_joint, Egg),
        (ma.register_surface, Hitch),
        (ma.register_surface, Flat),
        (ma.register_surface, ma.Surface),
    ],
)
def test_a_class_that_lacks_something_cannot_be_registered(register, own):
    with refused(ma.MultiarmError, own.__name__):
        register(own)


def test_where_a_limited_slide_across_the_axis_begins():
    ma.register_joint(Rail)
    left = {"kind": "rail", "reach": [-0.1, 0.2], "begin": 0.03}
    inspection = inspect_system(ma.compile_system(scene_of(left)))
    (limit,) = inspection.joints[0].limits
    assert (limit.coordinate, limit.unit) == ("slide along x", "m")
    assert limit.start == pytest.approx(-0.03, abs=1e-12)


def test_names_that_are_taken_are_refused():
    ma.register_joint(Hitch)
    assert ma.register_joint(Hitch) is Hitch
    with refused(ma.MultiarmError, "'hitch'"):
        joint_of(lambda self: GOOD, "hitch")
    with refused(ma.MultiarmError, "'weld'"):
        joint_of(lambda self: GOOD, "weld")
    with refused(ma.MultiarmError, "'cone'"):
        ma.register_surface(type("Cone", (Egg,), {"name": "cone"}))


def test_surfaces_of_one_s_own_may_say_how_they_bend_and_whether_they_are_hollow():
    ma.register_surface(Marble)
    ring = {
        "arm": {"marble": {"radius": 1, "inside": True}},
        "object": {"plane": {"normal": [0, 0, 1]}},
    }
    joint = {"kind": "contacts", "contacts": [ring]}
    assert scene_of(joint).joints[0].contacts[0].arm.value.is_hollow

    class Bent(Marble):
        name = "marble"

        def curvatures(self):
            return -1.0 / self.radius, -1.0 / self.radius

    Bent.__qualname__ = Marble.__qualname__
    ma.register_surface(Bent)
    with refused(ma.MultiarmError, "$.joints[0].contacts[0]"):
        scene_of(joint)


def test_an_effect_of_contacts_that_push_asks_the_records():
    ma.register_joint(Hitch)
    ma.register_joint(Rest)
    effects = {"unilateral_contacts": {}}
    (warning,) = scene_of({"kind": "hitch"}, effects=effects).warnings
    assert "adds nothing, since no joint has contacts that only push" in warning
    egg = {"half": [0.1, 0.07, 0.05]}
    assert scene_of({"kind": "rest", "egg": egg}, effects=effects).warnings == []


def test_a_patch_bounds_a_surface_of_one_s_own_too():
    ma.register_surface(Marble)
    joint = scene_of(
        touching({"marble": {"radius": 0.05, "patch": {"min": [0, None, None]}}})
    ).joints[0]
    (contact,) = joint.placed(np.eye(4))
    assert contact.object.patch.excess(np.array([-0.02, 9.0, 9.0])) == pytest.approx(0.02)
