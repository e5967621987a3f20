"""Random search for systems on which the solvers are wrong: ``--help`` lists the options.

Prints for each family how many systems were judged, how many are in the band where more than one
answer is right, and of each solver the worst figure relative to its bound with its seed.  Exits
with 1 when a figure is above its bound, and lists the seeds.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

from random_hands import draw_hand, evaluated
from random_systems import FAMILIES, draw
from system_oracle import Oracle

HANDS = "hands"  # scenes


def judged(family: str, seed: int, folder: Path) -> Iterator[tuple[str, Oracle, dict[str, float]]]:
    """Every solver that a system is for, the oracle, and its figures."""
    if family != HANDS:
        oracle = Oracle(draw(family, seed))
        for solver in oracle.solvers:
            yield solver, oracle, oracle.judge(solver)
        return
    scene = draw_hand(seed, folder)
    for arms in ("pinocchio", "compiled"):
        for solver in ("node", "dense"):
            system, found = evaluated(scene, solver, arms)
            oracle = Oracle(system)
            if solver in oracle.solvers:
                yield solver, oracle, oracle.judge(solver, found)


def search(family: str, seeds: range, until: float, folder: Path) -> bool:
    """Judge a family and print the result; whether nothing was wrong."""
    counts, in_band = Counter[str](), Counter[str]()
    worst: dict[str, tuple[float, str, int]] = {}
    wrong: dict[str, dict[int, dict[str, float]]] = defaultdict(dict)
    for done, seed in enumerate(seeds):
        if done and time.monotonic() > until:
            break
        for solver, oracle, figures in judged(family, seed, folder):
            counts[solver] += 1
            in_band[solver] += oracle.spectra[solver].in_band
            what, figure = max(figures.items(), key=lambda item: item[1])
            worst[solver] = max(worst.get(solver, (0.0, what, seed)), (figure, what, seed))
            over = {name: value for name, value in figures.items() if value > 1.0}
            if over:
                wrong[solver][seed] = over
    for solver, number in counts.items():
        figure, what, seed = worst[solver]
        print(
            f"{family:24} {solver:9} {number:6d} judged, {in_band[solver]:5d} in the band, "
            f"{len(wrong[solver]):5d} wrong; worst {figure:.1e} of the bound: {what}, seed {seed}",
            flush=True,
        )
        for seed, over in list(wrong[solver].items())[:20]:
            listed = ", ".join(f"{name} {value:.1e}" for name, value in over.items())
            print(f"    seed {seed}: {listed}")
    return not any(wrong.values())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=1000, help="systems of each family")
    parser.add_argument("--seed", type=int, default=0, help="of the first system")
    parser.add_argument("--seconds", type=float, default=600.0, help="for all families together")
    parser.add_argument("--family", choices=[*FAMILIES, HANDS], action="append", help="all if none")
    options = parser.parse_args()
    families = options.family or [*FAMILIES, HANDS]
    right = True
    with tempfile.TemporaryDirectory() as folder:
        for family in (HANDS, "form_closure", "sliding"):  # compiles
            list(judged(family, 0, Path(folder)))
        began = time.monotonic()
        for k, family in enumerate(families, start=1):
            until = began + options.seconds * k / len(families)
            seeds = range(options.seed, options.seed + options.number)
            right &= search(family, seeds, until, Path(folder))
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
