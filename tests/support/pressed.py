"""Random problems of contact: boxes that fingertips press, and random rows."""

from __future__ import annotations

import numpy as np
from laws import random_rows

from multiarm.events.complementarity import Bounded, Friction, Push


def pressed_box(rng):
    """A box that one to three hands press with one to four fingertips each.

    Hands are bodies, some guided along one to three axes, so that rows depend on each other; some
    have joints with dry friction or stops. Returns D, b and the laws.
    """
    half, mass = rng.uniform(0.05, 0.4, 3), rng.uniform(0.5, 20.0)
    squares = half**2
    inertia = mass / 3.0 * (squares.sum() - squares)
    freedoms = [int(rng.choice([1, 2, 3, 6])) for _ in range(int(rng.integers(1, 4)))]
    size = 6 + sum(freedoms)
    mobility, force = np.zeros((size, size)), np.zeros(size)
    mobility[range(6), range(6)] = [*[1.0 / mass] * 3, *1.0 / inertia]
    force[2] = -9.81 * mass
    force[3:6] = rng.standard_normal(3) * rng.choice([0.0, 0.1, 1.0])
    rows, laws, start = [], [], 6
    axis, side = int(rng.integers(3)), 1.0
    for freedom in freedoms:
        hand = slice(start, start + freedom)
        spread = rng.standard_normal((freedom, freedom))
        mobility[hand, hand] = np.linalg.inv(spread @ spread.T + 0.3 * np.eye(freedom))
        side = -side
        press, count = rng.uniform(0.0, 3.0) * mass * 9.81, int(rng.integers(1, 5))
        for _ in range(count):
            at = rng.uniform(-1.0, 1.0, 3) * half
            at[axis] = side * half[axis]
            axes = np.roll(np.eye(3), -axis, axis=0)
            axes[0] *= -side
            twist = np.hstack([np.eye(3), -np.cross(np.eye(3), at).T])
            guided = twist if freedom == 6 else np.roll(np.eye(3), -axis, axis=0)[:freedom].T
            both = np.zeros((3, size))
            both[:, :6], both[:, hand] = axes @ twist, -axes @ guided
            force[hand] += press / count * guided.T @ axes[0]
            n = 3 * len(laws)
            laws.append(Friction(n, (n + 1, n + 2), float(rng.uniform(0.4, 0.9))))
            rows += list(both)
        start += freedom
    for joint in range(6, 6 + int(rng.integers(0, min(4, size - 5)))):
        rows.append(np.eye(size)[joint])
        bound = float(rng.uniform(0.1, 2.0))
        last = len(rows) - 1
        laws.append(Push(last) if rng.random() < 0.4 else Bounded(last, -bound, bound))
    J = np.array(rows)
    motion = mobility @ force
    if rng.random() < 0.5:  # an impact
        motion = 1e-3 * motion + 0.1 * rng.standard_normal(size)
    return J @ mobility @ J.T, J @ motion, laws


def mixed_rows(rng):
    """Random rows, often dependent, with up to twelve laws; mu up to 3, masses of 1e-3 to 1e3."""
    laws, row = [], 0
    for kind in rng.choice([Friction, Push, Bounded], int(rng.integers(1, 13)), p=[0.6, 0.2, 0.2]):
        if kind is Friction:
            mu = float(rng.choice([0.0, 0.3, 1.0, 3.0, rng.uniform(0.0, 3.0)]))
            laws.append(Friction(row, (row + 1, row + 2), mu))
            row += 2
        elif kind is Push:
            laws.append(Push(row))
        else:
            lower = -float(rng.choice([0.0, 0.3, 1.0, np.inf]))
            laws.append(Bounded(row, lower, float(rng.choice([-lower, 0.5]))))
        row += 1
    A, a = random_rows(rng, row, int(rng.integers(1, row + 3)))
    return A @ A.T * 10.0 ** rng.uniform(-3.0, 3.0), A @ a, laws
