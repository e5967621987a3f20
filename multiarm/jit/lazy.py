"""Functions that few scenes need: compiled at their first call.

Such a function stands in a table of addresses as the address of a Python function.  The first call
compiles it, writes its own address into the table and calls it: from then on compiled code calls
compiled code.
"""

from __future__ import annotations

import ctypes

from multiarm.jit.kernels import Kernel
from multiarm.jit.pointers import CFUNC_PROTOTYPE, GuardedCall, address_of
from multiarm.jit.structs import WIDTH


class LazyFunction(GuardedCall):
    """Stands in for a compiled function in a struct's table of addresses until it is called.

    Parameters
    ----------
    function : Kernel
        Decorated with `cfunc`.
    table, slot : int
        The struct's field that is the table of addresses, and the function's place there.
    flag : int
        The struct's field whose first number is set when the function could not be compiled, such
        as after a Ctrl-C.
    failed : int
        What the call returns then.
    """

    def __init__(self, function: Kernel, table: int, slot: int, flag: int, failed: int) -> None:
        self._function, self._failed = function, failed
        self._table, self._slot, self._flag = table, slot, flag
        self._stand_in = CFUNC_PROTOTYPE(self._compile_and_call)
        self.address: int = ctypes.cast(self._stand_in, ctypes.c_void_p).value or 0

    def _compile_and_call(self, address: int, size: int, a: float, b: float) -> int:
        try:
            found = address_of(self._function)
        except BaseException as error:  # it must not cross compiled code
            self.error = error
            _integers(address, self._flag)[0] = 1
            return self._failed
        _integers(address, self._table)[self._slot] = found
        return CFUNC_PROTOTYPE(found)(address, size, a, b)


def _integers(address: int, field: int) -> ctypes.Array:
    """The vector of integers in a field of the struct at an address."""
    entry = (ctypes.c_int64 * WIDTH).from_address(address + 8 * WIDTH * field)
    return (ctypes.c_int64 * entry[1]).from_address(entry[0])
