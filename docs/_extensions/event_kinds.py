"""The table of all kinds of events and their meanings."""

from pathlib import Path

FILE = Path(__file__).parents[2] / "docs" / "reference" / "generated" / "events.txt"


def _write():
    from multiarm.results.event_kinds import FAMILIES, EventKind

    kinds = sorted(EventKind, key=lambda kind: FAMILIES.index(kind.family))
    lines = ["| | kind | what happened |", "|---|---|---|"]
    lines += [f"| {kind.family.sign} | `{kind.word}` | {kind.meaning} |" for kind in kinds]
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")


def setup(app):
    """Write the table before any page is read."""
    _write()
    return {"parallel_read_safe": True}
