"""Claims about joints by their rows: a basis of wrenches is a joint, and a joint is its rows.

A hinge may be written as five contacts or as the five wrenches that it transmits: it moves alike.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from mechanics import (
    EPS,
    carried,
    first_difference,
    kernel_rows,
    plain_gap,
    pose,
    random_pose,
    second_difference,
    ur5_pair,
)
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.geometry.records import Contact, plane, point
from multiarm.scene import (
    BallJoint,
    CylindricalJoint,
    PlanarJoint,
    Pose,
    PrismaticJoint,
    RevoluteJoint,
    UniversalJoint,
    WeldJoint,
    WrenchesJoint,
)

X, Y, Z = np.eye(3)

# --- differences of contacts ----------------------------------------------------------------------


@pytest.fixture
def difference(rng):
    """Half the force of one contact less half that of another, with planes on either body."""

    def contact(name, on_arm):
        tip, face = point(rng.standard_normal(3)), plane(*rng.standard_normal((2, 3)))
        return Contact(name, face, tip) if on_arm else Contact(name, tip, face)

    return replace(contact("one", True), weight=0.5, minus=contact("other", False))


def test_a_difference_of_contacts_is_the_difference_of_their_rows(difference, rng):
    """The rates too; and all of it against differences of the two gaps."""
    motion = random_pose(rng), random_pose(rng), rng.standard_normal(6), rng.standard_normal(6)
    pair = [replace(difference, weight=1.0, minus=None), difference.minus]
    rows, single = kernel_rows([difference], *motion), kernel_rows(pair, *motion)
    for name in ("phi", "phi_dot", "c"):
        one, other = getattr(single, name)
        assert getattr(rows, name)[0] == pytest.approx(0.5 * (one - other), rel=0, abs=1e-13)
    for name in ("W_m", "W_o", "W_m_dot", "W_o_dot"):
        one, other = getattr(single, name).T
        np.testing.assert_allclose(
            getattr(rows, name)[:, 0], 0.5 * (one - other), rtol=0, atol=1e-13, err_msg=name
        )

    def gap(t):
        return plain_gap(difference, carried(motion[0], motion[2], t), carried(*motion[1::2], t))

    assert rows.phi[0] == pytest.approx(gap(0.0), abs=1e-13)
    assert rows.phi_dot[0] == pytest.approx(first_difference(gap, 1e-2), abs=1e-10)
    assert rows.c[0] == pytest.approx(-second_difference(gap, 1.5e-2), rel=1e-8, abs=1e-8)


@pytest.mark.parametrize(
    "across", [[X + Y, Z], [X + Y, X - Y - 2 * Z], [X, Y]], ids=["level", "diagonal", "upright"]
)
@pytest.mark.parametrize("kind", ["hinge", "slider", "weld"])
def test_roundings_of_the_wrenches_do_not_move_the_contacts(kind, across, rng):
    """The contacts of a wrench decide the finite motion: their rows are compared off the start."""
    forces, couples = np.eye(6)[:3], np.eye(6)[3:]
    wrenches = {
        "hinge": np.vstack([forces, across @ couples]),
        "slider": np.vstack([across @ forces, couples]),
        "weld": np.vstack([forces, couples]),
    }[kind]
    poses = random_pose(rng), random_pose(rng)

    def rows(wrenches):
        joint = WrenchesJoint(arm="a", wrenches=wrenches.tolist())
        return kernel_rows(joint.placed(np.eye(4)), *poses).W_o

    expected = rows(wrenches)
    for _ in range(20):
        rounded = wrenches + 4 * EPS * rng.uniform(-1, 1, wrenches.shape)
        np.testing.assert_allclose(rows(rounded), expected, atol=1e-11)


# --- a hinge by its wrenches ----------------------------------------------------------------------

HINGE = [
    [1, 0, 0, 0, 0, 0],
    [0, 1, 0, 0, 0, 0],
    [0, 0, 1, 0, 0, 0],
    [0, 0, 0, 1, 0, 0],
    [0, 0, 0, 0, 1, 0],
]
# the same space of wrenches: forces across the axis at three heights, one along it, and a couple
LEVERS = [
    [1, 0, 0, 0, 0.3, 0],
    [1, 2, 0, 0.2, -0.1, 0],
    [0, 1, 0, -0.2, 0, 0],
    [0, 0, 1, 0, 0, 0],
    [0, 0, 0, 1, -1, 0],
]
# and spanned by screws: the same hinge at the start only, for their contacts are off the axis
SCREWS = [
    [1, 0, 0, 0, 0.3, 0],
    [1, 2, 0, 0.1, -0.2, 0],
    [0.5, 0, 1, 0.2, 0, 0],
    [0, 0, 1, 1, -1, 0],
    [0.2, -0.1, 0.3, 0.4, 2, 0],
]
TURNED = {"at_tip": {"rpy": [0.4, -0.3, 0.2]}}
MOVING = {"control": {"kind": "none"}, "gravity": [0.0, 0.0, -3.0]}


def run_of(left: dict):
    """Half a second of two UR5s with a given joint on the left, a ball joint on the right."""
    scene = ur5_pair({**left, **TURNED}, {"kind": "ball"}, **MOVING)
    system = ma.compile_system(scene)
    return system, ma.simulate(system, 0.6, integrator="rk4", step=1e-3, output_step=0.1)


@pytest.fixture(scope="module")
def hinged():
    return run_of({"kind": "revolute"})


@pytest.mark.parametrize("carried_by", ["object", "arm"])
@pytest.mark.parametrize("basis", [HINGE, LEVERS], ids=["axes", "levers"])
def test_hinge_of_wrenches_is_one_at_every_angle(basis, carried_by):
    """The gaps stay closed, and the rows as independent as they were."""
    joint = WrenchesJoint(arm="a", wrenches=basis, carried_by=carried_by)
    contacts = joint.placed(np.eye(4))
    spread = []
    for angle in np.linspace(-math.pi, math.pi, 25):
        rows = kernel_rows(contacts, free_pose("revolute", (5,), [angle]), np.eye(4))
        np.testing.assert_allclose(rows.phi, 0.0, atol=1e-12)
        values = np.linalg.svd(rows.W_o / np.linalg.norm(rows.W_o, axis=0), compute_uv=False)
        spread.append(values[-1] / values[0])
    np.testing.assert_allclose(spread, spread[0], rtol=1e-9)
    assert spread[0] > 1e-3


@pytest.mark.parametrize("carried_by", ["object", "arm"])
@pytest.mark.parametrize("basis", [HINGE, LEVERS], ids=["axes", "levers"])
def test_hinge_of_wrenches_moves_like_a_hinge_of_contacts(hinged, basis, carried_by):
    _, expected = hinged
    _, run = run_of({"kind": "wrenches", "wrenches": basis, "carried_by": carried_by})
    assert run.status == expected.status == "completed"
    np.testing.assert_allclose(run.object_position, expected.object_position, rtol=0, atol=1e-9)
    apart = (
        Rotation.from_quat(run.object_quaternion_xyzw)
        * Rotation.from_quat(expected.object_quaternion_xyzw).inv()
    )
    np.testing.assert_allclose(apart.magnitude(), 0.0, atol=1e-9)
    for arm in ("left", "right"):
        np.testing.assert_allclose(
            run.joint_positions[arm], expected.joint_positions[arm], rtol=0, atol=1e-9
        )
    # and the hinge does turn
    turned = Rotation.from_quat(run.object_quaternion_xyzw)
    assert (turned[-1] * turned[0].inv()).magnitude() > 0.02


def test_hinge_of_wrenches_transmits_the_wrench_of_the_hinge(hinged):
    """The wrench on the object does not depend on the rows that it is written with."""
    system, _ = hinged
    other, _ = run_of({"kind": "wrenches", "wrenches": SCREWS})
    wrenches = []
    for compiled in (system, other):
        found = ma.evaluate(compiled)
        wrenches.append(found.contact_terms["left"].W_o @ found.contact_forces["left"])
    np.testing.assert_allclose(wrenches[1], wrenches[0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("carried_by", ["object", "arm"])
def test_rows_of_a_wrench_joint_are_its_wrenches_at_the_start(carried_by):
    """In the joint frame, wherever that is on the object."""
    system = ma.compile_system(
        ur5_pair(
            {"kind": "wrenches", "wrenches": SCREWS, "carried_by": carried_by, **TURNED},
            {"kind": "ball"},
        )
    )
    W = ma.evaluate(system).contact_terms["left"].W_o
    frame = system.frames["left"].on_object
    R, p = frame[:3, :3], frame[:3, 3]
    for wrench, column in zip(np.array(SCREWS, float), W.T, strict=True):
        force = R @ wrench[:3]
        expected = np.concatenate([force, R @ wrench[3:] + np.cross(p, force)])
        # one unit of the multiplier is the wrench as written, or a contact of unit force
        scale = np.linalg.norm(column) / np.linalg.norm(expected)
        np.testing.assert_allclose(np.abs(column @ expected), scale * expected @ expected)
        np.testing.assert_allclose(np.abs(column), scale * np.abs(expected), atol=1e-12)


# --- the catalogue: exactly the finite motions that it promises -----------------------------------

AXIS = (0.3, -0.5, 0.9)
NAMED = [
    WeldJoint(arm="a"),
    BallJoint(arm="a"),
    RevoluteJoint(arm="a", axis=AXIS, size=0.2),
    PrismaticJoint(arm="a", axis=AXIS),
    CylindricalJoint(arm="a", axis=AXIS),
    UniversalJoint(arm="a"),
    PlanarJoint(arm="a", normal=AXIS),
]


def free_pose(kind: str, free, values) -> np.ndarray:
    """Arm's joint frame in the object's after free motions: slides [m], then turns [rad]."""
    slide, turns = np.zeros(3), []
    for component, value in zip(free, values, strict=True):
        if component < 3:
            slide[component] = value
        else:
            turns.append(value * np.eye(3)[component - 3])
    if kind == "universal":
        R = Rotation.from_rotvec(turns[0]) * Rotation.from_rotvec(turns[1])
    else:
        R = Rotation.from_rotvec(np.sum(turns, axis=0) if turns else np.zeros(3))
    return pose(R.as_matrix(), slide)


@pytest.mark.parametrize("joint", NAMED, ids=lambda joint: joint.kind)
def test_a_joint_allows_its_own_finite_motions_and_nothing_else(joint, rng):
    """Gaps stay closed along whole turns and metres; the rows hold everything else everywhere."""
    joint = joint.model_copy(update={"at_tip": Pose(xyz=(0.1, -0.2, 0.3), rpy=(0.4, -0.8, 1.2))})
    X_OJ, free = random_pose(rng), joint.free
    contacts = joint.placed(X_OJ)
    on_tip, on_object = joint.frames(X_OJ)
    ranges = [1.5 if k < 3 or joint.kind == "universal" else math.pi for k in free]
    for _ in range(20):
        X_JJ = free_pose(joint.kind, free, [rng.uniform(-r, r) for r in ranges])
        X_OT = on_object @ X_JJ @ np.linalg.inv(on_tip)
        gaps = [plain_gap(contact, X_OT, np.eye(4)) for contact in contacts]
        np.testing.assert_allclose(gaps, 0.0, atol=1e-12)
        rows = kernel_rows(contacts, X_OT, np.eye(4))
        np.testing.assert_allclose(rows.phi, 0.0, atol=1e-12)
        values = np.linalg.svd(rows.W_o, compute_uv=False)
        assert np.sum(values > 1e-6 * values[0]) == 6 - len(free) == len(contacts)
