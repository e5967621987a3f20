"""Ctrl-C that ends a run in good order."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Interrupt:
    """Whether Ctrl-C was pressed, and has not been acted on."""

    pressed = False

    def deliver(self) -> None:
        """Let a Ctrl-C act now that came too late to end anything: it must not be lost."""
        if self.pressed:
            self.pressed = False
            signal.raise_signal(signal.SIGINT)


@contextmanager
def deferred_interrupt(interrupt: Interrupt | None = None) -> Iterator[Interrupt]:
    """Note Ctrl-C instead of raising in the middle of something.

    Python raises ``KeyboardInterrupt`` wherever it happens to be; inside a function that compiled
    code has called it would be printed and lost.  A second Ctrl-C acts as ever.
    """
    interrupt = Interrupt() if interrupt is None else interrupt
    if threading.current_thread() is not threading.main_thread():
        yield interrupt  # signals reach the main thread only
        return
    before = signal.getsignal(signal.SIGINT)

    def note(_number: int, _frame: FrameType | None) -> None:
        interrupt.pressed = True
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, before)
