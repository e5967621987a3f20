"""The scaling study: cost over the number of arms, and shares of the time.

Four studies, each in its own module: the cost of one evaluation compared with Pinocchio's
algorithms (:mod:`multiarm.studies.evaluation_costs`), section 4.4 of the thesis
(:mod:`multiarm.studies.solver_study`), the parts of an evaluation and of a step
(:mod:`multiarm.studies.time_shares`), the cost of a contact row
(:mod:`multiarm.studies.contact_rows`).
"""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass
from typing import Any

from multiarm.studies import contact_rows, solver_study, time_shares
from multiarm.studies.evaluation_costs import evaluation_costs
from multiarm.studies.records import machine
from multiarm.terminal.progress import Progress, Report, displayed

EVALUATIONS, THESIS, SHARES, ROWS = STUDIES = ("evaluations", "thesis", "shares", "rows")
KINDS = ("weld", "ball")


@dataclass(frozen=True)
class Plan:
    """What is measured.

    Attributes
    ----------
    studies : tuple of str
        Of ``STUDIES``.
    kinds : tuple of str
        Joints of the evaluations: weld, ball, revolute.
    arms, thesis_arms, share_arms : tuple of int
        Numbers of arms, increasing, of the evaluations, of section 4.4, of the shares of time.
    rounds : int
        Repetitions of every measurement.
    """

    studies: tuple[str, ...] = STUDIES
    kinds: tuple[str, ...] = KINDS
    arms: tuple[int, ...] = (2, 4, 8, 16, 32, 64)
    thesis_arms: tuple[int, ...] = solver_study.ARMS
    share_arms: tuple[int, ...] = time_shares.ARMS
    rounds: int = 7

    @property
    def measurements(self) -> int:
        """Number of progress reports of :func:`run_scaling`."""
        each = {
            EVALUATIONS: len(self.kinds) * len(self.arms),
            THESIS: len(self.thesis_arms),
            SHARES: len(self.share_arms) + len(time_shares.integrators()),
            ROWS: self.rounds,
        }
        return sum(each[study] for study in self.studies)


def quick(studies: tuple[str, ...] = STUDIES, kinds: tuple[str, ...] = KINDS) -> Plan:
    """A plan that takes seconds: fewer arms, fewer repetitions."""
    return Plan(
        studies, kinds, arms=(2, 4, 8, 16), thesis_arms=(2, 4, 6, 8, 10, 20), share_arms=(2, 8),
        rounds=2,
    )  # fmt: skip


def run_scaling(plan: Plan, progress: bool | Report | None = None) -> dict[str, Any]:
    """Carry out a plan.

    Parameters
    ----------
    plan : Plan
    progress : bool or callable, optional
        ``progress(done, total, words)``, in measurements; True: on stderr.

    Returns
    -------
    dict
        ``machine``, ``rounds``, ``wall_time_s``, ``waited`` (share of it in which this process did
        not run, as other programs disturbed it); and of the requested studies
        ``evaluations`` (:func:`~multiarm.studies.evaluation_costs.evaluation_costs`), ``thesis``
        (:func:`~multiarm.studies.solver_study.solver_study`), ``shares``
        (:func:`~multiarm.studies.time_shares.time_shares`) and ``contact_rows`` (kind of row ->
        microseconds).
    """
    begin, busy = time.perf_counter(), time.process_time()
    with displayed(progress, Progress) as show:
        found = _measured(plan, show)
    wall = time.perf_counter() - begin
    found["wall_time_s"] = wall
    found["waited"] = max(0.0, 1.0 - (time.process_time() - busy) / wall)
    return found


def _measured(plan: Plan, show: Report) -> dict[str, Any]:
    found: dict[str, Any] = {"machine": machine(), "rounds": plan.rounds}
    counted = itertools.count()

    def report(words: str) -> None:
        show(next(counted), plan.measurements, words)

    if EVALUATIONS in plan.studies:
        found["evaluations"] = evaluation_costs(plan.arms, plan.kinds, plan.rounds, report)
    if THESIS in plan.studies:
        found["thesis"] = solver_study.solver_study(plan.thesis_arms, plan.rounds, report)
    if SHARES in plan.studies:
        found["shares"] = time_shares.time_shares(plan.share_arms, plan.rounds, report)
    if ROWS in plan.studies:
        found["contact_rows"] = contact_rows.measure_rows(plan.rounds, report)
    return found
