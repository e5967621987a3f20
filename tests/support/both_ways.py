"""What compiled and interpreted kernels both compute, to be compared.

    NUMBA_DISABLE_JIT=1 python tests/support/both_ways.py

prints JSON, a line for each computation and each frozen case: its name, its results interpreted.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType
from typing import Any

import event_scenes
import golden
import numpy as np
import object_scenes
from random_trees import draw_trees
from tree_scenes import satellite_scene

import multiarm as ma
from multiarm.assembly.inverse_kinematics import InverseKinematics
from multiarm.jit.kernels import kernel
from multiarm.jit.simd import (
    LANES,
    broadcast,
    gather_pack,
    load_pack,
    min_positive,
    minimum,
    packs_of,
    store_pack,
    sum_pack,
    transpose_four,
)
from multiarm.problems import HARD_CASES, ring_of_arms
from multiarm.robots.compiled.kernels import outwards, update_robots
from multiarm.scene import parse_scene
from multiarm.scene.joint_values import SOLVE


def swinging(arms: str) -> ma.System:
    """Two UR5s hold a disc by balls, and cannot hold it still."""
    return ma.compile_system(ring_of_arms(2, "ball"), arms=arms)


def dividing() -> ma.System:
    """A compiled robot with branches holds an object by several tips."""
    with TemporaryDirectory() as folder:
        trees = draw_trees("several_tips", np.random.default_rng(4), Path(folder))
        return ma.compile_system(parse_scene(trees.scene), arms="compiled")


def branches() -> golden.Results:
    """An evaluation of a robot with branches."""
    evaluation = ma.evaluate(dividing())
    accelerations = [*evaluation.joint_accelerations.values(), evaluation.object_acceleration]
    return {"accelerations": np.concatenate(accelerations)}


def step() -> golden.Results:
    """One step of a stepper."""
    state = ma.Stepper(swinging("compiled"), accuracy=1e-6).advance(1e-3)
    return {"position": state.position, "velocity": state.velocity}


def ten_steps() -> golden.Results:
    """A run of ten steps."""
    run = ma.simulate(swinging("pinocchio"), 0.01, integrator="rk4", step=1e-3, certificate=False)
    names = ("object/position", "object/twist", "arms/arm0/joint_velocity", "energy/work")
    return {"steps": run.statistics["steps"], **{name: run.channel(name) for name in names}}


def implicit_steps() -> golden.Results:
    """A run by the implicit method, against a damper that explicit ones need short steps for."""
    system = ma.compile_system(HARD_CASES["stiff_damping"].scene())
    run = ma.simulate(system, 0.01, integrator="rodas5p", tolerance=1e-6, certificate=False)
    return {"twist": run.object_twist, "status": run.status}


def implicit_steps_of_objects() -> golden.Results:
    """The same of two objects, each on an arm that eliminates its own contacts."""
    objects, arms, joints = {}, {}, []
    for k, name in enumerate("ab"):
        place = [float(k), 0.0, 0.0]
        objects[name] = object_scenes.body(1.0 + k, [0.01, 0.02, 0.03], place)
        arms[f"arm_{name}"] = event_scenes.arm("xyzXYZ", base={"xyz": place})
        joints.append({"arm": f"arm_{name}", "object": name, "kind": "ball", "at": {}})
    scene = {
        "gravity": object_scenes.DOWN, "objects": objects, "arms": arms, "joints": joints,
        "effects": {"joint_damping": 1.0, "drag": {"linear": 0.5}},
    }  # fmt: skip
    system = ma.compile_system(parse_scene(scene))
    run = ma.simulate(system, 2e-3, integrator="rodas5p", tolerance=1e-3, certificate=False)
    twists = [motion.twist[-1] for motion in run.objects.values()]
    return {"twists": np.concatenate(twists), "work": run.channel("effects/drag/work")}


def event() -> golden.Results:
    """A ball falls on a floor."""
    scene = event_scenes.on_floor(event_scenes.ball(height=1e-4))
    run = event_scenes.run(scene, 0.006)
    touches, *rests = run.events
    return {
        "at rest": [rest["time"] for rest in rests],
        "kind": touches["kind"],
        "time": touches["time"],
        "impulse": touches["after"]["impulse_N_s"],
        "twist": run.object_twist[-1],
    }


def derivatives() -> golden.Results:
    """Of the accelerations and forces by everything."""
    system = swinging("compiled")
    return {"matrix": ma.derivatives(system, 0.1, system.initial_state()).matrix}


def gradient() -> golden.Results:
    """Of the object's height at the end by the start and by its mass."""
    result = ma.gradient(
        swinging("compiled"),
        2e-3,
        final=lambda t, state: state.object_position[2],
        parameters=["object.mass"],
        accuracy=1e-5,
    )
    return {
        "value": result.value,
        "mass": result.parameters["object.mass"],
        "rates": result.start.d_joint_velocities["arm0"],
    }


def posture() -> golden.Results:
    """Inverse kinematics of an arm, from three starts."""
    system = swinging("compiled")
    arm = system.arms["arm0"]
    place = arm.tip_pose(system.initial_state().joint_positions["arm0"])
    reach = InverseKinematics(arm).search([place], np.random.default_rng(1), starts=3)
    assert reach is not None, "the arm is there at the start"
    return {"posture": reach.postures[0], "dexterity": reach.dexterity}


@kernel
def write_packs(source, out):
    """Every operation of packs, of 16 numbers."""
    a, b = load_pack(source, 0), load_pack(source, LANES)
    store_pack(out, 0, a + b)
    store_pack(out, 4, a - b)
    store_pack(out, 8, a * b)
    store_pack(out, 12, a / b)
    store_pack(out, 16, minimum(a, b))
    store_pack(out, 20, min_positive(a, b))
    store_pack(out, 24, broadcast(sum_pack(load_pack(source, 8))))
    store_pack(out, 28, gather_pack(source, 7, 0, 13, 10))
    transpose_four(source, 0, out, 32, 44, 40, 36)
    row = packs_of(out, 11) + 1
    row[1], row[0] = packs_of(source, 2)[1], row[-1]


def packs() -> golden.Results:
    """Of numbers that are not finite, too; to the last digit."""
    source, out = np.arange(16.0) / 3.0, np.zeros(56)
    source[:8] = 1.0, -2.0, 0.3, np.nan, -1.5, 0.0, np.nan, 2.5
    write_packs(source, out)
    return {"numbers": [repr(number) for number in out.tolist()]}


COMPUTATIONS: dict[str, Callable[[], golden.Results]] = {
    function.__name__: function
    for function in (
        packs,
        posture,
        branches,
        step,
        ten_steps,
        implicit_steps,
        implicit_steps_of_objects,
        event,
        derivatives,
        gradient,
    )
}


@kernel
def number_after_the_last(vector):
    return vector[vector.size]


@kernel
def lanes_after_the_last(vector):
    return load_pack(vector, vector.size - 3)


def error_of(function: Callable, *arguments: Any) -> str:
    """Class of the exception that a call raises."""
    try:
        function(*arguments)
    except Exception as error:
        return type(error).__name__
    return ""


def lines_of_kernels() -> golden.Results:
    """Share of three kernels' lines that a tracer, such as a debugger, sees during evaluations.

    One that Python calls, one that is called by its address, one that is inlined.
    """
    from multiarm.dynamics.equations import evaluate_state

    floating = ma.compile_system(parse_scene(satellite_scene()), arms="compiled")
    systems, seen = (dividing(), floating), {}
    for function in (evaluate_state, update_robots, outwards):
        seen[function.py_func.__code__] = set()

    def trace(frame, event, argument):
        if frame.f_code not in seen:
            return None
        if event == "line":
            seen[frame.f_code].add(frame.f_lineno)
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        for system in systems:
            ma.evaluate(system)
    finally:
        sys.settrace(before)
    return {code.co_name: len(lines) / len(_lines_of(code)) for code, lines in seen.items()}


def _lines_of(code: CodeType) -> set[int]:
    """Lines with code, but that of the definition."""
    return {line for *_, line in code.co_lines() if line not in (None, code.co_firstlineno)}


@cache
def frozen_cases() -> dict[str, Any]:
    """The frozen cases, read once: they are some megabytes."""
    return golden.load()


ONE_WITH_A_PATH = "hard far_origin"


class EvaluatedCase(golden.Case):
    """A case as fast as its evaluations: what a compilation searches takes seconds, interpreted.

    Postures are the frozen ones.
    """

    def scene(self) -> ma.Scene:
        scene = super().scene()
        results = frozen_cases()[self.name]["results"]
        postures = {
            name: results[f"start/joint_positions/{name}"]["value"]
            for name, arm in scene.arms.items()
            if arm.posture == SOLVE
        }
        arms = {
            name: arm.model_copy(update={"posture": postures.get(name, arm.posture)})
            for name, arm in scene.arms.items()
        }
        return scene.replace(arms=arms)


def evaluated_cases() -> Iterator[golden.Case]:
    """Example scenes with compiled arms, and hard cases; evaluations without runs.

    Of the scenes that follow a path of the object, for which a compilation searches hundreds of
    postures, the one with the fewest.
    """
    for case in golden.cases():
        sort = case.name.partition(" ")[0]
        chosen = sort == "hard" or (sort == "example" and case.arms == "compiled")
        chosen = chosen and not case.brief  # of robots with several tips, whose compilation is long
        if chosen and (case.name == ONE_WITH_A_PATH or not _has_path(case.scene())):
            yield EvaluatedCase(case.name, case.source, case.arms, runs={})


def _has_path(scene: ma.Scene) -> bool:
    return bool(getattr(scene.control, "path", None))


def main() -> None:
    """Print all results."""
    for case in evaluated_cases():
        _show(case.name, golden.measure(case, frozen_cases()[case.name]["states"])[0])
    for name, compute in COMPUTATIONS.items():
        _show(name, compute())
    _show("number_after_the_last", error_of(number_after_the_last, np.zeros(4)))
    _show("lanes_after_the_last", error_of(lanes_after_the_last, np.zeros(4)))
    _show("lines_of_kernels", lines_of_kernels())


def as_json(results: Any) -> str:
    """Results with their arrays as nested lists."""
    return json.dumps(results, default=lambda array: array.tolist())


def _show(name: str, result: Any) -> None:
    print(as_json([name, result]), flush=True)


if __name__ == "__main__":
    main()
