"""What joints and surfaces are called, feel like and are written like: words, no numbers.

What can be computed or read elsewhere (rows, free motions, contacts, parameters with defaults and
units) is not said here, see :mod:`multiarm.cli.guide.cards`.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["JOINTS", "SURFACES", "Words"]


@dataclass(frozen=True)
class Words:
    """What is said of a kind.

    Attributes
    ----------
    picture : str
        Something that one knows from daily life, and what it does.
    example : str
        A piece of a scene, YAML.
    as_listed : bool
        Rows, contacts and free motions are whatever the user lists.
    """

    picture: str
    example: str
    as_listed: bool = False


JOINTS: dict[str, Words] = {
    "weld": Words(
        "glued or clamped: tip and object are one body",
        """
joints:
  - arm: left
    kind: weld
""",
    ),
    "ball": Words(
        "a trailer hitch: the tip turns every way about one point of the object",
        """
joints:
  - arm: left
    kind: ball
    at: {xyz: [0.3, 0, 0]}   # that point, in the object frame
""",
    ),
    "revolute": Words(
        "a door hinge: the tip turns about one line fixed in the object",
        """
joints:
  - arm: left
    kind: revolute
    axis: [0, 0, 1]          # that line, in the joint frame
    limits: [-0.5, 1.2]      # from the start; drawn and reported
""",
    ),
    "prismatic": Words(
        "a drawer: the tip slides along one line of the object and does not turn",
        """
joints:
  - arm: left
    kind: prismatic
    axis: [1, 0, 0]
    limits: [-0.05, 0.20]
""",
    ),
    "cylindrical": Words(
        "a rod in a sleeve: the tip turns about one line of the object and slides along it",
        """
joints:
  - arm: left
    kind: cylindrical
    axis: [0, 0, 1]
""",
    ),
    "universal": Words(
        "the cross of a drive shaft: the tip turns about the object's x and about its own y axis",
        """
joints:
  - arm: left
    kind: universal
""",
    ),
    "planar": Words(
        "a puck on ice: the tip slides over a flat face and turns on it, but never lifts or tilts",
        """
joints:
  - arm: left
    kind: planar
    normal: [0, 0, 1]
""",
    ),
    "point_on_plane": Words(
        "a fingertip on a table: it slides and rolls any way, but stays on the flat face",
        """
joints:
  - arm: left
    kind: point_on_plane
    normal: [0, 0, 1]        # out of the object's face
    tip_radius: 0.01
""",
    ),
    "point_on_cylinder": Words(
        "a fingertip on a pipe, or within one: it slides along and around it",
        """
joints:
  - arm: left
    kind: point_on_cylinder
    radius: 0.05
    axis: [0, 0, 1]
    tip_radius: 0.01
""",
    ),
    "point_on_sphere": Words(
        "a fingertip on a ball, or in a bowl: it slides anywhere on it",
        """
joints:
  - arm: left
    kind: point_on_sphere
    radius: 0.05
    inside: true             # a bowl
    tip_radius: 0.01
""",
    ),
    "corner_gripper": Words(
        "four fingertips around the corner of a block: it can be pushed and tipped, not pulled off",
        """
joints:
  - arm: left
    kind: corner_gripper
    tip_radius: 0.01
    at: {xyz: [-0.3, -0.25, 0.2], quaternion_xyzw: [1, 1, 0, 0]}   # the block's corner
""",
    ),
    "contacts": Words(
        "a hand of your own: any list of fingertips and surfaces, each touching in one point",
        """
joints:
  - arm: left
    kind: contacts
    contacts:
      - arm: {sphere: {center: [0, 0.1, 0.21], radius: 0.01}}
        object: {plane: {point: [0, 0, 0.2], normal: [0, 0, 1]}}
        name: finger on the lid
      - arm: {sphere: {center: [0.2, -0.1, 0.21], radius: 0.01}}
        object: {plane: {point: [0, 0, 0.2], normal: [0, 0, 1]}}
        rolling: true        # no slip
""",
        as_listed=True,
    ),
    "wrenches": Words(
        "a joint known by what it bears: the forces and moments it passes on; all else is free",
        """
joints:
  - arm: left
    kind: wrenches           # forces and moments, joint frame: a screw
    wrenches:
      - [1, 0, 0, 0, 0, 0]
      - [0, 1, 0, 0, 0, 0]
      - [0, 0, 1, 0, 0, -0.01]
      - [0, 0, 0, 1, 0, 0]
      - [0, 0, 0, 0, 1, 0]
""",
        as_listed=True,
    ),
}

SURFACES: dict[str, Words] = {
    "point": Words(
        "a needle's tip: it touches any surface of the other body",
        "arm: {point: [0, 0, 0.1]}",
    ),
    "sphere": Words(
        "a fingertip or a ball; inside: a socket or a bowl",
        "object: {sphere: {center: [0, 0, 0], radius: 0.05, inside: true}}",
    ),
    "plane": Words(
        "a table top; here with its edges, a patch",
        "object: {plane: {point: [0, 0, 0.2], normal: [0, 0, 1], "
        "patch: {min: [-0.3, -0.2, null], max: [0.3, 0.2, null]}}}",
    ),
    "cylinder": Words(
        "a pipe or a rail; inside: a bore",
        "object: {cylinder: {point: [0, 0, 0], axis: [0, 0, 1], radius: 0.05}}",
    ),
    "cone": Words(
        "a sharpened pencil; inside: a funnel",
        "object: {cone: {apex: [0, 0, 0], axis: [0, 0, 1], half_angle: 0.6, inside: true}}",
    ),
    "torus": Words(
        "a ring or a doughnut; inside: a curved tube",
        "object: {torus: {center: [0, 0, 0], axis: [0, 0, 1], circle_radius: 0.1, "
        "tube_radius: 0.02}}",
    ),
    "ellipsoid": Words(
        "an egg or a melon; inside: a dish",
        "object: {ellipsoid: {center: [0, 0, 0], semi_axes: [0.1, 0.07, 0.05]}}",
    ),
    "surface": Words(
        "any smooth shape of your own, a Python function: its signed distance or its "
        "parametrisation",
        'object: {surface: {distance: "shapes.py:bump"}}',
    ),
}
