"""``multiarm joints``: the catalogue of joints and surfaces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from multiarm.cli.files import check_targets, write_json
from multiarm.errors import MultiarmError
from multiarm.terminal.console import columns, facts, output, print_warnings

if TYPE_CHECKING:
    from multiarm.cli.joint_cards import JointCard, SurfaceCard
    from multiarm.cli.parameters import Parameter

__all__ = ["joints"]

SURFACES = "surfaces"


def joints(
    kind: Annotated[
        str | None,
        typer.Argument(
            help="One kind of joint or surface, shown in full; or 'surfaces'.",
            show_default="all kinds",
            metavar="[KIND]",
        ),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option(help="Write what is shown as JSON.", show_default="none", metavar="FILE.json"),
    ] = None,
) -> None:
    """List the joints between an arm and the object with their free motions and parameters.

    A joint is a set of frictionless contacts, each of which takes away one motion; rows are their
    number. Names of kinds are those of 'kind:' in a scene.

    The JSON has the keys joints, surfaces: each a table by name, with what is shown here.
    """
    check_targets({"--json": json})
    from multiarm.cli import joint_cards as cards

    (joint_cards, faults), (surface_cards, further) = cards.joint_cards(), cards.surface_cards()
    print_warnings([*faults, *further])
    known = [*joint_cards, SURFACES, *surface_cards]
    if kind is not None and kind not in known:
        from multiarm.scene.faults import unknown

        text = unknown("joint kind", kind, known, "kinds")
        raise MultiarmError(f"{text}; 'multiarm joints' shows them all")
    chosen = {name: card for name, card in joint_cards.items() if kind in (None, name)}
    surfaces = {n: card for n, card in surface_cards.items() if kind in (None, SURFACES, n)}
    if json is not None:
        write_json(
            json,
            {
                "joints": {name: asdict(card) for name, card in chosen.items()},
                "surfaces": {name: asdict(card) for name, card in surfaces.items()},
            },
        )
    console = output()
    for part in _parts(kind, chosen, surfaces):
        console.print(part)


def _parts(
    kind: str | None, joints: dict[str, JointCard], surfaces: dict[str, SurfaceCard]
) -> list[RenderableType]:
    """What is shown: everything, one joint, all surfaces, or one surface."""
    from multiarm.cli.joint_cards import common_parameters, contact_parameters

    common = _parameter_table("Parameters of every joint", common_parameters())
    options = [p for p in contact_parameters() if p.name not in ("arm", "object")]
    contact = _parameter_table("Parameters of a contact, besides its two sides", options)
    if kind is None:
        axes = Text("x, y, z: axes of the joint frame, turned until z is the axis or normal", "dim")
        hint = Text("One in full: multiarm joints KIND, multiarm joints SURFACE", "dim")
        return [_joint_listing(joints), axes, common, _surface_listing(surfaces), contact, hint]
    if kind == SURFACES:
        return [_surface_listing(surfaces), contact]
    if kind in surfaces:
        return _one_surface(surfaces[kind])
    return [*_one_joint(joints[kind]), common, *_example(joints[kind].example)]


def _joint_listing(cards: dict[str, JointCard]) -> Table:
    rows = []
    for card in cards.values():
        lines = [Text(card.picture)]
        if not card.as_listed:
            lines.append(_line("free", _motions(card, "nothing")))
            lines.append(_line("made of", card.made_of))
        if card.parameters:
            lines.append(_line("parameters", "; ".join(_brief(p) for p in card.parameters)))
        count = "any" if card.as_listed else str(card.rows or "")
        rows.append((Text(card.kind, "bold"), count, Group(*lines, "")))
    return columns("Joints", ("kind", "rows", "what it is"), rows)


def _surface_listing(cards: dict[str, SurfaceCard]) -> Table:
    rows = []
    for card in cards.values():
        lines = [Text(card.picture), Text(card.example, "green")]
        if card.parameters:
            lines.append(_line("parameters", "; ".join(_brief(p) for p in card.parameters)))
        rows.append((Text(card.name, "bold"), Group(*lines, "")))
    return columns("Surfaces for joints of kind 'contacts'", ("surface", "what it is"), rows)


def _one_joint(card: JointCard) -> list[RenderableType]:
    here = "; those of the example" if card.as_listed else ""
    about: dict[str, RenderableType] = {
        "what it is": card.picture,
        "rows": f"{card.rows}, rank {card.rank}{here}" if card.rank else str(card.rows or ""),
        "free motions": _motions(card, "none"),
        "made of": card.made_of,
        "names of the rows": ", ".join(card.row_names),
    }
    parts: list[RenderableType] = [facts(card.kind, about)]
    if card.parameters:
        parts.append(_parameter_table("Parameters", card.parameters))
    return parts


def _motions(card: JointCard, none: str) -> str:
    if card.free is None:
        return "depend on the scene, see multiarm check"
    return ", ".join(card.free) or none


def _one_surface(card: SurfaceCard) -> list[RenderableType]:
    parts: list[RenderableType] = [facts(card.name, {"what it is": card.picture})]
    if card.parameters:
        parts.append(_parameter_table("Parameters", card.parameters))
    return [*parts, *_example(card.example)]


def _example(text: str) -> list[RenderableType]:
    return [Text("In a scene", "bold"), Padding(Text(text, "green"), (1, 2))]


def _parameter_table(title: str, parameters: Iterable[Parameter]) -> Table:
    rows = [(p.name, p.default, p.unit, p.meaning) for p in parameters]
    return columns(title, ("name", "default", "unit", "meaning"), rows)


def _line(name: str, text: str) -> Text:
    return Text.assemble((f"{name}: ", "cyan"), (text, "dim"))


def _brief(parameter: Parameter) -> str:
    """``size 0.1 m``; without a default only the name and, in brackets, the unit."""
    name, default, unit = parameter.name, parameter.default, parameter.unit
    if default in ("required", "none"):
        return f"{name} [{unit}]" if unit else name
    return f"{name} {default} {unit}".rstrip()
