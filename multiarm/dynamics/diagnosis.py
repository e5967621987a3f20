r"""Which motions an arm, or a robot with several connections, has lost, in words.

Contact forces ``x`` of a joint sum to a wrench ``w`` on the arm.  The arm can move along it when it
causes joint torques, :math:`W_i x = J^T w \ne 0`.  Combinations without torques are lost motions,
and there are three reasons for them:

- the contacts depend on each other: they sum to no wrench at all;
- the arm has fewer joints than the joint has independent constraints;
- the posture is singular.

A wrench has an axis.  If it is a force along a line, the arm has no motion along that line; if it
is a couple, no turn about its axis; else a screw, a motion along an axis together with a turn about
it, is lost.  Moments are compared with forces over the arm's length (the largest distance of a
joint's axis from the place where the arm holds the object), and so are the joints' torques.

A robot with several connections has lost what each of them loses by itself, told with the name of
the connection, and what they lose together: two hands on one torso cannot both follow every motion.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.contact_geometry import (
    joint_origin,
    joint_wrenches,
    robot_matrix,
    wrenches_about,
)
from multiarm.dynamics.data import Evaluated
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.solver.factors import rank_of
from multiarm.geometry.records import Contact
from multiarm.notation import count_of
from multiarm.robots.robot import Robot
from multiarm.scene.faults import counted

# Motion along a direction, relative to that along the arm's best one, that counts as little ...
LITTLE = 5e-3
# ... and as none.
NONE = 1e-6
# A wrench gets the name of an axis when it differs from it by less than this part: about six
# degrees, or a tenth of the arm's length as distance from the axis or as pitch.
ALIKE = 0.1
# Longest description, in characters, without the name of a connection.
LONGEST = 60
# Part of a combination of forces that all belongs to one connection.
ALL_OF_IT = 0.99


@dataclass(frozen=True, eq=False)
class LostMotion:
    """A direction along which an arm cannot move."""

    words: str  # at most LONGEST characters
    # wrench without joint torques: force (3,), and moment (3,) about ``place`` [m], world axes
    force: np.ndarray
    moment: np.ndarray
    place: np.ndarray  # (3,) where the arm holds the object [m]
    share: float  # motion along it, relative to that along the arm's best direction
    along_reach: bool = False  # from the arm's shoulder to where it holds the object


def lost_motions(data: Evaluated, arms: Iterable[str] | None = None) -> dict[str, tuple[str, ...]]:
    """Lost motions of each robot (default: all) in words of at most 60 characters; empty for none.

    Where a robot has several connections, the name of one stands before its words.  At the
    kinematics in the data, before the elimination.
    """
    return {arm: _of_robot(data, arm) for arm in (data.model.arm_names if arms is None else arms)}


def lost_directions(data: Evaluated, connection: str) -> tuple[LostMotion, ...]:
    """The directions that a connection loses by posture or number of joints of its robot.

    One by one; other connections of the robot are left out.
    """
    hold = _hold(data, connection)
    if hold is None:
        return ()
    _, sizes, turned = np.linalg.svd(hold.torques)
    rank = rank_of(sizes, LITTLE)
    return _lost_motions(hold, hold.basis @ turned[rank:].T, float(sizes[0]))


def describe(data: Evaluated, arm: str, directions: np.ndarray) -> tuple[str, ...]:
    """Words for lost motions given as combinations of a robot's rows, shape (N_i, k).

    One text for each column; of an arm they describe a basis of the span of all columns.
    """
    directions = np.asarray(directions, dtype=float)
    if is_serial_arm(data, arm):
        return _describe(data, arm, directions)
    return tuple(_of_combination(data, arm, direction) for direction in directions.T)


def is_serial_arm(data: Evaluated, robot: str) -> bool:
    """Whether a robot has one connection only, that of its only tip with the object."""
    return _connections(data, robot) == [robot]


def _connections(data: Evaluated, robot: str) -> list[str]:
    return [name for name, pair in data.model.connections.items() if robot in pair.robots]


def _of_combination(data: Evaluated, robot: str, forces: np.ndarray) -> str:
    """Words for a combination (N_i,) of the rows of a robot with several connections."""
    layout = data.model.layout
    i = layout.names.index(robot)
    first, size = layout.contacts_of_blocks_of(i).start, float(np.linalg.norm(forces))
    taking_part = {}
    for c in layout.owners_of_blocks_of(i):
        rows = layout.contacts_of(c)
        part = forces[rows.start - first : rows.stop - first]
        if np.linalg.norm(part) > ALIKE * size:
            taking_part[layout.owners[c]] = part
    owner, part = max(taking_part.items(), key=lambda entry: np.linalg.norm(entry[1]))
    if owner in data.model.connections and np.linalg.norm(part) > ALL_OF_IT * size:
        return f"{owner}: {_describe(data, owner, part[:, None])[0]}"
    return f"a direction of {_together(data, taking_part)} together"


def _together(data: Evaluated, owners: Iterable[str]) -> str:
    """Owners of rows in words: connections by name, and joints' rows."""
    known = data.model.connections
    names = [name if name in known else f"joints of {name}" for name in owners]
    return counted(names, 3, " and " if len(names) == 2 else ", ")


def _describe(data: Evaluated, connection: str, directions: np.ndarray) -> tuple[str, ...]:
    """Words for combinations (N_c, k) of the rows of a connection."""
    hold = _hold(data, connection)
    if hold is None or not np.all(np.isfinite(directions)):
        return ("a direction that has no name here",) * directions.shape[1]
    wrenches = hold.wrenches @ directions
    size = np.linalg.norm(hold.wrenches, 2)
    space, sizes, _ = np.linalg.svd(wrenches, full_matrices=False)
    rank = int(np.sum(sizes > NONE * size * np.linalg.norm(directions)))
    named = _lost_motions(hold, space[:, :rank], float(np.linalg.norm(hold.torques, 2)))
    words = tuple(lost.words for lost in named)
    if rank < directions.shape[1]:
        words += ("contacts that say the same twice",)
    return words


# --- the arm and its joint -----------------------------------------------------------------------


@dataclass(frozen=True)
class _Hold:
    """How an arm holds the object: wrenches ``[f; m / length]`` about ``place``, world axes.

    ``wrenches`` (6, N) of the contacts; ``basis`` (6, r) orthonormal, of their span; ``torques``
    (n, r) of the joints for the basis, over ``length`` for revolute joints.
    """

    length: float
    place: np.ndarray
    wrenches: np.ndarray
    basis: np.ndarray
    torques: np.ndarray
    names: tuple[_Named, ...]
    joints: int  # that move one body of the connection against the other

    def share(self, wrench: np.ndarray, best: float) -> float:
        """Motion of the arm along a unit wrench, relative to that along its best direction."""
        return float(np.linalg.norm(self.torques @ (self.basis.T @ wrench))) / best if best else 0.0


class _Named(NamedTuple):
    """A line or an axis with a name, as a unit wrench about where the arm holds the object."""

    name: str
    wrench: np.ndarray
    along_reach: bool = False


class _Axis(NamedTuple):
    """Axis of a joint: whether it turns or slides, its direction, its point next to the tip."""

    turns: bool
    direction: np.ndarray
    point: np.ndarray


def _of_robot(data: Evaluated, robot: str) -> tuple[str, ...]:
    if is_serial_arm(data, robot):
        return _of_connection(data, robot)
    names = _connections(data, robot)
    words = tuple(f"{name}: {text}" for name in names for text in _of_connection(data, name))
    together = _lost_together(data, robot)
    if together:
        owners = data.model.layout.owners_of_blocks_of(data.model.arm_names.index(robot))
        everybody = _together(data, (data.model.layout.owners[c] for c in owners))
        words += (f"{count_of(together, 'direction')} that {everybody} lose together",)
    return words


def _lost_together(data: Evaluated, robot: str) -> int:
    """Directions that a robot's connections and joints' rows lose beside what each loses alone."""
    layout, parts, alone = data.model.layout, [], 0
    i = layout.names.index(robot)
    of_robot, first = robot_matrix(data, i), layout.contacts_of_blocks_of(i).start
    for c in layout.owners_of_blocks_of(i):
        owner, rows = layout.owners[c], layout.contacts_of(c)
        if owner in data.model.connections:
            hold = _hold(data, owner)
            if hold is None:
                return 0
            torques = hold.torques
        else:
            torques = of_robot[:, rows.start - first : rows.stop - first]
        sizes = np.linalg.svd(torques, compute_uv=False)
        rank = rank_of(sizes, LITTLE)
        alone += torques.shape[1] - rank
        if rank:
            parts.append(torques / sizes[0])
    if not parts:
        return 0
    every = np.hstack(parts)
    lost = every.shape[1] - rank_of(np.linalg.svd(every, compute_uv=False), LITTLE)
    return max(lost - alone, 0)


def _of_connection(data: Evaluated, connection: str) -> tuple[str, ...]:
    hold = _hold(data, connection)
    if hold is None:
        return ()
    words = _redundant(data, connection)
    joints, independent = hold.joints, hold.torques.shape[1]
    lost = lost_directions(data, connection)
    if joints >= independent:
        return words + tuple(motion.words for motion in lost)
    leave = f"its {count_of(joints, 'joint')} {'leaves' if joints == 1 else 'leave'}"
    words += (f"{leave} {len(lost)} of {independent} directions without motion",)
    if len(lost) > independent - joints:  # the posture loses further ones
        words += tuple(motion.words for motion in lost if motion.along_reach)
    return words


def _redundant(data: Evaluated, connection: str) -> tuple[str, ...]:
    """Contacts that depend on each other."""
    space = null_space(joint_wrenches(data, connection).T)
    names = [row.name for row in data.model.contacts[connection] if isinstance(row, Contact)]
    many = len(names) - space.rank
    if not many:
        return ()
    text = f"{many} of {len(names)} contacts too many"
    pairs = zip(names, space.untouched, strict=True)
    among = [name for name, independent in pairs if not independent]
    if len(among) == len(names):
        return (text,)
    for count in range(len(among), 0, -1):
        rest = f" and {len(among) - count} more" if count < len(among) else ""
        full = f"{text} among " + ", ".join(f"'{name}'" for name in among[:count]) + rest
        if len(full) <= LONGEST:
            return (full,)
    return (f"{text} among {len(among)} of them",)


def _hold(data: Evaluated, connection: str) -> _Hold | None:
    """Contact wrenches and their joint torques; None when a contact has no normal.

    None too where the base floats, or two robots are joined: what moves with them is not said in
    terms of the joints of one.
    """
    layout, pair = data.model.layout, data.model.connections[connection]
    if len(pair.robots) != 1 or data.model.robots[pair.robots[0]].floats:
        return None
    i, arm = layout.names.index(pair.robots[0]), data.model.robots[pair.robots[0]]
    d, r = layout.joints_of(i), layout.contacts_of(layout.owners.index(connection))
    first = layout.contacts_of_blocks_of(i).start
    W = robot_matrix(data, i)[:, r.start - first : r.stop - first]
    place = joint_origin(data, connection)
    wrenches = wrenches_about(data, connection, place)
    if not (np.all(np.isfinite(wrenches)) and np.all(np.isfinite(W)) and np.any(wrenches)):
        return None
    axes = _axes(arm, pair.first.tip, data.arrays.state.joint_positions[d])
    length = _length(axes, place)
    wrenches = np.hstack([wrenches[:, :3], wrenches[:, 3:] / length]).T
    rank = null_space(joint_wrenches(data, connection).T).rank
    basis, sizes, turned = np.linalg.svd(wrenches, full_matrices=False)
    combinations = turned[:rank].T / sizes[:rank]
    units = np.array([1.0 if unit == "m" else length for unit in arm.joint_units.values()])
    moving: set[int] = set()  # joints on the way to both bodies of an inner loop move neither
    for body in (pair.first, pair.second):
        moving ^= set(arm.tips[body.tip].chain.tolist()) if body.is_link else set()
    return _Hold(
        length=length,
        place=place,
        wrenches=wrenches,
        basis=basis[:, :rank],
        torques=(W / units[:, None]) @ combinations,
        names=tuple(_axis_names(axes, place, length)),
        joints=len(moving),
    )


def _axes(arm: Robot, tip: str, angles: np.ndarray) -> list[_Axis]:
    """Axes of the joints between the base and a tip, from its Jacobian.

    A turn about ``a`` through ``o`` moves the tip by ``a x (tip - o)``.
    """
    terms = arm.terms(angles, np.zeros(len(angles)), tip)
    jacobian, axes = terms.J[:, arm.tips[tip].chain], []
    for velocity, spin in zip(jacobian[:3].T, jacobian[3:].T, strict=True):
        turns = bool(np.any(spin))
        point = terms.tip_position - _cross(velocity, spin)
        axes.append(_Axis(turns, spin if turns else velocity, point))
    return axes


def _length(axes: list[_Axis], place: np.ndarray) -> float:
    """Largest distance of a turning joint's axis from a place; 1 m when there is none."""
    turning = [axis for axis in axes if axis.turns]
    away = [np.linalg.norm(_cross(a.direction, place - a.point)) for a in turning]
    longest = float(max(away, default=0.0))
    return longest if longest > 1e-6 else 1.0


# --- words ---------------------------------------------------------------------------------------


def _axis_names(axes: list[_Axis], place: np.ndarray, length: float) -> Iterator[_Named]:
    """Named lines and axes in the order of preference."""
    shoulder, ends = _reach(axes, place)
    for end in ends:
        along = end - shoulder
        if np.linalg.norm(along) > ALIKE * length:
            along = along / np.linalg.norm(along)
            yield _Named("motion along its own reach", _line(along, shoulder - place, length), True)
    for name, axis in zip("xyz", np.eye(3), strict=True):
        yield _Named(f"motion along world {name}", _line(axis, np.zeros(3), length))
    for name, axis in zip("xyz", np.eye(3), strict=True):
        yield _Named(f"turn about world {name}", np.concatenate([np.zeros(3), axis]))


def _reach(axes: list[_Axis], place: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Shoulder, and the points that the arm reaches out to: wrist (either pair of axes), grip.

    The shoulder is where the first two axes come closest, the wrist where the last ones do: a
    stretched elbow is on the line between them, wherever the wrist has turned the grip.
    """
    turning = [axis for axis in axes if axis.turns]
    if not turning:
        return place, []
    shoulder = _closest(turning[0], turning[1]) if len(turning) > 1 else turning[0].point
    pairs = [(-2, -1), (-3, -2)] if len(turning) > 3 else []
    wrists = [_closest(turning[j], turning[k]) for j, k in pairs]
    return shoulder, [*wrists, place]


def _closest(axis: _Axis, second: _Axis) -> np.ndarray:
    """Point of an axis that is closest to a second one; if they are parallel, to the tip."""
    across = _cross(axis.direction, second.direction)
    if np.linalg.norm(across) < ALIKE:
        return axis.point
    way = _cross(second.point - axis.point, second.direction) @ across / (across @ across)
    return axis.point + way * axis.direction


def _line(axis: np.ndarray, offset: np.ndarray, length: float) -> np.ndarray:
    """Unit wrench ``[f; m / length]`` of a force along a line through ``offset``."""
    wrench = np.concatenate([axis, _cross(offset, axis) / length])
    return wrench / np.linalg.norm(wrench)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of two vectors; ``np.cross`` takes twenty times as long."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def _lost_motions(hold: _Hold, space: np.ndarray, best: float) -> tuple[LostMotion, ...]:
    """A basis of lost wrenches (6, k): first those that have names, then others."""
    motions = []
    for line in hold.names:
        part = space.T @ line.wrench
        size = np.linalg.norm(part)
        if size * size > 1.0 - ALIKE * ALIKE:
            motions.append(_motion(hold, line._replace(wrench=space @ part / size), best))
            space = space @ np.linalg.svd(part[None, :])[2][1:].T
    screws = [_Named(_screw(hold, wrench), wrench) for wrench in space.T]
    return (*motions, *(_motion(hold, screw, best) for screw in screws))


def _motion(hold: _Hold, line: _Named, best: float) -> LostMotion:
    share, force, moment = hold.share(line.wrench, best), line.wrench[:3], line.wrench[3:]
    words = f"{'no' if share < NONE else 'little'} {line.name}"
    return LostMotion(words, force, hold.length * moment, hold.place, share, line.along_reach)


def _screw(hold: _Hold, wrench: np.ndarray) -> str:
    """A wrench in words by its axis."""
    force, moment = wrench[:3], hold.length * wrench[3:]
    size = float(np.linalg.norm(force))
    if size < ALIKE:
        return f"turn about {_vector(moment)}"
    pitch = float(force @ moment) / size**2
    if abs(pitch) > ALIKE * hold.length:
        return f"screw along {_vector(force)}, {_metres(pitch)} a radian"
    offset = float(np.linalg.norm(_cross(force, moment))) / size**2
    where = f" {_metres(offset)} off the tip" if offset > ALIKE * hold.length else ""
    return f"motion along {_vector(force)}{where}"


def _vector(v: np.ndarray) -> str:
    """Direction with two decimals, the first number of them positive."""
    v = np.round(v / np.linalg.norm(v), 2)
    v = v * np.sign(v[np.flatnonzero(v)[0]]) + 0.0
    return f"({v[0]:.2f}, {v[1]:.2f}, {v[2]:.2f})"


def _metres(length: float) -> str:
    return f"{length:.2f} m" if abs(length) >= 0.1 else f"{1e3 * length:.2g} mm"
