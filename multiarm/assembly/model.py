"""The model of a scene: bodies, joints and effects first, then what only the start tells.

:func:`uncontrolled_model` is complete for a scene without control.  From the start follow the free
motions of joints that list their contacts (:func:`with_joint_frames`), and the control
(:func:`with_control`); both are derived from the same model, as any later one is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from multiarm.assembly.joints import SceneRows
from multiarm.assembly.robots import Robots, gravity_of
from multiarm.contacts.joint import FRAME_WIDTH, Joint, JointFrame
from multiarm.control.program import ControlProgram
from multiarm.dynamics.arrays import COUPLED, Constants, FloatingBases, FreeComponents, TipFrame
from multiarm.dynamics.connections import BodyTable, Connection, Connections, surroundings_of
from multiarm.dynamics.control_laws import NO_CONTROL, are_differentiable, law_table
from multiarm.dynamics.effect_kernels import EffectProgram
from multiarm.dynamics.equations import (
    control_of_closed,
    kinematics,
    right_hand_sides,
    solve,
    solve_again,
    solve_decomposed,
    solve_deficient,
    solve_several,
    write_general_rows,
)
from multiarm.dynamics.held_control import with_held_control
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.model import Model, effect_constants, row_constants
from multiarm.dynamics.solver.tree_tables import pays_as_tree
from multiarm.dynamics.solver_monitor import compare_solution, record_solution
from multiarm.effects.building import BuildContext, effect_program
from multiarm.effects.unilateral import unilateral_kernels
from multiarm.integration.near_singular import evaluate_near_singular
from multiarm.integration.projection import project_state
from multiarm.integration.reporting_guards import check_reports, reporting_guards
from multiarm.integration.step import watch_stage
from multiarm.jit.kernels import Kernel
from multiarm.jit.rows import as_row, width
from multiarm.robots.backends import Backends
from multiarm.robots.robot import Robot
from multiarm.scene import Scene
from multiarm.scene.values import of_surroundings

# Functions of an evaluation: compiled at once, and when first called.
FUNCTIONS = {
    "kinematics": kinematics,
    "forces": right_hand_sides,
    "solve": solve,
    "solve_frictionless": solve,
    "record": record_solution,
    "compare": compare_solution,
    "project_state": project_state,
}
# Those of scenes with guards that only report.
REPORT_FUNCTIONS = {"reports": check_reports, "watch": watch_stage}
LAZY_FUNCTIONS = {
    "command": control_of_closed,
    "coupled": solve_deficient,
    "decomposed": solve_decomposed,
    "solve_again": solve_again,
    "general_rows": write_general_rows,
    "near_singular": evaluate_near_singular,
}


def uncontrolled_model(
    scene: Scene,
    robots: Robots,
    joints: Mapping[str, Joint],
    rows: SceneRows,
    backends: Backends,
) -> Model:
    """The model of a scene without its control.

    The free motions of joints are those that their kinds fix; contacts of two surfaces are not
    located yet.
    """
    by_name, layout, unilateral = robots.by_name, rows.layout, rows.unilateral
    outlines = {name: robot.joints for name, robot in robots.resolved.items()}
    context = BuildContext(scene, by_name, layout, outlines)
    effects = effect_program(context, unilateral_kernels(unilateral, layout.rate_count))
    of_robots = {
        name: on_link for name, on_link in rows.on_links.items() if not of_surroundings(name)
    }
    enforced = frozenset() if unilateral is None else unilateral.enforced
    limits = {name: joint.limits for name, joint in joints.items()}
    frames = {name: joint.frame for name, joint in joints.items()}
    bodies = BodyTable(by_name, backends.links, layout)
    connections = bodies.connections(rows.connections | surroundings_of(layout.objects))
    guards = reporting_guards(of_robots, limits, layout, connections, effects.watched, enforced)
    return Model(
        robots=by_name,
        resolved_robots=robots.resolved,
        connections=rows.connections,
        joints=dict(joints),
        backends=backends,
        layout=layout,
        contacts={name: rows.records[name] for name in of_robots},
        records=tuple(record for on_link in rows.on_links.values() for record in on_link),
        surfaces=tuple(rows.packed.surfaces),
        frames=frames,
        constants=_constants(scene, bodies, connections, frames, rows, effects, backends),
        effects=effects,
        effect_links=tuple(context.links),
        levers=tuple(_levers(by_name, rows.connections, frames, layout)),
        trees=_trees(by_name, layout),
        functions=_functions(layout) | (REPORT_FUNCTIONS if guards else {}),
        lazy_functions=LAZY_FUNCTIONS,
        breakpoints=effects.breakpoints,
        pair_places=np.zeros((len(rows.packed.table.shapes), 3)),
        unilateral=unilateral,
        guards=guards,
    )


def _functions(layout: Layout) -> dict[str, Kernel]:
    """``FUNCTIONS``; with several objects the node has more unknowns than a constant tells."""
    if layout.frames == 1:
        return FUNCTIONS
    return FUNCTIONS | {"solve": solve_several, "solve_frictionless": solve_several}


def with_joint_frames(model: Model, frames: Mapping[str, JointFrame]) -> Model:
    """The same model with other free motions of its joints."""
    bodies = BodyTable(model.robots, model.backends.links, model.layout)
    of_frames = _frame_constants(bodies, model.layout.owners, model.connections, frames)
    constants = model.constants._replace(**of_frames)
    return replace(model, frames=dict(frames), constants=constants)


def with_control(model: Model, control: ControlProgram) -> Model:
    """The same model with the control of its scene."""
    constants = model.constants._replace(
        control=law_table(control.laws, model.effects.end), control_reach=control.reach
    )
    if control.sampling is not None:
        constants = with_held_control(
            constants, constants.control, are_differentiable(control.laws), control.sampling.delay
        )
    if control.counts_friction:
        model = model.counting_friction()
    controlled = replace(
        model,
        constants=constants,
        breakpoints=np.union1d(model.breakpoints, control.breakpoints),
        laws=control.laws,
        sampling=control.sampling,
        control_span=control.span,
    )
    if control.python is None:
        return controlled
    return controlled.with_python_control(control.python, control.sampling)


def _trees(robots: Mapping[str, Robot], layout: Layout) -> dict[int, np.ndarray]:
    """``Model.trees``."""
    in_order, trees = list(robots.values()), {}
    for block in layout.blocks_of_robots:
        before, parents = 0, []
        for robot, first, count in layout.parts_of_blocks[block]:
            of_part = in_order[robot].parent_numbers[first : first + count] - first
            parents.append(np.where(of_part >= 0, of_part + before, -1))
            before += count
        if pays_as_tree(of_block := np.concatenate(parents)):
            trees[block] = of_block
    return trees


def _levers(
    robots: Mapping[str, Robot],
    connections: Mapping[str, Connection],
    frames: Mapping[str, JointFrame],
    layout: Layout,
) -> list[np.ndarray]:
    """Longest lever of every joint of each block on the contacts of its connections [m]."""
    levers = {name: [np.zeros(robot.dof)] for name, robot in robots.items()}
    for name, pair in connections.items():
        ends = (pair.first, frames[name].on_tip), (pair.second, frames[name].on_object)
        for body, frame in ends:
            if body.robot:
                robot = robots[body.robot]
                levers[body.robot].append(robot.levers(frame[:3, 3], body.tip))
    largest = [np.max(of_robot, axis=0) for of_robot in levers.values()]
    longest = np.concatenate([np.zeros(0), *largest])
    longest = np.where(longest > 0.0, longest, 1.0)
    return [longest[layout.joints_of_block(i)] for i in range(layout.block_count)]


def _constants(
    scene: Scene,
    bodies: BodyTable,
    connections: Connections,
    frames: Mapping[str, JointFrame],
    rows: SceneRows,
    effects: EffectProgram,
    backends: Backends,
) -> Constants:
    return Constants(
        q_slots=backends.q_slots,
        circular=_circular(bodies.robots),
        first_joint=np.array(rows.layout.first_joint, dtype=np.int64),
        floating_bases=_floating_bases(rows.layout, backends),
        undriven=rows.layout.undriven_joints,
        links=bodies.links(),
        connections=connections,
        object_masses=np.array([body.mass for body in scene.all_objects.values()]),
        object_inertias=np.array([body.inertia_matrix() for body in scene.all_objects.values()]),
        gravity=gravity_of(scene),
        control=NO_CONTROL,
        sampled=NO_CONTROL,
        sample_delay=False,
        control_reach=COUPLED,
        dense=scene.run.solver == "dense",
        calls_user=bool(rows.packed.surfaces)
        or effects.calls_user
        or (rows.unilateral is not None and rows.unilateral.has_functions),
        **_frame_constants(bodies, rows.layout.owners, rows.connections, frames),
        **row_constants(rows.packed.table, rows.layout),
        **effect_constants(effects),
    )


def _floating_bases(layout: Layout, backends: Backends) -> FloatingBases:
    """``Constants.floating_bases``."""
    robots = np.array(layout.floating_robots, dtype=np.int64)
    return FloatingBases(robots, backends.base_slots)


def _circular(robots: Mapping[str, Robot]) -> np.ndarray:
    """``Constants.circular``."""
    bases = {name: np.zeros(robot.base_dof) for name, robot in robots.items()}
    parts = [np.append(bases[name], robot.circular) for name, robot in robots.items()]
    return np.concatenate([[], *parts]).astype(np.int64)


def _frame_constants(
    bodies: BodyTable,
    owners: Sequence[str],
    connections: Mapping[str, Connection],
    frames: Mapping[str, JointFrame],
) -> dict[str, Any]:
    """Constants of tips, of joints' frames and of free motions, in the order of the owners."""
    tips, packed = np.zeros((len(owners), width(TipFrame))), np.zeros((len(owners), FRAME_WIDTH))
    free: list[tuple[int, int]] = []
    bounds = [0]
    for c, owner in enumerate(owners):
        if owner in connections:
            pair, frame = connections[owner], frames[owner]
            first, second = bodies.placement(pair.first), bodies.placement(pair.second)
            tips[c], packed[c] = as_row(TipFrame(*first)), frame.packed(first, second)
            free += zip(frame.free, frame.places, strict=True)
        bounds.append(len(free))
    components, coordinates = np.array(free, dtype=np.int64).reshape(-1, 2).T.copy()
    return {
        "tip_frames": tips,
        "joint_frames": packed,
        "free": FreeComponents(np.array(bounds), component=components, coordinate=coordinates),
    }
