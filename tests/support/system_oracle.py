r"""Exact solutions of constrained systems, and what a solver has to get right.

*Oracle.*  :func:`solve_exactly` has 50 digits, and one tolerance only: the rank is the number of
singular values of ``W`` above the solvers' tolerance, with all rows measured alike
(:func:`measured`).  The forces are of least norm.  It judges the node algorithm, its form with
reactions, and the dense reference alike, so that a difference says which of them is wrong.

*Judgement.*  Every solution has to balance the forces on the object and on each arm, and to keep
the accelerations on the constraints.  Beyond that its accelerations, its contact forces, which of
them are unique, the wrench that they add up to, and the rank have to be the oracle's.  Errors are
relative to the largest term of the equations in question; where they are larger than the bounds,
the system may be as sensitive: errors as large as what ``BACKWARD`` of each coefficient does
are accepted.

*Band.* Constraints that contribute less than ``COUPLED_RANK_TOLERANCE`` count as dependent, and by
how much they do depends on how levers and inertias are weighed: by each arm's own (node), or by all
(reference, reactions). Where a singular value is between the two of ``BAND``, in plain geometry or
so weighed, only balances and constraints are asked for, and a rank between the numbers of singular
values above either end of ``RANK_BAND``; likewise of the node algorithm where an arm moves by less
than ``BESIDE_OBJECT`` of what the object does.

*Depth.*  Weighed by all inertias, a gram held by tonnes comes near the tolerance by its mass alone.
Where a singular value that counts is below ``DEPTH``, reference and reactions are not asked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from decimal import localcontext
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from matrix_systems import exactly
from matrix_systems import solve_exactly as eliminate
from random_systems import System
from scipy.linalg import block_diag

from multiarm.dynamics.solver.batched import solve_batched
from multiarm.dynamics.solver.bounds import (
    COUPLED_RANK_TOLERANCE,
    IMBALANCE_BOUND,
    IMMOVABLE_BY_OBJECT,
    PART_TOLERANCE,
)
from multiarm.dynamics.solver.dense import SystemSolution, solve_dense
from multiarm.dynamics.solver.node import eliminate_blocks, make_work
from multiarm.dynamics.solver.reactions import (
    eliminate_with_reactions,
    make_reaction_work,
    solve_for_reactions,
)
from multiarm.dynamics.solver.singular import (
    couple,
    make_coupled,
    solve_coupled,
    undetermined_parts,
)
from multiarm.dynamics.status import OK

# Singular values of rows of unit pushes: between these there is more than one right answer, ...
BAND = (1e-12, 1e-5)
# ... but no rank counts what is below, and none leaves out what is above these.
RANK_BAND = (1e-8, 1e-5)
# Arms that move by this part of what the object does on its own, or less, count as immovable: next
# to these there are two right answers again.
BESIDE_OBJECT = 10.0 * IMMOVABLE_BY_OBJECT
# Smallest singular value that counts which reference and reactions are asked for.
DEPTH = 1e-3
# Constraints that count as dependent are missed by this part of the accelerations at the most: the
# tolerance times what separates one way of weighing from the other.
DROPPED = 1e-4
DIGITS = 50
# Errors relative to the largest terms of the same equation.
BALANCE, SOLUTION = 1e-9, 1e-8
# Forces are accelerations over mobilities, the squares of singular values; a sum's worth of these.
ROUNDING = 10.0 * float(np.finfo(float).eps)
# Arms that move by a thousandth of what the object does are eliminated: what is small by inertia
# loses three more digits.
SPLIT = 1e3
# What elimination leaves of the largest force of any arm, and of what single forces would do to a
# body alone: eleven digits (a pivot of 1e-5), of which one is lost in sums.
ELIMINATION = 1e-10
# Coefficients that a solution with eleven digits cannot tell apart.
BACKWARD = 1e-11
# One random change of all coefficients stands for the worst one.
SENSITIVITY_FACTOR = 10.0


# --- solvers on matrices -------------------------------------------------------------------------


class Loads(NamedTuple):
    """Right-hand sides and unknowns, stacked, as the kernels take them."""

    f_o: np.ndarray
    f_j: np.ndarray
    c: np.ndarray
    a_o: np.ndarray
    q: np.ndarray
    force: np.ndarray


def loads_of(system: System) -> Loads:
    f_j, c = np.concatenate(system.f_j), np.concatenate(system.c)
    return Loads(system.f_o, f_j, c, np.zeros(6), np.zeros(f_j.size), np.zeros(c.size))


def balanced(system: System, loads: Loads) -> bool:
    """Whether the object is, so that the equations are not solved again."""
    unit, pushes = unit_of_object(system), np.hstack(system.reaction_o) * loads.force
    left = (system.M_o @ loads.a_o - system.f_o - np.sum(pushes, axis=1)) / unit
    scale = size_of(system.f_o / unit, pushes / unit[:, None])
    return size_of(left) <= IMBALANCE_BOUND * scale


def load_arms(system: System, work, columns: dict[str, list[np.ndarray]]) -> None:
    """Write the arms' inertias, and matrices of one column a contact, into ``work``."""
    for i, M in enumerate(system.M):
        work.M[i, : len(M), : len(M)] = M
        for name, matrices in columns.items():
            getattr(work, name)[i, : len(M), : matrices[i].shape[1]] = matrices[i]


def solve_by_node(system: System) -> SystemSolution:
    """The node algorithm as an evaluation runs it: again where the object is not in balance.

    Raises
    ------
    ValueError
        When it says that the system cannot be solved.
    """
    dofs, rows = [len(M) for M in system.M], [W.shape[1] for W in system.W]
    work, coupled = make_work(dofs, rows, system.reach), make_coupled(dofs, rows)
    loads, W_o = loads_of(system), np.ascontiguousarray(np.hstack(system.W_o).T)
    load_arms(system, work, {"W": system.W})
    eliminated = solve_batched(work, W_o, system.M_o, *loads) == OK
    if eliminated and balanced(system, loads):
        return _solution(work, loads, loads.c.size, np.ones(loads.c.size, dtype=bool))
    for decompose_all in (False, True):
        load_arms(system, work, {"W": system.W})
        failure, _ = eliminate_blocks(work, W_o)
        if failure != OK or not couple(work, coupled, W_o, system.M_o, decompose_all) > 0.0:
            raise ValueError("the node algorithm takes an inertia for indefinite")
        solve_coupled(work, coupled, *loads)
        if balanced(system, loads):
            break
    rank = loads.c.size - int(coupled.status.unknowns - coupled.status.rank)
    return _solution(work, loads, rank, undetermined_parts(work, coupled) < PART_TOLERANCE)


def solve_by_reactions(system: System) -> SystemSolution:
    """The form with reactions, with all arms coupled where the object is not in balance.

    Raises
    ------
    ValueError
        When it says that the system cannot be solved.
    """
    rows = [W.shape[1] for W in system.W]
    work = make_reaction_work([len(M) for M in system.M], rows)
    for own, reach in zip(work.levers, system.reach, strict=True):
        own[: len(reach)] = reach
    loads = loads_of(system)
    W_o, Wr_o = (np.ascontiguousarray(np.hstack(W).T) for W in (system.W_o, system.reaction_o))
    for couple_all in (False, True):
        load_arms(system, work, {"W": system.W, "Wr": system.reaction})
        failure, _ = eliminate_with_reactions(work, W_o, Wr_o, system.M_o, couple_all)
        if failure != OK:
            raise ValueError("the form with reactions takes an inertia for indefinite")
        solve_for_reactions(work, W_o, Wr_o, *loads)
        if balanced(system, loads):
            break
    status, size = work.status, loads.c.size
    rank = size - (status.contacts - status.rank)
    loose = np.linalg.norm(work.null_force[: status.null_forces, :size], axis=0)
    return _solution(work, loads, rank, loose < PART_TOLERANCE)


def _solution(work, loads: Loads, rank: int, unique: np.ndarray) -> SystemSolution:
    dofs, rows = work.first_joint[1:-1], work.first_contact[1:-1]
    split = np.split(loads.q, dofs), np.split(loads.force, rows), np.split(unique, rows)
    return SystemSolution(loads.a_o, *split, rank)


def solve_by_reference(system: System) -> SystemSolution:
    names = ("M_o", "f_o", "M", "f_j", "W_o", "W", "c", "reaction_o", "reaction")
    return solve_dense(*(getattr(system, name) for name in names))


SOLVERS: dict[str, Callable[[System], SystemSolution]] = {
    "node": solve_by_node,
    "reactions": solve_by_reactions,
    "dense": solve_by_reference,
}


# --- geometry ------------------------------------------------------------------------------------


def unit_of_object(system: System) -> np.ndarray:
    """Units of a wrench on the object: 1 N, and that at the lever [N m]."""
    return np.repeat([1.0, system.lever], 3)


def measured(system: System, blocks: list[np.ndarray] | None = None) -> np.ndarray:
    """``W`` in unit forces, levers and what each joint moves at the contacts."""
    if blocks is None:
        blocks = [W / r[:, None] for W, r in zip(system.W, system.reach, strict=True)]
    return np.vstack([np.hstack(system.W_o) / unit_of_object(system)[:, None], block_diag(*blocks)])


def weighed(system: System) -> np.ndarray:
    """``W`` with each arm in units of what its inertia lets its quickest joint do."""
    blocks = []
    for M, W, reach in zip(system.M, system.W, system.reach, strict=True):
        blocks.append(np.linalg.solve(np.linalg.cholesky(M), W) / quickest(M, reach))
    return measured(system, blocks)


def inertia_scaled(system: System) -> np.ndarray:
    """``L^-1 W``, columns of unit length, as the reference and the reactions see it."""
    bodies = zip([system.M_o, *system.M], [np.hstack(system.W_o), *system.W], strict=True)
    own, *arms = (np.linalg.solve(np.linalg.cholesky(M), W) for M, W in bodies)
    whole = np.vstack([own, block_diag(*arms)])
    return whole / np.linalg.norm(whole, axis=0)


def quickest(M: np.ndarray, reach: np.ndarray) -> float:
    """How an arm's joints give way to a unit push at the contacts, at best [1/sqrt(kg)]."""
    return float(np.max(reach * np.sqrt(np.diag(np.linalg.inv(M)))))


def taken_for_immovable(system: System) -> bool:
    """Whether an arm moves along contacts by its own measure and hardly does beside the object."""
    whole = np.hstack(system.W_o)
    by_object = np.linalg.norm(np.linalg.solve(np.linalg.cholesky(system.M_o), whole), axis=0)
    for M, W, reach in zip(system.M, system.W, system.reach, strict=True):
        moved = values_of(np.linalg.solve(np.linalg.cholesky(M), W))
        own, beside = moved / quickest(M, reach), moved / np.max(by_object)
        if np.any((own > RANK_BAND[0]) & (beside < BESIDE_OBJECT)):
            return True
    return False


def values_of(matrix: np.ndarray) -> np.ndarray:
    return np.linalg.svd(matrix, compute_uv=False)


class Spectrum(NamedTuple):
    """What singular values say of the rank, see the module.

    least_rank, rank, most_rank : int
    in_band, deep : bool
    error : float
        Relative error of solutions.
    """

    least_rank: int
    rank: int
    most_rank: int
    in_band: bool
    deep: bool
    error: float


def spectrum(system: System, solver: str) -> Spectrum:
    plain, scaled = values_of(measured(system)), values_of(inertia_scaled(system))
    scaled = scaled / scaled[0]
    own = values_of(weighed(system)) if solver == "node" else scaled
    rank = int(np.sum(plain > COUPLED_RANK_TOLERANCE))
    least = min(plain[rank - 1], own[rank - 1])
    return Spectrum(
        least_rank=int(min(np.sum(plain > RANK_BAND[1]), np.sum(own > RANK_BAND[1]))),
        rank=rank,
        most_rank=int(max(np.sum(plain > RANK_BAND[0]), np.sum(own > RANK_BAND[0]))),
        in_band=any(bool(np.any((v > BAND[0]) & (v < BAND[1]))) for v in (plain, own))
        or (solver == "node" and taken_for_immovable(system)),
        deep=solver != "node" and bool(own[rank - 1] < DEPTH),
        error=max(SOLUTION, ROUNDING / least**2, SPLIT * ROUNDING / scaled[rank - 1]),
    )


# --- oracle --------------------------------------------------------------------------------------


def solve_exactly(system: System, rank: int) -> SystemSolution:
    """Solution with forces of least norm, of this rank.

    Forces and constraints are restricted to the row space of ``W``, in which they are regular.
    """
    turned = np.linalg.svd(measured(system))[2]
    bounds = np.cumsum([0] + [W.shape[1] for W in system.W])
    bodies = [
        (system.M_o, system.f_o, np.hstack(system.W_o), np.hstack(system.reaction_o), slice(None)),
        *zip(
            system.M, system.f_j, system.W, system.reaction,
            (slice(*ends) for ends in pairwise(bounds)), strict=True,
        ),
    ]  # fmt: skip
    with localcontext() as context:
        context.prec = DIGITS
        V = exactly(turned[:rank].T)
        F, d, kept = 0, V.T @ exactly(np.concatenate(system.c)), []
        for M, f_j, W, R, own in bodies:
            constraint, reaction = exactly(W) @ V[own], exactly(R) @ V[own]
            moved = eliminate(exactly(M), np.column_stack([reaction, exactly(f_j)]))
            F, d = F + constraint.T @ moved[:, :-1], d - constraint.T @ moved[:, -1]
            kept.append(moved)
        share = eliminate(F, d[:, None])[:, 0]
        force = (V @ share).astype(float)
        found = [(moved[:, -1] + moved[:, :-1] @ share).astype(float) for moved in kept]
    parts = np.linalg.norm(turned[rank:], axis=0)
    return SystemSolution(
        found[0], found[1:], np.split(force, bounds[1:-1]), np.split(parts, bounds[1:-1]), rank
    )


# --- judgement -----------------------------------------------------------------------------------


class Scales(NamedTuple):
    """Largest terms of the equations at the exact solution, in the units of :func:`measured`.

    forces, all_forces : float
        On the object and in any contact; those of the arms as well [N].
    of_arms : list of float
        On the joints of each arm, and in its contacts.
    accelerations, freed : float
        Of object, joints, and of the right-hand side; and what single forces alone would cause.
    """

    forces: float
    all_forces: float
    of_arms: list[float]
    accelerations: float
    freed: float


def size_of(*vectors: np.ndarray) -> float:
    return max(float(np.max(np.abs(v), initial=0.0)) for v in vectors)


def scales_of(system: System, exact: SystemSolution) -> Scales:
    unit = unit_of_object(system)
    a_o = exact.object_acceleration
    pushes = [R * f for R, f in zip(system.reaction_o, exact.contact_forces, strict=True)]
    of_arms, moved = [], [a_o * unit, np.linalg.solve(system.M_o, system.f_o) * unit, *system.c]
    freed = [np.linalg.solve(system.M_o, push) * unit[:, None] for push in pushes]
    for M, f_j, R, reach, q, f in zip(
        system.M, system.f_j, system.reaction, system.reach, exact.joint_accelerations,
        exact.contact_forces, strict=True,
    ):  # fmt: skip
        of_arms.append(size_of(M @ q / reach, f_j / reach, f))
        moved += [q * reach, np.linalg.solve(M, f_j) * reach]
        freed.append(np.linalg.solve(M, R * f) * reach[:, None])
    on_object = (
        system.M_o @ a_o / unit,
        system.f_o / unit,
        *(push / unit[:, None] for push in pushes),
    )
    forces = size_of(*on_object, *exact.contact_forces)
    return Scales(forces, max(forces, *of_arms), of_arms, size_of(*moved), size_of(*freed))


def balances(system: System, found: SystemSolution) -> tuple[float, list[float], float]:
    """Residuals of the object's equations, of every arm's, and of the constraints."""
    unit, a_o = unit_of_object(system), found.object_acceleration
    on_object = system.M_o @ a_o - system.f_o
    arms, constraint = [], 0.0
    for i, (q, f) in enumerate(zip(found.joint_accelerations, found.contact_forces, strict=True)):
        on_object = on_object - system.reaction_o[i] @ f
        left = system.M[i] @ q - system.f_j[i] - system.reaction[i] @ f
        arms.append(size_of(left / system.reach[i]))
        gap = system.W_o[i].T @ a_o + system.W[i].T @ q - system.c[i]
        constraint = max(constraint, size_of(gap))
    return size_of(on_object / unit), arms, constraint


def errors(system: System, found: SystemSolution, exact: SystemSolution) -> dict[str, float]:
    """Largest differences of accelerations, forces and wrench."""
    unit = unit_of_object(system)
    pairs = zip(found.joint_accelerations, exact.joint_accelerations, system.reach, strict=True)
    forces = [a - b for a, b in zip(found.contact_forces, exact.contact_forces, strict=True)]
    wrench = np.hstack(system.reaction_o) @ np.concatenate(forces)
    return {
        "object's acceleration": size_of(
            (found.object_acceleration - exact.object_acceleration) * unit
        ),
        "joints' accelerations": size_of(*((a - b) * reach for a, b, reach in pairs)),
        "contact forces": size_of(*forces),
        "wrench on the object": size_of(wrench / unit),
    }


def relative(value: float, bound: float) -> float:
    """How many times the bound; no number counts as infinite."""
    if value == 0.0:
        return 0.0
    ratio = value / bound if bound > 0.0 else np.inf
    return ratio if np.isfinite(ratio) else np.inf


class Oracle:
    """The exact solution of a system, and how sensitive it is."""

    def __init__(self, system: System):
        self.system = system
        self.spectra = {solver: spectrum(system, solver) for solver in SOLVERS}
        self.rank = self.spectra["node"].rank
        self.exact = solve_exactly(system, self.rank)
        self.scales = scales_of(system, self.exact)
        self._sensitivity: dict[str, float] | None = None

    @property
    def sensitivity(self) -> dict[str, float]:
        """What a change of all coefficients by ``BACKWARD`` does."""
        if self._sensitivity is None:
            other = solve_exactly(disturbed(self.system), self.rank)
            self._sensitivity = errors(self.system, other, self.exact)
        return self._sensitivity

    @property
    def solvers(self) -> list[str]:
        """Names of the solvers that the system is for."""
        able = [name for name, known in self.spectra.items() if not known.deep]
        return [name for name in able if not (self.system.sliding and name == "node")]

    def judge(self, solver: str, found: SystemSolution | None = None) -> dict[str, float]:
        """Every figure of a solver relative to its bound: above 1 is a fault.

        ``found`` is what it found elsewhere; it solves the system here when left out.
        """
        system, known = self.system, self.spectra[solver]
        try:
            found = found or SOLVERS[solver](system)
        except ValueError:
            return {"refused": np.inf}
        figures = self._balances(solver, found)
        within = known.least_rank <= found.rank <= known.most_rank
        figures["rank"] = 0.0 if within else np.inf
        determined = not system.sliding or self.rank == sum(c.size for c in system.c)
        if not known.in_band and determined:
            figures |= self._errors(found, known.error)
            figures["which forces are unique"] = self._uniqueness(found)
        return figures

    def _accelerations(self, part: float) -> float:
        return part * self.scales.accelerations + ELIMINATION * self.scales.freed

    def _balances(self, solver: str, found: SystemSolution) -> dict[str, float]:
        on_object, arms, constraint = balances(self.system, found)
        forces, dropped, in_band = self.scales.forces, 0.0, self.spectra[solver].in_band
        part, error = BALANCE if solver == "node" else SOLUTION, self.spectra[solver].error
        if in_band:  # forces that contribute 1e-8 of theirs may be had
            forces = max(forces, min(size_of(*found.contact_forces), forces / RANK_BAND[0]))
        if in_band and solver != "node":  # which take off what contributes hardly anything
            dropped = RANK_BAND[1] * forces
        rounding = dropped + ELIMINATION * max(self.scales.all_forces, forces)
        missed = DROPPED * self.scales.accelerations if in_band else 0.0
        return {
            "balance of the object": relative(on_object, part * forces + rounding),
            "balance of an arm": max(
                relative(left, part * own + rounding)
                for left, own in zip(arms, self.scales.of_arms, strict=True)
            ),
            "constraints": relative(constraint, self._accelerations(error) + missed),
        }

    def _errors(self, found: SystemSolution, part: float) -> dict[str, float]:
        figures = {}
        for name, error in errors(self.system, found, self.exact).items():
            allowed = part * self.scales.forces + ELIMINATION * self.scales.all_forces
            if "acceleration" in name:
                allowed = self._accelerations(part)
            figures[name] = relative(error, allowed)
            if 1.0 < figures[name] < np.inf:
                sensitive = SENSITIVITY_FACTOR * self.sensitivity[name]
                figures[name] = relative(error, allowed + sensitive)
        return figures

    def _uniqueness(self, found: SystemSolution) -> float:
        """Forces with a clear part in the null space are not unique, those without one are."""
        parts, unique = np.concatenate(self.exact.unique), np.concatenate(found.unique)
        wrong = (unique & (parts > RANK_BAND[1])) | (~unique & (parts < BAND[0]))
        return np.inf if np.any(wrong) else 0.0


def disturbed(system: System) -> System:
    """The system with all coefficients changed by up to ``BACKWARD`` of their like."""
    rng = np.random.default_rng(0)

    def near(values: np.ndarray, unit) -> np.ndarray:
        return values + BACKWARD * unit * rng.uniform(-1.0, 1.0, values.shape)

    def near_inertia(M: np.ndarray) -> np.ndarray:
        unit = np.sqrt(np.outer(np.diag(M), np.diag(M)))
        change = near(np.zeros(M.shape), unit)
        return M + 0.5 * (change + change.T)

    unit, reach = unit_of_object(system), system.reach
    most = [size_of(f_j / r) * r for f_j, r in zip(system.f_j, reach, strict=True)]
    W_o = [near(W, unit[:, None]) for W in system.W_o]
    W = [near(W, r[:, None]) for W, r in zip(system.W, reach, strict=True)]
    changed = {"reaction_o": W_o, "reaction": W}
    if system.sliding:
        changed = {
            "reaction_o": [near(R, unit[:, None]) for R in system.reaction_o],
            "reaction": [near(R, r[:, None]) for R, r in zip(system.reaction, reach, strict=True)],
        }
    return replace(
        system,
        M_o=near_inertia(system.M_o),
        f_o=near(system.f_o, size_of(system.f_o / unit) * unit),
        M=[near_inertia(M) for M in system.M],
        f_j=[near(f_j, unit) for f_j, unit in zip(system.f_j, most, strict=True)],
        W_o=W_o,
        W=W,
        c=[near(c, size_of(*system.c)) for c in system.c],
        **changed,
    )


def faults(system: System) -> dict[str, dict[str, float]]:
    """Figures above their bounds, by solver; solvers without any are left out."""
    oracle = Oracle(system)
    found = {}
    for solver in oracle.solvers:
        over = {what: value for what, value in oracle.judge(solver).items() if value > 1.0}
        if over:
            found[solver] = over
    return found
