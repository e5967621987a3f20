r"""User-defined controls: a kind, parameters, and the torques that they mean.

.. code-block:: python

    @ma.register_control  # or an entry point of its package, group "multiarm.controls"
    class Spring(ma.Control):
        kind: Literal["spring"] = "spring"
        stiffness: float  # [N m/rad]

        def torques(self, t, state):
            return {arm: -self.stiffness * q for arm, q in state.joint_positions.items()}

A scene then has ``control: {kind: spring, stiffness: 200}``, and ``sample_time`` and
``sample_delay`` like any other.  To stay in compiled code, a control defines ``build`` instead,
which returns laws (:mod:`multiarm.dynamics.control_laws`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multiarm.dynamics.state import State
from multiarm.errors import ModelError
from multiarm.scene.control import FunctionControl, SampledControl
from multiarm.scene.registry import called

if TYPE_CHECKING:
    from multiarm.control.program import ControlContext, ControlProgram


class Control(SampledControl):
    """Base class of user-defined controls; define ``kind``, fields, and ``torques`` or ``build``.

    Every thread has its own instance.  What it remembers between calls belongs in private
    attributes (``_sum: float = 0.0``); a run is repeated for its certificate, and a control that
    gives other torques then cannot be certified.

    Attributes
    ----------
    sample_time : float, optional
        The torques are computed every ``sample_time`` [s] and held; absent: all the time.
    sample_delay : bool
        Torques act one sample later.
    picture : str
        What it does, in a sentence of everyday words.
    example : str
        The control in YAML, as a scene has it; may be empty.
    by_joint : tuple of str
        Fields with values by arm and joint, which are checked against the arms.
    """

    def torques(self, t: float, state: State) -> Mapping[str, np.ndarray]:
        """Arm -> torques of its joints, base to tip [N m, N]; those left out get none."""
        raise NotImplementedError

    def build(self, context: ControlContext) -> ControlProgram:
        """The compiled laws and their numbers; by default ``torques`` in Python.

        A law that needs ``data.control.gravity_torque`` overrides ``compensates_gravity``.
        """
        from multiarm.control.program import ControlProgram
        from multiarm.dynamics.callbacks import PythonControl

        def instance():
            return self.model_copy(deep=True).torques

        who = f"the control {self.kind!r}"
        return ControlProgram(python=PythonControl(self.torques, who, True, instance))

    @classmethod
    def definition_fault(cls) -> str:
        """Why the class cannot be a kind of control; empty when it can."""
        if cls.kind_fault():
            return cls.kind_fault()
        if cls.torques is Control.torques and cls.build is Control.build:
            return "it defines neither 'torques' nor 'build'"
        return cls.example_fault()


def user_program(control: Control, context: ControlContext) -> ControlProgram:
    """What a user control builds.

    Raises
    ------
    ModelError
        It is no program, or laws cannot be called.
    """
    from multiarm.control.program import ControlProgram
    from multiarm.dynamics.arrays import CARRYING, COUPLED
    from multiarm.dynamics.control_laws import ControlLaw

    who = f"control kind {control.kind!r}: build()"
    program = called(lambda: control.build(context), who)
    if not isinstance(program, ControlProgram):
        raise ModelError(
            f"{who} returned {type(program).__name__}; return a multiarm.control.ControlProgram"
        )
    for law in program.laws:
        if not isinstance(law, ControlLaw):
            raise ModelError(
                f"{who} returned a law that is {type(law).__name__}; return "
                f"multiarm.control.ControlLaw(kernel, numbers), with a NamedTuple of its numbers"
            )
        law.require_usable(who)
    if program.reach == CARRYING and program.laws and program.laws[-1].share_derivative is None:
        raise ModelError(
            f"{who} returned a program with `reach=CARRYING` whose last law does not say what its "
            f"arms share; give the law a `share_derivative`, or leave `reach` out"
        )
    if context.data.model.layout.splits_robots:
        # torques of a robot may depend on all of its joints, not on those of one block only
        return replace(program, reach=COUPLED)
    return program


def function_program(control: FunctionControl, _context: ControlContext) -> ControlProgram:
    """The controller in Python that a scene names."""
    from multiarm.control.program import ControlProgram
    from multiarm.dynamics.callbacks import PythonControl

    return ControlProgram(python=PythonControl(control.function, in_scene=True))
