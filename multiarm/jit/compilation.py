"""How long threads wait for the compiler, and a clock that stands still meanwhile.

Numba announces each compilation; :mod:`multiarm.jit.kernels` listens.  A thread also waits where it
needs a kernel that another thread or another process compiles: such waits are marked by
:func:`compiling`.  This module does without Numba, which takes long to import.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = [
    "compile_time",
    "compiling",
    "is_compiling",
    "process_running_time",
    "running_time",
    "start_compiling",
    "stop_compiling",
]


class _Stopwatch:
    """Adds up the times during which at least one compilation is under way."""

    def __init__(self) -> None:
        self._under_way = 0
        self._total = self._since = 0.0  # [s]

    def start(self) -> None:
        if self._under_way == 0:
            self._since = time.perf_counter()
        self._under_way += 1

    def stop(self) -> None:
        self._under_way -= 1
        if self._under_way == 0:
            self._total += time.perf_counter() - self._since

    @property
    def runs(self) -> bool:
        return self._under_way > 0

    def seconds(self) -> float:
        return self._total + (time.perf_counter() - self._since if self.runs else 0.0)


class _OfThread(threading.local):
    def __init__(self) -> None:
        self.watch = _Stopwatch()


_THREAD, _PROCESS, _LOCK = _OfThread(), _Stopwatch(), threading.Lock()


@contextmanager
def compiling() -> Iterator[None]:
    """What is done in this context counts as compilation."""
    start_compiling()
    try:
        yield
    finally:
        stop_compiling()


def is_compiling() -> bool:
    """Whether some thread of this process waits for the compiler."""
    return _PROCESS.runs


def compile_time() -> float:
    """How long this thread has waited for the compiler since it began [s]."""
    return _THREAD.watch.seconds()


def running_time() -> float:
    """A clock [s] that stands still while this thread waits for the compiler."""
    return time.perf_counter() - compile_time()


def process_running_time() -> float:
    """A clock [s] that stands still while any thread waits for the compiler."""
    with _LOCK:
        return time.perf_counter() - _PROCESS.seconds()


def start_compiling() -> None:
    """This thread begins to wait for the compiler; calls may be nested."""
    _THREAD.watch.start()
    with _LOCK:
        _PROCESS.start()


def stop_compiling() -> None:
    """The end of what :func:`start_compiling` began."""
    _THREAD.watch.stop()
    with _LOCK:
        _PROCESS.stop()
