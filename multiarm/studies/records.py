"""What every study records beside its numbers: the machine, and why a number is missing."""

from __future__ import annotations

import importlib.metadata
import platform
from contextlib import suppress
from typing import Any

from multiarm.errors import MultiarmError
from multiarm.results.sinks import provenance


def machine() -> dict[str, Any]:
    """Processor, platform and versions, as far as they are known."""
    about = {key: value for key, value in provenance("").items() if key != "scene"}
    for name in ("scipy", "mujoco", "drake"):
        with suppress(importlib.metadata.PackageNotFoundError):
            about["dependencies"][name] = importlib.metadata.version(name)
    return {"processor": _processor(), **about}


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
