"""What every study records beside its numbers: the machine, and why a number is missing."""

from __future__ import annotations

import importlib.metadata
import platform
from contextlib import suppress
from typing import Any

from multiarm.errors import MultiarmError
from multiarm.results.sinks import provenance
from multiarm.scene import RunSpec, Scene, dump_scene
from multiarm.scene.run import DEFAULT_ACCURACY


def machine() -> dict[str, Any]:
    """Processor, platform and versions, as far as they are known."""
    about = {key: value for key, value in provenance("").items() if key != "scene"}
    for name in ("scipy", "mujoco"):
        with suppress(importlib.metadata.PackageNotFoundError):
            about["dependencies"][name] = importlib.metadata.version(name)
    return {"processor": _processor(), **about}


def about_scene(scene: Scene) -> dict[str, Any]:
    """The scene's name, duration and output step [s], and its text."""
    return {
        "name": scene.name,
        "duration_s": scene.run.duration,
        "output_step_s": scene.run.output_step,
        "text": dump_scene(scene),
    }


def accuracies(run: RunSpec, force: float) -> dict[str, float]:
    """What a run requests or has by default: motion, position, rotation, and force as given."""
    accuracy = run.accuracy
    motion = DEFAULT_ACCURACY if accuracy is None else accuracy.smallest
    return {
        "motion": motion,
        "position": (accuracy and accuracy.position) or motion,
        "rotation": (accuracy and accuracy.rotation) or motion,
        "force": (accuracy and accuracy.force) or force,
    }


def _processor() -> str:
    """The processor's name if the system gives it."""
    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as lines:
        for line in lines:
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def error_text(error: Exception) -> str:
    """What was raised: our own errors are sentences, others need their names."""
    text = str(error).strip()
    return text if isinstance(error, MultiarmError) else f"{type(error).__name__}: {text}"
