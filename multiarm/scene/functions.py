"""User functions in a scene, and the one place that decides whether one may be loaded.

A scene must be written to a file and read again, also where the function's module is absent.  So a
function is *named* in a scene, and looked up only when a system is compiled or a quantity measured:

* ``bowls.py:paraboloid``, a file (a relative path starts at the scene's folder);
* ``my_package.bowls:paraboloid``, a module that Python can import.

A callable given in Python is written as the second form, or as the first if it belongs to the
script that runs.  One without a name, such as a lambda, is written with its name in angle brackets:
the text says what it was, but it cannot be looked up again.

A function is loaded only

* from a ``.py`` file, which for a scene or sweep file must lie in its folder or below, or from a
  module that is installed, but not from Python's standard library;
* by a plain name, and not if the standard library defines it: ``tools.py:system`` after
  ``from os import system`` is refused as ``os:system`` is.

These rules keep a file without code from reaching functions that delete or start something.  Loaded
code can do anything: inspecting a file from an unknown author loads none.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import itertools
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, PlainSerializer, WithJsonSchema

from multiarm.errors import USER_FAULTS, ModelError
from multiarm.scene.faults import Parts, fault, shown


class FunctionReference(str):
    """The text that names a function, as it is in a file; the function is not loaded."""

    __slots__ = ()

    @property
    def home(self) -> str:
        """Its file, which ends in ``.py``, or its module."""
        return self.rpartition(":")[0]

    @property
    def name(self) -> str:
        """Its name there."""
        return self.rpartition(":")[2]

    @property
    def file(self) -> Path | None:
        """Its file; None where it is in a module."""
        return Path(self.home) if self.home.endswith(".py") else None


class LoadedFunction:
    """A function that was loaded, and the reference by which a file names it."""

    def __init__(self, reference: FunctionReference, function: Callable) -> None:
        self.reference, self.function = reference, function
        self.__qualname__ = str(reference)  # its name in messages

    def __call__(self, *arguments):
        """Call the function."""
        return self.function(*arguments)


def function_text(function: Callable | str) -> str:
    """``module:name`` or ``file.py:name`` for a function; a text is returned as it is."""
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


_REFERENCE = r"[^:\s][^\n]*:[^:\s][^:\n]*"


def _function(value: Any) -> Any:
    if callable(value):
        return value
    if isinstance(value, str) and re.fullmatch(_REFERENCE, value):
        return FunctionReference(value)
    raise fault(
        "must be a Python function, or name one as 'file.py:name' or 'package.module:name', got "
        f"{shown(value)}"
    )


UserFunction = Annotated[
    Any,
    BeforeValidator(_function),
    PlainSerializer(function_text, return_type=str),
    WithJsonSchema({"type": "string", "pattern": f"^{_REFERENCE}$"}),
]


# --- functions and files within a part of a scene ------------------------------------------------


def nodes(value: Any, parts: Parts = ()) -> Iterator[tuple[Parts, Any]]:
    """A part of a scene and all parts below it, with their places, from outside to inside."""
    yield parts, value
    for key, item in _items(value):
        yield from nodes(item, (*parts, key))


def function_references(value: Any, parts: Parts = ()) -> Iterator[tuple[Parts, FunctionReference]]:
    """The functions that are named, and not loaded, in a part of a scene, with their places."""
    return ((at, one) for at, one in nodes(value, parts) if isinstance(one, FunctionReference))


def mapped(value: Any, change: Callable[[Any, Parts], Any], parts: Parts = ()) -> Any:
    """A part of a scene with ``change(leaf, place)`` in place of every leaf; as it is if equal."""
    parts_of: dict[Any, Any] = dict(_items(value))
    if not parts_of:
        return change(value, parts)
    made = {key: mapped(item, change, (*parts, key)) for key, item in parts_of.items()}
    changes = {key: item for key, item in made.items() if item is not parts_of[key]}
    if not changes:
        return value
    if isinstance(value, BaseModel):  # each change is of the sort that was validated
        return BaseModel.model_copy(value, update=changes)
    return made if isinstance(value, Mapping) else tuple(made.values())


def located(value: Any, folder: Path) -> Any:
    """A part of a scene with file paths made absolute, relative ones below ``folder``."""

    def absolute(leaf: Any, _parts: Parts) -> Any:
        if isinstance(leaf, Path):
            return (folder / leaf.expanduser()).resolve()
        if isinstance(leaf, FunctionReference) and leaf.file is not None:
            return FunctionReference(f"{absolute(leaf.file, ())}:{leaf.name}")
        return leaf

    return mapped(value, absolute)


def _items(value: Any) -> Iterator[tuple[str | int, Any]]:
    """The parts of a part of a scene, with their keys or numbers."""
    if isinstance(value, BaseModel):
        yield from value
    elif isinstance(value, Mapping):
        yield from value.items()
    elif isinstance(value, tuple):
        yield from enumerate(value)


# --- loading -------------------------------------------------------------------------------------


def reference_fault(reference: FunctionReference, folder: Path | None = None) -> str:
    """Why a function may not be loaded by this reference; empty where it may.

    Parameters
    ----------
    reference : FunctionReference
        With an absolute path, if it names a file.
    folder : Path, optional
        That of the file in which it is written: a function's file lies there or below.
    """
    cannot = f"cannot load the function '{reference}': "
    if reference.name.startswith("<"):
        return (
            f"the function '{reference}' has no name by which it can be found again; give the "
            "function itself, or name one as 'file.py:name' or 'package.module:name'"
        )
    if not reference.name.isidentifier():
        return (
            f"{cannot}{reference.name!r} is not a plain name; name a function that stands in "
            f"{reference.home} itself"
        )
    if reference.file is None:
        if _is_standard(reference.home):
            return (
                f"{cannot}{reference.home!r} belongs to Python's standard library; name a function "
                "in a .py file next to the scene or in an installed package"
            )
        return ""
    if folder is not None and not reference.file.resolve().is_relative_to(folder.resolve()):
        return (
            f"{cannot}its file is not in the folder {folder} or below; put it there, or name an "
            "installed module as 'package.module:name'"
        )
    return ""


def load_function(given: Callable | FunctionReference) -> Callable:
    """The function to which a reference leads; a function is returned as it is.

    Raises
    ------
    ModelError
        When it may not be loaded; when there is no such file, module or name; when loading fails.
    """
    if not isinstance(given, FunctionReference):
        return given
    reason = reference_fault(given)
    if reason:
        raise ModelError(reason)
    home, name, file = given.home, given.name, given.file
    if file is not None and not file.is_file():
        raise ModelError(
            f"cannot load the function '{given}': there is no file {file}; correct the path, "
            "which starts at the scene's folder"
        )
    try:
        module = importlib.import_module(home) if file is None else _file_module(file)
    except USER_FAULTS as error:
        raise ModelError(
            f"cannot load the function '{given}': {type(error).__name__}: {error}; correct the "
            "module (functions are named 'file.py:name' or 'package.module:name')"
        ) from error
    if not hasattr(module, name):
        raise ModelError(f"there is no {name!r} in {home}; {_functions_in(module)}")
    found = getattr(module, name)
    if not callable(found):
        raise ModelError(f"{name!r} in {home} is not a function; {_functions_in(module)}")
    if _is_standard(_home_of(found)):
        raise ModelError(
            f"cannot load the function '{given}': it is one of {_home_of(found)!r}, of Python's "
            "standard library; name a function that is defined outside of it"
        )
    return found


def _is_standard(module: str) -> bool:
    root = module.partition(".")[0]
    return root in sys.stdlib_module_names or root in sys.builtin_module_names


def _home_of(function: Callable) -> str:
    """The module that defines a function, or what a partial one calls, or the type of an object."""
    while isinstance(function, functools.partial):
        function = function.func
    return str(getattr(function, "__module__", None) or type(function).__module__)


_COUNT = itertools.count()


class _Source(SourceFileLoader):
    """Compiles a file each time: kept byte code is found stale by time and size alone."""

    def get_code(self, fullname: str) -> CodeType:
        """The code of the file as it is now."""
        return self.source_to_code(self.get_data(self.path), self.path)


def _file_module(path: Path) -> ModuleType:
    """Run a file as a module each time; it is not left among the imported ones."""
    name = f"functions_of_{path.stem}_{next(_COUNT)}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_Source(name, str(path)))
    assert spec is not None and spec.loader is not None, "the loader is given"
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # data classes look for their module while it is run
    try:
        spec.loader.exec_module(module)
    finally:
        sys.modules.pop(name, None)
    return module


def _functions_in(module: ModuleType) -> str:
    names = [n for n, value in vars(module).items() if callable(value) and not n.startswith("_")]
    return (
        f"its functions are {', '.join(map(repr, names[:8]))}" if names else "it has no functions"
    )
