"""Run the hard cases and judge them by their own criteria.

:func:`run_case` turns one :class:`multiarm.problems.HardCase` into a :class:`CaseResult`: each
criterion measured against its bound, the rank, and the cost of the run.  A case passes when the run
is completed and every criterion is within its bound.  A case that cannot be run is a result too.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pandas

from multiarm import problems
from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.system import System
from multiarm.errors import MultiarmError
from multiarm.plots.decimation import decimate
from multiarm.problems import Criterion, HardCase
from multiarm.results.energy import ENERGIES, energy_balance
from multiarm.results.outcome import RunStatus, plain
from multiarm.results.trajectory import Trajectory
from multiarm.scene import dump_scene
from multiarm.scene.faults import unknown
from multiarm.simulation.simulate import simulate
from multiarm.simulation.solver_log import SOLVER_EVENTS
from multiarm.studies.records import error_text, machine
from multiarm.terminal.progress import Progress, Report, displayed

HISTORY_POINTS = 400
HISTORY = {
    "gap": "drift/position",
    "gap_rate": "drift/velocity",
    "residual": "solver/residual",
    "rank": "solver/rank",
    "coupled_arms": "solver/coupled_arms",
}
NOT_RUN = "not run"


def _events_missing(run: Trajectory, system: System) -> float:
    return float(not any(event["kind"] in SOLVER_EVENTS for event in run.events))


EVENTS = Criterion("expected events missing", 0.0, "1", _events_missing)
"""Of a case that is made to lose rank or a direction: a run that does not notice has not met it."""


@dataclass(frozen=True)
class CriterionResult:
    """One criterion: passed when ``measured <= bound``."""

    quantity: str
    bound: float
    unit: str
    measured: float | None  # None when not finite, or not measurable
    passed: bool
    message: str = ""  # why there is no number
    channel: str = ""  # the recorded quantity that the bound is of, if it is recorded


@dataclass(frozen=True)
class CaseResult:
    """A :class:`multiarm.problems.HardCase`, run and judged."""

    name: str
    title: str
    difficulty: str
    passed: bool  # completed, and every criterion within its bound
    status: str  # "completed", "failed", or "not run" when it could not even begin
    message: str  # what the run said, or why it could not begin
    criteria: tuple[CriterionResult, ...] = ()
    events: tuple[dict[str, Any], ...] = ()  # events of the run: time, kind, arm, text
    # of the run: steps, evaluations, coupled_steps, lowest_rank, highest_rank, ...
    statistics: Mapping[str, Any] = field(default_factory=dict)
    wall_time_s: float = 0.0  # of the run, without compilation; 0 when not run
    # time [s], gap [m], gap_rate [m/s], energy_balance [J], residual [1], rank, coupled_arms
    history: Mapping[str, list[float | None]] = field(default_factory=dict)
    scene: str = ""  # the scene as YAML, as far as it could be made

    @property
    def failures(self) -> tuple[str, ...]:
        """What is not as it should be, a line each; empty when the case passed."""
        lines = [] if self.status == RunStatus.COMPLETED else [f"{self.status}: {self.message}"]
        for item in self.criteria:
            if not item.passed:
                measured = item.message or f"{item.measured:.3g}"
                lines.append(f"{item.quantity}: {measured}, bound {item.bound:.3g} {item.unit}")
        return tuple(lines)

    @property
    def table(self) -> pandas.DataFrame:
        """A row for each criterion, as in :class:`CriterionResult`, with its ``margin``: bound over
        measured, missing where one of them is 0 or missing."""
        columns = [*CriterionResult.__dataclass_fields__]
        table = pandas.DataFrame([vars(item) for item in self.criteria], columns=columns)
        measured = table["measured"].astype(float)
        within = (measured > 0.0) & (table["bound"] > 0.0)
        return table.assign(margin=(table["bound"] / measured).where(within))


@dataclass(frozen=True)
class SuiteResult:
    """Several hard cases."""

    cases: tuple[CaseResult, ...]
    machine: Mapping[str, Any]  # processor, platform, versions, time of the run
    wall_time_s: float  # of everything, compilation too

    @property
    def passed(self) -> int:
        """How many cases passed."""
        return sum(case.passed for case in self.cases)

    def as_dict(self) -> dict[str, Any]:
        """The result in what JSON knows; what is no finite number is None."""
        counts = {"passed": self.passed, "total": len(self.cases)}
        about = {"wall_time_s": self.wall_time_s, "machine": self.machine}
        return plain({**counts, **about, "cases": [asdict(case) for case in self.cases]})


def run_suite(
    names: Sequence[str] = (),
    *,
    cases: Mapping[str, HardCase] | None = None,
    progress: bool | Report | None = None,
) -> SuiteResult:
    """Run hard cases one after the other; none of them ends the suite.

    Parameters
    ----------
    names : sequence of str
        Which; all when empty.
    cases : mapping of str to HardCase, optional
        Where the names are looked up; ``multiarm.problems.HARD_CASES`` when left out.
    progress : bool or callable, optional
        ``progress(done, total, words)``, in cases; True: on stderr.

    Raises
    ------
    MultiarmError
        For a name that is not among the cases.
    KeyboardInterrupt
        Ctrl-C ends the suite.
    """
    chosen = choose_cases(names, cases)
    begin = time.perf_counter()
    results: list[CaseResult] = []
    with displayed(progress, Progress) as show:
        for case in chosen:

            def report(words: str, part: float, name: str = case.name) -> None:
                show(len(results) + part, len(chosen), f"{name}: {words}")

            results.append(run_case(case, progress=report))
        show(len(chosen), len(chosen), "done")
    return SuiteResult(tuple(results), machine(), time.perf_counter() - begin)


def choose_cases(
    names: Sequence[str], cases: Mapping[str, HardCase] | None = None
) -> list[HardCase]:
    """The named cases in the order of the suite, each once; all when no name is given.

    Raises
    ------
    MultiarmError
        For unknown names, with the alternatives.
    """
    known = problems.HARD_CASES if cases is None else cases
    wrong = [unknown("hard case", name, known) for name in names if name not in known]
    if wrong:
        raise MultiarmError(f"{'; '.join(wrong)}; 'multiarm stability --list' shows them all")
    return [case for name, case in known.items() if not names or name in names]


def run_case(case: HardCase, *, progress: Callable[[str, float], None] | None = None) -> CaseResult:
    """Run one hard case and judge it.

    Whatever is raised on the way, except Ctrl-C, becomes a result that did not pass.  ``progress``
    is called with what is being done and which part of the case is done, 0 to 1.
    """
    report = progress or (lambda _words, _part: None)
    about = (case.name, case.title, case.difficulty)
    text = ""
    report("compiling", 0.0)
    try:
        scene = case.scene()
        text = dump_scene(scene)
        system = compile_system(scene)
        duration = scene.run.duration
        trajectory = simulate(
            system,
            progress=lambda t: report("simulating", min(1.0, t / duration)),
            certificate=False,
        )
    except Exception as error:
        return CaseResult(*about, False, NOT_RUN, error_text(error), scene=text)
    if trajectory.status == RunStatus.INTERRUPTED:
        raise KeyboardInterrupt
    expected = (*case.criteria, *([EVENTS] if case.events else []))
    criteria = tuple(_measured(item, trajectory, system) for item in expected)
    return CaseResult(
        *about,
        passed=trajectory.status == RunStatus.COMPLETED and all(item.passed for item in criteria),
        status=trajectory.status,
        message=trajectory.message,
        criteria=criteria,
        events=tuple(trajectory.events),
        statistics=trajectory.statistics,
        wall_time_s=trajectory.statistics["wall_time_s"],
        history=_history(trajectory),
        scene=text,
    )


def _measured(criterion: Criterion, trajectory: Trajectory, system: System) -> CriterionResult:
    about = (criterion.quantity, float(criterion.bound), criterion.unit)
    result = partial(CriterionResult, *about, channel=criterion.channel)
    try:
        value = float(criterion.measure(trajectory, system))
    except Exception as error:  # a run that broke off may lack what is measured
        return result(None, False, error_text(error))
    if not math.isfinite(value):
        return result(None, False, f"measured {value}")
    return result(value, value <= criterion.bound)


def _history(trajectory: Trajectory) -> dict[str, list[float | None]]:
    """The course of what judges a run, in a few points that keep every peak."""
    recorded = {key: name for key, name in HISTORY.items() if name in trajectory.channels}
    if not len(trajectory):
        return {}
    start = trajectory.energy_at_start

    def combine(kinetic, potential, work, *others) -> np.ndarray:
        return np.column_stack([energy_balance(kinetic, potential, work, start), *others])

    time_, values = decimate(
        trajectory, [*ENERGIES, *recorded.values()], combine, points=HISTORY_POINTS
    )
    series = zip(("energy_balance", *recorded), values.T, strict=True)
    return {"time": plain(time_), **{key: plain(column) for key, column in series}}
