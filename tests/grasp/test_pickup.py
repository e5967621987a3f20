"""Claims about picking bodies up by tilting them: plans that hold, refusals with proof.

Oracles: the couple that tilts a block and the slope up to which a pyramid cannot be tilted, in
closed form; wrenches from places in the world; linear programs on them; runs.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from repository import ROOT
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.errors import GraspError, SceneError
from multiarm.grasp import Contacts, PickupError, Polyhedron, plan_pickup
from multiarm.grasp.pickup import planning
from multiarm.grasp.pickup.course import HELD
from multiarm.grasp.pickup.lying_body import laid_on_face, reached_part
from multiarm.grasp.pickup.planning import NEVER_CLOSED
from multiarm.grasp.pickup.tilting import all_pushes, carried, floor_contacts, weakest_force

SIZE = np.array([0.4, 0.3, 0.3])
SQUARE = np.array([[-0.25, -0.25], [0.25, -0.25], [0.25, 0.25], [-0.25, 0.25]])
# Rounding of forces over the weight, and of places in metres.
ROUNDING = 1e-9


def edge_of(body, beside):
    """A body on the floor, and the edge with one of its faces."""
    lies = laid_on_face(body)
    (edge,) = [edge for edge in lies.edges() if body.names[edge.beside] == beside]
    return lies, edge


def tilted(edge, angle, points):
    """Points (N, 3) in the world, turned about the edge."""
    return Rotation.from_rotvec(angle * edge.axis).apply(points - edge.point) + edge.point


def flat_pyramid(height):
    return Polyhedron.pyramid(SQUARE, (0.0, 0.0, height))


@pytest.fixture(scope="module")
def block():
    """The plan for a block."""
    return plan_pickup(Polyhedron.box(SIZE))


@pytest.fixture(scope="module")
def scene(block, tmp_path_factory):
    """The block between two UR5s."""
    table = tmp_path_factory.mktemp("pickup") / "references.csv"
    return block.to_scene(["ur5", "ur5"], table=table, mass=5.0, lift=0.1)


@pytest.fixture(scope="module")
def system(scene):
    """The block between two UR5s."""
    return ma.compile_system(scene)


@pytest.fixture(scope="module")
def trajectory(system):
    """The block picked up."""
    return ma.simulate(system, output_step=0.01)


# --- closed forms ---------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.5])
def test_a_horizontal_couple_tilts_a_block(angle):
    body, apart = Polyhedron.box(SIZE), 0.2
    lies, edge = edge_of(body, "+x")
    # pushes high on the left side and low on the right one, and the floor at the right edge
    places = [[-0.2, 0.0, 0.1], [0.2, 0.0, 0.1 - apart]]
    pushes = Contacts(places, [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    pose = edge.turned(angle) @ lies.pose
    forces = carried(body, pose, pushes.joined(floor_contacts(body, pose, edge.vertices)), 0.0)
    w, h = SIZE[0] / 2, SIZE[2] / 2
    couple = (w * np.cos(angle) - h * np.sin(angle)) / apart
    np.testing.assert_allclose(forces.forces, [couple, couple, 0.5, 0.5], atol=ROUNDING)


def test_the_other_way_round_the_couple_would_have_to_pull():
    body = Polyhedron.box(SIZE)
    lies, edge = edge_of(body, "+x")
    pushes = Contacts([[-0.2, 0.0, -0.1], [0.2, 0.0, 0.1]], [[1.0, 0, 0], [-1.0, 0, 0]])
    contacts = pushes.joined(floor_contacts(body, lies.pose, edge.vertices))
    assert not carried(body, lies.pose, contacts, 0.0)
    assert weakest_force(body, lies.pose, contacts) == pytest.approx(-0.2 / 0.2)


@pytest.mark.parametrize("angle", [0.1, 0.4])
def test_a_tilted_face_is_as_high_as_a_ramp(angle):
    lies, edge = edge_of(Polyhedron.box(SIZE), "+y")
    part = reached_part(lies, lies.face, [edge.turned(angle)], 0.02)
    heights = tilted(edge, angle, lies.at(part))[:, 2]
    away = edge.distance(lies.at(part))
    np.testing.assert_allclose(heights, away * np.sin(angle), atol=1e-12)
    assert heights.min() == pytest.approx(0.02)
    assert away.max() == pytest.approx(SIZE[1])


@pytest.mark.parametrize(("height", "tips"), [(0.24, False), (0.26, True)])
def test_a_pyramid_can_be_tipped_when_its_sides_are_steeper_than_45_degrees(height, tips):
    # a push at the apex has the moment h^2 - (a/2)^2 about the far edge, over the slant height
    body = flat_pyramid(height)
    lies, edge = edge_of(body, "side 1")
    sides = {k: face.vertices for k, face in enumerate(body.faces) if face.name != "base"}
    floor = floor_contacts(body, lies.pose, edge.vertices)
    pushes = all_pushes(body, sides).joined(floor)
    assert bool(carried(body, lies.pose, pushes, 0.0)) == tips


# --- a plan ---------------------------------------------------------------------------------------


def world_wrenches(plan, angle, contacts, floor):
    """Wrenches (6, N) of pushes about the edge's first vertex, world axes; the load (6,)."""
    lies, edge = plan.lies, plan.edge
    body, turn = lies.body, Rotation.from_rotvec(angle * edge.axis)
    e = turn.apply(plan.grasp.contacts.normals[list(contacts)] @ lies.pose[:3, :3].T)
    p = tilted(edge, angle, lies.at(plan.grasp.contacts.points[list(contacts)]))
    v = tilted(edge, angle, lies.at(body.vertices[list(floor)])).reshape(-1, 3)
    e = np.vstack([e, np.tile([0.0, 0.0, 1.0], (len(v), 1))])
    p = np.vstack([p, v]) - edge.point
    c = tilted(edge, angle, lies.at(body.centre)[None])[0] - edge.point
    up = np.array([0.0, 0.0, 1.0])
    return np.vstack([e.T, np.cross(p, e).T]), np.append(up, np.cross(c, up))


def test_forces_of_every_phase_carry_the_weight_and_press(block):
    for phase in block.phases:
        for angle, forces in zip(phase.angles, phase.forces, strict=True):
            W, load = world_wrenches(block, angle, phase.contacts, phase.floor)
            np.testing.assert_allclose(W @ forces, load, atol=ROUNDING)
            assert forces.min() >= block.least - ROUNDING


def test_at_every_angle_of_the_tilt_hands_and_the_edge_close_the_block(block):
    phase = block.phase("tilt")
    for angle in np.linspace(0.0, block.angle, 23):
        W, load = world_wrenches(block, angle, phase.contacts, phase.floor)
        assert np.linalg.matrix_rank(W, tol=1e-4) == 6
        # pushes of one newton or more that balance, and some that carry the weight
        for wrench in (np.zeros(6), load):
            least = 1.0 if not wrench.any() else block.least
            assert linprog(np.ones(W.shape[1]), A_eq=W, b_eq=wrench, bounds=(least, None)).success


def test_the_body_is_tilted_as_far_as_a_finger_needs(block):
    contacts, at = block.grasp.contacts, block.lies.at
    late, early = list(block.late), [j for j in range(7) if j not in block.late]
    heights = tilted(block.edge, block.angle, at(contacts.points))[:, 2]
    assert heights[late].min() == pytest.approx(block.finger)
    assert np.all(heights >= block.finger - ROUNDING)
    assert np.all(at(contacts.points[early])[:, 2] >= block.finger - ROUNDING)
    assert [block.lies.body.names[block.grasp.faces[j]] for j in late] == ["-z"] * len(late)


def test_the_grasp_that_lifts_is_closed(block):
    W = block.grasp.contacts.wrenches
    assert np.linalg.matrix_rank(W) == 6
    assert linprog(np.ones(7), A_eq=W, b_eq=np.zeros(6), bounds=(1.0, None)).success
    assert block.phase("lift").floor == ()
    sizes = [block.grasp.gripper_size(gripper.name) for gripper in block.grasp.grippers]
    assert max(sizes) <= 2.0 * 0.4 * block.lies.body.size


def test_corners_that_lie_on_the_floor_are_those_of_the_phase(block):
    body, at = block.lies.body, block.lies.at
    low = np.flatnonzero(at(body.vertices)[:, 2] < ROUNDING)
    assert set(block.phase("grip").floor) == set(low.tolist())
    turned = tilted(block.edge, block.angle, at(body.vertices))[:, 2]
    assert set(block.phase("tilt").floor) == set(np.flatnonzero(turned < ROUNDING).tolist())
    assert turned.min() > -ROUNDING


def test_a_body_lies_on_a_face_that_carries_it():
    body = Polyhedron.hull([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0.9, 0.9, 1.0]])
    lies = laid_on_face(body)
    heights = lies.at(body.vertices)[:, 2]
    assert heights.min() > -ROUNDING and np.sum(heights < ROUNDING) == 3
    assert lies.at(body.centre)[:2] == pytest.approx(0.0, abs=ROUNDING)
    # the foot of the centre of mass is inside the triangle
    corners = lies.at(body.vertices[list(lies.corners)])[:, :2]
    shares = np.linalg.solve(np.vstack([corners.T, np.ones(3)]), [0.0, 0.0, 1.0])
    assert shares.min() > 0.0


def test_a_prism_that_overhangs_is_picked_up_as_it_lies():
    around = np.linspace(0.0, 2.0 * np.pi, 7)[:-1]
    body = Polyhedron.prism(0.25 * np.column_stack([np.cos(around), np.sin(around)]), 0.3)
    plan = plan_pickup(body, face="side 5")
    assert plan.edge is None and plan.angle == 0.0 and plan.late == ()
    assert [phase.name for phase in plan.phases] == ["grip", "lift"]
    assert plan.lies.face not in plan.free_faces
    assert all(face != plan.lies.face for face in plan.grasp.faces)
    assert plan.grasp.closure


# --- what cannot be -------------------------------------------------------------------------------


def test_a_flat_pyramid_is_refused_with_a_motion_that_proves_it():
    body = flat_pyramid(0.2)
    with refused(PickupError) as error:
        plan_pickup(body)
    lifting = [refusal for refusal in error.value.refusals if refusal.edge is not None]
    assert len(lifting) == 4
    lies = laid_on_face(body)
    for refusal in lifting:
        # pushes at every corner of every side, and the floor at the edge
        for face in body.faces[:4]:
            for corner in [*face.vertices, *face.vertices.mean(axis=0, keepdims=True)]:
                velocity = refusal.motion[:3] + np.cross(refusal.motion[3:], corner)
                assert -face.normal @ velocity <= ROUNDING
        for v in refusal.edge.vertices:
            velocity = refusal.motion[:3] + np.cross(refusal.motion[3:], body.vertices[v])
            assert lies.pose[2, :3] @ velocity <= ROUNDING
        velocity = refusal.motion[:3] + np.cross(refusal.motion[3:], body.centre)
        assert lies.pose[2, :3] @ velocity > 0.01


def pushes_at(refusal, lies, angle, finger):
    """Points (N, 3) and inward normals (N, 3) that fingers reach at a tilt, the late ones last."""
    body, steps = lies.body, np.arange(61) / 60
    share = np.array([[a, b, 1.0 - a - b] for a in steps for b in steps if a + b < 1.0 + ROUNDING])
    points = [], []
    for k, face in enumerate(body.faces):
        for u, v in zip(face.vertices[1:], face.vertices[2:], strict=False):
            spots = share @ np.array([face.vertices[0], u, v])
            heights = tilted(refusal.edge, angle, lies.at(spots))[:, 2]
            reached = heights >= finger
            if k != lies.face:
                reached &= lies.at(spots)[:, 2] >= finger
            points[k == lies.face].extend((spot, -face.normal) for spot in spots[reached])
    early, late = points
    p, e = (np.reshape([pair[k] for pair in early + late], (-1, 3)) for k in (0, 1))
    return p, e, len(early)


def closes(points, normals):
    """Whether pushes close a body: rank six, and positive forces in balance."""
    W = np.vstack([normals.T, np.cross(points, normals).T])
    balanced = linprog(np.ones(len(points)), A_eq=W, b_eq=np.zeros(6), bounds=(1.0, None))
    return bool(np.linalg.matrix_rank(W) == 6 and balanced.success)


def test_contacts_that_some_smaller_tilt_reaches_are_not_called_impossible():
    body = Polyhedron.hull(
        [[-0.15, 0.1, 0.0], [0.15, -0.15, 0.0], [-0.05, 0.0, 0.15], [-0.05, 0.1, -0.05]]
    )
    with refused(PickupError) as error:
        plan_pickup(body)
    (refusal,) = [r for r in error.value.refusals if r.edge is not None and r.motion is None]
    closed = {
        angle: closes(*pushes_at(refusal, laid_on_face(body), np.radians(angle), 0.03)[:2])
        for angle in (22.0, 30.0, np.degrees(refusal.edge.limit))
    }
    assert list(closed.values()) == [True, False, False]


def test_a_body_is_tilted_less_where_larger_tilts_take_faces_away():
    """Neither the usual tilt nor the largest closes this one; the plan is for one below both."""
    body = Polyhedron.hull(
        [[0.15, -0.1, -0.05], [-0.05, -0.2, 0.15], [-0.05, 0.2, -0.1], [-0.15, 0.2, 0.1]]
    )
    plan = plan_pickup(body, finger=0.02, tip_radius=0.003, gripper_size=0.3)
    for angle in np.radians([30.0, np.degrees(plan.edge.limit)]):
        assert not closes(*pushes_at(plan, plan.lies, angle, 0.02)[:2])
    contacts, at = plan.grasp.contacts, plan.lies.at
    early = [j for j in range(7) if j not in plan.late]
    heights = tilted(plan.edge, plan.angle, at(contacts.points))[:, 2]
    assert heights.min() >= 0.02 - ROUNDING
    assert at(contacts.points[early])[:, 2].min() >= 0.02 - ROUNDING
    assert closes(contacts.points, contacts.normals)
    for phase in plan.phases:
        for angle, forces in zip(phase.angles, phase.forces, strict=True):
            W, load = world_wrenches(plan, angle, phase.contacts, phase.floor)
            np.testing.assert_allclose(W @ forces, load, atol=ROUNDING)
            assert forces.min() >= plan.least - ROUNDING


FEW_TILTS = Polyhedron.hull(
    [[-0.2, 0.0, 0.05], [0.15, 0.05, 0.15], [0.0, -0.15, 0.1], [0.05, 0, 0.05]]
)


def test_no_tilt_closes_a_body_of_which_that_is_said():
    with refused(PickupError) as error:
        plan_pickup(FEW_TILTS, finger=0.06, gripper_size=2e-3, tip_radius=1e-4)
    (refusal,) = [r for r in error.value.refusals if r.reason == NEVER_CLOSED]
    for angle in np.linspace(0.0, refusal.edge.limit, 60)[1:]:
        points, normals, early = pushes_at(refusal, laid_on_face(FEW_TILTS), angle, 0.06)
        assert early == len(points) or not closes(points, normals)


def test_what_few_tilts_do_not_close_is_not_called_impossible(monkeypatch):
    """The ranges of tilts find one that closes the body where those that are tried do not."""
    monkeypatch.setattr(planning, "SCANNED", 1)
    body = Polyhedron.hull(
        [[-0.15, 0.1, 0.0], [0.15, -0.15, 0.0], [-0.05, 0.0, 0.15], [-0.05, 0.1, -0.05]]
    )
    with refused(PickupError) as error:
        plan_pickup(body)
    (refusal,) = [r for r in error.value.refusals if r.edge is not None and r.motion is None]
    assert planning.NOT_CLOSED in refusal.reason
    angle = np.radians(22.0)
    assert closes(*pushes_at(refusal, laid_on_face(body), angle, 0.03)[:2])


def test_contacts_that_only_a_larger_tilt_reaches_are_not_called_impossible():
    with refused(PickupError) as error:
        plan_pickup(FEW_TILTS, finger=0.06, gripper_size=2e-3, tip_radius=1e-4)
    unproven = [r for r in error.value.refusals if r.edge is not None and r.motion is None]
    closed = [
        [
            closes(*pushes_at(refusal, laid_on_face(FEW_TILTS), angle, 0.06)[:2])
            for angle in np.radians([30.0, 40.0])
        ]
        for refusal in unproven
    ]
    assert [False, True] in closed


def test_a_motion_that_no_tilt_prevents_proves_a_refusal():
    body = Polyhedron.hull(
        [[-0.05, 0.15, 0.05], [-0.05, -0.05, -0.1], [0.15, 0.2, 0.05], [-0.1, -0.2, -0.15]]
    )
    with refused(PickupError) as error:
        plan_pickup(body)
    lies, of_all_tilts = laid_on_face(body), 0
    for refusal in error.value.refusals:
        if refusal.edge is None or refusal.motion is None:
            continue
        v, w = refusal.motion[:3], refusal.motion[3:]
        up = lies.pose[2, :3] @ (v + np.cross(w, body.centre))
        leaves = True
        for angle in np.linspace(0.0, refusal.edge.limit, 12):
            points, normals, early = pushes_at(refusal, lies, angle, 0.03)
            work = np.sum(normals * (v + np.cross(w, points)), axis=1)
            leaves &= work.min() > -ROUNDING
            # no push opposes the motion, or those that tilt do no work in it while the weight rises
            assert leaves or (work[:early].max() < ROUNDING and up > 0.0)
        of_all_tilts += leaves
    assert of_all_tilts == 2


def test_a_body_below_a_finger_has_no_free_face():
    with refused(PickupError) as error:
        plan_pickup(Polyhedron.box([0.02, 0.02, 0.02]))
    assert len(error.value.refusals) == 5
    assert all(refusal.motion is None for refusal in error.value.refusals)


def test_a_floor_too_near_is_named():
    with refused(PickupError) as error:
        plan_pickup(Polyhedron.box([0.2, 0.15, 0.9]), finger=0.05)
    # the highest that the face gets before the block falls over
    for refusal in error.value.refusals[1:]:
        width = 0.2 if "x" in refusal.edge.name else 0.15
        assert width * np.sin(refusal.edge.limit) < 0.05
        assert refusal.edge.limit == pytest.approx(0.9 * np.arctan2(width / 2, 0.45))


@pytest.mark.parametrize(
    ("body", "options"),
    [
        (Polyhedron.hull([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0.9, 0.9, 1.0]]), {"face": 3}),
        (Polyhedron.box(SIZE), {"face": "bottom"}),
        (Polyhedron.box(SIZE), {"face": 6}),
        (Polyhedron.box(SIZE), {"face": True}),
        (Polyhedron.box(SIZE), {"finger": 0.0}),
        (Polyhedron.box(SIZE), {"finger": True}),
        (Polyhedron.box(SIZE), {"rng": -1}),
        (Polyhedron.box(SIZE), {"rng": "x"}),
        (Polyhedron.box(SIZE), {"gripper_size": -1.0}),
    ],
)
def test_bodies_and_numbers_that_do_not_do_are_refused(body, options):
    with refused(GraspError):
        plan_pickup(body, **options)


def test_a_body_that_is_not_convex_is_refused():
    around = [[-0.3, -0.3], [0.3, -0.3], [0.3, 0.3], [0.0, 0.0], [-0.3, 0.3]]
    with refused(GraspError):
        plan_pickup(Polyhedron.prism(around, 0.2))


def test_a_number_of_numpy_names_a_face():
    assert laid_on_face(Polyhedron.box(SIZE), np.int64(2)).face == 2


@pytest.mark.parametrize(
    "change",
    [
        {"table": None},
        {"table": "missing/references.csv"},
        {"table": "."},
        {"arms": "ur5"},
        {"arms": None},
        {"arms": [None, "ur5"]},
        {"arms": ["ur5", "nobody"]},
        {"seed": -1},
        {"duration": 0.005},
        {"accuracy": -1.0},
        {"lift": True},
        {"lift": 0.02},
        {"name": 5},
    ],
    ids=str,
)
def test_a_scene_that_cannot_be_is_refused_and_no_table_written(
    block, tmp_path, monkeypatch, change
):
    monkeypatch.chdir(tmp_path)
    with refused(SceneError if {"name"} & {*change} or "nobody" in str(change) else GraspError):
        block.to_scene(**{"table": "references.csv", **change})
    assert list(tmp_path.iterdir()) == []


def test_fingers_below_stay_clear_of_the_floor_at_the_least_lift(block):
    course = block.course(5.0, block.finger, 4.5)
    below = block.grasp.contacts.points[list(block.late)]
    for t in np.linspace(HELD * 4.5, 4.5, 50):
        pose = course.at(t).pose
        assert (below @ pose[2, :3] + pose[2, 3]).min() > block.finger - ROUNDING


def test_arms_that_do_not_fit_are_refused(block, tmp_path):
    table = tmp_path / "references.csv"
    with refused(GraspError):
        block.to_scene(["ur5"], table=table)
    with pytest.raises(GraspError, match="_joint"):  # which one is too weak depends on the plan
        block.to_scene(["ur5", "ur5"], table=table, mass=60.0)
    assert not table.exists()


def test_the_scene_of_the_gallery_is_of_the_kind_that_a_plan_makes_now(block, scene):
    # contacts, and where arms stand, come from searches that depend on the processor
    shown = ma.load_scene(ROOT / "examples" / "scenes" / "pick_up_block.yaml")
    assert (shown.gravity, shown.object, shown.effects, shown.run) == (
        scene.gravity, scene.object, scene.effects, scene.run,
    )  # fmt: skip
    files = [shown.control.file, scene.control.file]
    assert shown.control == scene.control.model_copy(update={"file": files[0]})
    tables = [Path(shown.folder, file).read_text().splitlines() for file in files]
    assert tables[0][0] == tables[1][0]
    times = [[row.split(",")[0] for row in table] for table in tables]
    assert times[0] == times[1]
    assert sum(len(joint.contacts) for joint in shown.joints) == len(block.grasp.contacts)
    radii = {(bool(j.intervals), c.arm.sphere.radius) for j in shown.joints for c in j.contacts}
    assert radii == {
        (bool(j.intervals), c.arm.sphere.radius) for j in scene.joints for c in j.contacts
    }
    begins = {joint.intervals[0].begin for joint in shown.joints if joint.intervals}
    assert begins == {joint.intervals[0].begin for joint in scene.joints if joint.intervals}


# --- runs -----------------------------------------------------------------------------------------


def test_the_block_is_tilted_held_and_lifted_in_one_run(block, trajectory):
    assert trajectory.status == "completed"
    assert trajectory.certificate["met"]
    lets_go = {e["text"]: e["time"] for e in trajectory.events if e["kind"] == "lets go"}
    (attached,) = [e for e in trajectory.events if e["kind"] == "attached"]
    names = [f"floor: corner {v + 1} lets go" for v in block.lies.corners]
    pivot = [f"floor: corner {v + 1} lets go" for v in block.edge.vertices]
    first = [lets_go[name] for name in names if name not in pivot]
    last = [lets_go[name] for name in pivot]
    assert max(first) < attached["time"] < min(last)
    assert attached["energy_loss"] < 1e-6
    rise = trajectory.object_position[-1] - trajectory.object_position[0]
    np.testing.assert_allclose(rise, [0.0, 0.0, 0.1], atol=1e-4)


def test_the_certificate_is_true(system, trajectory):
    accurate = ma.simulate(system, output_step=0.01, accuracy=1e-8, certificate=False)
    off = np.linalg.norm(accurate.object_position - trajectory.object_position, axis=1)
    turn = Rotation.from_quat(accurate.object_quaternion_xyzw)
    turned = turn * Rotation.from_quat(trajectory.object_quaternion_xyzw).inv()
    assert off.max() < trajectory.certificate["asked"]["position_m"]
    assert turned.magnitude().max() < trajectory.certificate["asked"]["rotation_rad"]


def test_the_edge_stays_where_it_is_while_the_block_is_tilted(block, trajectory):
    attached = next(e["time"] for e in trajectory.events if e["kind"] == "attached")
    k = int(np.searchsorted(trajectory.time, attached))
    R = Rotation.from_quat(trajectory.object_quaternion_xyzw[: k + 1])
    for v in block.edge.vertices:
        corner = block.lies.body.vertices[v] - block.lies.body.centre
        places = R.apply(corner) + trajectory.object_position[: k + 1]
        np.testing.assert_allclose(places, [places[0]] * (k + 1), atol=2e-5)
    assert (R[k] * R[0].inv()).magnitude() == pytest.approx(block.angle, abs=1e-4)


def test_hands_press_as_planned(block, trajectory):
    weight = 5.0 * 9.81
    early = np.hstack([trajectory.contact_forces[g.arm_name] for g in block.grasp.grippers])
    assert early.min() > 0.9 * block.least * weight
    assert early.max() < 1.1 * block.largest * weight
    held = trajectory.time > trajectory.time[-1] * 0.7
    for name, forces in trajectory.contact_forces.items():
        if name.endswith("_below"):
            assert forces[held].min() > 0.9 * block.least * weight
    # at rest and tilted, forces are those of the plan
    k = int(np.searchsorted(trajectory.time, 0.46 * trajectory.time[-1]))
    phase = block.phase("tilt")
    planned = phase.forces[-1][: len(phase.contacts)] * weight
    np.testing.assert_allclose(early[k], planned, atol=0.02 * weight)


def test_contacts_are_closed_to_roundings(block, trajectory):
    assert trajectory.position_drift.max() < 1e-9
    assert trajectory.contact_forces["floor"].min() >= 0.0
