"""One exception per kind of trouble, each with a message that is complete in itself.

Every error that multiarm raises on purpose derives from :class:`MultiarmError`. Its text names
the place, what was wrong there and the remedy, so that a program can show ``str(error)`` as it is.
"""

from __future__ import annotations

from collections.abc import Iterable

from multiarm.notation import count_of

__all__ = [
    "USER_FAULTS",
    "ControlError",
    "Fault",
    "FaultsError",
    "GraspError",
    "ModelError",
    "MultiarmError",
    "ReplayError",
    "SceneError",
    "SolverError",
    "SweepError",
    "TrajectoryError",
]

LONGEST_LINE, LONGEST_MESSAGE = 600, 3600
"""Of a message, in characters: more does not fit on a screen, and hides what matters."""
USER_FAULTS = (Exception, SystemExit)
"""Exceptions that count as faults of user-defined code: ``sys.exit`` there would end the program in
the middle of a run, with success.  ``KeyboardInterrupt`` comes from the user and passes through."""


class MultiarmError(Exception):
    """Base class of all errors that multiarm raises on purpose; long messages are shortened."""

    def __str__(self) -> str:
        return shortened(super().__str__())


class Fault(str):
    """A fault of an input, a complete line: ``$.joints[1].arm: unknown arm 'rigth'; ...``.

    Attributes
    ----------
    problem : str
        What is wrong, with the value, the alternatives and the remedy.
    place : str
        Where, as a user reads it, such as ``$.joints[1].arm``; empty where it is not said.
    parts : tuple of str and int
        The keys and list positions that lead there, such as ``("joints", 1, "arm")``.
    """

    problem: str
    place: str
    parts: tuple[str | int, ...]

    def __new__(cls, problem: str, place: str = "", parts: Iterable[str | int] = ()) -> Fault:
        """The line that place and problem make."""
        line = super().__new__(cls, f"{place}: {problem}" if place else problem)
        line.problem, line.place, line.parts = problem, place, tuple(parts)
        return line

    def __reduce__(self) -> tuple[type, tuple[str, str, tuple[str | int, ...]]]:
        return type(self), (self.problem, self.place, self.parts)


class FaultsError(MultiarmError):
    """An input cannot be used; the message lists all of its faults.

    Parameters
    ----------
    faults : iterable of Fault or str, or str
        All faults, each a complete line: place, value, alternatives, remedy.
    source : str, optional
        Where it came from (a file name), named on the first line of the message.

    Attributes
    ----------
    faults : list of Fault
        The faults: texts that know their place and their problem.
    source : str or None
        The file that it came from, when it came from one.
    """

    noun = "text"

    def __init__(self, faults: Iterable[str] | str, source: str | None = None) -> None:
        lines = [faults] if isinstance(faults, str) else faults
        self.faults = [line if isinstance(line, Fault) else Fault(line) for line in lines]
        self.source = source
        super().__init__(_message(self.faults, source, self.noun))

    def __reduce__(self) -> tuple[type, tuple[list[Fault], str | None]]:
        return type(self), (self.faults, self.source)


class SceneError(FaultsError):
    """A scene cannot be used as it is written."""

    noun = "scene"


class SweepError(FaultsError):
    """A sweep cannot be planned, carried out or stored."""

    noun = "sweep"


class ModelError(MultiarmError):
    """A robot description (URDF, meshes, inertias) cannot be turned into an arm."""


class SolverError(MultiarmError):
    """The equations of motion or the integration cannot be carried out as requested."""


class ControlError(MultiarmError):
    """A controller or an effect was given, or returned, something that cannot be applied."""


class TrajectoryError(MultiarmError):
    """A trajectory file cannot be written, read or interpreted."""


class ReplayError(MultiarmError):
    """A trajectory cannot be shown or exported."""


class GraspError(MultiarmError):
    """The contacts between the arms and the object do not hold the object as intended."""


def shortened(text: str) -> str:
    """The text with long lines cut in their middle, and without the lines that exceed a page.

    Names and values in a message are those of an input, which may be of any length.
    """
    if len(text) <= LONGEST_LINE:
        return text
    lines = text.split("\n")
    kept: list[str] = []
    for line in lines:
        kept.append(_cut(line))
        if sum(map(len, kept)) > LONGEST_MESSAGE - LONGEST_LINE:
            break
    left_out = len(lines) - len(kept)
    return "\n".join([*kept, f"  and {count_of(left_out, 'more line')}"] if left_out else kept)


def _cut(line: str) -> str:
    if len(line) <= LONGEST_LINE:
        return line
    half = LONGEST_LINE // 2 - 20
    return f"{line[:half]} [{len(line) - 2 * half:,} characters] {line[-half:]}"


def _message(faults: list[Fault], source: str | None, noun: str) -> str:
    if source is None and len(faults) == 1:
        return faults[0]
    count = count_of(len(faults), "fault")
    head = f"{source}: {count}" if source else f"the {noun} has {count}"
    return "\n".join([f"{head}:", *(f"  {fault}" for fault in faults)])
