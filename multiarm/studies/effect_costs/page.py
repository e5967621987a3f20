"""The ledger as one self-contained HTML page: what it says, the figure, the numbers, the scene."""

from __future__ import annotations

from html import escape
from pathlib import Path

from multiarm.reports.parts import CSS, NOTHING, inline_svg, quantity
from multiarm.results.files import save_page
from multiarm.studies.effect_costs.entries import QUANTITIES, Entry, Ledger
from multiarm.studies.effect_costs.plots import ledger_figure
from multiarm.studies.effect_costs.variants import CANDIDATE, PRESENT, SETTING
from multiarm.studies.effect_costs.words import (
    accuracy_text,
    percent,
    said,
    sentence,
    verdict,
)

_CSS = """
main { max-width: 78rem; }
td, th { padding-right: 1.2rem; }
td:last-child, th:last-child { padding-right: 0; }
thead th { font-size: 0.8rem; font-weight: 500; vertical-align: bottom; }
thead th.n, td.n { text-align: right; white-space: nowrap; }
td.t { text-align: left; font-size: 0.85rem; }
td.noise { opacity: 0.55; }
td.small { opacity: 0.55; }
td.good { color: var(--good); } td.bad { color: var(--bad); }
td small { color: var(--soft); }
ul.said { list-style: none; padding: 0; margin: 0 0 0.6rem; max-width: 60rem; }
ul.said li { font-size: 1.08rem; line-height: 1.5; }
ul.said li.good { color: var(--good); } ul.said li.bad { color: var(--bad); }
.scroll { overflow-x: auto; }
"""
_HEADS = {
    PRESENT: "Effects of the scene: what each costs and changes",
    CANDIDATE: "Effects that it might have: what each would cost and change",
    SETTING: "How it is run",
}


def write_page(found: Ledger, path: Path) -> None:
    """Write the page, complete or not at all.

    Raises
    ------
    MultiarmError
        The file cannot be written.
    """
    save_page(render(found), path)


def render(found: Ledger) -> str:
    """The page as text."""
    name = escape(found.scene["name"])
    tables = "".join(_table(found, kind) for kind in _HEADS)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name} · multiarm effects</title>\n<style>{CSS}{_CSS}</style>\n</head>\n"
        f"<body>\n<main>\n{_header(found)}{_diagram(found)}{tables}{_scene(found)}"
        f"{_footer(found)}</main>\n</body>\n</html>\n"
    )


def _header(found: Ledger) -> str:
    about = found.machine
    libraries = ", ".join(f"{key} {value}" for key, value in about["dependencies"].items())
    effects = [entry for entry in found.entries if entry.kind != SETTING]
    lines = "".join(
        f"<li class='{_tone(found, entry)}'>{escape(sentence(found, entry))}</li>"
        for entry in effects
    )
    said_so = lines or "<li>No effects: nothing is added, and nothing can be left out.</li>"
    return (
        "<header><p class='kicker'>multiarm · what effects cost and change</p>"
        f"<h1>{escape(found.scene['name'])}</h1><ul class='said'>{said_so}</ul>"
        f"<p class='message'>{escape(accuracy_text(found))}\n"
        f"{escape(found.run['certificate'])}\n"
        f"{escape(str(about['processor']))}, {escape(str(about['platform']))}\n"
        f"multiarm {escape(about['version'])}, Python {escape(about['python'])}, "
        f"{escape(libraries)}</p></header>\n"
    )


def _diagram(found: Ledger) -> str:
    if not any(entry.share is not None and entry.changes for entry in found.entries):
        return ""
    drawn = inline_svg(ledger_figure(found, on_page=True), "ledger-")
    return (
        f"<section><h2>Costs and changes</h2><figure>{drawn}<figcaption>Left: time, with its "
        "uncertainty. Right: the largest changes, in units of the accuracy that is asked for; what "
        "lies in the shaded part cannot be told from the errors of the runs.</figcaption></figure>"
        "</section>\n"
    )


def _table(found: Ledger, kind: str) -> str:
    entries = found.of_kind(kind)
    if not entries:
        return ""
    numbers = ("ms per s", "% of the time", "evaluations")
    heads = [*numbers, *(what for what, _ in QUANTITIES.values())]
    head = "".join(f"<th class='n'>{escape(text)}</th>" for text in heads)
    rows = "".join(_row(found, entry, len(heads)) for entry in entries)
    return (
        f"<section class='scroll'><h2>{_HEADS[kind]}</h2><table><thead><tr><th></th>{head}"
        f"<th></th></tr></thead><tbody>{rows}</tbody></table></section>\n"
    )


def _row(found: Ledger, entry: Entry, width: int) -> str:
    head = f"<tr><th scope='row'>{escape(entry.name)}</th>"
    last = f"<td class='t {_tone(found, entry)}'>{escape(verdict(found, entry))}"
    if entry.kind == CANDIDATE:
        last += f"<br><small>{escape(entry.about)}</small>"
    last += "</td></tr>"
    if entry.share is None or entry.milliseconds is None:
        return f"{head}{f'<td class=n>{NOTHING}</td>' * width}{last}"
    tone = " noise" if entry.share.within_noise else ""
    costs = (
        f"<td class='n{tone}'>{entry.milliseconds.value:.2g}</td>"
        f"<td class='n{tone}'>{percent(entry.share)}</td><td class='n'>{entry.evaluations:,}</td>"
    )
    return f"{head}{costs}{''.join(_change(found, entry, name) for name in QUANTITIES)}{last}"


def _change(found: Ledger, entry: Entry, name: str) -> str:
    change = entry.changes.get(name)
    if change is None:
        return f"<td class='n'>{NOTHING}</td>"
    tone = "" if change.value > found.asked[name] else " small"
    where = f"{change.arm}, " if change.arm else ""
    return (
        f"<td class='n{tone}'>{said(change, name)}<br><small>{escape(where)}"
        f"at {change.time:.3g} s</small></td>"
    )


def _tone(found: Ledger, entry: Entry) -> str:
    if entry.trouble:
        return "bad"
    return "good" if found.can_go(entry) else ""


def _scene(found: Ledger) -> str:
    return (
        "<section><details><summary>The scene</summary>"
        f"<pre>{escape(found.scene['text'])}</pre></details></section>\n"
    )


def _footer(found: Ledger) -> str:
    when = escape(str(found.machine["created_utc"]))
    return (
        "<footer><h2>How to read it</h2><p>The scene is run once more without each of its effects. "
        "All runs are made to the accuracy that the scene asks for, and checked where it names "
        "one; a change is the largest difference of two such runs at an output time. Times are "
        "the processor's, of runs in turn on one thread; ± is twice the standard error, and what "
        "is pale lies within it. Leaving gravity out also leaves out what the control does about "
        "it.</p>"
        f"<p>Measured in {quantity(found.wall_time_s, 's')}, {when}.</p></footer>\n"
    )
