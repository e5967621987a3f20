"""Claims about derivatives of robots with several connections: those of differences.

Differences of order four of evaluations share no derivative with the code under test.
"""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import difference, random_state
from steps import ORDER_8, Slope, assert_derivatives, coupled, derivatives_of, step_of_the_package
from tree_systems import name_of, tree_system

import multiarm as ma
from multiarm.spatial import retract

BALL, WELD, POINT = {"kind": "ball"}, {"kind": "weld"}, {"kind": "point_on_plane"}
CYLINDER = {"kind": "point_on_cylinder", "radius": 0.2}
TWO_ARMS = [-1, 0, 1, 2, 3, 0, 5, 6, 7]  # on one joint, tips l5 and l9
# By the two bodies; forces act on the second one.
CONNECTIONS = {
    "two tips hold the object": (TWO_ARMS, {("l5", "object"): WELD, ("l9", "object"): BALL}),
    "one tip twice": (TWO_ARMS, {("l5", "object"): BALL, ("l5", "world"): POINT}),
    "a tip and a link within": (TWO_ARMS, {("l9", "object"): BALL, ("l7", "world"): POINT}),
    "an inner loop": (TWO_ARMS, {("l5", "l9"): BALL, ("l5", "object"): BALL}),
    "an inner loop along one branch": (TWO_ARMS, {("l9", "l6"): POINT, ("l2", "l7"): CYLINDER}),
    "curved surfaces": (TWO_ARMS, {("l5", "l9"): CYLINDER, ("l9", "object"): CYLINDER}),
    "the world holds the object": (TWO_ARMS, {("object", "world"): BALL, ("l9", "object"): POINT}),
    "a free robot and object": (TWO_ARMS, {("l5", "world"): POINT}),
}  # fmt: skip


def moved(state, column: int, amount: float):
    """The state displaced along one column of the derivatives."""
    displaced, n = state.copy(), state.layout.rate_count
    if 3 <= column < 6:
        turn = amount * np.eye(3)[column - 3]
        displaced.position[3:7] = retract(state.position[3:7], turn)
    elif column < 3:
        displaced.position[column] += amount
    elif column < 12:
        displaced.velocity[column - 6] += amount
    elif column < 12 + n:
        displaced.position[column - 5] += amount
    else:
        displaced.velocity[column - 6 - n] += amount
    return displaced


def unknowns(system, state):
    """Accelerations of object and joints, and contact forces."""
    ev = ma.evaluate(system, 0.0, state)
    return np.concatenate(
        [ev.object_acceleration, *ev.joint_accelerations.values(), *ev.contact_forces.values()]
    )


@pytest.mark.parametrize("case", CONNECTIONS)
def test_derivatives_of_connections_are_those_of_differences(case, tmp_path, rng):
    system = tree_system(tmp_path, rng, *CONNECTIONS[case])
    state = random_state(system, rng, turn=0.5, speed=0.5)
    derivatives = ma.derivatives(system, 0.0, state)
    assert derivatives.message == ""
    columns = range(12 + 2 * state.layout.rate_count)
    expected = np.transpose(
        [difference(lambda h, c=c: unknowns(system, moved(state, c, h))) for c in columns]
    )
    size = np.abs(expected).max(axis=1, keepdims=True) + 1.0
    matrix = derivatives.matrix[: len(expected), : len(columns)]
    np.testing.assert_allclose(matrix / size, expected / size, atol=1e-7)


@pytest.mark.parametrize("joint", [0, 1])
def test_placements_of_contacts_have_derivatives_by_connection(joint, tmp_path):
    """Of two connections of one robot: a shift and a turn of the frame on the first body."""
    pairs = [("l5", "object"), ("l7", "l3")]

    def displaced(h, column):
        at_first = {"xyz": [0.0] * 3, "rpy": [0.0] * 3}
        at_first["xyz" if column < 3 else "rpy"][column % 3] = h
        kinds = [{**BALL, "at_first": at_first if k == joint else {}} for k in range(2)]
        rng = np.random.default_rng(5)
        system = tree_system(tmp_path, rng, TWO_ARMS, dict(zip(pairs, kinds, strict=True)))
        return system, random_state(system, rng, turn=0.3, speed=0.5)

    system, state = displaced(0.0, 0)
    derivatives = ma.derivatives(system, 0.0, state, parameters=True)
    rows = len(unknowns(*displaced(0.0, 0)))
    placements = derivatives.matrix[:rows, derivatives.columns["placements"]]
    block = placements[:, 6 * joint : 6 * joint + 6]
    for column in range(6):
        expected = difference(lambda h, c=column: unknowns(*displaced(h, c)))
        size = np.abs(expected).max() + 1.0
        np.testing.assert_allclose(block[:, column] / size, expected / size, atol=1e-7)
    names = [f"{name_of(first)}-{name_of(second)}" for first, second in pairs]
    assert list(derivatives.object_acceleration.d_placements) == names


@pytest.mark.parametrize("case", ["a tip and a link within", "an inner loop", "curved surfaces"])
@pytest.mark.parametrize("gains", [(0.0, 0.0), (30.0, 20.0)], ids=["", "with feedback"])
def test_derivatives_of_steps_are_those_of_differences(case, gains, tmp_path, rng):
    """Of a step robot by robot, and of one with a matrix for the whole system."""
    system = tree_system(tmp_path, rng, *CONNECTIONS[case])
    state = random_state(system, rng, turn=0.3, speed=0.5)
    nv, exact = 6 + system.model.layout.rate_count, Slope(system, state, *gains)
    steps = [step_of_the_package(s, state, 1e-3, *gains) for s in (system, coupled(system))]
    assert [bool(step.work[0].derived.block_by_block) for step in steps] == [True, False]
    J = exact.jacobian(steps[0].step.tolerance.size, 3e-3)[nv:]
    # gaps of about a metre, times beta^2, make accelerations whose roundings the differences have
    bound = max(ORDER_8, 1e-10 * np.max(np.abs(exact(0.0, exact.z)[nv:])))
    for system_of_step, step in zip((system, coupled(system)), steps, strict=True):
        assert_derivatives(np.hstack(derivatives_of(system_of_step, step)), J, bound)
