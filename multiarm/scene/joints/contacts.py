r"""A joint as a list of contacts: the surfaces of both bodies, and whether they touch in a point.

Two surfaces that touch share a tangent plane. They touch in that point only, and their common
normal moves smoothly with the bodies, when the sum of their curvatures is positive in every
direction of the plane (a curvature is positive where the body bulges, negative in a hollow). With
principal curvatures :math:`a_1 \ge a_2` and :math:`b_1 \ge b_2` there is a way of turning the two
such that this holds exactly if

.. math:: a_1 + b_2 > 0 \quad\text{and}\quad a_2 + b_1 > 0 .

So a plane meets no cylinder, a bore no cylinder, and a fingertip no narrower bore, but a ring fits
into a bore that is wider than its tube.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from pydantic import model_validator
from typing_extensions import Self

from multiarm.geometry import Contact
from multiarm.scene.faults import invalid
from multiarm.scene.joints.kind import Joint
from multiarm.scene.spec import Spec
from multiarm.scene.surfaces import Geometry, Surface
from multiarm.scene.values import NonNegative, Pose


class ContactSpec(Spec):
    """One frictionless contact: a surface of the arm and one of the object that touch."""

    arm: Geometry
    """The arm's side, in the joint frame at the tip."""
    object: Geometry
    """The object's side, in the joint frame at the object."""
    rolling: bool = False
    """The surfaces do not slip where they touch: two rows more, for the velocities."""
    mu: NonNegative | None = None
    """Coulomb's coefficient of friction; absent: that of the joint or of the scene."""
    bilateral: bool = False
    """The real contact also pulls, as a pin in a slot does: no effect opens it."""
    name: str | None = None
    """A name for reports."""

    @model_validator(mode="after")
    def _slides_or_rolls(self) -> Self:
        if self.rolling and self.mu is not None:
            raise invalid("a contact that rolls does not slide; leave out 'mu' or 'rolling'")
        return self

    @model_validator(mode="after")
    def _touch_in_a_point(self) -> Self:
        a, b = self.arm.value, self.object.value
        reason = _obstacle(a, b) if a is not None and b is not None else None
        if a is not None and b is not None and reason is not None:
            raise invalid(
                f"{a.described()} on the arm and {b.described()} on the object make no point "
                f"contact: {reason}"
            )
        return self


def _obstacle(a: Surface, b: Surface) -> str | None:
    """Why two surfaces cannot touch in a point, with the remedy; None when they can."""
    if a.name == b.name == "point":
        return "two points have no normal; give one body a surface"
    if a.is_hollow and b.is_hollow:
        return "both are touched from within; leave out 'inside' on one body"
    of_a, of_b = a.curvatures(), b.curvatures()
    if of_a is None or of_b is None:
        return None
    (a_1, a_2), (b_1, b_2) = of_a, of_b
    if a_1 + b_2 > 0.0 and a_2 + b_1 > 0.0:
        return None
    if a.is_hollow or b.is_hollow:
        inner, least = (b, b_2) if a.is_hollow else (a, a_2)
        if least == 0.0:
            return f"a {inner.name} is straight and cannot touch a hollow from within"
        return "it does not fit; make the inner surface smaller or the hollow one larger"
    return "they touch along a line or a face; use a sphere, a torus or an ellipsoid on one body"


class ContactsJoint(Joint):
    """Any list of frictionless point contacts.

    Without effects a contact holds the surfaces together. The report says where it pulls, which a
    real one could not, unless it is 'bilateral'. With friction ('mu') it can open and slide.

    Attributes
    ----------
    at : Pose
        Frame in which the object's geometry is given; by default the object frame itself.
    at_tip : Pose
        Frame in which the arm's geometry is given; by default the tip's frame itself.
    at_first : Pose, optional
        The same as 'at_tip'.
    """

    picture = "a hand of your own: any list of fingertips and surfaces, each touching in one point"
    example = """
    contacts:
      - arm: {sphere: {center: [0, 0.1, 0.21], radius: 0.01}}
        object: {plane: {point: [0, 0, 0.2], normal: [0, 0, 1]}}
        name: finger on the lid
      - arm: {sphere: {center: [0.2, -0.1, 0.21], radius: 0.01}}
        object: {plane: {point: [0, 0, 0.2], normal: [0, 0, 1]}}
        rolling: true        # no slip"""
    as_listed = True
    drawn_as = "surfaces"

    kind: Literal["contacts"] = "contacts"
    at: Pose = Pose()
    contacts: tuple[ContactSpec, ...]
    """A list of {arm: ..., object: ...}, at least one. The arm's geometry is given in the tip's
    frame (at_tip), the object's in the object's frame (at), patches too. With 'between', 'arm'
    stands for the first body and 'object' for the second."""

    @model_validator(mode="after")
    def _not_empty(self) -> Self:
        if not self.contacts:
            raise invalid("'contacts' is empty; list at least one contact {arm: ..., object: ...}")
        return self

    @property
    def pushes(self) -> bool:
        """Whether one of them only pushes."""
        return not all(contact.bilateral for contact in self.contacts)

    def records(self) -> list[Contact]:
        """One row for each contact, two more for a rolling one; functions are loaded already."""
        rows = []
        for k, spec in enumerate(self.contacts):
            name = spec.name or f"contact {k + 1}"
            normal = Contact(
                name,
                spec.arm.record(),
                spec.object.record(),
                pushes_only=not spec.bilateral,
                mu=spec.mu,
            )
            rows.append(normal)
            for tangent in (1, 2) if spec.rolling else ():
                row = f"{name}, no slip {tangent}"
                rows.append(
                    replace(normal, name=row, tangent=tangent, pushes_only=False, parent=name)
                )
        return rows
