r"""Entries of the ledger: the cost of one effect or setting, and the changes that it makes.

Costs are differences of times that were measured in turns.  Of pairs :math:`(a_k, b_k)`, one after
the other, the estimate is the median of :math:`a_k - b_k`: disturbances affect both of a pair.  The
uncertainty is twice the standard error of that median, :math:`\sigma \sqrt{\pi / 2 n}`, with
:math:`\sigma` from the quartiles of the differences, so that single outliers do not count.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np

from multiarm.results.trajectory import plain

PRESENT, CANDIDATE, SETTING = "present", "candidate", "setting"
"""Kinds of entry: an effect of the scene, one that might be added, a setting of the run."""
RECORDING = "recording"
"""The setting of which only the end of the motion is compared."""
QUARTILES = 1.349
"""Distance of the quartiles of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class Estimate:
    """A measured difference.

    Attributes
    ----------
    value : float
    uncertainty : float
        Twice its standard error.
    """

    value: float
    uncertainty: float

    @property
    def within_noise(self) -> bool:
        """Whether it may as well be zero."""
        return not abs(self.value) > self.uncertainty

    def scaled(self, factor: float) -> Estimate:
        """The estimate in another unit."""
        return Estimate(factor * self.value, abs(factor) * self.uncertainty)


def paired_difference(first: np.ndarray, second: np.ndarray) -> Estimate:
    """Estimate of ``first - second``, measured in turn, shapes (n,)."""
    assert first.shape == second.shape and first.size, "measured in turn"
    apart = first - second
    low, high = np.percentile(apart, (25.0, 75.0))
    error = (high - low) / QUARTILES * math.sqrt(math.pi / 2.0 / apart.size)
    return Estimate(float(np.median(apart)), 2.0 * float(error))


PATH, TURN, JOINTS, SLIDES, FORCE = "path", "turn", "joints", "slides", "force"


class Quantity(NamedTuple):
    """What may change; a change is the largest one at an output time.

    what, head : str
        In a sentence, and above a column.
    unit : str
        Of its numbers.
    factor, shown : float and str
        Factor to the unit in which people read it.
    """

    what: str
    head: str
    unit: str
    factor: float
    shown: str


QUANTITIES = {
    PATH: Quantity("object's path", "path", "m", 1e3, "mm"),
    TURN: Quantity("object's orientation", "turn", "rad", math.degrees(1.0), "deg"),
    JOINTS: Quantity("turning joints", "joints", "rad", math.degrees(1.0), "deg"),
    SLIDES: Quantity("sliding joints", "slides", "m", 1e3, "mm"),
    FORCE: Quantity("contact forces", "force", "N", 1.0, "N"),
}


@dataclass(frozen=True)
class Change:
    """The largest difference of two runs in one quantity.

    Attributes
    ----------
    value : float
        [m, rad, N]
    time : float
        When it is that large [s].
    arm : str
        Whose joint or contact it is; empty for the object.
    """

    value: float
    time: float
    arm: str = ""


@dataclass(frozen=True)
class Entry:
    """One thing: an effect of the scene, one that might be added, or a setting.

    Attributes
    ----------
    name : str
    kind : {"present", "candidate", "setting"}
    about : str
        What was done: "left out", "added as ...".
    trouble : str
        Why there are no numbers, or how the run failed; empty after a success.
    milliseconds : Estimate or None
        Of wall time a simulated second that it costs; negative where it saves time.
    share : Estimate or None
        The same as a fraction of the time of the scene's own run.
    evaluations : int or None
        That it costs, in the whole run.
    changes : mapping
        Quantity -> Change.
    certified : bool
        Its run meets the requested accuracy, or the scene requests none.
    """

    name: str
    kind: str
    about: str
    trouble: str = ""
    milliseconds: Estimate | None = None
    share: Estimate | None = None
    evaluations: int | None = None
    changes: Mapping[str, Change] = field(default_factory=dict)
    certified: bool = True


@dataclass(frozen=True)
class Ledger:
    """What every effect of a scene costs and changes.

    Attributes
    ----------
    scene : dict
        name, duration_s, output_step_s, text.
    asked : dict
        Quantity -> requested accuracy; changes below it are not distinguishable from errors.
    asked_by_scene : bool
        The scene itself requests that accuracy.
    run : dict
        The scene's own run: status, integrator, stabilization, evaluations, milliseconds (of wall
        time a simulated second), certificate (its sentence), repeats.
    entries : tuple of Entry
    machine : dict
    wall_time_s : float
        That all this took.
    """

    scene: Mapping[str, Any]
    asked: Mapping[str, float]
    asked_by_scene: bool
    run: Mapping[str, Any]
    entries: tuple[Entry, ...]
    machine: Mapping[str, Any]
    wall_time_s: float

    def of_kind(self, kind: str) -> list[Entry]:
        """Entries of a kind, in the order of the scene."""
        return [entry for entry in self.entries if entry.kind == kind]

    def moves(self, entry: Entry) -> str | None:
        """The quantity that an entry changes most, in units of the requested accuracy.

        None where every change of the motion, and of the forces, is below that.
        """
        above = {
            quantity: change.value / self.asked[quantity]
            for quantity, change in entry.changes.items()
            if change.value > self.asked[quantity]
        }
        return next((quantity for quantity in QUANTITIES if quantity in above), None)

    def can_go(self, entry: Entry) -> bool:
        """Whether an effect's changes are known to be below the requested accuracy."""
        known = entry.kind in (PRESENT, CANDIDATE) and not entry.trouble and entry.certified
        return known and bool(entry.changes) and self.moves(entry) is None

    def as_dict(self) -> dict[str, Any]:
        """The ledger in what JSON knows."""
        entries = [{**asdict(entry), "can_go": self.can_go(entry)} for entry in self.entries]
        return plain({**asdict(self), "entries": entries})
