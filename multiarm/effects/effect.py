r"""An effect of one's own: a name, parameters, and the forces it adds to the equations of motion.

.. code-block:: python

    class Spring(ma.Effect):
        name = "spring"

        class Spec(ma.Effect.Spec):
            stiffness: float  # [N/m]

        def forces(self, t, state):
            pull = -self.spec.stiffness * state.object_position  # [N]
            return ma.Loads(object_wrench=[*pull, 0, 0, 0])

    ma.register_effect(Spring)  # or an entry point of its package, group "multiarm.effects"

A scene then has ``effects: {spring: {stiffness: 200}}``.  ``forces`` is called back at every
evaluation, some microseconds each.  An effect that shall not leave compiled code defines ``build``
in its place, see :mod:`multiarm.dynamics.effect_kernels`.

The forces must be smooth functions of time and state: a method of high order sees jumps only by
what they do to its errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from multiarm.scene.own_effects import OwnSpec

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from multiarm.dynamics.effect_kernels import EffectKernel
    from multiarm.dynamics.state import State
    from multiarm.effects.context import BuildContext

__all__ = ["Effect", "Loads"]


@dataclass(frozen=True)
class Loads:
    """What an effect adds to the equations of motion at one moment; what is left out is zero.

    Attributes
    ----------
    object_wrench : array-like, shape (6,)
        Force [N] and moment about the centre of mass [N m] on the object, world axes.
    joint_torques : mapping of str to array-like, shape (n_i,)
        Arm name -> torques of its joints, base to tip [N m], sliding joints [N].
    """

    object_wrench: ArrayLike = field(default_factory=lambda: np.zeros(6))
    joint_torques: Mapping[str, ArrayLike] = field(default_factory=dict)


class Effect:
    """Base class of effects of one's own; define ``name``, ``Spec``, and ``forces`` or ``build``.

    Parameters
    ----------
    spec : Spec
        The validated parameters.

    Every system makes an instance for itself, so that runs in several threads share none.

    Attributes
    ----------
    name : str
        Under which scenes have it; the name of its work in a trajectory.
    Spec : type
        Pydantic model of its parameters: what stands under the name in a scene.
    spec : Spec
    """

    name: ClassVar[str] = ""
    Spec: ClassVar[type] = OwnSpec

    def __init__(self, spec: Any) -> None:
        self.spec = spec

    def forces(self, t: float, state: State) -> Loads:
        """The forces at a time [s] and a state; a function of these two alone."""
        raise NotImplementedError

    def build(self, context: BuildContext) -> list[EffectKernel]:
        """The kernels and arrays of this effect in a system; by default one that calls ``forces``.

        A kernel calls nothing in Python, and an evaluation costs what its arithmetic costs.
        """
        from multiarm.effects.called import called_kernel

        return [called_kernel(self.name, lambda: type(self)(self.spec).forces, context.layout)]

    @classmethod
    def lacks(cls) -> str:
        """What the class lacks to be an effect, in words; empty when it is one."""
        if not isinstance(cls.name, str) or not cls.name.isidentifier():
            return f"'name' must be a word that a scene can have as a key, it is {cls.name!r}"
        if not isinstance(cls.Spec, type) or not hasattr(cls.Spec, "model_validate"):
            return "'Spec' must be a pydantic model, such as a subclass of multiarm.Effect.Spec"
        if cls.forces is Effect.forces and cls.build is Effect.build:
            return "it defines neither 'forces' nor 'build'"
        return ""
