"""One line of a sweep's table: what was put into a run, how it ended, what came out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Row:
    """One run of a sweep.

    All but ``wall_time`` and ``worker`` follow from scene, sweep and number alone, whoever carries
    the run out, and whenever.

    Attributes
    ----------
    run : int
        From 1 on.
    status : {"completed", "failed"}
        Failed is also a run that ended well, but of which a function of the user's could not give
        its number; its other quantities are there.
    message : str
        What happened and, unless all went well, the remedy.
    values : mapping
        Path in the scene -> value that this run had there.
    quantities : mapping
        Name -> number, in the quantity's unit; None where there is none: the run failed, or the
        quantity is not defined for it.
    wall_time : float
        [s] that the run took.  Measured.
    worker : str
        Computer and process that carried it out.  Measured.
    """

    run: int
    status: str
    message: str
    values: Mapping[str, Any]
    quantities: Mapping[str, float | None]
    wall_time: float
    worker: str
