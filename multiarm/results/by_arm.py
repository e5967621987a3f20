"""A quantity of every arm, as a trajectory gives it: a mapping that reads on access."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from multiarm.errors import TrajectoryError


class _MissingArmError(TrajectoryError, KeyError):
    """A KeyError whose text is a sentence."""

    __str__ = TrajectoryError.__str__


class ByArm(Mapping[str, np.ndarray]):
    """One quantity of every arm, and of the floor where it has contacts; read on access."""

    def __init__(self, quantity: str, names: dict[str, str], read: Callable[[str], np.ndarray]):
        self._quantity, self._names, self._read = quantity, names, read

    def __getitem__(self, arm: str) -> np.ndarray:
        if not self._names:
            raise _MissingArmError(
                f"this result has no channels '{self._quantity}': it is that of an earlier version "
                "of multiarm; run the scene again"
            )
        if arm not in self._names:
            known = ", ".join(map(repr, self._names))
            raise _MissingArmError(f"unknown arm {arm!r}; arms are {known}")
        return self._read(self._names[arm])

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)
