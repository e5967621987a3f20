"""Python code that a scene names: functions and classes, and the one place that loads them.

A scene must be written to a file and read again, also where the code is absent.  So a function or a
class is *named* in a scene, in one of two forms:

* ``bowls.py:paraboloid``, a file (a relative path starts at the scene's folder);
* ``my_package.bowls:paraboloid``, a module that Python can import.

A callable given in Python is written as the second form, or as the first if it belongs to the
script that runs.  One without a name, such as a lambda, is written with its name in angle brackets:
the text says what it was, but it cannot be looked up again.

Reading a scene loads nothing.  Code is loaded when a system is compiled from a scene that may load
it, and when a quantity is measured; what only looks at a scene or a result never loads any.  Loaded
code can do anything.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, PlainSerializer, WithJsonSchema

from multiarm.errors import USER_FAULTS, ModelError
from multiarm.scene.faults import Parts, invalid, shown


class CodeReference(str):
    """The text that names a function or a class, as it is in a file; nothing is loaded."""

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

    def located(self, folder: Path) -> CodeReference:
        """The reference with an absolute path, which starts at ``folder`` where it is relative."""
        if self.file is None:
            return self
        return CodeReference(f"{(folder / self.file.expanduser()).resolve()}:{self.name}")


class LoadedFunction:
    """A function that was loaded, and the reference by which a file names it."""

    def __init__(self, reference: CodeReference, function: Callable) -> None:
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


def user_function(value: Any) -> Any:
    """A function, or the reference that names one; else a fault."""
    if callable(value):
        return value
    if isinstance(value, str) and is_reference(value):
        return CodeReference(value)
    raise invalid(
        "must be a Python function, or name one as 'file.py:name' or 'package.module:name', got "
        f"{shown(value)}"
    )


UserFunction = Annotated[
    Any,
    BeforeValidator(user_function),
    PlainSerializer(function_text, return_type=str),
    WithJsonSchema({"type": "string", "pattern": f"^{_REFERENCE}$"}),
]


# --- functions and files within a part of a scene ------------------------------------------------


def nodes(value: Any, parts: Parts = ()) -> Iterator[tuple[Parts, Any]]:
    """A part of a scene and all parts below it, with their places, from outside to inside."""
    yield parts, value
    for key, item in _items(value):
        yield from nodes(item, (*parts, key))


def function_references(value: Any, parts: Parts = ()) -> Iterator[tuple[Parts, CodeReference]]:
    """The functions that are named, and not loaded, in a part of a scene, with their places."""
    return ((at, leaf) for at, leaf in nodes(value, parts) if isinstance(leaf, CodeReference))


def mapped(value: Any, change: Callable[[Any, Parts], Any], parts: Parts = ()) -> Any:
    """A part of a scene with ``change(leaf, place)`` in place of every leaf; as it is if equal."""
    parts_of: dict[Any, Any] = dict(_items(value))
    if not parts_of:
        return change(value, parts)
    items = {key: mapped(item, change, (*parts, key)) for key, item in parts_of.items()}
    changes = {key: item for key, item in items.items() if item is not parts_of[key]}
    if not changes:
        return value
    if isinstance(value, BaseModel):  # each change is of the sort that was validated
        return BaseModel.model_copy(value, update=changes)
    return items if isinstance(value, Mapping) else tuple(items.values())


def located(value: Any, folder: Path) -> Any:
    """A part of a scene with file paths made absolute, relative ones below ``folder``."""

    def absolute(leaf: Any, _parts: Parts) -> Any:
        if isinstance(leaf, Path):
            return (folder / leaf.expanduser()).resolve()
        return leaf.located(folder) if isinstance(leaf, CodeReference) else leaf

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


def is_reference(text: str) -> bool:
    """Whether a text is written as a reference is."""
    return re.fullmatch(_REFERENCE, text) is not None


def reference_fault(
    reference: CodeReference, folder: Path | None = None, noun: str = "function"
) -> str:
    """Why code may not be loaded by this reference; empty where it may.

    Parameters
    ----------
    reference : CodeReference
        With an absolute path, if it names a file.
    folder : Path, optional
        That of the file in which it is written: a ``.py`` file lies there or below.
    noun : str
        What it is, in messages: a function or a class.
    """
    cannot = f"cannot load the {noun} '{reference}': "
    if reference.name.startswith("<"):
        return (
            f"the function '{reference}' has no name by which it can be found again; give the "
            "function itself, or name one as 'file.py:name' or 'package.module:name'"
        )
    if not reference.name.isidentifier():
        return (
            f"{cannot}{reference.name!r} is not a plain name; name a {noun} that stands in "
            f"{reference.home} itself"
        )
    if (
        folder is not None
        and reference.file is not None
        and not reference.file.resolve().is_relative_to(folder.resolve())
    ):
        return (
            f"{cannot}its file is not in the folder {folder} or below; put it there, or name an "
            "installed module as 'package.module:name'"
        )
    return ""


def load_code(reference: CodeReference, noun: str = "function") -> Callable:
    """The function or the class to which a reference leads; a file is run each time.

    Raises
    ------
    ModelError
        When it may not be loaded; when there is no such file, module or name; when loading fails.
    """
    reason = reference_fault(reference, noun=noun)
    if reason:
        raise ModelError(reason)
    home, name, file = reference.home, reference.name, reference.file
    if file is not None and not file.is_file():
        raise ModelError(
            f"cannot load the {noun} '{reference}': there is no file {file}; correct the path, "
            "which starts at the folder of the scene or sweep that names it"
        )
    try:
        module = importlib.import_module(home) if file is None else _file_module(file)
    except USER_FAULTS as error:
        raise ModelError(
            f"cannot load the {noun} '{reference}': {type(error).__name__}: {error}; correct the "
            "module (code is named 'file.py:name' or 'package.module:name')"
        ) from error
    code = getattr(module, name, None)
    if code is None:
        raise ModelError(f"there is no {name!r} in {home}; {_callables_in(module)}")
    if not callable(code):
        raise ModelError(f"{name!r} in {home} is not a {noun}; {_callables_in(module)}")
    return code


def load_function(function: Callable | CodeReference) -> Callable:
    """The function to which a reference leads; a function is returned as it is.

    Raises
    ------
    ModelError
        See :func:`load_code`.
    """
    return load_code(function) if isinstance(function, CodeReference) else function


_LOADING = threading.RLock()


class _Source(SourceFileLoader):
    """Compiles a file each time: kept byte code is found stale by time and size alone."""

    def get_code(self, fullname: str) -> CodeType:
        """The code of the file as it is now."""
        return self.source_to_code(self.get_data(self.path), self.path)


def _file_module(path: Path) -> ModuleType:
    """Run a file as a module, which takes the place of an earlier one of this file."""
    name = f"code_of_{path.stem}_{hashlib.sha256(os.fsencode(path)).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_Source(name, str(path)))
    assert spec is not None and spec.loader is not None, "the loader is given"
    module = importlib.util.module_from_spec(spec)
    with _LOADING:
        # data classes, and models with postponed annotations, look for their module
        before, sys.modules[name] = sys.modules.get(name), module
        try:
            spec.loader.exec_module(module)
        except BaseException:
            sys.modules.pop(name)
            if before is not None:
                sys.modules[name] = before
            raise
    return module


def _callables_in(module: ModuleType) -> str:
    names = [n for n, value in vars(module).items() if callable(value) and not n.startswith("_")]
    return (
        f"its functions are {', '.join(map(repr, names[:8]))}" if names else "it has no functions"
    )
