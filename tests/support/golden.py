"""Frozen results: what a change of the program's structure must not change.

The file ``tests/data/golden.json.xz`` has, for every case, the states at which it was evaluated and
all results. Scenes are those of the examples with arms, of :data:`multiarm.problems.HARD_CASES` and
of ``tests/data/golden_scenes.json``, which names every effect, joint kind, control and integrator.

    python tests/support/golden.py check [FILE] [--only TEXT]   compare: equal, or how far off
    python tests/support/golden.py write [FILE] [--only TEXT]   freeze today's results

A number may be off by its tolerance times the size of its array.  The tolerance is 1e-10, or a
hundred times what moves the number already today: roundings of the state, the other
implementation of the arms' terms, and the instruction sets of other processors.  Flags, ranks,
states of contacts and kinds of events must be equal.  Residuals and drifts have an upper limit.
Results that change under roundings alone, such as a rank decided at its threshold, are marked and
not compared.
"""

from __future__ import annotations

import argparse
import json
import lzma
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from repository import DATA, SCENES

import multiarm as ma
from multiarm.problems import HARD_CASES

FILE = DATA / "golden.json.xz"
GOLDEN_SCENES = DATA / "golden_scenes.json"

TOLERANCE = 1e-10  # of regular systems: some hundred roundings, times the condition of the arms
MARGIN = 100.0  # how much farther than roundings do today, results may move
SMALL_MARGIN = 10.0  # how much larger than today residuals and drifts may be
ROUNDING = 1e-15  # relative change of a state, a few units in the last place
FLOOR = 1e-3  # size of an array [SI] below which errors are not relative to it any more
SMALL_FLOOR = 1e-15
COUNT_SLACK = 3, 0.05  # steps and evaluations may differ by so many, or by this part
MANY_ARMS = 16
SHAKES = 3  # draws of rounded states
# Other instruction sets: of the linear algebra, and of the compiled kernels.
PROCESSORS = (
    {"OPENBLAS_CORETYPE": "Prescott"},
    {"OPENBLAS_CORETYPE": "Haswell"},
    {"OPENBLAS_CORETYPE": "SkylakeX"},
    {"OPENBLAS_CORETYPE": "Prescott", "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
)
OTHER_ARMS = {"pinocchio": "compiled", "compiled": "pinocchio"}
BRIEF_RUN = {
    "run": {"integrator": "dop853", "tolerance": 1e-10, "duration": 0.05, "output_step": 0.05}
}  # of scenes with robots of several tips or several objects, whose channels are many
DEFAULT_RUN = {"integrator": "dop853", "tolerance": 1e-10, "duration": 0.3, "output_step": 0.1}

# How results are compared, by the parts of their names; the others are numbers that are close.
SMALL = {"position_residual", "velocity_residual", "residuals", "residual", "drift"}
EXACT = {"rank", "coupled_arms", "contact_state", "contact_states", "contact_forces_unique"}
OF_SIZE_ONE = {"phi", "phi_dot", "events", "time", "contact_points"}  # also where they are 0
REMARK = "start"  # kind of an event that says how a start was corrected
COUNTED = ("steps", "rejected_steps", "evaluations", "projections", "coupled_steps")

Results = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """A scene, who computes its arms, and the runs that are made of it."""

    name: str
    source: Mapping[str, Any] | str
    arms: str
    runs: Mapping[str, Mapping[str, Any]]
    brief: bool = False  # evaluated at two states only

    def scene(self) -> ma.Scene:
        if isinstance(self.source, Mapping):
            return ma.Scene(folder=GOLDEN_SCENES.parent, **self.source)
        if self.source in HARD_CASES:
            return HARD_CASES[self.source].scene()
        return ma.load_scene(SCENES / self.source)

    def system(self, arms: str | None = None) -> ma.System:
        """The scene, compiled."""
        return ma.compile_system(self.scene(), arms=arms or self.arms)


HARD_RUNS = {
    # a damper that explicit methods need thousands of steps for
    "stiff_damping": {"run": {"accuracy": 1e-8, "duration": 0.1, "output_step": 0.05}},
    "millimetre_robots": {"run": {**DEFAULT_RUN, "duration": 1e-4, "output_step": 5e-5}},
    # its 268 channels would fill the file
    "sixty_four_arms": {"run": {**DEFAULT_RUN, "duration": 0.02, "output_step": 0.02}},
}


def cases() -> Iterator[Case]:
    """All cases; of most scenes two, with Pinocchio's and with compiled arms.

    Scenes with robots of several tips or several objects have one, with compiled arms.
    """
    run = {"run": DEFAULT_RUN}
    for path in sorted(SCENES.glob("*.yaml")):
        scene = ma.load_scene(path)
        if scene.robots or scene.objects:
            yield Case(f"example {path.stem} compiled", path.name, "compiled", BRIEF_RUN, True)
            continue
        for arms in OTHER_ARMS:
            yield Case(f"example {path.stem} {arms}", path.name, arms, run)
    short = {"run": {**DEFAULT_RUN, "duration": 0.1, "output_step": 0.05}}
    for name in HARD_CASES:
        yield Case(f"hard {name}", name, "pinocchio", HARD_RUNS.get(name, short))
    for name, entry in json.loads(GOLDEN_SCENES.read_text()).items():
        yield Case(f"scene {name}", entry["scene"], entry["arms"], entry["runs"])


# --- what is measured ----------------------------------------------------------------------------


def measure(case: Case, states: dict | None = None, arms: str | None = None, seed: int = 0):
    """Results of a case; a ``seed`` other than 0 rounds all states otherwise.

    Returns
    -------
    results : dict
        Name -> number, text, or array as nested lists.
    states : dict
        Label -> state, as stored; drawn where none are given.
    """
    system = case.system(arms)
    rng = np.random.default_rng(seed)
    start = system.initial_state()
    found: Results = {"arm_terms": dict(system.arm_terms)}
    if states is None:
        states = _draw_states(system, case.brief)
    found.update({f"start/{name}": values for name, values in _leaves(_stored(start))})
    labelled = {"start": start, **{k: system.state(**stored) for k, stored in states.items()}}
    for k, (label, state) in enumerate(labelled.items()):
        evaluation = ma.evaluate(system, 0.1 * k, _rounded(state, rng) if seed else state)
        found.update(_of_evaluation(label, evaluation))
    for label, settings in case.runs.items():
        state = _rounded(start, rng) if seed else None
        found.update(_of_run(label, _simulate(system, settings, state)))
    return json.loads(json.dumps(found, default=_listed)), states


def hold(q0, t, state):
    """A controller in Python: springs towards the start."""
    return {
        arm: -40.0 * (q - q0[arm]) - 2.0 * state.joint_velocities[arm]
        for arm, q in state.joint_positions.items()
    }


def gust(t, state):
    """A wrench in Python."""
    x = state.object_position
    return [3.0 * np.sin(5.0 * t), -2.0 * x[0], 1.0, 0.1, 0.2 * np.cos(t), 0.3 * x[2]]


def dome(p):
    """Signed distance of a sphere of 0.1 m about the origin, as a surface in Python."""
    return np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2) - 0.1


def _simulate(system, settings, state):
    settings, more = dict(settings), {}
    if settings.pop("python_control", False):
        q0 = {arm: q.copy() for arm, q in system.initial_state().joint_positions.items()}
        more["control"] = lambda t, now: hold(q0, t, now)
    return ma.simulate(system, state=state, certificate=False, **settings, **more)


def _stored(state_or_run, when=...) -> dict[str, Any]:
    """A state, or that of a run at a sample, as the keywords of ``system.state``."""
    of = state_or_run
    frames = {"objects": of.objects, "bases": of.bases}
    stored: dict[str, Any] = {
        kind: {
            name: {part: getattr(frame, part)[when].tolist() for part in FRAME}
            for name, frame in named.items()
        }
        for kind, named in frames.items()
        if named
    }
    if len(of.objects) == 1:
        (only,) = stored.pop("objects").values()
        stored.update({f"object_{part}": values for part, values in only.items()})
    for name in ("joint_positions", "joint_velocities"):
        stored[name] = {arm: values[when].tolist() for arm, values in getattr(of, name).items()}
    return stored


FRAME = ("position", "quaternion_xyzw", "twist")
ONE_VALUE = ("position_residual", "velocity_residual", "rank")
BY_NAME = (
    ("base_accelerations", "joint_accelerations", "joint_torques", "contact_forces")
    + ("contact_forces_unique", "contact_points", "contact_normals", "conditioning")
    + ("contact_states",)
)  # fmt: skip
TERMS = ("W_m", "W_o", "W_m_dot", "W_o_dot", "c", "phi", "phi_dot")


def _of_evaluation(label: str, evaluation) -> Results:
    found = {name: getattr(evaluation, name) for name in ONE_VALUE}
    accelerations = evaluation.object_accelerations
    if len(accelerations) == 1:
        (found["object_acceleration"],) = accelerations.values()
    else:
        found.update({f"object_accelerations/{name}": a for name, a in accelerations.items()})
    found["coupled_arms"] = sorted(evaluation.coupled_arms)
    for part in ("arm", "object", "constraint"):
        found[f"residuals/{part}"] = getattr(evaluation.residuals, part)
    for name in BY_NAME:
        found.update({f"{name}/{of}": x for of, x in getattr(evaluation, name).items()})
    for arm, terms in evaluation.contact_terms.items():
        found.update({f"contact_terms/{arm}/{name}": getattr(terms, name) for name in TERMS})
    return {f"{label}/{name}": value for name, value in found.items()}


def _of_run(label: str, trajectory) -> Results:
    found: Results = {f"channels/{name}": trajectory.channel(name) for name in trajectory.channels}
    found["status"] = trajectory.status
    counted = trajectory.statistics
    found.update({f"counts/{name}": counted[name] for name in COUNTED if name in counted})
    times: dict[str, list[float]] = {}
    for event in (event for event in trajectory.events if event["kind"] != REMARK):
        who = "/".join(str(event[key]) for key in ("arm", "contact", "joint") if key in event)
        times.setdefault(f"{event['kind']} {who}".strip(), []).append(event["time"])
    found["status/event kinds"] = {kind: len(when) for kind, when in sorted(times.items())}
    found.update({f"events/{kind}": sorted(when) for kind, when in times.items()})
    return {f"{label}/{name}": value for name, value in found.items()}


def _leaves(values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The lists of nested tables, each with the names that lead to it."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}/{rest}", leaf) for rest, leaf in _leaves(value))
        else:
            yield name, value


def _listed(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else list(value)


def _rounded(state, rng: np.random.Generator):
    """The state with other last digits."""
    other = state.copy()
    for values in (other.position, other.velocity):
        values *= 1.0 + ROUNDING * rng.choice([-1.0, 1.0], values.size)
    return other


def _draw_states(system, brief: bool) -> dict[str, dict]:
    """Two states on the joints and one beside them, all moving; where brief the first."""
    rng = np.random.default_rng(20261122)
    found = {}
    for label in ("state 1", "state 2"):
        for size in (0.05, 0.02, 0.005, 0.001, 0.0):
            try:
                run = ma.simulate(
                    system, 1e-6, integrator="rk4", step=1e-6, state=_beside(system, rng, size)
                )
            except ma.MultiarmError:
                continue  # too far from the joints to be projected
            found[label] = _stored(run, 0)
            break
    if brief or len(system.arm_names) > MANY_ARMS:
        return {"state 1": found["state 1"]}  # each state of 64 arms fills a tenth of the file
    beside = _beside(system, rng, 0.005)
    try:
        ma.evaluate(system, 0.0, beside)
    except ma.MultiarmError:
        return found  # nothing meets the laws of contacts there
    return {**found, "beside the joints": _stored(beside)}


def _beside(system, rng, size: float):
    speed = 0.3 * (size > 0.0)
    sizes = {"joint_positions": size, "joint_velocities": speed}
    sizes |= {"object_twist": speed, "twist": speed}  # positions of frames move less

    def shaken(values, by):
        if isinstance(values, dict):
            return {name: shaken(part, sizes.get(name, by)) for name, part in values.items()}
        return _shaken(rng, values, by)

    return system.state(**shaken(_stored(system.initial_state()), 0.1 * size))


def _shaken(rng, values, size: float) -> list[float]:
    return (np.asarray(values) + size * rng.uniform(-1.0, 1.0, len(values))).tolist()


# --- how it is compared --------------------------------------------------------------------------


@dataclass
class Comparison:
    """What came of comparing one case."""

    name: str
    faults: list[str] = field(default_factory=list)
    equal: bool = True
    counts_equal: bool = True
    worst: tuple[float, float, str] = (0.0, TOLERANCE, "")  # difference, its tolerance, of what

    def __str__(self) -> str:
        difference, tolerance, of = self.worst
        text = "equal to the bit" if self.equal else f"{difference:.1e} of {tolerance:.0e} ({of})"
        counts = "" if self.counts_equal else "; other counts"
        return f"{'FAIL' if self.faults else 'ok  '} {self.name}: {text}{counts}"


def compare(case: Case, frozen: dict[str, Any]) -> Comparison:
    """Measure a case and compare it with what is frozen."""
    return compared(case.name, frozen["results"], measure(case, frozen["states"])[0])


def compared(name: str, frozen: Results, found: Results) -> Comparison:
    """Compare results with frozen ones, ``name -> {value, tolerance or limit or kind}``."""
    outcome = Comparison(name)
    for quantity, entry in frozen.items():
        if quantity not in found:
            if "unsteady" not in entry:
                outcome.faults.append(f"{quantity}: is missing")
            continue
        value, new = entry["value"], found[quantity]
        same = value == new
        if "/counts/" in quantity:
            outcome.counts_equal &= same
        else:
            outcome.equal &= same
        if not same and "unsteady" not in entry:
            _compare(outcome, quantity, entry, new)
    if outcome.equal and not outcome.counts_equal:
        outcome.faults.append("equal results with other counts")
    return outcome


def _compare(outcome: Comparison, quantity: str, entry: dict, new: Any) -> None:
    """Add what is wrong with one quantity that is not equal."""
    value = entry["value"]
    if "limit" in entry:
        if not _largest(new) <= entry["limit"]:
            outcome.faults.append(f"{quantity}: {_largest(new):.2g}, limit {entry['limit']:.2g}")
    elif "tolerance" in entry:
        difference = _difference(quantity, value, new)
        if not difference <= entry["tolerance"]:
            outcome.faults.append(
                f"{quantity}: off by {difference:.2g}, tolerance {entry['tolerance']:.0e}"
            )
        if not difference / entry["tolerance"] <= outcome.worst[0] / outcome.worst[1]:
            outcome.worst = difference, entry["tolerance"], quantity
    elif "/counts/" in quantity:
        if abs(new - value) > max(COUNT_SLACK[0], COUNT_SLACK[1] * value):
            outcome.faults.append(f"{quantity}: {new}, was {value}")
    else:
        outcome.faults.append(f"{quantity}: {new}, was {value}")


def _difference(quantity: str, value: Any, new: Any) -> float:
    """Largest difference relative to the array's size; infinite where shapes differ."""
    value, new = np.asarray(value, dtype=float), np.asarray(new, dtype=float)
    if value.shape != new.shape or not np.all(np.isfinite(new)):
        return float("inf")
    floor = FLOOR if OF_SIZE_ONE.isdisjoint(quantity.split("/")) else 1.0
    return float(np.max(np.abs(new - value), initial=0.0)) / max(_largest(value), floor)


def _largest(value: Any) -> float:
    return float(np.max(np.abs(np.asarray(value, dtype=float)), initial=0.0))


# --- freezing ------------------------------------------------------------------------------------


def freeze(case: Case, others: list[Results]) -> dict[str, Any]:
    """Results of a case with their tolerances; ``others`` are those of other processors."""
    results, states = measure(case)
    others = others + [measure(case, states, seed=seed)[0] for seed in range(1, 1 + SHAKES)]
    others.append(measure(case, states, arms=OTHER_ARMS[case.arms])[0])
    frozen = {name: _frozen(name, value, others) for name, value in results.items()}
    return {"states": states, "results": frozen}


def _frozen(name: str, value: Any, others: list[Results]) -> dict[str, Any]:
    entry: dict[str, Any] = {"value": value}
    found = [other[name] for other in others if name in other]
    parts = set(name.split("/"))
    if name == "arm_terms":  # the others have others
        return entry
    if "counts" in parts:
        slack = max(COUNT_SLACK[0], COUNT_SLACK[1] * value)
        steady = all(abs(other - value) <= slack for other in found)
    elif parts & SMALL:
        limit = SMALL_MARGIN * max(_largest(x) for x in [value, *found])
        return {**entry, "limit": _short(max(limit, SMALL_FLOOR))}
    elif parts & EXACT or "status" in parts:
        steady = all(other == value for other in found)
    else:
        spread = max((_difference(name, value, other) for other in found), default=0.0)
        steady = MARGIN * spread < 1.0  # not so coordinates along a basis that is a free choice
        entry["tolerance"] = max(TOLERANCE, _short(MARGIN * spread))
    if steady and len(found) == len(others):
        return entry
    return {"value": value, "unsteady": True}


def _short(bound: float) -> float:
    """The bound in two digits."""
    return float(f"{bound:.1e}")


def load(file: Path = FILE) -> dict[str, Any]:
    """Frozen cases by name."""
    with lzma.open(file, "rt", encoding="utf-8") as stream:
        return json.load(stream)


def _save(file: Path, data: Any) -> None:
    text = json.dumps(data, separators=(",", ":")).encode()
    file.write_bytes(lzma.compress(text))


def _write(file: Path, only: str) -> None:
    """Freeze the cases whose names contain ``only``; the others of the file stay."""
    own = [case for case in cases() if only in case.name]
    others: list[dict[str, Results]] = []
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "states", Path(folder) / "results"
        _save(given, {case.name: {"states": measure(case)[1]} for case in own})
        for k, changed in enumerate(PROCESSORS):
            print("on another processor:", changed, flush=True)
            cache = {"NUMBA_CACHE_DIR": f"{folder}/{k}"} if "NUMBA_CPU_NAME" in changed else {}
            command = [sys.executable, __file__, "measure", str(given), str(made), "--only", only]
            subprocess.run(command, env={**os.environ, **changed, **cache}, check=True)
            others.append(load(made))
    kept = load(file) if only else {}
    frozen = {case.name: freeze(case, [o[case.name] for o in others]) for case in own}
    both = {**kept, **frozen}
    _save(file, {case.name: both[case.name] for case in cases() if case.name in both})
    for name, entry in frozen.items():
        print(f"{name}: {_looseness(entry['results'])}")


def _looseness(results: dict[str, dict]) -> str:
    tolerances = {
        name: entry["tolerance"] for name, entry in results.items() if "tolerance" in entry
    }
    loosest = max(tolerances, key=tolerances.__getitem__)
    unsteady = [name for name, entry in results.items() if "unsteady" in entry]
    text = f"{len(results)} results, loosest tolerance {tolerances[loosest]:.0e} ({loosest})"
    return f"{text}; not compared: {', '.join(unsteady)}" if unsteady else text


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task", choices=("check", "write", "measure"))
    parser.add_argument("file", nargs="?", type=Path, default=FILE, help="of frozen results")
    parser.add_argument("out", nargs="?", type=Path, help="where 'measure' writes bare results")
    parser.add_argument("--only", default="", help="cases whose names contain this text")
    options = parser.parse_args()
    if options.task == "write":
        _write(options.file, options.only)
        return 0
    given = load(options.file)
    chosen = [case for case in cases() if options.only in case.name]
    if options.task == "measure":
        found = {case.name: measure(case, given[case.name]["states"])[0] for case in chosen}
        _save(options.out, found)
        return 0
    failed = 0
    for case in chosen:
        outcome = compare(case, given[case.name])
        failed += bool(outcome.faults)
        print(outcome, *outcome.faults, sep="\n    ", flush=True)
    print(f"{failed} of {len(chosen)} cases differ")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
