"""Whether an object can be carried, and the efforts that it takes, as commands show it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.text import Text

from multiarm.notation import number

if TYPE_CHECKING:
    from multiarm.simulation.holding import Carrying, EffortShares

REMEDY = "take a lighter object, a stronger robot or another posture"


def carrying_rows(carrying: Carrying | None) -> dict[str, RenderableType]:
    """Rows of a table: the weight of the object, and the efforts of the drives."""
    if carrying is None:
        return {}
    good, overloaded = carrying.possible, bool(overload_warnings(carrying))
    return {
        "weight of the object": Text(_weight(carrying), "green" if good else "bold yellow"),
        "effort of the drives": Text(_efforts(carrying), "bold yellow" if overloaded else ""),
    }


def overload_warnings(carrying: Carrying | None) -> list[str]:
    """A sentence where drives are too weak for the start, or for the control there."""
    if carrying is None:
        return []
    control, least = carrying.control, carrying.least
    if carrying.verdict == "effort" and least is not None:
        return [f"the drives are too weak to hold the object at the start: {_weight(carrying)}"]
    if control is not None and control.overloaded:
        remedy = "squeeze less" if carrying.possible else "see the weight of the object"
        return [
            f"the control takes {_share(control)} of the effort limit at the start, which the "
            f"drive cannot give: {remedy}, or {REMEDY}"
        ]
    return []


def _weight(carrying: Carrying) -> str:
    if carrying.verdict == "wrench":
        return (
            f"cannot be carried: {number(carrying.force_residual, 'N')} and "
            f"{number(carrying.moment_residual, 'N m')} stay unbalanced, whatever the contact "
            "forces: the object falls or turns; add contacts, or an arm, that take them"
        )
    if carrying.verdict == "pushing":
        return "cannot be carried by contacts that only push; add contacts, or friction"
    if carrying.verdict == "effort" and carrying.least is not None:
        return (
            f"cannot be carried: whatever the contact forces, some drive needs "
            f"{_share(carrying.least)} of its limit; {REMEDY}"
        )
    return f"can be carried; largest contact force {number(carrying.largest_force, 'N')}"


def _efforts(carrying: Carrying) -> str:
    """Efforts of the control at the start, and the smallest that hold arms and object."""
    from multiarm.results.limit_use import percent

    if carrying.control is None:
        return "not known: the robots' files name no effort limits"
    text = f"the control takes {_share(carrying.control)} of its limit"
    if carrying.least is None:
        return text
    return f"{text}; {percent(carrying.least.largest)} would do with the best internal forces"


def _share(shares: EffortShares) -> str:
    from multiarm.results.limit_use import percent

    return f"{percent(shares.largest)} ({shares.joint})"
