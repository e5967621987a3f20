"""SIMD packs: one quantity of four arms in one vector register.

Sums and products of packs are one instruction each where the processor has registers for four
numbers, and a product that is added at once is rounded once where it can.  In memory the four
numbers follow each other: :func:`gather_pack` loads them from four places, and
:func:`transpose_four` transposes four packs, so that what belongs to one arm is together.  Nothing
in a lane depends on what the others hold.

:func:`packs_of` opens a vector whose packs are read and set by their numbers, ``packs[k]``;
:func:`load_pack` and :func:`store_pack` take the place of any number.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.datamodel import models
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import lower_builtin, register_model

from multiarm.jit.interpretation import generated

LANES = 4
_NUMBER, _INTEGER, _PLACE = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
_VECTOR = ir.VectorType(_NUMBER, LANES)
_ALIGNMENT = 64  # [bytes] one line of the processor's cache
# A product and a sum may become one instruction; the sign of a zero does not matter.
_FLAGS = ("contract", "nsz")


class PackType(types.Type):
    """Numba's type of one quantity of four arms."""

    def __init__(self) -> None:
        super().__init__(name="Pack")


@register_model(PackType)
class _PackModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: types.Type) -> None:
        super().__init__(manager, kind, _VECTOR)


PACK = PackType()


def aligned_zeros(size: int) -> np.ndarray:
    """A vector of zeros for lanes, which begins where a line of the processor's cache does."""
    room = np.zeros(size + _ALIGNMENT // 8)
    first = -room.__array_interface__["data"][0] % _ALIGNMENT // 8
    return room[first : first + size]


def _define(operation: Any, arguments: int, instruction: str) -> None:
    """Let an operator of Python mean one instruction on all lanes."""

    @infer_global(operation)
    class _Typing(ConcreteTemplate):
        cases = (signature(PACK, *[PACK] * arguments),)

    @lower_builtin(operation, *[PACK] * arguments)
    def _lower(_context, builder, _signature, values):
        return getattr(builder, instruction)(*values, flags=_FLAGS)


_define(operator.add, 2, "fadd")
_define(operator.sub, 2, "fsub")
_define(operator.mul, 2, "fmul")
_define(operator.truediv, 2, "fdiv")


def _lanes(array, at):
    """The four numbers that begin at one place of an array, where kernels are interpreted."""
    if not 0 <= at <= array.size - LANES:
        raise IndexError(f"lanes {at} to {at + LANES - 1} of an array of {array.size} numbers")
    return array.reshape(-1)[at : at + LANES]


def load_lanes(builder: Any, pointer: Any) -> Any:
    """LLVM value of the four numbers from a pointer to the first on."""
    return builder.load(builder.bitcast(pointer, _VECTOR.as_pointer()), align=8)


def store_lanes(builder: Any, value: Any, pointer: Any) -> None:
    """Write four numbers from a pointer to the first on."""
    builder.store(value, builder.bitcast(pointer, _VECTOR.as_pointer()), align=8)


def _pointer(context, builder, kind, array, at):
    """LLVM pointer to the number at one place of an array."""
    return builder.gep(context.make_array(kind)(context, builder, array).data, [at])


def _shuffled(builder, a, b, places):
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_PLACE, LANES), places))


def _load_pack(array, at):
    return _lanes(array, at).copy()


@generated(_load_pack)
def load_pack(typing_context, array, at):
    """Lanes that begin at one place of a vector of float64."""

    def generate(context, builder, signature, arguments):
        return load_lanes(builder, _pointer(context, builder, signature.args[0], *arguments))

    return PACK(array, types.intp), generate


def _store_pack(array, at, value):
    _lanes(array, at)[:] = value


@generated(_store_pack)
def store_pack(typing_context, array, at, value):
    """Write lanes into a vector of float64, from one place on."""

    def generate(context, builder, signature, arguments):
        pointer = _pointer(context, builder, signature.args[0], *arguments[:2])
        store_lanes(builder, arguments[2], pointer)
        return context.get_dummy_value()

    return types.void(array, types.intp, PACK), generate


# --- packs in memory, by index --------------------------------------------------------------------


class PacksType(types.Type):
    """Numba's type of the packs of a vector, from one on."""

    def __init__(self) -> None:
        super().__init__(name="Packs")


@register_model(PacksType)
class _PacksModel(models.PrimitiveModel):
    """Packs are the address of the first."""

    def __init__(self, manager: Any, kind: types.Type) -> None:
        super().__init__(manager, kind, _VECTOR.as_pointer())


PACKS = PacksType()


@infer_global(operator.getitem)
class _PackOfPacks(ConcreteTemplate):
    cases = (signature(PACK, PACKS, types.intp),)


@lower_builtin(operator.getitem, PACKS, types.intp)
def _load_from_packs(_context, builder, _signature, arguments):
    return builder.load(builder.gep(arguments[0], [arguments[1]]), align=8)


@infer_global(operator.setitem)
class _SetPackOfPacks(ConcreteTemplate):
    cases = (signature(types.void, PACKS, types.intp, PACK),)


@lower_builtin(operator.setitem, PACKS, types.intp, PACK)
def _store_into_packs(context, builder, _signature, arguments):
    packs, k, value = arguments
    builder.store(value, builder.gep(packs, [k]), align=8)
    return context.get_dummy_value()


@infer_global(operator.add)
class _LaterPacks(ConcreteTemplate):
    cases = (signature(PACKS, PACKS, types.intp),)


@lower_builtin(operator.add, PACKS, types.intp)
def _move_on_packs(_context, builder, _signature, arguments):
    return builder.gep(arguments[0], [arguments[1]])


class _Packs:
    """The packs of a vector, from one on, where kernels are interpreted."""

    __slots__ = ("_first", "_numbers")

    def __init__(self, array: np.ndarray, first: int) -> None:
        self._numbers, self._first = array, first

    def __add__(self, k: int) -> _Packs:
        return _Packs(self._numbers, self._first + k)

    def __getitem__(self, k: int) -> np.ndarray:
        return _load_pack(self._numbers, LANES * (self._first + k))

    def __setitem__(self, k: int, value: np.ndarray) -> None:
        _store_pack(self._numbers, LANES * (self._first + k), value)


@generated(_Packs)
def packs_of(typing_context, array, first):
    """The packs of a vector of float64, from number ``first`` of them on.

    ``packs[k]`` is one of them, and ``packs + k`` are those from there on.
    """

    def generate(context, builder, signature, arguments):
        at = builder.mul(arguments[1], _INTEGER(LANES))
        pointer = _pointer(context, builder, signature.args[0], arguments[0], at)
        return builder.bitcast(pointer, _VECTOR.as_pointer())

    return PACKS(array, types.intp), generate


# --- operations -----------------------------------------------------------------------------------


def _broadcast(number):
    return np.full(LANES, number)


@generated(_broadcast)
def broadcast(typing_context, number):
    """The same number in all lanes."""

    def generate(context, builder, signature, arguments):
        value = ir.Constant(_VECTOR, ir.Undefined)
        for lane in range(LANES):
            value = builder.insert_element(value, arguments[0], _PLACE(lane))
        return value

    return PACK(types.float64), generate


def _gather_pack(array, at0, at1, at2, at3):
    return array.reshape(-1)[[at0, at1, at2, at3]]


@generated(_gather_pack)
def gather_pack(typing_context, array, at0, at1, at2, at3):
    """Lanes from four places of an array of float64, counted as in a vector."""

    def generate(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        value = ir.Constant(_VECTOR, ir.Undefined)
        for lane, at in enumerate(arguments[1:]):
            number = builder.load(builder.gep(data, [at]))
            value = builder.insert_element(value, number, _PLACE(lane))
        return value

    return PACK(array, *[types.intp] * LANES), generate


def _min_positive(a, b):
    return np.where(b > 0.0, _minimum(a, b), 0.0)


@generated(_min_positive)
def min_positive(typing_context, a, b):
    """In every lane the minimum of ``a`` and ``b``, but 0 where ``b`` is not positive (or NaN)."""

    def generate(context, builder, signature, arguments):
        a, b = arguments
        minimum = builder.select(builder.fcmp_ordered("<", a, b), a, b)
        positive = builder.fcmp_ordered(">", b, ir.Constant(_VECTOR, [0.0] * LANES))
        return builder.select(positive, minimum, ir.Constant(_VECTOR, [0.0] * LANES))

    return PACK(PACK, PACK), generate


def _minimum(a, b):
    return np.where(a < b, a, b)


@generated(_minimum)
def minimum(typing_context, a, b):
    """In every lane the minimum of ``a`` and ``b``; ``b`` where one of them is NaN."""

    def generate(context, builder, signature, arguments):
        a, b = arguments
        return builder.select(builder.fcmp_ordered("<", a, b), a, b)

    return PACK(PACK, PACK), generate


def _sum_pack(value):
    return (value[0] + value[2]) + (value[1] + value[3])


@generated(_sum_pack)
def sum_pack(typing_context, value):
    """Sum of the four numbers."""

    def generate(context, builder, signature, arguments):
        (value,) = arguments
        total = builder.fadd(value, _shuffled(builder, value, value, [2, 3, 0, 1]))
        total = builder.fadd(total, _shuffled(builder, total, total, [1, 0, 3, 2]))
        return builder.extract_element(total, _PLACE(0))

    return types.float64(PACK), generate


def _any_nonzero(value):
    return bool(np.any(value != 0.0))


@generated(_any_nonzero)
def any_nonzero(typing_context, value):
    """Whether one of the four numbers is not zero (or NaN)."""

    def generate(context, builder, signature, arguments):
        zero = ir.Constant(_VECTOR, [0.0] * LANES)
        mask = builder.fcmp_unordered("!=", arguments[0], zero)
        bits = builder.bitcast(mask, ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.IntType(LANES)(0))

    return types.boolean(PACK), generate


def _transpose_four(source, at, out, at0, at1, at2, at3):
    rows = np.stack([_lanes(source, at + LANES * k) for k in range(LANES)])
    for place, column in zip((at0, at1, at2, at3), rows.T, strict=True):
        _lanes(out, place)[:] = column


@generated(_transpose_four)
def transpose_four(typing_context, source, at, out, at0, at1, at2, at3):
    """Deal four lanes that follow each other at ``at``: each arm's to four places of ``out``."""

    def generate(context, builder, signature, arguments):
        rows = []
        for k in range(LANES):
            place = builder.add(arguments[1], ir.Constant(_INTEGER, LANES * k))
            pointer = _pointer(context, builder, signature.args[0], arguments[0], place)
            rows.append(load_lanes(builder, pointer))
        even = [_shuffled(builder, rows[k], rows[k + 1], [0, 4, 2, 6]) for k in (0, 2)]
        odd = [_shuffled(builder, rows[k], rows[k + 1], [1, 5, 3, 7]) for k in (0, 2)]
        columns = [_shuffled(builder, a, b, [0, 1, 4, 5]) for a, b in (even, odd)]
        columns += [_shuffled(builder, a, b, [2, 3, 6, 7]) for a, b in (even, odd)]
        for place, column in zip(arguments[3:], columns, strict=True):
            pointer = _pointer(context, builder, signature.args[2], arguments[2], place)
            store_lanes(builder, column, pointer)
        return context.get_dummy_value()

    places = [types.intp] * LANES
    return types.void(source, types.intp, out, *places), generate
