"""Where the samples of a run are, and a channel of every arm as a mapping."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from multiarm.errors import TrajectoryError
from multiarm.results.channels import CLOSED, FLOOR, Block, Channel


class Store(Protocol):
    """Where the samples of a trajectory are."""

    samples: int
    channels: dict[str, Channel]

    @property
    def metadata(self) -> dict[str, Any]:
        """Where the samples come from, and the scene's text under `scene`."""
        ...

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Samples start..stop of a channel."""
        ...

    def rest(self) -> None:
        """Keep nothing open but while samples are read."""
        ...

    def close(self) -> None:
        """Let go of what the samples are read from."""
        ...


class ArrayStore:
    """Samples in memory: arrays that are read-only from here on.

    ``metadata`` is called when it is first asked for.
    """

    def __init__(
        self, channels: Sequence[Channel], arrays: Block, metadata: Callable[[], dict[str, Any]]
    ):
        self.channels = {channel.name: channel for channel in channels}
        self.samples = len(arrays["time"])
        self._metadata = metadata
        self._arrays, self._closed = arrays, False
        for values in arrays.values():
            values.flags.writeable = False

    @cached_property
    def metadata(self) -> dict[str, Any]:
        """Where the samples come from, and the scene's text under `scene`."""
        return self._metadata()

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Samples start..stop of a channel."""
        if self._closed:
            raise TrajectoryError(CLOSED)
        return self._arrays[name][start:stop]

    def rest(self) -> None:
        """Nothing to do: nothing is open."""

    def close(self) -> None:
        """Let go of the arrays; nothing more can be read."""
        self._arrays, self._closed = {}, True

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "metadata": self.metadata, "_metadata": None}


def arm_names(store: Store) -> tuple[str, ...]:
    """Names of the arms, in the order of the scene."""
    names = (n for n in store.channels if n.startswith("arms/"))
    return tuple(dict.fromkeys(n.removeprefix("arms/").rpartition("/")[0] for n in names))


def channels_of(channels: Iterable[str], quantity: str) -> dict[str, str]:
    """Arm, or "floor" -> name of its channel of a quantity, of the channels of a run."""
    channels = tuple(channels)
    found = {}
    for name in channels:
        place, _, last = name.rpartition("/")
        if last == quantity and place.startswith("arms/"):
            found[place.removeprefix("arms/")] = name
    if f"environment/{quantity}" in channels:
        found.setdefault(FLOOR, f"environment/{quantity}")
    return found


class _UnknownArmError(TrajectoryError, KeyError):
    """A KeyError whose text is a sentence."""

    __str__ = Exception.__str__


class ByArm(Mapping[str, np.ndarray]):
    """One channel of every arm, read when asked for.

    Parameters
    ----------
    store : Store
    quantity : str
        Last part of the channel's name.
    read : callable
        ``name -> samples``.
    optional : bool
        An arm without the channel has no columns of it; else it is an error.
    """

    def __init__(
        self,
        store: Store,
        quantity: str,
        read: Callable[[str], np.ndarray],
        optional: bool = False,
    ):
        self._store, self._quantity, self._read = store, quantity, read
        self._optional = optional

    def __getitem__(self, arm: str) -> np.ndarray:
        names = arm_names(self._store)
        if arm not in names:
            known = ", ".join(repr(name) for name in names)
            raise _UnknownArmError(f"unknown arm {arm!r}; arms are {known}")
        name = f"arms/{arm}/{self._quantity}"
        if self._optional and name not in self._store.channels:
            return np.empty((self._store.samples, 0))
        return self._read(name)

    def __iter__(self) -> Iterator[str]:
        return iter(arm_names(self._store))

    def __len__(self) -> int:
        return len(arm_names(self._store))


class ByContacts(ByArm):
    """A channel of contacts: of every arm, and under "floor" of the object's own, if it has any."""

    def __getitem__(self, bearer: str) -> np.ndarray:
        if bearer in self._floor:
            return self._read(f"environment/{self._quantity}")
        return super().__getitem__(bearer)

    def __iter__(self) -> Iterator[str]:
        return iter((*arm_names(self._store), *self._floor))

    def __len__(self) -> int:
        return len(arm_names(self._store)) + len(self._floor)

    @property
    def _floor(self) -> tuple[str, ...]:
        """The floor, where it has contacts; no name where an arm has taken it."""
        exists = f"environment/{self._quantity}" in self._store.channels
        return (FLOOR,) if exists and FLOOR not in arm_names(self._store) else ()
