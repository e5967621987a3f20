"""Compiling ahead: kernels are compiled in processes of their own, into the cache.

A process compiles one kernel at a time, since Numba holds a lock.  Kernels whose argument types are
known before the first call, those called by address and those with annotated arguments, can be
compiled in several processes at once; the process that needs them loads them from the cache.

``python -m multiarm.jit.ahead`` is such a process.  It reads the names of kernels, one in a line,
and answers each with a line when it is in the cache.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from importlib import import_module
from queue import Empty, SimpleQueue
from typing import get_type_hints

from numba import types

from multiarm.errors import MultiarmError
from multiarm.jit.kernels import Kernel
from multiarm.jit.pointers import CFUNC, address_of
from multiarm.jit.sources import kernel_modules


def all_kernels() -> list[Kernel]:
    """All kernels of the package that can be compiled ahead, the largest ones first."""
    values = (v for name in kernel_modules() for v in vars(import_module(name)).values())
    kernels = {name_of(v): v for v in values if isinstance(v, Kernel)}
    known = (kernel for kernel in kernels.values() if argument_types(kernel) is not None)
    # what Python calls calls everything else; of the others, more code takes longer
    return sorted(known, key=lambda k: (k.is_called_by_address, -_size(k)))


def argument_types(kernel: Kernel) -> tuple[types.Type, ...] | None:
    """Numba's types of a kernel's arguments; None where they are known at a call only."""
    if kernel.is_called_by_address:
        return CFUNC.args
    count = kernel.py_func.__code__.co_argcount
    hints = get_type_hints(kernel.py_func) if kernel.py_func.__annotations__ else {}
    hinted = tuple(hint for hint in hints.values() if isinstance(hint, types.Type))
    return hinted if hinted and len(hinted) == count else None


def name_of(kernel: Kernel) -> str:
    """``module:function``."""
    return f"{kernel.py_func.__module__}:{kernel.py_func.__name__}"


def compile_all(
    kernels: Iterable[Kernel],
    processes: int | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> None:
    """Compile kernels that are not in the cache.

    Parameters
    ----------
    kernels : iterable of Kernel
    processes : int, optional
        By default as many as there are processors.
    progress : callable
        Called with the name of each kernel that is in the cache now.

    Raises
    ------
    MultiarmError
        When a process ends without having compiled its kernel.
    """
    names: SimpleQueue[str] = SimpleQueue()
    waiting = 0
    for kernel in kernels:
        if kernel.is_cached():
            progress(name_of(kernel))
        else:
            names.put(name_of(kernel))
            waiting += 1
    count = min(processes or processors(), waiting)
    with ThreadPoolExecutor(max(count, 1)) as threads:
        for done in [threads.submit(_work_off, names, progress) for _ in range(count)]:
            done.result()


@cache
def compile_ahead(*kernels: Kernel) -> None:
    """Compile kernels in the background that are not in the cache; their first call waits for it.

    Looks once in each process.  Does nothing where there is only one processor, or where no process
    can be started.
    """
    missing = [kernel for kernel in kernels if not kernel.is_cached()]
    if not missing or processors() == 1 or not sys.executable:
        return
    with suppress(OSError):
        process = _start(subprocess.DEVNULL)
        assert process.stdin is not None
        process.stdin.write("".join(f"{name_of(kernel)}\n" for kernel in missing))
        process.stdin.close()
        for kernel in missing:
            kernel.expect_in_cache(process.wait)


def _work_off(names: SimpleQueue[str], progress: Callable[[str], None]) -> None:
    """Let one process compile kernels until none is left."""
    with _start(subprocess.PIPE) as process:
        assert process.stdin is not None and process.stdout is not None
        while (name := _next(names)) is not None:
            print(name, file=process.stdin, flush=True)
            if process.stdout.readline().strip() != name:
                process.kill()
                raise MultiarmError(
                    f"{name} could not be compiled in a process of its own; see the messages above"
                )
            progress(name)
        process.stdin.close()


def _next(names: SimpleQueue[str]) -> str | None:
    """A name that no other process works on; None when there is none left."""
    try:
        return names.get_nowait()
    except Empty:
        return None


def _start(stdout: int) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "multiarm.jit.ahead"]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=stdout, text=True)


def processors() -> int:
    """Number of processors that this process may use, by its affinity and a container's share."""
    from joblib import cpu_count

    return cpu_count()


def _size(kernel: Kernel) -> int:
    return len(kernel.py_func.__code__.co_code)


def _serve() -> None:
    """Compile the kernels that are named on standard input."""
    for line in sys.stdin:
        module, _, name = line.strip().partition(":")
        kernel = getattr(import_module(module), name)
        if kernel.is_called_by_address:
            address_of(kernel)
        else:
            kernel.whole.compile(argument_types(kernel))
        print(line.strip(), flush=True)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):  # a Ctrl-C is meant for the process that started this one
        _serve()
