"""Typical parameters of each effect, to estimate its influence on a scene."""

from __future__ import annotations

from typing import Any

from multiarm.scene import EFFECTS, Scene
from multiarm.scene.effects import BUILT_IN


def defaults(scene: Scene) -> dict[str, Any]:
    """Name -> parameters, as in a scene, of all effects that have typical ones.

    Of user-defined effects, those with a class attribute ``default``.
    """
    body = scene.one_object("a table of typical effects")
    typical = {name: kind.typical(body) for name, kind in BUILT_IN.items()}
    typical |= {name: getattr(EFFECTS.find(name), "default", None) for name in EFFECTS.names()}
    return {name: parameters for name, parameters in typical.items() if parameters is not None}
