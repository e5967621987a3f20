"""`sweep`: run one scene hundreds or thousands of times on all cores, into one folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from multiarm.errors import SweepError
from multiarm.results.files import resolved
from multiarm.results.outcome import RunStatus
from multiarm.scene import Scene
from multiarm.scene.faults import shown
from multiarm.scene.values import is_integer
from multiarm.sweeps.folder import Header, PartWriter, create, is_sweep, read_header, read_rows
from multiarm.sweeps.plan import SweepPlan, make_plan
from multiarm.sweeps.quantities import UserQuantity
from multiarm.sweeps.result import Sweep, load_sweep
from multiarm.terminal.progress import SweepProgress, displayed

if TYPE_CHECKING:
    from distributed import Client

    from multiarm.sweeps.run import Row

SweepReport = Callable[[int, int, int], None]
"""Called with the runs that are done, all of them, and those that failed."""


def sweep(
    scene: Scene | str | os.PathLike,
    over: str | os.PathLike | Mapping[str, Any] | None = None,
    *,
    out: str | os.PathLike = "run.sweep",
    workers: int | None = None,
    dask: str | bool | Client | None = None,
    keep: str | Callable | Mapping[str, Any] | Sequence[Any] | None = None,
    repeat: int | None = None,
    combine: str | None = None,
    sampling: str | None = None,
    seed: int | None = None,
    certificate: bool | None = None,
    progress: bool | SweepReport | None = None,
    resume: bool = True,
    **run: Any,
) -> Sweep:
    """Run a scene many times, with other values in it, on all cores or on a cluster.

    Every run is a pure function of the scene and its values: on any worker and in any order it
    gives the same numbers, bit for bit on the same kind of computer.

    Parameters
    ----------
    scene : Scene or path
    over : path or mapping, optional
        A sweep file (YAML), its content as a table, or its ``over`` alone: ``{"object.mass":
        {"linspace": [5, 50, 10]}, "effects.joint_damping": [0.1, 1, 10], "arms.left.base.xyz[2]":
        {"uniform": [-0.01, 0.01]}}``.  Paths are written as in error messages; several with commas
        between them move together.  Values are a list; ``linspace``, ``logspace``, ``geomspace``,
        ``range``, ``rows``; drawn at random by ``uniform``, ``loguniform``, ``normal``,
        ``lognormal``, ``integers``, ``choice``.
    out : path-like
        Folder of the sweep, ``NAME.sweep``: scene, sweep, and the rows as Parquet files.  A sweep
        that was killed or stopped resumes from it.
    workers : int, optional
        Processes on this computer, by default one for each core; 1 runs everything in this process.
    dask : str, True or distributed.Client, optional
        Scheduler of a Dask cluster that carries out the runs; True: the one in Dask's
        configuration.  Its workers need the same multiarm, and the files that the scene names.
    keep : list, optional
        Outputs of every run: names of quantities, functions ``f(trajectory) -> number``, and
        tables ``{"function": ..., "name": ..., "gives": [...], "unit": ..., "words": ...}``.  A
        single one needs no list.
    repeat : int, optional
        Runs of each point of the grid, where an axis is drawn at random.
    combine : {"product", "zip"}, optional
    sampling : {"random", "latin_hypercube", "sobol"}, optional
    seed : int, optional
        Of all random samples.  Those of "random" for run k depend on it and on k only; the other
        two sample all runs of a grid point together, by the seed and the number of the point.
    certificate : bool, optional
        Check runs of some ``accuracy``, as :func:`multiarm.simulate` does.
    progress : bool or callable, optional
        True: a bar on the terminal, elsewhere a line on stderr every few seconds.  A function is
        called in this thread with the number of finished runs, of all runs, and of runs that failed
        since the call; it may raise ``KeyboardInterrupt`` to end the sweep.
    resume : bool
        Continue from the rows of this sweep in the folder.  False: begin again in it.
    **run
        Entries of the scene's ``run``: ``duration=1.0, accuracy=1e-6``.

    Returns
    -------
    Sweep
        A run that fails has a row with the reason.  Ctrl-C keeps the finished runs; call the
        function again to resume.

    Raises
    ------
    SceneError
        When the scene cannot be read; when it was read with ``code=False``, and it or the sweep
        names code.
    SweepError
        When the sweep is wrong, naming all faults; the folder belongs to another sweep or cannot be
        written; the cluster does not answer or cannot run the jobs.
    """
    keys = {
        "keep": None if keep is None else _entries(keep),
        "repeat": repeat,
        "combine": combine,
        "sampling": sampling,
        "seed": seed,
        "certificate": certificate,
        "run": run or None,
    }
    plan = make_plan(scene, over, **{key: v for key, v in keys.items() if v is not None})
    return run_plan(plan, out, workers=workers, dask=dask, progress=progress, resume=resume)


def run_plan(
    plan: SweepPlan,
    out: str | os.PathLike,
    *,
    workers: int | None = None,
    dask: str | bool | Client | None = None,
    progress: bool | SweepReport | None = None,
    resume: bool = True,
) -> Sweep:
    """Carry out a plan; parameters, result and errors are those of :func:`sweep`."""
    from multiarm.sweeps.executors import connected

    _check_executor(workers, dask)
    with (
        displayed(progress, SweepProgress) as show,
        # before the folder: if the cluster does not answer, earlier rows must not be lost
        connected(dask) if dask else nullcontext() as client,
    ):
        folder = _folder(out, plan, resume)
        missing = plan.spec.table.index.difference(read_rows(folder, plan.spec).index).tolist()
        rows = _rows(plan, missing, workers, client)
        _fill(PartWriter(folder, plan), rows, plan.spec.count - len(missing), plan.spec.count, show)
    return load_sweep(folder, code=plan.scene.may_load_code)


def _entries(keep: Any) -> list[Any]:
    """The entries of ``keep``, of which a single one needs no list."""
    single = isinstance(keep, (str, Mapping, UserQuantity)) or callable(keep)
    return [keep] if single or not isinstance(keep, Iterable) else list(keep)


def _folder(out: str | os.PathLike, plan: SweepPlan, resume: bool) -> Path:
    """The folder of this sweep, which is made if there is none.

    Raises
    ------
    SweepError
        It belongs to another sweep; the message lists the differences.
    """
    folder = resolved(out, SweepError)
    if not (resume and is_sweep(folder)):
        create(folder, plan)
    there, here = read_header(folder), Header.of(plan)
    differs = there.differences(here)
    if not differs and there.functions != here.functions:
        differs = ["the text of a function that gives a quantity"]
    if differs:
        lines = "\n  ".join(differs)
        raise SweepError(
            f"'{folder}' holds another sweep; choose another folder, or begin again in this one "
            f"(--fresh, in Python resume=False). Differences (- there, + here):\n  {lines}"
        )
    return folder


def _rows(
    plan: SweepPlan, missing: list[int], workers: int | None, client: Client | None
) -> Generator[Row, None, None]:
    """Rows of the missing runs, as they end."""
    from multiarm.jit.ahead import processors
    from multiarm.sweeps.executors import run_here, run_in_processes, run_on_cluster
    from multiarm.sweeps.run import Context

    if not missing:
        return
    context = Context.of(plan)
    jobs = list(zip(missing, plan.spec.table.loc[missing].to_dict("records"), strict=True))
    workers = workers or processors()
    if client is not None:
        yield from run_on_cluster(context, jobs, client)
    elif workers == 1:
        yield from run_here(context, jobs)
    else:
        yield from run_in_processes(context, jobs, min(workers, len(missing)))


def _fill(
    writer: PartWriter,
    rows: Generator[Row, None, None],
    done: int,
    count: int,
    show: SweepReport,
) -> None:
    """Append rows to the folder until all are there or Ctrl-C is pressed.

    A thread writes, since the disk takes some milliseconds: each time all rows that wait.
    """
    failed = 0
    waiting: SimpleQueue[Row | None] = SimpleQueue()
    with ThreadPoolExecutor(1, "multiarm") as pool:
        writing = pool.submit(_write, writer, waiting)
        try:
            show(done, count, failed)
            for row in rows:
                waiting.put(row)
                done += 1
                failed += row["status"] != RunStatus.COMPLETED
                show(done, count, failed)
                if writing.done():
                    break  # the disk is full
        except KeyboardInterrupt:
            pass  # the finished runs are kept
        finally:
            waiting.put(None)
            rows.close()
    writing.result()


def _write(writer: PartWriter, waiting: SimpleQueue[Row | None]) -> None:
    """Append rows until None comes."""
    last = False
    while not last:
        arrived = [waiting.get()]
        while not waiting.empty():
            arrived.append(waiting.get())
        rows = [row for row in arrived if row is not None]
        last = len(rows) < len(arrived)
        if rows:
            writer.append(rows)


MOST_WORKERS = 1000


def _check_executor(workers: Any, dask: Any) -> None:
    if workers is not None and dask:
        raise SweepError("workers and dask exclude each other: a cluster has its own workers")
    if workers is not None and not (is_integer(workers) and workers >= 1):
        raise SweepError(f"workers: must be a number from 1 on, got {workers!r}")
    if workers is not None and workers > MOST_WORKERS:
        raise SweepError(
            f"workers: at most {MOST_WORKERS:,} processes are possible on one computer, got "
            f"{shown(workers)}; leave it out for one a processor, or take a cluster"
        )
