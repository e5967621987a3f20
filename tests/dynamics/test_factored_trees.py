"""Claims about blocks that are eliminated by the factors of their inertias.

Oracle: the same scenes with Pinocchio's inertias, eliminated by their entries.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mechanics import data_of
from tree_scenes import DOWN, cart_scene, hinge_urdf, link_urdf

import multiarm as ma
from multiarm.dynamics.contact_geometry import block_inertias
from multiarm.dynamics.momenta import write_momenta
from multiarm.dynamics.solver.tree_tables import open_tree
from multiarm.errors import SolverError
from multiarm.scene import parse_scene

HANDS = {"left": "left_rubber_hand", "right": "right_rubber_hand"}
BOX = {"shape": {"box": [0.2, 0.3, 0.2]}, "mass": 3.0, "pose": {"xyz": [0.3, 0.0, 1.0]}}
HELD = [{"arm": "a/left", "kind": "weld"}, {"arm": "a/right", "kind": "ball"}]
ARM = {"robot": "ur5", "base": {"xyz": [0.2, 1.0, 0.6]}, "tips": {"tip": "tool0"}}


def humanoid(y: float = 0.0) -> dict[str, Any]:
    return {
        "robot": "g1_29dof_rev_1_0",
        "base": {"moves": "free", "xyz": [0.0, y, 0.79], "twist": [0.1, 0.0, 0.2, 0.3, -0.1, 0.2]},
        "tips": HANDS,
    }


def scene(robots: dict[str, Any], *joints: dict[str, Any]) -> ma.Scene:
    return parse_scene(
        {
            "gravity": DOWN,
            "object": BOX,
            "robots": {"a": humanoid(), **robots},
            "joints": [*HELD, *joints],
        }
    )


SCENES = {
    "alone": (scene({}), [True]),
    "joined": (
        scene({"b": humanoid(1.0)}, {"between": ["a/left", "b/right"], "kind": "ball"}),
        [True],
    ),
    "joined to an arm": (
        scene({"b": ARM}, {"between": ["a/left", "b/tip"], "kind": "ball"}),
        [False],
    ),
    "beside one": (scene({"b": humanoid(3.0)}), [True, True]),
}


@pytest.mark.parametrize("name", SCENES)
def test_factors_and_entries_of_inertias_say_the_same(name, rng):
    """Accelerations, inertias and momenta; only blocks of trees have factors."""
    drawn, factored = SCENES[name]
    systems = [ma.compile_system(drawn, arms=arms) for arms in ("compiled", "pinocchio")]
    state = systems[0].initial_state()
    state.velocity[:] += 0.3 * rng.normal(size=state.velocity.size)
    compiled, exact = (ma.evaluate(system, 0.0, state) for system in systems)
    scale = np.max(np.abs(exact.accelerations))
    np.testing.assert_allclose(compiled.accelerations, exact.accelerations, atol=1e-10 * scale)
    assert (
        compiled.residuals.arm
        < 1e-10 * np.max(np.abs(block_inertias(data_of(systems[0]))[0])) * scale
    )
    data, pinocchio = map(data_of, systems)
    trees = [open_tree(row) for row in data.work.trees.block]
    assert [tree.factors != 0 for tree in trees] == factored
    for made, M in zip(block_inertias(data), block_inertias(pinocchio), strict=True):
        np.testing.assert_allclose(made, M, atol=1e-11 * np.max(np.abs(M)))
    momenta = [np.empty_like(state.velocity) for _ in systems]
    for data, written in zip(map(data_of, systems), momenta, strict=True):
        write_momenta(data.struct, written)
    np.testing.assert_allclose(*momenta, atol=1e-11 * np.max(np.abs(momenta)))


def test_a_law_that_reads_inertias_has_those_of_its_state(rng):
    """From a system's first evaluation on, whose data may be those of its compilation."""
    drawn = parse_scene({**cart_scene(), "control": {"kind": "computed_torque"}})
    systems = [ma.compile_system(drawn, arms=arms) for arms in ("compiled", "pinocchio")]
    state = systems[0].initial_state()
    joints = state.layout.joint_positions(state.position)
    joints += 0.1 * rng.normal(size=joints.size)
    state.velocity[:] += 0.3 * rng.normal(size=state.velocity.size)
    compiled, exact = (ma.evaluate(system, 0.0, state).accelerations for system in systems)
    np.testing.assert_allclose(compiled, exact, atol=1e-10 * np.max(np.abs(exact)))
    assert open_tree(data_of(systems[0]).work.trees.block[0]).factors == 0


def test_a_joint_without_inertia_is_named(tmp_path):
    """The last link of the first branch has no mass."""
    parts = [link_urdf("root")]
    for branch in "ab":
        before = "root"
        for k in range(6):
            link = f"{branch}{k}"
            hinge = hinge_urdf(link).replace("'root'", f"'{before}'").replace("0 0 1", "0 1 0")
            parts += [link_urdf(link, 0.0 if link == "a5" else 1.0), hinge]
            before = link
    path = tmp_path / "branches.urdf"
    path.write_text(f"<robot name='branches'>{''.join(parts)}</robot>")
    base = {"moves": "free", "mass": 1.0, "inertia": [1.0, 1.0, 1.0]}
    robot = {"urdf": str(path), "base": base, "tips": {"tip": "b5", "free": "a5"}}
    held = {"arm": "robot/tip", "kind": "weld"}
    branches = parse_scene({"object": BOX, "robots": {"robot": robot}, "joints": [held]})
    told = []
    for arms in ("compiled", "pinocchio"):
        with pytest.raises(SolverError) as caught:
            ma.evaluate(ma.compile_system(branches, arms=arms))
        told.append(str(caught.value))
    assert told[0] == told[1] and "robot" in told[0]
