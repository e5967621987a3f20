"""Runs in batches that take about the same time, however long a run takes.

A batch that is lost is done again, so that it should be short; sending one costs some milliseconds,
so that it should not be too short.  Towards the end batches become shorter, so that all workers end
at about the same time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice

from multiarm.sweeps.row import Row
from multiarm.sweeps.work import Job

__all__ = ["Batches"]

TARGET = 0.5
"""[s] that a batch takes."""
MOST_JOBS = 256
"""In a batch."""
ROUNDS = 4
"""Batches that each worker has still to come, at least, while there are enough jobs."""


class Batches:
    """Jobs in batches, made when they are asked for.

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
        """Jobs of the next batch: one, until a run has told how long it takes."""
        if self._spent <= 0.0:
            return 1
        most = MOST_JOBS
        if self._left is not None:
            most = min(most, self._left // (ROUNDS * self.workers))
        return max(1, min(most, int(TARGET * self._runs / self._spent)))

    def learn(self, rows: Iterable[Row]) -> None:
        """Take note of how long runs took."""
        for row in rows:
            self._runs, self._spent = self._runs + 1, self._spent + row.wall_time
