r"""What each effect of a scene costs and changes in a run: the ledger.

A *variant* of the scene lacks one effect, has one more, or has one simpler setting.

Each variant is run once to the requested accuracy, and then timed in turns.  The first run is
checked (:mod:`multiarm.simulation.certificate`), so that differences between two of them are caused
by the effect and not by the method.  The timed runs are unchecked: in every round each variant runs
once after the scene itself, and the differences count.  A change is the largest difference of a
quantity between two runs.  With an effect a contact may have forces that it lacks without it, such
as those of friction; these are not compared.

Of pairs of times :math:`(a_k, b_k)`, one after the other, the estimate is the median of
:math:`a_k - b_k`: disturbances affect both of a pair.  The uncertainty is twice the standard error
of that median, :math:`\sigma \sqrt{\pi / 2 n}`, with :math:`\sigma` from the quartiles of the
differences, so that single outliers do not count.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.system import System
from multiarm.effects.defaults import defaults
from multiarm.errors import SolverError
from multiarm.notation import count_of
from multiarm.results.outcome import RunStatus, plain
from multiarm.results.trajectory import Trajectory
from multiarm.scene import RunSpec, Scene
from multiarm.scene.parameters import written_value
from multiarm.simulation.comparison import object_poses, pose_differences
from multiarm.simulation.inspection import active_effects
from multiarm.simulation.simulate import simulate
from multiarm.studies.differences import Quantity, largest_differences, open_forces
from multiarm.studies.records import about_scene, accuracies, error_text, machine
from multiarm.studies.timing import clocked_run
from multiarm.tableaus import METHODS, VARIATIONAL
from multiarm.terminal.progress import Progress, Report, displayed
from multiarm.threads import one_thread

PRESENT, CANDIDATE, SETTING = "present", "candidate", "setting"
"""Kinds of entry: an effect of the scene, one that might be added, a setting of the run."""
STABILIZATION, RECORDING, CERTIFICATE = "stabilization", "recording", "certificate"
"""The settings."""
QUARTILES = 1.349
"""Distance of the quartiles of a normal distribution, in standard deviations."""
REPEATS = 9
LEAST_REPEATS = 3
BUDGET = 3.0
"""All timed runs of one variant take about so long together [s]: slow ones are repeated less."""
FORCE_ACCURACY = 1e-3
"""Accuracy of contact forces if the scene requests none, as a fraction of the largest one."""


PATH, TURN, JOINTS, SLIDES, FORCE = "path", "turn", "joints", "slides", "force"
CHANGE_QUANTITIES = {
    PATH: Quantity("object's path", "m", ("object position",)),
    TURN: Quantity("object's orientation", "rad", ("object rotation",)),
    JOINTS: Quantity("turning joints", "rad", ("joints",)),
    SLIDES: Quantity("sliding joints", "m", ("sliding joints",)),
    FORCE: Quantity("contact forces", "N", ("contact forces",)),
}


# --- facts ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Estimate:
    """A measured difference, and twice its standard error."""

    value: float
    uncertainty: float

    @property
    def within_noise(self) -> bool:
        """Whether it may as well be zero."""
        return not abs(self.value) > self.uncertainty

    def scaled(self, factor: float) -> Estimate:
        """The estimate in another unit."""
        return Estimate(factor * self.value, abs(factor) * self.uncertainty)


def paired_difference(first: np.ndarray, second: np.ndarray) -> Estimate:
    """Estimate of ``first - second``, measured in turn, shapes (n,)."""
    assert first.shape == second.shape and first.size, "measured in turn"
    apart = first - second
    low, high = np.percentile(apart, (25.0, 75.0))
    error = (high - low) / QUARTILES * math.sqrt(math.pi / 2.0 / apart.size)
    return Estimate(float(np.median(apart)), 2.0 * float(error))


@dataclass(frozen=True)
class Change:
    """The largest difference of two runs in one quantity."""

    value: float  # [m, rad, N]
    time: float  # when it is that large [s]
    arm: str = ""  # whose joint or contact it is; empty for the object


@dataclass(frozen=True)
class Entry:
    """One thing: an effect of the scene, one that might be added, or a setting."""

    name: str
    kind: str  # present, candidate, setting
    about: str  # what was done: "left out", "added as ..."
    trouble: str = ""  # why there are no numbers, or how the run failed; empty after a success
    # of wall time a simulated second that it costs; negative where it saves time
    milliseconds: Estimate | None = None
    share: Estimate | None = None  # the same as a fraction of the time of the scene's own run
    evaluations: int | None = None  # that it costs, in the whole run
    changes: Mapping[str, Change] = field(default_factory=dict)  # quantity -> Change
    certified: bool = True  # its run meets the requested accuracy, or the scene requests none


@dataclass(frozen=True)
class Ledger:
    """What every effect of a scene costs and changes."""

    scene: Mapping[str, Any]  # name, duration_s, output_step_s, text
    # quantity -> requested accuracy; changes below it are not distinguishable from errors
    asked: Mapping[str, float]
    asked_by_scene: bool  # the scene itself requests that accuracy
    # the scene's own run: status, integrator, stabilization, evaluations, milliseconds (of wall
    # time a simulated second), certificate (its sentence), certified (as of an entry), repeats
    run: Mapping[str, Any]
    entries: tuple[Entry, ...]
    machine: Mapping[str, Any]
    wall_time_s: float  # that all this took

    @property
    def table(self) -> pandas.DataFrame:
        """A row for each entry: name, kind, ``share`` of the time and its ``uncertainty``, and for
        each quantity the change in units of the requested accuracy; missing where not known."""
        rows = [
            {
                "name": entry.name,
                "kind": entry.kind,
                "share": None if entry.share is None else entry.share.value,
                "uncertainty": None if entry.share is None else entry.share.uncertainty,
                **{name: change.value / self.asked[name] for name, change in entry.changes.items()},
            }
            for entry in self.entries
        ]
        numbers = ["share", "uncertainty", *CHANGE_QUANTITIES]
        table = pandas.DataFrame(rows, columns=["name", "kind", *numbers])
        return table.astype(dict.fromkeys(numbers, float))

    def moves(self, entry: Entry) -> str | None:
        """The first quantity whose change is above the requested accuracy; None without any."""
        above = (q for q, change in entry.changes.items() if change.value > self.asked[q])
        return min(above, key=list(CHANGE_QUANTITIES).index, default=None)

    def can_go(self, entry: Entry) -> bool:
        """Whether an effect's changes are known to be below the requested accuracy."""
        certified = self.run["certified"] and entry.certified
        known = entry.kind in (PRESENT, CANDIDATE) and not entry.trouble and certified
        return known and bool(entry.changes) and self.moves(entry) is None

    def as_dict(self) -> dict[str, Any]:
        """The ledger in what JSON knows."""
        entries = [{**asdict(entry), "can_go": self.can_go(entry)} for entry in self.entries]
        return plain({**asdict(self), "entries": entries})


# --- variants -------------------------------------------------------------------------------------


class Variant(NamedTuple):
    """A scene that differs from the one that is looked at in one thing."""

    name: str  # of that thing
    kind: str
    about: str  # what was done, in words
    scene: Callable[[], Scene]  # raises SceneError where there is none
    ends_only: bool = False  # its run has no samples in common with the scene's but the ends


def without(scene: Scene, name: str) -> Scene:
    """The scene without an effect; gravity is one.

    Raises
    ------
    SceneError
        Something else in the scene needs it.
    """
    if name == "gravity":
        return scene.replace(gravity=None)
    remaining = {key: spec for key, spec in scene.effects.named.items() if key != name}
    return scene.replace(effects=remaining)


def variants_of(scene: Scene, candidates: Mapping[str, Any]) -> list[Variant]:
    """The scene without each of its effects, in simpler settings, and with each candidate that it
    does not have."""
    run, present = scene.run, scene.effects.named
    variants = [
        Variant(name, PRESENT, "left out", partial(without, scene, name))
        for name in active_effects(scene)
    ]
    keeps_closed = run.integrator is not None and METHODS[run.integrator].kind == VARIATIONAL
    if run.stabilization.kind != "none" and not keeps_closed:
        about = f"none instead of {run.stabilization.kind}"
        bare = partial(_with_run, scene, stabilization="none")
        variants.append(Variant(STABILIZATION, SETTING, about, bare))
    if run.output_step < run.duration:
        about = f"two samples instead of one every {run.output_step:g} s"
        unrecorded = partial(_with_run, scene, output_step=run.duration)
        variants.append(Variant(RECORDING, SETTING, about, unrecorded, ends_only=True))
    for name, spec in candidates.items():
        if name not in present:
            extended = partial(scene.replace, effects={**present, name: spec})
            variants.append(Variant(name, CANDIDATE, f"added as {written_value(spec)}", extended))
    return variants


def _with_run(scene: Scene, **changes: Any) -> Scene:
    return scene.replace(run={**scene.run.model_dump(exclude_none=True), **changes})


# --- measurements ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bench:
    """A variant, compiled, and its checked run."""

    system: System
    run: Trajectory


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
    variants = variants_of(scene, defaults(scene) if candidates else {})
    with one_thread(), displayed(progress, Progress) as report:
        report(0.0, 1 + len(variants), "the scene itself")
        base = _bench(compile_system(scene))
        if base.run.status != RunStatus.COMPLETED:
            raise SolverError(f"the scene itself does not run: {base.run.message}")
        benches: list[Bench | str] = []
        for number, variant in enumerate(variants):
            report(number + 1.0, 1 + len(variants), f"{variant.name}, {variant.about}")
            try:
                benches.append(_bench(compile_system(variant.scene())))
            except Exception as error:  # one that fails must not hide the others
                benches.append(error_text(error))
        base_times, *times = _times([base, *benches], repeats, report)
    entries = [_entry(*row, base, base_times) for row in zip(variants, benches, times, strict=True)]
    statistics, certificate = base.run.statistics, base.run.certificate
    milliseconds = 1e3 * float(np.median(base_times))
    if certificate is not None:
        entries.append(_cost_of_checking(certificate["attempts"], milliseconds))
    return Ledger(
        scene=about_scene(scene),
        asked=_accuracies(scene.run, base.run),
        asked_by_scene=scene.run.accuracy is not None,
        run={
            "status": base.run.status,
            **{key: statistics[key] for key in ("integrator", "stabilization", "evaluations")},
            "milliseconds": milliseconds,
            "certificate": "" if certificate is None else certificate["text"],
            "certified": _is_certified(base.run),
            "repeats": int(base_times.size),
        },
        entries=tuple(entries),
        machine=machine(),
        wall_time_s=time.perf_counter() - begin,
    )


def _bench(system: System) -> Bench:
    run = simulate(system)
    if run.status == RunStatus.INTERRUPTED:
        raise KeyboardInterrupt
    return Bench(system, run)


def _times(benches: Sequence[Bench | str], repeats: int, report: Report) -> list[np.ndarray]:
    """Seconds a simulated second of each bench, in rounds; empty of one that does not run.

    A bench that has spent its time takes no part any more; the first, the scene itself, does.
    """
    seconds: list[list[float]] = [[] for _ in benches]
    running = {
        number: bench
        for number, bench in enumerate(benches)
        if isinstance(bench, Bench) and bench.run.status == RunStatus.COMPLETED
    }
    left = dict.fromkeys(running, BUDGET)
    for turn in range(repeats):
        report(turn, repeats, "timing, round by round")
        for number, bench in running.items():
            if number == 0 or turn < LEAST_REPEATS or left[number] > 0.0:
                _, wall_time = clocked_run(bench.system)
                left[number] -= wall_time
                seconds[number].append(wall_time / bench.run.statistics["simulated_s"])
        if turn + 1 >= LEAST_REPEATS and max(left.values()) <= 0.0:
            break
    return [np.array(times) for times in seconds]


def _entry(
    variant: Variant, bench: Bench | str, times: np.ndarray, base: Bench, base_times: np.ndarray
) -> Entry:
    entry = Entry(variant.name, variant.kind, variant.about)
    if isinstance(bench, str):
        return replace(entry, trouble=bench, certified=False)
    compared = last_changes if variant.ends_only else changes
    entry = replace(
        entry,
        changes=compared(base.system, base.run, bench.run),
        certified=_is_certified(bench.run),
    )
    if bench.run.status != RunStatus.COMPLETED:
        return replace(entry, trouble=f"the run fails: {bench.run.message}")
    sign = 1 if variant.kind == CANDIDATE else -1
    cost = paired_difference(times, base_times[: times.size]).scaled(sign)
    more = bench.run.statistics["evaluations"] - base.run.statistics["evaluations"]
    return replace(
        entry,
        milliseconds=cost.scaled(1e3),
        share=cost.scaled(1.0 / float(np.median(base_times))),
        evaluations=sign * more,
    )


def _is_certified(run: Trajectory) -> bool:
    return run.certificate is None or bool(run.certificate["met"])


def changes(system: System, run: Trajectory, variant: Trajectory) -> dict[str, Change]:
    """Largest differences of two runs with the same output times, as far as both go.

    Parameters
    ----------
    system : System
        Of the first run; says which contact forces its equations leave open.
    run, variant : Trajectory
    """
    if not len(run) or not len(variant):
        return {}
    undetermined = open_forces(system, run)
    largest = largest_differences(run, variant, undetermined, CHANGE_QUANTITIES)
    return {name: Change(d.worst, d.time, d.arm) for name, d in largest.items()}


def last_changes(_system: System, run: Trajectory, variant: Trajectory) -> dict[str, Change]:
    """Differences of the object's pose at the end of two runs, whatever they recorded before.

    There are none where the second one ends earlier.
    """
    if variant.status != RunStatus.COMPLETED:
        return {}
    time = float(run.time[-1])
    moved, turned = pose_differences(object_poses(run)[-1:], object_poses(variant)[-1:])
    return {PATH: Change(moved, time), TURN: Change(turned, time)}


def _cost_of_checking(attempts: Sequence[Mapping[str, Any]], milliseconds: float) -> Entry:
    """What checking the run cost: all runs but the first, in units of that one."""
    first, *repetitions = attempts
    share = sum(attempt["wall_time_s"] for attempt in repetitions) / first["wall_time_s"]
    return Entry(
        CERTIFICATE,
        SETTING,
        f"{count_of(len(repetitions), 'more run')}, to check the first",
        milliseconds=Estimate(share * milliseconds, 0.0),
        share=Estimate(share, 0.0),
        evaluations=sum(attempt["evaluations"] for attempt in repetitions),
    )


def _accuracies(spec: RunSpec, run: Trajectory) -> dict[str, float]:
    """The requested or default accuracy, by quantity."""
    largest = max(run.summary()["contact_force_max_N"].values(), default=0.0)
    asked = accuracies(spec, max(FORCE_ACCURACY * largest, FORCE_ACCURACY))
    position, rotation = asked["position"], asked["rotation"]
    return {
        PATH: position, TURN: rotation, JOINTS: rotation, SLIDES: position, FORCE: asked["force"],
    }  # fmt: skip
