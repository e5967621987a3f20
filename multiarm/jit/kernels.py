"""Kernels: functions that Numba compiles, caches and compiles into each other.

A kernel is compiled whole when Python calls it, or when its address is taken; where another kernel
calls it, it becomes part of that one.  Plain ones run as Python when Python calls them.  The code
of a whole is cached on disk and stays fresh until its sources change (:mod:`multiarm.jit.sources`);
where it has no file, as in a notebook, it is compiled once in each process.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types
from numba.core import event

from multiarm.jit.compilation import compiling, start_compiling, stop_compiling
from multiarm.jit.interpretation import INTERPRETED
from multiarm.jit.linking import PART, WHOLE
from multiarm.jit.sources import stamp_of, stamp_of_constants

# Types of arguments, to annotate kernels with that Python calls: these can be compiled ahead.
INT, NUMBER, TRUTH = types.int64, types.float64, types.boolean
INTS, NUMBERS, TABLE = types.int64[::1], types.float64[::1], types.float64[:, ::1]


def named_tuple_of(kind: type, *fields: types.Type) -> Any:
    """Type of an argument that is a ``NamedTuple`` of this class, from the types of its fields."""
    return types.NamedTuple(fields, kind)


class Kernel:
    """A compiled function: whole when it is called from Python, part of others when from kernels.

    Each of the two is compiled at its first use.
    """

    def __init__(self, function: Callable, plain: bool = False, **options: Any) -> None:
        self.py_func = function
        self._plain = plain
        self.is_called_by_address = not options.get("no_cfunc_wrapper", True)
        functools.update_wrapper(self, function)
        if INTERPRETED:
            return
        self._stamp = stamp_of(function)
        # As in NumPy, a division by zero gives inf or NaN, which the callers look for.  Numba hands
        # inlining and contraction on to what a kernel calls, where that does not state its own.
        common = {"error_model": "numpy", "no_cfunc_wrapper": True}
        self._options = {**common, "forceinline": False, "fastmath": False, **options}
        self._whole: Any = None
        self._wait: Callable[[], object] | None = None
        self._making = threading.Lock()

    @functools.cached_property
    def _part(self) -> Any:
        """Numba's dispatcher of the function as a part of others; cached wholes need none."""
        part = {**self._options, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        return njit(**PART, **part)(self.py_func)

    @property
    def _numba_type_(self) -> types.Type:
        """What Numba reads where another kernel names this one."""
        return self._part._numba_type_

    @property
    def whole(self) -> Any:
        """Numba's dispatcher of the function as a whole, cached while its sources are the same."""
        if self._whole is None or self._wait is not None:
            self._make_whole()
        return self._whole

    def _make_whole(self) -> None:
        """Make the dispatcher, or wait for who compiles it: one thread does, others wait for it."""
        with compiling(), self._making:
            if self._wait is not None:
                self._wait()
                self._wait = None
            if self._whole is None:
                caches = bool(self._stamp)
                whole: Any = njit(cache=caches, **WHOLE, **self._options)(self.py_func)
                if caches:
                    file = _cache_file(whole)
                    file._source_stamp = self._stamp + stamp_of_constants(self.py_func)
                    file._load_index = _or_nothing(file._load_index)
                    file._load_data = _or_missing(file._load_data)
                self._whole = whole

    def __call__(self, *arguments: Any) -> Any:
        """Run the whole, or a plain kernel's Python."""
        if INTERPRETED:
            with np.errstate(all="ignore"):
                result = self.py_func(*arguments)
            # a division by Python's zero raises, by NumPy's it gives inf or NaN
            return np.float64(result) if type(result) is float else result
        return self.py_func(*arguments) if self._plain else self.whole(*arguments)

    def expect_in_cache(self, wait: Callable[[], object]) -> None:
        """Somebody else compiles this kernel; its next use calls ``wait()`` first."""
        self._wait = wait

    def is_compiled(self, arguments: tuple[types.Type, ...]) -> bool:
        """Whether this process has machine code of the whole for these types."""
        return self._whole is not None and arguments in self._whole.overloads

    def is_cached(self) -> bool:
        """Whether fresh machine code is in the cache, or is not needed."""
        return INTERPRETED or bool(self._stamp and _cache_file(self.whole)._load_index())


class _CompilationListener(event.Listener):
    """Counts the times of Numba's compilations; parts of a kernel are announced within its own."""

    def on_start(self, event: event.Event) -> None:
        start_compiling()

    def on_end(self, event: event.Event) -> None:
        stop_compiling()


event.register("numba:compile", _CompilationListener())


def _decorator(**options: Any) -> Callable[[Callable], Kernel]:
    return functools.partial(Kernel, **options)


# Kernels that make no arrays are compiled without Numba's reference counting (`_nrt`): it would
# count every slice they hand to each other, which doubles the cost of an evaluation.
kernel = _decorator(_nrt=False)
inlined = _decorator(_nrt=False, forceinline=True)
# Few scalar operations, for which Python need not wait for the compiler.
plain = _decorator(plain=True, _nrt=False)
# A product that is added at once is rounded once, where the processor can.
fused = _decorator(_nrt=False, forceinline=True, fastmath={"contract"})
# A kernel during which other threads may run Python; callbacks wait for their turn.
unlocked = _decorator(_nrt=False, nogil=True)
# For kernels that do make arrays; they must not return them to one of the other kind.
allocating = _decorator(_nrt=True)
# A large kernel that others call by its address (:mod:`multiarm.jit.pointers`): compiled once, and
# not once more into every function above it, which is most of what compiling would cost.
cfunc = _decorator(_nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=False)


def _cache_file(dispatcher: Any) -> Any:
    """Where Numba keeps a kernel's code; Numba has no public name for it."""
    return dispatcher._cache._cache_file


def _or_nothing(load: Callable) -> Callable:
    """An index of cached code that cannot be read, such as one of another version, is empty."""

    def guarded() -> dict:
        try:
            return load()
        except Exception:
            return {}

    return guarded


def _or_missing(load: Callable) -> Callable:
    """Cached code that cannot be read, such as a file cut short by a full disk, is missing."""

    def guarded(name: str) -> Any:
        try:
            return load(name)
        except Exception as error:
            raise OSError(f"{name} cannot be read: {error}") from error

    return guarded


@inlined
def copy(source, out):
    """Write ``source`` into ``out``, vectors of one length (slice assignment would allocate)."""
    for i in range(out.size):
        out[i] = source[i]


@inlined
def clear(out):
    """Write zeros into a vector (slice assignment takes long to compile)."""
    for i in range(out.size):
        out[i] = 0.0


@inlined
def larger(size, x):
    """The larger of a magnitude and ``|x|``; NaN where either is (``max`` would drop it)."""
    return abs(x) if abs(x) > size or x != x else size


@kernel
def greatest(vector):
    """Largest magnitude of a vector's entries; NaN where any is."""
    size = 0.0
    for k in range(vector.size):
        size = larger(size, vector[k])
    return size
