"""Address books: one vector of integers that stands for many arrays.

Kernels hand a book to each other instead of fifty arrays.  A :func:`view` of it has the names of a
``NamedTuple`` of arrays, and finds each array where it is used: passing a view costs one number,
and what a kernel does not name costs nothing, neither at run time nor when it is compiled.  Views
are not reference counted.

.. code-block:: python

    class Pendulum(NamedTuple):
        angle: Floats1
        inertia: Floats2

    open_pendulum = view(Pendulum)
    book = address_book([*pendulum])  # in Python; in a kernel: open_pendulum(book).angle[0]
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Sequence
from typing import Annotated, Any, get_type_hints

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    models,
    register_model,
    unbox,
)
from numba.np.arrayobj import populate_array

# What a field of a NamedTuple may be: C-contiguous arrays of float64 or int64, and their axes, or
# numbers.
Float = Annotated[float, (types.float64, 0)]
Int = Annotated[int, (types.int64, 0)]
Flag = Annotated[bool, (types.int64, 0)]
Floats1 = Annotated[np.ndarray, (types.float64, 1)]
Floats2 = Annotated[np.ndarray, (types.float64, 2)]
Floats3 = Annotated[np.ndarray, (types.float64, 3)]
Ints1 = Annotated[np.ndarray, (types.int64, 1)]
Ints2 = Annotated[np.ndarray, (types.int64, 2)]

# Integers an entry: an address and up to three sizes, or a number itself.
WIDTH = 4
_NO_SIZES = (1,) * (WIDTH - 1)
_KINDS = (np.dtype(np.float64), np.dtype(np.int64))
_NUMBER, _BITS = struct.Struct("d"), struct.Struct("q")


def address_book(entries: Sequence[np.ndarray | float]) -> np.ndarray:
    """Addresses and shapes of C-contiguous float64 and int64 arrays, and numbers, shape (4 k,).

    The arrays must stay alive as long as the book is used.
    """
    numbers: list[int] = []  # a list is filled faster than an array
    for entry in entries:
        if isinstance(entry, np.ndarray):
            assert entry.flags.c_contiguous and entry.dtype in _KINDS
            sizes = entry.shape
            first = entry.__array_interface__["data"][0]
        else:
            sizes = ()
            whole = isinstance(entry, (int, np.integer))
            first = int(entry) if whole else _BITS.unpack(_NUMBER.pack(entry))[0]
        numbers += (first, *sizes, *_NO_SIZES[len(sizes) :])
    return np.array(numbers, dtype=np.int64)


def book_of(*holders: tuple) -> np.ndarray:
    """Address book of ``NamedTuples``, one behind the other; numbers become what their fields are.

    An ``int`` in a ``Float`` field is written as a float, a ``bool`` in an ``Int`` field as an int.
    """
    entries: list[np.ndarray | float] = []
    for holder in holders:
        numbers = _numbers_of(type(holder))
        entries += [numbers[k](entry) if k in numbers else entry for k, entry in enumerate(holder)]
    return address_book(entries)


@functools.cache
def _numbers_of(holder: type) -> dict[int, Callable[[Any], float]]:
    """Places of the fields that are numbers, and what makes such a number."""
    kinds = [dtype if not axes else None for dtype, axes in _fields_of(holder)]
    made = {types.float64: float, types.int64: int}
    return {k: made[kind] for k, kind in enumerate(kinds) if kind is not None}


def _fields_of(holder: type) -> list[tuple[Any, int]]:
    """Number type and axes of every field of a ``NamedTuple``, from its annotations."""
    hints = get_type_hints(holder, include_extras=True)
    return [hints[name].__metadata__[0] for name in holder._fields]  # type: ignore[attr-defined]


class View(types.Type):
    """Numba's type of the arrays of a ``NamedTuple`` in a book, the first one at place ``at``."""

    def __init__(self, holder: type, at: int) -> None:
        names = holder._fields  # type: ignore[attr-defined]
        self.fields = {
            name: (at + k, dtype, axes)
            for k, (name, (dtype, axes)) in enumerate(zip(names, _fields_of(holder), strict=True))
        }
        super().__init__(name=f"View({holder.__module__}.{holder.__qualname__}, {at})")


@register_model(View)
class _ViewModel(models.PrimitiveModel):
    """A view is the address of its book."""

    def __init__(self, manager, view) -> None:
        super().__init__(manager, view, ir.IntType(64))


@infer_getattr
class _ViewFields(AttributeTemplate):
    key = View

    def generic_resolve(self, view, name):
        if name in view.fields:
            _, dtype, axes = view.fields[name]
            return types.Array(dtype, axes, "C") if axes else dtype
        return None


@lower_getattr_generic(View)
def _field_of_view(context, builder, view, book, name):
    place, dtype, axes = view.fields[name]
    numbers = builder.inttoptr(book, ir.IntType(64).as_pointer())
    first = ir.IntType(64)(WIDTH * place)
    if axes:
        return _array_in_book(context, builder, dtype, axes, numbers, first)
    return builder.bitcast(_number(builder, numbers, first), context.get_value_type(dtype))


@unbox(View)
def _no_view(view, given, c):
    """Python has no views: kernels take the ``NamedTuple`` itself from there."""
    c.pyapi.err_set_string("PyExc_TypeError", "views of address books exist in kernels only")
    return NativeValue(ir.IntType(64)(0), is_error=ir.IntType(1)(1))


def view(holder: type, at: int = 0) -> Callable[[Any], Any]:
    """Function of kernels: ``book -> view`` of the arrays of ``holder``, the first at place ``at``.

    ``holder`` is a ``NamedTuple`` whose fields are annotated with ``Floats1`` ... ``Ints2``.
    """
    kind = View(holder, at)

    @intrinsic
    def open_view(typing_context, book):
        def generate(context, builder, signature, arguments):
            array = context.make_array(signature.args[0])(context, builder, arguments[0])
            return builder.ptrtoint(array.data, ir.IntType(64))

        return kind(book), generate

    return open_view


def _entry_of_book(dtype, axes: int):
    """Intrinsic ``(book, k) -> array``: the view at entry ``k`` of an address book."""

    @intrinsic
    def entry(typing_context, book, k):
        def generate(context, builder, signature, arguments):
            numbers = context.make_array(signature.args[0])(context, builder, arguments[0]).data
            first = builder.mul(arguments[1], context.get_constant(types.intp, WIDTH))
            return _array_in_book(context, builder, dtype, axes, numbers, first)

        return types.Array(dtype, axes, "C")(book, types.intp), generate

    return entry


# Single arrays in an address book, by their places.
floats1 = _entry_of_book(types.float64, 1)
floats2 = _entry_of_book(types.float64, 2)
ints1 = _entry_of_book(types.int64, 1)
ints2 = _entry_of_book(types.int64, 2)


@intrinsic
def floats_at(typing_context, address, count):
    """Vector of ``count`` float64 at an integer address."""

    def generate(context, builder, signature, arguments):
        return _array_at(context, builder, types.float64, arguments[0], [arguments[1]])

    return types.Array(types.float64, 1, "C")(types.int64, types.intp), generate


@intrinsic
def book_at(typing_context, address, size):
    """Address book of ``size`` integers at an integer address."""

    def generate(context, builder, signature, arguments):
        return _array_at(context, builder, types.int64, arguments[0], [arguments[1]])

    return types.Array(types.int64, 1, "C")(types.int64, types.int64), generate


def _array_in_book(context, builder, dtype, axes, numbers, first):
    """LLVM value of an array whose address is number ``first`` of a book, its sizes behind it."""
    found = []
    for offset in range(1 + axes):
        at = builder.add(first, context.get_constant(types.intp, offset))
        found.append(_number(builder, numbers, at))
    return _array_at(context, builder, dtype, found[0], found[1:])


def _number(builder, numbers, at):
    """Read one integer of a book, which never changes: LLVM may do so once, ahead of a loop."""
    number = builder.load(builder.gep(numbers, [at]))
    number.set_metadata("invariant.load", builder.module.add_metadata([]))
    return number


def _array_at(context, builder, dtype, address, shape):
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
