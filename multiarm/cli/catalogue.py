"""Catalogues of what scenes may name, as lists, as cards, and as JSON.

A catalogue has sections, such as joints and surfaces; a section has a card for each name.  What a
card says comes from the class: its picture, its parameters, its example.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from multiarm.cli.files import check_targets, write_json
from multiarm.errors import MultiarmError
from multiarm.scene.parameters import Parameter, example_of, parameters_of, picture_of
from multiarm.terminal.console import columns, facts, output, print_warnings

if TYPE_CHECKING:
    from multiarm.scene.registry import Registry

KindName = Annotated[
    str | None,
    typer.Argument(help="One of them, shown in full.", show_default="all", metavar="[NAME]"),
]


@dataclass(frozen=True)
class Card:
    """What a catalogue says about one name.

    Attributes
    ----------
    name, picture : str
    parameters : list of Parameter
    example : str
        YAML, as in a scene; may be empty.
    count : str
        What the column beside the name shows.
    facts, listed : dict
        What the card, and what the list, says further, by headings.
    table : tuple of title, headings and rows, optional
        What the card shows below its facts.
    key : str
        What the JSON calls the name.
    further : dict
        What the JSON has besides.
    """

    name: str
    picture: str
    parameters: list[Parameter]
    example: str
    count: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    listed: Mapping[str, str] = field(default_factory=dict)
    table: tuple[str, Sequence[str], Sequence[Sequence[str]]] | None = None
    key: str = "name"
    further: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, name: str, kind: Any, parameters: Any) -> Card:
        """The card of a class, with the model of its parameters, which may be the class itself."""
        return cls(name, picture_of(kind), parameters_of(parameters), example_of(kind))

    @classmethod
    def of_key(cls, owner: Any, name: str, example: str) -> Card:
        """The card of one key of a table: its parameters, or the one value that it has."""
        from multiarm.scene.faults import models_in

        (key,) = (parameter for parameter in parameters_of(owner) if parameter.name == name)
        within = [
            parameter
            for model in models_in(owner.model_fields[name].annotation)
            for parameter in parameters_of(model)
        ]
        return cls(
            name,
            key.meaning,
            within or [replace(key, default="required")],
            example,
        )

    def figures(self) -> dict[str, Any]:
        """What is shown, as JSON."""
        parameters = [asdict(parameter) for parameter in self.parameters]
        shown = {"picture": self.picture, "parameters": parameters, "example": self.example}
        return {self.key: self.name, **shown, **self.further}


@dataclass(frozen=True)
class Section:
    """Cards of one sort.

    Attributes
    ----------
    title, noun, plural : str
        Of the list, and for messages.
    cards : dict
        By name.
    faults : list of str
        Why user classes cannot be used.
    heads : tuple of str
        Of the columns: the name, perhaps one beside it, and what it is.
    shared : dict
        Title -> parameters that all of them have, and whether a card shows them too.
    note : str
    """

    title: str
    noun: str
    plural: str
    cards: Mapping[str, Card]
    faults: list[str] = field(default_factory=list)
    heads: tuple[str, ...] = ("kind", "what it is")
    shared: Mapping[str, tuple[list[Parameter], bool]] = field(default_factory=dict)
    note: str = ""

    @classmethod
    def of_kinds(
        cls,
        title: str,
        ours: Mapping[str, Any],
        registry: Registry,
        card: Callable[[str, Any, Any], Card] = Card.of,
        **shown: Any,
    ) -> Section:
        """Our classes of a sort and the users'; ``shown`` are further attributes."""
        user_classes, faults = registry.classes()
        cards = {name: card(name, kind, kind) for name, kind in ours.items()}
        cards |= {
            name: card(name, kind, registry.parameters_of(kind))
            for name, kind in user_classes.items()
        }
        return cls(title, registry.noun, registry.plural, cards, faults, **shown)


def show(
    command: str, sections: Mapping[str, Section], name: str | None, json: Path | None
) -> None:
    """Print a catalogue, one section but the first by its name, or one card; and write the JSON.

    Raises
    ------
    MultiarmError
        Nothing has that name; the message lists similar ones.
    """
    check_targets({"--json": json})
    first, *further = sections
    print_warnings(fault for section in sections.values() for fault in section.faults)
    known = list(sections[first].cards)
    for title in further:
        known += [title, *sections[title].cards]
    if name is not None and name not in known:
        from multiarm.scene.faults import unknown

        noun, plural = sections[first].noun, sections[first].plural
        raise MultiarmError(unknown(noun, name, known, plural, f"multiarm {command}"))
    chosen = {
        key: {kind: card for kind, card in section.cards.items() if name in (None, key, kind)}
        for key, section in sections.items()
    }
    if json is not None:
        figures = {
            key: {kind: card.figures() for kind, card in cards.items()}
            for key, cards in chosen.items()
        }
        write_json(json, figures)
    console = output()
    for key, section in sections.items():
        if name in (None, key):
            _print_list(console, section)
        elif chosen[key]:
            _print_card(console, section, chosen[key][name])
    if name is None:
        hints = (f"multiarm {command} {sections[key].heads[0].upper()}" for key in sections)
        console.print(Text(f"One in full: {', '.join(hints)}", "dim"))


def _print_list(console: Console, section: Section) -> None:
    rows: list[tuple[RenderableType, ...]] = []
    for card in section.cards.values():
        lines = [Text(card.picture)]
        lines += [Text.assemble((f"{k}: ", "cyan"), (v, "dim")) for k, v in card.listed.items()]
        if card.parameters:
            keys = "; ".join(_brief(parameter) for parameter in card.parameters)
            lines.append(Text.assemble(("parameters: ", "cyan"), (keys, "dim")))
        counts = (card.count,) if len(section.heads) == 3 else ()
        rows.append((Text(card.name, "bold"), *counts, Group(*lines, "")))
    console.print(columns(section.title, section.heads, rows))
    if section.note:
        console.print(Text(section.note, "dim"))
    for title, (parameters, _) in section.shared.items():
        console.print(_parameter_table(title, parameters))


def _print_card(console: Console, section: Section, card: Card) -> None:
    console.print(facts(card.name, {"what it is": card.picture, **card.facts}))
    if card.table is not None:
        console.print(columns(*card.table))
    if card.parameters:
        console.print(_parameter_table("Parameters", card.parameters))
    for title, (parameters, with_cards) in section.shared.items():
        if with_cards:
            console.print(_parameter_table(title, parameters))
    if card.example:
        console.print(Text("In a scene", "bold"))
        # Neither wrapped nor filled up, so that the lines can be copied.
        for line in ("", *card.example.splitlines(), ""):
            console.print(Text(f"  {line}".rstrip(), "green"), soft_wrap=True)


def _parameter_table(title: str, parameters: Iterable[Parameter]) -> Table:
    rows = [(p.name, p.default, p.unit, p.meaning) for p in parameters]
    return columns(title, ("name", "default", "unit", "meaning"), rows)


def _brief(parameter: Parameter) -> str:
    """``size 0.1 m``; without a default only the name and, in brackets, the unit."""
    name, default, unit = parameter.name, parameter.default, parameter.unit
    if default in ("required", "none"):
        return f"{name} [{unit}]" if unit else name
    return f"{name} {default} {unit}".rstrip()
