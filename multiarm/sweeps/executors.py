"""Runs on workers: in this process, in processes on this computer, or on a Dask cluster.

joblib and Dask carry them out, in chunks that take about the same time: a chunk is stored, or lost,
as a whole, and sending one costs some milliseconds.  Chunks become shorter towards the end, so that
all workers finish together.

A worker that dies takes the runs with it that were under way.  On this computer all processes end
then; the runs are tried again, as many at a time as there are workers, and those that are lost once
more each alone.  Dask repeats a chunk by itself, and names one that workers die of; its runs are
tried one by one.  A run whose worker dies every time gets a row with status "failed".
"""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from functools import cache
from itertools import islice
from pickle import PicklingError
from typing import TYPE_CHECKING, Any

from multiarm.errors import MultiarmError, SweepError
from multiarm.integration.time_loop import advance
from multiarm.sweeps.run import Context, Row, lost_run, prepare, run

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["connected", "run_here", "run_in_processes", "run_on_cluster"]

Job = tuple[int, dict[str, Any]]
"""Number of a run, and its values."""
CHUNK_TIME = 0.5
"""[s] that a chunk takes."""
MOST_JOBS = 256
"""In a chunk."""
CHUNKS_LEFT = 4
"""Chunks left for each worker, at least, while there are enough jobs."""


def run_here(context: Context, jobs: Sequence[Job]) -> Iterator[list[Row]]:
    """Carry out runs in this process, one after the other."""
    chunks = Chunks(jobs, workers=1)
    for chunk in chunks:
        rows = [run(context, *job) for job in chunk]
        chunks.learn(rows)
        yield rows


def run_in_processes(context: Context, jobs: Sequence[Job], workers: int) -> Iterator[list[Row]]:
    """Carry out runs in processes on this computer."""
    if not advance.is_cached():
        prepare(context)  # else every worker would compile the kernels for itself
    chunks = Chunks(jobs, workers)
    while lost := (yield from _until_a_worker_dies(context, chunks, workers, 2 * workers)):
        singles = ([job] for job in lost)
        while suspects := (yield from _until_a_worker_dies(context, singles, workers, workers)):
            for job in suspects:
                if (yield from _until_a_worker_dies(context, iter([[job]]), workers, 1)):
                    yield [lost_run(context, job[0])]


def _until_a_worker_dies(
    context: Context, chunks: Iterator[list[Job]], workers: int, at_once: int
) -> Generator[list[Row], None, list[Job]]:
    """Rows as chunks end; returns the runs that were under way when a worker died."""
    from joblib import Parallel, delayed

    under_way: dict[int, Job] = {}

    def tasks() -> Iterator[Any]:
        for chunk in chunks:
            under_way.update((job[0], job) for job in chunk)
            yield delayed(_run_in_worker)(context, chunk, os.getpid())

    # joblib takes this process where there is one worker
    parallel = Parallel(
        max(2, workers), return_as="generator_unordered", batch_size=1, pre_dispatch=at_once
    )
    ended: Iterator[list[Row]] = iter(())
    try:
        ended = parallel(tasks())
        for rows in ended:
            for row in rows:
                del under_way[row.run]
            if isinstance(chunks, Chunks):
                chunks.learn(rows)
            yield rows
    except BrokenExecutor:
        return [*under_way.values()]
    except Exception as error:
        raise _explained(error) from error
    finally:
        if isinstance(ended, Generator):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about runs that are given up
                ended.close()
    return []


def run_on_cluster(context: Context, jobs: Sequence[Job], client: Client) -> Iterator[list[Row]]:
    """Carry out runs on the workers of a Dask cluster.

    Raises
    ------
    SweepError
        When the cluster has no workers or is lost, or a worker cannot carry out the runs.
    """
    from distributed import KilledWorker, as_completed

    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        raise SweepError(
            f"dask: the cluster has no workers, after {PATIENCE:g} s; start some: "
            f"dask worker {client.scheduler.address}"  # type: ignore[union-attr]
        ) from None
    workers = sum(client.nthreads().values())
    chunks, sent, ended = Chunks(jobs, workers), {}, as_completed(loop=client.loop)

    def send(chunk: list[Job]) -> None:
        task = client.submit(_run_in_worker, context, chunk, os.getpid(), pure=False)
        sent[task] = chunk
        ended.add(task)

    try:
        for chunk in islice(chunks, 2 * workers):
            send(chunk)
        for task in ended:
            chunk = sent.pop(task)
            error = task.exception() if task.status == "error" else None
            if task.status == "finished":
                rows = task.result()
                chunks.learn(rows)
                yield rows
            elif isinstance(error, KilledWorker) and len(chunk) > 1:
                for job in chunk:
                    send([job])
                continue
            elif isinstance(error, KilledWorker):
                yield [lost_run(context, chunk[0][0])]
            elif error is not None:
                raise _explained(error)
            else:
                raise SweepError(
                    "dask: the connection with the cluster was lost; what is done is kept: resume "
                    "the sweep when the cluster is back"
                )
            for following in islice(chunks, 1):
                send(following)
    finally:
        client.cancel(list(sent), force=True)


class Chunks:
    """Jobs in chunks of about ``CHUNK_TIME`` that several workers share."""

    def __init__(self, jobs: Sequence[Job], workers: int) -> None:
        self._jobs, self._workers, self._next = jobs, workers, 0
        self._runs, self._spent = 0, 0.0

    def __iter__(self) -> Iterator[list[Job]]:
        return self

    def __next__(self) -> list[Job]:
        chunk = list(self._jobs[self._next : self._next + self.size])
        if not chunk:
            raise StopIteration
        self._next += len(chunk)
        return chunk

    @property
    def size(self) -> int:
        """Jobs of the next chunk: one, until the time of a run has been measured."""
        if self._spent <= 0.0:
            return 1
        left = len(self._jobs) - self._next
        most = min(MOST_JOBS, left // (CHUNKS_LEFT * self._workers))
        return max(1, min(most, int(CHUNK_TIME * self._runs / self._spent)))

    def learn(self, rows: Sequence[Row]) -> None:
        """Update the mean time of a run."""
        self._runs += len(rows)
        self._spent += sum(row.wall_time for row in rows)


def _explained(error: Exception) -> Exception:
    """The error to raise in place of one from a worker or from joblib."""
    if isinstance(error, MultiarmError):
        return error
    if isinstance(error, (PicklingError, TypeError, AttributeError)):
        return SweepError(
            f"the workers cannot be given the work: {type(error).__name__}: {error}; put "
            "functions into a module, or name them as 'file.py:name'"
        )
    return SweepError(
        f"a worker cannot do the work: {type(error).__name__}: {error}; it needs the same Python "
        "packages as this process, multiarm among them. What is done is kept: resume the sweep"
    )


def _run_in_worker(context: Context, jobs: Sequence[Job], caller: int) -> list[Row]:
    """Carry out runs in another process.  Ctrl-C may reach it, but only the caller acts on it."""
    if os.getpid() != caller and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if os.getppid() == caller:
            _end_with(caller)
    return [run(context, *job) for job in jobs]


@cache
def _end_with(caller: int) -> None:
    """End this process soon after its caller has ended, even if the caller was killed."""

    def watch() -> None:
        while os.getppid() == caller:
            time.sleep(1.0)  # [s]
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


PATIENCE = 30.0
"""[s] to wait for the scheduler of a cluster, and for its first worker."""


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
