"""Executors: jobs run in this process, in processes on this computer, or on a Dask cluster.

Every executor takes an iterator of jobs, groups them into batches that take about the same time,
and yields the records of finished runs in any order.  A lost batch is repeated, so batches are kept
short; sending one costs some milliseconds, so they are not too short either.  Batches become
shorter towards the end, so that all workers finish at about the same time.

Runs survive a worker that dies.  The jobs that it may have had are repeated one by one when all
others are done, and those that are lost again each alone, unless the pool knows which job it was.
A run whose workers die every time gives a record with status "failed".
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import contextmanager, suppress
from functools import cache
from itertools import islice
from pickle import PicklingError
from queue import Empty
from typing import TYPE_CHECKING, Any, Protocol

from multiarm.errors import MultiarmError, SweepError
from multiarm.integration.time_loop import advance
from multiarm.sweeps.plan import Job, Record
from multiarm.sweeps.worker import JobContext, run_jobs, warm_up

if TYPE_CHECKING:
    from distributed import Client

__all__ = [
    "Batches",
    "connected",
    "run_in_process",
    "run_in_processes",
    "run_on_cluster",
]

AHEAD = 2
"""Batches for each worker: one runs, the next one waits."""


class Pool(Protocol):
    """Workers that carry out batches of jobs."""

    deaths: int
    """Workers that a job has killed when it is given up."""
    knows_killers: bool
    """Whether a batch is lost only if its own jobs kill workers."""

    def size(self) -> int:
        """Number of workers at present."""

    def submit(self, context: JobContext, batch: list[Job]) -> Future:
        """Begin a batch as soon as a worker is free."""

    def records(self, future: Future) -> list[Record] | None:
        """The records of a batch that has ended; None if its worker died."""

    def stop(self) -> None:
        """Give up all batches that have not ended."""


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
    """Run jobs in processes on this computer; ``count`` is the number of jobs."""
    if not advance.is_cached():
        warm_up(context)  # else every worker would compile the kernels for itself
    yield from _run_in_pool(context, jobs, _Processes(workers), count)


def run_on_cluster(
    context: JobContext, jobs: Iterable[Job], client: Client, count: int | None = None
) -> Iterator[list[Record]]:
    """Run jobs on the workers of a Dask cluster; ``count`` is the number of jobs.

    Raises
    ------
    SweepError
        When the cluster has no workers or is lost, or a worker cannot run the jobs.
    """
    yield from _run_in_pool(context, jobs, _Cluster(client), count)


def _run_in_pool(
    context: JobContext, jobs: Iterable[Job], pool: Pool, count: int | None
) -> Iterator[list[Record]]:
    batches = Batches(jobs, count)
    lost: list[Job] = []
    for records in _carried_out(context, batches, pool, lost):
        batches.learn(records)
        batches.workers = pool.size()
        yield records
    suspects: list[Job] = []
    yield from _carried_out(context, ([job] for job in lost), pool, suspects)
    for job in suspects:
        killers = [job] if pool.knows_killers else []
        if not killers:
            yield from _carried_out(context, iter([[job]]), pool, killers)
        if killers:
            yield [_record_of_lost_run(context, job, pool.deaths)]


def _carried_out(
    context: JobContext, batches: Iterator[list[Job]], pool: Pool, lost: list[Job]
) -> Iterator[list[Record]]:
    """Records as batches end; ``lost`` receives the jobs whose workers died."""
    pending: dict[Future, list[Job]] = {}
    try:
        while True:
            for batch in islice(batches, max(0, AHEAD * pool.size() - len(pending))):
                pending[pool.submit(context, batch)] = batch
            if not pending:
                return
            records: list[Record] = []
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                batch, found = pending.pop(future), pool.records(future)
                if found is None:
                    lost += batch
                else:
                    records += found
            if records:
                yield records
    finally:
        if pending:
            pool.stop()


def _record_of_lost_run(context: JobContext, job: Job, deaths: int) -> Record:
    message = (
        f"its worker died {deaths} times: the process was ended, by lack of memory perhaps, or "
        "broke down in compiled code"
    )
    nothing = dict.fromkeys([own.name for own in context.quantities])
    return Record(job.run, "failed", message, job.values, nothing, 0.0, "")


TARGET = 0.5
"""[s] that a batch takes."""
MOST_JOBS = 256
"""In a batch."""
ROUNDS = 4
"""Batches left for each worker, at least, while there are enough jobs."""


class Batches:
    """Jobs in batches, made on demand; ``count`` is how many jobs there are, if it is known.

    Attributes
    ----------
    workers : int
        That share the batches.
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


# --- processes ------------------------------------------------------------------------------------


class _Processes:
    """Processes on this computer (loky, of joblib).  One that dies takes the others with it."""

    deaths, knows_killers = 3, False

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def size(self) -> int:
        return self._workers

    def submit(self, context: JobContext, batch: list[Job]) -> Future:
        while True:
            try:
                return self._executor().submit(_run_in_worker, context, batch, os.getpid())
            except BrokenExecutor:
                pass  # just now: the next executor is another one

    def records(self, future: Future) -> list[Record] | None:
        try:
            return future.result()
        except BrokenExecutor:
            return None
        except PicklingError as error:
            raise SweepError(
                f"the workers cannot be given the work: {type(error).__name__}: {error}; put "
                "functions into a module, or name them as 'file.py:name'"
            ) from error

    def stop(self) -> None:
        executor = self._executor()
        with suppress(Empty):  # work that waits for a process would let the shutdown fail
            while True:
                executor._work_ids.get_nowait()
        executor.shutdown(kill_workers=True)

    def _executor(self) -> Any:
        """The processes of an earlier call if they are alive, else new ones."""
        from joblib.externals.loky import get_reusable_executor

        return get_reusable_executor(self._workers, timeout=300.0)  # [s] that idle ones stay


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


# --- a cluster ------------------------------------------------------------------------------------

PATIENCE = 30.0
"""[s] to wait for the scheduler, and for its first worker."""
SIZE_POLL = 2.0
"""[s] between two queries of the cluster's size: it may grow and shrink."""


@contextmanager
def connected(cluster: Any) -> Iterator[Client]:
    """A client of a cluster as :func:`multiarm.sweep` takes it; closed here unless it was given.

    Raises
    ------
    SweepError
        When Dask is not installed, or no scheduler answers.
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


class _Cluster:
    """The workers of a Dask cluster, which repeats a batch on others before it gives it up."""

    deaths, knows_killers = 0, True

    def __init__(self, client: Client) -> None:
        self._client = client
        self._tasks: set[Any] = set()
        self._size, self._polled = 0, 0.0
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            raise SweepError(
                f"dask: the cluster has no workers, after {PATIENCE:g} s; start some: "
                f"dask worker {client.scheduler.address}"  # type: ignore[union-attr]
            ) from None

    def size(self) -> int:
        now = time.monotonic()
        if now >= self._polled + SIZE_POLL or not self._size:
            threads = self._client.nthreads()
            self._size, self._polled = max(1, sum(threads.values())), now
        return self._size

    def submit(self, context: JobContext, batch: list[Job]) -> Future:
        task = self._client.submit(run_jobs, context, batch, pure=False)
        self._tasks.add(task)
        ended: Future = Future()
        task.add_done_callback(ended.set_result)  # also of one that failed or was lost
        return ended

    def records(self, future: Future) -> list[Record] | None:
        from distributed import KilledWorker

        task = future.result()
        self._tasks.remove(task)
        if task.status == "finished":
            return task.result()
        if task.status != "error":
            raise SweepError(
                "dask: the connection with the cluster was lost; what is done is kept, resume the "
                "sweep when the cluster is back"
            )
        error = task.exception()
        if isinstance(error, KilledWorker):
            self.deaths = error.allowed_failures + 1
            return None
        if isinstance(error, MultiarmError):
            raise error
        raise SweepError(
            f"dask: a worker cannot do the work: {type(error).__name__}: {error}; it needs the "
            "same Python packages as this process, multiarm among them"
        ) from error

    def stop(self) -> None:
        self._client.cancel(list(self._tasks), force=True)
