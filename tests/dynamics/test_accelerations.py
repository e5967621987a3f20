"""Claims about accelerations and contact forces at one state.

Oracles: the worked two-arm example; the whole system assembled from Pinocchio's inverse dynamics
and from differences of plain gaps (``mechanics.plain_system``); Pinocchio's constrained dynamics.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
from mechanics import (
    UR5_WRIST_SINGULAR,
    G,
    chain_urdf,
    object_terms,
    panda_trio,
    plain_gaps,
    plain_system,
    planar_pair,
    project_velocity,
    random_state,
    scene_of,
    single_arm,
    solve_plain,
    stacked,
    two_arm_block,
    two_arm_block_twice,
    ur5_pair,
)
from pinocchio_forest import constrained_forest
from repository import SCENES, WORKED
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.errors import ModelError
from multiarm.scene import Pose

EXPECTED = WORKED["two_arm_block_system"]["expected"]


# --- the worked example --------------------------------------------------------------------------


def test_object_accelerates_as_in_the_worked_example():
    data = WORKED["object_dynamics"]["inputs"]
    inertia, bias = object_terms(
        data["m"], np.array(data["I_body"]), np.array(data["R"]),
        np.array(data["xdot"] + data["omega"]), np.array(data["gravity"]),
    )  # fmt: skip
    acceleration = np.linalg.solve(inertia, np.array(data["wrench"]) - bias)
    expected = WORKED["object_dynamics"]["expected"]["vdot_classical_world"]
    np.testing.assert_allclose(acceleration, expected, atol=1e-10)


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_two_arms_and_block_accelerate_as_in_the_worked_example(block_system, solver):
    ev = ma.evaluate(block_system.with_solver(solver))
    np.testing.assert_allclose(ev.object_acceleration, EXPECTED["vdot"], atol=1e-7)
    q, force = stacked(ev)
    np.testing.assert_allclose(q[6:], EXPECTED["qdd"], atol=1e-7 * np.max(np.abs(EXPECTED["qdd"])))
    np.testing.assert_allclose(force, EXPECTED["mu_phys"], atol=1e-7)
    assert all(unique.all() for unique in ev.contact_forces_unique.values())


def test_contact_matrices_are_those_of_the_worked_example(block_system):
    ev = ma.evaluate(block_system)
    for i, name in enumerate(block_system.arm_names):
        terms = ev.contact_terms[name]
        np.testing.assert_allclose(terms.W_o, EXPECTED["Wo"][i], atol=1e-9)
        np.testing.assert_allclose(terms.W_m, EXPECTED["Wm"][i], atol=1e-9)
        np.testing.assert_allclose(terms.phi, 0.0, atol=1e-12)
        np.testing.assert_allclose(terms.phi_dot, 0.0, atol=1e-12)
        # the kernel's c leaves the arm's bias in; the example's c is the right-hand side itself
        np.testing.assert_allclose(terms.c, EXPECTED["c"][i], atol=1e-9)
        arm = block_system.arms[name]
        state = ev.state
        t = arm.terms(state.joint_positions[name], state.joint_velocities[name])
        J_local = np.vstack([t.tip_rotation.T @ t.J[:3], t.tip_rotation.T @ t.J[3:]])
        np.testing.assert_allclose(J_local.T @ terms.W_m, EXPECTED["Woff"][i], atol=1e-9)


def test_energy_of_the_worked_example(block_system):
    trajectory = ma.simulate(block_system, duration=1e-3, integrator="rk4", step=1e-3)
    assert trajectory.energy[0] == pytest.approx(EXPECTED["total_energy"], abs=1e-8)


def test_contact_forces_split_into_carried_load_and_internal_force(block_system):
    """lambda = W_o^+ f_o + A_o mu_I with the worked basis A_o (3.4.2)."""
    ev = ma.evaluate(block_system)
    W_o = ev.W_o
    _, force = stacked(ev)
    A_o = np.array(EXPECTED["Ao"])
    np.testing.assert_allclose(W_o @ A_o, 0.0, atol=1e-12)
    internal = force - np.linalg.pinv(W_o) @ (W_o @ force)
    np.testing.assert_allclose(internal, A_o * (A_o @ force) / (A_o @ A_o), atol=1e-9)
    first = np.linalg.pinv(W_o)[0] @ (W_o @ force)
    assert force[0] - first == pytest.approx(EXPECTED["mu_I"], abs=1e-7)


# --- against a system assembled from differences -------------------------------------------------


def mixed_contacts(X_OT):
    """Every surface on either body, sharp and round tips, within one arm, all just touching."""
    rng = np.random.default_rng(3)
    X_TO, pairs = np.linalg.inv(X_OT), []
    for k, shape in enumerate(("plane", "sphere", "bore", "cylinder", "plane")):
        touch, normal, across = (
            rng.uniform(-0.1, 0.1, 3),
            *np.linalg.qr(rng.normal(size=(3, 2)))[0].T,
        )
        radius, tip = 0.3 + 0.1 * k, 0.01 * k
        middle = touch + (radius if shape == "bore" else -radius) * normal
        X_surface, X_tip = (np.eye(4), X_TO) if k % 2 else (X_TO, np.eye(4))
        moved = lambda X, p: (X[:3, :3] @ p + X[:3, 3]).tolist()  # noqa: E731
        turned = lambda X, a: (X[:3, :3] @ a).tolist()  # noqa: E731
        surface = {
            "plane": {
                "plane": {"point": moved(X_surface, touch), "normal": turned(X_surface, normal)}
            },
            "sphere": {"sphere": {"center": moved(X_surface, middle), "radius": radius}},
            "cylinder": {
                "cylinder": {
                    "point": moved(X_surface, middle),
                    "radius": radius,
                    "axis": turned(X_surface, across),
                }
            },
        }["cylinder" if shape == "bore" else shape]
        if shape == "bore":
            surface["cylinder"]["inside"] = True
        centre = moved(X_tip, touch + tip * normal)
        finger = {"sphere": {"center": centre, "radius": tip}} if tip else {"point": centre}
        pairs.append((finger, surface) if k % 2 else (surface, finger))
    return [{"arm": arm, "object": body} for arm, body in pairs]


def touching(_):
    """One arm that touches its object by five contacts of all kinds; geometry in the tip frame.

    Odd contacts have their surface on the object.
    """
    posture = [0.3, -0.6, 1.1, 0.4, 0.7, -0.2]
    free = ma.compile_system(single_arm("textbook_6r", "tool", posture, {"kind": "ball"}))
    X_WT = free.arms["arm"].tip_pose(np.array(posture))
    X_WO = free.scene.object.pose.matrix()
    joint = {"kind": "contacts", "contacts": mixed_contacts(np.linalg.inv(X_WO) @ X_WT)}
    return single_arm("textbook_6r", "tool", posture, joint)


def crowded(tmp_path):
    """Nine arms of three hinges: more than Pinocchio gets in one model."""
    urdf = tmp_path / "chain.urdf"
    urdf.write_text(chain_urdf("zyx"))
    arms, joints = {}, []
    for k in range(9):
        angle = 2 * math.pi * k / 9
        base = {"xyz": [math.cos(angle), math.sin(angle), 0], "rpy": [0, 0, angle]}
        arms[f"arm_{k}"] = {
            "urdf": str(urdf),
            "tip": "tip",
            "base": base,
            "posture": [0.2, 0.5, -0.4],
        }
        joints.append({"arm": f"arm_{k}", "kind": "ball" if k % 2 else "planar"})
    return scene_of(arms, joints)


def own_chain(kinds, joint):
    def build(tmp_path):
        urdf = tmp_path / "chain.urdf"
        urdf.write_text(chain_urdf(kinds))
        posture = [0.1 + 0.2 * k for k in range(len(kinds))]
        arm = {"urdf": str(urdf), "tip": "tip", "posture": posture}
        body = {"shape": {"box": [0.2, 0.3, 0.1]}, "mass": 2.0, "inertia": [0.3, 0.4, 0.5]}
        return scene_of({"arm": arm}, [{"arm": "arm", **joint}], object=body)

    return build


KINOVA = {
    "robot": "kinova",
    "tip": "j2s6s200_end_effector",
    "posture": [0.4, 2.9, 1.3, -2.0, 1.4, 7.0],
}
SYSTEMS = {
    "worked_example": lambda _: two_arm_block(),
    "weld_and_ball": lambda _: ur5_pair({"kind": "weld"}, {"kind": "ball"}),
    "universal_and_slide": lambda _: ur5_pair(
        {"kind": "universal", "size": 0.8}, {"kind": "prismatic", "axis": [1, 2, 3]}
    ),
    "redundant_arms": lambda _: panda_trio({"kind": "cylindrical", "axis": [1, 0, 1], "size": 0.8}),
    "fingertips": lambda _: ma.load_scene(SCENES / "corner_grippers_block.yaml"),
    "round_faces": lambda _: ur5_pair(
        {"kind": "point_on_cylinder", "radius": 0.4, "tip_radius": 0.03, "inside": True},
        {"kind": "point_on_sphere", "radius": 0.4, "tip_radius": 0.03},
    ),
    "mixed_contacts": touching,
    "continuous_joints": lambda _: scene_of(
        {"a": KINOVA}, [{"arm": "a", "kind": "revolute", "size": 0.8}]
    ),
    "slides": own_chain("uwzYxv", {"kind": "weld"}),
    "one_hinge": own_chain("y", {"kind": "point_on_plane", "normal": [1, 1, 1]}),
    "sixteen_joints": own_chain("zxyuZxyzvyxzYxyz", {"kind": "weld"}),
    "nine_arms": crowded,
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_evaluation_solves_the_equations_of_motion(name, tmp_path, rng):
    """At states off the constraints, with inconsistent velocities of everything."""
    system = ma.compile_system(SYSTEMS[name](tmp_path))
    np.testing.assert_allclose(plain_gaps(system, system.initial_state()), 0.0, atol=1e-12)
    for turn in (0.05, 0.2):
        state = random_state(system, rng, turn)
        ev = ma.evaluate(system, 0.3, state)
        M, f_j, W, c = plain_system(system, state, ev.joint_torques)
        q, force = stacked(ev)
        assert_small(M @ q - W @ force - f_j, np.abs(M) @ np.abs(q) + np.abs(W) @ np.abs(force))
        assert_small(W.T @ q - c, np.abs(W.T) @ np.abs(q) + np.abs(c))
        terms = ev.contact_terms.values()
        assert_small(np.concatenate([t.c for t in terms]) - c, np.abs(c) + 1.0)
        gaps = plain_gaps(system, state)
        np.testing.assert_allclose(np.concatenate([t.phi for t in terms]), gaps, atol=1e-12)


def assert_small(residual, terms):
    """What is left over is small against the terms that cancel (differences: 1e-8)."""
    assert np.max(np.abs(residual) / (terms + 1e-6 * np.max(terms))) < 2e-8


# --- against Pinocchio's constrained dynamics ----------------------------------------------------


def pinocchios_solution(system, state, contact_type):
    """Accelerations in our order and axes, and the wrench (or force) on each arm's tip."""
    model, q, R, models, datas = constrained_forest(system, state, contact_type)
    twist = state.object_twist
    v = np.concatenate([*state.joint_velocities.values(), R.T @ twist[:3], R.T @ twist[3:]])
    data = model.createData()
    pin.initConstraintDynamics(model, data, models, datas)
    # a zero regularisation returns NaN; with this one the proximal iterations converge to rounding
    settings = pin.ProximalSettings(1e-15, 1e-9, 200)
    a = pin.constraintDynamics(model, data, q, v, np.zeros(model.nv), models, datas, settings)
    spatial, local = a[-6:], v[-6:]
    linear = R @ (spatial[:3] + np.cross(local[3:], local[:3]))
    accelerations = np.concatenate([linear, R @ spatial[3:], a[:-6]])
    return accelerations, [d.contact_force.vector for d in datas]


@pytest.mark.parametrize("build", ["ur5_pair", "panda_trio"])
@pytest.mark.parametrize("kind", ["weld", "ball"])
def test_accelerations_and_forces_equal_pinocchios_constrained_dynamics(build, kind, rng):
    joint = {"kind": kind}
    scene = ur5_pair(joint, joint) if build == "ur5_pair" else panda_trio(joint)
    system = ma.compile_system(scene)
    moving = random_state(system, rng, turn=0.0)
    state = project_velocity(system, moving)
    contact = pin.ContactType.CONTACT_6D if kind == "weld" else pin.ContactType.CONTACT_3D
    expected, wrenches = pinocchios_solution(system, state, contact)
    for solver in ("node", "dense"):
        ev = ma.evaluate(system.with_solver(solver), 0.0, state)
        q, _ = stacked(ev)
        np.testing.assert_allclose(q, expected, atol=1e-9 * np.max(np.abs(expected)))
        for name, wrench in zip(system.arm_names, wrenches, strict=True):
            on_tip = ev.contact_terms[name].W_m @ ev.contact_forces[name]
            np.testing.assert_allclose(on_tip, wrench, atol=1e-8 * np.max(np.abs(wrench)))


# --- properties ----------------------------------------------------------------------------------


def test_inverse_dynamics_of_the_result_gives_the_torques_back(block_system, rng):
    """tau = rnea(q, q', q'') - J^T (contact wrench), and Newton-Euler for the object."""
    state = random_state(block_system, rng)
    ev = ma.evaluate(block_system, 0.0, state)
    R = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
    on_object = np.zeros(6)
    for name, arm in block_system.arms.items():
        q, v = state.joint_positions[name], state.joint_velocities[name]
        a, lam = ev.joint_accelerations[name], ev.contact_forces[name]
        terms, model = ev.contact_terms[name], arm.model.copy()
        frame = pin.ReferenceFrame.LOCAL
        data, q_pin = model.createData(), arm.configuration(q)
        J = pin.computeFrameJacobian(model, data, q_pin, arm.tip.frame_id, frame)
        tau = pin.rnea(model, data, q_pin, v, a) - J.T @ terms.W_m @ lam
        np.testing.assert_allclose(tau, ev.joint_torques[name], atol=1e-9)
        on_object += terms.W_o @ lam
    body, twist = block_system.scene.object, state.object_twist
    I = R @ body.inertia_matrix() @ R.T
    force = body.mass * (ev.object_acceleration[:3] - G)
    moment = I @ ev.object_acceleration[3:] + np.cross(twist[3:], I @ twist[3:])
    np.testing.assert_allclose(R @ on_object[:3], force, atol=1e-9)
    np.testing.assert_allclose(R @ on_object[3:], moment, atol=1e-9)


def test_forces_act_at_the_points_along_the_normals(rng):
    """Newton-Euler from what a user sees: contact_points, contact_normals, contact_forces."""
    system = ma.compile_system(touching(None))
    state = project_velocity(system, random_state(system, rng, turn=0.0))
    ev = ma.evaluate(system, 0.0, state)
    f = ev.contact_forces["arm"][:, None] * ev.contact_normals["arm"]
    r = ev.contact_points["arm"] - state.object_position
    R = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
    body, omega = system.scene.object, state.object_twist[3:]
    I = R @ body.inertia_matrix() @ R.T
    np.testing.assert_allclose(f.sum(0), body.mass * (ev.object_acceleration[:3] - G), atol=1e-9)
    moment = I @ ev.object_acceleration[3:] + np.cross(omega, I @ omega)
    np.testing.assert_allclose(np.cross(r, f).sum(0), moment, atol=1e-9)
    # the points are on the surfaces: they move to the fingertip's centre by its radius
    for contact, point in zip(system.contacts["arm"], ev.contact_points["arm"], strict=True):
        on_object = contact.surface_body == 0
        X_WO = np.eye(4)
        X_WO[:3, :3], X_WO[:3, 3] = R, state.object_position
        X_WT = system.arms["arm"].tip_pose(state.joint_positions["arm"])
        centre = ((X_WT if on_object else X_WO) @ np.append(contact.follower.origin, 1.0))[:3]
        assert np.linalg.norm(point - centre) == pytest.approx(contact.follower.sizes[0], abs=1e-12)


def test_a_result_certifies_itself(ur5_system, rng):
    ev = ma.evaluate(ur5_system, 0.0, random_state(ur5_system, rng))
    scale = max(1.0, *(np.max(np.abs(f)) for f in ev.contact_forces.values()))
    for residual in (ev.residuals.arm, ev.residuals.object, ev.residuals.constraint):
        assert residual < 1e-11 * scale
    assert ev.position_residual > 1e-3 and ev.velocity_residual > 1e-3  # and tells the truth
    assert all(0.0 < pivot <= 1.0 for pivot in ev.conditioning.values())


def test_moving_the_whole_scene_moves_the_result(rng):
    """A rotation about the vertical and any displacement change nothing but the axes."""
    data = ur5_pair({"kind": "weld"}, {"kind": "universal"}).model_dump(exclude_unset=True)
    here = ma.compile_system(scene_of(data["arms"], data["joints"], object=data["object"]))
    turn, shift = Rotation.from_rotvec([0, 0, 0.8]), np.array([3.0, -2.0, 1.5])

    def moved(spec):
        X = Pose(**spec).matrix()
        quaternion = (turn * Rotation.from_matrix(X[:3, :3])).as_quat()
        return {"xyz": turn.apply(X[:3, 3]) + shift, "quaternion_xyzw": quaternion}

    for spec in (data["object"], *data["arms"].values()):
        key = "pose" if "pose" in spec else "base"
        spec[key] = moved({k: v for k, v in spec[key].items() if v is not None})
    there = ma.compile_system(scene_of(data["arms"], data["joints"], object=data["object"]))
    state = project_velocity(here, random_state(here, rng, turn=0.0))
    twist = np.concatenate([turn.apply(state.object_twist[:3]), turn.apply(state.object_twist[3:])])
    first = ma.evaluate(here, 0.0, state)
    second = ma.evaluate(
        there, 0.0, there.state(object_twist=twist, joint_velocities=state.joint_velocities)
    )
    a = first.object_acceleration
    expected = np.concatenate([turn.apply(a[:3]), turn.apply(a[3:])])
    np.testing.assert_allclose(second.object_acceleration, expected, atol=1e-9)
    for name in here.arm_names:
        np.testing.assert_allclose(
            second.joint_accelerations[name], first.joint_accelerations[name], atol=1e-8
        )
        np.testing.assert_allclose(
            second.contact_forces[name], first.contact_forces[name], atol=1e-8
        )


def test_the_order_of_the_arms_does_not_matter(rng):
    scene = panda_trio({"kind": "ball"})
    turned = scene.replace(arms=dict(reversed(scene.arms.items())), joints=scene.joints[::-1])
    one, other = ma.compile_system(scene), ma.compile_system(turned)
    state = random_state(one, rng)
    same = other.state(
        state.object_position, state.object_quaternion_xyzw, state.joint_positions,
        state.object_twist, state.joint_velocities,
    )  # fmt: skip
    first, second = ma.evaluate(one, 0.0, state), ma.evaluate(other, 0.0, same)
    np.testing.assert_allclose(first.object_acceleration, second.object_acceleration, atol=1e-10)
    for name in one.arm_names:
        np.testing.assert_allclose(
            first.joint_accelerations[name], second.joint_accelerations[name], atol=1e-9
        )
        np.testing.assert_allclose(
            first.contact_forces[name], second.contact_forces[name], atol=1e-9
        )


def test_without_gravity_a_scene_at_rest_stays_at_rest():
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"}).replace(gravity=None)
    q, force = stacked(ma.evaluate(ma.compile_system(scene)))
    np.testing.assert_array_equal(q, 0.0)
    np.testing.assert_array_equal(force, 0.0)


# --- arms that cannot follow, contacts that repeat -----------------------------------------------


HARD = {
    "planar_2r_ball": lambda: planar_pair("planar_2r", [0.7, -1.4], {"kind": "ball"}),
    "planar_2r_revolute": lambda: planar_pair("planar_2r", [0.7, -1.4], {"kind": "revolute"}),
    "planar_3r_weld": lambda: planar_pair("planar_3r", [0.7, -1.4, 0.5], {"kind": "weld"}),
    "wrist_singularity": lambda: single_arm("ur5", "tool0", UR5_WRIST_SINGULAR, {"kind": "weld"}),
    "repeated_contacts": lambda: two_arm_block_twice(),
}


@pytest.mark.parametrize("solver", ["node", "dense"])
@pytest.mark.parametrize("name", HARD)
def test_arms_that_cannot_follow_move_as_the_whole_system_does(name, solver, rng):
    system = ma.compile_system(HARD[name]()).with_solver(solver)
    state = project_velocity(system, random_state(system, rng, turn=0.0))
    ev = ma.evaluate(system, 0.0, state)
    M, f_j, W, c = plain_system(system, state, ev.joint_torques)
    q, force = stacked(ev)
    expected, _ = solve_plain(M, f_j, W, c)
    np.testing.assert_allclose(q, expected, atol=1e-6 * np.max(np.abs(expected)))
    assert_small(W.T @ q - c, np.abs(W.T) @ np.abs(q) + np.abs(c))
    assert_small(M @ q - W @ force - f_j, np.abs(M) @ np.abs(q) + np.abs(W) @ np.abs(force))
    # no other forces that do the same are smaller
    np.testing.assert_allclose(
        force, np.linalg.pinv(W, rcond=1e-9) @ W @ force, atol=1e-7 * np.max(np.abs(force))
    )
    assert ev.rank == np.linalg.matrix_rank(W / np.linalg.norm(W, axis=0), tol=1e-9)


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_repeated_contacts_share_their_force_and_say_so(block_system, solver):
    repeated = ma.compile_system(two_arm_block_twice()).with_solver(solver)
    once, twice = ma.evaluate(block_system), ma.evaluate(repeated)
    np.testing.assert_allclose(
        twice.object_acceleration, once.object_acceleration, rtol=1e-9, atol=1e-9
    )
    for name in block_system.arm_names:
        shared = once.contact_forces[name].copy()
        shared[0] /= 2
        np.testing.assert_allclose(twice.contact_forces[name][:-1], shared, atol=1e-8)
        assert twice.contact_forces[name][-1] == pytest.approx(shared[0], abs=1e-8)
        determined = [False, *[True] * (len(shared) - 1), False]
        assert twice.contact_forces_unique[name].tolist() == determined


def test_a_singular_arm_is_named_with_what_it_cannot_do(ur5_system):
    posture = {"left": UR5_WRIST_SINGULAR}
    ev = ma.evaluate(ur5_system, 0.0, ur5_system.state(joint_positions=posture))
    assert ev.coupled_arms == ("left",) and ev.conditioning["left"] < 1e-12
    assert list(ev.lost_motions) == ["left"] and "no " in ev.lost_motions["left"][0]
    regular = ma.evaluate(ur5_system)
    assert regular.coupled_arms == () and regular.lost_motions == {}
    assert ev.rank == regular.rank == ur5_system.model.layout.contacts


def test_pivot_tells_how_near_a_singularity_is(ur5_system):
    pivots = []
    for angle in (1.0, 0.1, 0.01, 0.001):
        posture = [*UR5_WRIST_SINGULAR[:4], angle, 0.0]
        state = ur5_system.state(joint_positions={"left": posture})
        pivots.append(ma.evaluate(ur5_system, 0.0, state).conditioning["left"])
    assert all(a > 10 * b > 0 for a, b in itertools.pairwise(pivots))


# --- states and controllers from outside ---------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"object_position": [0, 0]}, r"object_position: expected shape \(3,\)"),
        ({"object_twist": [0, 0, 0, 0, 0, math.nan]}, "object_twist: a number is not finite"),
        ({"object_quaternion_xyzw": [0, 0, 0, 0]}, "object_quaternion_xyzw has length zero"),
        ({"joint_positions": {"middle": [0] * 6}}, "unknown arm 'middle'; arms are left, right"),
        ({"joint_velocities": {"left": [0] * 7}}, r"joint_velocities\['left'\]: expected shape"),
        ({"object_position": "here"}, "object_position: expected 3 numbers"),
    ],
)
def test_unusable_states_are_refused_with_their_place(ur5_system, given, message):
    with pytest.raises(ModelError, match=message):
        ur5_system.state(**given)


def test_a_state_is_normalised_and_independent(ur5_system):
    state = ur5_system.state(object_quaternion_xyzw=[0, 0, 0, 2.0])
    np.testing.assert_array_equal(state.object_quaternion_xyzw, [0, 0, 0, 1])
    state.joint_positions["left"][:] = 9.0
    assert not np.any(ur5_system.initial_state().joint_positions["left"] == 9.0)


def test_evaluation_leaves_the_given_state_alone(ur5_system, rng):
    state = random_state(ur5_system, rng)
    before = state.copy()
    ev = ma.evaluate(ur5_system, 0.0, state)
    state.position[:] = 0.0
    np.testing.assert_array_equal(ev.state.position, before.position)


def test_torques_of_one_control_do_not_linger_in_a_system_without(free_block_system):
    """Systems made from each other share their arrays; the results must not show it."""
    driven = free_block_system.with_control(lambda t, state: {"one": np.full(6, 5.0)})
    assert ma.evaluate(driven).joint_torques["one"].tolist() == [5.0] * 6
    np.testing.assert_array_equal(ma.evaluate(free_block_system).joint_torques["one"], 0.0)
