"""When a joint holds: from a time or an event on, until another one.

A *moment* is a time, the event at which a function of the motion has fallen to zero, or the event
at which a contact closes.  Without any, a joint holds all the time; ``never`` leaves it to
commands, see :meth:`multiarm.Stepper.attach`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator
from typing_extensions import TypeAliasType

from multiarm.scene.code import UserFunction, user_function
from multiarm.scene.faults import invalid, shown
from multiarm.scene.spec import Spec
from multiarm.scene.values import is_finite

NEVER = "never"


class When(Spec):
    """The event at which a function has fallen to zero."""

    when: UserFunction
    """A Python function f(t, state) -> number, positive before the event; in a file name it as
    'file.py:name' or 'package.module:name'."""


class Touching(Spec):
    """The event at which a contact closes."""

    touching: str
    """A contact that can open, as 'joint/contact'; or a joint or 'floor', for its first one."""


def _moment(value: Any) -> Any:
    if isinstance(value, (When, Touching)) or (value == NEVER and isinstance(value, str)):
        return value
    if is_finite(value) and not isinstance(value, bool):
        return float(value)
    if isinstance(value, Mapping) and set(value) == {"when"}:
        return When.model_construct(when=user_function(value["when"]))
    if isinstance(value, Mapping) and set(value) == {"touching"}:
        name = value["touching"]
        if isinstance(name, str) and name:
            return Touching.model_construct(touching=name)
    raise invalid(
        "must be a time [s], 'never', {when: 'file.py:function'} or {touching: 'joint/contact'}, "
        f"got {shown(value)}"
    )


Moment = TypeAliasType(
    "Moment", Annotated[float | Literal["never"] | When | Touching, BeforeValidator(_moment)]
)


class Interval(NamedTuple):
    """A stretch of time in which a joint holds.

    Attributes
    ----------
    begin : float, When or Touching
        ``-inf``: it holds from the start on; ``inf``: only by command.
    end : float, When or Touching
        ``inf``: for good.
    """

    begin: float | When | Touching
    end: float | When | Touching

    def has(self, t: float) -> bool:
        """Whether a time belongs to it, as far as times say."""
        begin = self.begin if isinstance(self.begin, float) else math.inf
        end = self.end if isinstance(self.end, float) else math.inf
        return begin <= t < end


def _pairs(value: Any) -> Any:
    """Refuse pairs that are none, or not one after the other."""
    if not isinstance(value, (list, tuple)):
        return value
    if not value or not all(isinstance(pair, (list, tuple)) and len(pair) == 2 for pair in value):
        raise invalid(
            "a list must have pairs [from, until], such as [[0, 2], [4, never]], got "
            f"{shown(value)}"
        )
    times = [time for pair in value for time in pair if is_finite(time)]
    for before, after in pairwise(times):
        if not before < after:
            raise invalid(f"times of pairs must increase; {after:g} comes after {before:g}")
    if any(begin == NEVER for begin, _ in value):
        raise invalid("no pair begins with 'never'; leave it out")
    if any(end == NEVER for _, end in value[:-1]):
        raise invalid("only the last pair may end with 'never'")
    return tuple(map(tuple, value))


def moments(value: Any) -> Any:
    """Validate what ``from`` may be: a moment, or a list of pairs."""
    if isinstance(value, (list, tuple)):
        return tuple((_moment(begin), _moment(end)) for begin, end in _pairs(value))
    return _moment(value)


Begin = TypeAliasType(
    "Begin", Annotated[Moment | tuple[tuple[Moment, Moment], ...], BeforeValidator(moments)]
)
"""A moment, or a list of pairs of moments."""


def intervals(begin: Any, end: Any) -> tuple[Interval, ...]:
    """The stretches of time that ``from`` and ``until`` say; empty: all the time."""
    if begin is None and end is None:
        return ()
    if isinstance(begin, tuple):
        return tuple(Interval(first, _end(last)) for first, last in begin)
    return (Interval(-math.inf if begin is None else _end(begin), _end(end)),)


def _end(moment: Any) -> Any:
    return math.inf if moment in (None, NEVER) else moment


def fault_of_times(begin: Any, end: Any) -> str:
    """Why ``from`` and ``until`` contradict each other; empty where they do not."""
    if end is None:
        return ""
    if isinstance(begin, tuple):
        return "'from' lists pairs [from, until] already; leave 'until' out"
    if begin == NEVER:
        return "a joint 'from: never' is joined by command, and let go by command; leave it out"
    if isinstance(begin, float) and isinstance(end, float) and not begin < end:
        return f"must be after 'from', {begin:g} s, got {end:g} s"
    return ""


def without_function(value: Any) -> Any:
    """``from`` or ``until`` without the events that functions tell: they do not come."""
    if isinstance(value, tuple):
        left = tuple(
            (begin, without_function(end)) for begin, end in value if not isinstance(begin, When)
        )
        return left or NEVER
    return NEVER if isinstance(value, When) else value
