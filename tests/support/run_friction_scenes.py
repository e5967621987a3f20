"""Run random scenes with friction, each within a time limit, and list those that fail.

python tests/support/run_friction_scenes.py --family fingertips --number 60 --accuracy 1e-6
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from random_friction_scenes import FAMILIES, Table, draw

PROVEN = "no solution (Painleve)"
"""What messages of runs have that end because no motion obeys the laws."""
SLOWEST = 120.0  # of a run [s]


class Case(NamedTuple):
    """A scene, and the accuracy of its run."""

    family: str
    seed: int
    accuracy: float


class Run(NamedTuple):
    """How a run ended."""

    status: str
    message: str
    simulated: float  # [s]
    duration: float  # asked for [s]
    seconds: float
    evaluations: int
    events: int

    @property
    def proven(self) -> bool:
        """Whether it ended because no motion obeys the laws of contact."""
        return self.status != "completed" and PROVEN in self.message


def simulate_table(table: Table, accuracy: float, **options: Any) -> Any:
    """The trajectory of a scene, without a certificate if not asked for."""
    import multiarm as ma
    from multiarm.scene import parse_scene

    system = ma.compile_system(parse_scene(table))
    return ma.simulate(system, accuracy=accuracy, **{"certificate": False} | options)


def carry_out(case: Case) -> Run:
    """Run a case; an error is a result."""
    table = draw(case.family, case.seed)
    duration = table["run"]["duration"]
    began = time.monotonic()
    try:
        trajectory = simulate_table(table, case.accuracy)
    except (Exception, KeyboardInterrupt) as error:
        seconds = time.monotonic() - began
        return Run(f"{type(error).__name__}", str(error), 0.0, duration, seconds, 0, 0)
    facts = trajectory.statistics
    return Run(
        str(trajectory.status),
        trajectory.message,
        float(facts["simulated_s"]),
        duration,
        time.monotonic() - began,
        facts.get("evaluations", 0),
        facts.get("contact_events") or 0,
    )


def _serve(pipe: Connection) -> None:
    while True:
        pipe.send(carry_out(Case(*pipe.recv())))


class Worker:
    """A process that runs cases one by one.

    A run that takes too long is interrupted; a process that does not listen is replaced.
    """

    def __init__(self, limit: float = SLOWEST) -> None:
        self.limit = limit
        self._context = multiprocessing.get_context("spawn")
        self._process: Any = None

    def run(self, case: Case) -> Run:
        if self._process is None:
            self._pipe, there = self._context.Pipe()
            self._process = self._context.Process(target=_serve, args=(there,), daemon=True)
            self._process.start()
            there.close()
        self._pipe.send(case)
        try:
            if not self._pipe.poll(self.limit):
                os.kill(self._process.pid, signal.SIGINT)
            if self._pipe.poll(self.limit):
                return self._pipe.recv()
            why = Run("timeout", "does not listen", 0.0, 0.0, 2.0 * self.limit, 0, 0)
        except (EOFError, OSError):
            why = Run("died", "the process ended", 0.0, 0.0, 0.0, 0, 0)
        self.close()
        return why

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--family", choices=list(FAMILIES), action="append", help="all if none")
    parser.add_argument("--number", type=int, default=10, help="scenes of each family")
    parser.add_argument("--seed", type=int, default=0, help="of the first")
    parser.add_argument("--accuracy", type=float, action="append", help="1e-4 and 1e-6 if none")
    parser.add_argument("--limit", type=float, default=SLOWEST, help="of a run [s]")
    parser.add_argument("--out", type=Path, help="append results to this file, a JSON a line")
    parser.add_argument("--scene", type=Path, help="only write the first scene to this file")
    options = parser.parse_args()
    if options.scene is not None:
        table = draw((options.family or list(FAMILIES))[0], options.seed)
        options.scene.write_text(yaml.safe_dump(table, sort_keys=False))
        return 0
    worker, failed = Worker(options.limit), 0
    for family in options.family or FAMILIES:
        for accuracy in options.accuracy or (1e-4, 1e-6):
            for seed in range(options.seed, options.seed + options.number):
                case = Case(family, seed, accuracy)
                run = worker.run(case)
                good = run.status == "completed" or run.proven
                failed += not good
                print(
                    f"{family:10} {seed:3d} {accuracy:.0e} {run.status:12} "
                    f"{run.simulated:.4f}/{run.duration:.2f} s  {run.seconds:6.1f} s "
                    f"{run.evaluations:8d} evaluations {run.events:5d} events"
                    + ("" if good else f"  {run.message}"),
                    flush=True,
                )
                if options.out is not None:
                    with options.out.open("a") as file:
                        file.write(json.dumps(case._asdict() | run._asdict()) + "\n")
    worker.close()
    print(f"{failed} failed")
    return bool(failed)


if __name__ == "__main__":
    raise SystemExit(main())
