"""What ``dir`` and the completion of interactive sessions show of public objects."""

from __future__ import annotations


def public_names(self: object) -> list[str]:
    """Names without a leading underscore; a class has it as its ``__dir__``."""
    return [name for name in object.__dir__(self) if not name.startswith("_")]
