"""From the effects that a scene names to their kernels."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

from multiarm.dynamics.effect_kernels import EffectKernel, EffectProgram
from multiarm.effects.context import BuildContext
from multiarm.errors import ModelError
from multiarm.scene.effects import COME_AND_GO
from multiarm.scene.own_effects import find_effect


def effect_program(context: BuildContext, further: Sequence[EffectKernel] = ()) -> EffectProgram:
    """The kernels of the effects that the scene names, and further ones; no other is imported."""
    kernels = [*further]
    for name, spec in context.scene.effects.named.items():
        if name in COME_AND_GO:
            continue
        if name in type(context.scene.effects).model_fields:
            kernels += import_module(f"multiarm.effects.{name}").build(spec, context)
        else:
            kernels += _user_kernels(name, spec, context)
    return EffectProgram.of(kernels)


def _user_kernels(name: str, spec: Any, context: BuildContext) -> list[EffectKernel]:
    """The kernels of a user-defined effect."""
    effect = find_effect(name)
    if effect is None:
        raise ModelError(
            f"effects.{name}: the package of this effect is not installed; install it, or register "
            "its class with multiarm.register_effect"
        )
    try:
        found = effect(spec).build(context)
    except SystemExit as error:
        raise ModelError(f"effects.{name}: build raised SystemExit: {error}") from error
    if not isinstance(found, list) or not all(isinstance(k, EffectKernel) for k in found):
        raise ModelError(
            f"effects.{name}: build returned {type(found).__name__}; return a list of "
            "multiarm.effects.EffectKernel"
        )
    return found
