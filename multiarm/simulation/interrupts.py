"""Ctrl-C that ends a run, with its result."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Interrupt:
    """Whether Ctrl-C was pressed and is still pending."""

    pressed = False

    def deliver(self) -> None:
        """Raise a pending Ctrl-C, which came too late to end the run."""
        if self.pressed:
            self.pressed = False
            signal.raise_signal(signal.SIGINT)


# The outermost :func:`deferred_interrupt`'s, while it lasts.
_deferring: list[Interrupt] = []


@contextmanager
def deferred_interrupt() -> Iterator[Interrupt]:
    """Store Ctrl-C instead of raising ``KeyboardInterrupt``; within another one, in the same place.

    Raised inside a function that compiled code has called, it would be printed and lost.  A second
    Ctrl-C raises as usual.
    """
    before = signal.getsignal(signal.SIGINT)
    # signals reach the main thread only; a handler that is not Python's could not be put back
    if threading.current_thread() is not threading.main_thread() or before is None:
        yield Interrupt()
        return
    if _deferring:
        yield _deferring[0]
        return
    interrupt = Interrupt()

    def note(_number: int, _frame: FrameType | None) -> None:
        interrupt.pressed = True
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    _deferring.append(interrupt)
    try:
        yield interrupt
    finally:
        _deferring.clear()
        signal.signal(signal.SIGINT, before)
