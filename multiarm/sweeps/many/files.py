"""Where the results of many runs go: one file each."""

from __future__ import annotations

import os
from pathlib import Path

from multiarm.errors import TrajectoryError

DIGITS = 4
"""Of the numbers in the files' names, at least: names in order are runs in order."""


def run_files(out: str | os.PathLike | None, count: int) -> list[Path | None]:
    """One file for each run.

    Parameters
    ----------
    out : path-like, optional
        A folder, made if need be, for ``run_0001.h5`` and so on; or a pattern of files such as
        ``"runs/box_{:03d}.h5"``, in which the number of the run, from 1 on, is put.
    count : int
        How many runs there are.

    Raises
    ------
    TrajectoryError
        A place cannot be written, or holds something that multiarm did not write.
    """
    if out is None:
        return [None] * count
    from multiarm.results.trajectory_file import TrajectoryReader

    paths = _by_pattern(str(out), count) if "{" in str(out) else _in_folder(Path(out), count)
    for path in paths:
        TrajectoryReader.writable_target(path)
    return [*paths]


def _in_folder(folder: Path, count: int) -> list[Path]:
    folder = folder.expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TrajectoryError(
            f"cannot make the folder '{folder}' for the runs: {error.strerror}; name another, or a "
            "pattern of files such as 'box_{:03d}.h5'"
        ) from error
    digits = max(DIGITS, len(str(count)))
    return [folder / f"run_{number:0{digits}d}.h5" for number in range(1, count + 1)]


def _by_pattern(pattern: str, count: int) -> list[Path]:
    try:
        names = [pattern.format(number) for number in range(1, count + 1)]
    except (ValueError, IndexError, KeyError, AttributeError) as error:
        raise TrajectoryError(
            f"'{pattern}' is no pattern of files ({error}); write the number's place as in "
            "'box_{:03d}.h5'"
        ) from None
    if len(set(names)) < count:
        raise TrajectoryError(
            f"'{pattern}' names one file for several runs; write the number's place as in "
            "'box_{:03d}.h5'"
        )
    return [Path(name) for name in names]
