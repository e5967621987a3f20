"""Runs on workers: in processes on this computer, or on a Dask cluster.

A worker that dies takes the runs with it that were under way.  On this computer all processes end
then; half of the runs that were under way are tried again at a time, which leaves in few steps the
one that kills its worker alone.  Alone it is tried twice: it may never have begun before, and its
worker may have died of something else, such as a lack of memory that others caused.  Dask repeats
runs by itself, and names those that workers died of, which are tried once more.
A run whose worker dies every time gets a row with status "failed".
"""

from __future__ import annotations

import asyncio
import os
import threading
import time
import warnings
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from itertools import islice
from typing import TYPE_CHECKING, Any

from multiarm.errors import MultiarmError, SweepError
from multiarm.integration.time_loop import advance
from multiarm.simulation.interrupts import deferred_interrupt
from multiarm.sweeps.run import Context, Row, lost_run, prepare, run

if TYPE_CHECKING:
    from distributed import Client

Job = tuple[int, dict[str, Any]]
"""Number of a run, and its values."""
IDLE = 10.0
"""[s] after which a process without work ends."""
TRIES_ALONE = 2
"""Deaths of the worker of a run that is alone after which the run is lost."""
PATIENCE = 30.0
"""[s] to wait for the scheduler of a cluster, and for its first worker."""
# two classes in Python 3.10
TIMEOUTS = (TimeoutError, asyncio.TimeoutError)


def run_here(context: Context, jobs: Sequence[Job]) -> Iterator[Row]:
    """Carry out runs in this process, one after the other.

    Ctrl-C ends the run that is under way, or the runs before the next one begins: raised wherever
    the program happens to be, it is lost where that is the callback of a weak reference.
    """
    with deferred_interrupt() as interrupt:
        for job in jobs:
            interrupt.deliver()
            yield run(context, *job)
        interrupt.deliver()


def run_in_processes(context: Context, jobs: Sequence[Job], workers: int) -> Iterator[Row]:
    """Carry out runs in processes on this computer; rows come as runs end."""
    if not advance.is_cached():
        prepare(context)  # else every worker would compile the kernels for itself
    waiting = iter(jobs)
    while suspects := (yield from _until_a_worker_dies(context, waiting, workers)):
        yield from _tried_again(context, suspects, workers)


def _tried_again(context: Context, suspects: Sequence[Job], workers: int) -> Iterator[Row]:
    """Rows of runs that were under way when a worker died, of which half are tried at a time."""
    if len(suspects) == 1:
        yield from _tried_alone(context, suspects[0], workers)
        return
    middle = len(suspects) // 2
    for half in (suspects[:middle], suspects[middle:]):
        waiting = iter(half)
        while fewer := (yield from _until_a_worker_dies(context, waiting, workers)):
            yield from _tried_again(context, fewer, workers)


def _tried_alone(context: Context, job: Job, workers: int) -> Iterator[Row]:
    """The row of a run that is tried with no other under way."""
    for _ in range(TRIES_ALONE):
        if not (yield from _until_a_worker_dies(context, iter([job]), workers)):
            return
    yield lost_run(job[0])


def _until_a_worker_dies(
    context: Context, jobs: Iterator[Job], workers: int
) -> Generator[Row, None, list[Job]]:
    """Rows as runs end; returns the runs that were under way when a worker died."""
    from joblib import Parallel, delayed

    under_way: dict[int, Job] = {}

    def tasks() -> Iterator[Any]:
        for job in jobs:
            under_way[job[0]] = job
            yield delayed(_run_for)(os.getpid(), context, *job)

    # joblib takes this process where there is one worker
    parallel = Parallel(
        max(2, workers), "loky", return_as="generator_unordered", idle_worker_timeout=IDLE
    )
    rows: Generator[Row, None, None] = parallel(tasks())
    try:
        with warnings.catch_warnings():
            # It warns of a process that ended for lack of work as work came, and starts another.
            # An error would end the thread that serves the processes: the sweep would never end.
            warnings.filterwarnings("ignore", "A worker stopped while some jobs were given")
            for row in rows:
                del under_way[row["run"]]
                yield row
    except Exception as error:
        if isinstance(error, BrokenProcessPool) and error.__cause__ is None:
            return [*under_way.values()]  # with a cause, a task or its result could not be sent
        raise _explained(error) from error
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about runs that are given up
            rows.close()
    return []


def _run_for(caller: int, context: Context, number: int, values: dict[str, Any]) -> Row:
    """Carry out a run in a process of a caller's."""
    _end_with(caller)
    return run(context, number, values)


@cache
def _end_with(caller: int) -> None:
    """End this process soon after its caller has ended, even if the caller was killed."""

    def watch() -> None:
        while os.getppid() == caller:
            time.sleep(1.0)  # [s]
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def run_on_cluster(context: Context, jobs: Sequence[Job], client: Client) -> Iterator[Row]:
    """Carry out runs on the workers of a Dask cluster; rows come as runs end.

    Dask's own client, as joblib would wait for ever for a run that workers die of.

    Raises
    ------
    SweepError
        When the cluster has no workers or is lost, or a worker cannot carry out the runs.
    """
    from distributed import KilledWorker, as_completed

    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TIMEOUTS:
        raise SweepError(
            f"dask: the cluster has no workers, after {PATIENCE:g} s; start some: "
            f"dask worker {client.scheduler.address}"  # type: ignore[union-attr]
        ) from None
    waiting, sent, ended = iter(jobs), {}, as_completed(loop=client.loop)
    suspects: set[int] = set()

    def send(jobs: Iterable[Job]) -> None:
        for job in jobs:
            task = client.submit(run, context, *job, pure=False)
            sent[task] = job
            ended.add(task)

    try:
        send(islice(waiting, 2 * sum(client.nthreads().values())))
        for task in ended:
            job = sent.pop(task)
            error = task.exception() if task.status == "error" else None
            if isinstance(error, KilledWorker) and job[0] not in suspects:
                suspects.add(job[0])  # it may have waited behind one that workers die of
                send([job])
                continue
            if task.status == "finished":
                yield task.result()
            elif isinstance(error, KilledWorker):
                yield lost_run(job[0])
            elif error is not None:
                raise _explained(error)
            else:
                raise SweepError(
                    "dask: the connection with the cluster was lost; what is done is kept: resume "
                    "the sweep when the cluster is back"
                )
            send(islice(waiting, 1))
    finally:
        client.cancel(list(sent), force=True)


def _explained(error: BaseException) -> Exception:
    """The error to raise in place of one from a worker or from a library."""
    if isinstance(error, MultiarmError):
        return error
    return SweepError(
        f"a worker cannot do the work: {_reason(error)}; it needs the same Python "
        "packages as this process, multiarm among them, and functions that it can load: put them "
        "into a module, or name them as 'file.py:name'. What is done is kept: resume the sweep"
    )


def _reason(error: BaseException) -> str:
    if isinstance(error, BrokenProcessPool) and error.__cause__ is not None:
        # a worker cannot load a task: the last line of its traceback
        return str(error.__cause__).strip('"\n').rpartition("\n")[2]
    return f"{type(error).__name__}: {error}"


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
    except (*TIMEOUTS, OSError, ValueError, RuntimeError) as error:
        raise SweepError(f"dask: no scheduler answers at {address!r}: {error}") from error
    try:
        yield client
    finally:
        client.close()
