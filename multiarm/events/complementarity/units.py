r"""The laws that rows can obey, and the words for what a unit does.

A unit is one row, or a normal row with its two tangents. x are forces, y the rates that they meet:

=============  ====================================================================================
``Push``       :math:`0 \le x \perp y \ge 0`
``Bounded``    :math:`l \le x \le u`; y = 0 between, :math:`y \ge 0` at l, :math:`y \le 0` at u
``Friction``   :math:`0 \le x_n \perp y_n \ge 0`, :math:`|x_t| \le \mu x_n`, and
               :math:`x_t = -\mu x_n y_t / |y_t|` where :math:`y_t \ne 0` (Coulomb at zero slip)
``Sliding``    :math:`0 \le x_n \perp y_n \ge 0`, :math:`x_t = -\mu x_n s` with the slip direction s
=============  ====================================================================================

Bounds may be infinite: a row that is held whatever it takes is ``Bounded(row, -inf, inf)``.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Mode(str, Enum):
    """What a unit does from now on."""

    OPEN = "open"
    """No force; the contact leaves."""
    RESTING = "resting"
    """Touches without force; its row is not held, because other rows or nothing else moves it."""
    CLOSED = "closed"
    """Pushes; of a contact with friction: without friction, other rows keep it from slipping."""
    STICKING = "sticking"
    """Pushes, and the force stays inside the cone of friction."""
    SLIDING = "sliding"
    """Pushes, and slips or begins to: friction at its bound against the direction of slip."""
    LIMIT = "at the limit of friction"
    """Pushes, with friction at its bound against a direction; it does not slip yet: the bound has
    just been reached, or other rows keep it from slipping."""
    HOLDING = "holding"
    """Between its bounds, at rate zero."""
    AT_LOWER = "at lower bound"
    """The force is the lower bound, a constant from now on."""
    AT_UPPER = "at upper bound"
    """The force is the upper bound, a constant from now on."""


@dataclass(frozen=True)
class Push:
    """A contact without friction, or a joint limit.

    Attributes
    ----------
    row : int
        Its row: force [N] or [N m], positive pushes; rate, positive separates.
    """

    row: int


@dataclass(frozen=True)
class Bounded:
    """A force between two bounds that opposes motion: dry friction of a joint at rest.

    Attributes
    ----------
    row : int
        Its row; force times rate is power.
    lower, upper : float
        Bounds of the force [N] or [N m]; may be infinite.
    """

    row: int
    lower: float
    upper: float

    def __post_init__(self) -> None:
        assert self.lower <= self.upper, "the lower bound is above the upper one"


@dataclass(frozen=True)
class Friction:
    """A contact with Coulomb friction that does not slip at this instant.

    Attributes
    ----------
    row : int
        Normal row.
    tangents : tuple of int
        Rows of two orthogonal tangents, measured in one unit of length.
    mu : float
        Coefficient of friction; zero is allowed.
    """

    row: int
    tangents: tuple[int, int]
    mu: float

    def __post_init__(self) -> None:
        assert self.mu >= 0.0, "a coefficient of friction is not negative"


@dataclass(frozen=True)
class Sliding:
    """A contact that slips at this instant, so that the direction of friction is given.

    Attributes
    ----------
    row : int
        Normal row.
    tangents : tuple of int
        Rows of the two tangents.
    mu : float
        Coefficient of friction.
    direction : tuple of float
        Unit vector of the slip velocity, in the tangents.
    """

    row: int
    tangents: tuple[int, int]
    mu: float
    direction: tuple[float, float]

    def __post_init__(self) -> None:
        assert self.mu >= 0.0, "a coefficient of friction is not negative"
        assert abs(self.direction[0] ** 2 + self.direction[1] ** 2 - 1.0) < 1e-9, "a unit vector"


Unit = Push | Bounded | Friction | Sliding


def rows_of(unit: Unit) -> tuple[int, ...]:
    """The rows of a unit, the normal one first."""
    if isinstance(unit, (Push, Bounded)):
        return (unit.row,)
    return (unit.row, *unit.tangents)
