"""Claims about how kernels are compiled, cached, called by address, and about address books."""

from __future__ import annotations

import ast
import functools
import importlib
import math
import os
import re
import subprocess
import sys
from collections import namedtuple
from pathlib import Path
from threading import Barrier, Thread
from typing import NamedTuple

import numpy as np
import pytest
from mechanics import data_of
from numba import njit
from repository import ROOT
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.errors import MultiarmError
from multiarm.jit import sources, vectors
from multiarm.jit.ahead import all_kernels, argument_types, compile_ahead, compile_all
from multiarm.jit.kernels import INT, NUMBER, NUMBERS, cfunc, fused, kernel
from multiarm.jit.pointers import address_of
from multiarm.jit.sources import kernel_modules
from multiarm.jit.structs import (
    Flag,
    Float,
    Floats1,
    Floats2,
    Int,
    Ints1,
    count_entries,
    make_struct,
    misfit,
    place_of,
    struct_of,
    view,
)
from multiarm.problems import HARD_CASES, ring_of_arms


class Things(NamedTuple):
    count: Int
    share: Float
    wanted: Flag
    line: Floats1
    table: Floats2
    numbers: Ints1


open_things, open_behind = view(Things), view(Things, len(Things._fields))


@kernel
def sum_of(struct):
    """Everything in the second of two sets of things."""
    things = open_behind(struct)
    total = things.count + things.share + (100.0 if things.wanted else 0.0)
    for i in range(things.line.size):
        total += things.line[i]
    for i in range(things.table.shape[0]):
        for j in range(things.table.shape[1]):
            total += things.table[i, j]
    return total + things.numbers[things.numbers.size - 1]


@kernel
def write_into(struct):
    """Write where the first set's table is."""
    open_things(struct).table[1, 0] = 7.0


def things(wanted: bool = True) -> Things:
    table = np.arange(6.0).reshape(2, 3)
    return Things(3, 0.25, wanted, np.array([1.0, 2.0]), table, np.array([5, 40]))


def test_a_view_has_the_arrays_and_numbers_of_its_book():
    first, second = things(), things(wanted=False)
    struct = make_struct([*first, *second])
    assert sum_of(struct) == 3 + 0.25 + 3 + 15 + 40
    assert sum_of(make_struct([*second, *first])) == 100 + 3 + 0.25 + 3 + 15 + 40


def test_numbers_become_what_their_fields_are():
    given = things()._replace(count=3.0, share=2, wanted=np.bool_(True))
    assert sum_of(struct_of(things(), given)) == 100 + 3 + 2 + 3 + 15 + 40


def test_what_a_kernel_writes_through_a_view_is_in_the_array():
    first = things()
    struct = make_struct([*first, *things()])
    write_into(struct)
    assert first.table[1, 0] == 7.0


class Groups(NamedTuple):
    first: Things
    between: Float
    second: Things


open_groups = view(Groups, len(Things._fields))


@kernel
def sum_of_groups(struct):
    """What is between two groups, and the last numbers of both; writes into the second one."""
    groups = open_groups(struct)
    groups.second.table[1, 2] = groups.first.table[1, 2] + 1.0
    return groups.between + groups.first.numbers[1] + 10.0 * groups.second.numbers[0]


def test_the_fields_of_groups_stand_one_after_the_other_in_a_struct():
    groups = Groups(things(), 0.5, things())
    assert count_entries(Groups) == 2 * len(Things._fields) + 1
    assert place_of(Groups, "second") == len(Things._fields) + 1
    struct = struct_of(things(), groups)
    assert sum_of_groups(struct) == 0.5 + 40 + 50
    assert (groups.first.table[1, 2], groups.second.table[1, 2]) == (5.0, 6.0)


def test_numbers_of_users_have_no_groups():
    assert misfit(Groups(things(), 0.5, things())).startswith("'first' is not annotated")
    assert misfit(namedtuple("Bare", "first")(1.0)).startswith("'first' is not annotated")


def test_a_class_that_is_defined_again_has_its_own_fields():
    def first_of(*names):
        holder = NamedTuple("Again", [(name, Float) for name in names])
        open_again = view(holder)
        return njit(lambda struct: open_again(struct).first)(struct_of(holder(*range(len(names)))))

    assert first_of("first", "second") == 0.0
    assert first_of("second", "first") == 1.0
    assert first_of("second", "third", "first") == 2.0


def test_views_do_not_exist_in_python():
    @kernel
    def returns_a_view(struct):
        return open_things(struct)

    with pytest.raises((TypeError, NotImplementedError)):
        returns_a_view(make_struct([*things()]))


@cfunc
def told(address, size, a, b):
    """An entry that nobody has asked for yet."""
    return int(a + b) + size


def test_threads_that_ask_at_once_get_one_entry():
    gate, found = Barrier(4), []

    def ask():
        gate.wait()
        found.append(address_of(told))

    threads = [Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4 and len(set(found)) == 1


USER_KERNEL = """
from multiarm.jit.kernels import kernel
{imports}

@kernel
def scaled(x):
    return FACTOR * x
"""
SHOWN = "print(scaled.is_cached(), scaled(2.0))\n"


def run_kernels_of_users(folder: Path, program: str, **modules: str) -> list[str]:
    """What a program prints, a line each; it and its modules lie in a folder, with a cache."""
    for name, text in {"program": program, **modules}.items():
        file = folder.joinpath(*name.split(".")).with_suffix(".py")
        file.parent.mkdir(exist_ok=True)
        file.write_text(text, encoding="utf-8")
        os.utime(file, (1e9, 1e9))  # a copy of the same time and size
    environment = os.environ | {
        "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(folder / "cache"),
        "PYTHONDONTWRITEBYTECODE": "1",  # Python looks at time and size, too
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, str(folder / "program.py")],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.splitlines()


def run_constant(folder: Path, factor: float) -> list[str]:
    """Whether the code of a kernel with a constant of its file is in the cache, and its result."""
    return run_kernels_of_users(folder, USER_KERNEL.format(imports=f"FACTOR = {factor}") + SHOWN)


@pytest.mark.slow
def test_an_edited_constant_of_a_users_kernel_counts(tmp_path):
    assert run_constant(tmp_path, 3.0) == ["False 6.0"]
    assert run_constant(tmp_path, 3.0) == ["True 6.0"]
    assert run_constant(tmp_path, 5.0) == ["False 10.0"]


CONSTANTS_OF_USERS = """
import numpy as np
import laws.helpers
import laws.settings as settings
from laws.settings import FACTOR
from multiarm.jit.kernels import kernel

NESTED = (1.0, (FACTOR, 2))
ARRAY = np.full(2, FACTOR)


def with_closure(factor):
    @kernel
    def scaled_by_closure(x):
        return factor * x
    return scaled_by_closure


closed = with_closure(FACTOR)


@kernel
def of_global(x):
    return FACTOR * x


@kernel
def of_module(x):
    return settings.FACTOR * x


@kernel
def of_package(x):
    return laws.settings.FACTOR * x


@kernel
def of_kernel_in_module(x):
    return laws.helpers.scaled(x)


@kernel
def of_closure(x):
    return closed(x)


@kernel
def of_tuple(x):
    return NESTED[1][0] * x


@kernel
def of_array(x):
    return ARRAY[1] * x


@kernel
def of_inner_function(x):
    def scale(y):
        return FACTOR * y
    return scale(x)


for name in [name for name in globals() if name.startswith("of_")]:
    print(name, globals()[name].is_cached(), globals()[name](2.0))
"""


@pytest.mark.slow
def test_constants_of_a_users_kernel_that_no_file_has_count(tmp_path, monkeypatch):
    """Wherever Numba takes them from."""
    modules = {
        "laws.__init__": "",
        "laws.settings": "import os\nFACTOR = float(os.environ['USER_FACTOR'])",
        "laws.helpers": USER_KERNEL.format(imports="from laws.settings import FACTOR"),
    }
    names = re.findall(r"def (of_\w+)", CONSTANTS_OF_USERS)

    def run(factor: float) -> list[str]:
        monkeypatch.setenv("USER_FACTOR", str(factor))
        return run_kernels_of_users(tmp_path, CONSTANTS_OF_USERS, **modules)

    assert run(3.0) == [f"{name} False 6.0" for name in names]
    assert run(3.0) == [f"{name} True 6.0" for name in names]
    assert run(5.0) == [f"{name} False 10.0" for name in names]


@pytest.mark.slow
def test_an_edited_file_that_the_file_of_a_users_kernel_imports_counts(tmp_path):
    """Imported directly, through another file, in a package."""
    imports = {
        "direct": "from constants import FACTOR",
        "through_another": "import law\nFACTOR = law.factor",
        "in_a_package": "from laws import (  # relative\n    law,\n)\nFACTOR = law.factor",
    }
    users = {name: USER_KERNEL.format(imports=text) for name, text in imports.items()}
    laws = {
        "law": "from other_constants import factor",
        "laws.__init__": "", "laws.law": "from .constants import factor",
    }  # fmt: skip
    program = "".join(f"from {name} import scaled\n{SHOWN}" for name in users)

    def run(factor: float) -> list[str]:
        constants = {"constants": f"FACTOR = {factor}"}
        for name in ("other_constants", "laws.constants"):
            constants[name] = f"factor = {factor}"
        return run_kernels_of_users(tmp_path, program, **users, **laws, **constants)

    assert run(3.0) == ["False 6.0"] * 3
    assert run(3.0) == ["True 6.0"] * 3
    assert run(5.0) == ["False 10.0"] * 3


def stamp_of_code(text: str, file: Path) -> str:
    """The stamp of the function ``f`` of a user's code, of a file or of a notebook's cell."""
    namespace: dict = {"__name__": "__main__"}
    exec(compile(text, str(file), "exec"), namespace)
    return sources.stamp_of(namespace["f"])


def test_a_module_counts_as_it_was_when_it_was_imported(tmp_path, monkeypatch):
    """Code that is compiled after the file was edited has the numbers from before."""
    monkeypatch.syspath_prepend(tmp_path)
    constants, file = tmp_path / "numbers_of_a_user.py", tmp_path / "user.py"
    constants.write_text("FACTOR = 3.0", encoding="utf-8")
    file.write_text("from numbers_of_a_user import FACTOR\nf = lambda: FACTOR", encoding="utf-8")

    def stamp() -> str:
        return stamp_of_code(file.read_text(encoding="utf-8"), file)

    before = stamp()
    constants.write_text("FACTOR = 5.00", encoding="utf-8")
    assert stamp() == before
    importlib.reload(sys.modules["numbers_of_a_user"])
    assert stamp() != before
    constants.write_text("FACTOR = 3.0", encoding="utf-8")
    os.utime(constants, (1e9, 1e9))
    importlib.reload(sys.modules["numbers_of_a_user"])
    assert stamp() == before


CELL = """
import linecache

text = "from multiarm.jit.kernels import kernel\\n@kernel\\ndef f(x):\\n    return {factor} * x\\n"
file = "/tmp/ipykernel_1/1.py"  # no such file
linecache.cache[file] = len(text), None, text.splitlines(True), file
exec(compile(text, file, "exec"))
print(f.is_cached(), f(2.0))
"""


@pytest.mark.slow
def test_an_edited_cell_of_a_notebook_counts(tmp_path):
    """Cells have no files, and what a kernel reads may have been defined in any of them."""
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "HOME": str(tmp_path),
        "IPYTHONDIR": str(tmp_path),
    }
    for factor in (3.0, 5.0):
        done = subprocess.run(
            [sys.executable, "-c", CELL.format(factor=factor)],
            env=environment, capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert done.stdout == f"False {2.0 * factor}\n"


def test_imports_that_python_refuses_are_none_of_a_users_file(tmp_path):
    """Files that run alone and in a package try both."""
    text = "try:\n    from ..law import f\nexcept ImportError:\n    f = lambda: 0"
    names = sources._imported_names(text.encode(), "laws")
    assert names == frozenset()


def test_installed_packages_are_not_read():
    """They have thousands of files; a package's own ones are, when it is installed itself."""
    file = Path(np.__file__)
    assert not sources._may_change("numpy", file, "laws.law")
    assert not sources._may_change("ast", Path(ast.__file__), "laws")
    assert not sources._may_change("sys", Path(), "laws")
    assert sources._may_change("numpy.linalg", file, "numpy.random")
    assert sources._may_change("repository", ROOT / "tests" / "support" / "repository.py", "")


PACKAGE = ROOT / "multiarm"


@functools.cache
def imported_by(file: Path) -> set[Path]:
    """Files of the package that a file imports when it is imported, by its syntax tree."""
    files: set[Path] = set()
    for node in ast.parse(file.read_bytes()).body:
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        for name in names:
            place = ROOT.joinpath(*name.split("."))
            files |= {place.with_suffix(".py"), place / "__init__.py"}
    return {path for path in files if path.is_file() and PACKAGE in path.parents}


def reached_from(file: Path) -> set[Path]:
    """A file, and all that it imports from the package, directly or through others."""
    reached: set[Path] = set()
    waiting = [file]
    while waiting:
        path = waiting.pop()
        if path not in reached:
            reached.add(path)
            waiting += imported_by(path)
    return reached


@pytest.mark.parametrize(
    "edited", ["effects/drag.py", "contacts/surfaces.py", "scene/values.py", "jit/vectors.py"]
)
def test_exactly_the_kernels_that_import_an_edited_file_compile_again(edited, monkeypatch):
    files = [ROOT.joinpath(*name.split(".")).with_suffix(".py") for name in kernel_modules()]
    before = {file: sources._stamp([str(file)]) for file in files}
    read_file = sources._read_file

    def read(path):
        digest, imported = read_file(path)
        return (b"edited" if path == str(PACKAGE / edited) else digest), imported

    monkeypatch.setattr(sources, "_read_file", read)
    changed = {file for file in files if sources._stamp([str(file)]) != before[file]}
    assert changed == {file for file in files if PACKAGE / edited in reached_from(file)}
    assert changed


def test_kernels_of_other_packages_compile_again_with_any_kernel_of_this_one(monkeypatch):
    """They name what they use by way of `multiarm.effects`, which loads it on demand."""
    path = str(ROOT / "examples" / "own_effect" / "magnet_effect.py")
    function = eval(compile("lambda: 0", path, "eval"))
    before, read_file = sources.stamp_of(function), sources._read_file

    def read(path):
        digest, imported = read_file(path)
        return (b"edited" if path == str(PACKAGE / "dynamics" / "arrays.py") else digest), imported

    monkeypatch.setattr(sources, "_read_file", read)
    monkeypatch.setattr(sources, "_stamp_of_package", sources._stamp_of_package.__wrapped__)
    assert sources.stamp_of(function) != before


@pytest.mark.slow
def test_a_cache_that_cannot_be_read_is_no_cache(tmp_path):
    run_constant(tmp_path, 3.0)
    for ending in ("nbi", "nbc"):
        files = list((tmp_path / "cache").rglob(f"*.{ending}"))
        assert files
        for file in files:
            file.write_bytes(file.read_bytes()[:100])
        (shown,) = run_constant(tmp_path, 3.0)
        assert shown.endswith("6.0")


def test_what_regular_scenes_do_without_is_compiled_where_it_is_called():
    regular = ma.compile_system(ring_of_arms(2, "weld"))
    ma.evaluate(regular)
    fresh = ma.compile_system(ring_of_arms(2, "weld"))
    coupled = ma.compile_system(HARD_CASES["bricard"].scene())
    before = data_of(regular).arrays.functions.coupled
    assert before != data_of(fresh).arrays.functions.coupled, "each system has its own stand-in"
    ma.evaluate(coupled)
    compiled = data_of(coupled).arrays.functions.coupled
    assert compiled not in (before, data_of(fresh).arrays.functions.coupled)
    assert data_of(regular).arrays.functions.coupled == before, "a regular scene does without"
    assert data_of(regular).arrays.functions.general_rows != 0


@fused
def twice(x):
    return square(x) + square(2.0 * x)


@kernel
def square(x):
    return x * x


@kernel
def one_and_two(x: NUMBER):
    return twice(x)


@pytest.mark.parametrize("option", ["alwaysinline", "contract"])
def test_what_a_kernel_calls_does_not_inherit_its_options(option):
    one_and_two._part.compile(argument_types(one_and_two))  # parts are in no cache
    (calling_code,) = twice._part.inspect_llvm().values()
    (called_code,) = square._part.inspect_llvm().values()
    assert option in calling_code
    assert option not in called_code


def test_loops_whose_turns_are_unknown_are_not_unrolled():
    """So that the code of an evaluation finds place in the processor's first cache."""
    text = """
@kernel
def total(numbers):
    result = 0.0
    for k in range(numbers.size):
        result += numbers[k]
    return result
"""
    scope = {"kernel": kernel}
    exec(compile(text, "<a cell>", "exec"), scope)  # without a file, it is in no cache
    total = scope["total"]
    assert total(np.ones(11)) == 11.0
    (code,) = total.whole.inspect_llvm().values()
    assert code.count("fadd double") == 1


def test_a_scene_without_guards_compiles_none_of_their_functions(welded_ur5_system):
    data = data_of(welded_ur5_system)
    assert not data.model.guards
    assert data.arrays.functions.reports == data.arrays.functions.watch == 0


def test_kernels_that_python_calls_get_the_types_that_they_are_compiled_for(welded_ur5_system):
    """Else they would be compiled ahead for nothing."""
    ma.simulate(welded_ur5_system, 0.002, accuracy=1e-3)
    called = [kernel for kernel in all_kernels() if not kernel.is_called_by_address]
    assert len(called) > 5
    compiled = 0
    for one in called:
        if one.whole.signatures:
            assert one.whole.signatures == [argument_types(one)]
            compiled += 1
    assert compiled > 3


AHEAD = """
from multiarm.integration.step import begin_chart as one, write_slope as other
from multiarm.jit.ahead import argument_types, compile_ahead, compile_all

if __name__ == "__main__":
    compile_all([one], progress=print)
    compile_ahead(one, other)
    print(one._wait, other._wait is not None)
    for kernel in (one, other):
        kernel.whole.compile(argument_types(kernel))
        print(sum(kernel.whole.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_kernels_compiled_by_other_processes_are_loaded(tmp_path):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", AHEAD], env=environment, capture_output=True, text=True, check=True
    )
    first, waits, *hits = done.stdout.splitlines()
    assert first == "multiarm.integration.step:begin_chart"
    assert waits == "None True"  # the first one is in the cache already
    assert hits == ["1", "1"]


@kernel
def doubled(x: NUMBER):
    return 2.0 * x


@kernel
def partly(x: NUMBERS, count):
    return x[0] * count


def test_only_kernels_with_all_types_known_are_compiled_ahead():
    assert argument_types(doubled) == (NUMBER,)
    assert argument_types(partly) is None
    assert INT in argument_types(told)


@pytest.mark.slow
def test_a_process_that_fails_is_an_error_and_no_obstacle(monkeypatch, capfd):
    """This test's module is none that another process could import."""
    monkeypatch.setattr(doubled.py_func, "__module__", "no_such_module")
    monkeypatch.setattr(doubled, "is_cached", lambda: False)
    with pytest.raises(MultiarmError, match="no_such_module:doubled could not be compiled"):
        compile_all([doubled], processes=1)
    compile_ahead(doubled)
    assert doubled(2.0) == 4.0
    assert "No module named 'no_such_module'" in capfd.readouterr().err


# --- rotations ------------------------------------------------------------------------------------


@kernel
def write_rotation_vector(matrix: NUMBERS, vector: NUMBERS):
    """Of a rotation that stands row by row."""
    vectors.put(vector, 0, vectors.rotation_vector(vectors.rotation(matrix, 0)))


@pytest.mark.parametrize("missing", [math.pi, 1.0, 1e-3, 1e-5, 1e-9, 1e-13, 0.0])
def test_a_rotation_vector_is_right_up_to_half_a_turn(missing, rng):
    """Its exponential is the rotation; at half a turn either direction is right."""
    written = np.empty(3)
    for axis in [*np.eye(3), *-np.eye(3), *rng.normal(size=(20, 3))]:
        R = Rotation.from_rotvec((math.pi - missing) * axis / np.linalg.norm(axis)).as_matrix()
        write_rotation_vector(R.ravel(), written)
        assert np.linalg.norm(written) == pytest.approx(math.pi - missing, abs=1e-12)
        assert Rotation.from_rotvec(written).as_matrix() == pytest.approx(R, abs=1e-11)
