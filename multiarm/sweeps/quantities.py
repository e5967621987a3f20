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
from multiarm.results.limit_use import largest_shares
from multiarm.scene.code import UserFunction, function_text, load_function
from multiarm.scene.control import quintic
from multiarm.scene.faults import fault, shown
from multiarm.scene.values import Spec

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

__all__ = ["KNOWN", "MEASURED", "UserQuantity", "measure"]

MEASURED = "wall_time"
"""May be listed among the quantities; every record has it anyway, as it is not reproducible."""


def _column(value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z_][\w.\-]*", value):
        raise fault(
            f"{shown(value)} cannot name a quantity; use letters, digits, '_', '-' and '.', with "
            "a letter first (names become columns of tables)"
        )
    return value


Column = Annotated[str, BeforeValidator(_column)]


class UserQuantity(Spec):
    """A user-defined function of a run's trajectory.

    Attributes
    ----------
    function : callable or str
        ``f(trajectory) -> number``, or its place: ``file.py:name``, ``package.module:name``.
    name : str, optional
        Of the quantity; by default the function's name.
    gives : list of str, optional
        The function returns a table with these names; each is a quantity ``name.entry``.
    unit, words : str
        Unit and description of the number.
    """

    function: UserFunction = Field(description="file.py:name of a function of the trajectory")
    name: Column | None = None
    gives: Annotated[tuple[Column, ...], Field(min_length=1)] | None = None
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


def _largest(values: np.ndarray) -> float:
    return float(np.max(np.abs(values), initial=0.0))


def _largest_of(arms: Mapping[str, np.ndarray]) -> float:
    return max(map(_largest, arms.values()), default=0.0)


def _last(values: np.ndarray) -> float:
    return float(values[-1])


def _desired_pose(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Desired position and quaternion of the object at the end of the run.

    Between waypoints they follow the quintic law; without a path they are those at t = 0.
    """
    from multiarm.spatial import difference, matrix_to_quaternion, retract

    start = trajectory.object_position[0], trajectory.object_quaternion_xyzw[0].copy()
    stops = [(0.0, *start)]
    for waypoint in getattr(trajectory.scene.control, "path", None) or ():
        X = waypoint.matrix()
        turned = matrix_to_quaternion(X[:3, :3])
        stops.append((waypoint.time, X[:3, 3], turned))
    end = float(trajectory.time[-1])
    later = next((k for k, stop in enumerate(stops) if stop[0] > end), None)
    if later is None:
        return stops[-1][1:]
    (t0, p0, q0), (t1, p1, q1) = stops[later - 1 : later + 1]
    share = quintic((end - t0) / (t1 - t0))
    return p0 + share * (p1 - p0), retract(q0, share * difference(q0, q1))


def _position_error(trajectory: Trajectory) -> float:
    return float(np.linalg.norm(trajectory.object_position[-1] - _desired_pose(trajectory)[0]))


def _rotation_error(trajectory: Trajectory) -> float:
    from multiarm.spatial import difference

    turned = difference(_desired_pose(trajectory)[1], trajectory.object_quaternion_xyzw[-1].copy())
    return float(np.linalg.norm(turned))


def _speed(trajectory: Trajectory, columns: slice) -> float:
    return float(np.max(np.linalg.norm(trajectory.object_twist[:, columns], axis=1)))


def _final_coordinate(axis: int) -> Callable[[Trajectory], float]:
    return lambda run: _last(run.object_position[:, axis])


def _estimated_error(trajectory: Trajectory) -> float | None:
    return (trajectory.certificate or {}).get("estimated_error", {}).get("position_m")


def _count(trajectory: Trajectory, key: str) -> float | None:
    number = trajectory.statistics.get(key)
    return None if number is None else float(number)


def _limit_share(limit: str) -> Callable[[Trajectory], float | None]:
    return lambda run: largest_shares(run)[limit]


class Known(NamedTuple):
    """A built-in quantity: its unit, its description, and the number of a trajectory."""

    unit: str
    words: str
    function: Callable[[Trajectory], float | None]


_POSE = "at the end, from where the control leads it, or from the start where it has no path"
KNOWN = {
    "final_position_error": Known("m", f"distance of the object {_POSE}", _position_error),
    "final_rotation_error": Known("rad", f"turn of the object {_POSE}", _rotation_error),
    **{
        f"final_{name}": Known(
            "m",
            f"{name} of the object's centre of mass at the end",
            _final_coordinate(axis),
        )
        for axis, name in enumerate("xyz")
    },
    "largest_speed": Known(
        "m/s", "of the object's centre of mass", lambda run: _speed(run, slice(0, 3))
    ),
    "largest_turn_rate": Known("rad/s", "of the object", lambda run: _speed(run, slice(3, 6))),
    "largest_contact_force": Known(
        "N", "magnitude along a contact's normal", lambda run: _largest_of(run.contact_forces)
    ),
    "largest_joint_torque": Known(
        "N m",
        "magnitude of the drives', of sliding joints in N",
        lambda run: _largest_of(run.joint_torques),
    ),
    **{
        f"largest_{limit}_share": Known(
            "1", f"of a joint's {limit} limit, 1 at the limit", _limit_share(limit)
        )
        for limit in ("effort", "speed", "range")
    },
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
    "final_energy": Known("J", "kinetic plus potential, at the end", lambda run: _last(run.energy)),
    "work": Known("J", "done by control and effects", lambda run: _last(run.work)),
    "estimated_error": Known("m", "of positions, by the run's check", _estimated_error),
    "events": Known("1", "number of events", lambda run: float(len(run.events))),
    "steps": Known("1", "of the integration", lambda run: _count(run, "steps")),
    "evaluations": Known("1", "of the equations of motion", lambda run: _count(run, "evaluations")),
}
"""The built-in quantities by name."""
