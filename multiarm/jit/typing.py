"""Types of built-in operations: found once for each combination of operand types.

For every ``a * b`` Numba tries all implementations of the operator until one fits the operands'
types, and does so again at every place where the same types meet.  That takes a third of the time
of compiling kernels, which consist of such operations.  The typing context here remembers what it
found.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core.typing import Context

_SIGNATURES: dict[tuple, Any] = {}


class RememberingContext(Context):
    """Numba's typing context with a memory of the signatures of built-in functions.

    Functions of Numba's library and operators always have the same signature for the same types.
    """

    @classmethod
    def around(cls, context: Context) -> RememberingContext:
        """The same context, which shares all of its state, with the memory."""
        other = cls.__new__(cls)
        other.__dict__ = context.__dict__
        return other

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        """Signature of a call of ``func``; Numba's name for it."""
        # others: kernels, methods, and by name what depends on values besides types
        built_in = isinstance(func, types.Function) or not isinstance(func, (types.Type, str))
        if kws or not built_in:
            return super().resolve_function_type(func, args, kws)
        call = func, tuple(args)
        signature = _SIGNATURES.get(call)
        if signature is None:
            signature = super().resolve_function_type(func, args, kws)
            if signature is not None:
                _SIGNATURES[call] = signature
        return signature
