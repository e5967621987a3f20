"""Unilateral constraints of a scene: contacts that can open, joint stops, dry friction at rest.

A *unilateral constraint* is active at some times only: a contact that can only push (with its two
tangents, if it has friction), a joint at an end of its range, a joint that dry friction holds at
rest.  A contact that holds both ways and has friction is one of them too, of which the tangents
alone come and go.  Compliant contacts are springs and dampers: their rows are measured, never
active.  All other rows are *bilateral*.  This module derives the constraints and their rows of W
from a scene's joints and effects; :mod:`multiarm.events` decides which are active at a time.

Rows are in the order of the stacked vectors: arm by arm its contacts, each followed by its
tangents, then its joints; last the contacts of the object with the floor.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from multiarm.contacts.table import JointRow
from multiarm.errors import SceneError
from multiarm.geometry.records import Contact, Patch, plane, sphere, tangent_rows
from multiarm.scene import Mesh, Scene, Shape
from multiarm.scene.effects.contacts import ContactFrictionSpec, FloorSpec, SomeContacts
from multiarm.scene.faults import place, unknown
from multiarm.scene.meshes import read_mesh
from multiarm.scene.values import SURROUNDINGS

CONTACT, LIMIT, DRY_JOINT = "contact", "limit", "joint friction"


@dataclass(frozen=True)
class Constraint:
    """One unilateral constraint.

    Attributes
    ----------
    kind : str
        ``CONTACT``, ``LIMIT`` or ``DRY_JOINT``.
    arm, name : str
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
    arm: str
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
        Contacts and joint rows of every arm, and of the surroundings: all rows.
    constraints : tuple of Constraint
        In the order of their rows.
    model : tuple of int
        Rows of the scene without effects, which are the controllers' model.
    assembled : tuple of int
        Rows of the model that are closed at the start, which is projected on them.
    bilateral : tuple of int
        Rows that are active at all times.
    compliant : CompliantContacts or None
    """

    records: dict[str, list[Contact | JointRow]]
    constraints: tuple[Constraint, ...]
    model: tuple[int, ...]
    assembled: tuple[int, ...]
    bilateral: tuple[int, ...]
    compliant: CompliantContacts | None

    @property
    def contacts(self) -> tuple[Constraint, ...]:
        """The contacts among the constraints."""
        return tuple(one for one in self.constraints if one.kind == CONTACT)

    def contacts_of(self, owner: str) -> tuple[str, ...]:
        """Names of the unilateral contacts of an arm, or of the surroundings."""
        return tuple(contact.name for contact in self.contacts if contact.arm == owner)


def unilateral_constraints(
    scene: Scene,
    contacts: Mapping[str, list[Contact]],
    limits: Mapping[str, Mapping[str, tuple[float, float]]],
    dry: Mapping[str, np.ndarray] | None,
) -> UnilateralConstraints | None:
    """The unilateral constraints and all rows of a scene; None where all rows are bilateral.

    Parameters
    ----------
    scene : Scene
    contacts : mapping arm -> list of Contact
        Of the arms' joints with the object.
    limits : mapping arm -> joint -> (lower, upper)
        Of the robots, in chain order [rad, m].
    dry : mapping arm -> (n,), optional
        Dry friction of the joints [N m, N].

    Raises
    ------
    SceneError
        Naming contacts that do not exist, or to which an effect does not apply; or when the points
        of the object that can touch the floor are unknown.
    """
    parameters = _contact_parameters(scene, contacts)
    rows, first = _Rows(), 0
    for arm, own in contacts.items():
        rows.start(arm)
        for k, contact in enumerate(own):
            rows.add_contact(contact, parameters[arm].get(k))
        for number, (name, limit) in enumerate(limits[arm].items()):
            record, joint = JointRow(name, number), first + number
            rows.add_stops(record, joint, *_range(scene, arm, name, limit))
            if dry is not None and dry[arm][number] > 0.0:
                rows.add_dry_friction(record, joint, float(dry[arm][number]))
        first += len(limits[arm])
    rows.start(SURROUNDINGS)
    if (floor := scene.effects.floor) is not None:
        for contact in floor_contacts(floor, scene.object.shape):
            rows.add_contact(contact, _Parameters(floor.mu, floor.restitution))
    if not (rows.constraints or rows.compliant):
        return None
    spec = scene.effects.unilateral_contacts
    as_written = spec is not None and spec.start == "as_written"
    unable_to_open = [one.row for one in rows.constraints if one.bilateral]
    return UnilateralConstraints(
        records=rows.records,
        constraints=tuple(rows.constraints),
        model=tuple(rows.model),
        assembled=tuple(sorted([*rows.bilateral, *unable_to_open]) if as_written else rows.model),
        bilateral=tuple(rows.bilateral),
        compliant=_compliant_contacts(rows),
    )


def floor_contacts(spec: FloorSpec, shape: Shape) -> list[Contact]:
    """Contacts of an object of this shape with the floor.

    Raises
    ------
    SceneError
        When the points that can touch it are unknown.
    """
    pose = spec.at.matrix()
    ground = plane(pose[:3, 3], pose[:3, 2])
    if spec.size is not None:
        half = 0.5 * np.array([*spec.size, np.inf])
        ground = replace(ground, patch=Patch(-half, half, pose))
    return [
        Contact(name, ground, sphere(point, radius), pushes_only=True)
        for name, point, radius in _touching_points(spec, shape)
    ]


def hull_corners(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull of points, shape (n, 3), without those on its faces and edges.

    Raises
    ------
    SceneError
        When the points lie in a plane.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        raise _unknown_points("the mesh is flat", "on both of its sides") from None
    corners = []
    for vertex in hull.vertices:
        normals = hull.equations[np.any(hull.simplices == vertex, axis=1), :3]
        if np.linalg.svd(normals, compute_uv=False)[-1] > 1e-6:  # three faces that differ
            corners.append(points[vertex])
    return np.array(corners)


class _Parameters(NamedTuple):
    """Parameters of a contact that can open, slide or give way."""

    mu: float | None = None  # coefficient of friction; None: it has no tangents
    restitution: float = 0.0  # Newton's, between 0 and 1
    stiffness: float = 0.0  # of a compliant contact [N/m]; 0: it is rigid
    damping: float = 0.0  # [N s/m]


class _Rows:
    """Builder of the rows of a scene, in order, owner by owner."""

    def __init__(self) -> None:
        self.owner = ""
        self.records: dict[str, list[Contact | JointRow]] = {}
        self.constraints: list[Constraint] = []
        self.model: list[int] = []
        self.bilateral: list[int] = []
        self.compliant: list[tuple[int, _Parameters, bool]] = []
        self.count = 0

    def start(self, owner: str) -> None:
        """Begin the rows of an arm, or of the surroundings."""
        self.owner = owner
        self.records[owner] = []

    def _add(self, record: Contact | JointRow) -> int:
        self.records[self.owner].append(record)
        self.count += 1
        return self.count - 1

    def _constrain(self, kind: str, record: Contact | JointRow, row: int, **more: Any) -> None:
        self.constraints.append(Constraint(kind, self.owner, record.name, row, **more))

    def add_contact(self, contact: Contact, own: _Parameters | None) -> None:
        """A contact, bilateral without parameters."""
        row = self._add(contact)
        if self.owner != SURROUNDINGS:
            self.model.append(row)
        if own is None:
            self.bilateral.append(row)
        elif own.stiffness > 0.0:
            self.compliant.append((row, own, not contact.pushes_only))
            if contact.pushes_only:  # one that also pulls is always active
                lag = own.damping / own.stiffness
                self._constrain(CONTACT, contact, row, compliant=True, lag=lag)
        elif own.mu is None:
            self._constrain(CONTACT, contact, row, restitution=own.restitution)
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
                mu=own.mu,
                restitution=own.restitution,
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


def _compliant_contacts(rows: _Rows) -> CompliantContacts | None:
    if not rows.compliant:
        return None
    places, parameters, always = zip(*rows.compliant, strict=True)
    return CompliantContacts(
        rows=np.array(places, dtype=np.int64),
        stiffness=np.array([own.stiffness for own in parameters]),
        damping=np.array([own.damping for own in parameters]),
        always=np.array(always, dtype=np.int64),
    )


def _range(
    scene: Scene, arm: str, joint: str, limit: tuple[float, float]
) -> tuple[tuple[float, float], float]:
    """The ends of a joint's range at which it stops, infinite for none, and its restitution."""
    spec, none = scene.effects.joint_limits, (-np.inf, np.inf)
    if spec is None:
        return none, 0.0
    ends = limit if spec.range == "urdf" else spec.range.get(arm, {}).get(joint, none)
    return ends, spec.restitution


def _contact_parameters(
    scene: Scene, contacts: Mapping[str, list[Contact]]
) -> dict[str, dict[int, _Parameters]]:
    """Parameters of contacts that can open, slide or give way: arm -> number of the contact."""
    effects = scene.effects
    faults: list[str] = []
    unilateral, friction = effects.unilateral_contacts, effects.contact_friction
    compliance = effects.contact_compliance
    for name, spec, pushing in (
        ("unilateral_contacts", unilateral, True),
        ("contact_friction", friction, False),
        ("contact_compliance", compliance, False),
    ):
        if spec is not None:
            faults += _name_faults(name, spec, contacts, pushing)
    found: dict[str, dict[int, _Parameters]] = {arm: {} for arm in contacts}
    for arm, own in contacts.items():
        rolling = tangent_rows(own)
        for k, contact in enumerate(own):
            if contact.tangent:
                continue
            one = None
            if unilateral is not None and contact.pushes_only and _named(unilateral, arm, contact):
                one = _Parameters(restitution=unilateral.restitution)
            mu = _friction(friction, arm, contact)
            if mu is not None:
                one = (one or _Parameters())._replace(mu=mu)
                if contact.is_combined:
                    faults.append(
                        f"$.joints: contact '{arm}/{contact.name}' is a multiple or a difference "
                        f"of contacts, which has no friction; give 'mu' to contacts of surfaces"
                    )
            if compliance is not None and _named(compliance, arm, contact):
                if mu is not None:
                    faults.append(
                        f"$.effects.contact_compliance: contact '{arm}/{contact.name}' has "
                        f"friction ('mu' or contact_friction), which needs a rigid contact; name "
                        f"the contacts of each with 'contacts'"
                    )
                one = _Parameters(stiffness=compliance.stiffness, damping=compliance.damping)
            if one is None:
                continue
            found[arm][k] = one
            if k in rolling:
                faults.append(
                    f"$.effects: contact '{arm}/{contact.name}' rolls ('rolling: true'): it cannot "
                    f"let go, slide or give way; leave it out of 'contacts' of the effect, or give "
                    f"it friction and no 'rolling'"
                )
    if faults:
        raise SceneError(list(dict.fromkeys(faults)))
    return found


def _friction(spec: ContactFrictionSpec | None, arm: str, contact: Contact) -> float | None:
    """A contact's coefficient of friction; None: it has no tangents.

    The nearest one counts: that of the contact, of its joint, of the scene.  The scene's is of
    contacts that only push, unless it names others.
    """
    mu = contact.mu
    if mu is None and spec is not None and _named(spec, arm, contact):
        mu = spec.mu if contact.pushes_only or spec.contacts is not None else None
    # without friction, one that holds both ways is bilateral and nothing else
    return mu if mu or contact.pushes_only else None


def _named(spec: SomeContacts, arm: str, contact: Contact) -> bool:
    names = spec.contacts
    return names is None or arm in names or f"{arm}/{contact.name}" in names


def _name_faults(
    effect: str, spec: SomeContacts, contacts: Mapping[str, list[Contact]], pushing: bool
) -> Iterator[str]:
    """Names that are no contact, or none that can only push (``pushing``)."""
    known = {
        f"{arm}/{contact.name}": contact.pushes_only or not pushing
        for arm, own in contacts.items()
        for contact in own
        if contact.tangent == 0
    }
    usable = [name for name, fits in known.items() if fits]
    for k, name in enumerate(spec.contacts or ()):
        where = place(("effects", effect, "contacts", k))
        if name in contacts:
            if not any(other.startswith(f"{name}/") for other in usable):
                yield f"{where}: arm {name!r} has no contact that only pushes; name others"
        elif name not in known:
            yield f"{where}: {unknown('contact', name, usable)}"
        elif not known[name]:
            yield (
                f"{where}: contact {name!r} also pulls, and cannot let go or slide; contacts that "
                f"only push are {', '.join(map(repr, usable)) or '(none)'}"
            )


def _touching_points(spec: FloorSpec, shape: Shape) -> list[tuple[str, np.ndarray, float]]:
    """Name, position in the object frame and radius of all points that can touch the floor."""
    if spec.points is not None:
        return [(f"point {k + 1}", np.array(point), 0.0) for k, point in enumerate(spec.points)]
    if shape.sphere is not None:
        return [("ball", np.zeros(3), float(shape.sphere))]
    if shape.box is not None:
        half = 0.5 * np.array(shape.box)
        corners = [np.array(signs) * half for signs in product((-1.0, 1.0), repeat=3)]
        return _named_corners(corners)
    if shape.hull is not None:
        return _named_corners(list(hull_corners(np.array(shape.hull))))
    if shape.mesh is not None:
        return _named_corners(list(_mesh_corners(shape.mesh)))
    if shape.cylinder is not None:
        raise _unknown_points("a cylinder has no corners", "such as eight or more around each rim")
    raise _unknown_points("the object has no 'shape'", "such as its corners")


def _named_corners(corners: list[np.ndarray]) -> list[tuple[str, np.ndarray, float]]:
    return [(f"corner {k + 1}", corner, 0.0) for k, corner in enumerate(corners)]


def _mesh_corners(mesh: Mesh) -> np.ndarray:
    """Corners of the convex hull of a mesh, object frame [m], shape (n, 3)."""
    if not mesh.file.is_file():
        raise _unknown_points(f"there is no mesh at {mesh.file}", "or correct the path")
    try:
        vertices, triangles, _ = read_mesh(mesh.file, mesh.scale)
    except ValueError as error:
        raise _unknown_points(
            f"{mesh.file} cannot be read ({error})", "or repair the file"
        ) from None
    corners = hull_corners(vertices[np.unique(triangles)])
    if len(corners) > 64:  # every corner is a contact; a hull with more is a rounded body
        raise _unknown_points(
            f"the hull of {mesh.file.name} has {len(corners)} corners, which is too many",
            "at most 64",
        )
    return corners


def _unknown_points(reason: str, such: str) -> SceneError:
    return SceneError(
        [
            f"$.effects.floor: {reason}; name the points of the object that can touch the floor "
            f"with 'points: [[x, y, z], ...]' in the object frame, {such}"
        ]
    )
