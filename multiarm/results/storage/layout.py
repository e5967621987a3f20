"""What writer and reader of a trajectory file agree on."""

import os
import re

FORMAT = "multiarm trajectory"
FORMAT_VERSION = 1
CHUNK_SAMPLES = 512
"""Samples per chunk: a scalar channel fills a page of the file with it."""
CACHE_BYTES = 1 << 18
"""Of written samples kept in memory, per channel: a few chunks."""
PAGE_BYTES = 4096
PIECE_BYTES = 120
"""Length of a piece of the outcome: a line of text in `h5dump`."""


def reason(error: Exception) -> str:
    """The operating system's word for it, else the first line of HDF5's."""
    text = str(error).strip()
    number = getattr(error, "errno", None) or next(iter(re.findall(r"errno = (\d+)", text)), None)
    return os.strerror(int(number)) if number else text.partition("\n")[0].strip("'\"")
