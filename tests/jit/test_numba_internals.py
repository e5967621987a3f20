"""Claims about what `multiarm.jit` takes from Numba without its promise to keep it.

When a new version of Numba fails here, the test's name says what was removed or renamed; then mend
`multiarm.jit`, and raise the upper bound in pyproject.toml.
"""

from __future__ import annotations

import importlib
import inspect

import pytest
from numba import njit

NAMES = [
    ("numba.core.codegen", "JITCodeLibrary"),
    ("numba.core.compiler", "Compiler"),
    ("numba.core.datamodel", "models.PrimitiveModel"),
    ("numba.core.errors", "NumbaTypeError"),
    ("numba.core.typing.templates", "AttributeTemplate"),
    ("numba.core.typing.templates", "ConcreteTemplate"),
    ("numba.core.typing.templates", "infer_global"),
    ("numba.extending", "lower_getattr_generic"),
    ("numba.extending", "lower_setattr_generic"),
]
LIBRARY = [
    "_finalize_final_module", "_get_module_for_linking", "add_llvm_module",
    "enable_object_caching", "finalize", "get_pointer_to_function",
]  # fmt: skip
CODE_GENERATOR = ["_module_pass_manager"]
COMPILER = ["compile_extra", "define_pipelines"]
LIBRARY_FIELDS = ["_codegen", "_final_module", "_linking_libraries", "_shared_module", "_finalized"]
CACHE_FILE = ["_load_index", "_load_data", "_source_stamp"]


def named(module: str, name: str) -> object:
    found = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    return found


@pytest.mark.parametrize(("module", "name"), NAMES, ids=lambda text: text)
def test_a_name_is_still_there(module, name):
    assert named(module, name) is not None


@pytest.mark.parametrize("name", LIBRARY)
def test_a_code_library_still_has_its_method(name):
    assert callable(getattr(named("numba.core.codegen", "JITCodeLibrary"), name))


@pytest.mark.parametrize("name", CODE_GENERATOR)
def test_a_code_generator_still_has_its_method(name):
    assert callable(getattr(named("numba.core.codegen", "CPUCodegen"), name))


@pytest.mark.parametrize("name", COMPILER)
def test_a_compiler_still_has_its_method(name):
    assert callable(getattr(named("numba.core.compiler", "Compiler"), name))


@pytest.mark.parametrize("name", LIBRARY_FIELDS)
def test_a_code_library_still_has_its_field(name):
    source = inspect.getsource(importlib.import_module("numba.core.codegen"))
    assert f"self.{name}" in source


@njit(cache=True)
def doubled(x):
    return 2.0 * x


@pytest.mark.parametrize("name", CACHE_FILE)
def test_a_cached_function_still_has_its_file(name):
    assert hasattr(doubled._cache._cache_file, name)


@pytest.mark.parametrize(
    "option", ["_nrt", "forceinline", "no_cpython_wrapper", "no_cfunc_wrapper"]
)
def test_an_option_of_the_compiler_is_still_known(option):
    flags = importlib.import_module("numba.core.compiler").Flags
    known = {name.removeprefix("_") for name in dir(flags)} | set(dir(flags))
    assert option.removeprefix("_") in known
