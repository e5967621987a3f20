"""Claims about runs on a Dask cluster: the same rows, and no death of a worker loses any."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from mechanics import ur5_pair
from refusals import refused
from sweep_runs import FUNCTIONS, KEEP, MASS, OVER, RUN, jobs_of, repeatable, statuses

from multiarm.errors import SweepError
from multiarm.sweeps import executors
from multiarm.sweeps.plan import make_plan
from multiarm.sweeps.run import Context


@pytest.fixture(scope="module")
def scene():
    return ur5_pair({"kind": "weld"}, {"kind": "weld"})


@contextmanager
def cluster_of(folder, workers, **environment):
    """A scheduler and workers, processes each: the scheduler's address, the workers."""
    file, here = folder / "scheduler.json", os.environ | environment
    common = {
        "cwd": folder,
        "env": here,
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
    }
    tool = [sys.executable, "-m"]
    head = ["distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    hand = ["distributed.cli.dask_worker", "--no-nanny", "--nthreads", "1", "--no-dashboard"]
    known = ["--scheduler-file", str(file)]
    processes = [subprocess.Popen([*tool, *head, *known], **common)]
    try:
        processes += [subprocess.Popen([*tool, *hand, *known], **common) for _ in range(workers)]
        from distributed import Client

        with Client(scheduler_file=str(file), timeout=60, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60)
            address = client.scheduler.address
        yield address, processes[1:]
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait()


SLOW = """
import time

def slow(trajectory):
    time.sleep(0.2)
    return 1.0
"""


@pytest.mark.slow
def test_a_cluster_gives_the_same_rows_whichever_workers_die(scene, tmp_path):
    """Workers die of one of the runs: that is its row, of which the others know nothing."""
    (tmp_path / "own.py").write_text(SLOW + FUNCTIONS)
    plan = make_plan(
        scene, OVER, repeat=4, seed=7, keep=[*KEEP, f"{tmp_path}/own.py:slow"], run=RUN
    )
    expected = repeatable(executors.run_here(Context.of(plan), jobs_of(plan)))
    deadly = make_plan(
        scene, {MASS: [5.0, 10.0, 20.0]}, keep=[f"{tmp_path}/own.py:always"], run=RUN
    )
    once = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    with cluster_of(tmp_path, 3, **once) as (address, workers), executors.connected(address) as c:
        coming = executors.run_on_cluster(Context.of(plan), jobs_of(plan), c)
        rows = [next(coming), next(coming)]
        workers[0].kill()
        rows += coming
        assert repeatable(rows) == expected
        assert len({row["worker"] for row in rows}) > 1
        ended = statuses(executors.run_on_cluster(Context.of(deadly), jobs_of(deadly), c))
    assert [ended[run][0] for run in (1, 2, 3)] == ["completed", "failed", "completed"]
    assert ended[2][1].startswith("its worker died")


def test_a_cluster_without_workers_is_told(scene):
    class Idle:
        scheduler = SimpleNamespace(address="tcp://here:1")

        def wait_for_workers(self, count, timeout):
            raise asyncio.TimeoutError  # another class than TimeoutError in Python 3.10

    plan = make_plan(scene, {MASS: [5.0]}, keep=["steps"], run=RUN)
    with refused(SweepError, "dask worker tcp://here:1"):
        next(executors.run_on_cluster(Context.of(plan), jobs_of(plan), Idle()))


def test_a_cluster_that_is_not_there_is_told(monkeypatch):
    monkeypatch.setattr(executors, "PATIENCE", 0.5)
    monkeypatch.delenv("DASK_SCHEDULER_ADDRESS", raising=False)
    for address in ("tcp://127.0.0.1:9", True, 3):
        with refused(SweepError, "dask: "), executors.connected(address):
            pass
