"""The study: every variant is run once to the accuracy asked, and then timed in turn.

The first run of each is checked (:mod:`multiarm.simulation.certificate`), so that differences
between two of them are the effect's and not the method's.  The timed runs are unchecked; in every
round each variant runs once, after the scene itself, and what the two differ by is taken.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.system import System
from multiarm.effects.defaults import defaults
from multiarm.errors import SolverError
from multiarm.results.trajectory import Trajectory
from multiarm.scene import RunSpec, Scene, dump_scene
from multiarm.scene.control import DEFAULT_ACCURACY
from multiarm.simulation.simulate import simulate
from multiarm.studies.bursts import one_thread
from multiarm.studies.clocked_run import clocked_run
from multiarm.studies.effect_costs.changes import changes, last_changes
from multiarm.studies.effect_costs.entries import (
    FORCE,
    JOINTS,
    PATH,
    SLIDES,
    TURN,
    Entry,
    Ledger,
)
from multiarm.studies.effect_costs.estimates import Estimate, paired_difference
from multiarm.studies.effect_costs.variants import (
    CANDIDATE,
    CERTIFICATE,
    RECORDING,
    SETTING,
    Variant,
    added,
    left_out,
    simpler_settings,
    told,
)
from multiarm.studies.hard_cases import machine

REPEATS = 9
LEAST_REPEATS = 3
BUDGET = 3.0
"""All timed runs of one variant take about so long together [s]: slow ones are repeated less."""
FORCE_ACCURACY = 1e-3
"""Of contact forces where the scene asks for none, as a fraction of the largest one."""

Progress = Callable[[str, float, float], None]
"""Called with what is being done, how much is done, and how much there is."""


def ledger(
    scene: Scene,
    *,
    candidates: bool = False,
    repeats: int = REPEATS,
    progress: Progress | None = None,
) -> Ledger:
    """Measure what each effect of a scene costs, and what it changes.

    Parameters
    ----------
    scene : Scene
    candidates : bool
        Add each effect that the scene does not have, with its usual parameters
        (:func:`multiarm.effects.defaults.defaults`).
    repeats : int
        Timed runs of each variant, at most.
    progress : callable, optional

    Raises
    ------
    MultiarmError
        Where the scene itself does not run to its end.
    KeyboardInterrupt
        Ctrl-C.
    """
    begin = time.perf_counter()
    tell = progress or (lambda _text, _done, _total: None)
    variants = [*left_out(scene), *simpler_settings(scene)]
    if candidates:
        variants += added(scene, defaults(scene))
    with one_thread():
        own, benches = _run_all(scene, variants, tell)
        able = {key: bench for key, bench in benches.items() if isinstance(bench, _Bench)}
        times = _times({_OWN: own, **able}, repeats, tell)
    entries = [
        _entry(variant, benches[_key(variant)], own, times.get(_key(variant)), times[_OWN])
        for variant in variants
    ]
    cost = _certificate(own.run, times[_OWN])
    return Ledger(
        scene={
            "name": scene.name,
            "duration_s": scene.run.duration,
            "output_step_s": scene.run.output_step,
            "text": dump_scene(scene),
        },
        asked=_asked(scene.run, own.run),
        asked_by_scene=scene.run.accuracy is not None,
        run=_about(own.run, times[_OWN]),
        entries=(*entries, *([] if cost is None else [cost])),
        machine=machine(),
        wall_time_s=time.perf_counter() - begin,
    )


_OWN = "the scene itself"


@dataclass(frozen=True)
class _Bench:
    """A variant, compiled, and its checked run."""

    system: System
    run: Trajectory

    @classmethod
    def of(cls, system: System) -> _Bench:
        run = simulate(system)
        if run.status == "interrupted":
            raise KeyboardInterrupt
        return cls(system, run)


def _run_all(
    scene: Scene, variants: Sequence[Variant], tell: Progress
) -> tuple[_Bench, dict[str, _Bench | str]]:
    """Bench of the scene, and of each variant: its bench, or why there is none."""
    total = 2.0 * (1 + len(variants))
    tell(_OWN, 0.0, total)
    own = _Bench.of(compile_system(scene))
    if own.run.status != "completed":
        raise SolverError(f"the scene itself does not run: {own.run.message}")
    found: dict[str, _Bench | str] = {}
    for number, variant in enumerate(variants):
        tell(f"{variant.name}, {variant.about}", number + 1.0, total)
        try:
            found[_key(variant)] = _Bench.of(compile_system(variant.scene()))
        except Exception as error:  # one that fails must not hide the others
            found[_key(variant)] = told(error)
    return own, found


def _key(variant: Variant) -> str:
    return f"{variant.kind}/{variant.name}"


def _times(benches: Mapping[str, _Bench], repeats: int, tell: Progress) -> dict[str, np.ndarray]:
    """Seconds a simulated second of each variant that runs, in rounds.

    A variant that has spent its time takes no part any more; the first, the scene itself, does.
    """
    running = {key: b for key, b in benches.items() if b.run.status == "completed"}
    found: dict[str, list[float]] = {key: [] for key in running}
    left = dict.fromkeys(running, BUDGET)
    for turn in range(repeats):
        tell("timing", float(repeats + turn), 2.0 * repeats)
        for key in [k for k in running if left[k] > 0.0 or k == _OWN or turn < LEAST_REPEATS]:
            _, seconds = clocked_run(running[key].system)
            left[key] -= seconds
            found[key].append(seconds / running[key].run.statistics["simulated_s"])
        if turn + 1 >= LEAST_REPEATS and max(left.values()) <= 0.0:
            break
    return {key: np.array(times) for key, times in found.items()}


def _entry(
    variant: Variant,
    bench: _Bench | str,
    own: _Bench,
    times: np.ndarray | None,
    own_times: np.ndarray,
) -> Entry:
    entry = Entry(variant.name, variant.kind, variant.about)
    if isinstance(bench, str):
        return replace(entry, trouble=bench, certified=False)
    sign = 1 if variant.kind == CANDIDATE else -1
    compared = last_changes if variant.name == RECORDING else changes
    entry = replace(
        entry,
        changes=compared(own.system, own.run, bench.run),
        certified=_is_certified(bench.run),
    )
    if bench.run.status != "completed":
        return replace(entry, trouble=f"the run fails: {bench.run.message}")
    assert times is not None, "what runs is timed"
    cost = paired_difference(times, own_times[: times.size]).scaled(sign)
    whole = float(np.median(own_times))
    counted = bench.run.statistics["evaluations"] - own.run.statistics["evaluations"]
    return replace(
        entry,
        milliseconds=cost.scaled(1e3),
        share=cost.scaled(1.0 / whole),
        evaluations=sign * counted,
    )


def _certificate(run: Trajectory, times: np.ndarray) -> Entry | None:
    """What checking the run cost: all runs but the first, in units of that one."""
    if run.certificate is None:
        return None
    first, *others = run.certificate["attempts"]
    share = sum(item["wall_time_s"] for item in others) / first["wall_time_s"]
    return Entry(
        CERTIFICATE,
        SETTING,
        f"{len(others)} more run{'s' if len(others) > 1 else ''}, to check the first",
        milliseconds=Estimate(1e3 * share * float(np.median(times)), 0.0),
        share=Estimate(share, 0.0),
        evaluations=sum(item["evaluations"] for item in others),
    )


def _is_certified(run: Trajectory) -> bool:
    return run.certificate is None or bool(run.certificate["met"])


def _asked(spec: RunSpec, run: Trajectory) -> dict[str, float]:
    """The accuracy asked for, by quantity."""
    asked = spec.accuracy
    smallest = DEFAULT_ACCURACY if asked is None else asked.smallest
    position = (asked and asked.position) or smallest
    rotation = (asked and asked.rotation) or smallest
    largest = max(run.summary()["contact_force_max_N"].values(), default=0.0)
    force = (asked and asked.force) or max(FORCE_ACCURACY * largest, FORCE_ACCURACY)
    return {PATH: position, TURN: rotation, JOINTS: rotation, SLIDES: position, FORCE: force}


def _about(run: Trajectory, times: np.ndarray) -> dict[str, Any]:
    counted, certificate = run.statistics, run.certificate
    return {
        "status": run.status,
        "integrator": counted["integrator"],
        "stabilization": counted["stabilization"],
        "evaluations": counted["evaluations"],
        "milliseconds": 1e3 * float(np.median(times)),
        "certificate": "" if certificate is None else certificate["text"],
        "repeats": int(times.size),
    }
