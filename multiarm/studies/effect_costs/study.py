"""What each effect of a scene costs and changes in a run, and what it adds to an evaluation.

A *variant* of the scene lacks one effect, has one more, or has one simpler setting.

Each variant is run once to the requested accuracy, and then timed in turns.  The first run is
checked (:mod:`multiarm.simulation.certificate`), so that differences between two of them are caused
by the effect and not by the method.  The timed runs are unchecked: in every round each variant runs
once after the scene itself, and the differences count.  A change is the largest difference of a
quantity between two runs.  With an effect a contact may have forces that it lacks without it, such
as those of friction; these are not compared.

Of one evaluation, at the start, time, arrays, states, rows and calls into Python are compared with
those of the scene without the effect.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.system import System
from multiarm.effects.defaults import defaults
from multiarm.errors import SolverError
from multiarm.notation import count_of
from multiarm.results.trajectory import Trajectory
from multiarm.scene import RunSpec, Scene
from multiarm.simulation.comparison import compare, rotation_apart, undetermined_forces
from multiarm.simulation.inspection import active_effects
from multiarm.simulation.simulate import simulate
from multiarm.studies.effect_costs.entries import (
    CANDIDATE,
    FORCE,
    JOINTS,
    PATH,
    PRESENT,
    RECORDING,
    SETTING,
    SLIDES,
    TURN,
    Change,
    Entry,
    Estimate,
    Ledger,
    paired_difference,
)
from multiarm.studies.records import about_scene, accuracies, error_text, machine
from multiarm.studies.timing import clocked_run, one_thread
from multiarm.terminal.progress import Progress, Report, displayed

STABILIZATION, CERTIFICATE = "stabilization", "certificate"


# --- variants -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Variant:
    """A scene that differs from the one that is looked at in one thing.

    Attributes
    ----------
    name : str
        Of that thing.
    kind : {"present", "candidate", "setting"}
        An effect that is left out, one that is added, or a setting of the run that is simpler.
    about : str
        What was done, in words.
    scene : callable
        Makes the scene; raises SceneError where there is none.
    """

    name: str
    kind: str
    about: str
    scene: Callable[[], Scene]


def without(scene: Scene, name: str) -> Scene:
    """The scene without an effect; gravity is one.

    Raises
    ------
    SceneError
        Something else in the scene needs it.
    """
    if name == "gravity":
        return scene.replace(gravity=None)
    kept = {key: spec for key, spec in scene.effects.named.items() if key != name}
    return scene.replace(effects=kept)


def left_out(scene: Scene) -> list[Variant]:
    """One variant for each effect of a scene."""
    return [
        Variant(name, PRESENT, "left out", partial(without, scene, name))
        for name in active_effects(scene)
    ]


def added(scene: Scene, candidates: Mapping[str, Any]) -> list[Variant]:
    """One variant for each effect that the scene does not have, with these parameters."""
    has = scene.effects.named
    return [
        Variant(
            name,
            CANDIDATE,
            f"added as {_words(spec)}",
            partial(scene.replace, effects={**has, name: spec}),
        )
        for name, spec in candidates.items()
        if name not in has
    ]


def simpler_settings(scene: Scene) -> list[Variant]:
    """The run without stabilisation, and with no samples but the first and the last."""
    run = scene.run
    found = []
    if run.stabilization.kind != "none" and run.integrator != "variational":
        about = f"none instead of {run.stabilization.kind}"
        found.append(
            Variant(STABILIZATION, SETTING, about, partial(_with_run, scene, stabilization="none"))
        )
    if run.output_step < run.duration:
        about = f"two samples instead of one every {run.output_step:g} s"
        found.append(
            Variant(RECORDING, SETTING, about, partial(_with_run, scene, output_step=run.duration))
        )
    return found


def _with_run(scene: Scene, **changes: Any) -> Scene:
    return scene.replace(run={**scene.run.model_dump(exclude_none=True), **changes})


def _words(spec: Any) -> str:
    """Parameters in one line, as a scene has them."""
    if isinstance(spec, Mapping):
        return "{" + ", ".join(f"{key}: {_words(value)}" for key, value in spec.items()) + "}"
    if isinstance(spec, (list, tuple)):
        return "[" + ", ".join(_words(value) for value in spec) + "]"
    return f"{spec:.4g}" if isinstance(spec, float) else str(spec)


# --- runs -----------------------------------------------------------------------------------------


_QUANTITY_OF = {
    "object position": PATH,
    "object rotation": TURN,
    "joints": JOINTS,
    "sliding joints": SLIDES,
    "contact forces": FORCE,
}


def changes(system: System, run: Trajectory, other: Trajectory) -> dict[str, Change]:
    """Largest differences of two runs with the same output times, as far as both go.

    Parameters
    ----------
    system : System
        Of the first run; says which contact forces its equations leave open.
    run, other : Trajectory
    """
    found: dict[str, Change] = {}
    if not len(run) or not len(other):
        return found
    with system.borrow() as data:
        lost = undetermined_forces(data, run)
    for name, difference in compare(run, other, lost).outputs.items():
        arm, _, noun = name.rpartition(": ")
        quantity = _QUANTITY_OF[noun]
        worse = quantity not in found or difference.worst > found[quantity].value
        if difference.compared and worse:
            found[quantity] = Change(difference.worst, difference.time, arm)
    return found


def last_changes(_system: System, run: Trajectory, other: Trajectory) -> dict[str, Change]:
    """Differences of the object's pose at the end of two runs, whatever they recorded before."""
    time = float(run.time[-1])
    off = np.linalg.norm(run.object_position[-1] - other.object_position[-1])
    turned = rotation_apart(run.object_quaternion_xyzw[-1:], other.object_quaternion_xyzw[-1:])
    return {PATH: Change(float(off), time), TURN: Change(float(turned[0]), time)}


REPEATS = 9
LEAST_REPEATS = 3
BUDGET = 3.0
"""All timed runs of one variant take about so long together [s]: slow ones are repeated less."""
FORCE_ACCURACY = 1e-3
"""Accuracy of contact forces if the scene requests none, as a fraction of the largest one."""


def ledger(
    scene: Scene,
    *,
    candidates: bool = False,
    repeats: int = REPEATS,
    progress: bool | Report | None = None,
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
    progress : bool or callable, optional
        ``progress(done, total, words)``; True: on stderr.

    Raises
    ------
    MultiarmError
        Where the scene itself does not run to its end.
    KeyboardInterrupt
        Ctrl-C.
    """
    begin = time.perf_counter()
    variants = [*left_out(scene), *simpler_settings(scene)]
    if candidates:
        variants += added(scene, defaults(scene))
    with one_thread(), displayed(progress, Progress) as report:
        own, benches = _run_all(scene, variants, report)
        able = {key: bench for key, bench in benches.items() if isinstance(bench, _Bench)}
        times = _times({_OWN: own, **able}, repeats, report)
    entries = [
        _entry(variant, benches[_key(variant)], own, times.get(_key(variant)), times[_OWN])
        for variant in variants
    ]
    cost = _certificate(own.run, times[_OWN])
    return Ledger(
        scene=about_scene(scene),
        asked=_accuracies(scene.run, own.run),
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
    scene: Scene, variants: Sequence[Variant], report: Report
) -> tuple[_Bench, dict[str, _Bench | str]]:
    """Bench of the scene, and of each variant: its bench, or why there is none."""
    total = 1 + len(variants)
    report(0.0, total, _OWN)
    own = _Bench.of(compile_system(scene))
    if own.run.status != "completed":
        raise SolverError(f"the scene itself does not run: {own.run.message}")
    found: dict[str, _Bench | str] = {}
    for number, variant in enumerate(variants):
        report(number + 1.0, total, f"{variant.name}, {variant.about}")
        try:
            found[_key(variant)] = _Bench.of(compile_system(variant.scene()))
        except Exception as error:  # one that fails must not hide the others
            found[_key(variant)] = error_text(error)
    return own, found


def _key(variant: Variant) -> str:
    return f"{variant.kind}/{variant.name}"


def _times(benches: Mapping[str, _Bench], repeats: int, report: Report) -> dict[str, np.ndarray]:
    """Seconds a simulated second of each variant that runs, in rounds.

    A variant that has spent its time takes no part any more; the first, the scene itself, does.
    """
    running = {key: b for key, b in benches.items() if b.run.status == "completed"}
    found: dict[str, list[float]] = {key: [] for key in running}
    left = dict.fromkeys(running, BUDGET)
    for turn in range(repeats):
        report(turn, repeats, "timing, round by round")
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
        f"{count_of(len(others), 'more run')}, to check the first",
        milliseconds=Estimate(1e3 * share * float(np.median(times)), 0.0),
        share=Estimate(share, 0.0),
        evaluations=sum(item["evaluations"] for item in others),
    )


def _is_certified(run: Trajectory) -> bool:
    return run.certificate is None or bool(run.certificate["met"])


def _accuracies(spec: RunSpec, run: Trajectory) -> dict[str, float]:
    """The requested or default accuracy, by quantity."""
    largest = max(run.summary()["contact_force_max_N"].values(), default=0.0)
    asked = accuracies(spec, max(FORCE_ACCURACY * largest, FORCE_ACCURACY))
    position, rotation = asked["position"], asked["rotation"]
    return {
        PATH: position, TURN: rotation, JOINTS: rotation, SLIDES: position, FORCE: asked["force"],
    }  # fmt: skip


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
