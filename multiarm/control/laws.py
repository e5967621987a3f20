"""From the control of a scene to its compiled laws.

Only the laws that a scene names are compiled; a scene without control has an empty program.
:data:`PROGRAMS` lists what builds each kind; each law is in the module of its builder, with its
equation, its numbers and its derivative.  Any of them but constant torques can be sampled
(:mod:`multiarm.dynamics.held_control`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from multiarm.control.gravity_compensation import gravity_compensation_program
from multiarm.control.harmonic import constant_program, harmonic_program
from multiarm.control.joint_pd import joint_pd_program
from multiarm.control.object_control import computed_torque_program, object_impedance_program
from multiarm.control.program import ControlContext, ControlProgram
from multiarm.control.recorded import recorded_program
from multiarm.control.user_control import Control, function_program, user_program
from multiarm.dynamics.held_control import Sampling
from multiarm.errors import ControlError
from multiarm.scene.bodies import WORLD
from multiarm.scene.control import (
    ComputedTorqueControl,
    ConstantControl,
    ControlKind,
    FunctionControl,
    GravityCompensationControl,
    HarmonicControl,
    JointPDControl,
    ObjectImpedanceControl,
    RecordedControl,
    SampledControl,
)

PROGRAMS: dict[type[ControlKind], Callable[[Any, ControlContext], ControlProgram]] = {
    ConstantControl: constant_program,
    HarmonicControl: harmonic_program,
    RecordedControl: recorded_program,
    GravityCompensationControl: gravity_compensation_program,
    JointPDControl: joint_pd_program,
    ComputedTorqueControl: computed_torque_program,
    ObjectImpedanceControl: object_impedance_program,
    FunctionControl: function_program,
    Control: user_program,
}
"""What builds the laws of each kind of control; kinds without an entry have none."""


def _check_bases(control: ControlKind, context: ControlContext) -> None:
    """Refuse controls that rest on bases, where one floats.

    They carry the weight of a robot that nothing holds, or follow paths of the object with the
    joints alone.

    Raises
    ------
    ControlError
    """
    floating = [name for name, robot in context.arms.items() if robot.floats]
    of_object = isinstance(control, ComputedTorqueControl | ObjectImpedanceControl)
    if floating and (of_object or any(control.paths(context.start.layout.objects).values())):
        what = f"kind '{control.kind}'" if of_object else "'path'"
        raise ControlError(
            f"control: {what} is not computed with a base that floats, that of robot "
            f"'{floating[0]}', which drives do not move; control the joints alone: 'joint_pd', "
            "'harmonic', 'constant', 'recorded', or a function in Python"
        )
    holds = isinstance(control, HarmonicControl) and control.hold
    carries = (control.compensates_gravity or holds) and context.scene.gravity is not None
    hovering = [name for name in floating if name not in _standing(context)]
    if not (carries and hovering):
        return
    what = f"kind '{control.kind}'"
    if holds:
        what = "'hold: true'"
    elif isinstance(control, JointPDControl | RecordedControl):
        what = "'gravity_compensation: true'"
    raise ControlError(
        f"control: {what} has nothing that carries a base that floats, that of robot "
        f"'{hovering[0]}': join the robot to the world (`between: [{hovering[0]}/..., world]`), or "
        "control the joints alone: 'joint_pd' with 'gravity_compensation: false', 'harmonic' with "
        "'hold: false', 'constant', 'recorded', or a function in Python"
    )


def _check_times(control: ControlKind, context: ControlContext) -> None:
    """Refuse controls that distribute wrenches over hands that come and go.

    Raises
    ------
    ControlError
    """
    timed = [joint.connection for joint in context.scene.joints if joint.intervals]
    if not timed:
        return
    what = ""
    if isinstance(control, ComputedTorqueControl | ObjectImpedanceControl):
        what = f"kind '{control.kind}'"
    elif any(control.paths(context.start.layout.objects).values()):
        what = "'path'"
    elif getattr(control, "friction_margin", None) is not None:
        what = "'friction_margin'"
    if what:
        raise ControlError(
            f"control: {what} is not computed with joints that hold for some of the time, such as "
            f"'{timed[0]}': it plans with the hands that hold the objects all the time; control "
            "the joints alone ('joint_pd', 'recorded', 'harmonic', 'constant'), or by "
            "'gravity_compensation' or a function in Python"
        )


def _standing(context: ControlContext) -> set[str]:
    """Robots whose base does not float, and robots and objects that joints tie to the world."""
    pairs = [(pair.first, pair.second) for pair in context.data.model.connections.values()]
    ends = [[body.robot or body.tip for body in pair] for pair in pairs]
    standing = {name for name, robot in context.arms.items() if not robot.floats} | {str(WORLD)}
    while reached := {end for pair in ends if standing & {*pair} for end in pair} - standing:
        standing |= reached
    return standing


def control_program(context: ControlContext) -> ControlProgram:
    """The control of a scene.

    Raises
    ------
    ControlError
        When the contacts cannot have the forces that the control commands.
    SceneError
        When a recorded table cannot be used.
    ModelError
        When a user class cannot be used.
    """
    control = context.scene.control
    _check_bases(control, context)
    _check_times(control, context)
    kind = next((kind for kind in type(control).__mro__ if kind in PROGRAMS), None)
    program = ControlProgram() if kind is None else PROGRAMS[kind](control, context)
    if not isinstance(control, SampledControl) or control.sample_time is None:
        return program
    sampling = Sampling(control.sample_time, control.sample_delay)
    # held torques change at samples only
    return replace(program, sampling=sampling, breakpoints=np.zeros(0))
