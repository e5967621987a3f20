"""Claims about the derivatives of trees: motions of links, and inverse dynamics under loads.

The answers are Pinocchio's: its derivatives of the inverse dynamics, and differences of order four
of its inverse dynamics and of its motions of links.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from mechanics import difference
from random_structures import pinocchio_model, random_parents, random_structure

from multiarm.contacts.motion import BODY_WIDTH, BodyMotion
from multiarm.jit.kernels import INT, INTS, NUMBERS, TABLE, kernel
from multiarm.jit.rows import fields_of
from multiarm.jit.structs import struct_of, view
from multiarm.robots.derivatives import (
    DISPLACEMENT_WIDTH,
    LINK_WIDTH,
    Displacement,
    TreeLinks,
    subtract_load,
    subtract_torques,
    tree_links,
    write_inverse_dynamics,
    write_link,
    write_motions,
)
from multiarm.robots.terms import TreeStructure

GRAVITY = np.array([1.0, -2.0, -9.0])
TREES = {
    "a joint": [-1],
    "a chain": [-1, 0, 1, 2, 3, 4, 5],
    "two arms on a torso": [-1, 0, 1, 2, 1, 4, 5],
    "two trees on one base": [-1, 0, -1, 2],
    "a hand": [-1, 0, 0, 2, 0, 4, 5],
    "branches of branches": [-1, 0, 1, 1, 3, 3, 0, 6, 6],
}
# Differences of order four at this step: h^4 of the truncation, eps / h of the roundings.
STEP, TOLERANCE = 1e-3, 1e-9

open_links = view(TreeLinks)
NO_BASES = np.zeros((0, 7))


@kernel
def move(struct: INTS, i: INT, q: NUMBERS, v: NUMBERS, a: NUMBERS, scratch: TABLE):
    write_motions(open_links(struct), i, NO_BASES, q, v, a, scratch)


@kernel
def move_link(struct: INTS, i: INT, k: INT, scratch: TABLE, body: NUMBERS, moved: TABLE):
    write_link(open_links(struct), i, k, scratch, body, moved)


@kernel
def differentiate(struct: INTS, i: INT, loads: TABLE, scratch: TABLE, by_q: TABLE, by_v: TABLE):
    for k in range(loads.shape[0]):
        subtract_load(k, loads[k], scratch)
    write_inverse_dynamics(open_links(struct), i, scratch, by_q, by_v)


@kernel
def load_torques(struct: INTS, i: INT, k: INT, wrench: NUMBERS, scratch: TABLE, table: TABLE):
    subtract_torques(open_links(struct), i, k, wrench, scratch, table, 1)


class Moving(NamedTuple):
    """Two trees side by side, of which the second is looked at; Pinocchio's model of it."""

    links: np.ndarray  # struct of TreeLinks
    keeps: TreeLinks
    model: pin.Model
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    every: tuple[np.ndarray, ...]  # q, v, a of both
    scratch: np.ndarray


def moving(tree: TreeStructure, rng) -> Moving:
    n, before = tree.parents.size, random_structure(rng, [-1, 0, 0])
    links = tree_links([[before], [tree]], GRAVITY)
    every = tuple(rng.uniform(-2, 2, 3 + n) for _ in range(3))
    model = pinocchio_model(tree, GRAVITY)
    scratch = rng.standard_normal((n, LINK_WIDTH))
    struct = struct_of(links)
    move(struct, 1, *every, scratch)
    return Moving(struct, links, model, *(part[3:] for part in every), every, scratch)


@pytest.fixture(params=TREES)
def tree(request, rng) -> Moving:
    return moving(random_structure(rng, TREES[request.param]), rng)


def forces_on_links(loads: np.ndarray) -> pin.StdVec_Force:
    """Wrenches on links, about their origins in their axes, as Pinocchio wants them."""
    forces = pin.StdVec_Force()
    forces.append(pin.Force.Zero())
    forces.extend(pin.Force(load[:3], load[3:]) for load in loads)
    return forces


def inverse_dynamics_derivatives(tree: Moving, loads) -> tuple[np.ndarray, np.ndarray]:
    n, rest = tree.q.size, np.full((tree.q.size + 2,) * 2, 7.0)
    by_q, by_v = rest.copy(), rest.copy()
    differentiate(tree.links, 1, loads, tree.scratch.copy(), by_q, by_v)
    return by_q[:n, :n], by_v[:n, :n]


def assert_derivatives_are_pinocchios(tree: Moving, loads: np.ndarray) -> None:
    data = tree.model.createData()
    pin.computeRNEADerivatives(tree.model, data, tree.q, tree.v, tree.a, forces_on_links(loads))
    size = max(np.abs(data.dtau_dq).max(), np.abs(data.dtau_dv).max())
    by_q, by_v = inverse_dynamics_derivatives(tree, loads)
    np.testing.assert_allclose(by_q, data.dtau_dq, atol=1e-13 * size)
    np.testing.assert_allclose(by_v, data.dtau_dv, atol=1e-13 * size)


def test_inverse_dynamics_derivatives_are_pinocchios(tree, rng):
    assert_derivatives_are_pinocchios(tree, 5.0 * rng.standard_normal((tree.q.size, 6)))


def test_inverse_dynamics_derivatives_are_differences_under_loads_on_some_links(tree, rng):
    loads, data = np.zeros((tree.q.size, 6)), tree.model.createData()
    loads[[0, -1]] = 5.0 * rng.standard_normal((2, 6))
    forces = forces_on_links(loads)
    torques = lambda q, v: pin.rnea(tree.model, data, q, v, tree.a, forces).copy()  # noqa: E731
    by_q, by_v = inverse_dynamics_derivatives(tree, loads)
    for j, e in enumerate(np.eye(tree.q.size)):
        of_q = difference(lambda h, e=e: torques(tree.q + h * e, tree.v), STEP)
        of_v = difference(lambda h, e=e: torques(tree.q, tree.v + h * e), STEP)
        size = max(np.abs(of_q).max(), np.abs(of_v).max(), 1.0)
        np.testing.assert_allclose(by_q[:, j], of_q, atol=TOLERANCE * size)
        np.testing.assert_allclose(by_v[:, j], of_v, atol=TOLERANCE * size)


def motion_of_link(model: pin.Model, joint: int, q, v, a) -> BodyMotion:
    """Motion of a link by Pinocchio, whose numbers of joints count the base as 0."""
    data = model.createData()
    pin.forwardKinematics(model, data, q, v, a)
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    twist = pin.getVelocity(model, data, joint, axes)
    rate = pin.getClassicalAcceleration(model, data, joint, axes)
    return BodyMotion(
        rotation=data.oMi[joint].rotation.copy(),
        origin=data.oMi[joint].translation.copy(),
        velocity=twist.linear.copy(),
        spin=twist.angular.copy(),
        acceleration=rate.linear.copy(),
        spin_rate=rate.angular.copy(),
    )


def displacement_by_differences(motion, rotation) -> np.ndarray:
    """Derivative of ``motion(h)`` at zero as a row of :class:`Displacement`."""
    turned = difference(lambda h: motion(h).rotation, STEP) @ rotation.T
    by = lambda name: difference(lambda h: getattr(motion(h), name), STEP)  # noqa: E731
    turn = [turned[2, 1], turned[0, 2], turned[1, 0]]
    rest = [by(name) for name in ("velocity", "spin", "acceleration", "spin_rate")]
    return np.concatenate([by("origin"), turn, *rest])


def written_motion(tree: Moving, link: int, rng) -> tuple[BodyMotion, np.ndarray]:
    body, moved = rng.standard_normal(BODY_WIDTH), rng.standard_normal((30, DISPLACEMENT_WIDTH))
    move_link(tree.links, 1, link, tree.scratch, body, moved)
    return fields_of(BodyMotion, body), moved


def test_links_move_as_pinocchios(tree, rng):
    for link in range(tree.q.size):
        body, _ = written_motion(tree, link, rng)
        expected = motion_of_link(tree.model, link + 1, tree.q, tree.v, tree.a)
        for part, reference in zip(body, expected, strict=True):
            size = max(np.abs(reference).max(), 1.0)
            np.testing.assert_allclose(part, reference, atol=1e-13 * size)


def test_displacements_of_links_are_those_of_differences(tree, rng):
    """By every joint of the tree: also those that do not move the link, whose columns are zero."""
    n = tree.q.size
    for link in {0, n // 2, n - 1}:
        body, moved = written_motion(tree, link, rng)
        motion = partial(motion_of_link, tree.model, link + 1)
        for j, e in enumerate(np.eye(n)):
            by_q = displacement_by_differences(
                lambda h, e=e, at=motion: at(tree.q + h * e, tree.v, tree.a), body.rotation
            )
            by_v = displacement_by_differences(
                lambda h, e=e, at=motion: at(tree.q, tree.v + h * e, tree.a), body.rotation
            )
            size = max(np.abs(by_q).max(), np.abs(by_v).max(), 1.0)
            np.testing.assert_allclose(moved[j], by_q, atol=TOLERANCE * size)
            np.testing.assert_allclose(moved[n + j], by_v, atol=TOLERANCE * size)


def test_joints_of_other_branches_do_not_displace_a_link(rng):
    tree = moving(random_structure(rng, [-1, 0, 1, 1, 3]), rng)
    _, moved = written_motion(tree, 4, rng)
    assert not np.any(moved[[2, 5 + 2]])
    assert np.all(np.any(moved[[0, 1, 3, 4, 5, 6, 8, 9]], axis=1))
    fields = fields_of(Displacement, moved[5:10])
    assert not np.any(fields.shift) and not np.any(fields.turn)  # rates leave the pose


def test_torques_of_a_wrench_are_those_of_the_jacobian(tree, rng):
    n, data = tree.q.size, tree.model.createData()
    for link in range(n):
        wrench, table = rng.standard_normal(6), np.ones((n, 3))
        load_torques(tree.links, 1, link, wrench, tree.scratch, table)
        J = pin.computeJointJacobian(tree.model, data, tree.q, link + 1).reshape(6, n)
        np.testing.assert_allclose(table[:, 1], 1.0 - J.T @ wrench, atol=1e-13)
        assert np.all(table[:, [0, 2]] == 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_random_trees_have_pinocchios_derivatives(seed):
    rng = np.random.default_rng(seed)
    joints = int(rng.integers(1, 24))
    tree = moving(random_structure(rng, random_parents(rng, joints)), rng)
    assert_derivatives_are_pinocchios(tree, 5.0 * rng.standard_normal((joints, 6)))
