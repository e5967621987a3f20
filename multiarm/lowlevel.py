"""Primitives that let compiled code reach Pinocchio: read an address, call back into Python.

Numba types plain integers, so that a table of addresses is ordinary data: kernels compiled once
serve every scene, whatever arms it has.

An *address book* is one integer vector that stands for many arrays.  Functions of the time loop
hand it to each other instead of fifty arrays, and open it into views that are not reference
counted; an evaluation costs half of what it does with the arrays as arguments.
"""

from __future__ import annotations

import ctypes
import hashlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

_KERNEL = re.compile(rb"^@(kernel|inlined|inner|inner_inlined|entry|allocating)\b", re.MULTILINE)
_IMPORTED = re.compile(rb"^from multiarm\.([\w.]+) import", re.MULTILINE)


def _source_stamp() -> str:
    """Digest of the sources of all kernels and of the modules they import (their constants).

    Numba looks only at a kernel's own file to see whether its cached code is fresh; a kernel that
    was compiled into another one from another file would stay as it was.
    """
    root = Path(__file__).parent
    sources = {path: path.read_bytes() for path in sorted(root.rglob("*.py"))}
    # nothing is compiled from benchmarks into other kernels
    used = {Path(__file__)}
    for path, text in sources.items():
        if _KERNEL.search(text) and path.parent.name != "benchmarks":
            imported = (name.decode().replace(".", "/") for name in _IMPORTED.findall(text))
            used |= {path, *(root / f"{name}.py" for name in imported)}
    digest = hashlib.sha256()
    for path in sorted(used & sources.keys()):
        digest.update(path.name.encode() + sources[path])
    return digest.hexdigest()


_STAMP = _source_stamp()


def _decorator(with_cfunc_wrapper: bool = False, **options: Any) -> Callable:
    """Numba's decorator whose cache is fresh as long as no kernel of the package has changed."""
    options["no_cfunc_wrapper"] = not with_cfunc_wrapper

    def decorate(function: Callable) -> Any:
        # as in NumPy, a division by zero gives inf or NaN, which the callers look for
        dispatcher = njit(cache=True, error_model="numpy", **options)(function)
        _cache_file(dispatcher)._source_stamp = _STAMP
        return dispatcher

    return decorate


# Kernels that make no arrays are compiled without Numba's reference counting (`_nrt`): it would
# count every slice they hand to each other, which doubles the cost of an evaluation.  `kernel` and
# `inlined` may be called from Python too; `inner` and `inner_inlined` have no Python entry, which
# saves most of the compile time of functions that take many arrays.
kernel = _decorator(_nrt=False)
inlined = _decorator(_nrt=False, forceinline=True)
inner = _decorator(_nrt=False, no_cpython_wrapper=True)
inner_inlined = _decorator(_nrt=False, no_cpython_wrapper=True, forceinline=True)
# A large kernel that others call by its address (`address_of`, `call_entry`): it is compiled once,
# and not once more into every function above it, which is most of what compiling would cost.  Its
# arguments are those of ENTRY: address and size of an address book, two numbers; it returns an int.
entry = _decorator(_nrt=False, no_cpython_wrapper=True, with_cfunc_wrapper=True)
# For kernels that do make arrays; they must not return them to one of the other kind.
allocating = _decorator(_nrt=True)


def is_cached(dispatcher: Any) -> bool:
    """Whether fresh machine code of a kernel is in the cache."""
    return bool(_cache_file(dispatcher)._load_index())


def _cache_file(dispatcher: Any) -> Any:
    """Where Numba keeps a kernel's code; Numba has no public name for it."""
    return dispatcher._cache._cache_file


def address_book(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Addresses and shapes of C-contiguous float64 and int64 arrays, shape (4 k,).

    The arrays must stay alive as long as the book is used.
    """
    book = np.ones((len(arrays), 4), dtype=np.int64)
    for row, array in zip(book, arrays, strict=True):
        assert array.flags.c_contiguous and array.dtype in (np.float64, np.int64)
        row[0] = array.__array_interface__["data"][0]
        row[1 : 1 + array.ndim] = array.shape
    return book.ravel()


def _view(context, builder, dtype, address, shape):
    """LLVM value of a C-contiguous array at an address, without reference counting."""
    kind = types.Array(dtype, len(shape), "C")
    array = context.make_array(kind)(context, builder)
    pointer = builder.inttoptr(address, context.get_value_type(types.CPointer(dtype)))
    item = context.get_constant(types.intp, 8)
    strides = [item]
    for size in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], size))
    populate_array(array, pointer, shape, strides, item, meminfo=None)
    return array._getvalue()


@intrinsic
def floats_at(typing_context, address, count):
    """Vector of ``count`` float64 at an integer address."""

    def generate(context, builder, signature, arguments):
        return _view(context, builder, types.float64, arguments[0], [arguments[1]])

    return types.Array(types.float64, 1, "C")(types.int64, types.intp), generate


def _entry_of_book(dtype, axes: int):
    """Intrinsic ``(book, k) -> array``: the view at entry ``k`` of an address book."""

    @intrinsic
    def entry(typing_context, book, k):
        def generate(context, builder, signature, arguments):
            base = context.make_array(signature.args[0])(context, builder, arguments[0]).data
            first = builder.mul(arguments[1], context.get_constant(types.intp, 4))
            numbers = []
            for offset in range(1 + axes):
                at = builder.add(first, context.get_constant(types.intp, offset))
                numbers.append(builder.load(builder.gep(base, [at])))
            return _view(context, builder, dtype, numbers[0], numbers[1:])

        return types.Array(dtype, axes, "C")(book, types.intp), generate

    return entry


# Views of the arrays in an address book: of float64 with 1, 2, 3 axes and of int64 with 1, 2.
floats1 = _entry_of_book(types.float64, 1)
floats2 = _entry_of_book(types.float64, 2)
floats3 = _entry_of_book(types.float64, 3)
ints1 = _entry_of_book(types.int64, 1)
ints2 = _entry_of_book(types.int64, 2)


@inlined
def copy(source, out):
    """Write ``source`` into ``out``, vectors of one length (slice assignment would allocate)."""
    for i in range(out.size):
        out[i] = source[i]


ENTRY = types.int64(types.int64, types.int64, types.float64, types.float64)


def address_of(function: Any) -> int:
    """Address of a kernel decorated with `entry`, compiled if need be."""
    function.compile(ENTRY)
    result = function.overloads[ENTRY.args]
    return result.library.get_pointer_to_function(result.fndesc.llvm_cfunc_wrapper_name)


@intrinsic
def call_entry(typing_context, address, book, a, b):
    """Call the entry at an integer address with an address book and two numbers."""

    def generate(context, builder, signature, arguments):
        array = context.make_array(signature.args[1])(context, builder, arguments[1])
        integer, number = ir.IntType(64), ir.DoubleType()
        kind = ir.FunctionType(integer, [integer, integer, number, number])
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        data = builder.ptrtoint(array.data, integer)
        return builder.call(function, [data, array.nitems, arguments[2], arguments[3]])

    return types.int64(types.int64, book, types.float64, types.float64), generate


@intrinsic
def book_at(typing_context, address, size):
    """Address book of ``size`` integers at an integer address."""

    def generate(context, builder, signature, arguments):
        return _view(context, builder, types.int64, arguments[0], [arguments[1]])

    return types.Array(types.int64, 1, "C")(types.int64, types.int64), generate


@intrinsic
def call_back(typing_context, address):
    """Call the function without arguments or result at an integer address."""

    def generate(context, builder, signature, arguments):
        function = ir.FunctionType(ir.VoidType(), [])
        builder.call(builder.inttoptr(arguments[0], function.as_pointer()), [])
        return context.get_dummy_value()

    return types.void(types.int64), generate


class CallBack:
    """A Python function that compiled code can call, and the trouble it ran into.

    An exception must not cross compiled code (it would be printed and lost).  It is kept here, the
    flag array is raised, and the loop returns; :meth:`reraise` then raises it where Python can see
    it.  ``KeyboardInterrupt`` goes the same way.
    """

    def __init__(self, function: Callable[[], None], flag) -> None:
        self.error: BaseException | None = None

        def guarded() -> None:
            try:
                function()
            except BaseException as error:
                self.error = error
                flag[0] = 1

        self._keep_alive = ctypes.CFUNCTYPE(None)(guarded)
        self.address: int = ctypes.cast(self._keep_alive, ctypes.c_void_p).value or 0

    def reraise(self) -> None:
        """Raise what the function raised, if it did, once."""
        error, self.error = self.error, None
        if error is not None:
            raise error
