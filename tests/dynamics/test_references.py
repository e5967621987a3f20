"""Claims about structs that kernels reach by an address."""

from __future__ import annotations

import gc
import weakref

import numpy as np

from multiarm.dynamics.references import Reference
from multiarm.dynamics.variables import ModeStructs


class Owner:
    """Of a struct."""

    def __init__(self) -> None:
        self.struct = np.zeros(4, dtype=np.int64)


def test_a_struct_lives_as_long_as_any_numbers_that_refer_to_it():
    owner, numbers = Owner(), ModeStructs(active=True)
    numbers.refer(full=Reference(owner.struct, owner))
    address, life = owner.struct.ctypes.data, weakref.ref(owner)
    copy = numbers.copy()
    del owner, numbers
    gc.collect()
    assert life() is not None and copy.active and copy.full == address
    copy.refer(full=Reference(np.zeros(4, dtype=np.int64), None))
    gc.collect()
    assert life() is None
