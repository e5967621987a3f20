"""Values by joint and by arm.

A quantity of joints (posture, torque, gain, ...) may be written as one number for all joints, as a
list from base to tip, or as a table ``joint: value``.  A quantity of all arms may be one of these
for every arm alike, or a table ``arm: value``; where robots' files have such numbers too, ``urdf``
stands for these, for all arms or for one.  Robots with several tips take part as arms do; their
joints are listed in the order of :attr:`multiarm.scene.resolution.ResolvedRobot.joints`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, TypeAdapter

from multiarm.notation import count_of
from multiarm.scene.bodies import OBJECT_NAME
from multiarm.scene.faults import Faults, Parts, invalid, listed, shown, unknown
from multiarm.scene.urdf import JointOutline
from multiarm.scene.values import Number, as_list, finite_number, number_list

if TYPE_CHECKING:
    import numpy as np

URDF = "urdf"
"""Stands for the numbers in the robot's file."""
SOLVE = "solve"
"""Stands for a posture that the program finds."""


def _with_text_keys(value: Mapping) -> Mapping:
    for key in value:
        if not isinstance(key, str):
            raise invalid(f"names must be text, got {shown(key)}; put quotes around it")
    return value


_joint_table = TypeAdapter(dict[str, Number]).validate_python


def _joint_values(value: Any) -> tuple[float, ...] | dict[str, float]:
    value = as_list(value)
    if isinstance(value, Mapping):
        return _joint_table(_with_text_keys(value))
    if isinstance(value, (list, tuple)):
        return number_list(value)
    raise invalid(f"must be a list (base to tip) or a table 'joint: value', got {shown(value)}")


def _number_or_joint_values(value: Any) -> Any:
    value = as_list(value)
    many = isinstance(value, (list, tuple, Mapping))
    return _joint_values(value) if many else finite_number(value)


_arm_table = TypeAdapter(
    dict[str, Annotated[Any, BeforeValidator(_number_or_joint_values)]]
).validate_python


def _per_arm(value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise invalid(f"must be a table 'arm: values', got {shown(value)}")
    return _arm_table(_with_text_keys(value))


def _gain(value: Any) -> Any:
    value = as_list(value)
    gain = _per_arm(value) if isinstance(value, Mapping) else _number_or_joint_values(value)
    lowest = min(_leaves(gain), default=0.0)
    if lowest < 0.0:
        raise invalid(f"must not be negative, got {lowest}")
    return gain


def _leaves(value: Any) -> list[float]:
    if isinstance(value, Mapping):
        return [leaf for item in value.values() for leaf in _leaves(item)]
    return list(value) if isinstance(value, tuple) else [value]


def _gain_or_urdf(value: Any) -> Any:
    if _is_urdf(value):
        return value
    if isinstance(value, str):
        raise invalid(f"must be a number, a list, a table or {URDF!r}, got {shown(value)}")
    if not isinstance(value, Mapping):
        return _gain(value)
    numbers = _gain({arm: 0.0 if _is_urdf(gain) else gain for arm, gain in value.items()})
    return {arm: URDF if _is_urdf(value[arm]) else gain for arm, gain in numbers.items()}


def _is_urdf(value: Any) -> bool:
    return isinstance(value, str) and value == URDF


def _posture(value: Any) -> Any:
    if not isinstance(value, str):
        return _joint_values(value)
    if value != SOLVE:
        raise invalid(f"must be a list, a table 'joint: value' or {SOLVE!r}, got {shown(value)}")
    return value


JointValues = Annotated[tuple[float, ...] | dict[str, float], BeforeValidator(_joint_values)]
Posture = Annotated[
    tuple[float, ...] | dict[str, float] | Literal["solve"], BeforeValidator(_posture)
]
PerArm = Annotated[
    dict[str, float | tuple[float, ...] | dict[str, float]], BeforeValidator(_per_arm)
]
Gain = Annotated[
    float | tuple[float, ...] | dict[str, float | tuple[float, ...] | dict[str, float]],
    BeforeValidator(_gain),
]
_Urdf = Literal["urdf"]
UrdfGain = Annotated[
    float
    | _Urdf
    | tuple[float, ...]
    | dict[str, float | _Urdf | tuple[float, ...] | dict[str, float]],
    BeforeValidator(_gain_or_urdf),
]


def joint_vector(
    values: float | Sequence[float] | Mapping[str, float] | None,
    joint_names: Sequence[str],
    default: np.ndarray | float = 0.0,
) -> np.ndarray:
    """One value per movable joint from base to tip, shape (n,).

    Joints that ``values`` does not name get the default, one number or shape (n,).

    Raises
    ------
    ValueError
        If a list has another length than n, or a table names other joints.
    """
    import numpy as np

    names = list(joint_names)
    faults = [message for _, message in joint_value_faults(values, names)]
    if faults:
        raise ValueError("; ".join(faults))
    result = np.full(len(names), default, dtype=float)
    if isinstance(values, Mapping):
        for joint, value in values.items():
            result[names.index(joint)] = value
    elif values is not None:
        result[:] = values
    return result


def gain_vector(
    gain: float | Sequence[float] | Mapping[str, Any] | None,
    arm: str,
    joint_names: Sequence[str],
) -> np.ndarray:
    """One value per joint of ``arm``, shape (n,); zero for joints and arms that are not named."""
    value = gain.get(arm) if isinstance(gain, Mapping) else gain
    return joint_vector(value, joint_names)


def joint_value_faults(
    values: float | Sequence[float] | Mapping[str, float] | None,
    joint_names: Sequence[str],
    held: Mapping[str, str] | None = None,
) -> Faults:
    """Faults with respect to the joints; ``held`` says of other joints why they do not move."""
    names = list(joint_names)
    if isinstance(values, Mapping):
        reasons = held or {}
        return [
            ((j,), f"joint {j!r} {reasons[j]}" if j in reasons else unknown("joint", j, names))
            for j in values
            if j not in names
        ]
    if values is None or isinstance(values, (float, Real)) or len(values) == len(names):
        return []
    message = (
        f"{count_of(len(values), 'value')} for {count_of(len(names), 'movable joint')}; "
        f"give one each, base to tip: {listed(names)}"
    )
    return [((), message)]


@dataclass
class KnownRobot:
    """The facts of an arm or robot for the checks of a scene; None where it has faults.

    Attributes
    ----------
    joints : tuple of JointOutline
        The moving ones, of an arm from base to tip.
    links : tuple of str
        All links, of the robot and of its tool.
    moving : tuple of str
        Those that the moving joints carry.
    tips : dict of str to str
        Of a robot, the links of its tips by name; None for an arm, whose only tip has no name.
    carriers : dict of str to str
        Of a robot, the last joint that moves each link of ``moving``: links with one carrier are
        parts of one rigid body.
    ways : dict of str to tuple of str
        Of a robot, the moving joints of its file on the way to each of ``tips``, and to each
        further link that joints of the scene name.
    held : dict of str to str
        Joints that do not move, and why: the end of a sentence about the joint.
    shown_by : str or None
        The command that shows all links.
    """

    joints: tuple[JointOutline, ...] | None = None
    links: tuple[str, ...] | None = None
    moving: tuple[str, ...] = ()
    tips: Mapping[str, str] | None = None
    carriers: Mapping[str, str] = field(default_factory=dict)
    ways: dict[str, tuple[str, ...]] = field(default_factory=dict)
    held: Mapping[str, str] = field(default_factory=dict)
    shown_by: str | None = None

    @property
    def joint_names(self) -> tuple[str, ...] | None:
        """Names of the movable joints."""
        return None if self.joints is None else tuple(joint.name for joint in self.joints)


class KnownRobots(dict[str, KnownRobot]):
    """The arms and robots of a scene by name, and the names of its connections and objects."""

    def __init__(
        self,
        robots: Mapping[str, KnownRobot] | None = None,
        connections: Iterable[str] = (),
        objects: Iterable[str] = (OBJECT_NAME,),
    ) -> None:
        super().__init__(robots or {})
        self.connections, self.objects = tuple(connections), tuple(objects)


def unknown_robot(name: object, robots: KnownRobots) -> str:
    """The message that neither an arm nor a robot has this name."""
    if all(robot.tips is None for robot in robots.values()):
        return unknown("arm", name, robots)
    return unknown("arm or robot", name, robots, "arms and robots")


def unknown_connection(name: str, robots: KnownRobots, contacts: bool = False) -> str:
    """The message that no joint has this name; empty where one has it.

    With ``contacts``, a name may also be that of a contact, ``connection/contact``.
    """
    arms = [arm for arm, robot in robots.items() if robot.tips is None]
    known = list(dict.fromkeys([*arms, *robots.connections]))
    if any(name == joint or (contacts and name.startswith(f"{joint}/")) for joint in known):
        return ""
    if known == list(robots):
        return unknown("arm", name.partition("/")[0] if contacts else name, known)
    return unknown("joint", name, known)


def gain_faults(
    value: Any,
    arms: KnownRobots,
    in_urdf: Callable[[JointOutline], float] | None = None,
    what: str = "",
) -> Faults:
    """Faults of a value for all arms, or of a table by arm, with respect to the arms.

    ``in_urdf`` gives a joint the number, called ``what``, of the robot's file, which must not be
    negative where ``value`` refers to it.
    """
    if value is None:
        return []
    by_arm = isinstance(value, Mapping)
    faults: Faults = []
    for arm, gain in (value if by_arm else dict.fromkeys(arms, value)).items():
        where: Parts = (arm,) if by_arm else ()
        if arm not in arms:
            faults.append((where, unknown_robot(arm, arms)))
            continue
        names = arms[arm].joint_names
        if names is None or _is_urdf(gain):
            continue
        subject = "" if by_arm else f"arm {arm!r}: "
        for further, text in joint_value_faults(gain, names, arms[arm].held):
            faults.append(((*where, *further), f"{subject}{text}"))
    if in_urdf is None:
        return faults
    for where, arm in _arms_by_urdf(value, arms):
        wrong = [j.name for j in arms[arm].joints or () if not in_urdf(j) >= 0.0]
        if wrong:
            text = f"the URDF of arm {arm!r} gives {listed(wrong)} a {what} that is no number >= 0"
            faults.append((where, f"{text}; correct the file, or write numbers here"))
    return faults


def urdf_warnings(
    value: Any, arms: KnownRobots, in_urdf: Callable[[JointOutline], Any], what: str
) -> Faults:
    """Arms whose robots' files have no such number, where ``value`` refers to these files."""
    return [
        (where, f"the URDF of arm {arm!r} gives no joint a {what}; write numbers to give them some")
        for where, arm in _arms_by_urdf(value, arms)
        if not any(in_urdf(joint) for joint in arms[arm].joints or ())
    ]


def _arms_by_urdf(value: Any, arms: Iterable[str]) -> list[tuple[Parts, str]]:
    """Arms whose numbers are those of their robots' files, and where a scene says so."""
    if isinstance(value, Mapping):
        return [((arm,), arm) for arm in arms if _is_urdf(value.get(arm))]
    return [((), arm) for arm in arms] if _is_urdf(value) else []
