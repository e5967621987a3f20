"""A sweep without robots: what its rows hold follows from the run's number, at no cost.

As a program it is a writer that is killed: it goes on with a file, says what is safe, and ends by
SIGKILL before one of the steps by which it changes the disk, however fast the machine is.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from multiarm.sweeps.plan import Record
from multiarm.sweeps.store import SweepFile

NAMES = ("gap", "force", "never")
UNITS = {"gap": "m", "force": "N", "never": "J"}
FAILING = 13
"""Every so many-th run fails."""
STEPS = (os, "fsync"), (Path, "replace"), (shutil, "rmtree")
"""All calls by which a writer changes the disk."""


@dataclass(frozen=True)
class StandInPlan:
    """What the file of a sweep needs to know of its plan."""

    count: int
    text: str = "over: {object.mass: {uniform: [5, 50]}}\n"
    paths: tuple[str, ...] = ("object.mass", "effects.joint_damping", "name", "run")
    fingerprint: str = "stand-in"
    scene_text: str = "gravity: [0, 0, -9.81]\n"
    files: dict[str, str] = field(default_factory=dict)
    folder: str = "."

    @property
    def quantities(self) -> tuple[Any, ...]:
        return tuple(SimpleNamespace(name=n, unit=UNITS[n], words=f"its {n}") for n in NAMES)

    def examples(self, path: str) -> list[Any]:
        return [row_of(run).values.get(path, 0.5) for run in range(1, 6)]

    @property
    def scene(self) -> Any:
        return SimpleNamespace(folder=Path(self.folder))


def row_of(run: int, worker: str = "here") -> Record:
    """The row that a run has, wherever it is made."""
    rng = np.random.default_rng(run)
    values = {
        "object.mass": float(rng.uniform(5, 50)),
        "effects.joint_damping": [0, 0.5, 2**60 + 1, None, True][run % 5],
        "name": f"schön, “{run}”\n" * (1 + 4 * (run % 3)),
        "run": {"duration": 0.1 * (run % 7), "accuracy": [1e-6, run]},
    }
    if run % FAILING == 0:
        quantities = dict.fromkeys(NAMES)
        return Record(
            run, "failed", f"the step of run {run} is too small", values, quantities, 0.0, worker
        )
    gap, force = (float(x) for x in rng.standard_normal(2))
    found = {"gap": gap, "force": force * 10.0 ** rng.integers(-300, 300), "never": None}
    return Record(run, "completed", "", values, found, float(rng.random()), worker)


def write_on(path: Path, plan: StandInPlan, order: int) -> None:
    """Make what is missing, in an order of its own; say after every block what is safe."""
    print("begin", flush=True)
    with SweepFile(path, plan) as file:
        print(file.made, flush=True)
        rng, left = random.Random(order), list(file.missing())
        # in threads of work that finish out of order, as real workers do
        left.sort(key=lambda run: run + rng.uniform(0, 40))
        while left:
            block, left = left[: (size := rng.randint(1, 7))], left[size:]
            file.append([row_of(run, f"process {order}") for run in block])
            print(file.made, flush=True)
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


if __name__ == "__main__":
    path, count, order, *steps = sys.argv[1:]
    if steps:
        die_after(int(steps[0]))
    write_on(Path(path), StandInPlan(int(count)), int(order))
