"""What comes and goes in a scene: its units, and the rows that they have.

A *unit* is a contact that can let go (with its two tangents, if it has friction; or a compliant
one), a joint at the end of its range, or a joint with dry friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from multiarm.contacts.records import Contact, JointRow
from multiarm.dynamics.state import Layout

CONTACT, LIMIT, DRY_JOINT = "contact", "limit", "joint friction"
SURROUNDINGS = "floor"
"""Who owns the contacts of the object with its surroundings."""


@dataclass(frozen=True)
class Law:
    """How a contact behaves when it may let go.

    Attributes
    ----------
    mu : float or None
        Coefficient of friction; None: it has no tangents.
    restitution : float
        Newton's, between 0 and 1.
    stiffness, damping : float
        Of a contact that gives way and is no constraint [N/m, N s/m]; stiffness 0: it is one.
    """

    mu: float | None = None
    restitution: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0


@dataclass(frozen=True)
class Unit:
    """One thing that comes and goes.

    Attributes
    ----------
    kind : str
        ``CONTACT``, ``LIMIT`` or ``DRY_JOINT``.
    arm, name : str
    row : int
        Its (normal) row among the candidates.
    tangents : tuple of int
        Rows of the two tangents; empty without friction.
    mu, restitution : float
    bound : float
        Largest torque of dry friction [N m] or force [N].
    joint : int
        Of limits and dry joints: place in the stacked vectors; else -1.
    soft : bool
        The contact is a spring that only pushes, and its row is never held.
    """

    kind: str
    arm: str
    name: str
    row: int
    tangents: tuple[int, ...] = ()
    mu: float = 0.0
    restitution: float = 0.0
    bound: float = 0.0
    joint: int = -1
    soft: bool = False


@dataclass(frozen=True)
class JointLaw:
    """What a joint does at the ends of its range, and at rest.

    Attributes
    ----------
    lower, upper : float or None
        Ends of the range [rad, m].
    restitution : float
        At these ends.
    friction : float or None
        Dry friction [N m, N].
    """

    lower: float | None = None
    upper: float | None = None
    restitution: float = 0.0
    friction: float | None = None


@dataclass(frozen=True)
class Candidates:
    """The rows of a scene whose contacts come and go.

    Attributes
    ----------
    records : mapping owner -> list
        Contacts and joint rows of every arm, and of the surroundings.
    laws : mapping owner -> list
        What each record is: a ``Law`` (normal row), the number of the tangent, a ``JointLaw``, or
        None for rows that are always held.
    """

    records: dict[str, list[Contact | JointRow]]
    laws: dict[str, list[Law | JointLaw | int | None]]


def candidates(
    contacts: Mapping[str, list[Contact]],
    laws: Mapping[str, Mapping[int, Law]],
    joints: Mapping[str, Mapping[int, tuple[str, JointLaw]]],
    surroundings: list[tuple[Contact, Law]],
) -> Candidates:
    """Spread contacts and joints out to rows.

    Parameters
    ----------
    contacts : mapping arm -> list of Contact
    laws : mapping arm -> number of the contact -> Law
        Contacts that are not named are always held.
    joints : mapping arm -> number of the joint -> name and law
    surroundings : list
        Contacts of the object with what stands around it.
    """
    found = Candidates({}, {})
    for arm, own in contacts.items():
        rows, kinds = found.records.setdefault(arm, []), found.laws.setdefault(arm, [])
        for k, contact in enumerate(own):
            _add_contact(contact, laws.get(arm, {}).get(k), rows, kinds)
        for number, (name, law) in joints.get(arm, {}).items():
            _add_joint(number, name, law, rows, kinds)
    rows, kinds = (
        found.records.setdefault(SURROUNDINGS, []),
        found.laws.setdefault(SURROUNDINGS, []),
    )
    for contact, contact_law in surroundings:
        _add_contact(contact, contact_law, rows, kinds)
    return found


def _add_contact(contact: Contact, law: Law | None, rows: list, kinds: list) -> None:
    rows.append(contact)
    kinds.append(law)
    if law is None or law.mu is None:
        return
    for tangent in (1, 2):
        name = f"{contact.name}, friction {tangent}"
        rows.append(replace(contact, name=name, tangent=tangent, pushes_only=False))
        kinds.append(tangent)


def _add_joint(number: int, name: str, law: JointLaw, rows: list, kinds: list) -> None:
    if law.lower is not None:
        rows.append(JointRow(f"{name} at its lower limit", number, 1.0, law.lower))
        kinds.append(replace(law, friction=None))
    if law.upper is not None:
        rows.append(JointRow(f"{name} at its upper limit", number, -1.0, law.upper))
        kinds.append(replace(law, friction=None))
    if law.friction is not None:
        rows.append(JointRow(f"{name}, dry friction", number))
        kinds.append(JointLaw(friction=law.friction))


def make_units(found: Candidates, layout: Layout) -> tuple[Unit, ...]:
    """The units of a scene, in the order of their rows."""
    units = []
    for i, (owner, kinds) in enumerate(found.laws.items()):
        for k, law in enumerate(kinds):
            row, record = layout.rows[i] + k, found.records[owner][k]
            if isinstance(law, Law) and law.stiffness > 0.0:
                if record.pushes_only:  # a spring that also pulls acts at all times
                    units.append(Unit(CONTACT, owner, record.name, row, soft=True))
            elif isinstance(law, Law):
                tangents = () if law.mu is None else (row + 1, row + 2)
                units.append(
                    Unit(CONTACT, owner, record.name, row, tangents, law.mu or 0.0, law.restitution)
                )
            elif isinstance(law, JointLaw):
                assert isinstance(record, JointRow)
                joint = layout.dofs[i] + record.joint
                kind = LIMIT if law.friction is None else DRY_JOINT
                units.append(
                    Unit(
                        kind, owner, record.name, row, joint=joint,
                        restitution=law.restitution, bound=law.friction or 0.0,
                    )
                )  # fmt: skip
    return tuple(units)


def model_rows(
    found: Candidates, contacts: Mapping[str, list[Contact]], layout: Layout
) -> list[int]:
    """Rows of the scene without effects: every contact of the arms' joints, held both ways."""
    rows = []
    for i, arm in enumerate(contacts):
        for k, law in enumerate(found.laws[arm]):
            if law is None or isinstance(law, Law):
                rows.append(layout.rows[i] + k)
    return rows


def bare_rows(found: Candidates, layout: Layout) -> list[int]:
    """Rows that are held at all times."""
    return [
        layout.rows[i] + k
        for i, kinds in enumerate(found.laws.values())
        for k, law in enumerate(kinds)
        if law is None
    ]
