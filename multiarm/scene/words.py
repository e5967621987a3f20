"""The sentences in which faults are told: what was unknown, and what would have been known.

Every message about a name offers the names that exist, the most similar first, so that a typing
error is mended without opening the manual.
"""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable

__all__ = ["listed", "place", "shown", "unknown"]

_MAX_LISTED = 12
_SIMILAR = 0.6  # ratio of difflib above which two names count as one mistyped

_repr = reprlib.Repr()
_repr.maxstring = _repr.maxother = 60
_repr.maxlist = _repr.maxtuple = 8


def shown(value: object) -> str:
    """Return a short text of ``value`` for use inside a message."""
    return _repr.repr(list(value) if isinstance(value, tuple) else value)


def listed(names: Iterable[str], similar_to: str | None = None) -> str:
    """Return ``'a', 'b', 'c'``, most similar first, shortened when there are very many."""
    names = list(names)
    if not names:
        return "(none)"
    if similar_to is not None:
        names.sort(key=lambda name: -_similarity(name, similar_to))
    text = ", ".join(repr(name) for name in names[:_MAX_LISTED])
    left_out = len(names) - _MAX_LISTED
    return text if left_out <= 0 else f"{text} and {left_out} more"


def unknown(noun: str, value: object, known: Iterable[str], plural: str | None = None) -> str:
    """Return ``unknown arm 'rigth'; did you mean 'right'? arms are 'right', 'left'``."""
    known = list(known)
    plural = plural or f"{noun}s"
    text = f"unknown {noun} {shown(value)}"
    if not known:
        return f"{text}; there are no {plural}"
    if not isinstance(value, str):
        return f"{text}; {plural} are {listed(known)}"
    close = difflib.get_close_matches(value, known, n=1, cutoff=_SIMILAR)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{text}; {hint}{plural} are {listed(known, similar_to=value if close else None)}"


def place(parts: Iterable[str | int], root: str = "$") -> str:
    """Return a path such as ``$.joints[1].arm`` or ``$.arms['my arm'].tip``."""
    text = root
    for part in parts:
        if isinstance(part, str) and part.isidentifier():
            text += f".{part}"
        else:
            text += f"[{part!r}]"
    return text


def _similarity(name: str, other: str) -> float:
    return difflib.SequenceMatcher(None, name.lower(), other.lower()).ratio()
