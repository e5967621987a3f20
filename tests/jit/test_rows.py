"""Claims about rows of named numbers, by NumPy's views of the same array."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

from multiarm.jit.kernels import kernel
from multiarm.jit.rows import (
    Axes,
    Number,
    Pair,
    Rotation,
    Symmetric,
    Vector,
    _python_row,
    fields_of,
    lanes_of,
    offset_of,
    row_of,
    width,
)
from multiarm.jit.simd import LANES


class Every(NamedTuple):
    """One field of each sort."""

    number: Number
    vector: Vector
    pair: Pair
    symmetric: Symmetric
    rotation: Rotation
    axes: Axes


open_row, open_lanes = row_of(Every), lanes_of(Every)


@kernel
def copy_row(source, out):
    read, written = open_row(source), open_row(out)
    written.number, written.vector, written.pair = read.number, read.vector, read.pair
    written.symmetric, written.rotation, written.axes = read.symmetric, read.rotation, read.axes


@kernel
def copy_lanes(source, out, at):
    read, written = open_lanes(source, at), open_lanes(out, at)
    written.number, written.vector, written.pair = read.number, read.vector, read.pair
    written.symmetric, written.rotation, written.axes = read.symmetric, read.rotation, read.axes


@kernel
def turn_row(row):
    """Transpose both rotations by reading the one and writing the other."""
    opened = open_row(row)
    opened.rotation, opened.axes = opened.axes, opened.rotation


def test_fields_follow_each_other_and_cover_the_row():
    row = np.arange(width(Every), dtype=float)
    fields = fields_of(Every, row)
    assert [offset_of(Every, name) for name in Every._fields] == [0, 1, 4, 10, 16, 25]
    assert fields.number == 0 and fields.vector.tolist() == [1, 2, 3]
    np.testing.assert_array_equal(fields.rotation.ravel(), row[16:25])
    np.testing.assert_array_equal(fields.axes.T.ravel(), row[25:34])
    fields.axes[:] = np.eye(3)  # a view
    np.testing.assert_array_equal(row[25:34], np.eye(3).ravel())


def test_kernels_read_and_write_what_the_fields_are(rng):
    row, out = rng.normal(size=(2, width(Every)))
    copy_row(row, out)
    np.testing.assert_array_equal(out, row)
    before = fields_of(Every, row.copy())
    turn_row(row)
    after = fields_of(Every, row)
    np.testing.assert_array_equal(after.rotation, before.axes)
    np.testing.assert_array_equal(after.axes, before.rotation)
    np.testing.assert_array_equal(after.pair, before.pair)


def test_python_runs_the_source_of_kernels_on_rows(rng):
    row = rng.normal(size=width(Every))
    copied, out = row.copy(), np.zeros_like(row)
    copy_row.py_func(row, out)
    np.testing.assert_array_equal(out, row)
    turn_row(row)
    turn_row.py_func(copied)
    np.testing.assert_array_equal(copied, row)


def test_lanes_are_copied_where_they_are_and_nowhere_else(rng):
    size = LANES * width(Every)
    row, out = rng.normal(size=3 * size), np.zeros(3 * size)
    copy_lanes(row, out, size)
    np.testing.assert_array_equal(out[size : 2 * size], row[size : 2 * size])
    assert not np.any(out[:size]) and not np.any(out[2 * size :])


@pytest.mark.parametrize("lanes", [1, LANES])
def test_interpreted_rows_are_the_same_and_know_where_they_end(lanes, rng):
    size = lanes * width(Every)
    numbers = rng.normal(size=size)
    opened = _python_row(Every, lanes)(numbers, 0)
    fields = fields_of(Every, numbers.reshape(-1, lanes).T)
    columns = [[np.ravel(entry)[0] for entry in column] for column in opened.rotation]
    np.testing.assert_array_equal(np.transpose(columns), fields.rotation[0])
    opened.vector = opened.pair[1]
    np.testing.assert_array_equal(fields.vector, fields.pair[:, 3:])
    with pytest.raises(IndexError):
        _python_row(Every, lanes)(numbers, 1)


def test_a_class_that_is_defined_again_has_its_own_fields():
    def first_of(*names):
        open_again = row_of(NamedTuple("Again", [(name, Number) for name in names]))
        return njit(lambda row: open_again(row).first)(np.arange(2.0))

    assert (first_of("first", "second"), first_of("second", "first")) == (0.0, 1.0)
