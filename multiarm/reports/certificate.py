"""The certificate in a report: the verdict first, then the numbers it rests on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from multiarm import plots
from multiarm.reports.parts import NOTHING, grid, inline_svg, number, quantity, words
from multiarm.results.event_log import Event

KINDS = {
    "position_m": ("Position", "m"),
    "rotation_rad": ("Rotation", "rad"),
    "force_N": ("Contact force", "N"),
}
CHECKS = {
    "energy": "Energy and work in balance",
    "residual": "Equations solved, relative",
    "drift": "Contacts closed",
}


def certificate_section(certificate: Mapping[str, Any] | None, events: Sequence[Event] = ()) -> str:
    """The section of a report; its figure shows the run's events. Empty if nothing was checked."""
    if certificate is None:
        return ""
    if not {"met", "text", "asked", "estimated_error"} <= certificate.keys():
        return _foreign(certificate)
    tone = "completed" if certificate.get("met") else "interrupted"
    verdict = "Accuracy met" if certificate.get("met") else "Accuracy not met"
    text = str(certificate.get("text", "")).partition(": ")[2]
    parts = [
        f"<div class='verdict {tone}'><p class='status'><span>{verdict}</span></p>"
        f"<p class='message'>{escape(text)}</p></div>",
        _asked_and_estimated(certificate),
        _course(certificate, events),
        _outputs(certificate),
        _checks(certificate),
        _attempts(certificate),
        f"<p class='note'>{escape(_meaning(certificate))}</p>",
    ]
    return f"<section class='certificate'><h2>Certificate</h2>{''.join(parts)}</section>\n"


def _foreign(certificate: Mapping[str, Any]) -> str:
    """What another program wrote as a certificate, as it is."""
    rows = [(words(str(key)), number(value)) for key, value in certificate.items()]
    return f"<section><h2>Certificate</h2>{grid(('', ''), rows)}</section>\n"


def _meaning(certificate: Mapping[str, Any]) -> str:
    return (
        "Errors are estimates: the differences to a rerun with smaller tolerances, times "
        f"{number(certificate.get('safety'))}, at the worst output time."
    )


def _asked_and_estimated(certificate: Mapping[str, Any]) -> str:
    asked, found = certificate["asked"], certificate["estimated_error"]
    rows = [
        (name, quantity(asked[kind], unit), quantity(found[kind], unit), _mark(asked, found, kind))
        for kind, (name, unit) in KINDS.items()
        if asked[kind] is not None or found[kind] is not None
    ]
    return grid(("", "asked", "estimated error", ""), rows)


def _mark(asked: Mapping[str, Any], found: Mapping[str, Any], kind: str) -> str:
    if asked[kind] is None:
        return "not asked"
    if found[kind] is None:
        return "not judged"
    return "met" if found[kind] <= asked[kind] else "not met"


def _outputs(certificate: Mapping[str, Any]) -> str:
    rows = []
    for name, output in certificate["by_output"].items():
        left = output.get("samples_left_out")
        note = f"forces left open by the equations at {number(left)} samples" if left else ""
        when = quantity(output.get("time"), "s") if output["error"] is not None else NOTHING
        rows.append((name, quantity(output["error"], output["unit"]), when, note))
    return grid(("By output", "estimated error", "worst at", ""), rows)


def _checks(certificate: Mapping[str, Any]) -> str:
    rows = []
    for name, check in certificate["checks"].items():
        unit = "" if check["unit"] == "1" else check["unit"]
        value, bound = (quantity(check[key], unit) if unit else number(check[key])
                        for key in ("value", "bound"))  # fmt: skip
        rows.append((CHECKS.get(name, name), value, bound, "yes" if check["passed"] else "no"))
    return grid(("The run on its own", "largest", "bound", "passed"), rows)


def _attempts(certificate: Mapping[str, Any]) -> str:
    rows = []
    for place, row in enumerate(certificate["attempts"], start=1):
        errors = [
            quantity(row[kind], unit) for kind, (_, unit) in KINDS.items() if row[kind] is not None
        ]
        rows.append(
            (
                f"{place}{' (this result)' if row.get('returned') else ''}",
                str(row["integrator"]),
                number(row["tolerance"]),
                number(row["evaluations"]),
                quantity(row["wall_time_s"], "s"),
                ", ".join(errors) or NOTHING,
            )
        )
    heads = ("Runs", "method", "tolerance of a step", "evaluations", "wall time", "estimated error")
    return grid(heads, rows)


def _course(certificate: Mapping[str, Any], events: Sequence[Event]) -> str:
    if not certificate["over_time"]["time"]:
        return ""
    svg = inline_svg(plots.accuracy_course(certificate, events), "accuracy-")
    return (
        f"<figure>{svg}<figcaption>Estimated error over time, and what was asked (dashed)."
        f"{_growth(certificate)}</figcaption></figure>"
    )


def _growth(certificate: Mapping[str, Any]) -> str:
    rate = certificate["growth_rate_per_s"]
    return "" if rate is None else f" Errors grow about e<sup>{rate:.2g} t</sup>, t in s."
