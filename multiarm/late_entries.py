"""Entries that few scenes need: compiled when they are first called, not before.

A late entry stands in ``Plant.calls`` as the address of a Python function.  The first call compiles
the entry, writes its own address there, and goes on with it: from then on compiled code calls
compiled code.
"""

from __future__ import annotations

import ctypes

from multiarm.books import WIDTH
from multiarm.lowlevel import ENTRY_PROTOTYPE, Kernel, Trouble, address_of
from multiarm.plant import CALLS, FLAG


class LateEntry(Trouble):
    """Stands in for an entry of a system's ``Plant.calls`` until it is called.

    Parameters
    ----------
    entry : Kernel
    slot : int
        Its place in ``Plant.calls``.
    failed : int
        What a call returns when it could not be compiled, such as after a Ctrl-C; the flag of the
        system's buffers is then raised.
    """

    def __init__(self, entry: Kernel, slot: int, failed: int) -> None:
        self._entry, self._slot, self._failed = entry, slot, failed
        self._stand_in = ENTRY_PROTOTYPE(self._compile_and_call)
        self.address: int = ctypes.cast(self._stand_in, ctypes.c_void_p).value or 0

    def _compile_and_call(self, address: int, size: int, a: float, b: float) -> int:
        try:
            found = address_of(self._entry)
        except BaseException as error:  # it must not cross compiled code
            self.error = error
            _integers(address, FLAG)[0] = 1
            return self._failed
        _integers(address, CALLS)[self._slot] = found
        return ENTRY_PROTOTYPE(found)(address, size, a, b)


def _integers(address: int, place: int) -> ctypes.Array:
    """The vector of integers at a place of the address book at an address."""
    entry = (ctypes.c_int64 * WIDTH).from_address(address + 8 * WIDTH * place)
    return (ctypes.c_int64 * entry[1]).from_address(entry[0])
