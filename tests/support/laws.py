"""The laws of contact and friction written once more, for tests: in plain units, from a list."""

from __future__ import annotations

import numpy as np

from multiarm.events.complementarity import Bounded, ContactMode, Friction, Push, Sliding


def pushes(count):
    return [Push(row) for row in range(count)]


def frictions(count, mu):
    return [Friction(3 * k, (3 * k + 1, 3 * k + 2), mu) for k in range(count)]


def random_unit(rng, kind, row):
    """A unit whose first row is given."""
    mu = float(rng.choice([0.0, 0.3, 0.8]))
    if kind is Push:
        return Push(row)
    if kind is Bounded:
        lower = -float(rng.choice([0.0, 0.3, 1.0, np.inf]))
        return Bounded(row, lower, float(rng.choice([-lower, 0.5])))
    if kind is Friction:
        return Friction(row, (row + 1, row + 2), mu)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return Sliding(row, (row + 1, row + 2), mu, (float(np.cos(angle)), float(np.sin(angle))))


def random_units(rng, kinds, count):
    units, row = [], 0
    for _ in range(count):
        units.append(random_unit(rng, kinds[rng.integers(len(kinds))], row))
        row += 3 if isinstance(units[-1], (Friction, Sliding)) else 1
    return units, row


def random_rows(rng, rows, freedoms):
    """Rows of a mechanism of unit inertias, and the accelerations without forces.

    Some have whole numbers, so that ties and exact zeros happen.
    """
    A, a = rng.standard_normal((rows, freedoms)), rng.standard_normal(freedoms)
    if rng.random() < 0.3:
        A, a = np.round(2.0 * A), np.round(2.0 * a)
        A[np.all(A == 0.0, axis=1), 0] = 1.0
    return A, a


def box(tangents, height=0.4, mass=20.0):
    """Rows and mobility of a box on its four corners."""
    a, b, h = 1.0, 0.6, height
    inertia = mass / 12.0 * np.array([b * b + h * h, a * a + h * h, a * a + b * b])
    rows = []
    for x, y in [(a, b), (a, -b), (-a, b), (-a, -b)]:
        corner = np.array([x, y, -h]) / 2.0
        for axis in [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)][: 3 if tangents else 1]:
            rows.append(np.concatenate([axis, np.cross(corner, axis)]))
    return np.array(rows), np.diag(1.0 / np.array([mass] * 3 + list(inertia)))


def violation(D, b, units, x):
    """The largest violation of any law, as a part of the largest scaled number."""
    s = 1.0 / np.sqrt(np.where(D.diagonal() > 0.0, D.diagonal(), np.max(D)))
    y = D @ x + b
    size = max(np.max(np.abs(s * b)), np.max(np.abs(x / s)), np.finfo(float).tiny)
    worst = 0.0
    for unit in units:
        n, both = unit.row, list(getattr(unit, "tangents", ()))
        force, rate = x[n] / s[n], y[n] * s[n]
        if isinstance(unit, Bounded):
            below, above = force - unit.lower / s[n], unit.upper / s[n] - force
            worst = max(worst, -below, -above, min(below, rate), min(above, -rate))
            continue
        worst = max(worst, -force, -rate, min(force, rate))
        if isinstance(unit, Friction):
            worst = max(worst, *disk(unit.mu * x[n], x[both], y[both], s[both].mean(), size))
        elif isinstance(unit, Sliding):
            against = x[both] + unit.mu * x[n] * np.array(unit.direction)
            worst = max(worst, np.max(np.abs(against)) / s[both].max())
    return worst / size


def disk(radius, force, slip, s, size):
    """Friction outside of its disk; and what of it is not against the slip, where there is one."""
    excess = (np.hypot(*force) - radius) / s
    speed = np.hypot(*slip)
    if speed * s < 1e-7 * size:
        return excess, 0.0
    return excess, np.max(np.abs(force + radius * slip / speed)) / s


def held_motion(D, b, units, solution):
    """Forces of least norm that keep the rows held at rest, nobody looking at signs.

    Friction of units that slide is tied to the normal force; bounds are constants.
    """
    x, columns, held = np.zeros(b.size), [], []
    for unit, mode, direction in zip(units, solution.modes, solution.directions, strict=True):
        if mode in (ContactMode.AT_LOWER, ContactMode.AT_UPPER):
            x[unit.row] = unit.lower if mode is ContactMode.AT_LOWER else unit.upper
        for row in (unit.row, *getattr(unit, "tangents", ())):
            if row not in solution.active_rows:
                continue
            column = np.eye(b.size)[row]
            if mode in (ContactMode.SLIDING, ContactMode.AT_BOUND):
                assert row == unit.row
                column[list(unit.tangents)] = -unit.mu * direction
            columns.append(column)
            held.append(row)
    assert sorted(held) == list(solution.active_rows)
    if not held:
        return x
    B, s = np.array(columns).T, 1.0 / np.sqrt(D.diagonal()[held])
    left, values, right = np.linalg.svd(s[:, None] * (D @ B)[held] * s)
    rank = int(np.sum(values > 1e-9 * values[0]))
    rest = -s * (b + D @ x)[held]
    force = s * (right[:rank].T @ ((left.T @ rest)[:rank] / values[:rank]))
    null = np.linalg.qr(s[:, None] * right[rank:].T)[0]
    return x + B @ (force - null @ (null.T @ force))
