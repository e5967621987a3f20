"""Compiled code: the only package that knows Numba's internals.

- :mod:`~multiarm.jit.kernels`: functions that are compiled, cached and inlined into each other;
- :mod:`~multiarm.jit.sources`: the files that cached code depends on;
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

Code reaches code in five ways.  Take the first that serves.

*A part of its caller*: what a kernel calls becomes part of it.  ``@kernel`` leaves to LLVM whether
it is inlined: once in each whole where it is large and called from several places.  ``@inlined`` is
for what must live in registers, such as vectors and views; each of its calls is code anew, so that
large ones make wholes large.  ``@fused`` is the same, with products that are added in one rounding.

*By address* (``@cfunc`` and ``call_cfunc``): for what is large, is called by several wholes, or
differs between scenes.  It is compiled once, and another function may take its place in a table.
All have one signature, a struct and two numbers, since an address does not tell which it has;
what else is to be passed stands in the struct.

*At the first call* (:class:`~multiarm.jit.lazy.LazyFunction`): by address, for what few scenes
need.

*Into Python* (:class:`~multiarm.jit.pointers.PythonCallback`): what users write, and Pinocchio.

*Generated*: what Numba cannot express, such as fields by name, packs and addresses, is written as
LLVM's instructions: operations by :func:`~multiarm.jit.interpretation.generated` beside their twin
in Python, fields as attributes of a type of Numba (:class:`~multiarm.jit.structs.View`,
:class:`~multiarm.jit.rows.Row`).  Only this package does so.

What these take from Numba without its promise to keep it is listed in
``tests/jit/test_numba_internals.py``, which says what is missing when a version of Numba drops it.
"""
