"""Claims about problems that have no solution, several, or one that must be proven."""

from __future__ import annotations

import numpy as np
import pytest
from laws import box, frictions, pushes, random_rows, violation
from pressed import pressed_box

from multiarm.events.complementarity import (
    Bounded,
    ContactMode,
    Friction,
    Sliding,
    Verdict,
    describe,
    find_impulses,
    solve,
)
from multiarm.events.complementarity.problem import build
from multiarm.events.complementarity.solution import Motion, all_solutions, uniqueness
from multiarm.events.complementarity.solvers import iterate, newton


def rod(theta):
    """Response of the end of a rod of mass and half length one, at an angle to the floor."""
    s, c = np.sin(theta), np.cos(theta)
    return np.array(
        [[1 + 3 * c * c, 3 * s * c, 0.0], [3 * s * c, 1 + 3 * s * s, 0.0], [0.0, 0.0, 1.0]]
    )


@pytest.mark.parametrize("mu", [0.5, 1.3, 1.4, 2.0, 5.0])
@pytest.mark.parametrize("degrees", [20.0, 45.0, 60.0, 63.435, 75.0, 85.0])
def test_the_sliding_rod_has_none_or_two_solutions_where_friction_pulls_it_in(mu, degrees):
    theta = np.radians(degrees)
    grip = 1 + 3 * np.cos(theta) ** 2 - 3 * mu * np.sin(theta) * np.cos(theta)
    assert grip > 0.0 or mu > 4.0 / 3.0
    units = [Sliding(0, (1, 2), mu, (1.0, 0.0))]
    pressed = solve(rod(theta), [-1.0, 0.3, 0.0], units)
    lifted = solve(rod(theta), [1.0, 0.3, 0.0], units)
    if grip > 0.0:
        assert pressed.verdict is lifted.verdict is Verdict.UNIQUE
        np.testing.assert_allclose(pressed.forces, np.array([1.0, -mu, 0.0]) / grip, rtol=1e-10)
        assert pressed.modes == (ContactMode.SLIDING,) and lifted.modes == (ContactMode.OPEN,)
        return
    assert pressed.verdict is Verdict.NONE
    assert "no solution (Painleve)" in pressed.message and pressed.active_rows == ()
    assert lifted.verdict is Verdict.SEVERAL
    assert "several solutions (Painleve)" in lifted.message
    # the one without force is taken, the other is an alternative
    assert lifted.modes == (ContactMode.OPEN,)
    (other,) = lifted.alternatives
    assert other.modes == (ContactMode.SLIDING,)
    np.testing.assert_allclose(other.forces, np.array([-1.0, mu, 0.0]) / grip, rtol=1e-10)


def test_some_angle_of_the_rod_is_in_doubt_from_four_thirds_on():
    angles = np.radians(np.linspace(1.0, 89.0, 177))
    for mu, doubted in ((1.33, False), (1.34, True)):
        units = [Sliding(0, (1, 2), mu, (1.0, 0.0))]
        verdicts = {solve(rod(theta), [1.0, 0.0, 0.0], units).verdict for theta in angles}
        assert (Verdict.SEVERAL in verdicts) == doubted


def test_two_rods_in_doubt_have_four_motions():
    D = np.kron(np.eye(2), rod(np.radians(60.0)))
    units = [Sliding(3 * k, (3 * k + 1, 3 * k + 2), 2.0, (1.0, 0.0)) for k in range(2)]
    solution = solve(D, [1.0, 0.0, 0.0] * 2, units)
    assert solution.verdict is Verdict.SEVERAL and len(solution.alternatives) == 3


def test_a_rod_at_rest_in_doubt_stays_or_leaves():
    """No slip yet: with b > 0 it may leave, or jam itself tight."""
    solution = solve(rod(np.radians(60.0)), [0.1, 1.0, 0.0], [Friction(0, (1, 2), 2.0)])
    assert solution.verdict is Verdict.SEVERAL and solution.modes == (ContactMode.OPEN,)
    assert {other.modes[0] for other in solution.alternatives} >= {ContactMode.STICKING}


def test_a_wedge_that_friction_squeezes_is_reported():
    """A slider between two walls: forces that squeeze it move no wall, but brake it."""
    rows = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])  # wall, along, nothing, rail
    units = [Friction(0, (1, 2), 0.5), Bounded(3, -10.0, 10.0)]
    solution = solve(rows @ rows.T, rows @ [1.0, -1.0], units)
    assert "leave the motion undetermined" in solution.message


def test_walls_that_close_in_have_no_solution():
    solution = solve([[1.0, -1.0], [-1.0, 1.0]], [-1.0, -2.0], pushes(2))
    assert solution.verdict is Verdict.NONE and "contradict" in solution.message
    assert solution.active_rows == () and solution.residual > 0.1


@pytest.mark.parametrize("free", [0.0, 1e-14])
def test_a_rod_on_the_verge_of_doubt_may_do_anything(free):
    """Friction pulls in exactly as much as the contact pushes: any force keeps the normal rate."""
    D = rod(np.radians(60.0))
    units = [Sliding(0, (1, 2), D[0, 0] / D[0, 1], (1.0, 0.0))]
    solution = solve(D, [0.0, 1.0, free], units)
    assert solution.verdict is Verdict.SEVERAL
    assert solution.alternatives[0].forces[0] > 0.0


def sliding_box(wrench, mu=0.4):
    J, mobility = box(tangents=True)
    units = [Sliding(3 * k, (3 * k + 1, 3 * k + 2), mu, (1.0, 0.0)) for k in range(4)]
    return J @ mobility @ J.T, J @ mobility @ wrench, units


def test_corners_that_share_a_sliding_load_leave_the_motion_unique():
    D, b, units = sliding_box(np.array([0.0, 0.0, -200.0, -45.0, 70.0, 0.0]))
    problem = build(D, b, units)
    assert np.linalg.matrix_rank(problem.G) == 3
    assert uniqueness(problem) is Motion.UNIQUE
    solution = solve(D, b, units)
    assert solution.verdict is Verdict.UNIQUE and not solution.forces_unique
    assert ContactMode.RESTING in solution.modes
    assert violation(D, b, units, solution.forces) < 1e-12


def test_trying_all_modes_finds_forces_that_push_where_the_smallest_pull():
    D, b, units = sliding_box(np.array([0.0, 0.0, -200.0, -45.0, 70.0, 0.0]))
    (found,) = all_solutions(build(D, b, units), [])
    assert np.min(found) >= -1e-9
    np.testing.assert_allclose(
        D @ build(D, b, units).E @ found + b, solve(D, b, units).rates, atol=1e-9
    )


def test_one_contact_with_mild_friction_is_proven_unique_and_four_corners_are_not():
    one = solve(np.diag([1.0, 3.5, 3.5]), [-1.0, 2.0, 0.0], frictions(1, 0.5))
    assert one.verdict is Verdict.UNIQUE
    J, mobility = box(tangents=True)
    four = solve(J @ mobility @ J.T, J @ mobility @ [0, 0, -9.0, 0, 0, 0], frictions(4, 0.5))
    assert four.verdict is Verdict.FOUND and four.message == ""


@pytest.mark.slow
def test_thirteen_contacts_on_six_freedoms_have_a_solution():
    for seed in range(15):
        rng = np.random.default_rng(seed)
        A, a = random_rows(rng, 39, 6)
        A[::3] *= 2.0
        D, b, units = A @ A.T, A @ a, frictions(13, 0.4)
        solution = solve(D, b, units)
        assert solution.verdict is Verdict.FOUND
        assert violation(D, b, units, solution.forces) < 1e-11


def test_other_starts_help_where_newton_runs_in_circles():
    rng, circles = np.random.default_rng(0), 0
    for _ in range(100):
        problem = build(*pressed_box(rng))
        circles += problem.residual(newton(problem, problem.without_force())) > 1e-6
        assert problem.residual(iterate(problem)) < 1e-12
    assert circles > 1


def test_redundant_fingertips_have_a_motion():
    """One to twelve contacts, whose rows depend on each other."""
    rng = np.random.default_rng(3)
    for _ in range(60):
        D, b, laws = pressed_box(rng)
        solution = solve(D, b, laws)
        assert solution.verdict is not Verdict.NONE and solution.residual < 1e-9


def test_impulses_are_those_near_to_others_and_are_described_without_a_search():
    D, b = rod(np.radians(60.0)), np.array([0.1, 1.0, 0.0])
    laws = [Friction(0, (1, 2), 2.0)]
    several = solve(D, b, laws)
    assert several.verdict is Verdict.SEVERAL
    for motion in [several, *several.alternatives]:
        impulses, residual = find_impulses(D, b, laws, motion.forces)
        assert residual < 1e-12
        np.testing.assert_allclose(impulses, motion.forces, rtol=1e-10)
        again = describe(D, b, laws, impulses)
        assert again.verdict is Verdict.FOUND and again.modes == motion.modes
        np.testing.assert_allclose(again.forces, motion.forces, rtol=1e-10)
