"""Kinds of events: what each means, and which ones figures and replays show alike."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True)
class Family:
    """Kinds of events that figures and replays show alike.

    Attributes
    ----------
    name : str
    sign : str
        One character, so that colour is not the only difference.
    colour : str
        ``#rrggbb``, readable on light and on dark ground.
    """

    name: str
    sign: str
    colour: str

    @property
    def kinds(self) -> tuple[str, ...]:
        """The words of its kinds."""
        return tuple(kind.word for kind in EventKind if kind.family is self)


MADE, LOST, SLIP, STICK, AT_LIMIT, ACTUATOR, OTHER = FAMILIES = (
    Family("contact made", "\N{BLACK DOWN-POINTING TRIANGLE}", "#1f9d57"),
    Family("contact lost", "\N{WHITE UP-POINTING TRIANGLE}", "#d1495b"),
    Family("slip", "\N{WHITE DIAMOND}", "#d07c1e"),
    Family("stick", "\N{BLACK DIAMOND}", "#8a5fc4"),
    Family("limit", "\N{BLACK SQUARE}", "#3b7dd8"),
    Family("saturation", "\N{WHITE SQUARE}", "#14939c"),
    Family("other", "+", "#7a8797"),
)


class EventKind(Enum):
    """The kinds of events of a run.

    Attributes
    ----------
    word : str
        ``kind`` of the events of `Trajectory.events`.
    family : Family
    meaning : str
        For the documentation.
    """

    TOUCHES = "touches", MADE, "a contact closes, without a rebound"
    BOUNCES = (
        "bounces",
        MADE,
        "a contact, or the end of a joint's range, closes and opens again at once",
    )
    COMES_TO_REST = (
        "comes to rest",
        MADE,
        "impacts that came ever faster have ended; the contact stays closed",
    )
    AT_REST = (
        "at rest",
        MADE,
        "an object does not move any more: what it lies on holds it, or nothing moves it",
    )
    PUSHES_AGAIN = "pushes again", MADE, "a contact that was pulled pushes"
    RETURNS_TO_PATCH = (
        "is back on its patch",
        MADE,
        "a contact point has returned to its patch",
    )
    ATTACHED = (
        "attached",
        MADE,
        "a joint takes hold: an impact without restitution, if its bodies moved against each other",
    )
    DETACHED = "detached", LOST, "a joint lets go"
    LETS_GO = "lets go", LOST, "a contact opens"
    PULLS = (
        "pulls",
        LOST,
        "a contact that can only push is pulled, and no effect lets it open",
    )
    LEAVES_PATCH = (
        "leaves its patch",
        LOST,
        "a contact point leaves the patch that bounds its surface",
    )
    SLIDES = "slides", SLIP, "a closed contact with friction begins to slip"
    JOINT_SLIPS = "joint slips", SLIP, "a joint with dry friction begins to move"
    STICKS = "sticks", STICK, "the slip of a contact has ended"
    JOINT_STICKS = "joint sticks", STICK, "dry friction holds a joint"
    REACHES_LIMIT = (
        "reaches its limit",
        AT_LIMIT,
        "a joint comes to the end of its range and stays there",
    )
    LEAVES_LIMIT = "leaves its limit", AT_LIMIT, "a joint moves away from the end of its range"
    PASSES_LIMIT = (
        "passes its limit",
        AT_LIMIT,
        "a joint passes the end of its range, which the scene does not name",
    )
    RETURNS_TO_RANGE = "is back within its limit", AT_LIMIT, "a joint has returned to its range"
    SATURATES = "saturates", ACTUATOR, "a drive comes to the limit of its torque"
    UNSATURATES = "is no longer saturated", ACTUATOR, "a drive is below its limit again"
    LOSES_DIRECTION = (
        "loses a direction",
        OTHER,
        "an arm cannot follow its joint in every direction",
    )
    REGAINS_DIRECTION = (
        "regains a direction",
        OTHER,
        "an arm can follow its joint in more directions, or in all",
    )
    PASSES_SINGULAR_POSTURE = (
        "passes a singular posture",
        OTHER,
        "an arm loses a direction and regains it within one step",
    )
    RANK_FALLS = (
        "rank falls",
        OTHER,
        "constraints become dependent: the chains may move on in more than one way",
    )
    RANK_RISES = "rank rises", OTHER, "constraints are independent again"
    # remarks on how the run was prepared, which are no events of the motion
    START = (
        "start",
        OTHER,
        "a remark on how the run was prepared, such as a correction of the start",
    )
    METHOD_CHANGES = (
        "method changes",
        OTHER,
        "the integrator was switched, because the scene is stiff, or no longer",
    )
    JAMS = (
        "jams",
        SLIP,
        "friction leaves no accelerations that obey the contact laws (Painleve): an impulse "
        "without a collision follows",
    )
    CHATTERS = (
        "chatters",
        OTHER,
        "contacts opened, closed, stuck and slipped in turns; impulse steps led over it",
    )
    SHOWS_MODE = (
        "shows a mode",
        OTHER,
        "a natural motion is shown from here on, in the replay of `multiarm modes`",
    )
    CONTROL_ENDS = "control ends", OTHER, "a table or a path of the control ends"
    NOT_LISTED = (
        "not listed",
        OTHER,
        "last of all: how many more events there were than the thousand that are listed",
    )

    def __init__(self, word: str, family: Family, meaning: str) -> None:
        self.word, self.family, self.meaning = word, family, meaning


_FAMILY_OF = {kind.word: kind.family for kind in EventKind}


def family_of(kind: str) -> Family:
    """The family of a kind of event; "other" for an unknown one."""
    return _FAMILY_OF.get(kind, OTHER)
