"""A study as text: recommendation, settings and reference; and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from multiarm.studies.work_precision.choice import CLAIMED, Decade, decades, wall_time
from multiarm.studies.work_precision.points import Point
from multiarm.studies.work_precision.reference import QUANTITIES
from multiarm.studies.work_precision.settings import BY_ACCURACY, short
from multiarm.studies.work_precision.store import Results

FARTHER = 1e-3
"""The second level of the recommendation, as a fraction of the first."""


def recommendation(results: Results, quantity: str = "motion") -> str:
    """The study in a sentence: what to take, what it costs, and what more would cost."""
    target = results.about["scene"]["accuracy"][quantity]
    found = decades(results, quantity)
    reached = [decade for decade in found if decade.ours is not None]
    if not reached:
        return "No setting reached an error of 0.1: nothing can be recommended for this scene."
    first = _at(reached, target)
    if first is None:
        first = reached[-1]
        apology = f"No setting reached {short(target)}. "
    else:
        apology = ""
    taken = first.ours
    assert taken is not None, "only levels that we reach are looked at"
    duration = results.about["scene"]["duration_s"]
    text = (
        f"{apology}For errors below {short(first.level)}{_of(quantity)} take {described(taken)}: "
        f"{1e3 * wall_time(taken):.3g} ms for {duration:g} s of motion"
    )
    second = _at(reached, FARTHER * first.level) or reached[-1]
    if second.level >= first.level or second.ours is None:
        return f"{text}."
    times = wall_time(second.ours) / wall_time(taken)
    return f"{text}; {short(second.level)} costs {times:.2g} times that."


def comparison(results: Results, quantity: str = "motion") -> str:
    """How the best peer fares at two levels, in a sentence; empty where there is none."""
    parts = [
        f"{decade.ratio:.2g} times our time to reach {short(decade.level)} "
        f"({decade.peer.setting.text})"
        for decade in decades(results, quantity)
        if decade.level in CLAIMED and decade.ratio is not None and decade.peer is not None
    ]
    return f"The best peer takes {', and '.join(parts)}." if parts else ""


def described(point: Point) -> str:
    """A setting as a piece of advice: ``accuracy 1e-5 (dop853, projection)``."""
    setting = point.setting
    if not setting.ours:
        return f"{setting.knob_text} ({setting.solver}, {setting.method})"
    chosen = setting.method == BY_ACCURACY
    kind = "projection" if chosen else setting.stabilization
    about = [point.used if chosen else setting.method]
    if kind:
        about.append("no stabilization" if kind == "none" else kind)
    return f"{setting.knob_text} ({', '.join(about)})"


def reference_text(results: Results) -> str:
    """The reference and its digits, in words."""
    assert results.reference is not None, "a study begins with its reference"
    about, digits = results.reference["about"], results.reference["digits"]
    check, scene = about["check"], results.about["scene"]
    known = ", ".join(
        f"{QUANTITIES[name][0]} {value:.1g} {QUANTITIES[name][1].split(',')[0]}"
        for name, value in digits.items()
        if name != "motion"
    )
    times = f"{scene['duration_s']:g} s, looked at every {scene['output_step_s']:g} s. "
    if results.reference["first"]:
        return (
            f"{times}First reference: {about['integrator']} at accuracy {about['accuracy']:g}, "
            f"from which accuracy {check['accuracy']:g} differs by: {known}. Errors below that are "
            "not ranked. A checked reference will replace it."
        )
    return (
        f"{times}Reference: {about['integrator']} at {about['tolerance']:g}; checked by the "
        f"{check['solver']} solver with {check['integrator']} at {check['tolerance']:g}, which "
        f"differs by: {known}. Errors below that are not ranked."
    )


def state_text(results: Results) -> str:
    """How far the study is, and what it leaves out; empty when all is measured."""
    if results.planned is not None:
        return f"{len(results.points)} of {results.planned} points measured."
    return "Dominated settings are left out; --thorough measures them." if results.left_out else ""


def figures(results: Results, quantity: str = "motion") -> dict[str, Any]:
    """All figures of a study, under the keys that ``multiarm accuracy --help`` lists."""
    kept = {
        key: value for key, value in results.as_dict().items() if key not in ("format", "planned")
    }
    cheapest = [
        {
            "level": decade.level,
            "ours": None if decade.ours is None else decade.ours.setting.key,
            "peer": None if decade.peer is None else decade.peer.setting.key,
            "peer_over_ours": decade.ratio,
        }
        for decade in decades(results, quantity)
    ]
    advice = recommendation(results, quantity)
    return {**kept, "cheapest": cheapest, "recommendation": advice}


def _at(found: Sequence[Decade], level: float) -> Decade | None:
    """The coarsest decade that is at least as fine as a level."""
    fine = [decade for decade in found if decade.level <= level * (1.0 + 1e-9)]
    return fine[0] if fine else None


def _of(quantity: str) -> str:
    return " N" if quantity == "force" else ""
