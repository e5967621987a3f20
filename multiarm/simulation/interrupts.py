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


@contextmanager
def deferred_interrupt(interrupt: Interrupt | None = None) -> Iterator[Interrupt]:
    """Store Ctrl-C in ``interrupt`` instead of raising ``KeyboardInterrupt``.

    Raised inside a function that compiled code has called, it would be printed and lost.  A second
    Ctrl-C raises as usual.
    """
    interrupt = Interrupt() if interrupt is None else interrupt
    before = signal.getsignal(signal.SIGINT)
    # signals reach the main thread only; a handler that is not Python's could not be put back
    if threading.current_thread() is not threading.main_thread() or before is None:
        yield interrupt
        return

    def note(_number: int, _frame: FrameType | None) -> None:
        interrupt.pressed = True
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, before)
