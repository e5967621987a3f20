"""Quantities: the few numbers that a sweep stores of every run.

Built-in quantities are listed in :data:`KNOWN`.  Any user function is another one,
``f(trajectory) -> number``, or ``-> {name: number}`` if its entry lists the names.
"""

from __future__ import annotations

import hashlib
import inspect
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.errors import USER_FAULTS
from multiarm.scene.functions import FunctionReference, load_function

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

__all__ = ["KNOWN", "MEASURED", "Quantity", "digest", "measure"]

MEASURED = "wall_time"
"""May be listed among the quantities; every record has it anyway, as it is not reproducible."""


@dataclass(frozen=True)
class Quantity:
    """One number of every run.

    Attributes
    ----------
    name : str
    unit : str
    words : str
        Description.
    function : callable or FunctionReference, optional
        The user's function, or its place.
    key : str, optional
        Of the table that the function returns.
    digest : str
        Of the function's source text.
    """

    name: str
    unit: str
    words: str
    function: Callable[[Trajectory], Any] | FunctionReference | None = None
    key: str | None = None
    digest: str = ""


def measure(
    quantities: Sequence[Quantity], trajectory: Trajectory
) -> tuple[dict[str, float | None], str]:
    """The quantities of a completed run.

    Parameters
    ----------
    quantities : sequence of Quantity
    trajectory : Trajectory

    Returns
    -------
    numbers : dict
        Name -> number; None where the quantity is not defined for this run, or its function failed.
    fault : str
        Errors of user-defined functions; empty if there are none.
    """
    numbers: dict[str, float | None] = {}
    faults = []
    for function, group in groupby(quantities, lambda one: (one.function, one.digest)):
        members = list(group)
        try:
            numbers |= _measured(function[0], members, trajectory)
        except _Fault as fault:
            faults.append(str(fault))
            numbers |= dict.fromkeys([one.name for one in members])
    return numbers, "; ".join(faults)


def digest(function: Callable | str) -> str:
    """A digest of the function's source text; empty if the text is not available."""
    try:
        if isinstance(function, str):
            file = FunctionReference(function).file
            text = "" if file is None else file.read_text(encoding="utf-8")
        else:
            text = inspect.getsource(function)
    except (OSError, TypeError, ValueError):
        return ""  # typed in at a prompt, or made by other means
    return hashlib.sha256(text.encode()).hexdigest()[:16] if text else ""


class _Fault(Exception):
    """An error of a user-defined function."""


def _measured(
    function: Callable | FunctionReference | None, members: list[Quantity], trajectory: Trajectory
) -> dict[str, float | None]:
    if function is None:
        return {one.name: KNOWN[one.name].function(trajectory) for one in members}
    key = members[0].key
    name = members[0].name if key is None else members[0].name.removesuffix(f".{key}")
    try:
        given = _loaded(function, members[0].digest)(trajectory)
    except USER_FAULTS as error:
        raise _Fault(f"quantity {name!r} raised {type(error).__name__}: {error}") from error
    if key is None:
        return {members[0].name: _number(given, name)}
    if not isinstance(given, Mapping):
        raise _Fault(f"quantity {name!r} must give a table of numbers, it gave {given!r:.60}")
    keys = {one.key for one in members}
    if set(given) != keys:
        raise _Fault(
            f"quantity {name!r} gave {', '.join(map(str, given)) or 'nothing'}; its 'gives' lists "
            f"{', '.join(map(str, sorted(map(str, keys))))}"
        )
    return {one.name: _number(given[one.key], f"{name} [{one.key}]") for one in members}


def _number(value: Any, name: str) -> float:
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    if not isinstance(value, (Real, np.bool_)):
        raise _Fault(f"quantity {name!r} must give a number, it gave {value!r:.60}")
    if not math.isfinite(value):
        raise _Fault(f"quantity {name!r} gave {float(value)}, which is not finite")
    return float(value)


@lru_cache(maxsize=64)
def _loaded(function: Callable | FunctionReference, _digest: str) -> Callable:
    """The function; the digest makes a changed file be read again."""
    return load_function(function)


# --- built-in quantities --------------------------------------------------------------------------


def _largest(values: np.ndarray) -> float:
    return float(np.max(np.abs(values), initial=0.0))


def _largest_of(arms: Mapping[str, np.ndarray]) -> float:
    return max(map(_largest, arms.values()), default=0.0)


def _last(values: np.ndarray) -> float:
    return float(values[-1])


def _desired_pose(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Desired position and quaternion of the object at the end of the run.

    Between waypoints they follow s^3 (10 - 15 s + 6 s^2); without a path they stay at t = 0.
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
    s = (end - t0) / (t1 - t0)
    share = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return p0 + share * (p1 - p0), retract(q0, share * difference(q0, q1))


def _position_error(trajectory: Trajectory) -> float:
    return float(np.linalg.norm(trajectory.object_position[-1] - _desired_pose(trajectory)[0]))


def _rotation_error(trajectory: Trajectory) -> float:
    from multiarm.spatial import difference

    turned = difference(_desired_pose(trajectory)[1], trajectory.object_quaternion_xyzw[-1].copy())
    return float(np.linalg.norm(turned))


def _coordinate(axis: int) -> Callable[[Trajectory], float]:
    return lambda trajectory: float(trajectory.object_position[-1, axis])


def _speed(columns: slice) -> Callable[[Trajectory], float]:
    def largest(trajectory: Trajectory) -> float:
        return float(np.max(np.linalg.norm(trajectory.object_twist[:, columns], axis=1)))

    return largest


def _estimated_error(trajectory: Trajectory) -> float | None:
    return (trajectory.certificate or {}).get("estimated_error", {}).get("position_m")


def _counted(key: str) -> Callable[[Trajectory], float | None]:
    def count(trajectory: Trajectory) -> float | None:
        found = trajectory.statistics.get(key)
        return None if found is None else float(found)

    return count


def _known() -> Iterator[tuple[str, str, str, Callable[[Any], float | None]]]:
    pose = "at the end, from where the control leads it, or from the start where it has no path"
    yield "final_position_error", "m", f"distance of the object {pose}", _position_error
    yield "final_rotation_error", "rad", f"turn of the object {pose}", _rotation_error
    for axis, name in enumerate("xyz"):
        words = f"{name} of the object's centre of mass at the end"
        yield f"final_{name}", "m", words, _coordinate(axis)
    yield "largest_speed", "m/s", "of the object's centre of mass", _speed(slice(0, 3))
    yield "largest_turn_rate", "rad/s", "of the object", _speed(slice(3, 6))
    yield (
        "largest_contact_force", "N", "magnitude along a contact's normal",
        lambda trajectory: _largest_of(trajectory.contact_forces),
    )  # fmt: skip
    yield (
        "largest_joint_torque", "N m", "magnitude of the controller's, of sliding joints in N",
        lambda trajectory: _largest_of(trajectory.joint_torques),
    )  # fmt: skip
    yield "position_drift", "m", "largest gap of a contact", lambda t: _largest(t.position_drift)
    yield "velocity_drift", "m/s", "largest rate of a gap", lambda t: _largest(t.velocity_drift)
    yield (
        "energy_balance", "J", "largest magnitude of energy gained less work done",
        lambda trajectory: _largest(trajectory.energy_balance),
    )  # fmt: skip
    yield "final_energy", "J", "kinetic plus potential, at the end", lambda t: _last(t.energy)
    yield "work", "J", "done by control and effects", lambda t: _last(t.work)
    yield "estimated_error", "m", "of positions, by the run's check", _estimated_error
    yield "events", "1", "number of events", lambda t: float(len(t.events))
    yield "steps", "1", "of the integration", _counted("steps")
    yield "evaluations", "1", "of the equations of motion", _counted("evaluations")


@dataclass(frozen=True)
class _Known:
    unit: str
    words: str
    function: Callable[[Any], float | None]


KNOWN: dict[str, _Known] = {name: _Known(unit, words, own) for name, unit, words, own in _known()}
"""The built-in quantities by name."""
