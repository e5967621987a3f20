"""Functions that few scenes need: compiled at their first call.

Its address is at first that of a Python function.  The first call compiles it, writes the compiled
function's address in its place and calls it: from then on compiled code calls compiled code.
"""

from __future__ import annotations

import ctypes

from multiarm.jit.kernels import Kernel
from multiarm.jit.pointers import (
    CFUNC_PROTOTYPE,
    GuardedCall,
    address_of,
    c_function,
    function_at,
)
from multiarm.jit.structs import WIDTH


class LazyFunction(GuardedCall):
    """Stands in for a compiled function until it is called.

    Parameters
    ----------
    function : Kernel
        Decorated with `cfunc`.
    address : tuple of int
        The struct's field that is a :class:`multiarm.jit.structs.Numbers`, and the place in it, of
        the function's address.
    flag : tuple of int
        The same for a number that is set to 1 when the function could not be compiled, such as
        after a Ctrl-C.
    failed : int
        The value that the call returns then.
    """

    def __init__(
        self, function: Kernel, address: tuple[int, int], flag: tuple[int, int], failed: int
    ) -> None:
        self._function, self._failed = function, failed
        self._place, self._flag = address, flag
        self._stand_in, self.address = c_function(CFUNC_PROTOTYPE, self._compile_and_call)

    def _compile_and_call(self, struct: int, size: int, a: float, b: float) -> int:
        try:
            compiled = address_of(self._function)
        except BaseException as error:  # it must not cross compiled code
            self.keep(error)
            _number(struct, *self._flag).value = 1
            return self._failed
        _number(struct, *self._place).value = compiled
        return function_at(compiled)(struct, size, a, b)


def _number(struct: int, field: int, place: int) -> ctypes.c_int64:
    """An integer of the numbers in a field of the struct at an address."""
    numbers = ctypes.c_int64.from_address(struct + 8 * WIDTH * field)
    return ctypes.c_int64.from_address(numbers.value + 8 * place)
