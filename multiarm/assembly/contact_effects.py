"""Unilateral constraints of a scene, from its contacts and effects; faults of what these name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multiarm.assembly.blocks import Block, RobotPart
from multiarm.contacts.table import JointRow, WheelRow
from multiarm.contacts.unilateral import (
    CONTACT,
    Constraint,
    ContactParameters,
    RowBuilder,
    TimedJoint,
    TimedRows,
    UnilateralConstraints,
)
from multiarm.errors import SceneError
from multiarm.geometry.records import Contact, Patch, basis, plane, sphere, tangent_rows
from multiarm.scene import JointSpec, Scene, Shape
from multiarm.scene.effects.contacts import ContactFrictionSpec, FloorSpec, SomeContacts
from multiarm.scene.faults import place, unknown
from multiarm.scene.joints.times import Touching
from multiarm.scene.shapes import NoCornersError
from multiarm.scene.values import floor_owner


@dataclass(frozen=True)
class JointLaws:
    """What the rows of robots' joints are about.

    Attributes
    ----------
    limits : mapping robot -> joint -> (lower, upper)
        In the order of its joints [rad, m].
    bilateral : mapping robot -> list of JointRow or WheelRow
        Of joints that copy others, and of wheels.
    dry : mapping robot -> (n,), optional
        Dry friction of the joints [N m, N].
    of_bases : mapping robot -> int
        How many numbers of a floating base stand before the joints.
    """

    limits: Mapping[str, Mapping[str, tuple[float, float]]]
    bilateral: Mapping[str, list[JointRow | WheelRow]]
    dry: Mapping[str, np.ndarray] | None
    of_bases: Mapping[str, int]


def unilateral_constraints(
    scene: Scene,
    contacts: Mapping[str, list[Contact]],
    blocks: Sequence[Block],
    around: Sequence[str],
    laws: JointLaws,
) -> UnilateralConstraints | None:
    """The unilateral constraints and all rows of a scene; None where all rows are bilateral.

    Parameters
    ----------
    scene : Scene
    contacts : mapping connection -> list of Contact
    blocks : sequence of Block
        Of the robots, in the order of the equations.
    around : sequence of str
        Connections in which no robot takes part.
    laws : JointLaws

    Raises
    ------
    SceneError
        Naming contacts that do not exist, or to which an effect does not apply; or when the points
        of the object that can touch the floor are unknown.
    """
    parameters = _contact_parameters(scene, contacts)
    timed = {joint.connection: joint for joint in scene.joints if joint.intervals}
    rows, first = RowBuilder(timed), 0
    for block in blocks:
        # the rows of an owner stand together: those of an arm's joints follow its contacts
        firsts = np.cumsum([first, *(len(part.joints) for part in block.parts)]).tolist()
        for owner in block.owners:
            if owner in block.connections:
                _add_connections(rows, [owner], contacts, parameters)
            for part, of_part in zip(block.parts, firsts, strict=False):
                if owner == part.owner:
                    _add_joint_rows(rows, scene, part, of_part, laws)
        first = firsts[-1]
    _add_connections(rows, around, contacts, parameters)
    for name, body in scene.all_objects.items():
        rows.start(floor_owner(name, scene.all_objects))
        if (floor := scene.effects.floor) is not None and floor.is_of(name):
            for contact in floor_contacts(floor, body.shape):
                rows.add_contact(contact, ContactParameters(floor.mu, floor.restitution))
    if not (rows.constraints or rows.compliant or rows.timed):
        return None
    if faults := [*_touching_faults(scene, rows.constraints), *_patch_faults(scene, contacts)]:
        raise SceneError(faults)
    joints = tuple(_timed_joint(timed[name], of_joint) for name, of_joint in rows.timed.items())
    spec = scene.effects.unilateral_contacts
    as_written = spec is not None and spec.start == "as_written"
    unable_to_open = [constraint.row for constraint in rows.constraints if constraint.bilateral]
    closed = [*rows.bilateral, *unable_to_open, *(row for joint in joints for row in joint.rows)]
    constraints = UnilateralConstraints(
        records=rows.records,
        constraints=tuple(rows.constraints),
        model=tuple(rows.model),
        of_laws=tuple(rows.model),
        assembled=tuple(sorted(closed) if as_written else rows.model),
        bilateral=tuple(rows.bilateral),
        compliant=rows.compliant_contacts(),
        timed=joints,
    )
    assembled = constraints.rows_held_by(constraints.holding_at(0.0), constraints.assembled)
    return replace(constraints, assembled=assembled)


def _touching_faults(scene: Scene, constraints: Iterable[Constraint]) -> Iterator[str]:
    """Moments at which a contact is to close that cannot open, or is none."""
    can_open = [one for one in constraints if one.kind == CONTACT and not one.bilateral]
    contacts = [f"{contact.owner}/{contact.name}" for contact in can_open]
    owners = {contact.owner for contact in can_open}
    for number, joint in enumerate(scene.joints):
        for where, moment in joint.moments.items():
            if not isinstance(moment, Touching) or moment.touching in {*owners, *contacts}:
                continue
            at, name = place(("joints", number, *where, "touching")), moment.touching
            if contacts:
                yield f"{at}: {unknown('contact that can open', name, contacts, 'such contacts')}"
            else:
                yield (
                    f"{at}: {name!r} has no contact that can open, as no joint has; contacts that "
                    "only push do with 'effects: {unilateral_contacts: {}}', or with friction"
                )


def _patch_faults(scene: Scene, contacts: Mapping[str, list[Contact]]) -> Iterator[str]:
    """Joints that hold their bodies where they are, on surfaces that are bounded."""
    for number, joint in enumerate(scene.joints):
        if not joint.intervals or joint.at is not None:
            continue
        bounded = [c.name for c in contacts[joint.connection] if c.object.patch is not None]
        if bounded:
            yield (
                f"{place(('joints', number))}: without 'at' the joint holds its bodies where they "
                f"are, and its surfaces move there; that of {bounded[0]!r} has a patch, which does "
                "not; give 'at', or leave the patch out"
            )


def _timed_joint(joint: JointSpec, rows: TimedRows) -> TimedJoint:
    turn = np.eye(4)
    turn[:3, :3] = basis(joint.z_axis)
    return TimedJoint(
        connection=joint.connection,
        rows=tuple(rows.rows),
        constraints=tuple(rows.constraints),
        intervals=joint.intervals,
        located=joint.at is None,
        offset=turn.T @ joint.start_shift() @ turn,
        axes=turn[:3, :3],
        speed_limit=np.inf if joint.speed_limit is None else joint.speed_limit,
    )


def joints_with_rows(scene: Scene, laws: JointLaws) -> dict[str, set[int]]:
    """Joints of every robot that have rows of W of their own, counted from 0."""
    joints = {}
    for robot, of_joints in laws.limits.items():
        ends = [_range(scene, robot, *limit)[0] for limit in of_joints.items()]
        before = laws.of_bases[robot]
        ranged = before + np.flatnonzero(np.isfinite(np.reshape(ends, (-1, 2))).any(axis=1))
        joints[robot] = set(ranged.tolist())
        joints[robot] |= {row.joint for row in laws.bilateral[robot]}
        if laws.dry is not None:
            joints[robot] |= set((before + np.flatnonzero(laws.dry[robot] > 0.0)).tolist())
    return joints


def _add_connections(
    rows: RowBuilder,
    names: Iterable[str],
    contacts: Mapping[str, list[Contact]],
    parameters: Mapping[str, Mapping[int, ContactParameters]],
) -> None:
    for name in names:
        rows.start(name)
        for k, contact in enumerate(contacts[name]):
            rows.add_contact(contact, parameters[name].get(k))


def _add_joint_rows(
    rows: RowBuilder, scene: Scene, part: RobotPart, first: int, laws: JointLaws
) -> None:
    """Add the rows of a part's joints, of which ``first`` is the first one among all joints."""
    robot = part.robot
    limits, dry = list(laws.limits[robot].items()), laws.dry
    rows.start(part.owner, robot)
    before = laws.of_bases[robot]
    for number in part.joints:
        if number < before:
            continue
        joint_name, limit = limits[number - before]
        record, joint = JointRow(joint_name, number), first + number - part.joints.start
        rows.add_stops(record, joint, *_range(scene, robot, joint_name, limit))
        if dry is not None and dry[robot][number - before] > 0.0:
            rows.add_dry_friction(record, joint, float(dry[robot][number - before]))
    for row in laws.bilateral[robot]:
        if row.joint in part.joints:
            rows.add_bilateral(row)


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
) -> dict[str, dict[int, ContactParameters]]:
    """Parameters of contacts that can open, slide or give way: arm -> number of the contact."""
    effects = scene.effects
    faults: list[str] = []
    timed = {joint.connection for joint in scene.joints if joint.intervals}
    unilateral, friction = effects.unilateral_contacts, effects.contact_friction
    compliance = effects.contact_compliance
    for name, spec, pushing in (
        ("unilateral_contacts", unilateral, True),
        ("contact_friction", friction, False),
        ("contact_compliance", compliance, False),
    ):
        if spec is not None:
            faults += _name_faults(name, spec, contacts, pushing)
    parameters: dict[str, dict[int, ContactParameters]] = {arm: {} for arm in contacts}
    for arm, of_arm in contacts.items():
        rolling = tangent_rows(of_arm)
        for k, contact in enumerate(of_arm):
            if contact.tangent:
                continue
            contact_parameters = None
            if unilateral is not None and contact.pushes_only and _named(unilateral, arm, contact):
                contact_parameters = ContactParameters(restitution=unilateral.restitution)
            mu = _friction(friction, arm, contact)
            if mu is not None:
                contact_parameters = (contact_parameters or ContactParameters())._replace(mu=mu)
                if contact.is_combined:
                    faults.append(
                        f"$.joints: contact '{arm}/{contact.name}' is a multiple or a difference "
                        f"of contacts, which has no friction; give 'mu' to contacts of surfaces"
                    )
            if compliance is not None and _named(compliance, arm, contact):
                if arm in timed:
                    faults.append(
                        f"$.effects.contact_compliance: joint '{arm}' holds for some of the time, "
                        f"its contacts are rigid; name those of other joints with 'contacts'"
                    )
                if mu is not None:
                    faults.append(
                        f"$.effects.contact_compliance: contact '{arm}/{contact.name}' has "
                        f"friction ('mu' or contact_friction), which needs a rigid contact; name "
                        f"the contacts of each with 'contacts'"
                    )
                contact_parameters = ContactParameters(
                    stiffness=compliance.stiffness, damping=compliance.damping
                )
            if contact_parameters is None:
                continue
            parameters[arm][k] = contact_parameters
            if k in rolling:
                faults.append(
                    f"$.effects: contact '{arm}/{contact.name}' rolls ('rolling: true'): it cannot "
                    f"let go, slide or give way; leave it out of 'contacts' of the effect, or give "
                    f"it friction and no 'rolling'"
                )
    if faults:
        raise SceneError(list(dict.fromkeys(faults)))
    return parameters


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
        for arm, of_arm in contacts.items()
        for contact in of_arm
        if contact.tangent == 0
    }
    usable = [name for name, fits in known.items() if fits]
    for k, name in enumerate(spec.contacts or ()):
        where = place(("effects", effect, "contacts", k))
        if name in contacts:
            if not any(contact.startswith(f"{name}/") for contact in usable):
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
    try:
        if shape.solid is None:
            raise NoCornersError("the object has no 'shape'", "such as its corners")
        corners, radius = shape.solid.corners()
    except NoCornersError as unknown_corners:
        raise SceneError(
            [
                f"$.effects.floor: {unknown_corners.reason}; name the points of the object that "
                f"can touch the floor with 'points: [[x, y, z], ...]' in the object frame, "
                f"{unknown_corners.remedy}"
            ]
        ) from None
    names = [f"corner {k + 1}" for k in range(len(corners))] if radius == 0.0 else ["ball"]
    return [(name, corner, radius) for name, corner in zip(names, corners, strict=True)]
