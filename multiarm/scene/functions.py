"""Python functions as parts of a scene: the callable itself, or a text that says where it is.

A scene must be written to a file and read again, also where the function's module is absent.  So a
function is *named* in a scene, and looked up only when a system is compiled:

* ``bowls.py:paraboloid``, a file (a relative path starts at the scene's folder);
* ``my_package.bowls:paraboloid``, a module that Python can import.

Such a text is a :class:`multiarm.scene.user_code.FunctionReference`.

A callable given in Python is written as the second form, or as the first if it belongs to the
script that runs.  One that has no name of its own, such as a lambda, is written with its name in
angle brackets: the text tells what it was, but it cannot be looked up again.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, PlainSerializer

from multiarm.scene.user_code import FunctionReference, LoadedFunction
from multiarm.scene.values import Parts, fault
from multiarm.scene.words import shown

__all__ = [
    "UserFunction",
    "function_references",
    "function_text",
    "located_function",
    "parts_of",
]

_TEXT = re.compile(r"[^:\s][^\n]*:[^:\s][^:\n]*")


def function_text(function: Callable | str) -> str:
    """Return ``module:name`` or ``file.py:name`` for a function; a text is returned as it is."""
    if isinstance(function, LoadedFunction):
        function = function.reference
    if isinstance(function, str):
        return str(function)
    module = str(getattr(function, "__module__", None) or type(function).__module__)
    name = getattr(function, "__qualname__", None)
    if name is None:
        return f"{module}:<{type(function).__qualname__} object>"
    if "<" in name or getattr(function, "__self__", None) is not None:
        return f"{module}:<{name.replace('<', '').replace('>', '')}>"
    script = getattr(sys.modules.get("__main__"), "__file__", None)
    if module == "__main__" and script is not None:
        module = str(Path(script).resolve())
    return f"{module}:{name}"


def located_function(function: Callable | str | None, folder: Path) -> Callable | str | None:
    """Return the function with the path of its file made absolute, a relative one below folder."""
    return function.below(folder) if isinstance(function, FunctionReference) else function


def function_references(value: Any, parts: Parts = ()) -> Iterator[tuple[Parts, FunctionReference]]:
    """The functions that are named, and not loaded, below a part of a scene, with their places."""
    if isinstance(value, FunctionReference):
        yield parts, value
    for key, item in parts_of(value):
        yield from function_references(item, (*parts, key))


def parts_of(value: Any) -> Iterator[tuple[str | int, Any]]:
    """What is directly below a part of a scene, by key or number."""
    if isinstance(value, BaseModel):
        yield from ((name, getattr(value, name)) for name in type(value).model_fields)
    elif isinstance(value, tuple):
        yield from enumerate(value)


def _function(value: Any) -> Any:
    if callable(value):
        return value
    if isinstance(value, str) and _TEXT.fullmatch(value):
        return FunctionReference(value)
    raise fault(
        "must be a Python function, or name one as 'file.py:name' or 'package.module:name', got "
        f"{shown(value)}"
    )


UserFunction = Annotated[
    Any, BeforeValidator(_function), PlainSerializer(function_text, return_type=str)
]
