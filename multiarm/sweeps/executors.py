"""Executors: jobs run in this process, in processes on this computer, or on a Dask cluster.

Every executor takes an iterator of jobs, groups them into batches that take about the same time,
and yields the records of finished runs in any order.  A lost batch is repeated, so batches are kept
short; sending one costs some milliseconds, so they are not too short either.  Batches become
shorter towards the end, so that all workers finish at about the same time.

Runs survive a worker that dies.  With local processes, the jobs it had are repeated one by one, and
then each alone.  Dask repeats a lost batch on another worker; a batch that has lost several workers
is repeated job by job, so that only the job that kills its worker fails.  A run whose workers die
every time gives a record with status "failed".
"""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from itertools import islice
from pickle import PicklingError
from typing import TYPE_CHECKING, Any

from multiarm.errors import MultiarmError, SweepError
from multiarm.integration.time_loop import advance
from multiarm.sweeps.records import Record
from multiarm.sweeps.worker import Job, JobContext, run_jobs, warm_up

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = [
    "DEATHS",
    "Batches",
    "connected",
    "processors",
    "record_of_lost_run",
    "run_in_process",
    "run_in_processes",
    "run_on_cluster",
]


DEATHS = 3
"""Workers that may die on a run."""


def run_in_process(context: JobContext, jobs: Iterable[Job]) -> Iterator[list[Record]]:
    """Run jobs in this process, one after the other."""
    batches = Batches(jobs)
    for batch in batches:
        records = run_jobs(context, batch)
        batches.learn(records)
        yield records


def run_in_processes(
    context: JobContext, jobs: Iterable[Job], workers: int, count: int | None = None
) -> Iterator[list[Record]]:
    """Run jobs in processes on this computer (joblib, loky).

    Parameters
    ----------
    context : JobContext
    jobs : iterable of Job
        May be iterated in another thread.
    workers : int
    count : int, optional
        Of the jobs.
    """
    if not advance.is_cached():
        warm_up(context)  # else every worker would compile the kernels for itself
    batches = Batches(jobs, count)
    batches.workers = workers
    while True:
        lost: list[Job] = []
        for records in _until_death(context, batches, workers, lost):
            batches.learn(records)
            yield records
        if not lost:
            return
        yield from _one_by_one(context, lost, workers)


def processors() -> int:
    """Number of processors that this process may use."""
    from joblib import cpu_count

    return cpu_count()


def record_of_lost_run(context: JobContext, job: Job, deaths: int) -> Record:
    """The record of a run on which workers die."""
    message = (
        f"its worker died {deaths} times: the process was ended, by lack of memory perhaps, or "
        "broke down in compiled code"
    )
    nothing = dict.fromkeys([own.name for own in context.quantities])
    return Record(job.run, "failed", message, job.values, nothing, 0.0, "")


def _one_by_one(context: JobContext, jobs: list[Job], workers: int) -> Iterator[list[Record]]:
    """Repeat lost jobs in parallel, one in a batch; repeat those that are lost again alone."""
    singles = ([job] for job in jobs)
    while True:
        lost: list[Job] = []
        yield from _until_death(context, singles, workers, lost)
        if not lost:
            return
        for job in lost:
            yield from _alone(context, job, workers)


def _alone(context: JobContext, job: Job, workers: int) -> Iterator[list[Record]]:
    """Repeat a job that was lost twice, with no other at the same time."""
    for _ in range(DEATHS - 2):
        lost: list[Job] = []
        yield from _until_death(context, iter([[job]]), workers, lost)
        if not lost:
            return
    yield [record_of_lost_run(context, job, DEATHS)]


def _until_death(
    context: JobContext, batches: Iterator[list[Job]], workers: int, lost: list[Job]
) -> Iterator[list[Record]]:
    """Records until the batches end or a worker dies; ``lost`` then receives the pending jobs."""
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import BrokenProcessPool

    pending: dict[int, Job] = {}

    def tasks() -> Iterator[Any]:
        for batch in batches:
            pending.update((job.run, job) for job in batch)
            yield delayed(_run_in_worker)(context, batch, os.getpid())

    pool = Parallel(
        n_jobs=max(2, workers),  # with one, joblib would take this process
        backend="loky",
        return_as="generator_unordered",
        batch_size=1,
        pre_dispatch="2 * n_jobs",
        max_nbytes=None,
    )
    results = pool(tasks())
    try:
        for records in results:
            for record in records:
                del pending[record.run]
            yield records
    except BrokenProcessPool:
        lost += pending.values()
    except PicklingError as error:
        raise SweepError(_unsendable(error)) from error
    finally:
        with warnings.catch_warnings():
            # joblib warns of tasks that were not finished: a caller who stops early knows
            warnings.filterwarnings("ignore", "[0-9]+ tasks ", UserWarning)
            results.close()


def _unsendable(error: Exception) -> str:
    return (
        f"the workers cannot be given the work: {type(error).__name__}: {error}; put functions "
        "into a module, or name them as 'file.py:name'"
    )


def _run_in_worker(context: JobContext, jobs: list[Job], caller: int) -> list[Record]:
    """Run jobs in a worker process.  Ctrl-C reaches it too, but only the caller acts on it."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with(caller)
    return run_jobs(context, jobs)


@cache
def _end_with(caller: int) -> None:
    """End this process soon after its caller has ended, even if the caller was killed."""

    def watch() -> None:
        while os.getppid() == caller:
            time.sleep(1.0)  # [s]
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


TARGET = 0.5
"""[s] that a batch takes."""
MOST_JOBS = 256
"""In a batch."""
ROUNDS = 4
"""Batches left for each worker, at least, while there are enough jobs."""


class Batches:
    """Jobs in batches, made on demand.

    Attributes
    ----------
    workers : int
        That share the batches.

    Parameters
    ----------
    jobs : iterable of Job
    count : int, optional
        How many jobs there are.
    """

    def __init__(self, jobs: Iterable[Job], count: int | None = None) -> None:
        self.workers = 1
        self._jobs, self._left = iter(jobs), count
        self._runs, self._spent = 0, 0.0

    def __iter__(self) -> Iterator[list[Job]]:
        return self

    def __next__(self) -> list[Job]:
        batch = list(islice(self._jobs, self.size))
        if not batch:
            raise StopIteration
        if self._left is not None:
            self._left -= len(batch)
        return batch

    @property
    def size(self) -> int:
        """Jobs of the next batch: one, until the time of a run has been measured."""
        if self._spent <= 0.0:
            return 1
        most = MOST_JOBS
        if self._left is not None:
            most = min(most, self._left // (ROUNDS * self.workers))
        return max(1, min(most, int(TARGET * self._runs / self._spent)))

    def learn(self, records: Iterable[Record]) -> None:
        """Update the mean time of a run."""
        for record in records:
            self._runs, self._spent = self._runs + 1, self._spent + record.wall_time


PATIENCE = 30.0
"""[s] to wait for the scheduler, and for its first worker."""
AHEAD = 2
"""Batches for each thread of the cluster: one runs, the next one waits."""
SIZE_POLL = 2.0
"""[s] between two queries of the cluster's size: it may grow and shrink."""


@contextmanager
def connected(cluster: Any) -> Iterator[Client]:
    """A client of a cluster, closed in the end unless it was given.

    Parameters
    ----------
    cluster : str, True or distributed.Client
        Address of a scheduler; True: the one in Dask's configuration (``DASK_SCHEDULER_ADDRESS``).

    Raises
    ------
    SweepError
        When Dask is not installed, no scheduler answers, or the cluster has no workers.
    """
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        raise SweepError(
            f"a cluster needs Dask, which is not installed ({error}): pip install distributed"
        ) from None
    if isinstance(cluster, Client):
        yield cluster
        return
    address = dask.config.get("scheduler-address", None) if cluster is True else cluster
    if not isinstance(address, str) or not address:
        raise SweepError(
            "dask: no scheduler is named; give its address, such as 'tcp://10.0.0.5:8786', or set "
            "DASK_SCHEDULER_ADDRESS"
        )
    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, RuntimeError) as error:
        raise SweepError(f"dask: no scheduler answers at {address!r}: {error}") from error
    try:
        yield client
    finally:
        client.close()


def run_on_cluster(
    context: JobContext, jobs: Iterable[Job], client: Client, count: int | None = None
) -> Iterator[list[Record]]:
    """Run jobs on the workers of a Dask cluster.

    Parameters
    ----------
    context : JobContext
    jobs : iterable of Job
    client : distributed.Client
    count : int, optional
        Of the jobs.

    Raises
    ------
    SweepError
        When the cluster has no workers or is lost, or a worker cannot run the jobs.
    """
    _wait_for_workers(client)
    batches = Batches(jobs, count)
    runs = _ClusterRuns(context, client)
    try:
        for records in runs.records(batches):
            batches.learn(records)
            batches.workers = runs.threads
            yield records
        yield from runs.records([job] for job in runs.take_lost())
        for job in runs.take_lost():
            yield [record_of_lost_run(context, job, runs.deaths)]
    finally:
        runs.cancel()


def _wait_for_workers(client: Client) -> None:
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        raise SweepError(
            f"dask: the cluster has no workers, after {PATIENCE:g} s; start some: "
            f"dask worker {client.scheduler.address}"  # type: ignore[union-attr]
        ) from None


class _ClusterRuns:
    """Batches that were submitted to a cluster.

    Attributes
    ----------
    threads : int
        Of the cluster.
    deaths : int
        Workers that the cluster lost on one batch.
    """

    def __init__(self, context: JobContext, client: Client) -> None:
        self._context, self._client = context, client
        self._pending: dict[Any, tuple[Future, list[Job]]] = {}
        self._lost: deque[Job] = deque()
        self.threads, self._polled = 0, 0.0
        self.deaths = 0

    def records(self, batches: Iterable[list[Job]]) -> Iterator[list[Record]]:
        """Records as batches end; jobs whose workers died are set aside."""
        from distributed import as_completed

        waiting = iter(batches)
        submitted = as_completed(loop=self._client.loop, raise_errors=False)
        self._submit(waiting, submitted)
        for future in submitted:
            records = self._result(future)
            self._submit(waiting, submitted)
            if records:
                yield records

    def take_lost(self) -> list[Job]:
        """The jobs that were set aside."""
        lost = list(self._lost)
        self._lost.clear()
        return lost

    def cancel(self) -> None:
        """Cancel all batches that have not ended."""
        self._client.cancel([future for future, _ in self._pending.values()], force=True)
        self._pending.clear()

    def _submit(self, waiting: Iterator[list[Job]], submitted: Any) -> None:
        while len(self._pending) < self._capacity():
            batch = next(waiting, None)
            if batch is None:
                return
            future = self._client.submit(run_jobs, self._context, batch, pure=False)
            self._pending[future.key] = future, batch
            submitted.add(future)

    def _capacity(self) -> int:
        """Batches that may be submitted at a time."""
        now = time.monotonic()
        if now >= self._polled + SIZE_POLL or not self.threads:
            threads = self._client.nthreads()
            self.threads, self._polled = max(1, sum(threads.values())), now
        return AHEAD * self.threads

    def _result(self, future: Future) -> list[Record]:
        """The records of a batch that ended; none of one that was lost."""
        from distributed import KilledWorker

        _, batch = self._pending.pop(future.key)
        if future.status == "finished":
            return future.result()
        if future.status != "error":
            raise SweepError(
                "dask: the connection with the cluster was lost; what is done is kept, resume the "
                "sweep when the cluster is back"
            )
        error = future.exception()
        if isinstance(error, KilledWorker):
            self.deaths = error.allowed_failures + 1
            self._lost.extend(batch)
            return []
        if isinstance(error, MultiarmError):
            raise error
        raise SweepError(
            f"dask: a worker cannot do the work: {type(error).__name__}: {error}; it needs the "
            "same Python packages as this process, multiarm among them"
        ) from error
