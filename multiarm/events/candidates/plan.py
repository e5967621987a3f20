"""What a compiled scene knows of its contacts that come and go, before any run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from multiarm.contacts.records import Contact
from multiarm.dynamics.state import Layout
from multiarm.events.candidates.springs import Springs, make_springs
from multiarm.events.candidates.units import (
    CONTACT,
    Candidates,
    Unit,
    bare_rows,
    make_units,
    model_rows,
)

if TYPE_CHECKING:
    from multiarm.scene import Scene


@dataclass(frozen=True, eq=False)
class Plan:
    """The units of a scene, and which rows are held without them.

    Attributes
    ----------
    units : tuple of Unit
    model : tuple of int
        Rows of the scene without effects, with which controllers reckon.
    assembled : tuple of int
        Rows on which the start is assembled: those of the model that begin closed.
    bare : tuple of int
        Rows that are held at all times.
    springs : Springs or None
        Contacts that give way.
    """

    units: tuple[Unit, ...]
    model: tuple[int, ...]
    assembled: tuple[int, ...]
    bare: tuple[int, ...]
    springs: Springs | None = None

    @property
    def contacts(self) -> tuple[Unit, ...]:
        """The contacts among the units."""
        return tuple(unit for unit in self.units if unit.kind == CONTACT)

    def contacts_of(self, owner: str) -> tuple[str, ...]:
        """Names of the contacts of an arm that come and go."""
        return tuple(unit.name for unit in self.contacts if unit.arm == owner)


def make_plan(
    scene: Scene, found: Candidates, contacts: Mapping[str, list[Contact]], layout: Layout
) -> Plan:
    """The plan of a scene with these candidates; ``contacts`` are those of its joints."""
    units = make_units(found, layout)
    model, bare = model_rows(found, contacts, layout), bare_rows(found, layout)
    apart = scene.effects.unilateral_contacts
    as_written = apart is not None and apart.start == "as_written"
    return Plan(
        units=units,
        model=tuple(model),
        assembled=tuple(bare if as_written else model),
        bare=tuple(bare),
        springs=make_springs(found, layout),
    )
