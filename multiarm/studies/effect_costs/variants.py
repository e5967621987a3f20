"""Variants of a scene: without one effect, with one more, or with one simpler setting."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from multiarm.scene import Scene
from multiarm.simulation.inspection import active_effects

PRESENT, CANDIDATE, SETTING = "present", "candidate", "setting"
STABILIZATION, RECORDING, CERTIFICATE = "stabilization", "recording", "certificate"


@dataclass(frozen=True)
class Variant:
    """A scene that differs from the one that is looked at in one thing.

    Attributes
    ----------
    name : str
        Of that thing.
    kind : {"present", "candidate", "setting"}
        An effect that is left out, one that is added, or a setting of the run that is simpler.
    about : str
        What was done, in words.
    scene : callable
        Makes the scene; raises SceneError where there is none.
    """

    name: str
    kind: str
    about: str
    scene: Callable[[], Scene]


def without(scene: Scene, name: str) -> Scene:
    """The scene without an effect; gravity is one.

    Raises
    ------
    SceneError
        Something else in the scene needs it.
    """
    if name == "gravity":
        return scene.replace(gravity=None)
    kept = {key: spec for key, spec in scene.effects.named.items() if key != name}
    return scene.replace(effects=kept)


def left_out(scene: Scene) -> list[Variant]:
    """One variant for each effect of a scene."""
    return [
        Variant(name, PRESENT, "left out", partial(without, scene, name))
        for name in active_effects(scene)
    ]


def added(scene: Scene, candidates: Mapping[str, Any]) -> list[Variant]:
    """One variant for each effect that the scene does not have, with these parameters."""
    has = scene.effects.named
    return [
        Variant(
            name,
            CANDIDATE,
            f"added as {_words(spec)}",
            partial(scene.replace, effects={**has, name: spec}),
        )
        for name, spec in candidates.items()
        if name not in has
    ]


def simpler_settings(scene: Scene) -> list[Variant]:
    """The run without stabilisation, and with no samples but the first and the last."""
    run = scene.run
    found = []
    if run.stabilization.kind != "none" and run.integrator != "variational":
        about = f"none instead of {run.stabilization.kind}"
        found.append(
            Variant(STABILIZATION, SETTING, about, partial(_with_run, scene, stabilization="none"))
        )
    if run.output_step < run.duration:
        about = f"two samples instead of one every {run.output_step:g} s"
        found.append(
            Variant(RECORDING, SETTING, about, partial(_with_run, scene, output_step=run.duration))
        )
    return found


def _with_run(scene: Scene, **changes: Any) -> Scene:
    return scene.replace(run={**scene.run.model_dump(exclude_none=True), **changes})


def _words(spec: Any) -> str:
    """Parameters in one line, as a scene has them."""
    if isinstance(spec, Mapping):
        return "{" + ", ".join(f"{key}: {_words(value)}" for key, value in spec.items()) + "}"
    if isinstance(spec, (list, tuple)):
        return "[" + ", ".join(_words(value) for value in spec) + "]"
    return f"{spec:.4g}" if isinstance(spec, float) else str(spec)
