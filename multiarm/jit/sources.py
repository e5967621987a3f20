"""Sources of kernels: the files that their cached code depends on, and a digest of them.

Numba looks only at a kernel's own file to see whether its cached code is fresh.  A kernel from
another file that was compiled into it, or a constant that it reads, would stay as it was; so what
the file imports counts, and what that imports, and so on.  Of kernels of this package these are
files of this package.  Of kernels of users they are their own files, and all kernels of this
package, whose names may come by way of other files; installed packages stay as they are.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import inspect
import os
import re
import sys
import sysconfig
from collections.abc import Callable, Iterable
from importlib.util import resolve_name
from numbers import Number
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NamedTuple

import numpy as np

_PACKAGE = Path(__file__).parents[1]
_KERNEL = re.compile(rb"^@(kernel|unlocked|inlined|plain|fused|cfunc|allocating)\b", re.MULTILINE)
_IMPORTED = re.compile(rb"^from multiarm\.([\w.]+) import", re.MULTILINE)
_LIBRARIES = {Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib")}
_INSTALLED = {"site-packages", "dist-packages"}


def kernel_modules() -> list[str]:
    """Names of the package's modules that have kernels."""
    paths = (path.relative_to(_PACKAGE).with_suffix("") for path in _kernel_files())
    return [".".join(("multiarm", *path.parts)) for path in paths]


def stamp_of(function: Callable) -> str:
    """Digest of all sources that the cached code of a kernel depends on.

    Empty for a function without a file, such as one of a notebook's cell: it reads what other cells
    define, which has no file either.
    """
    file = Path(function.__code__.co_filename)
    if _PACKAGE in file.parents:
        return _stamp_of_file(str(file))
    if not file.is_file():
        return ""
    return _stamp_of_package() + _stamp_of_user_code(file, function.__globals__)


def stamp_of_constants(function: Callable) -> str:
    """Digest of the constants that a kernel of a user, and those it calls, take from their modules.

    They become part of the code, and may come from anywhere: the environment, a table, an argument
    of the program.  Those of this package come from its files.
    """
    constants: list[str] = []
    kernels = [function]  # grows while it is read
    for called in kernels:
        if (called.__module__ or "").partition(".")[0] == _PACKAGE.name:
            continue
        for name, value in _named_values(called):
            constants.append(f"{name} = {_text_of_constant(value)}\n")
            parts = value if isinstance(value, tuple) else (value,)
            functions = (getattr(part, "py_func", None) for part in parts)
            kernels += [each for each in functions if each is not None and each not in kernels]
    return _digest(text.encode() for text in constants)


def _named_values(function: Callable) -> list[tuple[str, Any]]:
    """What the names in a function, and in functions within it, stand for outside of it.

    An attribute is looked up in every module that the function names, as its bytecode lists the
    names only; one too many does no harm.
    """
    codes = [function.__code__]
    for code in codes:
        codes += [inner for inner in code.co_consts if isinstance(inner, CodeType)]
    names = list(dict.fromkeys(name for code in codes for name in code.co_names))
    values = list(inspect.getclosurevars(function).nonlocals.items())
    scopes, searched = [("", function.__globals__)], set()
    for place, scope in scopes:
        for name in names:
            if name in scope:
                values.append((place + name, scope[name]))
        for label, value in values:
            if isinstance(value, ModuleType) and value not in searched:
                searched.add(value)
                scopes.append((f"{label}.", vars(value)))
    return values


def _text_of_constant(value: Any) -> str:
    """A text that tells a constant from others; of a kernel its name, empty for anything else."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_text_of_constant, value))})"
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, (Number, np.generic, str, bytes)):
        return repr(value)
    return f"{value.__module__}.{value.__qualname__}" if hasattr(value, "py_func") else ""


def _digest(parts: Iterable[bytes]) -> str:
    return hashlib.sha256(b"".join(parts)).hexdigest()


# --- this package ---------------------------------------------------------------------------------


def _kernel_files() -> list[Path]:
    return [path for path in sorted(_PACKAGE.rglob("*.py")) if _KERNEL.search(path.read_bytes())]


@functools.cache
def _stamp_of_file(file: str) -> str:
    return _stamp([file])


@functools.cache
def _stamp_of_package() -> str:
    """Digest of all files with kernels."""
    return _stamp([str(path) for path in _kernel_files()])


def _stamp(files: list[str]) -> str:
    """Digest of files of this package, and of all that they import from it."""
    digests: dict[str, bytes] = {}  # paths as texts are compared faster
    waiting = list(files)
    while waiting:
        path = waiting.pop()
        if path not in digests:
            digests[path], imported = _read_file(path)
            waiting += imported
    return _digest(digests[path] for path in sorted(digests))


# This package's files are read once, when they are imported: they may be edited while it runs.
@functools.cache
def _read_file(path: str) -> tuple[bytes, list[str]]:
    """Digest of a file, and the files of this package that it imports from.

    A syntax tree of each would take longer than all else that importing the package takes.
    """
    text = Path(path).read_bytes()
    names = {name.decode().replace(".", os.sep) for name in _IMPORTED.findall(text)}
    stems = [os.path.join(_PACKAGE, name) for name in names]  # in a tenth of the time of Path
    return hashlib.sha256(text).digest(), [
        f"{stem}.py" if os.path.isfile(f"{stem}.py") else os.path.join(stem, "__init__.py")
        for stem in stems
    ]


# --- users ----------------------------------------------------------------------------------------


class _Module(NamedTuple):
    """What a module of a user was when it was imported."""

    spec: Any  # another one after each import
    digest: bytes
    imported: frozenset[str]  # names that are modules, or may be


_MODULES: dict[str, _Module] = {}


def _stamp_of_user_code(file: Path, namespace: dict[str, Any]) -> str:
    """Digest of a file and of what it imports."""
    text, home = file.read_bytes(), str(namespace.get("__package__") or "")
    digests = {"": hashlib.sha256(text).digest()}
    waiting = [(name, home) for name in _imported_names(text, home)]
    while waiting:
        name, importer = waiting.pop()
        loaded = sys.modules.get(name)
        path = Path(getattr(loaded, "__file__", None) or "")
        if name in digests or not _may_change(name, path, importer):
            continue
        module = _read_module(name, loaded, path)
        digests[name] = module.digest
        waiting += ((imported, name) for imported in module.imported)
    return _digest(name.encode() + digests[name] for name in sorted(digests))


def _may_change(name: str, path: Path, importer: str) -> bool:
    """Whether a module is none of this package or of another installed one than its importer's."""
    package = name.partition(".")[0]
    if package == _PACKAGE.name or not path.is_file():
        return False
    is_installed = not _INSTALLED.isdisjoint(path.parts) or not _LIBRARIES.isdisjoint(path.parents)
    return not is_installed or package == importer.partition(".")[0]


def _read_module(name: str, loaded: Any, path: Path) -> _Module:
    """Digest and imports of a module: its file is read once for each time it is imported."""
    spec = getattr(loaded, "__spec__", None)
    module = _MODULES.get(name)
    if module is None or module.spec is not spec:
        text = path.read_bytes()
        home = str(getattr(loaded, "__package__", None) or "")
        names = _imported_names(text, home) if path.suffix == ".py" else frozenset()
        module = _MODULES[name] = _Module(spec, hashlib.sha256(text).digest(), names)
    return module


@functools.cache
def _imported_names(text: bytes, package: str) -> frozenset[str]:
    """Modules that a file of a package imports, with the packages around them.

    With ``package.name`` for every name from a package, which may be a module or not.
    """
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError):  # it has been edited since it was imported
        return frozenset()
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            home = "." * node.level + (node.module or "")
            try:
                home = resolve_name(home, package) if node.level and package else home
            except ImportError:  # beyond the package: a file that also runs alone catches it
                continue
            names.update((home, *(f"{home}.{alias.name}" for alias in node.names)))
    around = {name.rsplit(".", k)[0] for name in names for k in range(1, name.count(".") + 1)}
    return frozenset(names | around)
