"""The model of a scene: bodies, joints and effects first, then what only the start tells.

:func:`uncontrolled_model` is complete for a scene without control.  From the start follow the free
motions of joints that list their contacts (:func:`with_joint_frames`), and the control
(:func:`with_control`); both are derived from the same model, as any later one is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.arms.backends import ArmBackends
from multiarm.assembly.joints import Rows
from multiarm.assembly.robots import Robots, gravity_of
from multiarm.contacts.joint import Joint, JointFrame
from multiarm.control.program import ControlProgram
from multiarm.dynamics.arrays import COUPLED, Constants, FreeComponents, TipFrame
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
    write_general_rows,
)
from multiarm.dynamics.held_control import with_held_control
from multiarm.dynamics.model import Model, effect_constants, row_constants
from multiarm.dynamics.solver_monitor import compare_solution, record_solution
from multiarm.effects.building import BuildContext, effect_program
from multiarm.effects.unilateral import unilateral_kernels
from multiarm.integration.near_singular import evaluate_near_singular
from multiarm.integration.projection import project_state
from multiarm.integration.reporting_guards import check_reports, reporting_guards
from multiarm.integration.step import watch_stage
from multiarm.jit.rows import as_row
from multiarm.scene import Scene

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
    rows: Rows,
    backends: ArmBackends,
) -> Model:
    """The model of a scene without its control.

    The free motions of joints are those that their kinds fix; contacts of two surfaces are not
    located yet.
    """
    arms, layout, unilateral = robots.arms, rows.layout, rows.unilateral
    outlines = {name: arm.joints for name, arm in robots.resolved.items()}
    context = BuildContext(scene, arms, layout, outlines)
    effects = effect_program(context, unilateral_kernels(unilateral, layout.joints))
    of_arms = {name: rows.on_links[name] for name in arms}
    enforced = frozenset() if unilateral is None else unilateral.enforced
    limits = {name: joint.limits for name, joint in joints.items()}
    frames = {name: joint.frame for name, joint in joints.items()}
    levers = [arms[name].levers(frame.on_tip[:3, 3]) for name, frame in frames.items()]
    guards = reporting_guards(of_arms, limits, layout, effects.watched, enforced)
    without_arm = layout.owner_count - len(arms)  # the surroundings, where they have rows
    return Model(
        arms=arms,
        robots=robots.resolved,
        joints=dict(joints),
        backends=backends,
        layout=layout,
        contacts={name: rows.records[name] for name in arms},
        records=tuple(record for on_link in rows.on_links.values() for record in on_link),
        surfaces=tuple(rows.packed.surfaces),
        frames=frames,
        constants=_constants(scene, arms, frames, rows, effects, backends),
        effects=effects,
        links=tuple(context.links),
        levers=(*levers, *[np.zeros(0)] * without_arm),
        functions=FUNCTIONS | REPORT_FUNCTIONS if guards else FUNCTIONS,
        lazy_functions=LAZY_FUNCTIONS,
        breakpoints=effects.breakpoints,
        pair_places=np.zeros((len(rows.packed.table.shapes), 3)),
        unilateral=unilateral,
        guards=guards,
    )


def with_joint_frames(model: Model, frames: Mapping[str, JointFrame]) -> Model:
    """The same model with other free motions of its joints."""
    constants = model.constants._replace(**_frame_constants(model.arms, frames))
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


def _constants(
    scene: Scene,
    arms: Mapping[str, Arm],
    frames: Mapping[str, JointFrame],
    rows: Rows,
    effects: EffectProgram,
    backends: ArmBackends,
) -> Constants:
    return Constants(
        q_slots=backends.q_slots,
        circular=np.concatenate([arm.circular for arm in arms.values()]).astype(np.int64),
        tip_frames=np.array(
            [as_row(TipFrame(arm.tip_rotation, arm.tip_translation)) for arm in arms.values()]
        ),
        object_mass=float(scene.object.mass),
        object_inertia=np.ascontiguousarray(scene.object.inertia_matrix()),
        gravity=gravity_of(scene),
        control=NO_CONTROL,
        sampled=NO_CONTROL,
        sample_delay=False,
        control_reach=COUPLED,
        dense=scene.run.solver == "dense",
        calls_user=bool(rows.packed.surfaces) or effects.calls_user,
        **_frame_constants(arms, frames),
        **row_constants(rows.packed.table, rows.layout),
        **effect_constants(effects),
    )


def _frame_constants(arms: Mapping[str, Arm], frames: Mapping[str, JointFrame]) -> dict[str, Any]:
    """Constants of the joints' frames and their free motions, in the order of the arms."""
    in_order = [frames[name] for name in arms]
    packed = [
        frame.packed(arm.tip_rotation, arm.tip_translation)
        for arm, frame in zip(arms.values(), in_order, strict=True)
    ]
    free = [pair for f in in_order for pair in zip(f.free, f.places, strict=True)]
    components, coordinates = np.array(free, dtype=np.int64).reshape(-1, 2).T.copy()
    bounds = np.cumsum([0, *(len(frame.free) for frame in in_order)])
    return {
        "joint_frames": np.array(packed),
        "free": FreeComponents(bounds, component=components, coordinate=coordinates),
    }
