"""A sweep without runs: what its rows hold follows from the run's number, at no cost.

As a program it is a writer that is killed: it goes on with a folder, says what is safe, and ends by
SIGKILL before one of the steps by which it changes the disk, however fast the machine is.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
from pathlib import Path

import numpy as np
from repository import SCENES

import multiarm as ma
from multiarm.sweeps.folder import PartWriter, create, is_sweep, read_rows
from multiarm.sweeps.plan import SweepPlan
from multiarm.sweeps.run import Row
from multiarm.sweeps.spec import parse_sweep

NAMES = ("gap", "force", "never")
FAILING = 13
"""Every so many-th run fails."""
STEPS = (os, "fsync"), (Path, "replace"), (Path, "rename"), (Path, "mkdir"), (shutil, "rmtree")
"""All calls by which a writer changes the disk."""
TEXT = """
over:
  object.mass: {{uniform: [5, 50]}}
  effects.joint_damping: {{choice: [0, 0.5, 1152921504606846977, null, true]}}
  name: {{choice: ["schön, “a”\\n", b]}}
  run: {{choice: [{{duration: 0.1, accuracy: [1.0e-6, 3]}}, {{duration: 0.2}}]}}
repeat: {count}
seed: {seed}
keep:
- {{function: 'nobody.py:gap', unit: m, words: its gap}}
- {{function: 'nobody.py:force', unit: N, words: its force}}
- {{function: 'nobody.py:never', unit: J, words: its never}}
"""


def stand_in_plan(count: int, seed: int = 3) -> SweepPlan:
    """A plan of so many runs."""
    scene = ma.load_scene(SCENES / "two_ur5_box.yaml")
    return SweepPlan(scene, parse_sweep(TEXT.format(count=count, seed=seed)))


def row_of(run: int, worker: str = "here") -> Row:
    """The row that a run has, wherever it is made."""
    rng = np.random.default_rng(run)
    failed = run % FAILING == 0
    gap, force = (float(x) for x in rng.standard_normal(2))
    numbers = {"gap": gap, "force": force * 10.0 ** rng.integers(-300, 300), "never": None}
    return {
        "run": run,
        "status": "failed" if failed else "completed",
        "message": f"the step of run {run} is too small" if failed else "",
        **(dict.fromkeys(NAMES) if failed else numbers),
        "wall_time": 0.0 if failed else float(rng.random()),
        "worker": worker,
    }


def opened(path: Path, plan: SweepPlan) -> tuple[PartWriter, list[int]]:
    """A writer that goes on with a folder, or begins it, and the runs that are there."""
    if not is_sweep(path):
        create(path, plan)
    return PartWriter(path, plan), read_rows(path, plan.spec).index.tolist()


def write_on(path: Path, plan: SweepPlan, order: int) -> None:
    """Make what is missing, in an order of its own; say after every block what is safe."""
    print("begin", flush=True)
    writer, made = opened(path, plan)
    safe = len(made)
    print(safe, flush=True)
    rng, left = random.Random(order), sorted({*range(1, plan.spec.count + 1)} - {*made})
    # in threads of work that finish out of order, as real workers do
    left.sort(key=lambda run: run + rng.uniform(0, 40))
    while left:
        block, left = left[: (size := rng.randint(1, 7))], left[size:]
        writer.append([row_of(run, f"process {order}") for run in block])
        safe += len(block)
        print(safe, flush=True)
    print("end", flush=True)


def die_after(steps: int) -> None:
    """Kill this process before the next one of its steps, when so many are made."""
    left = iter(range(steps))

    def counted(call):
        def step(*arguments, **options):
            if next(left, None) is None:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*arguments, **options)

        return step

    for owner, name in STEPS:
        setattr(owner, name, counted(getattr(owner, name)))


def serve() -> None:
    """For each line a process that writes on, forked when all is imported; then its exit code."""
    for line in sys.stdin:
        path, count, order, *steps = line.split()
        child = os.fork()
        if child == 0:
            if steps:
                die_after(int(steps[0]))
            write_on(Path(path), stand_in_plan(int(count)), int(order))
            os._exit(0)
        print("exit", os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


if __name__ == "__main__":
    serve()
