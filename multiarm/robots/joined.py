r"""Terms of robots that are joined to each other, which the equations eliminate together.

Each robot has its terms where its backend keeps them.  The block of several robots has, copied from
there at every evaluation,

.. math::
    M = \operatorname{blkdiag}(M_1, M_2, \dots), \qquad
    J = [J_1\; J_2\; \dots], \qquad
    b = (b_1, b_2, \dots) ,

or the factors of the inertia in place of M where all robots have them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from multiarm.jit.kernels import kernel
from multiarm.jit.rows import Number, row_of, width
from multiarm.jit.structs import floats_at
from multiarm.robots.terms import FACTOR_WIDTH, MatrixAddress, TermAddresses


class MatrixCopy(NamedTuple):
    """From where to where a matrix is copied: a row of int64."""

    source: Number
    source_stride: Number  # in numbers
    target: Number
    target_stride: Number
    rows: Number
    columns: Number


_open_copy = row_of(MatrixCopy)


@kernel
def copy_matrices(copies):
    """Copy matrices, rows of :class:`MatrixCopy`."""
    for k in range(copies.shape[0]):
        matrix = _open_copy(copies[k])
        rows, columns = matrix.rows, matrix.columns
        here, there = matrix.source_stride, matrix.target_stride
        source = floats_at(matrix.source, (rows - 1) * here + columns)
        target = floats_at(matrix.target, (rows - 1) * there + columns)
        for a in range(rows):
            for b in range(columns):
                target[a * there + b] = source[a * here + b]


def table_of_copies(copies: Sequence[MatrixCopy]) -> np.ndarray:
    """The copies for kernels, shape (k, 6)."""
    return np.array(copies, dtype=np.int64).reshape(-1, width(MatrixCopy))


class JoinedMatrix:
    """A block diagonal matrix of those of the robots.

    Parameters
    ----------
    parts : sequence of MatrixAddress
        The matrices of the robots.
    counts : sequence of int
        Number of the rows of each.

    Attributes
    ----------
    address : MatrixAddress
        Of the matrix; valid while this lives.
    copies : list of MatrixCopy
        They fill it.
    """

    def __init__(self, parts: Sequence[MatrixAddress], counts: Sequence[int]) -> None:
        first = np.cumsum([0, *counts]).tolist()
        self._numbers = np.zeros((first[-1], first[-1]))
        self.address = MatrixAddress(self._numbers.ctypes.data, first[-1])
        self.copies = [
            MatrixCopy(*part, *self.address.from_joint(begin), end - begin, end - begin)
            for part, (begin, end) in zip(parts, pairwise(first), strict=True)
        ]


class JoinedTerms:
    """The terms of a block of several robots.

    Parameters
    ----------
    parts : sequence of TermAddresses
        The terms of the robots.
    counts : sequence of int
        Number of the joints of each.

    Attributes
    ----------
    addresses : TermAddresses
        Of the block; valid while this lives.
    copies : list of MatrixCopy
        They fill the terms.
    """

    def __init__(self, parts: Sequence[TermAddresses], counts: Sequence[int]) -> None:
        first = np.cumsum([0, *counts]).tolist()
        self._inertia = JoinedMatrix([part.inertia_matrix for part in parts], counts)
        self._lists = {
            "jacobian": np.zeros((first[-1], 6)),
            "bias": np.zeros(first[-1]),
            "gravity_torque": np.zeros(first[-1]),
        }
        factored = all(part.factors for part in parts)
        if factored:
            self._lists["factors"] = np.zeros((first[-1], FACTOR_WIDTH))
        lists = {name: numbers.ctypes.data for name, numbers in self._lists.items()}
        self.addresses = TermAddresses(*self._inertia.address, **lists)
        self.copies = [] if factored else list(self._inertia.copies)
        for part, (begin, end) in zip(parts, pairwise(first), strict=True):
            target = self.addresses.from_joint(begin)
            for name, numbers in self._lists.items():
                size = numbers[begin:end].size
                source, place = getattr(part, name), getattr(target, name)
                self.copies.append(MatrixCopy(source, size, place, size, rows=1, columns=size))
