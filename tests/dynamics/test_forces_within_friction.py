"""Claims about contact forces in the middle of the cones of friction, which exert a wrench.

The oracle is Clarabel, a solver of cone programs: it finds the smallest forces in the cones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy import sparse

from multiarm.dynamics.forces.friction import (
    BEYOND_FRICTION,
    NOT_CONVERGED,
    distribute_within_friction,
)
from multiarm.dynamics.status import OK

clarabel = pytest.importorskip("clarabel")

LEAST = 2.0  # [N]
# Clarabel's own tolerance, of the objective.
SOLVED = 1e-7


class Grip(NamedTuple):
    """Rows of contacts about one object."""

    W_o: np.ndarray  # (N, 6)
    pushing: np.ndarray
    friction: np.ndarray
    bilateral: list[int]


def random_grip(rng, with_friction, without=0, bilateral=0):
    """Contacts about a ball of 0.5 m, with normals that point roughly inward."""
    rows, pushing, friction = [], [], []
    for kind in rng.permutation([2] * with_friction + [1] * without + [0] * bilateral):
        normal = rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        place = -0.5 * normal + 0.15 * rng.standard_normal(3)
        axes = np.linalg.qr(np.column_stack([normal, rng.standard_normal((3, 2))]))[0].T
        axes[0] = normal
        if kind:
            pushing.append(len(rows))
            friction.append(rng.uniform(0.1, 1.0) if kind == 2 else 0.0)
        rows += [[*axis, *np.cross(place, axis)] for axis in axes[: 3 if kind == 2 else 1]]
    covered = {row + k for row, mu in zip(pushing, friction, strict=True)
               for k in range(3 if mu else 1)}  # fmt: skip
    rest = [row for row in range(len(rows)) if row not in covered]
    return Grip(np.array(rows), np.array(pushing), np.array(friction), rest)


def forces_of(grip, wrench, least=LEAST, desired=None):
    """The forces, or None where there are none."""
    force = np.full(len(grip.W_o), np.nan)
    wished = np.zeros(len(force)) if desired is None else desired
    status = distribute_within_friction(
        wrench, grip.W_o, grip.pushing, grip.friction, least, wished, force
    )
    assert status in (OK, BEYOND_FRICTION)
    return force if status == OK else None


def smallest_in_cones(grip, wrench):
    """Clarabel's smallest forces, None where it proves that there are none, "?" where it fails."""
    N = len(grip.W_o)
    A, b, cones = [grip.W_o.T], [wrench], [clarabel.ZeroConeT(6)]
    for row, mu in zip(grip.pushing, grip.friction, strict=True):
        size = 3 if mu else 1
        cone = np.zeros((size, N))
        cone[0, row] = -mu if mu else -1.0
        for k in range(1, size):
            cone[k, row + k] = -1.0
        A.append(cone)
        b.append(np.zeros(size))
        cones.append(clarabel.SecondOrderConeT(size) if mu else clarabel.NonnegativeConeT(1))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(np.eye(N)),
        np.zeros(N),
        sparse.csc_matrix(np.vstack(A)),
        np.concatenate(b),
        cones,
        settings,
    )
    solution = solver.solve()
    if "Solved" in str(solution.status):
        return np.array(solution.x)
    return None if "PrimalInfeasible" in str(solution.status) else "?"


def cones_left(grip, force):
    """``mu n - |t|`` of every contact, ``n`` without friction."""
    left = []
    for row, mu in zip(grip.pushing, grip.friction, strict=True):
        slip = np.hypot(force[row + 1], force[row + 2]) if mu else 0.0
        left.append(mu * force[row] - slip if mu else force[row])
    return np.array(left)


MIXTURES = {
    "three": (3, 0, 0),
    "six": (6, 0, 0),
    "nine": (9, 0, 0),
    "mixed": (4, 3, 2),
    "one_hand_holds": (2, 0, 6),
}


@pytest.mark.parametrize("mixture", MIXTURES)
def test_forces_are_those_of_a_cone_program_up_to_the_barrier(mixture, rng):
    """They exert the wrench within the cones where Clarabel finds any forces, and nowhere else.

    The barrier costs at most its weight times its degree, ``least^2 / 2`` times two a contact.
    """
    verdicts = []
    for _ in range(25):
        grip = random_grip(rng, *MIXTURES[mixture])
        wrench = 60.0 * rng.standard_normal(6) * [1, 1, 1, 0.3, 0.3, 0.3]
        best = smallest_in_cones(grip, wrench)
        if isinstance(best, str):
            continue
        force = forces_of(grip, wrench)
        assert (force is None) == (best is None)
        verdicts.append(force is not None)
        if force is None:
            continue
        assert np.abs(grip.W_o.T @ force - wrench).max() < 1e-10 * np.abs(force).max()
        assert np.all(cones_left(grip, force) > 0.0)
        for least in (LEAST, 0.1 * LEAST, 0.01 * LEAST):
            more = 0.5 * (np.sum(forces_of(grip, wrench, least) ** 2) - np.sum(best**2))
            rounding = SOLVED * np.sum(best**2)
            assert -rounding <= more <= least**2 * len(grip.pushing) + rounding
    assert sum(verdicts) >= 3


def test_without_a_load_the_mean_square_of_the_forces_is_that_of_the_least(rng):
    grips = [random_grip(rng, 6) for _ in range(20)]
    forces = [(grip, forces_of(grip, np.zeros(6))) for grip in grips]
    closed = [(grip, force) for grip, force in forces if force is not None]
    assert len(closed) > 5
    for grip, force in closed:
        assert np.abs(grip.W_o.T @ force).max() < 1e-10
        assert np.sum(force**2) / 6 == pytest.approx(LEAST**2, rel=1e-9)


def test_forces_are_stationary(rng):
    """``lambda - lambda_s - least^2 / 2 grad log`` is some ``W_o y``; complex steps of the log."""
    for _ in range(10):
        grip = random_grip(rng, 6, 2, 2)
        desired = 5.0 * rng.standard_normal(len(grip.W_o))
        force = forces_of(grip, 20.0 * rng.standard_normal(6), desired=desired)
        if force is None:
            continue

        def barrier(forces, grip=grip):
            logs = 0.0
            for row, mu in zip(grip.pushing, grip.friction, strict=True):
                slips = forces[row + 1] ** 2 + forces[row + 2] ** 2 if mu else 0.0
                pushes = forces[row]
                logs += np.log(mu**2 * pushes**2 - slips) if mu else 2 * np.log(pushes)
            return -0.5 * LEAST**2 * logs

        slope = [barrier(force + 1e-30j * e).imag / 1e-30 for e in np.eye(len(force))]
        gradient = force - desired + slope
        y = np.linalg.lstsq(grip.W_o, gradient, rcond=None)[0]
        np.testing.assert_allclose(grip.W_o @ y, gradient, atol=1e-7 * np.abs(gradient).max())


def test_forces_change_smoothly_with_the_wrench(rng):
    """Differences over half the step are a quarter as far from the differential."""
    grip = next(g for g in iter(lambda: random_grip(rng, 6), None)
                if forces_of(g, np.zeros(6)) is not None)  # fmt: skip
    wrench, turn = 40.0 * rng.standard_normal(6), rng.standard_normal(6)

    def curvature(step):
        ends = [forces_of(grip, wrench + side * step * turn) for side in (-1.0, 0.0, 1.0)]
        return (ends[0] - 2 * ends[1] + ends[2]) / step**2

    coarse, middle, fine = (curvature(step) for step in (0.2, 0.1, 0.05))
    assert np.linalg.norm(middle - fine) < 0.5 * np.linalg.norm(coarse - fine)
    assert np.linalg.norm(fine) > 1e-6


def test_the_margin_of_a_contact_far_inside_or_outside_its_cone_is_kept_to_rounding():
    """Two opposed contacts: forces from 1e-6 to 1e6 times the least."""
    rows = []
    for side in (1.0, -1.0):
        for axis in ([side, 0, 0], [0, 1, 0], [0, 0, 1]):
            rows.append([*axis, *np.cross([-0.5 * side, 0, 0], axis)])
    W_o = np.array(rows)[:, :3]  # of points, which cannot be turned about their line
    W_o = np.hstack([W_o, np.zeros((6, 3))])
    W_o = np.vstack([W_o, np.hstack([np.zeros((3, 3)), np.eye(3)])])
    grip = Grip(W_o, np.array([0, 3]), np.array([0.4, 0.4]), [6, 7, 8])
    for size in (1e-6, 1e-3, 1.0, 1e3, 1e6):
        wrench = size * np.array([0.3, 0.0, 1.0, 0, 0, 0])
        force = forces_of(grip, wrench, least=1.0)
        assert force is not None
        assert np.all(cones_left(grip, force) > 0.0)
        assert np.abs(W_o.T @ force - wrench).max() < 1e-10 * max(size, 1.0)


def test_what_is_not_found_is_not_taken_for_proven_to_be_beyond_friction():
    """Two contacts do not turn an object about the line between them."""
    places = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]])
    rows = []
    for place in places:
        normal = -2.0 * place
        axes = [normal, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        rows += [[*axis, *np.cross(place, axis)] for axis in axes]
    W_o, pushing, friction = np.array(rows), np.array([0, 3]), np.full(2, 0.5)
    assert np.linalg.matrix_rank(W_o) == 5

    def answer(wrench):
        force, none = np.zeros((2, 6))
        return distribute_within_friction(wrench, W_o, pushing, friction, LEAST, none, force)

    assert answer(np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])) == NOT_CONVERGED
