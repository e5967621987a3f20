"""Workers that carry out cases side by side, and the caller who waits for them.

The compiled loop over time lets other threads run; Python, around a run and wherever a run calls
it, is for one thread at a time.  Every run borrows a Data of the system for itself, so
that it gives the same numbers whichever worker carries it out.

The caller looks now and then how far the runs are, and whether Ctrl-C was pressed: then those under
way end in good order, as they do by themselves, and no other begins.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from queue import Empty, SimpleQueue

from multiarm.dynamics.system import System
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.interrupts import deferred_interrupt
from multiarm.sweeps.many.cases import Case, run_case, undone

TICK = 0.05
"""[s] between two looks at progress and Ctrl-C."""

ManyProgress = Callable[[float, int], None]


def run_cases(
    cases: Sequence[Case], system: System, threads: int, progress: ManyProgress | None = None
) -> list[Trajectory]:
    """Carry out all cases.

    Parameters
    ----------
    cases : sequence of Case
        Of scenes that are the system's, or similar to it.
    system : System
        Stays free for the caller.
    threads : int
    progress : callable, optional
        Called in this thread with the simulated time of all runs together [s] and the number of
        those that are done; may raise ``KeyboardInterrupt`` to end them all.

    Returns
    -------
    list of Trajectory
        In the order of the cases.

    Raises
    ------
    Exception
        What a run raised that is no trouble of its own, after the others have ended.
    """
    crew = _Crew(cases)
    workers_at_once = max(1, min(threads, len(cases)))
    with (
        deferred_interrupt() as interrupt,
        ThreadPoolExecutor(workers_at_once, "multiarm") as pool,
    ):
        try:
            workers = [pool.submit(crew.work, system) for _ in range(workers_at_once)]
            while wait(workers, TICK).not_done:
                if interrupt.pressed:
                    crew.stop()
                crew.tell(progress)
        finally:
            crew.stop()  # else the pool would wait for all that is to come
    for worker in workers:
        worker.result()
    crew.tell(progress)
    never = "interrupted", "stopped by the user before it began"
    return [
        undone(case, system, *never, keep=False) if result is None else result
        for case, result in zip(cases, crew.results, strict=True)
    ]


class _Crew:
    """What the workers and the caller know in common.

    Attributes
    ----------
    results : list of Trajectory or None
        None: not there yet.
    times : list of float
        How far each run is [s].
    """

    def __init__(self, cases: Sequence[Case]) -> None:
        self.results: list[Trajectory | None] = [None] * len(cases)
        self.times = [0.0] * len(cases)
        self._queue: SimpleQueue[tuple[int, Case]] = SimpleQueue()
        for item in enumerate(cases):
            self._queue.put(item)
        self._stopped = threading.Event()

    def work(self, system: System) -> None:
        """Carry out cases, one after the other, until none is left."""
        while not self._stopped.is_set():
            try:
                k, case = self._queue.get_nowait()
            except Empty:
                return
            try:
                self.results[k] = run_case(case, system, _Watch(self, k))
            except BaseException:
                self.stop()
                raise

    def stop(self) -> None:
        """Let the runs under way end, and no other begin."""
        self._stopped.set()

    def check(self) -> None:
        """End the run that asks, if they all shall end."""
        if self._stopped.is_set():
            raise KeyboardInterrupt

    def tell(self, progress: ManyProgress | None) -> None:
        """Say how far the runs are."""
        if progress is None:
            return
        try:
            progress(sum(self.times), sum(result is not None for result in self.results))
        except KeyboardInterrupt:
            self.stop()


class _Watch:
    """What a run calls now and then."""

    def __init__(self, crew: _Crew, number: int) -> None:
        self._crew, self._number = crew, number

    def __call__(self, t: float) -> None:
        self._crew.times[self._number] = t
        self._crew.check()

    def checking(self, _t: float, _number: int) -> None:
        """The accuracy is being checked."""
        self._crew.check()
