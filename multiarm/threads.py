"""Linear algebra on one thread: for small matrices, and where workers share the processors already.

The number of threads belongs to the process.  Several of its threads may ask for one at the same
time, such as runs on one worker of a cluster: the first sets it, and the last takes it back.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController


class _Users:
    """How many ask for one thread at present, and what restores the number there was before."""

    def __init__(self) -> None:
        self.lock, self.count = threading.Lock(), 0
        self.limiter: Any = None


_USERS = _Users()


@contextmanager
def one_thread() -> Iterator[None]:
    """Let the linear algebra of this process run on one thread meanwhile."""
    with _USERS.lock:
        if _USERS.count == 0:
            _USERS.limiter = _thread_pools().limit(limits=1)
        _USERS.count += 1
    try:
        yield
    finally:
        with _USERS.lock:
            _USERS.count -= 1
            if _USERS.count == 0:
                _USERS.limiter.restore_original_limits()


@cache
def _thread_pools() -> ThreadpoolController:
    """The libraries with threads; looking for them takes as long as a short run."""
    import scipy.linalg  # noqa: F401 - only libraries that are loaded are found

    return ThreadpoolController()
