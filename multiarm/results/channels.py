"""What a run records: named channels, each an array over the samples.

A channel is one physical quantity sampled K times: `object/position` is (K, 3) metres in
world axes, `arms/left/joint_torque` is (K, nv). A `Channel` says what its numbers mean (unit,
frame, description, a label per column), so that a file can be read without this program.
Every block of samples passes `finite_rows` on its way to a sink: a number that is not finite
never gets any further, and the error names the channel, the column and the time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from multiarm.errors import TrajectoryError

Block = dict[str, np.ndarray]
"""Samples of all channels: name -> array whose leading axis counts the samples."""
FLOOR = "floor"
"""What stands in an arm's place where contacts are the object's own, with its surroundings."""
CONTACT_STATES = ("open", "touching", "sliding", "sticking", "resting")
"""What a contact does, by its code in a channel; resting: it touches, and other contacts carry."""
OPEN, TOUCHING, SLIDING, STICKING, RESTING = range(len(CONTACT_STATES))
CLOSED = "this trajectory was closed; load it from its file, or simulate again"
"""What is wrong when samples are asked for that were let go of."""


@dataclass(frozen=True)
class Channel:
    """One recorded quantity.

    Parameters
    ----------
    name : str
        Path such as `object/position` or `arms/left/contact_force`.
    shape : tuple of int
        Shape of one sample: `()` for a scalar, `(6,)` for a twist.
    unit : str
        One unit for all columns, or one per column separated by `, `.
    frame : str
        Axes in which the numbers are given; empty for a scalar.
    description : str
        What the number is, with its sign.
    labels : tuple of str
        One label per column; empty for a scalar.
    """

    name: str
    shape: tuple[int, ...] = ()
    unit: str = "1"
    frame: str = ""
    description: str = ""
    labels: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        if any(part in ("", ".", "..") for part in self.name.split("/")):
            raise TrajectoryError(
                f"channel name {self.name!r} has an empty, '.' or '..' part; "
                "name the arm with letters, digits, '_' or '-'"
            )

    @property
    def column_units(self) -> tuple[str, ...]:
        """Unit of each column."""
        width = int(np.prod(self.shape, dtype=int))
        units = tuple(self.unit.split(", "))
        return units if len(units) == width else (self.unit,) * width


def trajectory_channels(
    joints: Mapping[str, Mapping[str, str]],
    contacts: Mapping[str, Sequence[str]],
    free: Mapping[str, Mapping[str, str]] | None = None,
    works: Sequence[str] = (),
    states: Mapping[str, Sequence[str]] | None = None,
    environment: Sequence[str] = (),
) -> tuple[Channel, ...]:
    """The channels of a run.

    Parameters
    ----------
    joints : mapping
        Arm name -> (joint name -> unit of its coordinate, `"rad"` or `"m"`), in chain order.
    contacts : mapping
        Arm name -> name of each contact, in the order of the rows of W.
    free : mapping
        Arm name -> (free motion of its joint to the object -> unit of its coordinate).
    works : sequence of str
        Names of the effects whose work is recorded.
    states : mapping
        Arm name, or ``"floor"`` -> names of its contacts that can open, slide or stick.
    environment : sequence of str
        Names of the rows of the object's contacts with the floor.

    Returns
    -------
    tuple of Channel
        Time first, then the object, the arms, the floor, effects, energy and drift.
    """
    channels = [Channel("time", (), "s", "", "time of the sample")]
    channels += _object_channels()
    for arm, units in joints.items():
        channels += _arm_channels(arm, units, contacts[arm])
        channels += _state_channels(f"arms/{arm}", (states or {}).get(arm, ()))
        channels += _free_channels(arm, (free or {}).get(arm, {}))
    channels += _floor_channels(environment)
    channels += _state_channels("environment", (states or {}).get(FLOOR, ()))
    channels += [
        Channel(f"effects/{name}/work", (), "J", "", f"work done by {name} since the start")
        for name in works
    ]
    return (*channels, *_scalar_channels())


def finite_rows(channels: Sequence[Channel], block: Block) -> tuple[Block, str]:
    """The leading samples of a block in which every number is finite.

    Parameters
    ----------
    channels : sequence of Channel
    block : dict of array-like
        All channels, with the same number of samples each.

    Returns
    -------
    rows : dict of ndarray
        Copies in double precision, cut before the first sample that is not finite.
    fault : str
        Empty, or the sentence that names channel, column and time of the first bad number.

    Raises
    ------
    TrajectoryError
        A channel is missing, unknown, or has the wrong shape.
    """
    arrays = _shaped(channels, block)
    with np.errstate(over="ignore", invalid="ignore"):
        # a number that is not finite stays so in the sum, which is the quicker test
        if math.isfinite(np.concatenate([v.ravel() for v in arrays.values()]).sum()):
            return arrays, ""
    first, culprit = len(arrays["time"]), None
    for channel in channels:
        values = arrays[channel.name]
        bad = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
        row = int(np.argmax(bad)) if bad.any() else first
        if row < first:
            first, culprit = row, channel
    rows = {name: values[:first] for name, values in arrays.items()}
    return rows, "" if culprit is None else _fault(culprit, arrays, first)


def _fault(channel: Channel, arrays: Block, row: int) -> str:
    sample = np.atleast_1d(arrays[channel.name][row]).ravel()
    column = int(np.argmin(np.isfinite(sample)))
    where = f" ({channel.labels[column]})" if channel.labels else ""
    time = arrays["time"]
    when = f"t = {time[row]:.9g} s" if np.isfinite(time[row]) else f"sample {row} of a block"
    return (
        f"channel '{channel.name}'{where} is {sample[column]} at {when}: "
        "the sample and all after it were not recorded"
    )


def _shaped(channels: Sequence[Channel], block: Block) -> Block:
    names = {channel.name for channel in channels}
    if names != set(block):
        lacking, extra = sorted(names - set(block)), sorted(set(block) - names)
        raise TrajectoryError(
            f"a block of samples lacks the channels {lacking} and has the unknown channels {extra}"
        )
    arrays = {c.name: np.array(block[c.name], dtype=np.float64, order="C") for c in channels}
    samples = arrays["time"].shape[0] if arrays["time"].ndim == 1 else -1
    for channel in channels:
        shape = arrays[channel.name].shape
        if shape != (samples, *channel.shape):
            raise TrajectoryError(
                f"channel '{channel.name}' has a block of shape {shape}; "
                f"expected {('K', *channel.shape)} with K = {samples} samples as in 'time'"
            )
    return arrays


def _object_channels() -> list[Channel]:
    xyz = ("x", "y", "z")
    twist = tuple(f"{kind}{axis}" for kind in ("v", "w") for axis in xyz)
    twist_units = ", ".join(["m/s"] * 3 + ["rad/s"] * 3)
    return [
        Channel("object/position", (3,), "m", "world", "centre of mass of the object", xyz),
        Channel(
            "object/quaternion_xyzw", (4,), "1", "object axes in world axes",
            "orientation of the object, unit quaternion, scalar last", (*xyz, "w"),
        ),
        Channel(
            "object/twist", (6,), twist_units, "world",
            "velocity of the object's centre of mass, then its angular velocity", twist,
        ),
    ]  # fmt: skip


def _arm_channels(arm: str, units: Mapping[str, str], contacts: Sequence[str]) -> list[Channel]:
    joints, n = tuple(units), (len(units),)
    positions = ", ".join(units.values())
    velocities = ", ".join(f"{unit}/s" for unit in units.values())
    torques = ", ".join("N" if unit == "m" else "N m" for unit in units.values())
    path, order = f"arms/{arm}", "joints, base to tip"
    return [
        Channel(f"{path}/joint_position", n, positions, order, "joint coordinate", joints),
        Channel(f"{path}/joint_velocity", n, velocities, order, "joint velocity", joints),
        Channel(
            f"{path}/joint_torque", n, torques, order,
            "torque (force, if the joint slides) of the drive: the controller's, within limits and "
            "lag of the drive if there are any", joints,
        ),
        Channel(
            f"{path}/contact_force", (len(contacts),), "N", "contact normals",
            "force at each contact along its normal; positive pushes the object", tuple(contacts),
        ),
    ]  # fmt: skip


def _state_channels(path: str, contacts: Sequence[str]) -> list[Channel]:
    if not contacts:
        return []
    codes = ", ".join(f"{code} {state}" for code, state in enumerate(CONTACT_STATES))
    labels = tuple(contacts)
    return [Channel(f"{path}/contact_state", (len(labels),), "1", "", codes, labels)]


def _floor_channels(contacts: Sequence[str]) -> list[Channel]:
    if not contacts:
        return []
    force = Channel(
        "environment/contact_force", (len(contacts),), "N", "contact normals",
        "force of the floor at each contact along its normal; positive pushes the object",
        tuple(contacts),
    )  # fmt: skip
    return [force]


def _free_channels(arm: str, free: Mapping[str, str]) -> list[Channel]:
    if not free:
        return []
    labels, n, path = tuple(free), (len(free),), f"arms/{arm}"
    frame = "joint frame on the object"
    return [
        Channel(
            f"{path}/relative_rate", n, ", ".join(f"{unit}/s" for unit in free.values()), frame,
            "free motion of the arm's joint frame relative to the object's: its rates", labels,
        ),
        Channel(
            f"{path}/relative_position", n, ", ".join(free.values()), frame,
            "translation, and angle (several: rotation vector), of the arm's joint frame seen from "
            "the object's", labels,
        ),
    ]  # fmt: skip


def _scalar_channels() -> list[Channel]:
    return [
        Channel("energy/kinetic", (), "J", "", "kinetic energy of the arms and the object"),
        Channel("energy/potential", (), "J", "", "potential energy in the field of gravity"),
        Channel("energy/work", (), "J", "", "work done by control and effects since the start"),
        Channel("drift/position", (), "m", "", "largest gap of a contact, max |phi|"),
        Channel("drift/velocity", (), "m/s", "", "largest rate of a gap, max |W^T v|"),
        Channel("solver/rank", (), "1", "", "independent constraints"),
        Channel("solver/coupled_arms", (), "1", "", "arms that were solved in the coupled system"),
        Channel(
            "solver/residual", (), "1", "",
            "largest relative residual of the constraints or of the object's motion",
        ),
    ]  # fmt: skip
