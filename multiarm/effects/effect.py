r"""User-defined effects: a name, parameters, and the forces they add to the equations of motion.

.. code-block:: python

    class Spring(ma.Effect):
        name = "spring"

        class Spec(ma.Effect.Spec):
            stiffness: float  # [N/m]

        def forces(self, t, state):
            pull = -self.spec.stiffness * state.object_position  # [N]
            return ma.Loads(object_wrench=[*pull, 0, 0, 0])

    ma.register_effect(Spring)  # or an entry point of its package, group "multiarm.effects"

A scene then has ``effects: {spring: {stiffness: 200}}``.  ``forces`` is called at every evaluation,
some microseconds each.  Where a scene has several objects, it returns their wrenches by name:
``ma.Loads(object_wrenches={"beam": [*pull, 0, 0, 0]})``.  To stay in compiled code, an effect
defines ``build`` instead, see :mod:`multiarm.dynamics.effect_kernels`.

The forces must be smooth functions of time and state: the integrator notices jumps only by its
error estimates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from multiarm.dynamics.layout import Layout
from multiarm.dynamics.state import State, checked_vector, fill_by_arm
from multiarm.errors import ControlError
from multiarm.scene.faults import shown, unknown
from multiarm.scene.registry import UserSpec

if TYPE_CHECKING:
    from multiarm.dynamics.effect_kernels import EffectKernel
    from multiarm.effects.building import BuildContext


@dataclass(frozen=True)
class Loads:
    """Forces of an effect at one time; those left out are zero.

    Attributes
    ----------
    object_wrench : array-like, shape (6,)
        Force [N] and moment about the centre of mass [N m] on the object, world axes.
    joint_torques : mapping of str to array-like, shape (n_i,)
        Arm name -> torques of its joints, base to tip [N m], sliding joints [N].
    object_wrenches : mapping of str to array-like, shape (6,)
        Object name -> what ``object_wrench`` is, for scenes with several objects.
    """

    object_wrench: ArrayLike = field(default_factory=lambda: np.zeros(6))
    joint_torques: Mapping[str, ArrayLike] = field(default_factory=dict)
    object_wrenches: Mapping[str, ArrayLike] = field(default_factory=dict)


class Effect:
    """Base class of user-defined effects; define ``name``, ``Spec``, and ``forces`` or ``build``.

    Every thread has its own instance.

    Attributes
    ----------
    name : str
        Key of the effect in scenes, and of its work in trajectories.
    Spec : type
        Pydantic model of the parameters under this key.
    picture : str
        What it adds, in a sentence of everyday words.
    example : str
        The effect in YAML, as a scene has it.
    default : mapping, optional
        Typical parameters, with which the effect's influence on a scene is estimated.
    spec : Spec
        The validated parameters.
    """

    class_sort: ClassVar[str] = "effect"
    picture: ClassVar[str] = ""
    example: ClassVar[str] = ""
    default: ClassVar[Mapping[str, Any] | None] = None
    name: ClassVar[str] = ""
    Spec: ClassVar[type] = UserSpec

    def __init__(self, spec: Any) -> None:
        self.spec = spec

    def forces(self, t: float, state: State) -> Loads:
        """The forces at a time [s] and a state, and of nothing else."""
        raise NotImplementedError

    def build(self, context: BuildContext) -> list[EffectKernel]:
        """The kernels and arrays of this effect in a system; by default one that calls ``forces``.

        A compiled kernel in its place costs no more than its arithmetic.
        """
        from multiarm.effects.building import forces_kernel

        read = partial(_stacked, self.name, context.layout)
        return [forces_kernel(self.name, lambda: self._copy().forces, read, context.layout)]

    def _copy(self) -> Effect:
        """Another instance, with the attributes that ``build`` has added to this one."""
        copy = type(self)(self.spec)
        copy.__dict__ |= {k: v for k, v in vars(self).items() if k not in vars(copy)}
        return copy

    @classmethod
    def definition_fault(cls) -> str:
        """Why the class cannot be an effect; empty when it can."""
        if not isinstance(cls.name, str) or not cls.name.isidentifier():
            return f"'name' must be a word that a scene can have as a key, it is {cls.name!r}"
        if not isinstance(cls.Spec, type) or not hasattr(cls.Spec, "model_validate"):
            return "'Spec' must be a pydantic model, such as a subclass of multiarm.Effect.Spec"
        if cls.forces is Effect.forces and cls.build is Effect.build:
            return "it defines neither 'forces' nor 'build'"
        return ""


def _stacked(name: str, layout: Layout, loads: object) -> np.ndarray:
    """Wrenches on the objects and torques of all joints, shape (6 F + n,)."""
    who = f"the effect {name!r}"
    if not isinstance(loads, Loads):
        raise ControlError(f"{who} returned {type(loads).__name__}; return multiarm.Loads(...)")
    forces = np.zeros(layout.nv)
    _fill_wrenches(who, layout, layout.twists(forces), loads)
    torques = layout.joint_rates(forces)
    fill_by_arm(f"{who}: joint_torques", layout, torques, loads.joint_torques, ControlError)
    return forces


def _fill_wrenches(who: str, layout: Layout, wrenches: np.ndarray, loads: Loads) -> None:
    """Write the wrenches on all objects, (F, 6)."""
    wrench = checked_vector(f"{who}: object_wrench", loads.object_wrench, 6, ControlError)
    example = f"object_wrenches={{{layout.objects[0]!r}: 6 numbers}}"
    if not isinstance(loads.object_wrenches, Mapping):
        got = shown(loads.object_wrenches)
        raise ControlError(f"{who}: needs a dict by object, such as {example}, got {got}")
    if len(layout.objects) == 1:
        wrenches[0] = wrench
    elif np.any(wrench):
        raise ControlError(
            f"{who}: object_wrench: there are {len(layout.objects)} objects, "
            f"{', '.join(layout.objects)}; return {example}"
        )
    for name, values in loads.object_wrenches.items():
        if name not in layout.objects:
            fault = unknown("object", name, layout.objects)
            raise ControlError(f"{who}: object_wrenches: {fault}")
        place = f"{who}: object_wrenches[{name!r}]"
        wrenches[layout.objects.index(name)] += checked_vector(place, values, 6, ControlError)
