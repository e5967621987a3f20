"""Python functions that a file names: the one place where they are judged and loaded.

A scene, a sweep or a stored result names a function as ``file.py:name`` or
``package.module:name``.  Reading such a file makes a :class:`FunctionReference` of the text and
imports nothing.  A function is loaded when a system is compiled or a quantity is measured, and only

* from a ``.py`` file, which for a scene or sweep file must lie in its folder or below, or from a
  module that is installed, but not from Python's standard library;
* by a plain name, and not if the standard library defines it: ``tools.py:system`` after
  ``from os import system`` is refused as ``os:system`` is.

These rules keep a file from reaching, without code of its own, what can delete or start something.
Code that is loaded can do anything: who looks at a file of a stranger loads none.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import itertools
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from multiarm.errors import USER_FAULTS, ModelError

__all__ = ["FunctionReference", "LoadedFunction", "load_function", "reference_fault"]


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

    def below(self, folder: Path) -> FunctionReference:
        """The same with the path of its file made absolute, a relative one below a folder."""
        if self.file is None:
            return self
        return FunctionReference(f"{(folder / self.file.expanduser()).resolve()}:{self.name}")

    def __str__(self) -> str:
        return "".join(self)  # plain text, which YAML can write


class LoadedFunction:
    """A function that was loaded, and the reference by which a file names it.

    Parameters
    ----------
    reference : FunctionReference
    function : callable
    """

    def __init__(self, reference: FunctionReference, function: Callable) -> None:
        self.reference, self.function = reference, function
        self.__qualname__ = str(reference)  # what messages call it

    def __call__(self, *arguments):
        """Call the function."""
        return self.function(*arguments)


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
                "in a .py file beside the scene or in an installed package"
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
            f"cannot load the function '{given}': there is no file {file}; mend the path, which "
            "starts at the scene's folder"
        )
    try:
        module = importlib.import_module(home) if file is None else _file_module(file)
    except USER_FAULTS as error:
        raise ModelError(
            f"cannot load the function '{given}': {type(error).__name__}: {error}; mend the module "
            "(functions are named 'file.py:name' or 'package.module:name')"
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


def _file_module(path: Path) -> ModuleType:
    """Run a file as a module, anew each time; it is not left among the imported ones."""
    name = f"functions_of_{path.stem}_{next(_COUNT)}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None, "a name that ends in .py has a loader"
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
