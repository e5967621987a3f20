"""Channels: the recorded quantities of a run, each an array over the samples.

A channel is one physical quantity sampled K times: `object/position` is (K, 3) metres in world
axes, `arms/left/joint_torque` is (K, nv). A `Channel` describes its numbers (unit, frame,
description, a label per column), so that a file can be read without this program.

The channels of several objects are `objects/beam/position` and the like, and those of their
contacts with the floor `environment/beam/contact_force`; one object, whatever its name, has
`object/position` and `environment/contact_force`.

A run produces its samples as rows of numbers, shape (K, width). Columns are the places of the
channels in a row, so that rows are split into channels only when one is read.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from multiarm.errors import TrajectoryError
from multiarm.results.contact_states import RECORDED_STATES

CLOSED = "this trajectory was closed; load it from its file, or simulate again"
"""Message for reading a channel whose samples were released."""
Columns = dict[str, slice]
"""Channel -> its numbers in a row."""
OBJECT, OBJECTS, ARMS, ENVIRONMENT, EFFECTS = "object", "objects", "arms", "environment", "effects"
"""Groups of channels; others, such as ``energy``, are of the whole run."""
FLOOR = "floor"
"""Owner of the contacts of an object with its surroundings; of several objects ``floor/beam``."""
NAMES_OF_OBJECTS = "objects"
"""Entry of a result's metadata: the names of the objects, in the order of the scene."""
# Quantities of a robot's joints.
_OF_JOINTS = ("joint_position", "joint_velocity", "joint_torque")
# Descriptions of forces: of a connection on its second body, of rows of joints, of the floor.
_CONTACT_FORCES = "force at each contact along its normal; positive pushes the {}"
_JOINT_FORCES = (
    "torque (force, if the joint slides) of joints' stops, dry friction and couplings; positive "
    "drives the joint along the row's direction"
)
_FLOOR_FORCES = "force of the floor at each contact along its normal; positive pushes the {}"


class Owner(NamedTuple):
    """Whose quantity a channel has.

    Attributes
    ----------
    group : str
        The first part of the channel's name; empty for the time.
    name : str
        Of the arm, the effect or one of several objects; empty where a group has one owner only.
    """

    group: str
    name: str = ""


@dataclass(frozen=True)
class Channel:
    """One recorded quantity."""

    name: str  # path such as `object/position` or `arms/left/contact_force`
    shape: tuple[int, ...] = ()  # of one sample: `()` for a scalar, `(6,)` for a twist
    unit: str = "1"  # of all columns, or one per column separated by `, `
    frame: str = ""  # axes of the numbers; empty for a scalar
    description: str = ""  # with the sign
    labels: tuple[str, ...] = ()  # one per column; empty for a scalar

    def __post_init__(self) -> None:
        if any(part in ("", ".", "..") for part in self.name.split("/")):
            raise TrajectoryError(
                f"channel name {self.name!r} has an empty, '.' or '..' part; "
                "name the arm with letters, digits, '_' or '-'"
            )

    @cached_property
    def _path(self) -> tuple[Owner, str]:
        """Owner and quantity; names of arms may have several parts."""
        path, _, quantity = self.name.rpartition("/")
        return Owner(*path.split("/", 1)), quantity

    @property
    def owner(self) -> Owner:
        """Whose quantity it is."""
        return self._path[0]

    @property
    def quantity(self) -> str:
        """What it is of its owner, such as ``contact_force``."""
        return self._path[1]

    @cached_property
    def width(self) -> int:
        """Numbers per sample."""
        return math.prod(self.shape)

    @property
    def column_units(self) -> tuple[str, ...]:
        """Unit of each column."""
        units = tuple(self.unit.split(", "))
        return units if len(units) == self.width else (self.unit,) * self.width

    @property
    def column_labels(self) -> tuple[str, ...]:
        """Label of each column; its number where there is none."""
        return self.labels or tuple(str(column + 1) for column in range(self.width))


def width_of(channels: Iterable[Channel]) -> int:
    """Numbers of a sample."""
    return sum(channel.width for channel in channels)


def in_sequence(channels: Iterable[Channel]) -> Columns:
    """Columns of rows in which the channels follow each other."""
    columns, end = {}, 0
    for channel in channels:
        columns[channel.name] = slice(end, end + channel.width)
        end += channel.width
    return columns


LARGEST = 1e150
"""Of numbers in results: the squares of larger ones overflow, in figures and replays too."""


def recordable(values: np.ndarray) -> np.ndarray:
    """Which numbers a result may hold: finite ones up to :data:`LARGEST`."""
    return np.abs(values) <= LARGEST  # not a number is not less than one either


def first_fault(channels: Sequence[Channel], columns: Columns, rows: np.ndarray) -> tuple[int, str]:
    """The first sample with a number that no result holds, and the sentence that reports it."""
    sample = int(np.argmin(recordable(rows).all(axis=1)))
    row, time = rows[sample], rows[sample, columns["time"]].item()
    channel = next(c for c in channels if not recordable(row[columns[c.name]]).all())
    numbers = row[columns[channel.name]]
    k = int(np.argmin(recordable(numbers)))
    where = f" ({channel.labels[k]})" if channel.labels else ""
    when = f"t = {time:.9g} s" if math.isfinite(time) else f"sample {sample} of a block"
    return sample, (
        f"channel '{channel.name}'{where} is {numbers[k]} at {when}: "
        "the sample and all after it were not recorded"
    )


def arm_channel(arm: str, quantity: str) -> str:
    """Name of the channel of an arm's quantity."""
    return f"{ARMS}/{arm}/{quantity}"


def arm_names(channels: Mapping[str, Channel]) -> tuple[str, ...]:
    """Names of the robots that have channels, in the order of the scene."""
    of_joints = [c.owner for c in channels.values() if c.quantity in _OF_JOINTS]
    return tuple(dict.fromkeys(owner.name for owner in of_joints if owner.group == ARMS))


def owner_names(channels: Mapping[str, Channel]) -> tuple[str, ...]:
    """Names of all robots and connections that have channels, in the order of the scene."""
    owners = (channel.owner for channel in channels.values())
    return tuple(dict.fromkeys(owner.name for owner in owners if owner.group == ARMS))


def contact_owners(channels: Mapping[str, Channel]) -> tuple[str, ...]:
    """Names of the arms and connections whose contacts have channels, in the order of the scene."""
    for quantity in ("wrench", "contact_force"):  # results of earlier versions have no wrenches
        owners = [c.owner for c in channels.values() if c.quantity == quantity]
        names = tuple(owner.name for owner in owners if owner.group == ARMS)
        if names:
            return names
    return ()


def base_names(channels: Mapping[str, Channel]) -> tuple[str, ...]:
    """Names of the robots whose base floats, in the order of the scene."""
    return tuple(
        channel.owner.name
        for channel in channels.values()
        if channel.owner.group == ARMS and channel.quantity == "base_position"
    )


def object_paths(channels: Mapping[str, Channel]) -> dict[str, str]:
    """Object -> the path of its channels, in the order of the scene; one alone is ``object``."""
    owners = (channel.owner for channel in channels.values())
    names = dict.fromkeys(owner.name for owner in owners if owner.group == OBJECTS)
    return {name: f"{OBJECTS}/{name}" for name in names} or {OBJECT: OBJECT}


def named_object_paths(
    channels: Mapping[str, Channel], metadata: Mapping[str, Any]
) -> dict[str, str]:
    """The same with the name of one alone, which the metadata of a run have.

    Results of earlier versions have none.
    """
    paths = object_paths(channels)
    match metadata.get(NAMES_OF_OBJECTS):
        case [str(name)] if len(paths) == 1:
            return {name: next(iter(paths.values()))}
    return paths


def channels_of(channels: Mapping[str, Channel], quantity: str) -> dict[str, str]:
    """Owner of rows -> name of its channel of a quantity, of the channels of a run.

    Owners are arms and connections, and ``floor`` or, of several objects, ``floor/beam``.
    """
    of_quantity = [channel for channel in channels.values() if channel.quantity == quantity]
    names = {c.owner.name: c.name for c in of_quantity if c.owner.group == ARMS}
    for channel in of_quantity:
        group, name = channel.owner
        if group == ENVIRONMENT:
            owner = f"{FLOOR}/{name}" if name else FLOOR
            names.setdefault(owner, channel.name)  # an arm may have this name
    return names


def is_floor(owner: str) -> bool:
    """Whether an owner of rows stands for contacts of an object with its surroundings."""
    return owner.partition("/")[0] == FLOOR


def environment_paths(channels: Mapping[str, Channel]) -> tuple[str, ...]:
    """The paths of the channels of objects' contacts with what stands still."""
    owners = (channel.owner for channel in channels.values())
    paths = ("/".join(owner).rstrip("/") for owner in owners if owner.group == ENVIRONMENT)
    return tuple(dict.fromkeys(paths))


def work_channels(channels: Mapping[str, Channel]) -> dict[str, str]:
    """Effect -> name of the channel of its work, of the channels of a run."""
    return {
        channel.owner.name: channel.name
        for channel in channels.values()
        if channel.owner.group == EFFECTS and channel.quantity == "work"
    }


class RowOwner(NamedTuple):
    """Whose rows of W some are, where that is not an arm with one tip at the object."""

    robot: str  # empty where no robot takes part
    second: str  # the body on which the forces act; empty where the rows are those of joints
    first_is_link: bool  # the first body has the motion of a tip
    on_object: bool  # the forces act on an object


def trajectory_channels(
    joints: Mapping[str, Mapping[str, str]],
    contacts: Mapping[str, Sequence[str]],
    free: Mapping[str, Mapping[str, str]] | None = None,
    works: Sequence[str] = (),
    states: Mapping[str, Sequence[str]] | None = None,
    environment: Mapping[str, Sequence[str]] | None = None,
    controlled: bool = False,
    owners: Mapping[str, RowOwner] | None = None,
    bases: Sequence[str] = (),
    objects: Sequence[str] = (OBJECT,),
) -> tuple[Channel, ...]:
    """The channels of a run: time, objects, robots and contacts, floor, effects, energy and drift.

    Parameters
    ----------
    joints : mapping
        Robot -> (joint name -> unit of its coordinate, `"rad"` or `"m"`), from base to tips.
    contacts : mapping
        Owner of rows -> name of each contact, in the order of the rows of W.
    free : mapping
        Owner -> (free motion of its connection -> unit of its coordinate).
    works : sequence of str
        Names of the effects whose work is recorded.
    states : mapping
        Owner of rows, the floor's too -> names of its contacts that can open, slide or stick.
    environment : mapping, optional
        ``"floor"``, or ``"floor/NAME"`` of several objects -> names of the rows of the contacts
        with the floor.
    controlled : bool
        Whether the robots have a control, whose power is recorded.
    owners : mapping, optional
        Those that are no arms: the others are robots too, with one tip at the object.
    bases : sequence of str
        Names of the robots whose base floats.
    objects : sequence of str
        Names of the objects, in the order of the scene.
    """
    free, states, owners = free or {}, states or {}, owners or {}
    channels = [Channel("time", (), "s", "", "time of the sample")]
    for path, name in _paths_of_objects(objects):
        channels += _motion_channels(f"{path}/", name, "centre of mass")
    facts = {name: owners.get(name, RowOwner(name, OBJECT, True, True)) for name in contacts}
    for robot, units in joints.items():
        channels += _arm_channels(f"arms/{robot}", units)
        if controlled:
            channels.append(control_power_channel(f"arms/{robot}"))
        if robot in bases:
            channels += base_channels(f"arms/{robot}")
        for owner in (name for name, fact in facts.items() if fact.robot == robot):
            channels += _owner_channels(
                owner, facts[owner], contacts[owner], states.get(owner, ()), free.get(owner, {})
            )
    for owner in (name for name, fact in facts.items() if not fact.robot):
        channels += _owner_channels(
            owner, facts[owner], contacts[owner], states.get(owner, ()), free.get(owner, {})
        )
    for owner, rows in (environment or {}).items():
        name = owner.partition("/")[2]
        path, force = f"{ENVIRONMENT}/{name}".rstrip("/"), _FLOOR_FORCES.format(name or OBJECT)
        channels += _contact_channels(path, rows, states.get(owner, ()), force)
        channels.append(wrench_channel(path, name or OBJECT))
    scalars = [
        *((f"effects/{name}/work", "J", f"work done by {name} since the start") for name in works),
        ("energy/kinetic", "J", "kinetic energy of the arms and the object"),
        ("energy/potential", "J", "potential energy in the field of gravity"),
        ("energy/work", "J", "work done by control and effects since the start"),
        ("drift/position", "m", "largest gap of a contact, max |phi|"),
        ("drift/velocity", "m/s", "largest rate of a gap, max |W^T v|"),
        ("solver/rank", "1", "independent constraints"),
        ("solver/coupled_arms", "1", "arms that were solved in the coupled system"),
        (
            "solver/residual", "1",
            "largest relative residual of the constraints or of the object's motion",
        ),
    ]  # fmt: skip
    channels += [Channel(name, (), unit, "", text) for name, unit, text in scalars]
    return tuple(channels)


def _paths_of_objects(names: Sequence[str]) -> list[tuple[str, str]]:
    """Path of the channels of each object, and what descriptions call it."""
    if len(names) == 1:
        return [(OBJECT, OBJECT)]
    return [(f"{OBJECTS}/{name}", name) for name in names]


def _owner_channels(
    owner: str,
    fact: RowOwner,
    contacts: Sequence[str],
    with_states: Sequence[str],
    free: Mapping[str, str],
) -> list[Channel]:
    """The channels of an owner of rows: forces, states, free motions, wrench and tip."""
    path = f"{ARMS}/{owner}"
    force = _CONTACT_FORCES.format(fact.second) if fact.second else _JOINT_FORCES
    channels = _contact_channels(path, contacts, with_states, force)
    if free:
        channels += _free_channels(path, free, fact.first_is_link and fact.on_object)
    if fact.second:
        channels.append(wrench_channel(path, fact.second, fact.on_object))
    if fact.first_is_link:
        channels += tip_channels(path)
    return channels


def tip_channels(path: str) -> list[Channel]:
    """The channels of a tip's motion, which have the same shapes for all."""
    return _motion_channels(f"{path}/tip_", "tip", "origin")


def base_channels(path: str) -> list[Channel]:
    """The channels of a floating base's motion, which have the same shapes for all."""
    return _motion_channels(f"{path}/base_", "base", "origin")


def control_power_channel(path: str) -> Channel:
    """The channel of the power of the control on an arm."""
    return Channel(
        f"{path}/control_power", (), "W", "",
        "power of the drives' torques, sum of torque times joint velocity; positive drives the arm",
    )  # fmt: skip


def wrench_channel(path: str, body: str = OBJECT, on_object: bool = True) -> Channel:
    """The channel of the wrench of a connection, or of the floor, on its second body."""
    about = f"{body}'s centre of mass" if on_object else "origin of the joint's frame on it"
    return Channel(
        f"{path}/wrench", (6,), ", ".join(["N"] * 3 + ["N m"] * 3), "world",
        f"resultant of the contact forces and friction on the {body}: force, then moment about the "
        f"{about}", ("fx", "fy", "fz", "mx", "my", "mz"),
    )  # fmt: skip


def _motion_channels(prefix: str, frame: str, point: str) -> list[Channel]:
    xyz = ("x", "y", "z")
    return [
        Channel(f"{prefix}position", (3,), "m", "world", f"{point} of the {frame}", xyz),
        Channel(
            f"{prefix}quaternion_xyzw", (4,), "1", f"{frame} axes in world axes",
            f"orientation of the {frame}, unit quaternion, scalar last", (*xyz, "w"),
        ),
        Channel(
            f"{prefix}twist", (6,), ", ".join(["m/s"] * 3 + ["rad/s"] * 3), "world",
            f"velocity of the {frame}'s {point}, then its angular velocity",
            ("vx", "vy", "vz", "wx", "wy", "wz"),
        ),
    ]  # fmt: skip


def _arm_channels(path: str, units: Mapping[str, str]) -> list[Channel]:
    joints, n, order = tuple(units), (len(units),), "joints, base to tip"
    positions = ", ".join(units.values())
    velocities = ", ".join(f"{unit}/s" for unit in units.values())
    torques = ", ".join("N" if unit == "m" else "N m" for unit in units.values())
    return [
        Channel(f"{path}/joint_position", n, positions, order, "joint coordinate", joints),
        Channel(f"{path}/joint_velocity", n, velocities, order, "joint velocity", joints),
        Channel(
            f"{path}/joint_torque", n, torques, order,
            "torque (force, if the joint slides) of the drive: the controller's, within limits and "
            "lag of the drive if there are any", joints,
        ),
    ]  # fmt: skip


def _contact_channels(
    path: str, contacts: Sequence[str], with_states: Sequence[str], force: str
) -> list[Channel]:
    channels = [
        Channel(
            f"{path}/contact_force", (len(contacts),), "N", "contact normals", force,
            tuple(contacts),
        )
    ]  # fmt: skip
    if with_states:
        codes = ", ".join(f"{state.value} {state.word}" for state in RECORDED_STATES)
        shape, labels = (len(with_states),), tuple(with_states)
        channels.append(Channel(f"{path}/contact_state", shape, "1", "", codes, labels))
    return channels


def _free_channels(path: str, free: Mapping[str, str], of_arm: bool) -> list[Channel]:
    first, second = ("arm", "object") if of_arm else ("first body", "second body")
    labels, n, frame = tuple(free), (len(free),), f"joint frame on the {second}"
    return [
        Channel(
            f"{path}/relative_rate", n, ", ".join(f"{unit}/s" for unit in free.values()), frame,
            f"free motion of the {first}'s joint frame relative to the {second}'s: its rates",
            labels,
        ),
        Channel(
            f"{path}/relative_position", n, ", ".join(free.values()), frame,
            f"translation, and angle (several: rotation vector), of the {first}'s joint frame seen "
            f"from the {second}'s", labels,
        ),
    ]  # fmt: skip
