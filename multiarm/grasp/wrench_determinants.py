r"""Determinants of six wrenches whose contacts slide: all corners of a product of polygons at once.

A contact that slides in its face by d changes its own column :math:`[e; p \times e]` by
:math:`[0; d \times e]`, linearly. A determinant is affine in every single displacement, and over a
product of polygons smallest at corners. With six polygons of m corners, and Laplace's expansion
along the first three columns and the last three, all :math:`m^6` values are one product of two
matrices.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from multiarm.grasp.contacts import Contacts

# Relative accuracy of radii.
ACCURACY = 1e-12
# Rounds of the descent; each takes every contact once.
ROUNDS = 12
# A radius of more than so many sizes of the grasp is called infinite.
ENDLESS = 1e9


class Minor:
    """Determinant of six contacts' wrenches as a function of their displacements.

    It is divided by its value without displacements: 1 there, and the grasp is lost at 0.
    Displacements are (6, 2), along each contact's tangents, over the length of the contacts.
    """

    def __init__(self, contacts: Contacts, tangents: np.ndarray, left_out: int | None) -> None:
        self.numbers = [j for j in range(contacts.count) if j != left_out]
        W = contacts.scaled_wrenches.T[self.numbers]  # (6, 6), a contact in each row
        e = contacts.normals[self.numbers, None]
        turned = np.cross(tangents[self.numbers], e)  # (6, 2, 3)
        self.base = W
        self.rates = np.concatenate([np.zeros_like(turned), turned], axis=2)  # (6, 2, 6)
        self.nominal = float(np.linalg.det(W))

    def at(self, moves: np.ndarray) -> np.ndarray:
        """Values for displacements (..., 6, 2)."""
        W = self.base + np.einsum("...ka,kab->...kb", moves, self.rates)
        return np.linalg.det(W) / self.nominal

    def worst(self, corners: np.ndarray) -> tuple[float, np.ndarray]:
        """Smallest value over a product of polygons (6, m, 2), and where (6, 2)."""
        columns = self.base[:, None] + np.einsum("kma,kab->kmb", corners, self.rates)
        left, right = _wedge(*columns[:3]), _wedge(*columns[3:])
        values = (
            (left * _SIGNS) @ right[:, ::-1].T / self.nominal
        )  # complements are in reverse order
        place = int(np.argmin(values))
        m = corners.shape[1]
        which = np.unravel_index(place, (m,) * 6)
        return float(values.flat[place]), corners[np.arange(6), list(which)]

    def gradient(self, moves: np.ndarray) -> np.ndarray:
        """Derivative with respect to each displacement, shape (6, 2); exact, being affine."""
        steps = np.eye(12).reshape(12, 6, 2)
        return (self.at(moves + steps) - self.at(moves)).reshape(6, 2)

    def estimate(self) -> float:
        """Radius to first order."""
        slope = float(np.sum(np.linalg.norm(self.gradient(np.zeros((6, 2))), axis=1)))
        return 1.0 / max(slope, 1.0 / ENDLESS)

    def smallest_on(self, polygons: np.ndarray, guess: float) -> float:
        """Smallest r at which polygons r times as large reach zero; infinite if none does."""
        from scipy.optimize import brentq

        def value(r: float) -> float:
            return self.worst(r * polygons)[0]

        high = guess
        while value(high) > 0.0:
            high *= 2.0
            if high > ENDLESS:
                return float("inf")
        return float(brentq(value, 0.0, high, xtol=ACCURACY * high, rtol=ACCURACY))

    def broken_by(self, start: np.ndarray, r: float) -> tuple[float, np.ndarray]:
        """A smaller radius, and directions (6, 2), at which the value is zero: descent on discs."""
        along = start / np.linalg.norm(start, axis=1, keepdims=True)
        for _ in range(ROUNDS):
            for k in range(6):
                slope = self.gradient(r * along)[k]
                size = np.linalg.norm(slope)
                if size > 0.0:
                    along[k] = -slope / size
            better = self.smallest_on(along[:, None], r)
            if better >= r * (1.0 - 1e-9):
                break
            r = better
        return r, along


def _wedge(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """All products ``a ^ b ^ c``, shape (m^3, 20), of vectors (m, 6)."""
    i, j = _PAIRS
    two = a[:, None, i] * b[None, :, j] - a[:, None, j] * b[None, :, i]  # (m, m, 15)
    ij, ik, jk, p, q, r = _TRIPLES
    three = (
        two[:, :, None, ij] * c[:, r]
        - two[:, :, None, ik] * c[:, q]
        + two[:, :, None, jk] * c[:, p]
    )
    return three.reshape(-1, 20)


def _index_tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    pairs = list(combinations(range(6), 2))
    triples = list(combinations(range(6), 3))
    place = {pair: k for k, pair in enumerate(pairs)}
    rows = [(place[i, j], place[i, k], place[j, k], i, j, k) for i, j, k in triples]
    signs = [(-1.0) ** (i + j + k - 3) for i, j, k in triples]
    return np.array(pairs).T, np.array(rows).T, np.array(signs)


_PAIRS, _TRIPLES, _SIGNS = _index_tables()
