"""A certificate in words: why there were no more runs, and what it means for the user."""

from __future__ import annotations

from typing import Any

from multiarm.scene import AccuracySpec
from multiarm.simulation.certificate.verdict import SAFETY, Finding, unchecked

GROWTH, EXHAUSTED, ATTEMPTS, CHECK = "growth", "rounding", "attempts", "check"
FAILED_RERUN, INTERRUPTED, MEMORY = "failed rerun", "interrupted", "memory"

UNDETERMINED_WORDS = (
    "the equations determine none of the forces asked for; ask for position or rotation"
)
INTERRUPTED_WORDS = "the check of its accuracy was interrupted, so that there is no certificate"
REMEDY = "ask for less accuracy, or simulate a shorter time"
ROUNDING_WORDS = f"smaller tolerances do not help any more, what is left is rounding: {REMEDY}"


def memory_words(function: str) -> str:
    """What it means for a run that a function of the user's remembers."""
    return (
        f"{function} answers otherwise when it is asked again for the same time and state, so that "
        f"a rerun would not be the same motion; simulate with `certificate=False`"
    )


def growth_words(rate: float) -> str:
    """What exponential growth of errors means for a run."""
    return (
        f"errors grow about e^({rate:.2g} t) in this motion, whatever the tolerance: simulate a "
        f"shorter time, ask for less accuracy, or add damping"
    )


def failed_words(message: str) -> str:
    """Why a run could not be checked whose rerun failed with this message."""
    return f"the tightened rerun that checks it failed {message}"


def certificate(
    finding: Finding | None,
    accuracy: AccuracySpec,
    reason: str,
    words: str,
    rows: list[dict[str, Any]],
) -> dict[str, Any]:
    """The certificate as it is stored."""
    if finding is None:
        found = unchecked(accuracy)
        text = f"not met, as far as is known: {words}"
    else:
        found, verdict = finding.as_dict(), "met" if finding.met else "not met"
        parts = [f"{verdict}: {finding.numbers()}", *finding.faults, words]
        if finding.undetermined:
            names = ", ".join(finding.undetermined)
            parts.append(f"forces that the equations leave open were not judged ({names})")
        text = "; ".join(part for part in parts if part)
    return {**found, "text": text, "reason": reason or "met", "safety": SAFETY, "attempts": rows}
