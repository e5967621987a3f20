"""Calls through addresses: compiled functions by their pointers, and callbacks into Python.

Numba types plain integers, so that a table of addresses is ordinary data: kernels compiled once
serve every scene, whatever arms it has.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from llvmlite import ir
from numba import types

from multiarm.jit.compilation import compiling
from multiarm.jit.interpretation import INTERPRETED, generated
from multiarm.jit.kernels import Kernel

# Signature of functions called by address, decorated with `cfunc`: address and size of a struct,
# two numbers; they return an integer.
CFUNC = types.int64(types.int64, types.int64, types.float64, types.float64)
# The same for Python: makes a function of an address, and an address of a function.
CFUNC_PROTOTYPE = ctypes.CFUNCTYPE(
    ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_double, ctypes.c_double
)
_CALLBACK_PROTOTYPE = ctypes.CFUNCTYPE(None)
# Where kernels are interpreted, the functions that they call "by address".
_INTERPRETED: WeakValueDictionary[int, Callable] = WeakValueDictionary()


def address_of(function: Kernel) -> int:
    """Address of a kernel decorated with `cfunc`, compiled if need be."""
    if INTERPRETED:
        return _key_of(function)
    whole = function.whole
    if CFUNC.args not in whole.overloads:
        # a thread that needs what another one compiles waits for the compiler, too
        with nullcontext() if function.is_cached() else compiling():
            whole.compile(CFUNC)
    result = whole.overloads[CFUNC.args]
    return result.library.get_pointer_to_function(result.fndesc.llvm_cfunc_wrapper_name)


def is_at(function: Kernel, address: int) -> bool:
    """Whether a kernel decorated with `cfunc` has an address; one not yet compiled has none."""
    if INTERPRETED:
        return id(function) == address
    return function.is_compiled(CFUNC.args) and address_of(function) == address


def function_at(address: int) -> Callable[[int, int, float, float], int]:
    """The function, decorated with `cfunc`, at an address."""
    return _INTERPRETED[address] if INTERPRETED else CFUNC_PROTOTYPE(address)


def call_whole(function: Kernel, struct: np.ndarray, a: float = 0.0, b: float = 0.0) -> int:
    """Call a kernel decorated with `cfunc` from Python, as kernels call it."""
    return function_at(address_of(function))(struct.ctypes.data, struct.size, a, b)


def c_function(prototype: Any, function: Callable) -> tuple[Any, int]:
    """A Python function that kernels can call, for as long as the object returned lives.

    Returns
    -------
    alive : object
    address : int
    """
    if INTERPRETED:
        return function, _key_of(function)
    pointer = prototype(function)
    return pointer, ctypes.cast(pointer, ctypes.c_void_p).value or 0


def _key_of(function: Callable) -> int:
    _INTERPRETED[id(function)] = function
    return id(function)


def _call_cfunc(address: int, struct: Any, a: float, b: float) -> int:
    return _INTERPRETED[address](struct.ctypes.data, struct.size, a, b)


@generated(_call_cfunc)
def call_cfunc(typing_context, address, struct, a, b):
    """Call the function at an integer address with a struct and two numbers."""

    def generate(context, builder, signature, arguments):
        array = context.make_array(signature.args[1])(context, builder, arguments[1])
        integer, number = ir.IntType(64), ir.DoubleType()
        kind = ir.FunctionType(integer, [integer, integer, number, number])
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        data = builder.ptrtoint(array.data, integer)
        return builder.call(function, [data, array.nitems, arguments[2], arguments[3]])

    return types.int64(types.int64, struct, types.float64, types.float64), generate


def _call_python(address: int) -> None:
    _INTERPRETED[address]()


@generated(_call_python)
def call_python(typing_context, address):
    """Call the function without arguments or result at an integer address."""

    def generate(context, builder, signature, arguments):
        function = ir.FunctionType(ir.VoidType(), [])
        builder.call(builder.inttoptr(arguments[0], function.as_pointer()), [])
        return context.get_dummy_value()

    return types.void(types.int64), generate


class GuardedCall:
    """A call of compiled code into Python, and the exception that it ran into.

    An exception must not cross compiled code (it would be printed and lost).  It is kept here, a
    flag is set, and the loop returns; :meth:`reraise` then raises it where Python can see
    it.  ``KeyboardInterrupt`` goes the same way.
    """

    address: int
    error: BaseException | None = None

    def keep(self, error: BaseException) -> None:
        """Keep an exception until it is raised; a Ctrl-C gives way to no later one."""
        if self.error is None or isinstance(self.error, Exception):
            self.error = error

    def reraise(self) -> None:
        """Raise what the function raised, if it did, once."""
        error, self.error = self.error, None
        if error is not None:
            raise error


class PythonCallback(GuardedCall):
    """A Python function without arguments or result that compiled code can call.

    When it raises an exception, ``status.failed`` is set.
    """

    def __init__(self, function: Callable[[], None], status: Any) -> None:
        def guarded() -> None:
            try:
                function()
            except BaseException as error:
                self.keep(error)
                status.failed = True

        self._keep_alive, self.address = c_function(_CALLBACK_PROTOTYPE, guarded)
