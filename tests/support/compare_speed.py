"""Two versions of the package against each other: how much faster or slower has it become?

    python tests/support/compare_speed.py --before ../old --after . [--cold] [--only TEXT]
        [--json FILE]

A version is a checkout, or a Python interpreter that has the package.  Each gets a process of its
own, and the two measure in turn, so that whatever else the machine does meets both alike.  The
ratio is that of each turn, after over before; the table has its median and its quartiles, for the
time of the processor and, beside it, for the time on the wall.  Scenes are those beside this file.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from repository import SCENES

HERE = Path(__file__).resolve()
COLD_SCENES = ("two_ur5_box", "hinged_box", "corner_grippers_block", "grasped_block")
ARMS = ("pinocchio", "compiled")
RING_SIZES = (2, 8, 32)
ACCURACIES = (1e-3, 1e-6, 1e-9)
STEP = 1e-4  # [s] of the fixed-step runs
LONGEST = 10_000  # of their steps: for one second, the scenes move as they are meant to
BURST = 0.05  # [s], about, of one measurement: long beside the clock, short beside disturbances
EGG = {"ellipsoid": {"center": [0, 0, -0.05], "semi_axes": [0.06, 0.04, 0.05]}}
END_FACE = {"plane": {"point": [0.6, 0, 0], "normal": [1, 0, 0]}}

Times = dict[str, float]
Burst = Callable[[], tuple[Times, float]]
"""Measures once: times, and the number of calls that took them."""


# --- in the process of one version ---------------------------------------------------------------


def clocked(call: Callable[[], Any]) -> tuple[Times, Any]:
    """Time [s] of a call, and its result."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = call()
    return {"cpu": time.process_time() - cpu, "wall": time.perf_counter() - wall}, result


def repeated(call: Callable[[], Any]) -> Burst:
    """A burst of calls."""
    call()  # what happens the first time only
    once = min(clocked(call)[0]["wall"] for _ in range(3))
    count = max(1, round(BURST / max(once, 1e-7)))

    def burst() -> tuple[Times, float]:
        return clocked(lambda: [call() for _ in range(count)])[0], count

    return burst


def evaluations(system: Any) -> Burst:
    """Evaluations of the time loop: a long run less a short one, so that all else drops out."""
    import multiarm as ma

    def run(steps: int) -> tuple[Times, int]:
        duration = steps * STEP
        times, trajectory = clocked(
            lambda: ma.simulate(
                system, duration, integrator="rk4", step=STEP, output_step=duration,
                stabilization="none", certificate=False,
            )
        )  # fmt: skip
        if trajectory.status != "completed":
            raise SystemExit(f"{system.scene.name}: {trajectory.message}")
        return times, trajectory.statistics["evaluations"]

    short, trial = 10, 110
    run(short)
    step = (run(trial)[0]["cpu"] - run(short)[0]["cpu"]) / (trial - short)
    long = short + max(100, min(LONGEST, round(BURST / max(step, 1e-7))))

    def burst() -> tuple[Times, float]:
        (few, count_few), (many, count_many) = run(short), run(long)
        return {key: many[key] - few[key] for key in many}, count_many - count_few

    return burst


def probes() -> dict[str, Callable[[], Burst]]:
    """What is measured within a process: name -> function that prepares it."""
    import multiarm as ma
    from multiarm.problems import ring_of_arms

    def load(name: str) -> Any:
        return ma.load_scene(SCENES / f"{name}.yaml")

    def egg() -> Any:
        contacts = [{"arm": EGG, "object": END_FACE}]
        return load("hinged_box").replace(
            gravity=None,
            joints=[
                {"arm": "left", "kind": "weld"},
                {"arm": "right", "kind": "contacts", "contacts": contacts},
            ],
            control={"kind": "none"},
            effects={"joint_damping": 5.0},
        )

    def in_loop(scene: Callable[[], Any], arms: str) -> Burst:
        return evaluations(ma.compile_system(scene(), arms=arms))

    def evaluate(arms: str) -> Burst:
        return repeated(partial(ma.evaluate, ma.compile_system(load("ring_weld"), arms=arms)))

    def simulate(accuracy: float, arms: str) -> Burst:
        system = ma.compile_system(load("ring_weld"), arms=arms)
        end_only = {"output_step": 1.0, "certificate": False}
        return repeated(partial(ma.simulate, system, 1.0, accuracy=accuracy, **end_only))

    def compile_again(arms: str) -> Burst:
        return repeated(partial(ma.compile_system, load("two_ur5_box"), arms=arms))

    scenes = {
        **{f"{n} arms, weld": partial(ring_of_arms, n, "weld") for n in RING_SIZES},
        "2 arms, ball": partial(ring_of_arms, 2, "ball"),
        "2 arms, corner grippers": partial(load, "corner_grippers_block"),
        "2 arms, weld and ellipsoid": egg,
    }
    found: dict[str, Callable[[], Burst]] = {}
    for arms in ARMS:
        for name, scene in scenes.items():
            found[f"evaluation in the loop: {name}, {arms}"] = partial(in_loop, scene, arms)
        found[f"ma.evaluate: ring_weld, {arms}"] = partial(evaluate, arms)
        for accuracy in ACCURACIES:
            name = f"ma.simulate: ring_weld, 1 s to {accuracy:g}, {arms}"
            found[name] = partial(simulate, accuracy, arms)
        found[f"compile_system: two_ur5_box, {arms}"] = partial(compile_again, arms)
    return found


def work() -> None:
    """Answer questions: a line with a probe's name comes in, a line with its figures goes out.

    An empty line asks for the names.
    """
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever the package prints goes elsewhere
    known, bursts = probes(), {}
    for line in sys.stdin:
        name = line.rstrip("\n")
        if not name:
            print(json.dumps(list(known)), file=answers)
            continue
        if name not in bursts:
            bursts[name] = known[name]()
        times, count = bursts[name]()
        print(json.dumps({key: value / count for key, value in times.items()}), file=answers)


# --- in the process that compares ----------------------------------------------------------------


@dataclass
class Side:
    """One version: what runs it."""

    python: str
    environment: dict[str, str]

    @classmethod
    def of(cls, place: str, cache: str | None = None) -> Side:
        """The version of a checkout or of an interpreter, with a kernel cache of its own or not."""
        path, environment = Path(place), dict(os.environ)
        if cache is not None:
            environment["NUMBA_CACHE_DIR"] = cache
        if path.is_dir():
            return cls(sys.executable, {**environment, "PYTHONPATH": str(path.resolve())})
        environment.pop("PYTHONPATH", None)
        return cls(place, environment)

    def worker(self) -> subprocess.Popen[str]:
        """Start a process that measures; :func:`ask` asks it."""
        return subprocess.Popen(
            [self.python, str(HERE), "--work"], env=self.environment, cwd=HERE.parent,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
        )  # fmt: skip

    def run(self, *arguments: str) -> Times:
        """Time [s] of a process."""
        before, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:  # where results are written
            subprocess.run(
                [self.python, *arguments], env=self.environment, cwd=folder, check=True,
                stdout=subprocess.DEVNULL,
            )  # fmt: skip
        wall, after = time.perf_counter() - wall, resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return {"cpu": cpu, "wall": wall}


def ask(worker: subprocess.Popen[str], name: str) -> Any:
    """What a worker measures, or the names of what it can."""
    assert worker.stdin is not None and worker.stdout is not None
    print(name, file=worker.stdin, flush=True)
    line = worker.stdout.readline()
    if not line:
        raise SystemExit(f"a worker failed at {name!r}; its last words are above")
    return json.loads(line)


def processes() -> dict[str, tuple[str, ...]]:
    """What is measured as a process: name -> arguments of the interpreter."""
    scene = str(SCENES / "two_ur5_box.yaml")
    first_compile = f"import multiarm as ma; ma.compile_system(ma.load_scene({scene!r}))"
    return {
        "process: python": ("-c", "pass"),
        "process: import multiarm": ("-c", "import multiarm"),
        "process: import and all public names": (
            "-c", "import multiarm as ma; [getattr(ma, name) for name in ma.__all__]",
        ),
        "process: import, first compile_system": ("-c", first_compile),
        "process: multiarm run two_ur5_box, 0.1 s": _run_command("two_ur5_box"),
    }  # fmt: skip


def _run_command(scene: str) -> tuple[str, ...]:
    short = ("--duration", "0.1", "--no-certificate", "--quiet")
    return ("-m", "multiarm", "run", str(SCENES / f"{scene}.yaml"), *short)


Pair = tuple[Times, Times]


def in_turn(turn: int, measures: Sequence[Callable[[], Times]]) -> Pair:
    """Measure both versions, the first of them first in every second turn."""
    if turn % 2:
        after = measures[1]()
        return measures[0](), after
    return measures[0](), measures[1]()


def measure_warm(sides: Sequence[Side], options: argparse.Namespace) -> dict[str, list[Pair]]:
    """All probes and processes, with the kernels that are cached.

    Where arrays happen to lie in a process is worth some percent, so that workers are started anew.
    """
    found: dict[str, list[Pair]] = {}
    for start in range(options.starts):
        with sides[0].worker() as before, sides[1].worker() as after:
            names = [name for name in ask(before, "") if options.only in name]
            for turn in range(-1, options.turns):  # the first turn prepares
                print(f"\rstart {start + 1}, turn {turn + 1}   ", end="", file=sys.stderr)
                for name in names:
                    pair = in_turn(turn, [partial(ask, worker, name) for worker in (before, after)])
                    if turn >= 0:
                        found.setdefault(name, []).append(pair)
    for turn in range(-1, options.process_turns):
        for name, arguments in processes().items():
            if options.only in name:
                pair = in_turn(turn, [partial(side.run, *arguments) for side in sides])
                if turn >= 0:
                    found.setdefault(name, []).append(pair)
    print(file=sys.stderr)
    return found


def measure_cold(options: argparse.Namespace) -> dict[str, list[Pair]]:
    """First runs of scenes, one after the other, from an empty cache, and second ones."""
    found: dict[str, list[Pair]] = {}
    for turn in range(options.cold):
        with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
            sides = [Side.of(options.before, one), Side.of(options.after, other)]
            for kind in ("cold", "warm again"):
                for scene in COLD_SCENES:
                    print(f"\r{kind}: {scene}            ", end="", file=sys.stderr, flush=True)
                    calls = [partial(side.run, *_run_command(scene)) for side in sides]
                    found.setdefault(f"{kind}: {scene}", []).append(in_turn(turn, calls))
    print(file=sys.stderr)
    return found


def summary(pairs: list[Pair]) -> dict[str, Any]:
    """Medians of both versions [s] and quartiles of their ratio, by kind of time."""
    found: dict[str, Any] = {"turns": len(pairs)}
    for kind in ("cpu", "wall"):
        before, after = ([pair[side][kind] for pair in pairs] for side in (0, 1))
        ratios = [b / a for a, b in zip(before, after, strict=True) if a > 0.0]
        quartiles = statistics.quantiles(ratios, n=4) if len(ratios) > 1 else ratios * 3
        found[kind] = {
            "before_s": statistics.median(before),
            "after_s": statistics.median(after),
            "ratio_quartiles": quartiles,
        }
    return found


def table(found: dict[str, dict[str, Any]]) -> str:
    """The figures as text: processor time, its ratio with quartiles, the ratio of wall times."""
    lines = [f"{'':60}{'before':>9}{'after':>9}  ratio (quartiles)      wall ratio"]
    for name, entry in found.items():
        cpu = entry["cpu"]
        low, median, high = cpu["ratio_quartiles"]
        lines.append(
            f"{name:60}{_time(cpu['before_s']):>9}{_time(cpu['after_s']):>9}  "
            f"{median:5.3f} ({low:.3f} to {high:.3f})  {entry['wall']['ratio_quartiles'][1]:8.3f}"
        )
    return "\n".join(lines)


def _time(seconds: float) -> str:
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"


def main() -> None:
    """The command line."""
    if "--work" in sys.argv:
        work()
        return
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--before", required=True, help="checkout or interpreter")
    parser.add_argument("--after", required=True, help="checkout or interpreter")
    parser.add_argument("--starts", type=int, default=4, help="of both workers")
    parser.add_argument("--turns", type=int, default=5, help="measurements of each per start")
    parser.add_argument("--process-turns", type=int, default=5, help="starts of each process")
    parser.add_argument("--cold", type=int, nargs="?", const=1, default=0, metavar="TURNS",
                        help="measure only first runs with an empty kernel cache")  # fmt: skip
    parser.add_argument("--only", default="", help="what has this text in its name")
    parser.add_argument("--json", type=Path, help="write all measurements")
    options = parser.parse_args()
    sides = [Side.of(options.before), Side.of(options.after)]
    pairs = measure_cold(options) if options.cold else measure_warm(sides, options)
    found = {name: summary(own) for name, own in pairs.items()}
    print(table(found))
    if options.json is not None:
        options.json.write_text(json.dumps({"summary": found, "pairs": pairs}, indent=1))


if __name__ == "__main__":
    main()
