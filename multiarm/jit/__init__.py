"""Compiled code: the only package that knows Numba's internals.

- :mod:`~multiarm.jit.kernels`: functions that are compiled, cached and inlined into each other;
- :mod:`~multiarm.jit.interpretation`: the same kernels as plain Python, to step through;
- :mod:`~multiarm.jit.linking`: how their parts become one unit of machine code;
- :mod:`~multiarm.jit.pointers`: calls through addresses, and callbacks into Python;
- :mod:`~multiarm.jit.lazy`: functions that are compiled at their first call;
- :mod:`~multiarm.jit.compilation`: how long threads wait for the compiler;
- :mod:`~multiarm.jit.ahead`: compilation ahead of the first call, in several processes;
- :mod:`~multiarm.jit.structs`: many arrays and numbers as one argument, read and set by name;
- :mod:`~multiarm.jit.rows`: numbers of one array, read and set by name;
- :mod:`~multiarm.jit.simd`: the numbers of four arms in one vector register;
- :mod:`~multiarm.jit.vectors`: vectors, rotations and symmetric matrices as tuples.

What these take from Numba without its promise to keep it is listed in
``tests/jit/test_numba_internals.py``, which says what is missing when a version of Numba drops it.
"""
