"""Quantities: the few numbers that a sweep stores of every run.

Built-in quantities are listed in :data:`KNOWN`.  Any user function is another one,
``f(trajectory) -> number``, or ``-> {name: number}`` if its entry lists the names.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field

from multiarm.errors import USER_FAULTS
from multiarm.results.channels import object_paths
from multiarm.results.limit_use import QUANTITIES as LIMITED
from multiarm.results.limit_use import largest_shares
from multiarm.scene import Pose
from multiarm.scene.code import UserFunction, function_text, load_function
from multiarm.scene.faults import invalid, shown
from multiarm.scene.spec import Spec

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

MEASURED = "wall_time"
"""May be listed among the quantities; every record has it anyway, as it is not reproducible."""


def _name(value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z_][\w.\-]*", value):
        raise invalid(
            f"{shown(value)} cannot name a quantity; use letters, digits, '_', '-' and '.', with "
            "a letter first (names become columns of tables)"
        )
    return value


Name = Annotated[str, BeforeValidator(_name)]


class UserQuantity(Spec):
    """A user-defined function of a run's trajectory.

    Attributes
    ----------
    function : callable or str
        ``file.py:name`` of a function of the trajectory.  Or ``package.module:name``; in Python
        also the function, ``f(trajectory) -> number``.
    name : str, optional
        Of the quantity; by default the function's name.
    gives : list of str, optional
        The function returns a table with these names; each is a quantity ``name.entry``.
    unit, words : str
        Unit and description of the number.
    """

    function: UserFunction
    name: Name | None = None
    gives: Annotated[tuple[Name, ...], Field(min_length=1)] | None = None
    unit: str = "1"
    words: str = ""

    @property
    def title(self) -> str:
        """Its name, or that of the function."""
        last = re.split(r"[:.]", function_text(self.function))[-1]
        return self.name or re.sub(r"\W", "", last) or "quantity"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its numbers."""
        if self.gives is None:
            return (self.title,)
        return tuple(f"{self.title}.{entry}" for entry in self.gives)

    def numbers(self, trajectory: Trajectory, load: Callable[[Any], Callable]) -> dict[str, float]:
        """Its numbers of a completed run, by name; raises ValueError where there are none."""
        try:
            output = load(self.function)(trajectory)
        except USER_FAULTS as error:
            problem = f"quantity {self.title!r} raised {type(error).__name__}: {error}"
            raise ValueError(problem) from error
        if self.gives is None:
            return {self.title: _number(output, self.title)}
        if not isinstance(output, Mapping):
            raise ValueError(
                f"quantity {self.title!r} must give a table of numbers, it gave {output!r:.60}"
            )
        if set(output) != set(self.gives):
            raise ValueError(
                f"quantity {self.title!r} gave {', '.join(map(str, output)) or 'nothing'}; its "
                f"'gives' lists {', '.join(sorted(self.gives))}"
            )
        return {
            name: _number(output[entry], f"{self.title} [{entry}]")
            for name, entry in zip(self.names, self.gives, strict=True)
        }


def measure(
    keep: Sequence[str | UserQuantity],
    trajectory: Trajectory,
    load: Callable[[Any], Callable] = load_function,
) -> tuple[dict[str, float | None], str]:
    """The quantities of a completed run by name, and the errors of user-defined functions.

    A number is None where it is not defined for this run, or its function failed; ``load`` loads
    the functions that are named.
    """
    numbers: dict[str, float | None] = {}
    faults = []
    for entry in keep:
        if isinstance(entry, UserQuantity):
            try:
                numbers |= entry.numbers(trajectory, load)
            except ValueError as error:
                faults.append(str(error))
                numbers |= dict.fromkeys(entry.names)
        elif entry != MEASURED:
            numbers[entry] = KNOWN[entry].function(trajectory)
    return numbers, "; ".join(faults)


def _number(value: Any, name: str) -> float:
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    if not isinstance(value, (Real, np.bool_)):
        raise ValueError(f"quantity {name!r} must give a number, it gave {value!r:.60}")
    if not math.isfinite(value):
        raise ValueError(f"quantity {name!r} gave {float(value)}, which is not finite")
    return float(value)


# --- built-in quantities --------------------------------------------------------------------------


def _largest(*channels: np.ndarray) -> float:
    """The largest magnitude in some channels of a run."""
    return max((float(np.max(np.abs(values), initial=0.0)) for values in channels), default=0.0)


def _pose_errors(trajectory: Trajectory) -> tuple[float, float]:
    """Distance [m] and angle [rad] of the object's last pose from the desired one.

    Without a path the desired pose is that at t = 0; of several objects these are the largest, of
    those that have paths where some have.
    """
    from multiarm.control.object_path import pose_path, reference_pose, route
    from multiarm.simulation.comparison import object_poses, pose_differences

    poses = object_poses(trajectory)
    objects = list(trajectory.scene.all_objects)
    paths = trajectory.scene.control.paths(objects)
    led = [objects.index(name) for name, waypoints in paths.items() if waypoints]
    if not led:
        return pose_differences(poses[-1], poses[0])
    desired = []
    for place in led:
        first = poses[0, place]
        start = Pose(xyz=first[:3].tolist(), quaternion_xyzw=first[3:].tolist())
        path = pose_path(*route(start.matrix(), paths[objects[place]]))
        position, quaternion, *_ = reference_pose(float(trajectory.time[-1]), path)
        desired.append(np.concatenate([position, quaternion]))
    return pose_differences(poses[-1, led], np.array(desired))


def _position_error(trajectory: Trajectory) -> float:
    return _pose_errors(trajectory)[0]


def _rotation_error(trajectory: Trajectory) -> float:
    return _pose_errors(trajectory)[1]


def _estimated_error(trajectory: Trajectory) -> float | None:
    return (trajectory.certificate or {}).get("estimated_error", {}).get("position_m")


class Known(NamedTuple):
    """A built-in quantity: its unit, its description, and the number of a trajectory."""

    unit: str
    words: str
    function: Callable[[Trajectory], float | None]


def _final(axis: int) -> Known:
    words = f"{'xyz'[axis]} of the object's centre of mass at the end, in scenes with one object"
    return Known("m", words, lambda run: float(run.object_position[-1, axis]))


def _largest_of_objects(run: Trajectory, part: slice) -> float:
    """The largest length of a part of the objects' twists."""
    twists = [run.channel(f"{path}/twist") for path in object_paths(run.channels).values()]
    return _largest(*(np.linalg.norm(twist[:, part], axis=1) for twist in twists))


def _share(limit: str) -> Known:
    words = f"of a joint's {limit} limit, 1 at the limit"
    return Known("1", words, lambda run: largest_shares(run)[limit])


def _statistic(name: str, words: str) -> Known:
    def number(run: Trajectory) -> float | None:
        count = run.statistics.get(name)
        return None if count is None else float(count)

    return Known("1", words, number)


OF_ONE_OBJECT = ("final_x", "final_y", "final_z")
"""Quantities of scenes with one object."""
_POSE = "at the end, from where the control leads it, or from the start where it has no path"
KNOWN = {
    "final_position_error": Known("m", f"distance of the object {_POSE}", _position_error),
    "final_rotation_error": Known("rad", f"turn of the object {_POSE}", _rotation_error),
    **{name: _final(axis) for axis, name in enumerate(OF_ONE_OBJECT)},
    "largest_speed": Known(
        "m/s",
        "of an object's centre of mass",
        lambda run: _largest_of_objects(run, slice(0, 3)),
    ),
    "largest_turn_rate": Known(
        "rad/s",
        "of an object",
        lambda run: _largest_of_objects(run, slice(3, 6)),
    ),
    "largest_contact_force": Known(
        "N",
        "magnitude along a contact's normal",
        lambda run: _largest(*run.contact_forces.values()),
    ),
    "largest_joint_torque": Known(
        "N m",
        "magnitude of the drives', of sliding joints in N",
        lambda run: _largest(*run.joint_torques.values()),
    ),
    **{f"largest_{limit}_share": _share(limit) for limit in LIMITED},
    "position_drift": Known(
        "m", "largest gap of a contact", lambda run: _largest(run.position_drift)
    ),
    "velocity_drift": Known(
        "m/s", "largest rate of a gap", lambda run: _largest(run.velocity_drift)
    ),
    "energy_balance": Known(
        "J",
        "largest magnitude of energy gained less work done",
        lambda run: _largest(run.energy_balance),
    ),
    "final_energy": Known(
        "J", "kinetic plus potential, at the end", lambda run: float(run.energy[-1])
    ),
    "work": Known("J", "done by control and effects", lambda run: float(run.work[-1])),
    "estimated_error": Known("m", "of positions, by the run's check", _estimated_error),
    "events": Known("1", "number of events", lambda run: float(len(run.events))),
    "steps": _statistic("steps", "of the integration"),
    "evaluations": _statistic("evaluations", "of the equations of motion"),
}
"""The built-in quantities by name."""
