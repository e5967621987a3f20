"""How a run ended, as results store it: in types of JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from multiarm.errors import TrajectoryError
from multiarm.notation import Word


class RunStatus(Word):
    """How a run may end."""

    COMPLETED = "completed"
    INTERRUPTED = "interrupted"
    FAILED = "failed"


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    status: RunStatus
    message: str  # how it ended and, after a failure, the remedy
    statistics: dict[str, Any] = field(default_factory=dict)  # steps, evaluations, wall_time_s, ...
    events: list[dict[str, Any]] = field(default_factory=list)
    certificate: dict[str, Any] | None = None
    remarks: list[str] = field(default_factory=list)  # what a user should know besides, clauses

    def __post_init__(self) -> None:
        try:  # files store the word
            object.__setattr__(self, "status", RunStatus(self.status))
        except ValueError:
            known = tuple(RunStatus)
            raise TrajectoryError(f"unknown status {self.status!r}; a run ends {known}") from None


def plain(value: Any) -> Any:
    """The value in types of JSON; a number that is not finite becomes None."""
    if value is None or isinstance(value, (str, int)):  # bool is an int
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, (dict, Mapping)):  # dict first: checks for abstract classes are slow
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # an array or number of NumPy, which commands import late
        return plain(value.tolist())
    if isinstance(value, (list, Iterable)):
        return [plain(item) for item in value]
    return str(value)
