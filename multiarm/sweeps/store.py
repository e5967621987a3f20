"""The file of a sweep: rows are appended as runs end, and a killed sweep resumes from it.

To resume, the complete rows are copied to a new file next to the old one, which it then replaces: a
kill at any moment leaves one of the two.  The set of finished runs takes one bit a run.
"""

from __future__ import annotations

import difflib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from typing_extensions import Self

from multiarm.errors import SweepError
from multiarm.results.sinks import provenance
from multiarm.sweeps.records import Record, fields_of, pack
from multiarm.sweeps.row_file import Block, RowReader, RowWriter, WriterLock

if TYPE_CHECKING:
    from multiarm.sweeps.plan import SweepPlan

__all__ = ["RunSet", "SweepFile"]

BLOCK = 1024
"""Rows that are copied at once."""


class RunSet:
    """A set of runs, one bit each.

    Parameters
    ----------
    count : int
        Of all runs; the first has number 1.
    """

    def __init__(self, count: int):
        self.count, self._members, self._bits = count, 0, bytearray(count // 8 + 1)

    def __len__(self) -> int:
        return self._members

    def __contains__(self, run: int) -> bool:
        return 1 <= run <= self.count and bool(self._bits[run // 8] >> run % 8 & 1)

    def add(self, run: int) -> None:
        """Add a run."""
        if run not in self:
            self._bits[run // 8] |= 1 << run % 8
            self._members += 1

    def missing(self) -> Iterator[int]:
        """The runs that are not in the set, in order."""
        return (run for run in range(1, self.count + 1) if run not in self)


class SweepFile:
    """A file of a sweep, open for writing; make one with :meth:`open`.

    Attributes
    ----------
    path : Path
    done : RunSet
        Runs whose rows are in the file.
    """

    def __init__(
        self, path: Path, done: RunSet, writer: RowWriter, fields: np.dtype, lock: WriterLock
    ):
        self.path, self.done = path, done
        self._writer, self._fields, self._lock = writer, fields, lock

    @classmethod
    def open(cls, path: str | os.PathLike, plan: SweepPlan, *, fresh: bool = False) -> Self:
        """Create a file, or resume one of the same plan.

        Parameters
        ----------
        path : path-like
        plan : SweepPlan
        fresh : bool
            Overwrite an existing file.

        Raises
        ------
        SweepError
            The file belongs to another sweep (the message lists the differences), is being written
            by another process, or cannot be written.
        """
        target = RowReader.writable_target(path)
        fields = fields_of(plan.paths, [quantity.name for quantity in plan.quantities])
        done, lock = RunSet(plan.count), WriterLock(target, SweepError)
        try:
            if fresh or not target.exists():
                texts, earlier = _texts(plan), _no_rows()
            else:
                texts, earlier = _earlier(target, plan, done)
            return cls(target, done, RowWriter(target, fields, texts, earlier), fields, lock)
        except BaseException:
            lock.release()
            raise

    def append(self, rows: Iterable[Record]) -> None:
        """Append records; they are on the disk when this returns.

        A record of a run that is in the file already is dropped: it is the same.

        Raises
        ------
        SweepError
            The disk is full, or a record has no valid run number.
        """
        new: dict[int, Record] = {}
        for row in rows:
            if not 1 <= row.run <= self.done.count:
                raise SweepError(f"there is no run {row.run}; runs are 1 to {self.done.count}")
            if row.run not in self.done:
                new.setdefault(row.run, row)
        if not new:
            return
        self._writer.append(*pack(list(new.values()), self._fields))
        for run in new:
            self.done.add(run)

    def close(self) -> None:
        """Close the file and release its lock."""
        self._writer.close()
        self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _earlier(path: Path, plan: SweepPlan, done: RunSet) -> tuple[dict[str, str], Iterator[Block]]:
    """Texts and rows of an existing file of the same sweep."""
    reader = RowReader(path)
    texts = {name: reader.text(name) for name in ("scene", "sweep", "header")}
    _check_same(path, texts, plan)
    return texts, _kept(reader, done)


def _no_rows() -> Iterator[Block]:
    return iter(())


def _kept(reader: RowReader, done: RunSet) -> Iterator[Block]:
    """The rows of a file without duplicates and interrupted runs; marks them as done."""
    for start in range(0, reader.count, BLOCK):
        rows, texts = reader.block(start, start + BLOCK)
        keep = []
        for k, (run, status) in enumerate(zip(rows["run"], rows["status"], strict=True)):
            if 1 <= run <= done.count and int(run) not in done and status != b"interrupted":
                done.add(int(run))
                keep.append(k)
        yield rows[keep], [texts[k] for k in keep]
    reader.close()


def _texts(plan: SweepPlan) -> dict[str, str]:
    """Scene, sweep and header of a new file."""
    header = json.dumps(_header(plan))
    return {"scene": plan.scene_text, "sweep": plan.text, "header": header}


def _header(plan: SweepPlan) -> dict[str, Any]:
    """Metadata of a new file, as JSON."""
    return {
        "fingerprint": plan.fingerprint,
        "count": plan.count,
        "paths": list(plan.paths),
        "quantities": [
            {"name": own.name, "unit": own.unit, "words": own.words} for own in plan.quantities
        ],
        "folder": str(plan.scene.folder),
        "files": plan.files,
        "provenance": _provenance(),
    }


def _provenance() -> dict[str, Any]:
    return {key: value for key, value in provenance("").items() if key != "scene"}


def differences(header: Mapping[str, Any], texts: Mapping[str, str], plan: SweepPlan) -> list[str]:
    """Differences between a file and a plan that change the numbers of runs, as text.

    Parameters
    ----------
    header, texts : mappings
        Of the file; the texts of "scene" and "sweep".
    plan : SweepPlan
    """
    differs = [
        *_differences("scene", texts["scene"], plan.scene_text),
        *_differences("sweep", texts["sweep"], plan.text),
    ]
    there, here = header["provenance"]["version"], _provenance()["version"]
    if not differs and there != here:
        differs = [f"it was begun by multiarm {there}, this is {here}"]
    then = header.get("files", {})
    for name in sorted({*then, *plan.files}):
        if then.get(name) != plan.files.get(name):
            differs.append(f"the file '{name}' has changed, or is missing")
    return differs


def _check_same(path: Path, texts: Mapping[str, str], plan: SweepPlan) -> None:
    """Refuse the file of another sweep."""
    header = json.loads(texts["header"])
    if header["fingerprint"] == plan.fingerprint:
        return
    differs = differences(header, texts, plan)
    differs = differs or ["the text of a function that gives a quantity"]
    lines = "\n".join(f"  {line}" for line in differs)
    raise SweepError(
        f"'{path}' holds another sweep; choose another file, or begin afresh and overwrite it. "
        f"Differences (- there, + here):\n{lines}"
    )


def _differences(what: str, there: str, here: str) -> list[str]:
    lines = difflib.unified_diff(there.splitlines(), here.splitlines(), n=0, lineterm="")
    changed = [line for line in lines if line[0] in "+-" and line[:3] not in ("+++", "---")]
    shown = [f"{what}: {line}" for line in changed[:6]]
    more = len(changed) - len(shown)
    return [*shown, f"{what}: and {more} more lines"] if more > 0 else shown
