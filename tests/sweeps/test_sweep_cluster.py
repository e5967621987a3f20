"""Claims about runs on a Dask cluster: the same rows, and no death of a worker loses any."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import contextmanager

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


@pytest.mark.slow
def test_a_cluster_gives_the_same_rows_and_survives_the_death_of_a_worker(scene, tmp_path):
    plan = make_plan(scene, OVER, repeat=4, seed=7, keep=KEEP, run=RUN)
    expected = repeatable(executors.run_here(Context.of(plan), jobs_of(plan)))
    (tmp_path / "own.py").write_text(
        "import time\ndef slow(trajectory):\n    time.sleep(0.05)\n    return 1.0\n"
    )
    slow = make_plan(scene, OVER, repeat=20, keep=["final_z", f"{tmp_path}/own.py:slow"], run=RUN)
    here = repeatable(executors.run_here(Context.of(slow), jobs_of(slow)))
    with cluster_of(tmp_path, 2) as (address, workers), executors.connected(address) as client:
        rows = list(executors.run_on_cluster(Context.of(plan), jobs_of(plan), client))
        assert repeatable(rows) == expected
        assert len({row.worker for row in rows}) == 2
        coming = executors.run_on_cluster(Context.of(slow), jobs_of(slow), client)
        found = [next(coming), next(coming)]
        workers[0].kill()
        found += coming
        assert repeatable(found) == here


@pytest.mark.slow
def test_a_run_on_which_workers_of_a_cluster_die_is_a_row_that_says_so(scene, tmp_path):
    (tmp_path / "own.py").write_text(FUNCTIONS)
    plan = make_plan(scene, {MASS: [5.0, 10.0, 20.0]}, keep=[f"{tmp_path}/own.py:always"], run=RUN)
    once = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    with cluster_of(tmp_path, 3, **once) as (address, _), executors.connected(address) as client:
        found = statuses(executors.run_on_cluster(Context.of(plan), jobs_of(plan), client))
    assert [found[run][0] for run in (1, 2, 3)] == ["completed", "failed", "completed"]
    assert found[2][1].startswith("its worker died")


def test_a_cluster_that_is_not_there_is_told(monkeypatch):
    monkeypatch.setattr(executors, "PATIENCE", 0.5)
    monkeypatch.delenv("DASK_SCHEDULER_ADDRESS", raising=False)
    for address in ("tcp://127.0.0.1:9", True, 3):
        with refused(SweepError, "dask: "), executors.connected(address):
            pass
