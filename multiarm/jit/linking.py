"""Linking kernels: a kernel that is inlined is optimised and translated in its callers only.

Numba optimises every function on its own, translates it, and does both again in every caller it is
compiled into.  Most functions here are only ever parts of a few large kernels that are called from
Python or by address.  These *parts* are kept as they were written down (LLVM's intermediate
language); a *whole* takes in the parts that it needs, makes them its own, so that LLVM may inline
or drop them, and is the only thing that is optimised.  That saves a third of the time.

Numba has no public name for this: the two classes below stand on its code libraries.
"""

from __future__ import annotations

import functools
import gc
from typing import Any

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class _NoEnvironment:
    """Stands in for a part's code generator where Numba would store the part's Python objects."""

    @staticmethod
    def set_env(name: str, environment: Any) -> None:
        """Parts have none that is ever read: they handle no Python objects."""


class _Part(JITCodeLibrary):
    """Code that only takes part in other kernels."""

    codegen = _NoEnvironment()

    def add_llvm_module(self, module: Any) -> None:
        self._final_module.link_in(module)

    def finalize(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == binding.Linkage.external:
                function.linkage = "linkonce_odr"
        self._shared_module = self._final_module
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """No address: there is no machine code."""
        return 0


class _Whole(JITCodeLibrary):
    """A kernel with all its parts."""

    def add_llvm_module(self, module: Any) -> None:
        self._final_module.link_in(module)

    def finalize(self) -> None:
        module = self._final_module
        defined = {function.name for function in module.functions if not function.is_declaration}
        for library in _with_parts(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            module.link_in(library._get_module_for_linking(), preserve=True)
        for function in module.functions:
            if not function.is_declaration and function.name not in defined:
                function.linkage = "internal"
        # Numba's own method runs all passes twice, at first to bring reference counts together:
        # there are few here.
        _keep_loops_short()
        manager, builder = self._codegen._module_pass_manager()
        manager.run(module, builder)
        module.verify()
        self._finalize_final_module()


@functools.cache
def _keep_loops_short() -> None:
    """Let LLVM leave loops alone whose number of turns is known only as they run.

    For processors that hold many decoded instructions it unrolls them eightfold, and again what is
    left over: an evaluation of a robot becomes twice as long as the processor's first cache.  Like
    those that Numba sets, this option is the whole process's.
    """
    binding.set_option("", "-unroll-runtime=false")


def _with_parts(libraries: Any) -> list[Any]:
    """Libraries and what their parts need, each once."""
    linked: dict[Any, None] = {}
    waiting = list(libraries)
    while waiting:
        library = waiting.pop()
        if library in linked:
            continue
        linked[library] = None
        if isinstance(library, _Part):
            waiting += library._linking_libraries
    return list(linked)


class _PartCompiler(Compiler):
    library = _Part

    def define_pipelines(self) -> list:
        codegen = self.state.targetctx.codegen()
        self.state.library = self.library(codegen, self.state.func_id.func_qualname)
        self.state.library.enable_object_caching()
        return super().define_pipelines()


class _WholeCompiler(_PartCompiler):
    library = _Whole

    def compile_extra(self, func: Any) -> Any:
        # Numba's trees are full of cycles and alive until the end: collecting garbage meanwhile
        # takes a tenth of the time and finds next to nothing.
        collecting = gc.isenabled()
        gc.disable()
        try:
            return super().compile_extra(func)
        finally:
            if collecting:
                gc.enable()


# Options of Numba's decorator for the two kinds.
PART: dict[str, Any] = {"pipeline_class": _PartCompiler}
WHOLE: dict[str, Any] = {"pipeline_class": _WholeCompiler}
