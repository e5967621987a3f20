"""Runs in batches that take about the same time, however long a run takes.

A batch that is lost is done again, so that it should be short; sending one costs some milliseconds,
so that it should not be too short.
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


class Batches:
    """Jobs in batches, made when they are asked for.

    Parameters
    ----------
    jobs : iterable of Job
    """

    def __init__(self, jobs: Iterable[Job]) -> None:
        self._jobs = iter(jobs)
        self._runs, self._spent = 0, 0.0

    def __iter__(self) -> Iterator[list[Job]]:
        return self

    def __next__(self) -> list[Job]:
        batch = list(islice(self._jobs, self.size))
        if not batch:
            raise StopIteration
        return batch

    @property
    def size(self) -> int:
        """Jobs of the next batch: one, until a run has told how long it takes."""
        if self._spent <= 0.0:
            return 1
        return max(1, min(MOST_JOBS, int(TARGET * self._runs / self._spent)))

    def learn(self, rows: Iterable[Row]) -> None:
        """Take note of how long runs took."""
        for row in rows:
            self._runs, self._spent = self._runs + 1, self._spent + row.wall_time
