"""The floor: which points of the object touch it, table tops, and starts that make no sense."""

from __future__ import annotations

import math

import numpy as np
import pytest
from loose_scenes import body_and_cart, happened
from mechanics import data_of
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.dynamics.contact_geometry import place_state
from multiarm.errors import SceneError
from multiarm.events.modes import Modes
from multiarm.events.row_dynamics import RowDynamics
from multiarm.problems import HARD_CASES
from multiarm.scene.solids import hull_corners

GRAVITY = 9.81


def box(height: float, **more) -> dict:
    body = {"shape": {"box": [0.4, 0.3, 0.2]}, "mass": 2.0, "pose": {"xyz": [0, 0, height]}}
    return {**body, **more}


def run(data: dict, **how):
    return ma.simulate(ma.compile_system(ma.Scene(**data)), certificate=False, **how)


def test_a_ball_touches_with_the_whole_of_its_surface(tmp_path):
    body = {"shape": {"sphere": 0.1}, "mass": 1.0, "pose": {"xyz": [0, 0, 0.6]}}
    trajectory = run(body_and_cart(tmp_path, body, {"floor": {}}))
    (touches,) = happened(trajectory)
    assert touches["time"] == pytest.approx(math.sqrt(2 * 0.5 / GRAVITY), abs=1e-10)
    assert trajectory.object_position[-1, 2] == pytest.approx(0.1, abs=1e-8)
    assert trajectory.contact_forces["floor"][-1, 0] == pytest.approx(GRAVITY, abs=1e-7)


def test_named_points_take_the_place_of_corners(tmp_path):
    feet = [[0.1, 0.1, -0.2], [-0.1, 0.1, -0.2], [0.0, -0.1, -0.2]]
    body = {"shape": {"cylinder": {"radius": 0.1, "height": 0.3}}, "mass": 1.0}
    body["pose"] = {"xyz": [0, 0, 0.2]}
    system = ma.compile_system(
        ma.Scene(**body_and_cart(tmp_path, body, {"floor": {"points": feet}}))
    )
    evaluation = ma.evaluate(system)
    # three feet carry the weight as the balance of moments has it
    np.testing.assert_allclose(
        evaluation.contact_forces["floor"], GRAVITY * np.array([0.25, 0.25, 0.5]), atol=1e-9
    )
    np.testing.assert_allclose(
        evaluation.contact_points["floor"], np.array(feet) + [0, 0, 0.2], atol=1e-12
    )


@pytest.mark.parametrize("roundings", [0.0, 1e-10])
def test_corners_of_a_mesh_are_those_of_its_hull(roundings, rng):
    """A box with its faces divided: 8 corners; the points on faces and edges are none."""
    grid = np.linspace(-0.5, 0.5, 5)
    points = np.array([[x, y, z] for x in grid for y in grid for z in grid])
    surface = points[np.max(np.abs(points), axis=1) == 0.5]
    found = hull_corners(surface + roundings * rng.normal(size=surface.shape))
    corners = {tuple(p) for p in points if np.all(np.abs(p) == 0.5)}
    assert len(found) == 8
    assert {tuple(np.round(c, 6)) for c in found} == corners


WEDGE = """v 0 0 0
v 0.3 0 0
v 0 0.3 0
v 0 0 0.3
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


def test_a_mesh_falls_on_its_corners(tmp_path):
    (tmp_path / "wedge.obj").write_text(WEDGE)
    body = {
        "shape": {"mesh": {"file": str(tmp_path / "wedge.obj")}},
        "mass": 1.0,
        "inertia": [0.01, 0.01, 0.01],
        "pose": {"xyz": [0, 0, 0.2]},
    }
    trajectory = run(body_and_cart(tmp_path, body, {"floor": {"mu": 0.5}}), duration=0.6)
    assert trajectory.status == "completed", trajectory.message
    first = happened(trajectory)[0]
    assert first["time"] == pytest.approx(math.sqrt(2 * 0.2 / GRAVITY), abs=1e-9)
    assert len(ma.compile_system(trajectory.scene).model.unilateral.contacts_of("floor")) == 4


def test_a_box_slides_off_a_table_and_falls(tmp_path):
    """Without friction; its leading corners leave the table first, and it tips over the others."""
    table = {"floor": {"size": [1.0, 1.0]}}
    body = box(0.1, twist=[1.0, 0, 0, 0, 0, 0])
    trajectory = run(body_and_cart(tmp_path, body, table), duration=1.0)
    assert trajectory.status == "completed", trajectory.message
    leaves = [event for event in happened(trajectory) if event["kind"] == "lets go"]
    # the leading corners, 0.2 m ahead, are over the edge after 0.3 m
    first, second, *others = (event["time"] for event in leaves)
    assert first == second == pytest.approx(0.3, abs=1e-9)
    level = trajectory.time < 0.3
    np.testing.assert_allclose(trajectory.object_position[level, 2], 0.1, atol=1e-8)
    # the others carry m g / (1 + a^2 / i^2) while it begins to turn about them
    tipping = np.flatnonzero(trajectory.time > 0.3)[0]
    inertia = (0.4**2 + 0.2**2) / 12.0
    share = trajectory.contact_forces["floor"][tipping].sum() / (2.0 * GRAVITY)
    assert share == pytest.approx(1.0 / (1.0 + 0.2**2 / inertia), rel=0.05)
    assert len(others) == 2
    assert trajectory.object_position[-1, 2] < -0.1
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-6


def test_a_sloping_floor_carries_along_its_own_normal(tmp_path):
    slope = 0.3
    place = {"rpy": [0, slope, 0]}
    body = box(0.0, pose={"xyz": [0.1 * math.sin(slope), 0, 0.1 * math.cos(slope)], **place})
    data = body_and_cart(tmp_path, body, {"floor": {"at": place, "mu": 0.2}})
    trajectory = run(data, duration=0.5)
    pull = GRAVITY * (math.sin(slope) - 0.2 * math.cos(slope))
    way = np.linalg.norm(trajectory.object_position[-1] - trajectory.object_position[0])
    assert way == pytest.approx(0.5 * pull * 0.25, rel=1e-6)


@pytest.mark.parametrize(
    ("body", "floor", "words"),
    [
        (box(0.05), {}, "'corner 1' of the object is below the floor by 0.05 m"),
        (
            {"shape": {"cylinder": {"radius": 0.1, "height": 0.3}}, "mass": 1.0},
            {},
            "a cylinder has no corners; name the points",
        ),
        (
            {
                "shape": {"mesh": {"file": "missing.stl"}},
                "mass": 1.0,
                "inertia": [0.01, 0.01, 0.01],
            },
            {},
            "there is no mesh at",
        ),
        (box(0.1), {"points": []}, "$.effects.floor.points: is empty"),
        (box(0.1), {"mu": -0.1}, "$.effects.floor.mu"),
        (box(0.1), {"restitution": 2.0}, "$.effects.floor.restitution"),
        (box(0.1), {"size": [1.0, 0.0]}, "$.effects.floor.size"),
    ],
)
def test_bad_floors_are_told(tmp_path, body, floor, words):
    with pytest.raises(ma.MultiarmError) as caught:
        ma.compile_system(ma.Scene(**body_and_cart(tmp_path, body, {"floor": floor})))
    assert words in str(caught.value)


def test_an_arm_may_not_be_called_floor(tmp_path):
    data = body_and_cart(tmp_path, box(0.1), {"floor": {}})
    data["arms"]["floor"] = data["arms"].pop("cart")
    data["joints"][0]["arm"] = "floor"
    with pytest.raises(SceneError, match=r"\$\.arms\.floor: ") as caught:
        ma.Scene(**data)
    assert not any(fault.place.startswith("$.effects") for fault in caught.value.faults)


def test_contacts_that_others_hold_fast_have_no_response():
    """Six fingers hold a box on a floor: what the floor's contacts give way by is rounding."""
    scene = HARD_CASES["six_sliding_fingers"].scene()
    pose, height = scene.object.pose.matrix(), scene.object.shape.box[2]
    turn = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    below = (pose[:3, 3] - 0.5 * height * pose[:3, 2]).tolist()
    floor = {"at": {"xyz": below, "quaternion_xyzw": turn}, "mu": 0.5}
    system = ma.compile_system(scene.replace(effects={"floor": floor}))
    data = data_of(system)
    place_state(data, 0.0, system.initial_state())
    dynamics = RowDynamics(Modes(data, 1e-9))
    dynamics.update()
    rows = list(range(system.model.layout.contacts))[system.model.layout.surroundings]
    jacobian = dynamics.jacobian(rows)
    assert len(rows) == 3 * 8 and np.all(dynamics.mobility(jacobian) > 1e-3)
    response, _ = dynamics.response(jacobian, dynamics.bilateral)
    assert not response.any()
    assert ma.evaluate(system).message == ""
