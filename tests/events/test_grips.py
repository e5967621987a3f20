"""Claims about the impact at which a joint takes hold of moving bodies.

Oracle: momentum and the joints' rows by textbook, with 50 digits (:mod:`grip_oracle`); of contacts
without friction the nearest velocity that they allow, with friction the laws of impulses.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from grip_oracle import Momentum, stop_approach, stop_rates, unexplained
from mechanics import PANDA_FINGERS, PANDA_POSTURE, UR5_POSTURE, UR5_WRIST_SINGULAR
from scipy.spatial.transform import Rotation
from timed_scenes import AFTER, EXACT, Table, at_event, held_never, last_state, switches

import multiarm as ma
from multiarm.scene import parse_scene

GRIP = 0.05
"""When joints take hold [s]."""
SAME = 1e-10
DOWN = [0.0, 0.0, -9.81]
SPIN = [0.7, -0.4, 1.9, 3.0, -2.0, 4.0]


class Case(NamedTuple):
    """A grip: the system just before it, velocities after it, and its events."""

    before: Momentum
    after: np.ndarray
    run: ma.Trajectory

    @property
    def attached(self) -> list[Table]:
        return [e for e in switches(self.run) if e["kind"] == "attached"]


def grip(table: Table, *names: str) -> Case:
    """A run over the instant at which the joints of some names take hold."""
    loose = ma.compile_system(parse_scene(held_never(table, *names)))
    before = ma.simulate(loose, GRIP, output_times=[GRIP], **EXACT)
    run = ma.simulate(
        ma.compile_system(parse_scene(table)), GRIP + 2e-3, output_times=GRIP + AFTER, **EXACT
    )
    for trajectory in (before, run):
        assert trajectory.status == "completed", trajectory.message
    parts = [motion.twist for motion in run.objects.values()]
    parts += [run.joint_velocities[name] for name in loose.arms]
    after = np.concatenate([at_event(part) for part in parts])
    return Case(Momentum.of(loose, last_state(loose, before)), after, run)


def plate(**more: Any) -> Table:
    return {
        "shape": {"box": [0.4, 0.3, 0.02]}, "mass": 2.5,
        "inertia": [0.02, 0.001, -0.002, 0.035, 0.003, 0.052],
        "pose": {"xyz": [0.6, 0.3, 0.5], "rpy": [0.3, 0.4, 0.5]}, "twist": SPIN, **more,
    }  # fmt: skip


def ur5(posture=UR5_POSTURE, rates=(0.3, -0.5, 0.4, 0.8, -0.6, 1.1), **more: Any) -> Table:
    return {"robot": "ur5", "tip": "tool0", "posture": list(posture), "velocity": list(rates),
            **more}  # fmt: skip


PANDA = {
    "robot": "panda", "tip": "panda_hand_tcp", "posture": PANDA_POSTURE, "lock": PANDA_FINGERS,
    "velocity": [0.3, -0.5, 0.4, 0.8, -0.6, 1.1, -0.9],
}  # fmt: skip


def scene(arms: Table, joints: list[Table], body: Table | None = None, **more: Any) -> Table:
    return {"gravity": DOWN, "object": body or plate(), "arms": arms, "joints": joints, **more}


def on_object(case: Case, arm: str, wrench: np.ndarray) -> np.ndarray:
    """A wrench at an arm's tip about the centre of the object."""
    lever = case.before.tip(arm) - case.before.state.object_position
    return np.concatenate([wrench[:3], wrench[3:] + np.cross(lever, wrench[:3])])


def assert_same(actual: np.ndarray, exact: np.ndarray) -> None:
    """Up to ``SAME`` of the largest."""
    np.testing.assert_allclose(actual, exact, rtol=0.0, atol=SAME * np.max(np.abs(exact)))


# --- one grip -------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["weld", "ball", "revolute"])
@pytest.mark.parametrize("arm", [ur5(), PANDA], ids=["ur5", "panda"])
def test_an_arm_that_grips_a_spinning_plate_obeys_the_balance_of_momentum(arm, kind):
    case = grip(scene({"arm": arm}, [{"arm": "arm", "kind": kind, "from": GRIP}]), "arm")
    before, (event,) = case.before, case.attached
    assert event["time"] == GRIP
    tip = before.tip("arm")
    turns = {"weld": [], "ball": np.eye(3)}.get(kind)
    if turns is None:  # about the z axis of the tip
        robot, data = before.system.arms["arm"], before.system.arms["arm"].model.createData()

        q = robot.configuration(before.state.joint_positions["arm"])
        pin.framesForwardKinematics(robot.model, data, q)
        turns = [data.oMf[robot.tip.frame_id].rotation[:, 2]]
    exact = stop_rates(before, before.closed("arm", "object", tip, turns))
    assert_same(case.after, exact.velocity)
    np.testing.assert_allclose(event["energy_loss"], exact.energy_lost, rtol=SAME)
    object_change = (before.M @ (exact.velocity - before.v))[:6]
    assert_same(np.array(event["impulse"]), object_change)
    if kind == "weld":
        assert_same(np.array(event["impulse"]), on_object(case, "arm", exact.impulses))


def test_a_second_arm_that_grips_stops_what_both_chains_cannot_do():
    """The first one holds the object already; its impulse passes through the object."""
    arms = {
        "left": ur5(base={"xyz": [-1.1, 0, 0]}),
        "right": ur5(base={"xyz": [1.1, 0.2, 0.1], "rpy": [0, 0, 3.0]}, rates=[0.5] * 6),
    }
    joints = [{"arm": "left", "kind": "weld"}, {"arm": "right", "kind": "weld", "from": GRIP}]
    body = {key: value for key, value in plate().items() if key not in ("pose", "twist")}
    case = grip(scene(arms, joints, body), "right")
    before, (event,) = case.before, case.attached
    exact = stop_rates(
        before,
        np.vstack([before.closed(arm, "object", before.tip(arm)) for arm in arms]),
    )
    assert_same(case.after, exact.velocity)
    np.testing.assert_allclose(event["energy_loss"], exact.energy_lost, rtol=SAME)
    assert_same(np.array(event["impulse"]), on_object(case, "right", exact.impulses[6:]))


def test_grips_that_repeat_each_other_stop_the_same():
    """Two hinges on one axis are taken at once; the arm that holds already lets one motion be."""
    hinge = {"between": ["object", "world"], "kind": "revolute", "axis": [0, 0, 1], "from": GRIP}
    places = ([0.1, 0.05, -0.2], [0.1, 0.05, 0.3])
    joints = [{"arm": "arm", "kind": "weld"}]
    joints += [
        {**hinge, "name": f"hinge{k}", "at_first": {"xyz": at}} for k, at in enumerate(places)
    ]
    body = {key: value for key, value in plate().items() if key not in ("pose", "twist")}
    case = grip(scene({"arm": ur5()}, joints, body), "hinge0", "hinge1")
    before = case.before
    R = Rotation.from_quat(before.state.object_quaternion_xyzw).as_matrix()
    rows = [before.closed("arm", "object", before.tip("arm"))]
    for at in places:
        point = before.state.object_position + R @ at
        rows.append(before.closed("object", "world", point, [R[:, 2]]))
    exact = stop_rates(before, np.vstack(rows))
    assert np.count_nonzero(exact.impulses) == 11
    assert np.linalg.norm(exact.velocity) > 1e-3
    assert_same(case.after, exact.velocity)
    for event in case.attached:  # of all at this instant
        np.testing.assert_allclose(event["energy_loss"], exact.energy_lost, rtol=SAME)
    # the hinges' impulses on the world about their places, together with that of the arm
    assert len(case.attached) == 2
    change = before.M @ (exact.velocity - before.v)
    wrench = np.zeros(6)
    for event, at in zip(case.attached, places, strict=True):
        force, moment = np.split(np.array(event["impulse"]), 2)
        wrench -= [*force, *(moment + np.cross(R @ at, force))]
    # of the arm from its own equations
    J = before.jacobian("arm", before.tip("arm"))[:, 6:]
    of_arm = np.linalg.solve(J.T, -change[6:])
    assert_same(wrench + on_object(case, "arm", of_arm), change[:6])


def test_a_singular_arm_grips_as_any_other():
    joints = [
        {"between": ["object", "world"], "name": "hinge", "kind": "revolute", "axis": [0, 1, 0],
         "at_first": {"xyz": [0.2, 0.0, 0.0]}},
        {"arm": "arm", "kind": "weld", "from": GRIP},
    ]  # fmt: skip
    body = plate(twist=[0.0] * 6, pose={"xyz": [0.6, 0.3, 0.5]})
    table = scene({"arm": ur5(UR5_WRIST_SINGULAR, [0.0] * 6)}, joints, body,
                  control={"kind": "gravity_compensation"})  # fmt: skip
    case = grip(table, "arm")
    before, (event,) = case.before, case.attached
    J = before.jacobian("arm", before.tip("arm"))[:, 6:]
    assert np.linalg.svd(J)[1][-1] < 1e-12
    assert np.linalg.norm(before.v) > 0.1
    R = Rotation.from_quat(before.state.object_quaternion_xyzw).as_matrix()
    pivot = before.state.object_position + R @ [0.2, 0.0, 0.0]
    rows = [before.closed("object", "world", pivot, [R[:, 1]])]
    rows.append(before.closed("arm", "object", before.tip("arm")))
    exact = stop_rates(before, np.vstack(rows))
    np.testing.assert_allclose(case.after, exact.velocity, rtol=0.0,
                               atol=SAME * np.max(np.abs(before.v)))  # fmt: skip
    np.testing.assert_allclose(event["energy_loss"], exact.energy_lost, rtol=SAME)


# --- an object that rests on the floor ------------------------------------------------------------


def lying(mu: float | None) -> Table:
    """A plate that lies on a floor with restitution, and an arm that is pushed down and aside."""
    body = {
        "shape": {"box": [0.4, 0.3, 0.02]}, "mass": 2.5, "pose": {"xyz": [0.5, 0.2, 0.01]},
    }  # fmt: skip
    floor = {"restitution": 0.6} if mu is None else {"restitution": 0.6, "mu": mu}
    return scene(
        {"arm": ur5(rates=[0.4, 0.9, -0.5, 0.3, 0.6, -0.8])},
        [{"arm": "arm", "kind": "weld", "from": GRIP}],
        body,
        effects={"floor": floor, "unilateral_contacts": {"restitution": 0.6}},
    )


def corners(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the normals (4, n) and tangents (4, 2, n) of the corners on the floor."""
    before = case.before
    R = Rotation.from_quat(before.state.object_quaternion_xyzw).as_matrix()
    at = [[x, y, -0.01] for x in (-0.2, 0.2) for y in (-0.15, 0.15)]
    points = before.state.object_position + np.array(at) @ R.T
    np.testing.assert_allclose(points[:, 2], 0.0, atol=1e-12)
    rows = [before.jacobian("object", point) for point in points]
    return np.array([J[2] for J in rows]), np.array([J[:2] for J in rows])


def test_a_grip_on_an_object_on_the_floor_makes_no_rebound():
    """Without friction the velocities after it are those nearest to the ones before."""
    case = grip(lying(None), "arm")
    before = case.before
    normals, _ = corners(case)
    rows = before.closed("arm", "object", before.tip("arm"))
    assert np.min(normals @ stop_rates(before, rows).velocity) < -1e-2  # the floor takes part
    exact = stop_approach(before, rows, normals)
    np.testing.assert_allclose(case.after, exact, rtol=0.0, atol=1e-9)
    # the arm's own equation has the impulse of the grip
    change = before.M @ (exact - before.v)
    J = before.jacobian("arm", before.tip("arm"))[:, 6:]
    of_arm = on_object(case, "arm", np.linalg.solve(J.T, -change[6:]))
    (event,) = case.attached
    np.testing.assert_allclose(event["impulse"], of_arm, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("mu", [0.2, 0.8])
def test_impulses_of_a_grip_on_the_floor_obey_the_laws_of_friction(mu):
    case = grip(lying(mu), "arm")
    before = case.before
    normals, tangents = corners(case)
    rows = before.closed("arm", "object", before.tip("arm"))
    assert np.min(normals @ stop_rates(before, rows).velocity) < -1e-2  # the floor takes part
    assert np.max(np.abs(rows @ case.after)) < 1e-10
    assert np.min(normals @ case.after) > -1e-10
    change = before.M @ (case.after - before.v)
    assert unexplained(change, case.after, rows, normals, tangents, mu) < 1e-9
    J = before.jacobian("arm", before.tip("arm"))[:, 6:]
    of_arm = on_object(case, "arm", np.linalg.solve(J.T, -change[6:]))
    (event,) = case.attached
    np.testing.assert_allclose(event["impulse"], of_arm, rtol=0.0, atol=1e-8)
