"""Joint paths: positions with which the arms carry the object along a path of poses.

A segment of a path is a Chebyshev series of the joints' positions.  Its nodes are postures of the
closed chains: from one to the next the object is displaced, and the arms follow with the object
held.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

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
from multiarm.geometry.frame_motion import FrameMotion
from multiarm.integration.projection import project_positions
from multiarm.scene import Scene, Waypoint
from multiarm.spatial import difference, matrix_to_quaternion, retract


def _only_motion(state: State) -> FrameMotion:
    """The motion of the only object."""
    return next(iter(state.objects.values()))


def joint_path(
    scene: Scene,
    data: Data,
    start: State,
    path: Sequence[Waypoint],
    compile_scene: Callable[[Scene], System],
) -> JointPath:
    """Joint positions with which the object passes the waypoints of a path.

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
    times, poses = route(pose_of(_only_motion(start)).matrix(), path)
    if any(joint.kind != "weld" for joint in scene.joints):
        rigid = compile_scene(_rigidly_held(scene, data, start))
        with rigid.borrow() as rigid_data:
            return _joint_path(rigid_data, rigid.initial_state(), times, poses)
    return _joint_path(data, start, times, poses)


def _joint_path(data: Data, state: State, times: list[float], poses: list[np.ndarray]) -> JointPath:
    constants = data.model.constants
    heavy = data.view(  # an object that the projection does not move
        data.model.with_constants(
            object_masses=1e8 * constants.object_masses,
            object_inertias=1e8 * constants.object_inertias,
        )
    )
    segments = []
    for k in range(len(times) - 1):
        series, state = _segment(data, heavy, state, poses[k], poses[k + 1], k + 1)
        segments.append(series)
    width = max(series.shape[1] for series in segments)
    padded = [np.pad(series, ((0, 0), (0, width - series.shape[1]))) for series in segments]
    return JointPath(np.array(times), np.array(padded))


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
            joints.append({"arm": joint.arm, "kind": "weld"})
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
    scene.one_object("a path of the object")
    (place,) = map(scene.place_of_object, scene.all_objects)
    at_rest = {f"{place}.pose": pose_of(_only_motion(start)), f"{place}.twist": None}
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
            for c in layout.owners_of_robot(i)
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
    data: Data, heavy: Data, start: State, begin: np.ndarray, end: np.ndarray, number: int
) -> tuple[np.ndarray, State]:
    """Chebyshev series (n, width) of the joints from one waypoint to the next, and the end state.

    The object follows the quintic law of time that begins and ends at rest.  The nodes include both
    ends, so that segments join without a jump.
    """
    for intervals in (16, 32, 64, 128):  # until the series has converged
        x = -np.cos(np.pi * np.arange(intervals + 1) / intervals)
        law = np.array([quintic(s)[0] for s in 0.5 * (1.0 + x)])
        angles, state = follow_object(data, heavy, start, begin, end, law, number)
        series = np.polynomial.chebyshev.chebfit(x, angles, intervals).T
        if np.max(np.abs(series[:, -4:])) < 1e-8:  # [rad, m]
            return series, state
    worst = int(np.argmax(np.max(np.abs(series[:, -4:]), axis=1)))
    joint = data.model.joint_names[worst]
    raise ControlError(
        f"control.path: on the way to waypoint {number} the joints do not move smoothly "
        f"(worst: {joint}); an arm passes a singular posture there, choose another path or posture"
    )


def follow_object(
    data: Data,
    heavy: Data,
    start: State,
    begin: np.ndarray,
    end: np.ndarray,
    law: np.ndarray,
    segment: int,
) -> tuple[np.ndarray, State]:
    """Joint positions that close the chains while the object moves from one pose to another.

    The limits of the joints are not enforced, as in a run.

    Parameters
    ----------
    heavy : Data
        A view of the data with an object that the projection does not move.
    start : State
        A closed state near the first pose.
    begin, end : ndarray, shape (4, 4)
        Object poses; positions are interpolated along a line, orientations about a fixed axis.
    law : ndarray, shape (K,)
        Fractions of the way, increasing from 0 to 1.
    segment : int
        For messages.

    Returns
    -------
    angles : ndarray, shape (K, n)
    state : State
        Closed, with the object at the end pose.
    """
    tolerance = projection_tolerance(data)
    base = matrix_to_quaternion(begin[:3, :3])
    turn = difference(base, matrix_to_quaternion(end[:3, :3]))
    state, angles = start.copy(), []
    state.velocity[:] = 0.0
    place, quaternion = state.object_position, state.object_quaternion_xyzw
    before = 0.0
    for fraction in law:
        # an arm's free motions depend little on the number of these smaller steps
        for part in np.linspace(before, fraction, 4)[1:]:
            place[:] = begin[:3, 3] + part * (end[:3, 3] - begin[:3, 3])
            quaternion[:] = retract(base, part * turn)
            if not _arms_close(data, heavy, state, tolerance):
                raise _cannot_follow(data, segment, part)
            state.position[:] = data.arrays.state.configuration
        before = fraction
        angles.append(data.model.layout.joint_positions(state.position).copy())
    return np.array(angles), state


def _arms_close(data: Data, heavy: Data, state: State, tolerance: float) -> bool:
    """Close the gaps from ``state`` with the object held; the result is in the data.

    ``heavy`` has an object that does not move.  The compiled projection is fast; where it fails,
    near singular postures, the gaps are closed in small steps.
    """
    data.move_to(state)
    data.arrays.last_step.points[:] = data.model.pair_places
    if project_positions(heavy.struct, tolerance, True, 0.3, 60) == OK:
        return True
    data.reraise()
    data.set_state(0.0, state)
    free = np.full((data.model.layout.rate_count, 2), [-np.inf, np.inf])
    for i in data.model.layout.blocks_of_robots:
        require_ok(data, update_kinematics(data.struct))
        if not close_gaps(Linkage(data, [i], False, free), tolerance).closed:
            return False
    return True


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
