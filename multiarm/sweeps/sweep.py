"""`sweep`: a scene, hundreds or thousands of runs, every core, one file, nothing lost."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from numbers import Integral
from typing import TYPE_CHECKING, Any

from multiarm.errors import SweepError
from multiarm.scene import Scene
from multiarm.simulation.interrupts import deferred_interrupt
from multiarm.sweeps.plan import SweepPlan, make_plan
from multiarm.sweeps.result import Sweep, load_sweep
from multiarm.sweeps.row import Row
from multiarm.sweeps.store import SweepFile

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["SweepProgress", "run_plan", "sweep"]

SweepProgress = Callable[[int, int, int], None]


def sweep(
    scene: Scene | str | os.PathLike,
    over: str | os.PathLike | Mapping[str, Any] | None = None,
    *,
    out: str | os.PathLike = "sweep.h5",
    workers: int | None = None,
    dask: str | bool | Client | None = None,
    keep: str | Sequence[Any] | None = None,
    repeat: int | None = None,
    combine: str | None = None,
    sampling: str | None = None,
    seed: int | None = None,
    certificate: bool | None = None,
    progress: bool | SweepProgress | None = None,
    resume: bool = True,
    **run: Any,
) -> Sweep:
    """Run a scene many times, with other values in it, on all cores or on a cluster.

    Every run is a pure function of the scene and its values: whoever carries it out, in whatever
    order, it gives the same numbers, bit for bit on the same kind of computer.

    Parameters
    ----------
    scene : Scene or path
    over : path or mapping, optional
        A sweep file, YAML; a table such as it holds; or its ``over`` alone: ``{"object.mass":
        {"linspace": [5, 50, 10]}, "effects.joint_damping": [0.1, 1, 10], "arms.left.base.xyz[2]":
        {"uniform": [-0.01, 0.01]}}``.  Paths are written as in error messages; several with commas
        between them move together.  Values are a list; ``linspace``, ``logspace``, ``geomspace``,
        ``range``, ``rows``; drawn at random by ``uniform``, ``loguniform``, ``normal``,
        ``lognormal``, ``integers``, ``choice``.
    out : path-like
        HDF5 file of the table, to which rows are appended as runs end.  A sweep that was killed, or
        stopped, goes on where it was.
    workers : int, optional
        Processes on this computer; one for each of its cores when left out; with 1 the runs are
        carried out in this process.
    dask : str, True or distributed.Client, optional
        The scheduler of a Dask cluster that carries out the runs; True: the one that Dask is
        configured for.  It needs the same multiarm, and the files that the scene names.
    keep : list, optional
        What is kept of every run: names of quantities, functions ``f(trajectory) -> number``, and
        tables ``{"function": ..., "name": ..., "gives": [...], "unit": ..., "words": ...}``.
    repeat : int, optional
        Runs of each point of the grid, where something is drawn at random.
    combine : {"product", "zip"}, optional
    sampling : {"random", "latin_hypercube", "sobol"}, optional
    seed : int, optional
        Of all draws: run k depends on it and on k.
    certificate : bool, optional
        Check runs of some ``accuracy``, as :func:`multiarm.simulate` does.
    progress : bool or callable, optional
        True: a bar on the terminal.  A function is called in this thread with the number of runs
        that are done, of all, and of those that failed meanwhile; it may raise
        ``KeyboardInterrupt`` to end the sweep.
    resume : bool
        Go on with what the file holds of this very sweep.  False: give that up and begin anew.
    **run
        Entries of the scene's ``run``: ``duration=1.0, accuracy=1e-6``.

    Returns
    -------
    Sweep
        A run that fails is a row that says why.  Ctrl-C keeps what is done; call it once more to go
        on.

    Raises
    ------
    SceneError
        When the scene cannot be read.
    SweepError
        When the sweep is wrong, naming all faults; the file is that of another sweep or cannot be
        written; the cluster does not answer or cannot do the work.
    """
    _check_engine(workers, dask)
    asked = {
        "keep": [keep] if isinstance(keep, str) else None if keep is None else list(keep),
        "repeat": repeat,
        "combine": combine,
        "sampling": sampling,
        "seed": seed,
        "certificate": certificate,
        "run": run or None,
    }
    plan = make_plan(scene, over, **{key: v for key, v in asked.items() if v is not None})
    if progress is not True:
        return run_plan(plan, out, workers, dask, progress or None, resume)
    from multiarm.terminal.progress import SweepProgress as Bar

    with Bar() as bar:
        return run_plan(plan, out, workers, dask, bar, resume)


def run_plan(
    plan: SweepPlan,
    out: str | os.PathLike = "sweep.h5",
    workers: int | None = None,
    dask: str | bool | Client | None = None,
    progress: SweepProgress | None = None,
    resume: bool = True,
) -> Sweep:
    """Carry out a plan, or what is missing of it; see :func:`sweep`."""
    from multiarm.sweeps.cluster import opened

    _check_engine(workers, dask)
    # a cluster that does not answer must not cost the rows of an earlier sweep
    with (
        opened(dask) if dask else nullcontext() as client,
        SweepFile.open(out, plan, fresh=not resume) as file,
    ):
        if len(file.done) < plan.count:
            _fill(file, plan, _rows(plan, file, workers, client), progress)
        elif progress is not None:
            progress(plan.count, plan.count, 0)
        path = file.path
    return load_sweep(path, code=plan.scene.may_load_code)


def _fill(
    file: SweepFile,
    plan: SweepPlan,
    coming: Iterator[list[Row]],
    progress: SweepProgress | None,
) -> None:
    """Put rows into the file as they come, until all are there or Ctrl-C is pressed."""
    failed = 0
    try:
        if progress is not None:
            progress(len(file.done), plan.count, failed)
        for rows in coming:
            with deferred_interrupt() as interrupt:  # not in the middle of the file
                file.append(rows)
            interrupt.deliver()
            failed += sum(row.status != "completed" for row in rows)
            if progress is not None:
                progress(len(file.done), plan.count, failed)
    except KeyboardInterrupt:
        pass  # what is done is safe
    finally:
        coming.close()  # type: ignore[attr-defined]


def _rows(
    plan: SweepPlan, file: SweepFile, workers: int | None, client: Client | None
) -> Iterator[list[Row]]:
    """Rows of the runs that are missing, as they end."""
    from multiarm.sweeps.cluster import on_cluster
    from multiarm.sweeps.engines import in_process, on_processes, processors
    from multiarm.sweeps.work import Job, Work

    work = Work.of(plan, session=uuid.uuid4().hex)
    jobs = (Job(run, values) for run, values in plan.among(file.done.missing()))
    missing = plan.count - len(file.done)
    if client is not None:
        yield from on_cluster(work, jobs, client, missing)
    elif (workers or processors()) == 1:
        yield from in_process(work, jobs)
    else:
        yield from on_processes(work, jobs, min(workers or processors(), missing), missing)


def _check_engine(workers: Any, dask: Any) -> None:
    if workers is not None and dask:
        raise SweepError("workers and dask exclude each other: a cluster has its own workers")
    whole = isinstance(workers, Integral) and not isinstance(workers, bool)
    if workers is not None and not (whole and workers >= 1):
        raise SweepError(f"workers: must be a number from 1 on, got {workers!r}")
