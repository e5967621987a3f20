"""Claims about the compiled solver of impulses, against laws written anew and convex programs."""

from __future__ import annotations

import clarabel
import numpy as np
import pytest
from laws import box, frictions, pushes
from pressed import mixed_rows, pressed_box
from scipy import sparse

from multiarm.events.complementarity import Bounded, Friction
from multiarm.events.complementarity.impulses import BOUNDED, FRICTION, PUSH, solve_impulses

# Parts of the largest scaled rate: sums of forty terms.
SOLVED = 1e-12
OBEYED = 1e-11
# Rates of two algorithms, as a part of the largest: an interior point method to gaps of 1e-12,
# where slips near to zero know their directions from half as many digits.
AGREE = 1e-4


def solution(D, b, laws, start=None):
    """Forces, residual and iterations."""
    kinds, rows = np.zeros(len(laws), dtype=np.int64), -np.ones((len(laws), 3), dtype=np.int64)
    mu, lower, upper = np.zeros((3, len(laws)))
    for k, law in enumerate(laws):
        rows[k, 0], kinds[k] = law.row, PUSH
        if isinstance(law, Bounded):
            kinds[k], lower[k], upper[k] = BOUNDED, law.lower, law.upper
        if isinstance(law, Friction):
            kinds[k], mu[k], rows[k, 1:] = FRICTION, law.mu, law.tangents
    x = np.zeros(len(b)) if start is None else start.copy()
    return x, *solve_impulses(D, np.asarray(b, dtype=float), kinds, rows, mu, lower, upper, x)


def disobedience(D, b, laws, x):
    """The largest violation of any law, powers for complementarity, in scaled rows."""
    s = 1.0 / np.sqrt(np.where(D.diagonal() > 0.0, D.diagonal(), np.max(D)))
    for law in laws:
        if isinstance(law, Friction):
            both = list(law.tangents)
            s[both] = 1.0 / np.sqrt(np.mean(D.diagonal()[both]))
    y = s * (D @ x + b)
    x = x / s
    size = max(np.max(np.abs(s * b)), np.max(np.abs(x)), np.finfo(float).tiny)
    worst = [0.0]
    for law in laws:
        n = law.row
        if isinstance(law, Bounded):
            below, above = x[n] - law.lower / s[n], law.upper / s[n] - x[n]
            worst += [-below, -above, min(below, y[n]), min(above, -y[n])]
            continue
        worst += [-x[n], -y[n], min(x[n], y[n])]
        if isinstance(law, Friction):
            both = list(law.tangents)
            radius = law.mu * x[n] * s[n] / s[both[0]]
            slip = np.hypot(*y[both])
            worst += [np.hypot(*x[both]) - radius, (x[both] @ y[both] + radius * slip) / size]
    return max(worst) / size


@pytest.mark.parametrize("problems", [pressed_box, mixed_rows])
@pytest.mark.parametrize("seed", range(10))
def test_impulses_obey_all_laws(problems, seed):
    """Fifty problems a case: one to twelve contacts, mostly redundant."""
    rng = np.random.default_rng(seed)
    for _ in range(50):
        D, b, laws = problems(rng)
        x, residual, iterations = solution(D, b, laws)
        assert residual < SOLVED and iterations >= 0
        assert disobedience(D, b, laws, x) < OBEYED


@pytest.mark.parametrize("problems", [pressed_box, mixed_rows])
def test_a_solution_is_recognised_and_a_near_one_is_reached_in_a_few_steps(problems):
    rng, iterations = np.random.default_rng(3), []
    for _ in range(100):
        D, b, laws = problems(rng)
        x, _, _ = solution(D, b, laws)
        again, residual, steps = solution(D, b, laws, x)
        assert residual < SOLVED and steps <= 3
        rate = np.max(np.abs(D @ (again - x)), initial=0.0)
        assert rate <= 1e-9 * np.max(np.abs(b) + np.abs(D) @ np.abs(x))
        _, residual, steps = solution(D, b * (1.0 + 1e-4 * rng.standard_normal()), laws, x)
        assert residual < SOLVED
        iterations.append(steps)
    assert np.median(iterations) <= 3


def convex_rates(D, b, laws, slips):
    """Rates of the minimum of ``x^T D x / 2 + (b + slips)^T x`` on cones and between bounds."""
    m, A, a, cones = b.size, [], [], []
    identity = np.eye(m)
    for law in laws:
        if isinstance(law, Friction):
            A.append(
                -identity[[law.row, *law.tangents]] * np.array([[law.mu or 1.0], [1.0], [1.0]])
            )
            a.append(np.zeros(3))
            without = [clarabel.NonnegativeConeT(1), clarabel.ZeroConeT(2)]
            cones += [clarabel.SecondOrderConeT(3)] if law.mu > 0.0 else without
            continue
        lower, upper = (law.lower, law.upper) if isinstance(law, Bounded) else (0.0, np.inf)
        for sign, bound in ((-1.0, -lower), (1.0, upper)):
            if np.isfinite(bound):
                A.append(sign * identity[[law.row]])
                a.append([bound])
                cones.append(clarabel.NonnegativeConeT(1))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    program = clarabel.DefaultSolver(
        sparse.triu(sparse.csc_matrix(D)).tocsc(),
        b + slips,
        sparse.csc_matrix(np.vstack(A)),
        np.concatenate(a),
        cones,
        settings,
    )
    return D @ np.array(program.solve().x) + b


@pytest.mark.parametrize("seed", range(4))
def test_with_its_slips_given_a_solution_is_that_of_a_convex_program(seed):
    """De Saxcé's change of variables; without friction the problem is convex by itself."""
    rng = np.random.default_rng(seed)
    for k in range(15):
        D, b, laws = pressed_box(rng)
        if k % 3 == 0:
            laws = [law for law in laws if isinstance(law, Friction)]
            laws = [Friction(law.row, law.tangents, 0.0) for law in laws]
            D, b = D[: 3 * len(laws), : 3 * len(laws)], b[: 3 * len(laws)]
        x, residual, _ = solution(D, b, laws)
        rates = D @ x + b
        slips = np.zeros(b.size)
        for law in laws:
            if isinstance(law, Friction):
                slips[law.row] = law.mu * np.hypot(*rates[list(law.tangents)])
        apart = np.max(np.abs(convex_rates(D, b, laws, slips) - rates))
        assert residual < SOLVED
        assert apart < AGREE * np.max(np.abs(b))


@pytest.mark.parametrize("push", [0.0, 90.0, 97.0, 98.1, 100.0, 150.0])
def test_a_pushed_box_sticks_up_to_mu_times_its_weight(push):
    """Four corners share the load: twelve rows, six freedoms."""
    J, mobility = box(tangents=True)
    weight = 20.0 * 9.81
    wrench = np.array([push, 0.0, -weight, 0.0, 0.1 * push, 0.0])
    x, residual, _ = solution(J @ mobility @ J.T, J @ mobility @ wrench, frictions(4, 0.5))
    speeds_up = max(push - 0.5 * weight, 0.0) / 20.0
    np.testing.assert_allclose(
        mobility @ (wrench + J.T @ x), [speeds_up, 0, 0, 0, 0, 0], atol=1e-10
    )
    assert residual < SOLVED


def test_unsolvable_and_unreadable_problems_end_with_numbers():
    """Walls that close in; rates and starts that are no numbers; nothing that responds."""
    x, residual, _ = solution(np.array([[1.0, -1.0], [-1.0, 1.0]]), [-1.0, -2.0], pushes(2))
    assert residual > 1e-8 and np.all(np.isfinite(x))
    for rate in (np.nan, np.inf):
        x, residual, _ = solution(np.eye(3), [rate, 1.0, 0.0], frictions(1, 0.5))
        assert residual == np.inf and np.all(x == 0.0)
    start = np.array([np.nan, 1.0, -np.inf])
    x, residual, _ = solution(np.eye(3), [-1.0, 0.3, 0.0], frictions(1, 0.5), start)
    assert residual < SOLVED
    np.testing.assert_allclose(x, [1.0, -0.3, 0.0], atol=1e-15)
    x, residual, _ = solution(np.zeros((3, 3)), np.zeros(3), frictions(1, 0.5))
    assert residual == 0.0 and np.all(x == 0.0)
    x, residual, _ = solution(np.zeros((0, 0)), np.zeros(0), [])
    assert residual == 0.0
