"""Whether the times of joints fit what else a scene says.

Which contacts of a joint can open is known once its contacts are
(:mod:`multiarm.assembly.contact_effects`); here is what a scene says of joints and floors by name.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from multiarm.scene.code import function_text
from multiarm.scene.faults import Parts, unknown
from multiarm.scene.joints.kind import Joint
from multiarm.scene.joints.times import Interval, Touching, When
from multiarm.scene.values import of_surroundings

Faults = Iterator[tuple[Parts, str]]


def touching_faults(
    joints: Mapping[int, Joint], connections: Sequence[str], floors: Sequence[str]
) -> Faults:
    """Faults of contacts at which joints take hold or let go, with their places in the scene.

    Parameters
    ----------
    joints : mapping int -> Joint
        Those with times, by their numbers in the scene.
    connections : sequence of str
        Names of all joints.
    floors : sequence of str
        Owners of the objects' contacts with the floor; empty where there is none.
    """
    owners = [*connections, *floors]
    for number, joint in joints.items():
        for where, moment in joint.moments.items():
            if not isinstance(moment, Touching):
                continue
            name, at = moment.touching, ("joints", number, *where, "touching")
            if of_surroundings(name) and not floors:
                text = "the scene has no floor; add it, 'effects: {floor: {}}', or name a joint"
                yield at, text
            elif not any(names(name, owner) for owner in owners):
                yield at, unknown("joint", name, owners)
            elif where[0] == "from" and where[-1] != 1 and names(name, joint.connection):
                yield (
                    at,
                    f"is a contact of joint {joint.connection!r} itself, which can close only "
                    "while the joint holds; name one of another joint, or of the floor",
                )


def names(name: str, owner: str) -> bool:
    """Whether a name is that of an owner of contacts, or of one of its contacts."""
    return name == owner or name.startswith(f"{owner}/")


def idle_joints(joints: Mapping[int, Joint], duration: float) -> Faults:
    """Warnings of joints that never hold within a run from 0 s on, of some duration [s]."""
    for number, joint in joints.items():
        begins, ends = zip(*joint.intervals, strict=True)
        ended = [t for t in ends if isinstance(t, float) and t <= 0.0]
        late = [t for t in begins if isinstance(t, float) and duration <= t < math.inf]
        if len(ended) + len(late) < len(joint.intervals):
            continue
        if late:
            yield (
                ("joints", number, "from"),
                f"{min(late):g} s is not before the end of the run at {duration:g} s, so that the "
                "joint never holds; correct either, or write 'never' and let a command join it",
            )
            continue
        last = max(ended)
        where = next(where for where, moment in joint.moments.items() if moment == last)
        yield (
            ("joints", number, *where),
            f"{last:g} s is not after the beginning of the run at 0 s, so that the joint never "
            "holds; correct it, or write 'from: never' alone and let a command join it",
        )


def times_in_words(joint: Joint) -> str:
    """When a joint holds, such as ``from 2 s until 'floor' touches``; empty: all the time."""
    return ", ".join(map(_stretch, joint.intervals))


def _stretch(interval: Interval) -> str:
    begin, end = interval
    if begin == math.inf:
        return "by command"
    words = [] if begin == -math.inf else [f"from {_moment(begin)}"]
    words += [] if end == math.inf else [f"until {_moment(end)}"]
    return " ".join(words) or "from the start on"


def _moment(moment: float | When | Touching) -> str:
    if isinstance(moment, Touching):
        return f"{moment.touching!r} touches"
    if isinstance(moment, When):
        return f"{function_text(moment.when).rpartition(':')[2]}() is 0"
    return f"{moment:g} s"
