"""Say more about a run whose file is complete: what was found out about it afterwards.

The file enters single-writer mode again, and what is said is appended as JSON in pieces, behind
whatever was said before; `amended` names the pieces that hold, and is written last. A kill at any
moment leaves the file as it was or as it shall be.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from multiarm.errors import TrajectoryError
from multiarm.results.storage.layout import PIECE_BYTES, reason
from multiarm.results.storage.opening import HDF5_ERRORS
from multiarm.results.storage.reader import Hdf5Store

SPARE_BYTES = 65536
"""Room asked for beyond the text itself: index and pages of the file."""


def create_amendment(file: h5py.File) -> None:
    """Make room for amendments in a new file."""
    amendment = file.create_dataset(
        "amendment", (0,), f"S{PIECE_BYTES}", maxshape=(None,), chunks=(64,)
    )
    amendment.attrs["description"] = "what was found out after the run: JSON, to be joined"
    amended = file.create_dataset("amended", data=np.zeros(2, dtype=np.int64))
    amended.attrs["description"] = "first and end of the pieces of amendment that hold"


def amend(path: Path, changes: dict[str, Any]) -> None:
    """Change entries of the outcome that a complete file holds.

    Parameters
    ----------
    path : Path
        No reader may be open in this process.
    changes : dict
        Entries of the outcome, in what JSON knows.

    Raises
    ------
    TrajectoryError
        No complete run of this program version, or the disk takes no more.
    """
    store = Hdf5Store(path)
    store.close()
    if store.outcome is None or store.amendment is None:
        raise TrajectoryError(f"'{path}' holds no complete run that could be amended; run it again")
    text = json.dumps({**store.amendment, **changes}, allow_nan=False).encode("ascii")
    pieces = [text[i : i + PIECE_BYTES] for i in range(0, len(text), PIECE_BYTES)]
    try:
        _reserve(path, len(text) + SPARE_BYTES)
        with h5py.File(path, "r+", libver=("v110", "v110"), locking="best-effort") as file:
            file.swmr_mode = True
            begin = int(file["amended"][1])
            end = begin + len(pieces)
            file["amendment"].resize(end, axis=0)
            file["amendment"][begin:end] = pieces
            file.flush()
            file["amended"][:] = begin, end
            file["amended"].flush()
            size = file.id.get_filesize()
        os.truncate(path, size)
    except HDF5_ERRORS as error:
        raise TrajectoryError(
            f"cannot write to '{path}': {reason(error)}; free some space on the disk"
        ) from error


def _reserve(path: Path, size: int) -> None:
    """Find out whether the file can grow, before HDF5 tries."""
    if hasattr(os, "posix_fallocate"):
        with open(path, "r+b") as file:
            os.posix_fallocate(file.fileno(), os.path.getsize(path), size)
