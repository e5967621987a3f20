"""Claims about the shape of the package: what may import what, and what `import multiarm` costs."""

from __future__ import annotations

import ast
import inspect
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter

import pytest
from repository import ROOT

import multiarm as ma

PACKAGE = ROOT / "multiarm"

# From the bottom to the top.  A room is a module or a package directly below `multiarm`; it imports
# rooms above it in this list only, wherever the import stands.  "multiarm" is the public surface.
ROOMS = (
    "notation", "errors", "public", "geometry", "jit", "spatial", "programs", "tableaus", "threads",
    "scene", "results", "contacts", "robots", "dynamics", "control", "effects", "integration",
    "terminal", "assembly", "events", "simulation", "linear", "gradients", "grasp", "sweeps",
    "plots", "reports", "viewer", "problems", "studies", "multiarm", "cli", "__main__",
)  # fmt: skip

# Libraries beside the standard one and NumPy: the rooms, or modules, that may import them.
LIBRARIES: dict[str, tuple[str, ...]] = {
    "PIL": ("scene.meshes",),
    "coal": ("robots.robot", "assembly.collisions", "viewer.shapes"),
    "control": ("linear.linearisation",),
    "dask": ("sweeps.executors",),
    "distributed": ("sweeps.executors", "sweeps.sweep"),
    "docstring_parser": ("scene.parameters",),
    "h5py": ("control.tables", "results.hdf5", "results.trajectory_file"),
    "jinja2": ("reports.pages",),
    "joblib": (
        "jit.ahead",
        "sweeps.executors",
    ),
    "llvmlite": ("jit",),
    "matplotlib": (
        "plots",
        "studies.hard_cases_page",
        "studies.effect_costs_page",
        "studies.work_precision_page",
    ),
    "mujoco": ("studies.mujoco_peer",),
    "numba": ("jit", "studies.mujoco_peer"),
    "pinocchio": (
        "robots.robot",
        "robots.backends",
        "robots.compiled.reference",
        "assembly.collisions",
        "scene.mjcf",
        "viewer",
        "studies.pinocchio_peer",
    ),
    "pandas": (
        "plots.sweep_figures",
        "results.trajectory",
        "studies",
        "sweeps.folder",
        "sweeps.result",
        "sweeps.spec",
    ),
    "pyarrow": ("control.tables", "sweeps.folder"),
    "platformdirs": ("viewer",),
    "pydantic": ("scene", "sweeps"),
    "pydantic_core": ("scene",),
    "rich": ("cli", "terminal"),
    "scipy": (
        "grasp",
        "integration.event_location",
        "control.recorded",
        "dynamics.solver.dense",
        "assembly.collisions",
        "assembly.loop_closure",
        "programs",
        "effects.external_wrenches",
        "gradients.collocation",
        "linear.coordinates",
        "linear.linearisation",
        "problems",
        "scene.solids",
        "sweeps.axes",
        "sweeps.spec",
        "threads",
        "studies.pinocchio_peer",
        "viewer.animation",
    ),
    "shapely": ("grasp",),
    "threadpoolctl": ("threads",),
    "trimesh": ("grasp.body.boundaries", "scene.meshes", "scene.solids"),
    "typer": ("cli",),
    "typing_extensions": ("grasp", "terminal", "scene", "sweeps"),
    "yaml": ("scene",),
}

HEAVY = {"numba", "pinocchio", "matplotlib", "h5py", "scipy", "pydantic"}

# What scripts written for this package rely on.
PUBLIC_ATTRIBUTES = {
    "Control": "picture example torques build faults",
    "Derivatives": "evaluation matrix rows columns message object_acceleration joint_accelerations "
    "contact_forces effect_state_rates motions",
    "Effect": "name Spec forces build",
    "Equilibrium": "state torques linear stability steps acceleration",
    "Evaluation": "object_acceleration joint_accelerations contact_forces contact_forces_unique "
    "contact_points contact_normals wrenches position_residual velocity_residual residuals",
    "Gradient": "value start parameters error trajectory times weights torque_density "
    "by_torque_table",
    "Joint": "kind arm name at at_tip records",
    "Kinematics": "tips",
    "LinearSystem": "A B C D rate state state_names input_names output_names modes controllable "
    "stability coordinates_of state_at to_scipy to_control",
    "Loads": "object_wrench joint_torques object_wrenches",
    "Scene": "name gravity object arms joints control effects run",
    "Sensitivities": "time matrix rows columns states trajectory error object_pose object_twist "
    "joint_positions joint_velocities",
    "State": "position velocity object_position object_quaternion_xyzw object_twist "
    "joint_positions joint_velocities",
    "Stepper": "advance reset time state contact_forces wrenches tip_positions "
    "tip_quaternions_xyzw tip_twists events trajectory",
    "Surface": "name patch record",
    "Sweep": "scene plan count complete runs paths quantities columns table status_counts "
    "summary values_of scene_of trajectory provenance",
    "System": "scene arm_names arms initial_state state kinematics",
    "TipKinematics": "position rotation twist jacobian joint_names",
    "Trajectory": "time object_position object_quaternion_xyzw object_twist joint_positions "
    "joint_velocities joint_torques contact_forces contact_states wrenches tip_positions "
    "tip_quaternions_xyzw tip_twists energy kinetic_energy potential_energy "
    "work energy_balance position_drift velocity_drift status message "
    "certificate events statistics provenance scene save arm_names",
}
PUBLIC_PARAMETERS = {
    "compile_system": "scene control sample_time sample_delay like",
    "derivatives": "system t state closed_loop parameters",
    "evaluate": "system t state",
    "find_equilibrium": "system state torques t",
    "gradient": "system duration final running parameters accuracy state start_time progress",
    "inverse_dynamics": "system state object_acceleration relative_acceleration internal_forces",
    "linearise": "system t state closed_loop",
    "load_scene": "path",
    "load_sweep": "path",
    "load_trajectory": "path",
    "register_control": "control",
    "register_effect": "effect",
    "register_joint": "joint",
    "register_surface": "surface",
    "sensitivities": "system times parameters accuracy state start_time progress",
    "replay": "trajectory path open_browser fps speed",
    "report": "trajectory path",
    "simulate": "system duration state control sample_time sample_delay accuracy integrator step "
    "stabilization output_step solver out progress",
    "simulate_many": "system duration states parameters threads progress out accuracy integrator "
    "step tolerance stabilization output_step max_step solver control sample_time "
    "sample_delay certificate",
    "sweep": "scene over out workers dask keep repeat combine sampling seed certificate progress "
    "resume run",
}


@dataclass(frozen=True)
class Import:
    """One import: dotted names without the leading ``multiarm.`` when it is ours."""

    importer: str
    imported: str
    ours: bool

    @property
    def rooms(self) -> tuple[str, str]:
        return self.importer.partition(".")[0], self.imported.partition(".")[0]


@cache
def modules() -> dict[str, ast.Module]:
    """All modules by dotted name below the package; the package itself is "multiarm"."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name or "multiarm"] = ast.parse(path.read_text(encoding="utf-8"), str(path))
    return found


@cache
def imports() -> tuple[Import, ...]:
    found = []
    for name, tree in modules().items():
        nodes = (node for node in ast.walk(tree) if isinstance(node, (ast.Import, ast.ImportFrom)))
        found += [Import(name, *target) for node in nodes for target in targets(node)]
    return tuple(found)


def targets(node: ast.Import | ast.ImportFrom) -> Iterator[tuple[str, bool]]:
    """What an import names, a module wherever it is one; and whether it is ours."""
    if isinstance(node, ast.Import):
        full = [alias.name for alias in node.names]
    else:
        assert node.level == 0 and node.module is not None, "imports are written in full here"
        full = [f"{node.module}.{alias.name}" for alias in node.names]
    for name in full:
        top, _, below = name.partition(".")
        if top != "multiarm":
            yield top, False
        elif isinstance(node, ast.ImportFrom) and below not in modules():
            yield below.rpartition(".")[0] or "multiarm", True  # a name in a module
        else:
            yield below or "multiarm", True


def in_fresh_python(code: str) -> list[str]:
    """What code prints as JSON, in a process that has imported nothing."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


@pytest.mark.slow
def test_every_room_has_its_place():
    assert {name.partition(".")[0] for name in modules()} == set(ROOMS)


@pytest.mark.slow
def test_imports_point_down():
    faults = []
    for found in imports():
        above, below = found.rooms
        if found.ours and ROOMS.index(below) > ROOMS.index(above):
            faults.append(f"{found.importer} -> {found.imported}")
    assert faults == []


@pytest.mark.slow
def test_modules_import_each_other_without_cycles():
    graph: dict[str, set[str]] = {name: set() for name in modules()}
    for found in imports():
        if found.ours:
            graph[found.importer].add(found.imported)
    try:
        order = list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(f"import cycle: {' -> '.join(error.args[1])}")
    assert set(order) == set(modules())


@pytest.mark.slow
def test_node_sees_arrays_only():
    node = "dynamics.solver."
    seen = {found.imported for found in imports() if found.ours and found.importer.startswith(node)}
    allowed = {"robots.terms", "dynamics.status"}
    assert all(name.startswith((node, "jit.")) or name in allowed for name in seen)


@pytest.mark.parametrize("library", LIBRARIES)
def test_each_library_is_imported_where_it_is_expected_and_nowhere_else(library):
    importers = {found.importer for found in imports() if found.imported == library}
    homes = LIBRARIES[library]
    unused = [h for h in homes if not any(i == h or i.startswith(f"{h}.") for i in importers)]
    strangers = {i for i in importers if not any(i == h or i.startswith(f"{h}.") for h in homes)}
    assert (strangers, unused) == (set(), [])


def test_no_other_library_is_imported():
    known = {*LIBRARIES, *sys.stdlib_module_names, "numpy"}
    assert {found.imported for found in imports() if not found.ours} <= known


HELP = """
import contextlib, io
from multiarm.cli import app
with contextlib.redirect_stdout(io.StringIO()) as printed:
    app(["run", "--help"], standalone_mode=False)
assert "--accuracy" in printed.getvalue()
"""
EFFECT = """
import multiarm as ma
class Push(ma.Effect):
    name = "push"
    def forces(self, t, state): return ma.Loads()
ma.register_effect(Push)
"""


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        ("import multiarm", HEAVY | {"numpy", "yaml", "rich", "typer"}),
        ("import multiarm; multiarm.load_scene", HEAVY - {"pydantic"}),
        ("import multiarm; multiarm.load_trajectory", HEAVY),
        ("import multiarm.cli", HEAVY),
        (HELP, HEAVY - {"pydantic"} | {"numpy", "meshcat"}),
        ("import multiarm.results.sinks, multiarm.results.trajectory", HEAVY),
        ("import multiarm.problems", {"scipy", "numba", "pinocchio"}),
        (EFFECT, {"scipy", "numba", "pinocchio"}),
    ],
    ids=[
        "multiarm",
        "load_scene",
        "load_trajectory",
        "cli",
        "help",
        "results",
        "problems",
        "effect",
    ],
)
def test_what_is_heavy_is_imported_late(code, heavy):
    loaded = in_fresh_python(f"{code}\nimport json, sys; print(json.dumps(list(sys.modules)))")
    assert "multiarm" in loaded
    assert heavy.intersection(loaded) == set()


def test_public_names_are_complete_and_sorted():
    assert sorted(ma.__all__) == ma.__all__
    assert set(ma.__all__) == {"MultiarmError", "grasp", *PUBLIC_ATTRIBUTES, *PUBLIC_PARAMETERS}
    assert set(ma.__all__) <= set(dir(ma))


@pytest.mark.slow
def test_public_names_stay_functions_and_classes_after_all_modules_were_imported():
    names = [f"multiarm.{name}" for name in modules() if name not in ("multiarm", "__main__")]
    wrong = in_fresh_python(
        "import importlib, inspect, json, multiarm\n"
        f"for name in {names}: importlib.import_module(name)\n"
        "from multiarm import geometry\n"
        "homes = multiarm, multiarm.grasp, geometry\n"
        "kinds = {name: getattr(home, name) for home in homes\n"
        "    for name in home.__all__ if name != 'grasp'}\n"
        "print(json.dumps([name for name, value in kinds.items()\n"
        "    if not (inspect.isfunction(value) or inspect.isclass(value))]))"
    )
    assert wrong == []


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'simulate_all'"):
        ma.simulate_all  # noqa: B018


@pytest.mark.parametrize("name", PUBLIC_ATTRIBUTES)
def test_public_classes_have_the_promised_attributes(name):
    kind = getattr(ma, name)
    has = {*dir(kind), *inspect.get_annotations(kind)}
    assert set(PUBLIC_ATTRIBUTES[name].split()) - has == set()


@pytest.mark.parametrize("name", PUBLIC_PARAMETERS)
def test_public_functions_have_the_promised_parameters(name):
    has = inspect.signature(getattr(ma, name)).parameters
    assert set(PUBLIC_PARAMETERS[name].split()) - set(has) == set()


def test_every_module_opens_with_what_it_is_about():
    silent = [name for name, tree in modules().items() if not ast.get_docstring(tree)]
    assert silent == []


# --- what interactive sessions see ----------------------------------------------------------------


@pytest.fixture(scope="module")
def objects(welded_ur5_system):
    system = welded_ur5_system
    with system.borrow() as data:
        found = (
            system, system.model, data, system.initial_state(), ma.evaluate(system),
            ma.Stepper(system), ma.simulate(system, 0.01, certificate=False), system.kinematics(),
        )  # fmt: skip
    return {type(one).__name__: one for one in found}


@pytest.mark.parametrize(
    "name",
    ["System", "Model", "Data", "State", "Evaluation", "Stepper", "Trajectory", "Kinematics"],
)
def test_an_object_shows_itself_in_a_line_or_two(objects, name):
    text = repr(objects[name])
    assert text.startswith(f"{name}(") and text.count("\n") <= 1
    assert all(len(line) <= 100 for line in text.splitlines())


@pytest.mark.parametrize(
    "name", ["System", "State", "Evaluation", "Stepper", "Trajectory", "Kinematics"]
)
def test_dir_has_the_promised_names_and_no_private_ones(objects, name):
    shown = dir(objects[name])
    assert set(PUBLIC_ATTRIBUTES[name].split()) <= set(shown)
    assert not [one for one in shown if one.startswith("_")]


def test_dir_of_a_scene_is_without_the_machinery_of_its_library(welded_ur5_system):
    shown = set(dir(welded_ur5_system.scene))
    assert set(PUBLIC_ATTRIBUTES["Scene"].split()) | {"replace"} <= shown
    assert not {one for one in shown if one.startswith(("model_", "_"))}


def test_dir_of_the_package_is_what_it_exports():
    assert set(dir(ma)) == {*ma.__all__, "__version__"}
    assert set(dir(ma.grasp)) == set(ma.grasp.__all__)
