"""Who carries out the runs: this process, processes on this computer, or a cluster.

All take an iterator of jobs, ask it for a few at a time, and give rows as runs end, in any order.
Runs on processes of their own survive a worker that dies: what it had is done again, at first run
by run, then each run alone.  A run whose workers die every time is a row that says so.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Iterable, Iterator
from functools import cache
from pickle import PicklingError
from typing import Any

from multiarm.errors import SweepError
from multiarm.integration.time_loop import advance
from multiarm.sweeps.batches import Batches
from multiarm.sweeps.row import Row
from multiarm.sweeps.work import Job, Work, perform_all, warm

__all__ = ["DEATHS", "dead_row", "in_process", "on_processes", "processors"]

DEATHS = 3
"""Workers that may die on a run."""
LOOK = 1.0
"""[s] between two looks of a worker whether its caller is still there."""


def in_process(work: Work, jobs: Iterable[Job]) -> Iterator[list[Row]]:
    """Rows of runs that are carried out here, one after the other."""
    batches = Batches(jobs)
    for batch in batches:
        rows = perform_all(work, batch)
        batches.learn(rows)
        yield rows


def on_processes(
    work: Work, jobs: Iterable[Job], workers: int, count: int | None = None
) -> Iterator[list[Row]]:
    """Rows of runs that are carried out by processes on this computer (joblib, loky).

    Parameters
    ----------
    work : Work
    jobs : iterable of Job
        May be asked by another thread.
    workers : int
    count : int, optional
        Of the jobs.
    """
    if not advance.is_cached():
        warm(work)  # else every worker would compile the kernels for itself
    batches = Batches(jobs, count)
    batches.workers = workers
    while True:
        lost: list[Job] = []
        for rows in _until_death(work, batches, workers, lost):
            batches.learn(rows)
            yield rows
        if not lost:
            return
        yield from _one_by_one(work, lost, workers)


def processors() -> int:
    """How many processes this one may keep busy."""
    from joblib import cpu_count

    return cpu_count()


def dead_row(work: Work, job: Job, deaths: int) -> Row:
    """The row of a run on which workers die."""
    message = (
        f"its worker died {deaths} times: the process was ended, by lack of memory perhaps, or "
        "broke down in compiled code"
    )
    nothing = dict.fromkeys([own.name for own in work.quantities])
    return Row(job.run, "failed", message, job.values, nothing, 0.0, "")


def _one_by_one(work: Work, jobs: list[Job], workers: int) -> Iterator[list[Row]]:
    """Do lost runs again, side by side, and those that are lost once more each alone."""
    singles = ([job] for job in jobs)
    while True:
        lost: list[Job] = []
        yield from _until_death(work, singles, workers, lost)
        if not lost:
            return
        for job in lost:
            yield from _alone(work, job, workers)


def _alone(work: Work, job: Job, workers: int) -> Iterator[list[Row]]:
    """Do a run that was lost twice again, with no other at the same time."""
    for _ in range(DEATHS - 2):
        lost: list[Job] = []
        yield from _until_death(work, iter([[job]]), workers, lost)
        if not lost:
            return
    yield [dead_row(work, job, DEATHS)]


def _until_death(
    work: Work, batches: Iterator[list[Job]], workers: int, lost: list[Job]
) -> Iterator[list[Row]]:
    """Rows, until batches end or a worker dies; ``lost`` is then what was under way."""
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import BrokenProcessPool

    out: dict[int, Job] = {}

    def handed_out() -> Iterator[Any]:
        for batch in batches:
            out.update((job.run, job) for job in batch)
            yield delayed(_perform_there)(work, batch, os.getpid())

    pool = Parallel(
        n_jobs=max(2, workers),  # with one, joblib would take this process
        backend="loky",
        return_as="generator_unordered",
        batch_size=1,
        pre_dispatch="2 * n_jobs",
        max_nbytes=None,
    )
    results = pool(handed_out())
    try:
        for rows in results:
            for row in rows:
                del out[row.run]
            yield rows
    except BrokenProcessPool:
        lost += out.values()
    except PicklingError as error:
        raise SweepError(_unsendable(error)) from error
    finally:
        with warnings.catch_warnings():
            # whoever ends a sweep early knows that there is more to do
            warnings.filterwarnings("ignore", "[0-9]+ tasks ", UserWarning)
            results.close()


def _unsendable(error: Exception) -> str:
    return (
        f"the workers cannot be given the work: {type(error).__name__}: {error}; put functions "
        "into a module, or name them as 'file.py:name'"
    )


def _perform_there(work: Work, jobs: list[Job], caller: int) -> list[Row]:
    """What a worker process does.  Ctrl-C reaches it too; only the caller acts on it."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with(caller)
    return perform_all(work, jobs)


@cache
def _end_with(caller: int) -> None:
    """Let this process end soon after the one that began it, even if that was killed."""

    def watch() -> None:
        while os.getppid() == caller:
            time.sleep(LOOK)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
