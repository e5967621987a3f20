"""Claims about the start: put on the joints when it is near, refused with reasons when not."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
import trimesh
from commands import multiarm
from mechanics import UR5_POSTURE, plain_gaps, scene_of, single_arm, sledge_urdf, ur5_pair
from object_scenes import double_pendulum
from refusals import refused
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.assembly.linkage import Linkage
from multiarm.assembly.loop_closure import Closing, Outcome
from multiarm.assembly.start import project_start
from multiarm.assembly.start_faults import cannot_close
from multiarm.assembly.start_warnings import start_warnings
from multiarm.dynamics.contact_geometry import place_state
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.errors import MultiarmError, SceneError, SolverError
from multiarm.problems import HARD_CASES
from multiarm.scene import Shape, dump_scene, parse_scene
from multiarm.simulation.inspection import inspect_system


def at_tip(name):
    """Pose of an arm's tip in the object frame at the pair's start, as a scene writes it."""
    system = ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "weld"}))
    scene = system.scene
    X_OT = np.linalg.solve(
        scene.object.pose.matrix(), system.arms[name].tip_pose(np.array(UR5_POSTURE))
    )
    return {
        "xyz": X_OT[:3, 3],
        "quaternion_xyzw": Rotation.from_matrix(X_OT[:3, :3]).as_quat(),
    }


def displaced(pose, shift, turn=(0.0, 0.0, 0.0)):
    rotation = Rotation.from_quat(pose["quaternion_xyzw"]) * Rotation.from_rotvec(turn)
    return {"xyz": (pose["xyz"] + shift).tolist(), "quaternion_xyzw": rotation.as_quat().tolist()}


def test_a_start_without_placement_is_closed_as_written():
    system = ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "point_on_plane"}))
    assert max(system.start_report.gaps.values()) < 1e-14
    assert system.start_report.joint_change == 0.0
    assert system.start_report.object_shift == 0.0
    np.testing.assert_allclose(plain_gaps(system, system.initial_state()), 0.0, atol=1e-14)


def test_a_near_start_is_closed_by_the_arms_alone_and_reported():
    shift = np.array([0.004, -0.003, 0.002])
    joint = {"kind": "weld", "at": displaced(at_tip("left"), shift, [0.02, 0.01, -0.03])}
    system = ma.compile_system(ur5_pair(joint, {"kind": "weld"}))
    start, report = system.initial_state(), system.start_report
    np.testing.assert_allclose(plain_gaps(system, start), 0.0, atol=2e-14)
    np.testing.assert_array_equal(start.object_position, [0, 0, 0.5])
    np.testing.assert_allclose(start.joint_positions["right"], UR5_POSTURE, atol=1e-14)
    change = np.abs(start.joint_positions["left"] - UR5_POSTURE)
    assert report.joint_change == pytest.approx(change.max()) and 1e-3 < change.max() < 0.1
    assert 1e-3 < report.gaps["left"] < 0.02 and report.gaps["right"] < 1e-12
    assert report.object_shift == 0.0 and report.object_turn == 0.0


def test_a_start_whose_gaps_still_shrink_is_not_called_out_of_reach(monkeypatch):
    monkeypatch.setattr("multiarm.assembly.loop_closure.MOST_STEPS", 1)
    joint = {"kind": "weld", "at": displaced(at_tip("left"), [0.02, -0.01, 0.01], [0.1, 0.1, 0.0])}
    with pytest.raises(SceneError) as caught:
        ma.compile_system(ur5_pair(joint, {"kind": "weld"}))
    assert "steps were too few, left: " in str(caught.value)
    assert "reach" not in str(caught.value)


def test_an_arm_that_moves_a_link_without_mass_is_refused(tmp_path):
    urdf = tmp_path / "sledge.urdf"
    urdf.write_text(sledge_urdf(mass=0.0))
    arm = {"urdf": str(urdf), "tip": "tip", "posture": [0.0]}
    with refused(SolverError, "arm 'a'"):
        ma.compile_system(scene_of({"a": arm}, [{"arm": "a", "kind": "weld"}]))


def test_an_object_out_of_the_arms_reach_gives_way():
    """A planar arm cannot lift its tip; the object comes down to it."""
    body = {"shape": {"sphere": 0.2}, "mass": 1.0, "pose": {"xyz": [1.0, 0.2, 0.005]}}
    arm = {"robot": "planar_3r", "tip": "tip", "posture": [0.4, -0.3, 0.2]}
    plain = scene_of({"arm": arm}, [{"arm": "arm", "kind": "ball"}], run={"solver": "dense"})
    tip = ma.compile_system(plain).arms["arm"].tip_pose(np.array(arm["posture"]))
    at = (tip[:3, 3] - [1.0, 0.2, 0.0]).tolist()
    joint = {"arm": "arm", "kind": "ball", "at": {"xyz": at}}
    scene = scene_of({"arm": arm}, [joint], object=body, run={"solver": "dense"})
    system = ma.compile_system(scene)
    start = system.initial_state()
    np.testing.assert_allclose(plain_gaps(system, start), 0.0, atol=1e-13)
    assert system.start_report.object_shift > 1e-3


def test_a_far_start_is_refused_with_all_gaps_and_a_remedy():
    pose = at_tip("left")
    left = {"kind": "weld", "at": displaced(pose, [0.5, 0.0, 0.0])}
    right = {"kind": "weld", "at": displaced(at_tip("right"), [0.0, 0.4, 0.0])}
    with pytest.raises(SceneError) as caught:
        ma.compile_system(ur5_pair(left, right))
    assert len(caught.value.faults) == 2
    for name, fault in zip(("left", "right"), caught.value.faults, strict=True):
        assert f"'{name}'" in fault and "gap of" in fault and "at" in fault


@pytest.mark.parametrize(
    "kind, axis", [("weld", 0), ("weld", 2), ("prismatic", 2), ("cylindrical", 1), ("planar", 0)]
)
@pytest.mark.parametrize("missing", [0.0, 0.05])
def test_a_joint_that_would_close_upside_down_is_refused(kind, axis, missing):
    """All gaps of a weld vanish at half a turn too, exactly or from near by."""
    turn = (math.pi - missing) * np.eye(3)[axis]
    flipped = displaced(at_tip("right"), np.zeros(3), turn)
    with refused(SceneError, "'right'"):
        ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": kind, "at": flipped}))


@pytest.mark.parametrize("kind, axis", [("revolute", 2), ("cylindrical", 2), ("ball", 0)])
def test_half_a_turn_about_a_free_axis_is_a_position_of_the_joint(kind, axis):
    flipped = displaced(at_tip("right"), np.zeros(3), math.pi * np.eye(3)[axis])
    system = ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": kind, "at": flipped}))
    assert system.start_report.joint_change < 1e-9


def test_a_start_that_is_not_assembled_serves_evaluations_elsewhere():
    """Without assembly gaps and postures stay as written; runs need a state on the joints."""
    there = {"kind": "weld", "at": displaced(at_tip("left"), [0.5, 0.0, 0.0])}
    far = ma.compile_system(ur5_pair(there, {"kind": "ball"}), assemble=False)
    assert far.start_report.gaps["left"] == pytest.approx(0.5, rel=1e-6)
    np.testing.assert_array_equal(far.initial_state().joint_positions["left"], UR5_POSTURE)
    near = {"kind": "weld", "at": displaced(at_tip("left"), [0.004, 0.0, 0.002])}
    scene = ur5_pair(near, {"kind": "ball"}, gravity=[0, 0, -9.81])
    closed, open_ = ma.compile_system(scene), ma.compile_system(scene, assemble=False)
    begin = closed.initial_state()
    state = open_.state(begin.object_position, begin.object_quaternion_xyzw, begin.joint_positions)
    one, other = ma.evaluate(closed, 0.0, begin), ma.evaluate(open_, 0.0, state)
    np.testing.assert_array_equal(one.object_acceleration, other.object_acceleration)
    np.testing.assert_array_equal(one.contact_forces["left"], other.contact_forces["left"])
    for run in (ma.simulate, ma.Stepper):
        with refused(SceneError, "`assemble=False`"):
            run(open_)
    from_there = ma.simulate(open_, 0.05, state=state)
    np.testing.assert_array_equal(
        from_there.object_position, ma.simulate(closed, 0.05).object_position
    )


def test_an_arm_that_reaches_its_place_from_nowhere_can_be_compiled_without_assembly():
    arms = {"arm": {"robot": "planar_3r", "tip": "tip"}}
    scene = scene_of(arms, [{"arm": "arm", "kind": "ball", "at": {"xyz": [9.0, 0, 0]}}])
    with refused(SceneError, "$.arms.arm.posture"):
        ma.compile_system(scene)
    system = ma.compile_system(scene, assemble=False)
    assert np.all(system.initial_state().joint_positions["arm"] == 0.0)
    assert np.isfinite(ma.evaluate(system).object_acceleration).all()


def test_written_velocities_are_projected_with_the_least_change():
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"})
    twist = [0.1, 0.2, -0.1, 0.3, -0.2, 0.1]
    moving = scene.replace(object=scene.object.model_copy(update={"twist": tuple(twist)}))
    system = ma.compile_system(moving)
    ev = ma.evaluate(system)
    assert ev.velocity_residual < 1e-13
    assert system.start_report.velocity_change > 0.01
    assert system.start_report.gap_rates["left"] > 0.05
    # the arms, at rest as written, hold the object back
    assert 0.0 < np.linalg.norm(ev.state.object_twist[:3]) < np.linalg.norm(twist[:3])


def test_a_start_closes_rates_along_directions_that_are_almost_lost(rng):
    """The projection of a run takes these for dependent and leaves 1e-8 of them."""
    scene = HARD_CASES["nearly_sliding_fingers"].scene()
    system = ma.compile_system(scene)
    state, data = system.initial_state(), Data(system.model)
    state.velocity[:] += rng.normal(size=state.velocity.size)
    start, report = project_start(data, scene, state)
    assert max(report.gap_rates.values()) > 0.1
    assert np.abs(data.contact_rows.gap_rate).max() < 1e-14
    place_state(data, 0.0, start)
    require_ok(data, update_kinematics(data.struct))
    assert np.abs(data.contact_rows.gap_rate).max() < 1e-14


def test_consistent_velocities_are_kept(block_system):
    assert block_system.start_report.velocity_change < 1e-12


def test_the_gaps_of_near_joints_are_told_beside_the_far_one():
    left = {"kind": "weld", "at": displaced(at_tip("left"), [0.5, 0.0, 0.0])}
    right = {"kind": "weld", "at": displaced(at_tip("right"), [0.0, 0.01, 0.0])}
    with pytest.raises(SceneError) as caught:
        ma.compile_system(ur5_pair(left, right))
    (fault,) = caught.value.faults
    assert "arm 'left': a gap of 0.5 m" in fault and "right: 0.01 m" in fault


def test_contacts_that_contradict_each_other_are_named():
    """Two floors at different heights under one fingertip; the wall has no part in it."""
    tip = {"point": [0, 0, 0]}
    contacts = [
        {"name": "floor", "arm": tip, "object": {"plane": {"normal": [0, 0, 1]}}},
        {"name": "wall", "arm": tip, "object": {"plane": {"normal": [1, 0, 0]}}},
        {
            "name": "second floor",
            "arm": tip,
            "object": {"plane": {"point": [0, 0, 0.004], "normal": [0, 0, 1]}},
        },
    ]
    posture = [0.3, -0.6, 1.1, 0.4, 0.7, -0.2]
    tip_pose = (
        ma.compile_system(single_arm("textbook_6r", "tool", posture, {"kind": "ball"}))
        .arms["arm"]
        .tip_pose(np.array(posture))
    )
    joint = {"kind": "contacts", "contacts": contacts, "at": {"xyz": tip_pose[:3, 3].tolist()}}
    with pytest.raises(SceneError) as caught:
        ma.compile_system(
            single_arm("textbook_6r", "tool", posture, joint, run={"solver": "dense"})
        )
    (fault,) = caught.value.faults
    assert "'floor', 'second floor' of arm 'arm' contradict each other" in fault
    assert "0.002 m" in fault and "wall" not in fault


def test_a_row_that_says_the_same_twice_is_closed():
    """One of the doubled floor's rows is redundant, and consistent."""
    tip = {"point": [0, 0, 0]}
    floor = {"arm": tip, "object": {"plane": {"point": [0, 0, 0.004], "normal": [0, 0, 1]}}}
    contacts = [{"name": name, **floor} for name in ("floor", "the same floor")]
    posture = [0.3, -0.6, 1.1, 0.4, 0.7, -0.2]
    tip_pose = (
        ma.compile_system(single_arm("textbook_6r", "tool", posture, {"kind": "ball"}))
        .arms["arm"]
        .tip_pose(np.array(posture))
    )
    joint = {"kind": "contacts", "contacts": contacts, "at": {"xyz": tip_pose[:3, 3].tolist()}}
    scene = single_arm("textbook_6r", "tool", posture, joint, run={"solver": "dense"})
    system = ma.compile_system(scene)
    assert system.start_report.gaps["arm"] == pytest.approx(0.004)
    np.testing.assert_allclose(plain_gaps(system, system.initial_state()), 0.0, atol=1e-13)


def test_contacts_at_the_centre_of_a_sphere_are_refused_without_a_traceback():
    """The gap of a point at the centre has no direction."""
    contact = {"arm": {"point": [0, 0, 0]}, "object": {"sphere": {"radius": 0.01}}}
    posture = [0.3, -0.6, 1.1, 0.4, 0.7, -0.2]
    tip = ma.compile_system(single_arm("textbook_6r", "tool", posture, {"kind": "ball"}))
    X = np.linalg.solve(tip.scene.object.pose.matrix(), tip.arms["arm"].tip_pose(np.array(posture)))
    joint = {"kind": "contacts", "contacts": [contact], "at": {"xyz": X[:3, 3].tolist()}}
    with pytest.raises(MultiarmError) as caught:
        ma.compile_system(single_arm("textbook_6r", "tool", posture, joint))
    assert "nan" not in str(caught.value).lower()


def test_wound_up_joints_are_not_unwound():
    """A continuous joint at 7 rad starts at 7 rad, though Pinocchio sees only cosine and sine."""
    posture = [0.4, 2.9, 1.3, -2.0, 1.4, 7.0]
    scene = single_arm("kinova", "j2s6s200_end_effector", posture, {"kind": "ball"})
    start = ma.compile_system(scene).initial_state()
    np.testing.assert_allclose(start.joint_positions["arm"], posture, atol=1e-14)
    assert start.joint_positions["arm"][5] > 2 * math.pi


# --- what a start is warned of --------------------------------------------------------------------

WEDGE = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.4, 0], [0, 0, 0.2]]) - [0.075, 0.1, 0.05]


@pytest.mark.parametrize(
    "shape",
    [
        {"box": [0.2, 0.4, 0.1]},
        {"sphere": 0.15},
        {"cylinder": {"radius": 0.1, "height": 0.3}},
        {"hull": WEDGE.tolist()},
    ],
    ids=lambda shape: next(iter(shape)),
)
def test_the_nearest_point_of_a_convex_solid_is_on_its_side_of_a_plane(shape, rng):
    """n is nearest to p exactly if n is in the solid and (p - n) . (x - n) <= 0 for all its x."""
    solid, inside = Shape(**shape).solid, rng.uniform(-0.4, 0.4, (4000, 3))
    if "box" in shape:
        inside = inside[np.all(np.abs(inside) <= np.array(shape["box"]) / 2, axis=1)]
    elif "sphere" in shape:
        inside = inside[np.linalg.norm(inside, axis=1) <= 0.15]
    elif "cylinder" in shape:
        inside = inside[(np.hypot(*inside.T[:2]) <= 0.1) & (np.abs(inside[:, 2]) <= 0.15)]
    else:
        inside = WEDGE
    for p in rng.uniform(-0.5, 0.5, (40, 3)):
        n = solid.nearest(p)
        assert np.max((inside - n) @ (p - n), initial=0.0) < 1e-12
        within = 0.5 * (n + inside.mean(axis=0))
        np.testing.assert_allclose(solid.nearest(within), within, atol=1e-12)


def test_the_nearest_point_of_a_mesh_with_a_dent(tmp_path, rng):
    """An L of two boxes: its distance is the smaller of theirs, zero inside either."""
    parts = [((-0.2, -0.1, -0.1), (0.2, 0.0, 0.1)), ((-0.2, 0.0, -0.1), (-0.1, 0.3, 0.1))]
    boxes = [trimesh.creation.box(bounds=1000.0 * np.array(ends)) for ends in parts]
    trimesh.util.concatenate(boxes).export(tmp_path / "l.stl")
    solid = Shape(mesh={"file": tmp_path / "l.stl", "scale": 1e-3}).solid
    for p in rng.uniform(-0.4, 0.4, (60, 3)):
        distances = [np.linalg.norm(p - np.clip(p, low, high)) for low, high in parts]
        assert np.linalg.norm(p - solid.nearest(p)) == pytest.approx(min(distances), abs=1e-7)
    assert Shape(mesh={"file": tmp_path / "none.stl"}).solid.nearest(np.zeros(3)) is None


@pytest.mark.parametrize(
    ("joint", "words"),
    [
        (
            {"kind": "weld"},
            r"\$.joints\[0\]: .* 0.15 m off .* \[-0.2, 0, 0\].* posture or the base",
        ),
        ({"kind": "ball", "at": True}, r"0.15 m off the object's shape, .* correct 'at', or leave"),
        ({"kind": "point_on_sphere", "radius": 0.14, "at": True}, None),
        (
            {
                "kind": "contacts",
                "contacts": [
                    {"arm": {"point": [0, 0, 0]}, "object": {"plane": {"normal": [1, 0, 0]}}}
                ],
                "at": True,
            },
            None,
        ),
    ],
    ids=["where the tip is", "at", "on a surface of its own", "listed contacts"],
)
def test_a_joint_off_the_object_is_told(joint, words):
    arms = {"arm": {"robot": "ur5", "tip": "tool0", "posture": UR5_POSTURE}}
    plain = ma.compile_system(scene_of(arms, [{"arm": "arm", "kind": "ball"}]))
    tip = plain.arms["arm"].tip_pose(np.array(UR5_POSTURE))
    body = {"shape": {"box": [0.4, 0.4, 0.4]}, "mass": 1.0}
    # the joint is 0.15 m beyond the box's face, and the tip there, or on the sphere around it
    offset = np.array([0.35 + joint.get("radius", 0.0), 0.0, 0.0])
    body["pose"] = {"xyz": (tip[:3, 3] + offset).tolist()}
    if joint.get("at"):
        joint = {**joint, "at": {"xyz": [-0.35, 0.0, 0.0]}}
    built = scene_of(arms, [{"arm": "arm", **joint}], object=body)
    found = start_warnings(ma.compile_system(built))
    assert len(found) == (words is not None)
    for text in found:
        assert re.search(words, text), text


HOLD = {"kind": "harmonic", "hold": True, "frequency": 1.0, "amplitude": {"arm": 0.0}}


def test_where_nothing_weighs_no_weight_is_left():
    weld = {"kind": "weld"}
    system = ma.compile_system(
        ur5_pair(weld, weld, control={"kind": "computed_torque"}, gravity=[0.0, 0.0, 0.0])
    )
    state = system.initial_state()
    state.velocity[system.model.layout.of_frames] = 0.1
    ma.evaluate(system, 0.0, state)  # commands forces
    assert start_warnings(system) == []


@pytest.mark.parametrize("control", [{"kind": "gravity_compensation"}, HOLD])
def test_weight_that_the_contacts_cannot_carry_is_told(control):
    """A ball joint beside the centre of mass, at d: of forces F there and the moment d x F, over d,
    half the weight is nearest to the weight.  A weld carries all of it.
    """
    arms, d, weight = {"arm": {"robot": "ur5", "tip": "tool0", "posture": UR5_POSTURE}}, 0.2, 19.62
    tip = ma.compile_system(scene_of(arms, [{"arm": "arm", "kind": "weld"}]))
    centre = tip.arms["arm"].tip_pose(np.array(UR5_POSTURE))[:3, 3] + [d, 0.0, 0.0]
    body = {"shape": {"box": [0.5] * 3}, "mass": 2.0, "pose": {"xyz": centre.tolist()}}
    left = {"ball": [0, 0, 0.5 * weight, 0, -0.5 * d * weight, 0], "weld": np.zeros(6)}
    for kind, wrench in left.items():
        joint = {"arm": "arm", "kind": kind}  # where the tip is
        system = ma.compile_system(
            scene_of(arms, [joint], object=body, gravity=[0, 0, -9.81], control=control)
        )
        warnings = start_warnings(system)
        assert len(warnings) == (kind == "ball")
        assert system.warnings == [*system.scene.warnings, *warnings]
        driven = system.with_control(lambda t, state: {})  # which may carry nothing
        assert driven.warnings == system.scene.warnings
        assert ma.compile_system(system.scene, assemble=False).warnings == system.scene.warnings
        if kind == "ball":
            assert "cannot carry all" in system._repr_html_()
            words = "of 'arm' cannot carry all of the object's weight, 19.6 N: 0, 0, 9.81 N and 0, "
            assert words in warnings[0] and warnings[0].startswith("$.control: ")
        if control["kind"] == "harmonic":  # commands nothing afterwards
            wrench = np.zeros(6)
        found = ma.evaluate(system).uncarried_wrench
        np.testing.assert_allclose(found, wrench, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_a_posture_that_assembly_pushes_into_a_limit_is_told(tmp_path):
    posture = [0.0, -0.4015, 0.0, -2.362, 0.0, 2.7459, 2.89]
    arm = {"robot": "panda", "tip": "panda_hand_tcp", "posture": posture}
    arm["lock"] = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
    tip = ma.compile_system(scene_of({"arm": arm}, [{"arm": "arm", "kind": "weld"}]))
    X = tip.arms["arm"].tip_pose(np.array(posture))
    turned = Rotation.from_matrix(X[:3, :3]) * Rotation.from_rotvec([0, 0, 0.05])
    joint = {"arm": "arm", "kind": "weld", "at": {"xyz": [0, 0, 0]}}
    body = {
        "shape": {"sphere": 0.1},
        "mass": 1.0,
        "pose": {"xyz": X[:3, 3].tolist(), "quaternion_xyzw": turned.as_quat().tolist()},
    }
    built = scene_of({"arm": arm}, [joint], object=body, run={"duration": 0.01})
    system = ma.compile_system(built)
    (text,) = start_warnings(system)
    assert "$.arms.arm.posture: 'panda_joint7' is written at 2.89 rad" in text
    assert "limit 2.8973 rad" in text
    assert inspect_system(system).warnings == system.warnings == [text]
    assert "is written at 2.89 rad" in system._repr_html_()
    path = tmp_path / "scene.yaml"
    path.write_text(dump_scene(built))
    for words in (["check"], ["run", "--out", str(tmp_path / "run.h5")]):
        result = multiarm(*words, path)
        assert result.exit_code == 0 and text in result.stderr.replace("\n", " ")
    assert start_warnings(tip) == []


@pytest.mark.parametrize(("coordinate", "who"), [(2, "object 'upper'"), (8, "object 'lower'")])
def test_what_would_have_to_move_too_far_is_named_among_several_objects(coordinate, who):
    system = ma.compile_system(parse_scene(double_pendulum([0.4, -0.9], [0.0, 0.0])))
    with system.borrow() as data:
        place_state(data, 0.0, system.initial_state())
        require_ok(data, update_kinematics(data.struct))
        everything = list(range(data.model.layout.block_count))
        linkage = Linkage(data, everything, True, data.model.position_limits)
        changes = np.eye(12)[coordinate]
        (fault,) = cannot_close(data, "it", "1 m", linkage, Closing(Outcome.FAR, changes))
    assert f"{who} would have to move" in fault
