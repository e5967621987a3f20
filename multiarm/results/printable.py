"""Texts as terminals and pages may have them: what would steer them, or hide, is written out.

Names, messages and paths come from scenes, results and folders of anybody's.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

# Control characters but for tab and newline, marks and overrides of the writing direction, line
# and paragraph separators, and halves of characters, which no encoding can write.
_STEERING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def printable(text: str) -> str:
    r"""The same text with characters that steer a terminal or a page written out: ``\x1b``."""
    return _STEERING.sub(lambda found: ascii(found[0])[1:-1], text)


def printable_texts(value: Any) -> Any:
    """The same tables and lists with all texts in them printable; names of entries stay."""
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, Mapping):
        return {key: printable_texts(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [printable_texts(item) for item in value]
    return value
