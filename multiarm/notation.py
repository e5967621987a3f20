"""How counts are written in everything that people read: messages, tables, pages, figures."""

from __future__ import annotations

__all__ = ["count_of"]


def count_of(number: int, noun: str, plural: str | None = None) -> str:
    """The number and its noun: ``1 joint``, ``1,234 joints``, ``2 bodies``.

    Parameters
    ----------
    number : int
    noun : str
        In the singular; may have words before it.
    plural : str, optional
        Where it is not the noun with an s.
    """
    return f"{number:,} {noun if number == 1 else plural or f'{noun}s'}"
