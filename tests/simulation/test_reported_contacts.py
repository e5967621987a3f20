"""Claims about what a run tells on the way, and about contacts that are lost or found again.

A sledge on a rail carries surfaces; the object, which nothing else holds, slides on them.
"""

from __future__ import annotations

import numpy as np
import pytest
from event_scenes import AS_WRITTEN, AWAY, AWAY_HEIGHT, arm, ball, scene
from mechanics import project_velocity, scene_of, single_arm, state_at
from refusals import refused

import multiarm as ma
from multiarm.contacts.surfaces import QUERY_WIDTH, Query, local_distance
from multiarm.contacts.table import pack
from multiarm.errors import SceneError
from multiarm.geometry.records import Contact as Record
from multiarm.geometry.records import ellipsoid, point
from multiarm.jit.rows import fields_of

SLEDGE = """<robot name="sledge"><link name="ground"/>
<joint name="rail" type="prismatic"><parent link="ground"/><child link="runner"/>
<axis xyz="1 0 0"/><limit lower="-50" upper="50" effort="1000" velocity="100"/></joint>
<link name="runner"><inertial><mass value="3.0"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="mount" type="fixed"><parent link="runner"/><child link="tip"/></joint>
<link name="tip"/></robot>"""
POSTURE = [0.3, -0.6, 1.1, 0.4, 0.7, -0.2]


@pytest.fixture
def sliding(tmp_path):
    """A system of the sledge ``a`` and a body that slides on it by one contact ``c``."""
    urdf = tmp_path / "sledge.urdf"
    urdf.write_text(SLEDGE)

    def build(on_arm: dict, on_object: dict, at=(0, 0, 0), twist=(0,) * 6, solver="dense"):
        pose = {"xyz": list(at)}
        body = {"shape": {"box": [0.1, 0.1, 0.1]}, "mass": 1.0, "pose": pose, "twist": list(twist)}
        contact = {"name": "c", "arm": on_arm, "object": on_object}
        joint = {"arm": "a", "kind": "contacts", "at": {"xyz": [0, 0, 0]}, "contacts": [contact]}
        arm = {"urdf": str(urdf), "tip": "tip", "posture": [0.0]}
        scene = scene_of(
            {"a": arm}, [joint], object=body, gravity=[0, 0, 0], run={"solver": solver}
        )
        return ma.compile_system(scene)

    return build


@pytest.mark.parametrize("step", [0.1, 0.02])
def test_leaving_a_patch_is_told_with_its_time_even_in_the_first_step(sliding, step):
    table = {
        "plane": {"normal": [0, 0, 1], "patch": {"min": [-1, -1, None], "max": [0.05, 1, None]}}
    }
    system = sliding(table, {"point": [0, 0, 0]}, twist=(1.0, 0, 0, 0, 0, 0))
    run = ma.simulate(system, 0.5, integrator="rk4", step=step)
    (event,) = run.events
    assert event["kind"] == "leaves its patch" and event["arm"] == "a" and event["contact"] == "c"
    assert event["time"] == pytest.approx(0.05, abs=1e-6)
    assert "patch" in run.message and "a: c (on the arm)" in run.message


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"floor": {"at": {"xyz": [0, 0, -50.0]}}},
        {"joint_friction": {"torque": 1e-6, "model": "set_valued"}},
        {"unilateral_contacts": {**AS_WRITTEN, "contacts": ["away"]}},
    ],
    ids=["bilateral", "floor", "dry friction", "open contact in a row before"],
)
def test_contacts_that_stay_bilateral_are_watched_beside_unilateral_constraints(effects):
    """A plate pushes a ball that slides off its patch, and pulls it half a period later."""
    patch = {"min": [-1, -1, None], "max": [0.05, 1, None]}
    contact = {
        "name": "c",
        "arm": {"plane": {"normal": [0, 0, 1], "patch": patch}},
        "object": {"sphere": {"radius": 0.05}},
    }
    lifting = {"kind": "harmonic", "amplitude": {"plate": 10.0}, "frequency": 5.0, "hold": False}
    arms, contacts = {"plate": arm("z")}, {"plate": [contact]}
    if "unilateral_contacts" in effects:
        arms = {"away": arm("x", base={"xyz": [0, 0, AWAY_HEIGHT]}), **arms}
        contacts = {"away": [AWAY], **contacts}
    body = ball(twist=[1.0, 0, 0, 0, 0, 0])
    system = ma.compile_system(scene(body, arms, contacts, effects, [0, 0, 0], control=lifting))
    run = ma.simulate(system, 0.15, accuracy=1e-9, certificate=False)
    reported = [event for event in run.events if event.get("contact") == "c"]
    assert [event["kind"] for event in reported] == ["leaves its patch", "pulls"]
    assert [event["time"] for event in reported] == pytest.approx([0.05, 0.1], abs=1e-6)
    assert all("plate: c" in event["text"] for event in reported)


def test_events_are_those_of_one_run(sliding):
    table = {
        "plane": {"normal": [0, 0, 1], "patch": {"min": [-1, -1, None], "max": [0.05, 1, None]}}
    }
    system = sliding(table, {"point": [0, 0, 0]}, twist=(1.0, 0, 0, 0, 0, 0))
    first, second = (ma.simulate(system, 0.2, accuracy=1e-6) for _ in range(2))
    assert len(first.events) == 1
    assert first.events == second.events


def test_start_outside_the_patch_is_refused(sliding):
    table = {"plane": {"normal": [0, 0, 1], "patch": {"min": [0.1, -1, None], "max": [1, 1, None]}}}
    with refused(SceneError, "'c'"):
        sliding(table, {"point": [0, 0, 0]})


@pytest.mark.slow
@pytest.mark.parametrize("output_step", [0.01, 0.5])
def test_hinge_counts_full_turns_between_samples_too(output_step):
    """Several turns at about 10 rad/s: the last angle is the integral of the hinge's rate."""
    hinge = {"kind": "revolute", "limits": [-20, 3.0]}
    system = ma.compile_system(single_arm("textbook_6r", "tool", POSTURE, hinge, gravity=[0, 0, 0]))
    start = system.initial_state()
    tip = system.arms["arm"].tip_pose(np.array(POSTURE))
    spin = -10.0 * tip[:3, 2]
    start.object_twist[:] = np.r_[np.cross(spin, start.object_position - tip[:3, 3]), spin]
    start = project_velocity(system, start)
    run, fine = (
        ma.simulate(system, 2.0, accuracy=1e-6, output_step=apart, state=start, certificate=False)
        for apart in (output_step, 1e-3)
    )
    turned = np.trapezoid(fine.relative_motion["arm"][:, 0], fine.time)
    assert run.relative_motion_labels == {"arm": ("turn z",)}
    assert run.relative_position["arm"][-1, 0] == pytest.approx(turned, abs=1e-3)
    assert turned > 6.0 * np.pi
    (event,) = (event for event in run.events if event["kind"] == "passes its limit")
    passed = np.interp(event["time"], fine.time, fine.relative_position["arm"][:, 0])
    assert passed == pytest.approx(3.0, abs=0.05)  # a straight line between the ends of a step


@pytest.mark.slow
def test_contact_of_two_surfaces_is_found_again_all_around(sliding):
    """Once around an ellipsoid: every sample can be evaluated, and simulation goes on from it."""
    system = sliding(
        {"ellipsoid": {"semi_axes": [0.2, 0.3, 0.25]}},
        {"ellipsoid": {"semi_axes": [0.1, 0.11, 0.12]}},
        at=(0.3, 0, 0),
        twist=(0, 0.5, 0, 0, 0, 0),
    )
    run = ma.simulate(system, 2.0, accuracy=1e-8, output_step=0.1, certificate=False)
    assert run.position_drift.max() < 1e-12
    for k in range(len(run)):
        evaluation = ma.evaluate(system, run.time[k], state_at(system, run, k))
        force = evaluation.contact_forces["a"]
        np.testing.assert_allclose(force, run.contact_forces["a"][k], atol=1e-6)
    again = ma.simulate(system, 0.1, state=state_at(system, run, len(run) - 1))
    assert again.status == "completed"


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_sliding_over_the_apex_of_a_cone_ends_the_run_and_names_the_contact(sliding, solver):
    half, radius = 0.7, 0.05
    along = np.array([np.sin(half), 0.0, -np.cos(half)])
    out = np.array([np.cos(half), 0.0, np.sin(half)])
    system = sliding(
        {"cone": {"axis": [0, 0, -1], "half_angle": half}},
        {"sphere": {"radius": radius}},
        at=0.3 * along + radius * out,
        twist=(*-along, 0, 0, 0),
        solver=solver,
    )
    run = ma.simulate(system, 1.0, integrator="rk4", step=0.01)
    assert run.status == "failed"
    assert "contact 'c' of arm 'a' has no normal" in run.message
    assert run.time[-1] == pytest.approx(0.3, abs=0.03)  # all data up to there
    assert np.isfinite(run.object_position).all()


def test_progress_may_evaluate_the_system_that_runs(sliding):
    system = sliding({"plane": {"normal": [0, 0, 1]}}, {"point": [0, 0, 0]})
    seen = []
    quiet = ma.simulate(system, 0.1)
    run = ma.simulate(system, 0.1, progress=lambda t: seen.append(ma.evaluate(system, t)))
    assert seen and np.array_equal(run.object_position, quiet.object_position)
    assert ma.evaluate(system).position_residual < 1e-12  # and it is free again


@pytest.mark.slow
@pytest.mark.parametrize("x", [0.0, 1e-18, 1e-17, 1e-16, 1e-12, 1e-6])
@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_distance_inside_an_ellipsoid_is_smooth_across_its_planes_of_symmetry(x, scale):
    """From a place in the plane x = 0 the foot is in it too: an ellipse's nearest point."""
    oval = ellipsoid((0, 0, 0), np.eye(3), scale * np.arange(1.0, 4.0))
    table = pack([Record("c", point((0, 0, 0)), oval)]).table
    query = np.zeros(QUERY_WIDTH)
    at = fields_of(Query, query)
    at.point[:] = scale * np.array([x, 1.4, 2.0])
    assert len(table.shapes) == 1
    local_distance(table.shapes[0], query, 0)
    angle = np.linspace(0, np.pi / 2, 2_000_001)
    ellipse = np.column_stack([2.0 * np.cos(angle), 3.0 * np.sin(angle)])
    nearest = np.linalg.norm(ellipse - [1.4, 2.0], axis=1).min()
    assert at.distance == pytest.approx(-scale * nearest, abs=1e-9 * scale)
    assert np.isfinite(at.second).all()
