"""Runs on a Dask cluster: the same work, on whatever workers its scheduler has.

Dask itself does a batch again, on another worker, when the one that had it has died; a batch that
has seen several die is done run by run, so that only the run that is to blame fails.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from multiarm.errors import MultiarmError, SweepError
from multiarm.sweeps.batches import Batches
from multiarm.sweeps.engines import dead_row
from multiarm.sweeps.row import Row
from multiarm.sweeps.work import Job, Work, perform_all

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["on_cluster", "opened"]

PATIENCE = 30.0
"""[s] to wait for the scheduler, and for its first worker."""
AHEAD = 2
"""Batches for each thread of the cluster: one is carried out, the next one waits beside it."""
LOOK = 2.0
"""[s] between two looks at how large the cluster is: it may grow and shrink."""


@contextmanager
def opened(cluster: Any) -> Iterator[Client]:
    """A client of a cluster, closed in the end unless it was given.

    Parameters
    ----------
    cluster : str, True or distributed.Client
        Address of a scheduler; True: the one in Dask's configuration (``DASK_SCHEDULER_ADDRESS``).

    Raises
    ------
    SweepError
        When Dask is not installed, nobody answers, or the cluster has no workers.
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


def on_cluster(
    work: Work, jobs: Iterable[Job], client: Client, count: int | None = None
) -> Iterator[list[Row]]:
    """Rows of runs that are carried out by the workers of a cluster.

    Parameters
    ----------
    work : Work
    jobs : iterable of Job
    client : distributed.Client
    count : int, optional
        Of the jobs.

    Raises
    ------
    SweepError
        When the cluster has no workers, is lost, or its workers cannot do the work.
    """
    _wait_for_workers(client)
    batches = Batches(jobs, count)
    crew = _Crew(work, client)
    try:
        for rows in crew.rows(batches):
            batches.learn(rows)
            batches.workers = crew.threads
            yield rows
        yield from crew.rows([job] for job in crew.take_lost())
        for job in crew.take_lost():
            yield [dead_row(work, job, crew.deaths)]
    finally:
        crew.dismiss()


def _wait_for_workers(client: Client) -> None:
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        raise SweepError(
            f"dask: the cluster has no workers, after {PATIENCE:g} s; start some: "
            f"dask worker {client.scheduler.address}"  # type: ignore[union-attr]
        ) from None


class _Crew:
    """The workers of a cluster, and the batches that are with them."""

    def __init__(self, work: Work, client: Client) -> None:
        self._work, self._client = work, client
        self._out: dict[Any, tuple[Future, list[Job]]] = {}
        self._lost: deque[Job] = deque()
        self.threads, self._looked = 0, 0.0
        self.deaths = 0

    def rows(self, batches: Iterable[list[Job]]) -> Iterator[list[Row]]:
        """Rows as batches end; jobs whose workers died are kept aside."""
        from distributed import as_completed

        waiting = iter(batches)
        coming = as_completed(loop=self._client.loop, raise_errors=False)
        self._hand_out(waiting, coming)
        for future in coming:
            rows = self._back(future)
            self._hand_out(waiting, coming)
            if rows:
                yield rows

    def take_lost(self) -> list[Job]:
        """The jobs that were kept aside."""
        lost = list(self._lost)
        self._lost.clear()
        return lost

    def dismiss(self) -> None:
        """Let go of all that is under way."""
        self._client.cancel([future for future, _ in self._out.values()], force=True)
        self._out.clear()

    def _hand_out(self, waiting: Iterator[list[Job]], coming: Any) -> None:
        while len(self._out) < self._room():
            batch = next(waiting, None)
            if batch is None:
                return
            future = self._client.submit(perform_all, self._work, batch, pure=False)
            self._out[future.key] = future, batch
            coming.add(future)

    def _room(self) -> int:
        """Batches that may be under way."""
        now = time.monotonic()
        if now >= self._looked + LOOK or not self.threads:
            threads = self._client.nthreads()
            self.threads, self._looked = max(1, sum(threads.values())), now
        return AHEAD * self.threads

    def _back(self, future: Future) -> list[Row]:
        """The rows of a batch that ended; none of one that was lost."""
        from distributed import KilledWorker

        _, batch = self._out.pop(future.key)
        if future.status == "finished":
            return future.result()
        if future.status != "error":
            raise SweepError(
                "dask: the connection with the cluster was lost; what is done is kept, go on with "
                "it when the cluster is back"
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
