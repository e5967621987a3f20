"""What evaluations of a recorded run read of it: the part of a `Trajectory` below them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np

from multiarm.results.channels import Channel
from multiarm.results.outcome import RunStatus


class RecordedRun(Protocol):
    """A run's samples, and how it went."""

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Names of the arms, in the order of the scene."""

    @property
    def channels(self) -> Mapping[str, Channel]:
        """Recorded quantities by name."""

    @property
    def provenance(self) -> dict[str, Any]:
        """What the run was made of; also the limits of its joints, where they are known."""

    @property
    def status(self) -> RunStatus:
        """How it ended."""

    @property
    def message(self) -> str:
        """The same in words."""

    @property
    def statistics(self) -> dict[str, Any]:
        """Steps, evaluations, wall time and the like."""

    def __len__(self) -> int:
        """Number of samples."""

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Samples start..stop of a channel."""

    def blocks(self, *names: str) -> Iterator[list[np.ndarray]]:
        """The same samples of the named channels, a bounded number at a time."""
