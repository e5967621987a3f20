"""``multiarm warmup``: compile the kernels that any scene may need."""

from __future__ import annotations

import time
from typing import Annotated

from multiarm.cli.options import option
from multiarm.errors import MultiarmError
from multiarm.notation import count_of
from multiarm.terminal.console import output
from multiarm.terminal.progress import Progress


def warmup(
    workers: Annotated[
        int | None,
        option("Processes, each with a kernel at a time.", default="one a processor", min=1),
    ] = None,
) -> None:
    """Compile the kernels that any scene may need, on all processors.

    Scenes compile what they need when they first run; after this, they find it in the cache.
    Needed once after installing or changing multiarm, and by no means necessary.
    """
    with Progress() as progress:
        from multiarm.jit.ahead import all_kernels, compile_all
        from multiarm.jit.interpretation import INTERPRETED

        if INTERPRETED:
            raise MultiarmError(
                "NUMBA_DISABLE_JIT is set, so that kernels are interpreted and there is nothing to "
                "compile; unset it to fill the cache"
            )
        began, kernels = time.perf_counter(), all_kernels()
        cached = sum(kernel.is_cached() for kernel in kernels)
        done = 0

        def note(name: str) -> None:
            nonlocal done
            done += 1
            progress(done, len(kernels), f"compiling, done: {name.rpartition(':')[2]}")

        compile_all(kernels, workers, note)
    took = time.perf_counter() - began
    output().print(
        f"in the cache: {count_of(len(kernels), 'kernel')}, {len(kernels) - cached} of them "
        f"compiled now, in {took:.1f} s"
    )
