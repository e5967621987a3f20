"""How a run ended, in words and numbers that any file format can hold."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from multiarm.errors import TrajectoryError

# Types that JSON knows, whatever the value.
_PLAIN = (str, int, bool, type(None))

STATUSES = ("completed", "interrupted", "failed")


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Parameters
    ----------
    status : {"completed", "interrupted", "failed"}
    message : str
        What happened and, unless all went well, the remedy.
    statistics : dict
        steps, rejected_steps, evaluations, wall_time_s, realtime_factor, error_estimate, ...
    events : list of dict
        What happened on the way, in order of time.
    certificate : dict or None
        The evidence that the asked accuracy was reached.
    """

    status: str
    message: str
    statistics: dict[str, Any] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)
    certificate: dict[str, Any] | None = None

    def __post_init__(self) -> None:
        if self.status not in STATUSES:
            raise TrajectoryError(f"unknown status {self.status!r}; a run ends {STATUSES}")


def plain(value: Any) -> Any:
    """The same value in what JSON knows; a number that is not finite becomes None."""
    if type(value) in _PLAIN:
        return value
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, Iterable):
        return [plain(item) for item in value]
    return str(value)
