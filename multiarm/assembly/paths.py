"""Joint paths: positions with which the arms carry objects along paths of poses.

A segment of a path is a Chebyshev series of the joints' positions.  Its nodes are postures of the
closed chains: from one to the next the objects are displaced, and the arms follow with the objects
held.  Objects without a path follow as their joints want.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from multiarm.assembly.linkage import Linkage, projection_tolerance
from multiarm.assembly.loop_closure import close_gaps
from multiarm.control.object_path import pose_of, quintic, route
from multiarm.control.program import JointPath
from multiarm.dynamics.contact_geometry import force_directions
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.state import State
from multiarm.dynamics.status import OK
from multiarm.dynamics.system import System
from multiarm.errors import ControlError
from multiarm.integration.projection import project_positions
from multiarm.scene import Scene, Waypoint
from multiarm.spatial import difference, matrix_to_quaternion, retract


def joint_path(
    scene: Scene,
    data: Data,
    start: State,
    paths: Mapping[str, Sequence[Waypoint]],
    compile_scene: Callable[[Scene], System],
) -> JointPath:
    """Joint positions with which objects pass the waypoints of their paths.

    Parameters
    ----------
    data : Data
        Of the scene's model, all contacts of the joints closed.
    compile_scene : callable
        Compiles a scene, see :func:`_rigidly_held`.

    Raises
    ------
    ControlError
        When the arms cannot follow, or do not move smoothly.
    """
    routes = {}
    for name, path in paths.items():
        pose = pose_of(start.objects[name])
        at_rest = Waypoint(time=1.0, **pose.model_dump())
        routes[name] = route(pose.matrix(), path or (at_rest,))
    if any(joint.kind != "weld" for joint in scene.joints):
        rigid = compile_scene(_rigidly_held(scene, data, start))
        with rigid.borrow() as rigid_data:
            return _joint_path(rigid_data, rigid.initial_state(), routes)
    return _joint_path(data, start, routes)


# Projections after which objects that are led are where they are to be: each moves them by 1e-8 of
# what closes the gaps.
ROUNDS = 5


class Leg(NamedTuple):
    """The part of an object's path over a segment: part of the way between two poses (4, 4)."""

    begin: np.ndarray
    end: np.ndarray
    first: float  # of the time from one pose to the other, in which the segment begins
    last: float

    def part(self, x: np.ndarray) -> np.ndarray:
        """Parts of the way, of those of the segment's time."""
        return np.array([quintic(s)[0] for s in self.first + x * (self.last - self.first)])


Route = tuple[list[float], list[np.ndarray]]


def _joint_path(data: Data, state: State, routes: Mapping[str, Route]) -> JointPath:
    constants, objects = data.model.constants, data.model.layout.objects
    weights = np.array([1e8 if name in routes else 1.0 for name in objects])
    heavy = data.view(  # objects that the projection does not move
        data.model.with_constants(
            object_masses=weights * constants.object_masses,
            object_inertias=weights[:, None, None] * constants.object_inertias,
        )
    )
    segments = []
    times = sorted({time for route_times, _ in routes.values() for time in route_times})
    for k, (begin, end) in enumerate(pairwise(times), start=1):
        legs = {name: _leg(*of_object, begin, end) for name, of_object in routes.items()}
        series, state = _segment(data, heavy, state, legs, k)
        segments.append(series)
    width = max(series.shape[1] for series in segments)
    padded = [np.pad(series, ((0, 0), (0, width - series.shape[1]))) for series in segments]
    return JointPath(np.array(times), np.array(padded))


def _leg(times: list[float], poses: list[np.ndarray], begin: float, end: float) -> Leg:
    """The part of an object's path between two times, at none of which it ends or begins inside."""
    if begin >= times[-1]:
        return Leg(poses[-1], poses[-1], 0.0, 1.0)
    if end <= times[0]:
        return Leg(poses[0], poses[0], 0.0, 1.0)
    s = bisect_right(times, begin) - 1
    length = times[s + 1] - times[s]
    return Leg(poses[s], poses[s + 1], (begin - times[s]) / length, (end - times[s]) / length)


def _rigidly_held(scene: Scene, data: Data, start: State) -> Scene:
    """The scene with every tip fixed to the object where it is at the start.

    Its motion is one that the joints allow, and it is unique: free motions of a joint stay at rest.
    Arms with fewer than six joints cannot hold rigidly, nor can tips of robots that do not move in
    all directions beside the other connections of their robot; they keep their own joints.
    """
    joints: list[Any] = []
    rigid = _rigid_connections(data, start)
    for joint in scene.joints:
        if joint.connection not in rigid:
            joints.append(joint)
        elif joint.between is None:
            named = {} if joint.object is None else {"object": joint.object}
            joints.append({"arm": joint.arm, **named, "kind": "weld"})
        else:
            bodies = {"between": joint.between, "name": joint.name}
            joints.append({**bodies, "kind": "weld"})
    arms, robots = (
        {
            name: spec.model_copy(update={"posture": tuple(start.joint_positions[name])})
            for name, spec in specs.items()
        }
        for specs in (scene.arms, scene.robots)
    )
    at_rest: dict[str, Any] = {}
    for name, motion in start.objects.items():
        place = scene.place_of_object(name)
        at_rest |= {f"{place}.pose": pose_of(motion), f"{place}.twist": None}
    parts = {"joints": joints, "arms": arms, "robots": robots}
    return scene.replace(at_rest, **parts, control={"kind": "none"}, effects={})


def _rigid_connections(data: Data, start: State) -> set[str]:
    """The connections whose tips can be fixed to the object without holding it back."""
    model, layout, rigid = data.model, data.model.layout, set()
    data.set_state(0.0, start)
    require_ok(data, update_kinematics(data.struct))
    directions = force_directions(data)
    for i, robot in enumerate(layout.names):
        arm, columns = model.robots[robot], layout.of_robot(i)
        rows = {
            layout.owners[c]: directions[columns, layout.contacts_of(c)].T
            for c in layout.owners_of_blocks_of(i)
        }
        for name, pair in model.connections.items():
            if pair.robots != (robot,) or not pair.on_object:
                continue
            angles, rates = start.joint_positions[robot], start.joint_velocities[robot]
            J = arm.tip_kinematics(angles, rates, pair.first.tip).jacobian
            beside = np.vstack([J[:0], *(rows[owner] for owner in rows if owner != name)])
            free = np.linalg.matrix_rank(np.vstack([beside, J])) - np.linalg.matrix_rank(beside)
            if arm.dof >= 6 if "" in arm.tips else free == 6:
                rigid.add(name)
                rows[name] = J
    return rigid


def _segment(
    data: Data, heavy: Data, start: State, legs: Mapping[str, Leg], number: int
) -> tuple[np.ndarray, State]:
    """Chebyshev series (n, width) of the joints from one waypoint to the next, and the end state.

    The objects follow the quintic law of time that begins and ends at rest.  The nodes include both
    ends, so that segments join without a jump.
    """
    for intervals in (16, 32, 64, 128):  # until the series has converged
        x = -np.cos(np.pi * np.arange(intervals + 1) / intervals)
        angles, state = follow_objects(data, heavy, start, legs, 0.5 * (1.0 + x), number)
        series = np.polynomial.chebyshev.chebfit(x, angles, intervals).T
        if np.max(np.abs(series[:, -4:])) < 1e-8:  # [rad, m]
            return series, state
    worst = int(np.argmax(np.max(np.abs(series[:, -4:]), axis=1)))
    joint = data.model.joint_names[worst]
    raise ControlError(
        f"control.path: on the way to waypoint {number} the joints do not move smoothly "
        f"(worst: {joint}); an arm passes a singular posture there, choose another path or posture"
    )


def follow_objects(
    data: Data,
    heavy: Data,
    start: State,
    legs: Mapping[str, Leg],
    times: np.ndarray,
    segment: int,
) -> tuple[np.ndarray, State]:
    """Joint positions that close the chains while objects move from one pose to another.

    The limits of the joints are not enforced, as in a run.

    Parameters
    ----------
    heavy : Data
        A view of the data with objects that the projection does not move.
    start : State
        A closed state near the first poses.
    legs : mapping object -> Leg
        Positions are interpolated along a line, orientations about a fixed axis.
    times : ndarray, shape (K,)
        Parts of the segment's time, increasing from 0 to 1.
    segment : int
        For messages.

    Returns
    -------
    angles : ndarray, shape (K, n)
    state : State
        Closed, with the objects at their end poses.
    """
    tolerance = projection_tolerance(data)
    state, angles = start.copy(), []
    state.velocity[:] = 0.0
    moving = []
    for name, (begin, end, *_) in legs.items():
        base = matrix_to_quaternion(begin[:3, :3])
        turn = difference(base, matrix_to_quaternion(end[:3, :3]))
        moving.append((state.objects[name], begin[:3, 3], end[:3, 3] - begin[:3, 3], base, turn))
    fractions = np.array([leg.part(times) for leg in legs.values()]).T
    before = np.array([leg.part(np.zeros(1))[0] for leg in legs.values()])
    for at_node in fractions:
        # an arm's free motions depend little on the number of these smaller steps
        for parts in np.linspace(before, at_node, 4)[1:]:
            for (motion, origin, shift, base, turn), part in zip(moving, parts, strict=True):
                motion.position[:] = origin + part * shift
                motion.quaternion_xyzw[:] = retract(base, part * turn)
            if not _arms_close(data, heavy, state, tolerance, list(legs)):
                raise _cannot_follow(data, segment, float(np.max(parts)))
            state.position[:] = data.arrays.state.configuration
        before = at_node
        angles.append(data.model.layout.joint_positions(state.position).copy())
    return np.array(angles), state


def _arms_close(
    data: Data, heavy: Data, state: State, tolerance: float, led: Sequence[str]
) -> bool:
    """Close the gaps from ``state`` with the objects held that are ``led``; it is in the data.

    ``heavy`` has these objects with so much mass that they do not move.  The compiled projection is
    fast; where it fails, near singular postures, the gaps are closed in small steps.
    """
    follows = len(led) < len(state.objects)
    for _ in range(ROUNDS if follows else 1):
        data.move_to(state)
        data.arrays.last_step.points[:] = data.model.pair_places
        if project_positions(heavy.struct, tolerance, not follows, 0.3, 60) != OK:
            break
        if not follows or _led_back(data, state, led) <= tolerance:
            return True
    if follows:
        return False
    data.reraise()
    data.set_state(0.0, state)
    free = np.full((data.model.layout.rate_count, 2), [-np.inf, np.inf])
    for i in data.model.layout.blocks_of_robots:
        require_ok(data, update_kinematics(data.struct))
        if not close_gaps(Linkage(data, [i], False, free), tolerance).closed:
            return False
    return True


def _led_back(data: Data, state: State, led: Sequence[str]) -> float:
    """Take the configuration of the data over into a state, but for the objects that are led.

    Returns how far these had moved [m, rad].
    """
    layout, closed = data.model.layout, state.copy()
    closed.position[:] = data.arrays.state.configuration
    moved = layout.twists(state.displacement_to(closed))
    for name in led:
        closed.objects[name].pose[:] = state.objects[name].pose
    state.position[:] = closed.position
    return float(max(np.max(np.abs(moved[layout.objects.index(name)])) for name in led))


def _cannot_follow(data: Data, segment: int, part: float) -> ControlError:
    gaps = data.model.layout.split_contacts(np.abs(data.contact_rows.gap))
    owner, gap = max(
        ((owner, float(np.max(gap, initial=0.0))) for owner, gap in gaps.items()),
        key=lambda worst: worst[1],
    )
    noun = "arm" if owner in data.model.robots else "joint"
    return ControlError(
        f"control.path: on the way to waypoint {segment} the arms cannot follow the object beyond "
        f"{100 * part:.0f} % ({noun} '{owner}' is {gap:.3g} m off); choose a nearer pose or other "
        f"base placements"
    )
