r"""The highest score that placements in given cells can have, at most: one linear program.

*margin*. A contact in a cell with corners :math:`c_v` and the force :math:`\lambda_i` is a
combination of forces at the corners, :math:`\lambda_i = \sum_v \mu_{iv}` and
:math:`\lambda_i w_i(p_i) = \sum_v \mu_{iv} w_i(c_v)`, since the wrench is affine on a face. The
best margin over all placements is a linear program in :math:`\mu`, without any loss.

*force, stability*. Maximise S under :math:`S \le \text{cut}(y)` for the twist cuts of
:mod:`multiarm.grasp.grasp_objectives`, y in the cells. Twists are made where they are needed: at
the placement that the program proposes. What remains between program and truth are the chords; a
cell is then cut in two where the chord that counts most has its bend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.grasp.grasp_objectives import VOID, Cuts, Margin, Objective
from multiarm.grasp.placements import ROUNDING, SevenTouches, halves, sides_of

# Twists are added until the bound falls by less than this part in a round, or so many rounds.
SETTLED = 0.01
ROUNDS = 6
# So many of the sharpest twists go on to the two halves of a cell.
INHERITED = 80
# How SciPy says that a program has no solution.
INFEASIBLE = 2
# A line that cuts a cell leaves this part of its width on either side.
SHARE = 0.15


@dataclass(frozen=True, eq=False)
class Node:
    """Cells of seven contacts, with their bounds.

    Attributes
    ----------
    cells : list of ndarray, shape (V, 2)
    twists : ndarray, shape (C, 6)
        For cuts.
    bound : float
        No placement in the cells has a higher score.
    """

    cells: list[np.ndarray]
    twists: np.ndarray
    bound: float


@dataclass(frozen=True, eq=False)
class Bounded:
    """A node's bound, a placement that the program proposes, and the parts of the node.

    Attributes
    ----------
    bound : float
    placements : ndarray, shape (K, 7, 2)
    twists : ndarray, shape (C, 6)
        Whose cuts are the sharpest, those first.
    parts : list of Node
        Empty when nothing in the node can be better than the requested value.
    """

    bound: float
    placements: np.ndarray
    twists: np.ndarray
    parts: list[Node]


def bounded(objective: Objective, touches: SevenTouches, node: Node, enough: float) -> Bounded:
    """Bound a node, and part it when its bound is above ``enough``."""
    if isinstance(objective, Margin):
        bound, y, twist = _best_margin(touches, node.cells)
        found = Bounded(min(bound, node.bound), y, twist, [])
        return found if bound <= enough else _parted(found, node, *_widest(node.cells))
    return _by_cuts(objective, touches, node, enough)


def _by_cuts(objective: Objective, touches: SevenTouches, node: Node, enough: float) -> Bounded:
    twists, bound, proposed = node.twists, node.bound, []
    for _ in range(ROUNDS):
        cuts = objective.cuts(touches, node.cells, twists, enough)
        top, y, weights = _highest(cuts, node.cells)
        top = max(top, enough)
        proposed.append(y)
        settled = top > bound * (1.0 - SETTLED)
        bound = min(bound, top)
        if bound <= enough or (settled and len(proposed) > 1):
            break
        twists = np.concatenate([twists, objective.twists(touches, y)])
    slack = cuts.constants + np.einsum("cia,ia->c", cuts.slopes, y)
    sharp = cuts.twists[np.argsort(slack, kind="stable")[:INHERITED]]
    found = Bounded(bound, np.array(proposed), sharp, [])
    return found if bound <= enough else _parted(found, node, *_bend(cuts, weights, y, node.cells))


def _highest(cuts: Cuts, cells: list[np.ndarray]) -> tuple[float, np.ndarray, np.ndarray]:
    """Largest S, where, and the weights of the cuts there."""
    from scipy.optimize import linprog

    useful = np.flatnonzero(cuts.constants < VOID)
    rows = [np.c_[-cuts.slopes[useful].reshape(-1, 14), np.ones(len(useful))]]
    limits = [cuts.constants[useful]]
    for i, cell in enumerate(cells):
        out, levels = sides_of(cell)
        row = np.zeros((len(out), 15))
        row[:, 2 * i : 2 * i + 2] = out
        rows.append(row)
        limits.append(levels)
    result = linprog(
        np.r_[np.zeros(14), -1.0],
        A_ub=np.vstack(rows),
        b_ub=np.concatenate(limits),
        bounds=[(None, None)] * 14 + [(None, VOID)],
    )
    weights = np.zeros(len(cuts.constants))
    if result.x is None:  # rounding in a sliver of a cell: nothing is concluded
        return VOID, np.array([cell.mean(axis=0) for cell in cells]), weights
    weights[useful] = -result.ineqlin.marginals[: len(useful)]
    return float(result.x[14]), result.x[:14].reshape(7, 2), weights


def _bend(
    cuts: Cuts, weights: np.ndarray, y: np.ndarray, cells: list[np.ndarray]
) -> tuple[int, np.ndarray, float]:
    """The contact that moves the worst chord most, and the line where its term is zero."""
    z = cuts.term_values + np.einsum("ctia,ia->ct", cuts.term_slopes, y)
    loss = weights[:, None] * (cuts.rises * z + cuts.bends - z.clip(0.0))
    c, t = np.unravel_index(int(np.argmax(loss)), loss.shape) if loss.size else (0, 0)
    if not loss.size or not loss[c, t] > ROUNDING:
        return _widest(cells)
    slopes = cuts.term_slopes[c, t]
    i = int(np.argmax([np.ptp(cell @ slope) for cell, slope in zip(cells, slopes, strict=True)]))
    return i, slopes[i], float(slopes[i] @ y[i] - z[c, t])


def _widest(cells: list[np.ndarray]) -> tuple[int, np.ndarray, float]:
    """The longest of all cells, and the line across its middle."""
    spread = [np.linalg.svd(cell - cell.mean(axis=0))[1:] for cell in cells]
    i = int(
        np.argmax([s[0] / np.sqrt(len(cell)) for (s, _), cell in zip(spread, cells, strict=True)])
    )
    along = spread[i][1][0]
    height = cells[i] @ along
    return i, along, 0.5 * float(height.min() + height.max())


def _parted(found: Bounded, node: Node, i: int, along: np.ndarray, level: float) -> Bounded:
    height = node.cells[i] @ along
    low, high = float(height.min()), float(height.max())
    margin = SHARE * (high - low)
    parts = []
    for half in halves(node.cells[i], along, min(max(level, low + margin), high - margin)):
        cells = list(node.cells)
        cells[i] = half
        parts.append(Node(cells, found.twists, found.bound))
    return Bounded(found.bound, found.placements, found.twists, parts)


def _best_margin(
    touches: SevenTouches, cells: list[np.ndarray]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Largest margin over the cells, the placement (1, 7, 2) that has it, the twist, either way."""
    from scipy.optimize import linprog

    owner = np.repeat(np.arange(7), [len(cell) for cell in cells])
    corners = np.concatenate(cells)
    w = touches.base[owner] + np.einsum("ca,caf->cf", corners, touches.rates[owner])
    sums = (owner[None] == np.arange(7)[:, None]).astype(float)
    count = len(owner)
    result = linprog(
        np.r_[np.zeros(count), -1.0],
        A_ub=np.hstack([-sums, np.ones((7, 1))]),
        b_ub=np.zeros(7),
        A_eq=np.vstack([np.c_[w.T, np.zeros(6)], np.r_[np.ones(count), 0.0]]),
        b_eq=np.r_[np.zeros(6), 1.0],
        bounds=[(0, None)] * count + [(None, None)],
    )
    if result.x is None or not -result.fun > 0.0:
        none = result.status == INFEASIBLE or result.x is not None  # else nothing is concluded
        return 0.0 if none else Margin.limit, np.zeros((0, 7, 2)), np.zeros((0, 6))
    mu = result.x[:count]
    y = (sums * mu) @ corners / (sums @ mu)[:, None]
    twist = result.eqlin.marginals[:6]
    return float(-result.fun), y[None], np.array([twist, -twist])
