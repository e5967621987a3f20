"""Runs of sibling scenes that criteria compare with: made once, on demand."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory
    from multiarm.scene import Scene


@cache
def reference_run(
    build: Callable[..., Scene], *arguments: Any, solver: str | None = None
) -> Trajectory:
    """The run of the scene ``build(*arguments)``, by another solver if one is named."""
    from multiarm.assembly.compilation import compile_system
    from multiarm.simulation.simulate import simulate

    scene = build(*arguments)
    if solver is not None:
        scene = scene.replace(run=scene.run.model_copy(update={"solver": solver}))
    return simulate(compile_system(scene), certificate=False)
