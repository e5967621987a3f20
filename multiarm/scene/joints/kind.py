"""The base class of joints: what a kind of joint says about itself.

Every joint is, to the rest of the program, a set of frictionless point contacts (S.Y. Ho, "Analysis
and Design of Multi-Arm Robotic Systems Manipulating Large Objects", CUHK MPhil thesis, 1995,
section 3.9).  A kind is one class: its parameters, its contacts, and what people read about it.
"""

from __future__ import annotations

from dataclasses import replace
from textwrap import dedent, indent
from typing import Annotated, ClassVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    model_validator,
)
from typing_extensions import Self

from multiarm.errors import ModelError
from multiarm.geometry import Contact
from multiarm.geometry.records import Vector, basis, tangent_rows
from multiarm.scene.bodies import (
    OBJECT_NAME,
    BodyName,
    body_named,
    connection_name,
    object_named,
    tip_named,
)
from multiarm.scene.faults import Parts, invalid, shown
from multiarm.scene.joints.times import Begin, Interval, Moment, fault_of_times, intervals
from multiarm.scene.registry import UserKind, called
from multiarm.scene.text import parse_yaml
from multiarm.scene.values import Direction, NonNegative, Pose, Positive, Range, list_of

X, Y, Z = np.eye(3)
ZERO = np.zeros(3)


def _around_the_start(limits: tuple[float, float]) -> tuple[float, float]:
    if not limits[0] <= 0.0 <= limits[1]:
        raise invalid(
            f"limits are counted from where the joint's two frames coincide, as they do at the "
            f"start unless 'at' turns them, and must enclose 0, got [{limits[0]:g}, "
            f"{limits[1]:g}]"
        )
    return limits


Limits = Annotated[Range, AfterValidator(_around_the_start)]
Line = Annotated[
    Direction,
    Field(description="Direction of the line through the joint frame's origin, joint frame."),
]
Spread = Annotated[
    Positive,
    Field(
        description="How far the contacts are spread [m]; contact forces depend on it, motions do "
        "not."
    ),
]
TipRadius = Annotated[
    NonNegative,
    Field(description="Radius of the spherical fingertip [m]; 0 is a sharp point."),
]


TwoBodies = Annotated[tuple[str, str], list_of("must be a list of two bodies", 2)]


class Joint(UserKind):
    """Base class of joints; define ``kind``, fields and :meth:`Joint.records`.

    It connects two bodies: points of the first usually touch surfaces of the second.  Contact
    forces are those on the second body.  The joint frame is written in the frame of the second
    body (``at``) and in that of the first (``at_first``); both coincide at the start.

    Attributes
    ----------
    arm : str
        The arm, or the tip of a robot as 'robot/tip', that this joint connects with an object.
        The link of the tip is the first body, the object the second. Empty with 'between'.
    object : str, optional
        With 'arm', the object that the tip holds. May be left out where the scene has one.
    between : list of 2 str, optional
        Instead of 'arm': a list of two bodies. 'object', or an object by its name, 'world', an arm
        by its name, 'robot/tip' or 'robot/link'. The first is a link or an object, the second an
        object, the world or another link, of the same robot or of another one.
    name : str, optional
        A name for reports; with 'between' also in results. Absent: 'arm', or 'first-second'.
    at : Pose, optional
        Joint frame in the frame of the second body, of the object where 'arm' is written. Absent:
        where the joint frame on the first is at the start; kind 'contacts': the second's frame.
    at_first : Pose, optional
        Joint frame in the frame of the first body. Absent: that frame.
    at_tip : Pose
        The same as 'at_first', where the first body is a tip.
    mu : float, optional
        Coulomb's coefficient of friction of its contacts, where they have none of their own and do
        not roll.  It counts before that of ``effects.contact_friction``.  Friction follows from the
        forces of each contact, and so from how far they are spread.
    from : time, 'never', event or list of pairs, optional
        When it begins to hold: a time [s]; {when: 'file.py:name'}, when the function f(t, state)
        of the motion has fallen to zero; {touching: 'joint/contact'}, when a contact closes;
        'never': by command only.  Or several times, as a list of pairs [from, until].  Without 'at'
        its frame on the second body is then where that on the first is.
    until : time, 'never' or event, optional
        When it lets go, written as 'from' is.
    speed_limit : float, optional
        A run ends where the joint would take hold of bodies that move faster against each other
        [m/s] at its frame.  Absent: at any speed.
    picture : str
        An everyday example, for ``multiarm joints``.
    example : str
        The lines after ``kind: ...`` of a joint in YAML; may be empty if no parameter is required.
    free : tuple of int or None
        Components of the relative motion that stay free, in the axes of :meth:`frames`: 0 to 2 are
        translations along x, y, z, 3 to 5 rotations about them. None: found at the start.
    limited : dict
        Component of the relative motion that each attribute limits.
    as_listed : bool
        The contacts are those that a user lists, so that their number and free motions vary.
    drawn_as : str
        How a replay draws it: a hinge of :mod:`multiarm.viewer.animate`, or ``surfaces``.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": [
                {"required": ["arm"]},
                {"required": ["between"], "not": {"required": ["object"]}},
            ]
        }
    )
    class_sort = "joint"
    free: ClassVar[tuple[int, ...] | None] = None
    limited: ClassVar[dict[str, int]] = {}
    as_listed: ClassVar[bool] = False
    drawn_as: ClassVar[str] = ""

    arm: str = ""
    object: str | None = None
    between: TwoBodies | None = None
    name: str | None = None
    at: Pose | None = None
    at_first: Pose | None = None
    at_tip: Pose = Pose()
    mu: NonNegative | None = None
    __annotations__["from"] = Begin | None  # a word of Python, which no field can be written as
    vars()["from"] = None
    until: Moment | None = None
    speed_limit: Positive | None = None
    kind: str

    _objects: tuple[str, ...] = PrivateAttr((OBJECT_NAME,))

    @model_validator(mode="after")
    def _bodies_and_frames_are_written_once(self) -> Self:
        if bool(self.arm) == (self.between is not None):
            raise invalid(
                "needs either 'arm' (the tip that it connects with the object) or 'between' (two "
                f"bodies), got {'both' if self.arm else 'neither'}"
            )
        if self.object is not None and self.between is not None:
            raise invalid("'object' belongs to 'arm'; 'between' names both bodies")
        if self.at_first is not None and "at_tip" in self.model_fields_set:
            raise invalid("gives both 'at_first' and 'at_tip', which are the same; keep one")
        return self

    @model_validator(mode="after")
    def _times_fit_together(self) -> Self:
        if fault := fault_of_times(getattr(self, "from"), self.until):
            raise invalid(f"'until': {fault}")
        if self.speed_limit is not None and not self.intervals:
            raise invalid(
                "'speed_limit' is of a joint that takes hold within a run; write 'from' too"
            )
        return self

    @property
    def intervals(self) -> tuple[Interval, ...]:
        """When it holds, in order; empty: all the time."""
        return intervals(getattr(self, "from"), self.until)

    @property
    def moments(self) -> dict[Parts, Moment]:
        """Beginnings and ends of its intervals, by their places in the joint."""
        begin, end = getattr(self, "from"), self.until
        if isinstance(begin, tuple):
            pairs = enumerate(begin)
            return {("from", k, i): moment for k, pair in pairs for i, moment in enumerate(pair)}
        written = {("from",): begin, ("until",): end}
        return {where: moment for where, moment in written.items() if moment is not None}

    def holds_at(self, t: float) -> bool:
        """Whether it holds at a time [s], as far as times say."""
        return not self.intervals or any(interval.has(t) for interval in self.intervals)

    @property
    def first(self) -> BodyName:
        """The body whose points usually touch."""
        if self.between is None:
            return tip_named(self.arm)
        return body_named(self.between[0], self._objects)

    @property
    def second(self) -> BodyName:
        """The body whose surfaces are usually touched, and on which contact forces act."""
        if self.between is None:
            return object_named(self.object or self._objects[0])
        return body_named(self.between[1], self._objects)

    @property
    def connection(self) -> str:
        """Its name in results: 'arm', or 'name', or those of both bodies, 'first-second'."""
        return connection_name(self.arm, self.between, self.name)

    @property
    def on_first(self) -> Pose:
        """The joint frame in the frame of the first body."""
        return self.at_tip if self.at_first is None else self.at_first

    def records(self) -> list[Contact]:
        """The contacts in the joint frame; points usually on the arm, surfaces on the object."""
        raise NotImplementedError

    def offset(self) -> np.ndarray:
        """Position of the joint frame relative to the tip at the start, shape (3,) [m].

        Zero, but for joints whose contacts are not at the tip's centre; only without ``at``.
        """
        return ZERO

    @property
    def z_axis(self) -> Vector:
        """Direction of the z axis of :meth:`frames` in the joint frame: the field ``axis`` or
        ``normal``, where the kind has one, else z."""
        return getattr(self, "axis", getattr(self, "normal", Z))

    @property
    def pushes(self) -> bool:
        """Whether it has contacts that only push."""
        return any(contact.pushes_only for contact in self.records())

    @property
    def free_limits(self) -> dict[int, tuple[float, float]]:
        """Limits [m, rad] by component of the relative motion, which are counted as in ``free``."""
        limits = {component: getattr(self, name) for name, component in self.limited.items()}
        return {component: ends for component, ends in limits.items() if ends is not None}

    def start_shift(self) -> np.ndarray:
        """The offset as a pose, shape (4, 4)."""
        shift = np.eye(4)
        who = f"joint kind {self.kind!r}: offset()"
        offset = called(self.offset, who)
        if np.shape(offset) != (3,) or not np.all(np.isfinite(offset)):
            raise ModelError(f"{who} must return 3 numbers [m], it returned {offset!r}")
        shift[:3, 3] = offset
        return shift

    def placed(self, object_pose: np.ndarray) -> list[Contact]:
        """The contacts, the arm's geometry in the tip frame, the object's in the object frame.

        ``object_pose`` (4, 4) is that of the joint frame in the object frame.

        Raises
        ------
        ModelError
            When a user class or function cannot be used.
        """
        who = f"joint kind {self.kind!r}: records()"
        contacts = called(self.records, who)
        listed = isinstance(contacts, (list, tuple))
        if not listed or not all(isinstance(contact, Contact) for contact in contacts):
            raise ModelError(
                f"{who} returned {shown(contacts)}; return a list of multiarm.geometry.Contact"
            )
        if not contacts:
            raise ModelError(f"{who} returned no contact; a joint has at least one")
        normals = {""}  # a tangent without a parent belongs to the contact before it
        for k, contact in enumerate(contacts):
            wrong = contact.fault()
            if not wrong and contact.tangent and (k == 0 or contact.parent not in normals):
                wrong = f"parent {shown(contact.parent)}, which is no contact before it"
            if wrong:
                raise ModelError(
                    f"{who} returned contact {shown(contact.name)} with {wrong}; correct it"
                )
            normals |= set() if contact.tangent else {contact.name}
        on_tip = self.on_first.matrix()
        placed = [moved(contact, on_tip, object_pose) for contact in contacts]
        return placed if self.mu is None else _with_friction(placed, self.mu)

    def frames(self, object_pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The frames in which its free motions are expressed, z its axis or normal.

        Returns
        -------
        on_tip, on_object : ndarray, shape (4, 4)
            Poses in the tip frame and in the object frame.
        """
        turn = np.eye(4)
        turn[:3, :3] = basis(self.z_axis)
        return self.on_first.matrix() @ turn, object_pose @ turn

    @classmethod
    def example_text(cls) -> str:
        """The example as part of a scene."""
        head = f"joints:\n  - arm: left\n    kind: {cls.kind_name()}"
        if not cls.example or cls.example[0].isspace():  # a comment on this line, and further lines
            comment, *lines = cls.example.rstrip().split("\n")
        else:
            comment, lines = "", cls.example.rstrip().split("\n")
        return head + comment + indent(dedent("".join(f"\n{line}" for line in lines)), "    ")

    @classmethod
    def sample(cls) -> Self:
        """The joint of the example."""
        (entry,) = parse_yaml(cls.example_text())["joints"]
        return cls.model_validate(entry)

    @classmethod
    def definition_fault(cls) -> str:
        """Why the class cannot be a kind of joint; empty when it can."""
        if cls.kind_fault():
            return cls.kind_fault()
        if cls.records is Joint.records:
            return "it does not define 'records'"
        unlimited = set(cls.limited) - set(cls.model_fields)
        if unlimited:
            return f"'limited' names {sorted(unlimited)[0]!r}, which is no field"
        if not {*(cls.free or ()), *cls.limited.values()} <= set(range(6)):
            return "'free' and 'limited' name components 0 to 5 of the relative motion"
        return cls.example_fault()


def in_scene_of(joint: Joint, objects: tuple[str, ...]) -> Joint:
    """The joint in a scene whose objects have these names."""
    if objects == joint._objects:
        return joint
    joint = BaseModel.model_copy(joint)
    joint._objects = objects
    return joint


class UnloadedJoint(Joint):
    """A joint of which only the frames are known: its contacts need code that is not loaded."""

    model_config = ConfigDict(extra="allow")

    @property
    def pushes(self) -> bool:
        """Perhaps."""
        return True

    def placed(self, object_pose: np.ndarray) -> list[Contact]:
        """No contacts."""
        return []


def _with_friction(contacts: list[Contact], mu: float) -> list[Contact]:
    """The contacts with a coefficient of friction, where they slide and have none of their own."""
    rolling = tangent_rows(contacts)
    return [
        contact
        if contact.tangent or contact.mu is not None or k in rolling
        else replace(contact, mu=mu)
        for k, contact in enumerate(contacts)
    ]


def moved(contact: Contact, on_arm: np.ndarray, on_object: np.ndarray) -> Contact:
    """The contact with the arm's geometry moved by one pose and the object's by another."""
    return contact.mapped(
        lambda surface: surface.moved(on_arm[:3, :3], on_arm[:3, 3]),
        lambda surface: surface.moved(on_object[:3, :3], on_object[:3, 3]),
    )


def turned(contacts: list[Contact], axis: Vector) -> list[Contact]:
    """Contacts written for the z axis, turned so that it becomes ``axis``."""
    turn = np.eye(4)
    turn[:3, :3] = basis(axis)
    return [moved(contact, turn, turn) for contact in contacts]
