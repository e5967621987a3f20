"""States of contacts: what each contact does, and how figures and replays show it."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple


class ContactState(IntEnum):
    """What a contact does, by its code in a channel.

    The last three are not recorded: two are of joints with dry friction.
    """

    OPEN = 0
    TOUCHING = 1
    SLIDING = 2
    STICKING = 3
    RESTING = 4  # it touches, but other contacts carry
    FORWARD = 5  # a joint that moves against its dry friction
    BACKWARD = 6
    AT_BOUND = 7  # friction is at its bound, and others keep the contact from slipping

    @property
    def moves(self) -> bool:
        """Whether a joint moves against its dry friction."""
        return self in (ContactState.FORWARD, ContactState.BACKWARD)

    @property
    def recorded(self) -> ContactState:
        """The state in channels and events."""
        return ContactState.STICKING if self is ContactState.AT_BOUND else self

    @property
    def word(self) -> str:
        """The state in words."""
        return "moving" if self.moves else self.recorded.name.lower()


RECORDED_STATES = tuple(state for state in ContactState if state <= ContactState.RESTING)
"""The states of contacts in channels, by their codes."""


class StateStyle(NamedTuple):
    """How figures and replays show a state of contacts."""

    sign: str  # one character
    colour: str  # #rrggbb
    height: float  # of a bar in a row of height 1
    hatch: str = ""  # of a bar, as in matplotlib; a bar without one is full


STATE_STYLES = {
    ContactState.OPEN: StateStyle("\N{DOTTED CIRCLE}", "#8a94a0", 0.06),
    ContactState.TOUCHING: StateStyle("\N{BLACK CIRCLE}", "#3b7dd8", 0.35),
    ContactState.SLIDING: StateStyle("\N{BULLSEYE}", "#d07c1e", 0.8, "////"),
    ContactState.STICKING: StateStyle("\N{BLACK SQUARE}", "#8a5fc4", 0.8),
    ContactState.RESTING: StateStyle("\N{WHITE CIRCLE}", "#2f9e67", 0.35, "...."),
}
"""Of the states that are recorded."""
