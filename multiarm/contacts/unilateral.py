"""Constraints of a scene that come and go: contacts that open, joint stops, dry friction, joints.

A *unilateral constraint* is active at some times only: a contact that can only push (with its two
tangents, if it has friction), a joint at an end of its range, a joint that dry friction holds at
rest.  A contact that holds both ways and has friction is one of them too, of which the tangents
alone come and go.  Compliant contacts are springs and dampers: their rows are measured, never
active.  A *timed joint* holds for some of the time: its rows are active while it does, and its
contacts are unilateral constraints only then.  All other rows are *bilateral*.
:mod:`multiarm.assembly.contact_effects` derives the constraints from a scene;
:mod:`multiarm.events` decides which are active at a time.

Rows are in the order of the stacked vectors: block by block and owner by owner the contacts of its
connections, each followed by its tangents, and the rows of its joints; last the contacts of the
object with the floor.
"""

from __future__ import annotations

from collections.abc import Iterable, Set
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from multiarm.contacts.table import JointRow, Record, WheelRow
from multiarm.geometry.records import Contact
from multiarm.scene.joints.times import Interval, Moment, When
from multiarm.scene.values import of_surroundings

CONTACT, LIMIT, DRY_JOINT = "contact", "limit", "joint friction"


@dataclass(frozen=True)
class Constraint:
    """One unilateral constraint.

    Attributes
    ----------
    kind : str
        ``CONTACT``, ``LIMIT`` or ``DRY_JOINT``.
    owner, name : str
        Of a contact the owner of its row, of a joint its robot.
    row : int
        Its (normal) row.
    tangents : tuple of int
        Rows of the two tangents; empty without friction.
    mu, restitution : float
        Coefficients of friction and of Newton's restitution.
    bilateral : bool
        The contact also pulls and never opens; its friction is bounded by the magnitude of its
        normal force.
    bound : float
        Largest torque of dry friction [N m] or force [N].
    joint : int
        Of limits and dry joints: index in the stacked vectors; else -1.
    compliant : bool
        The contact is a spring that only pushes; its row is never active.
    lag : float
        Of compliant contacts: damping over stiffness [s].
    """

    kind: str
    owner: str
    name: str
    row: int
    tangents: tuple[int, ...] = ()
    mu: float = 0.0
    restitution: float = 0.0
    bilateral: bool = False
    bound: float = 0.0
    joint: int = -1
    compliant: bool = False
    lag: float = 0.0


@dataclass(frozen=True, eq=False)
class TimedJoint:
    """A joint that holds for some of the time.

    Attributes
    ----------
    connection : str
    rows : tuple of int
        Those that are active while it holds.
    constraints : tuple of int
        Numbers of its contacts that can open or slide, which they do only while it holds.
    intervals : tuple of Interval
        When it holds.
    located : bool
        It holds its bodies where they are when it takes hold; else only where its frames coincide.
    offset : ndarray, shape (4, 4)
        Its frame on the second body, in that on the first, where it takes hold.
    axes : ndarray, shape (3, 3)
        Axes of its frame, z its axis or normal, in that of ``at``.
    speed_limit : float
        Of its frames against each other where it takes hold [m/s].
    """

    connection: str
    rows: tuple[int, ...]
    constraints: tuple[int, ...]
    intervals: tuple[Interval, ...]
    located: bool
    offset: np.ndarray
    axes: np.ndarray
    speed_limit: float

    @property
    def moments(self) -> tuple[Moment, ...]:
        """Beginnings and ends of its intervals in turn."""
        return tuple(moment for interval in self.intervals for moment in interval)

    def interval_at(self, t: float) -> Interval | None:
        """The interval that a time [s] belongs to, as far as times say."""
        return next((interval for interval in self.intervals if interval.has(t)), None)


@dataclass(frozen=True, eq=False)
class CompliantContacts:
    """Contacts that are springs and dampers.

    Attributes
    ----------
    rows : int64 (s,)
        Their rows.
    stiffness, damping : ndarray, shape (s,)
        [N/m, N s/m]
    always : int64 (s,)
        1 for those that also pull; the others act while they are compressed.
    """

    rows: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    always: np.ndarray

    def number(self, row: int) -> int:
        """Number of the contact in a row."""
        return int(np.searchsorted(self.rows, row))


@dataclass(frozen=True, eq=False)
class UnilateralConstraints:
    """All rows of a scene, and its unilateral constraints.

    Attributes
    ----------
    records : mapping owner -> list
        Contacts and joint rows of every connection and robot, and of the surroundings: all rows.
    constraints : tuple of Constraint
        In the order of their rows.
    model : tuple of int
        Rows of the scene without effects.
    of_laws : tuple of int
        Rows that control laws see: those of the model, and where the control counts friction the
        tangents of contacts that only push.
    assembled : tuple of int
        Rows of the model that are closed at the start, which is projected on them.
    bilateral : tuple of int
        Rows that are active at all times.
    compliant : CompliantContacts or None
    timed : tuple of TimedJoint
    """

    records: dict[str, list[Record]]
    constraints: tuple[Constraint, ...]
    model: tuple[int, ...]
    of_laws: tuple[int, ...]
    assembled: tuple[int, ...]
    bilateral: tuple[int, ...]
    compliant: CompliantContacts | None
    timed: tuple[TimedJoint, ...]

    @property
    def contacts(self) -> tuple[Constraint, ...]:
        """The contacts among the constraints."""
        return tuple(constraint for constraint in self.constraints if constraint.kind == CONTACT)

    @property
    def grips(self) -> tuple[Constraint, ...]:
        """The contacts of joints that only push and have friction; not those with the floor."""
        contacts = (c for c in self.contacts if c.row in self.model)
        return tuple(c for c in contacts if c.mu > 0.0 and not c.bilateral)

    def counting_friction(self) -> UnilateralConstraints:
        """The same for control that counts the friction of contacts that only push."""
        tangents = [row for contact in self.grips for row in contact.tangents]
        return replace(self, of_laws=tuple(sorted([*self.model, *tangents])))

    @property
    def has_functions(self) -> bool:
        """Whether functions tell when some timed joints hold."""
        return any(isinstance(moment, When) for joint in self.timed for moment in joint.moments)

    def holding_at(self, t: float) -> frozenset[int]:
        """Numbers of the timed joints that hold at a time [s], as far as times say."""
        return frozenset(k for k, joint in enumerate(self.timed) if joint.interval_at(t))

    def bilateral_with(self, holding: Set[int]) -> tuple[int, ...]:
        """Rows that are active while these timed joints hold, whatever contacts do."""
        timed = (row for k in holding for row in self.timed[k].rows)
        return tuple(sorted([*self.bilateral, *timed]))

    def idle_without(self, holding: Set[int]) -> frozenset[int]:
        """Constraints of the timed joints that do not hold."""
        others = (joint for k, joint in enumerate(self.timed) if k not in holding)
        return frozenset(u for joint in others for u in joint.constraints)

    def rows_held_by(self, holding: Set[int], rows: Iterable[int]) -> tuple[int, ...]:
        """Of some rows those that do not belong to timed joints which do not hold."""
        others = set(range(len(self.timed))).difference(holding)
        idle = frozenset().union(*(self.rows_of(k) for k in others))
        return tuple(row for row in rows if row not in idle)

    def rows_of(self, timed: int) -> frozenset[int]:
        """All rows of a timed joint, those of its contacts and their tangents too."""
        joint, constraints = self.timed[timed], self.constraints
        contacts = [constraints[u] for u in joint.constraints]
        return frozenset([*joint.rows, *(r for c in contacts for r in (c.row, *c.tangents))])

    @property
    def enforced(self) -> frozenset[int]:
        """Rows of the constraints, whose laws the modes enforce."""
        return frozenset(
            row for constraint in self.constraints for row in (constraint.row, *constraint.tangents)
        )

    def contacts_of(self, owner: str) -> tuple[str, ...]:
        """Names of the unilateral contacts of an owner of rows."""
        return tuple(contact.name for contact in self.contacts if contact.owner == owner)


class ContactParameters(NamedTuple):
    """Parameters of a contact that can open, slide or give way."""

    mu: float | None = None  # coefficient of friction; None: it has no tangents
    restitution: float = 0.0  # Newton's, between 0 and 1
    stiffness: float = 0.0  # of a compliant contact [N/m]; 0: it is rigid
    damping: float = 0.0  # [N s/m]


class TimedRows(NamedTuple):
    """Rows and numbers of constraints of a joint that holds for some of the time."""

    rows: list[int]
    constraints: list[int]


class RowBuilder:
    """Builder of the rows of a scene, in order, owner by owner.

    Parameters
    ----------
    timed : iterable of str
        Owners of rows: connections that hold for some of the time.
    """

    def __init__(self, timed: Iterable[str] = ()) -> None:
        self.owner = self.robot = ""
        self.timed = {owner: TimedRows([], []) for owner in timed}
        self.records: dict[str, list[Record]] = {}
        self.constraints: list[Constraint] = []
        self.model: list[int] = []
        self.bilateral: list[int] = []
        self.compliant: list[tuple[int, ContactParameters, bool]] = []
        self.count = 0

    def start(self, owner: str, robot: str = "") -> None:
        """Begin, or go on with, the rows of an owner; ``robot`` has the joints that follow."""
        self.owner, self.robot = owner, robot
        if not robot:
            self.records.setdefault(owner, [])

    def _add(self, record: Record) -> int:
        self.records.setdefault(self.owner, []).append(record)
        self.count += 1
        return self.count - 1

    def _constrain(self, kind: str, record: Record, row: int, **more: Any) -> None:
        owner = self.owner if kind == CONTACT else self.robot
        if kind == CONTACT and owner in self.timed:
            self.timed[owner].constraints.append(len(self.constraints))
        self.constraints.append(Constraint(kind, owner, record.name, row, **more))

    def add_contact(self, contact: Contact, parameters: ContactParameters | None) -> None:
        """A contact, bilateral without parameters."""
        row = self._add(contact)
        if not of_surroundings(self.owner):
            self.model.append(row)
        if parameters is None and self.owner in self.timed:
            self.timed[self.owner].rows.append(row)
        elif parameters is None:
            self.bilateral.append(row)
        elif parameters.stiffness > 0.0:
            self.compliant.append((row, parameters, not contact.pushes_only))
            if contact.pushes_only:  # one that also pulls is always active
                lag = parameters.damping / parameters.stiffness
                self._constrain(CONTACT, contact, row, compliant=True, lag=lag)
        elif parameters.mu is None:
            self._constrain(CONTACT, contact, row, restitution=parameters.restitution)
        else:
            for tangent in (1, 2):
                name = f"{contact.name}, friction {tangent}"
                self._add(
                    replace(
                        contact, name=name, tangent=tangent, pushes_only=False, parent=contact.name
                    )
                )
            self._constrain(
                CONTACT,
                contact,
                row,
                tangents=(row + 1, row + 2),
                mu=parameters.mu,
                restitution=parameters.restitution,
                bilateral=not contact.pushes_only,
            )

    def add_stops(
        self, record: JointRow, joint: int, ends: tuple[float, float], restitution: float
    ) -> None:
        """The ends of a joint's range that are finite."""
        for which, side, end in (("lower", 1.0, ends[0]), ("upper", -1.0, ends[1])):
            if np.isfinite(end):
                name = f"{record.name} at its {which} limit"
                stop = replace(record, name=name, side=side, bound=float(end))
                row = self._add(stop)
                self._constrain(LIMIT, stop, row, joint=joint, restitution=restitution)

    def add_dry_friction(self, record: JointRow, joint: int, bound: float) -> None:
        """A joint that dry friction can hold."""
        held = replace(record, name=f"{record.name}, dry friction")
        self._constrain(DRY_JOINT, held, self._add(held), joint=joint, bound=bound)

    def add_bilateral(self, record: JointRow | WheelRow) -> None:
        """A joint that copies another one, or wheels: at all times."""
        row = self._add(record)
        self.model.append(row)
        self.bilateral.append(row)

    def compliant_contacts(self) -> CompliantContacts | None:
        """The contacts that are springs and dampers."""
        if not self.compliant:
            return None
        rows, parameters, always = zip(*self.compliant, strict=True)
        return CompliantContacts(
            rows=np.array(rows, dtype=np.int64),
            stiffness=np.array([of_contact.stiffness for of_contact in parameters]),
            damping=np.array([of_contact.damping for of_contact in parameters]),
            always=np.array(always, dtype=np.int64),
        )
