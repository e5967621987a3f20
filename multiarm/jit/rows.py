"""Rows: numbers of one array that belong together, read and set by name.

A row, of float64 or int64, has the fields of a ``NamedTuple``, one after the other.  Kernels open
it where it is in an array, and read vectors, rotations and symmetric matrices as the tuples of
:mod:`multiarm.jit.vectors`; to set a field is to write it into the array.  Passing an open row
costs one address.

.. code-block:: python

    class Motion(NamedTuple):
        rotation: Rotation
        spin: Vector

    open_motion = row_of(Motion)

    motion = open_motion(motions[i])  # in a kernel
    motion.spin = rotate(motion.rotation, motion.spin)

    fields_of(Motion, motions).spin  # in Python: a view of all rows, shape (n, 3)

Python opens a row as kernels do where it runs the source of one itself.

:func:`lanes_of` opens rows of :mod:`~multiarm.jit.simd` packs, whose every number is that of four
arms.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Annotated, Any, TypeVar, get_type_hints
from zlib import crc32

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    infer_getattr,
    intrinsic,
    lower_builtin,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    register_model,
    type_callable,
)

from multiarm.jit.interpretation import INTERPRETED
from multiarm.jit.simd import LANES, PACK, load_lanes, store_lanes

# Types of a field: the places of its numbers, as the tuples of `multiarm.jit.vectors` have them,
# and its shape in NumPy.
Number = Annotated[Any, 0]
Vector = Annotated[np.ndarray, (0, 1, 2)]
Quaternion = Annotated[np.ndarray, (0, 1, 2, 3)]  # x, y, z, w
Pair = Annotated[np.ndarray, ((0, 1, 2), (3, 4, 5))]  # such as a twist: linear, angular
Symmetric = Annotated[np.ndarray, (0, 1, 2, 3, 4, 5)]  # xx, xy, xz, yy, yz, zz
Rotation = Annotated[np.ndarray, ((0, 3, 6), (1, 4, 7), (2, 5, 8))]  # row by row
Axes = Annotated[np.ndarray, ((0, 1, 2), (3, 4, 5), (6, 7, 8))]  # a rotation column by column

R = TypeVar("R", bound=tuple)
Places = Any  # a number, or a tuple of places


@functools.cache
def width(kind: type) -> int:
    """Numbers of a row."""
    return sum(_count(places) for places in _places_of(kind).values())


def offset_of(kind: type, name: str) -> int:
    """First number of a field in its row."""
    return _fields(kind)[name][0]


def fields_of(kind: type[R], rows: np.ndarray) -> R:
    """Views of the fields of rows, shape (..., width): rotations are (..., 3, 3)."""
    return kind(*(_view(rows, *field) for field in _fields(kind).values()))


def field_of(kind: type, name: str, rows: np.ndarray) -> np.ndarray:
    """View of one field of rows."""
    return _view(rows, *_fields(kind)[name])


def _view(rows: np.ndarray, first: int, places: Places) -> np.ndarray:
    if places == 0:
        return rows[..., first]
    part = rows[..., first : first + _count(places)]
    if len(places) == 3 and places != (0, 1, 2):
        part = part.reshape(*rows.shape[:-1], 3, 3)
        return part if places[0] == (0, 3, 6) else part.swapaxes(-1, -2)
    return part


def as_row(fields: tuple) -> np.ndarray:
    """The row of these fields, shape (width,)."""
    row = np.empty(width(type(fields)))
    for part, field in zip(fields_of(type(fields), row), fields, strict=True):
        part[...] = field
    return row


def row_of(kind: type) -> Callable[[Any], Any]:
    """Function ``array -> row``, which begins with the array; of kernels and of Python."""
    open_at = _python_row(kind, 1)

    def open_row(array: np.ndarray) -> Any:
        return open_at(array, 0)

    @type_callable(open_row)
    def type_row(typing_context):
        return lambda array: Row(kind, array.dtype)

    @lower_builtin(open_row, types.Array)
    def lower_row(context, builder, signature, arguments):
        return context.make_array(signature.args[0])(context, builder, arguments[0]).data

    return open_row


def lanes_of(kind: type) -> Callable[[Any, Any], Any]:
    """Function of kernels ``(array, at) -> row`` of packs, whose first lane is at one place."""
    if INTERPRETED:
        return _python_row(kind, LANES)
    row = Row(kind, PACK)

    @intrinsic
    def open_lanes(typing_context, array, at):
        def generate(context, builder, signature, arguments):
            data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
            return builder.gep(data, [arguments[1]])

        return row(array, types.intp), generate

    return open_lanes


@functools.cache
def _places_of(kind: type) -> dict[str, Places]:
    hints = get_type_hints(kind, include_extras=True)
    return {name: hints[name].__metadata__[0] for name in kind._fields}  # type: ignore[attr-defined]


@functools.cache
def _fields(kind: type) -> dict[str, tuple[int, Places]]:
    """First number and places of every field."""
    fields, first = {}, 0
    for name, places in _places_of(kind).items():
        fields[name] = first, places
        first += _count(places)
    return fields


@functools.cache
def _count(places: Places) -> int:
    return sum(map(_count, places)) if isinstance(places, tuple) else 1


# --- compiled -------------------------------------------------------------------------------------


class Row(types.Type):
    """Numba's type of an open row of numbers of a type: float64, int64 or packs."""

    def __init__(self, kind: type, number: types.Type) -> None:
        self.fields, self.number = _fields(kind), number
        self.lanes = LANES if number is PACK else 1
        # Numba takes types of one name for one type, and a class may be defined again
        layout = f"{crc32(repr(self.fields).encode()):08x}"
        super().__init__(name=f"Row({kind.__module__}.{kind.__qualname__}, {number}, {layout})")


@register_model(Row)
class _RowModel(models.PrimitiveModel):
    """An open row is the address of its first number."""

    def __init__(self, manager: Any, row: Row) -> None:
        number = ir.IntType(64) if row.number == types.int64 else ir.DoubleType()
        super().__init__(manager, row, number.as_pointer())


@infer_getattr
class _RowFields(AttributeTemplate):
    key = Row

    def generic_resolve(self, row, name):
        return _type_of(row, row.fields[name][1]) if name in row.fields else None


def _type_of(row: Row, places: Places) -> types.Type:
    if isinstance(places, tuple):
        return types.UniTuple(_type_of(row, places[0]), len(places))
    return row.number


@lower_getattr_generic(Row)
def _read_field(context, builder, row, address, name):
    first, places = row.fields[name]

    def read(places):
        if isinstance(places, tuple):
            return context.make_tuple(builder, _type_of(row, places), [*map(read, places)])
        pointer = builder.gep(address, [ir.IntType(64)(row.lanes * (first + places))])
        return builder.load(pointer) if row.lanes == 1 else load_lanes(builder, pointer)

    return read(places)


@lower_setattr_generic(Row)
def _write_field(context, builder, signature, arguments, name):
    row, (address, value) = signature.args[0], arguments
    first, places = row.fields[name]

    def write(places, value):
        if isinstance(places, tuple):
            for k, part in enumerate(places):
                write(part, builder.extract_value(value, k))
            return
        pointer = builder.gep(address, [ir.IntType(64)(row.lanes * (first + places))])
        if row.lanes == 1:
            builder.store(value, pointer)
        else:
            store_lanes(builder, value, pointer)

    write(places, value)


# --- interpreted ----------------------------------------------------------------------------------


@functools.cache
def _python_row(kind: type, lanes: int) -> Callable[[np.ndarray, int], Any]:
    """Function that opens rows where kernels are interpreted; fields are properties of a class."""
    fields = {name: _property(lanes, *field) for name, field in _fields(kind).items()}
    opened = type(kind.__name__, (), {"__slots__": ("numbers",), **fields})
    size = lanes * width(kind)

    def open_row(array: np.ndarray, at: int) -> Any:
        if not 0 <= at <= array.size - size:
            raise IndexError(f"{kind.__name__} at {at} of an array of {array.size} numbers")
        row: Any = opened()
        row.numbers = array.reshape(-1)[at : at + size]
        return row

    return open_row


def _property(lanes: int, first: int, places: Places) -> property:
    def read(row: Any, places: Places = places) -> Any:
        if isinstance(places, tuple):
            return tuple(read(row, part) for part in places)
        at = lanes * (first + places)
        return row.numbers[at] if lanes == 1 else row.numbers[at : at + lanes].copy()

    def write(row: Any, value: Any, places: Places = places) -> None:
        if isinstance(places, tuple):
            for part, number in zip(places, value, strict=True):
                write(row, number, part)
        else:
            at = lanes * (first + places)
            row.numbers[at : at + lanes] = value

    return property(read, write)
