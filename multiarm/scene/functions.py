"""Python functions as parts of a scene: the callable itself, or a text that says where it is.

A scene must be written to a file and read again, also where the function's module is absent.  So a
function is *named* in a scene, and looked up only when a system is compiled:

* ``bowls.py:paraboloid``, a file (a relative path starts at the scene's folder);
* ``my_package.bowls:paraboloid``, a module that Python can import.

A callable given in Python is written as the second form, or as the first if it belongs to the
script that runs.  One that has no name of its own, such as a lambda, is written with its name in
angle brackets: the text tells what it was, but it cannot be looked up again.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer

from multiarm.scene.base import absolute
from multiarm.scene.values import fault
from multiarm.scene.words import shown

__all__ = ["UserFunction", "function_text", "located_function"]

_TEXT = re.compile(r"[^:\s][^\n]*:[^:\s][^:\n]*")


def function_text(function: Callable | str) -> str:
    """Return ``module:name`` or ``file.py:name`` for a function; a text is returned as it is."""
    if isinstance(function, str):
        return function
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
    if not isinstance(function, str):
        return function
    path, _, name = function.rpartition(":")
    return f"{absolute(Path(path), folder)}:{name}" if path.endswith(".py") else function


def _function(value: Any) -> Any:
    if callable(value):
        return value
    if isinstance(value, str) and _TEXT.fullmatch(value):
        return value
    raise fault(
        "must be a Python function, or name one as 'file.py:name' or 'package.module:name', got "
        f"{shown(value)}"
    )


UserFunction = Annotated[
    Any, BeforeValidator(_function), PlainSerializer(function_text, return_type=str)
]
