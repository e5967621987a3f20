"""Structs: one vector of integers that stands for many arrays and numbers.

Kernels hand a struct to each other instead of fifty arrays.  A :func:`view` of it has the names of
a ``NamedTuple`` of arrays and numbers, and finds each field where it is used: passing a view costs
one number, and what a kernel does not name costs nothing, neither at run time nor when it is
compiled.  Views are not reference counted.

.. code-block:: python

    class Pendulum(NamedTuple):
        angle: Floats1
        inertia: Floats2

    view_pendulum = view(Pendulum)
    struct = make_struct([*pendulum])  # in Python; in a kernel: view_pendulum(struct).angle[0]

The numbers of a ``NamedTuple`` never change, and kernels may read them ahead of a loop.  Numbers
that kernels set are the fields of a :class:`Numbers`:

.. code-block:: python

    class Clock(Numbers):
        time: Float
        steps: Int

    view_clock = view(Clock)
    clock = Clock(time=0.5)  # in a kernel: view_clock(clock.struct).steps += 1; then clock.steps

A field of a ``NamedTuple`` may be such numbers too, ``view_run(struct).clock.steps``, or another
``NamedTuple``, whose entries stand among those of the outer one: ``view_run(struct).state.angle``.
"""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from struct import Struct as Format
from typing import Annotated, Any, ClassVar, TypeVar, get_type_hints
from zlib import crc32

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.errors import NumbaTypeError
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

from multiarm.jit.interpretation import INTERPRETED, generated

# Types of a field of a NamedTuple: C-contiguous arrays of float64 or int64, and their axes, or
# numbers.
Float = Annotated[float, (types.float64, 0)]
Int = Annotated[int, (types.int64, 0)]
Flag = Annotated[bool, (types.int64, 0)]
Floats1 = Annotated[np.ndarray, (types.float64, 1)]
Floats2 = Annotated[np.ndarray, (types.float64, 2)]
Floats3 = Annotated[np.ndarray, (types.float64, 3)]
Ints1 = Annotated[np.ndarray, (types.int64, 1)]
Ints2 = Annotated[np.ndarray, (types.int64, 2)]

N = TypeVar("N", bound="Numbers")

# Integers an entry: an address and up to three sizes, or a number itself.
WIDTH = 4
# In place of the number of axes: a field's numbers are in a struct of their own, or its entries
# stand in this struct.
_NUMBERS, _GROUP = -1, -2
_NO_SIZES = (1,) * (WIDTH - 1)
_KINDS = (np.dtype(np.float64), np.dtype(np.int64))
_NUMPY: dict[Any, Any] = {types.float64: np.float64, types.int64: np.int64}
_NUMBER, _BITS = Format("d"), Format("q")


def make_struct(entries: Sequence[np.ndarray | float | Numbers]) -> np.ndarray:
    """Addresses and shapes of C-contiguous float64 and int64 arrays, and numbers, shape (4 k,).

    The arrays must stay alive as long as the struct is used.
    """
    numbers: list[int] = []  # a list is filled faster than an array
    for entry in entries:
        if isinstance(entry, Numbers):
            entry = entry.struct
        if isinstance(entry, np.ndarray):
            assert entry.flags.c_contiguous and entry.dtype in _KINDS
            sizes = entry.shape
            first = entry.__array_interface__["data"][0]  # `ctypes.data` takes longer
        else:
            sizes = ()
            whole = isinstance(entry, (int, np.integer))
            first = int(entry) if whole else _BITS.unpack(_NUMBER.pack(entry))[0]
        numbers += (first, *sizes, *_NO_SIZES[len(sizes) :])
    return np.array(numbers, dtype=np.int64)


def struct_of(*holders: tuple) -> np.ndarray:
    """Struct of ``NamedTuples``, one after the other; numbers take the types of their fields.

    An ``int`` in a ``Float`` field is written as a float, a ``bool`` in an ``Int`` field as an int.
    """
    entries: list[np.ndarray | float | Numbers] = []
    for holder in holders:
        entries += _entries(holder)
    return make_struct(entries)


def _entries(holder: tuple) -> list[np.ndarray | float | Numbers]:
    entries: list[np.ndarray | float | Numbers] = []
    for (kind, axes), entry in zip(_fields_of(type(holder)), holder, strict=True):
        if axes == _GROUP:
            entries += _entries(entry)
        elif axes == 0:
            entries.append(float(entry) if kind is types.float64 else int(entry))
        else:
            entries.append(entry)
    return entries


def count_entries(holder: type) -> int:
    """Entries of a ``NamedTuple`` in a struct, with those of its groups."""
    return sum(_widths_of(holder))


def place_of(holder: type, name: str) -> int:
    """Place of a field's first entry among those of a ``NamedTuple``."""
    fields: tuple[str, ...] = holder._fields  # type: ignore[attr-defined]
    return sum(_widths_of(holder)[: fields.index(name)])


def _widths_of(holder: type) -> list[int]:
    """Entries of every field."""
    return [count_entries(kind) if axes == _GROUP else 1 for kind, axes in _fields_of(holder)]


def misfit(holder: tuple) -> str:
    """The first field of a ``NamedTuple`` that is not of its annotated type, in words; else empty.

    Kernels trust these types; what users make must be looked at.
    """
    hints = get_type_hints(type(holder), include_extras=True)
    for name, entry in zip(holder._fields, holder, strict=True):  # type: ignore[attr-defined]
        if not hasattr(hints.get(name), "__metadata__"):
            return f"{name!r} is not annotated with `multiarm.jit.structs.Floats1` or the like"
        kind, axes = hints[name].__metadata__[0]
        if axes == 0:
            fits, what = isinstance(entry, (int, float, np.number, np.bool_)), "a number"
        else:
            dtype = np.dtype(_NUMPY[kind])
            what = f"a contiguous {axes}-D array of {dtype}"
            fits = isinstance(entry, np.ndarray) and entry.dtype == dtype and entry.ndim == axes
            fits = fits and entry.flags.c_contiguous
        if not fits:
            return f"{name!r} is not {what}"
    return ""


def size_places(holder: type, at: int, shapes: Mapping[str, tuple[int, ...]]) -> np.ndarray:
    """Places of the sizes of some fields of a holder at place ``at``, in the order of their shapes.

    With them arrays get other shapes in a struct, and keep their addresses.
    """
    places: list[int] = []
    for name, shape in shapes.items():
        first = WIDTH * (at + place_of(holder, name)) + 1
        places += range(first, first + len(shape))
    return np.array(places, dtype=np.int64)


class Numbers:
    """Numbers that Python and kernels both read and set, in one struct.

    Subclasses annotate their fields with ``Float``, ``Int`` or ``Flag``; all are 0 unless given.

    Attributes
    ----------
    struct : ndarray of int64, shape (4 k,)
        The argument of kernels; it is the memory of the fields.
    """

    _fields: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        cls._fields = tuple(name for name in cls.__annotations__)
        for k, (name, (kind, _)) in enumerate(zip(cls._fields, _fields_of(cls), strict=True)):  # type: ignore[arg-type]
            setattr(cls, name, _number_property(WIDTH * k, kind is types.float64))

    def __init__(self, **values: float) -> None:
        self.struct = np.zeros(WIDTH * len(self._fields), dtype=np.int64)
        # Python's own views are read and written in half the time that NumPy's take
        self._integers = memoryview(self.struct.data)
        self._floats = self._integers.cast("B").cast("d")
        for name, value in values.items():
            setattr(self, name, value)

    def copy(self: N) -> N:
        """A copy of the numbers in another struct."""
        copy = type(self)()
        copy.struct[:] = self.struct
        return copy

    @classmethod
    def place(cls, name: str) -> int:
        """Place of a field among the integers of the struct."""
        return WIDTH * cls._fields.index(name)


def _number_property(place: int, real: bool) -> property:
    """A field of :class:`Numbers` at one place of its struct."""

    def read(numbers: Numbers) -> float:
        return numbers._floats[place]

    def write(numbers: Numbers, value: float) -> None:
        numbers._floats[place] = value

    def read_integer(numbers: Numbers) -> int:
        return numbers._integers[place]

    def write_integer(numbers: Numbers, value: int) -> None:
        numbers._integers[place] = int(value)

    return property(read, write) if real else property(read_integer, write_integer)


@functools.cache  # reading annotations takes longer than a call of a kernel
def _fields_of(holder: type) -> list[tuple[Any, int]]:
    """Number type and axes of every field, from its annotations; or its class and what it is."""
    hints = get_type_hints(holder, include_extras=True)
    fields = []
    for name in holder._fields:  # type: ignore[attr-defined]
        kind = hints[name]
        if isinstance(kind, type) and issubclass(kind, (Numbers, tuple)):
            fields.append((kind, _NUMBERS if issubclass(kind, Numbers) else _GROUP))
        else:
            fields.append(kind.__metadata__[0])
    return fields


class View(types.Type):
    """Numba's type of the arrays of a ``NamedTuple`` in a struct, the first one at place ``at``."""

    def __init__(self, holder: type, at: int) -> None:
        *places, self.end = np.cumsum([at, *_widths_of(holder)]).tolist()
        self.fields: dict[str, tuple[int, Any, int]] = {}
        names: tuple[str, ...] = holder._fields  # type: ignore[attr-defined]
        for name, place, (kind, axes) in zip(names, places, _fields_of(holder), strict=True):
            if axes < 0:
                kind = View(kind, place if axes == _GROUP else 0)
            self.fields[name] = place, kind, axes
        self.settable = issubclass(holder, Numbers)
        # Numba takes types of one name for one type, and a class may be defined again
        layout = f"{crc32(repr(self.fields).encode()):08x}"
        super().__init__(name=f"View({holder.__module__}.{holder.__qualname__}, {at}, {layout})")


@register_model(View)
class _ViewModel(models.PrimitiveModel):
    """A view is the address of its struct."""

    def __init__(self, manager, view) -> None:
        super().__init__(manager, view, ir.IntType(64))


@infer_getattr
class _ViewFields(AttributeTemplate):
    key = View

    def generic_resolve(self, view, name):
        if name in view.fields:
            _, dtype, axes = view.fields[name]
            return types.Array(dtype, axes, "C") if axes > 0 else dtype
        return None


@lower_getattr_generic(View)
def _field_of_view(context, builder, view, struct, name):
    place, dtype, axes = view.fields[name]
    numbers = builder.inttoptr(struct, ir.IntType(64).as_pointer())
    first = ir.IntType(64)(WIDTH * place)
    if axes > 0:
        return _array_in_struct(context, builder, dtype, axes, numbers, first)
    if axes == _GROUP:
        return struct
    if axes == _NUMBERS:
        return _number(builder, numbers, first)  # where these numbers are
    if view.settable:  # it may have been set since it was read last
        number = builder.load(builder.gep(numbers, [first]))
    else:
        number = _number(builder, numbers, first)
    return builder.bitcast(number, context.get_value_type(dtype))


@lower_setattr_generic(View)
def _set_field_of_view(context, builder, signature, arguments, name):
    view, (struct, value) = signature.args[0], arguments
    place, _, axes = view.fields[name]
    if axes != 0 or not view.settable:
        raise NumbaTypeError(f"field '{name}' of {view} cannot be set: it is not of a `Numbers`")
    numbers = builder.inttoptr(struct, ir.IntType(64).as_pointer())
    bits = builder.bitcast(value, ir.IntType(64))
    builder.store(bits, builder.gep(numbers, [ir.IntType(64)(WIDTH * place)]))


@typeof_impl.register(Numbers)
def _type_of_numbers(numbers, _):
    return View(type(numbers), 0)


@unbox(View)
def _view_of_numbers(view, instance, c):
    """A view of the :class:`Numbers` that Python passes: where their struct is."""
    struct, kind = c.pyapi.object_getattr_string(instance, "struct"), types.int64[::1]
    native = c.unbox(kind, struct)
    array = c.context.make_array(kind)(c.context, c.builder, native.value)
    address = c.builder.ptrtoint(array.data, ir.IntType(64))
    if c.context.enable_nrt:
        c.context.nrt.decref(c.builder, kind, native.value)  # the caller holds the numbers
    c.pyapi.decref(struct)
    return NativeValue(address, is_error=native.is_error)


def view(holder: type, at: int = 0) -> Callable[[Any], Any]:
    """Function of kernels ``struct -> view``: the fields of ``holder``, the first at place ``at``.

    ``holder`` is a ``NamedTuple`` whose fields are annotated with ``Float`` ... ``Ints2``, or
    :class:`Numbers`.
    """
    kind = View(holder, at)
    if INTERPRETED:
        return _python_view(kind)

    @intrinsic
    def open_view(typing_context, struct):
        def generate(context, builder, signature, arguments):
            array = context.make_array(signature.args[0])(context, builder, arguments[0])
            return builder.ptrtoint(array.data, ir.IntType(64))

        return kind(struct), generate

    return open_view


def view_at(holder: type) -> Callable[[Any, Any], Any]:
    """Function of kernels ``(struct, at) -> view``: as :func:`view`, at a place that is data."""
    kind = View(holder, 0)
    twin = _python_view(kind)

    def read(struct, at):
        # no slice: kernels give 0 for a size that they do not know
        first = WIDTH * int(at)
        return twin(_struct_at(struct.ctypes.data + 8 * first, max(struct.size - first, 0)))

    @generated(read)
    def open_view(typing_context, struct, at):
        def generate(context, builder, signature, arguments):
            array = context.make_array(signature.args[0])(context, builder, arguments[0])
            first = builder.mul(arguments[1], ir.IntType(64)(8 * WIDTH))
            return builder.add(builder.ptrtoint(array.data, ir.IntType(64)), first)

        return kind(struct, types.int64), generate

    return open_view


class _PythonView:
    """A view where kernels are interpreted; its fields are properties of a subclass."""

    __slots__ = ("_address",)
    needed = 0  # integers of the struct

    def __init__(self, struct: np.ndarray) -> None:
        if 0 < struct.size < self.needed:  # kernels give 0 for a size that they do not know
            raise IndexError(f"{type(self).__name__} needs {self.needed} integers: {struct.size}")
        self._address = struct.ctypes.data


def _python_view(kind: View) -> type[_PythonView]:
    """Class of the views of one kind."""
    properties = {name: _view_property(kind, *field) for name, field in kind.fields.items()}
    members = {"__slots__": (), "needed": WIDTH * kind.end, **properties}
    return type(kind.name, (_PythonView,), members)


def _view_property(kind: View, place: int, dtype: Any, axes: int) -> property:
    offset = 8 * WIDTH * place  # [bytes]
    if axes == _GROUP:
        group = _python_view(dtype)

        def read_group(view: _PythonView) -> _PythonView:
            fields = object.__new__(group)
            fields._address = view._address
            return fields

        return property(read_group)
    if axes == _NUMBERS:
        numbers, size = _python_view(dtype), WIDTH * len(dtype.fields)

        def read_numbers(view: _PythonView) -> _PythonView:
            (address,) = _memory_at(np.int64, view._address + offset, (1,))
            return numbers(_struct_at(address, size))

        return property(read_numbers)
    number = _NUMPY[dtype]
    if axes > 0:
        return property(lambda view: _array_of_entry(view._address + offset, number, axes))

    def read(view: _PythonView) -> np.number:
        return _memory_at(number, view._address + offset, (1,))[0]

    def write(view: _PythonView, value: float) -> None:
        _memory_at(number, view._address + offset, (1,))[0] = value

    return property(read, write if kind.settable else None)


def _array_of_entry(address: int, number: Any, axes: int) -> np.ndarray:
    """The array of an entry of a struct: its address and its sizes stand at ``address``."""
    first, *shape = _memory_at(np.int64, address, (1 + axes,)).tolist()
    return _memory_at(number, first, tuple(shape))


@functools.lru_cache(maxsize=2**14)
def _memory_at(number: Any, address: int, shape: tuple[int, ...]) -> np.ndarray:
    """The C-contiguous array at an address; as in compiled code, somebody else keeps its memory."""
    memory = (ctypes.c_int64 * math.prod(shape)).from_address(address)
    return np.ndarray(shape, number, memoryview(memory))


def _entry_of_struct(dtype):
    """Intrinsic ``(struct, k) -> array``: the vector at entry ``k`` of a struct."""

    def read(struct, k):
        if not 0 <= WIDTH * k < struct.size:
            raise IndexError(f"entry {k} of a struct of {struct.size // WIDTH}")
        return _array_of_entry(struct.ctypes.data + 8 * WIDTH * k, _NUMPY[dtype], 1)

    @generated(read)
    def entry(typing_context, struct, k):
        def generate(context, builder, signature, arguments):
            numbers = context.make_array(signature.args[0])(context, builder, arguments[0]).data
            first = builder.mul(arguments[1], context.get_constant(types.intp, WIDTH))
            return _array_in_struct(context, builder, dtype, 1, numbers, first)

        return types.Array(dtype, 1, "C")(struct, types.intp), generate

    return entry


# Single arrays in a struct, by their places.
floats1 = _entry_of_struct(types.float64)
ints1 = _entry_of_struct(types.int64)


def _floats_at(address, count):
    return _memory_at(np.float64, int(address), (int(count),))


@generated(_floats_at)
def floats_at(typing_context, address, count):
    """Vector of ``count`` float64 at an integer address."""

    def generate(context, builder, signature, arguments):
        return _array_at(context, builder, types.float64, arguments[0], [arguments[1]])

    return types.Array(types.float64, 1, "C")(types.int64, types.intp), generate


def _struct_at(address, size):
    return _memory_at(np.int64, int(address), (int(size),))


@generated(_struct_at)
def struct_at(typing_context, address, size):
    """Struct of ``size`` integers at an integer address."""

    def generate(context, builder, signature, arguments):
        return _array_at(context, builder, types.int64, arguments[0], [arguments[1]])

    return types.Array(types.int64, 1, "C")(types.int64, types.int64), generate


def _referenced(address):
    return _struct_at(address, 0)


@generated(_referenced)
def referenced(typing_context, address):
    """Struct at an address that another struct has, whose size nobody reads."""

    def generate(context, builder, signature, arguments):
        size = context.get_constant(types.intp, 0)
        return _array_at(context, builder, types.int64, arguments[0], [size])

    return types.Array(types.int64, 1, "C")(types.int64), generate


def _array_in_struct(context, builder, dtype, axes, numbers, first):
    """LLVM value of an array: its address is number ``first`` of a struct, its sizes follow."""
    numbers_at = []
    for offset in range(1 + axes):
        at = builder.add(first, context.get_constant(types.intp, offset))
        numbers_at.append(_number(builder, numbers, at))
    return _array_at(context, builder, dtype, numbers_at[0], numbers_at[1:])


def _number(builder, numbers, at):
    """Read one integer of a struct: LLVM may do so once, ahead of a loop.

    It does not change while compiled code runs; between two calls Python may write sizes.
    """
    number = builder.load(builder.gep(numbers, [at]))
    number.set_metadata("invariant.load", builder.module.add_metadata([]))
    return number


def _array_at(context, builder, dtype, address, shape):
    """LLVM value of a C-contiguous array at an address, without reference counting."""
    kind = types.Array(dtype, len(shape), "C")
    item = context.get_constant(types.intp, 8)
    strides, count = [item], shape[-1]
    for size in reversed(shape[:-1]):
        strides.insert(0, builder.mul(item, count))
        count = builder.mul(count, size)
    place = context.data_model_manager[kind].get_field_position
    pointer = builder.inttoptr(address, context.get_value_type(types.CPointer(dtype)))
    # Numba's own helpers build the same in memory: four times as much code for LLVM
    array = ir.Constant(context.get_value_type(kind), None)
    for name, value in (("data", pointer), ("nitems", count), ("itemsize", item)):
        array = builder.insert_value(array, value, place(name))
    for name, values in (("shape", shape), ("strides", strides)):
        for axis, value in enumerate(values):
            array = builder.insert_value(array, value, [place(name), axis])
    return array
