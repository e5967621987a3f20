"""Whether the contacts of a scene make sense at its start, and what they leave free.

Each fault is told with the arm, the contact and the remedy: surfaces that have no common normal, or
touch along a line, a tip outside the patch that it should touch, rows that say the same twice.
"""

from __future__ import annotations

import numpy as np

from multiarm.assembly.system import System
from multiarm.contacts.kernel import AT, NORMAL, RELATIVE_WIDTH
from multiarm.contacts.records import (
    CURVED,
    CYLINDER,
    KIND,
    LINK,
    PAIR,
    PLANE,
    SPHERE,
    SURFACE_BODY,
    SURFACE_ON_OBJECT,
    TIP_RADIUS,
    Contact,
)
from multiarm.contacts.rows import LINE_CONTACT, locate_pair
from multiarm.contacts.screws import first_largest
from multiarm.contacts.surfaces import DISTANCE, SECOND, world_distance
from multiarm.dynamics.arrays import CALL_SURFACE
from multiarm.dynamics.equations import OK, update_kinematics
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.state import State
from multiarm.errors import SceneError
from multiarm.integration.monitors import DRIVE, FORCE, LIMIT, WATCH_BODY, WATCH_ROW, margin_of

# Directions in which a contact of two surfaces is looked for.
_GUESSES = 60


def locate_pairs(system: System, start: State) -> np.ndarray:
    """Where two surfaces touch, for every such contact: ``places`` of the kernel, (S, 3).

    Newton's method begins in many places; of what it finds, the contact with the smallest gap is
    the one meant, since at the start surfaces touch.

    Raises
    ------
    SceneError
        When two surfaces have no common normal near each other, or touch along a line.
    """
    places = np.zeros_like(system.buffers.places)
    pairs = np.flatnonzero(system.plant.codes[:, KIND] == PAIR)
    if not pairs.size:
        return places
    system.set_state(0.0, start)
    update_kinematics(system.struct())
    system.forgive()  # what is not located yet may well have failed
    faults = []
    for row in map(int, pairs):
        arm, contact = system.owner(row)
        found = _locate(system, row, arm)
        if found is None:
            faults.append(
                f"arm '{arm}': the two surfaces of '{contact.name}' have no common normal line, or "
                f"touch along a line and not in a point; mend their placement, or use several "
                f"contacts with spherical tips"
            )
        else:
            places[system.plant.codes[row, LINK]] = found
    if faults:
        raise SceneError(faults)
    return places


def place_state(system: System, t: float, state: State) -> None:
    """Write a state into the buffers, and find its contacts of two surfaces.

    They are looked for near where they were at the start, and everywhere if that fails.
    """
    system.set_state(t, state)
    if not (system.plant.codes[:, KIND] == PAIR).any():
        return
    status = update_kinematics(system.struct())
    if status == OK and np.all(np.isfinite(system.buffers.contacts)):
        return
    system.forgive()
    places = locate_pairs(system, state)
    system.set_state(t, state)
    system.buffers.places[:] = places


def check_patches(system: System) -> None:
    """Check that the contacts of the assembled start are on their patches.

    Raises
    ------
    SceneError
        Names the contacts that are not.
    """
    _kinematics(system, system.initial_state())
    faults = _outside(system)
    if faults:
        raise SceneError(faults)


def choose_free(system: System, arm: str) -> tuple[int, ...]:
    """Components of the relative twist that the joint of an arm leaves free, at the start.

    They are those of the joint frame in which the null space of the joint's rows has the largest
    parts, chosen one after the other (pivoting); turns are measured at the joint's own size.
    """
    _kinematics(system, system.initial_state())
    wrenches = joint_wrenches(system, arm)
    space = null_space(wrenches).basis  # (6, m)
    chosen: list[int] = []
    for _ in range(space.shape[1]):
        sizes = np.linalg.norm(space, axis=1)
        sizes[chosen] = -1.0
        best = first_largest(sizes)
        chosen.append(best)
        direction = space[best] / np.linalg.norm(space[best])
        space = space - np.outer(space @ direction, direction)
    return tuple(sorted(chosen))


def joint_wrenches(system: System, arm: str) -> np.ndarray:
    """Rows ``[e; (p - x) x e / size]`` of a joint at the kinematics in the buffers.

    Shape (N, 6), in the axes of the object's joint frame about the arm's, each of unit length;
    moments are measured at the longest lever arm [m].  Rows that belong to the arm's own joints
    have none, and are left out.
    """
    i = system.arm_names.index(arm)
    buffers, frame = system.buffers, system.frames[arm]
    body, link = buffers.body, buffers.arms[i]
    R = body[:9].reshape(3, 3) @ frame.on_object[:3, :3]
    tip = system.arms[arm]
    at = tip.tip_rotation @ frame.on_tip[:3, 3] + tip.tip_translation
    x = link[9:12] + link[:9].reshape(3, 3) @ at
    rows = buffers.Wo[system.layout.rows[i] : system.layout.rows[i + 1]]
    rows = rows[np.any(rows != 0.0, axis=1)]
    force = rows[:, :3]
    moment = rows[:, 3:] - np.cross(x - body[9:12], force)
    size = float(np.max(np.linalg.norm(moment, axis=1), initial=0.0)) or 1.0
    wrenches = np.hstack([force @ R, moment @ R / size])
    return wrenches / np.linalg.norm(wrenches, axis=1)[:, None]


def _outside(system: System) -> list[str]:
    faults = []
    for watch in system.plant.watches:
        if int(watch[WATCH_BODY]) in (FORCE, LIMIT, DRIVE):
            continue
        excess = margin_of(watch, system.plant, system.buffers)
        if excess > 0.0:
            arm, contact = system.owner(int(watch[WATCH_ROW]))
            faults.append(
                f"arm '{arm}': '{contact.name}' touches {excess:.3g} m outside the patch of its "
                f"surface; mend the posture, or the patch's 'min' and 'max'"
            )
    return faults


def _kinematics(system: System, state: State) -> None:
    system.set_state(0.0, state)
    if update_kinematics(system.struct()) != OK:
        system.reraise()


def _locate(system: System, row: int, arm: str) -> np.ndarray | None:
    """Point of the guiding surface, in its body, where two surfaces touch, shape (3,)."""
    plant, buffers = system.plant, system.buffers
    link, body = buffers.arms[system.arm_names.index(arm)], buffers.body
    on_object = plant.codes[row, SURFACE_BODY] == SURFACE_ON_OBJECT
    a, b = (link, body) if on_object else (body, link)
    first, calls = int(plant.codes[row, LINK]), plant.calls[CALL_SURFACE]
    query = buffers.query[RELATIVE_WIDTH:]
    r = a[9:12] - b[9:12]
    best, smallest, trouble = None, np.inf, None
    for guess in _guesses(system, arm, row, b):
        place = guess.copy()
        located = locate_pair(a, b, plant.shapes, first, tuple(r), query, calls, place)
        z = b[:9].reshape(3, 3) @ place
        world_distance(plant.shapes[first + 1], a, tuple(z - r), query, calls)
        gap, second = query[DISTANCE], query[SECOND : SECOND + 6].copy()
        world_distance(plant.shapes[first], b, tuple(z), query, calls)
        gap, second = abs(gap + query[DISTANCE]), second + query[SECOND : SECOND + 6]
        if buffers.flag[0] != 0:  # a function of the user's has no answer there
            trouble = system.calls["surface"].error
            system.forgive()
            continue
        if not located:
            continue
        if gap < smallest and not _is_line(second):
            best, smallest = place, gap
    if best is None and trouble is not None:
        raise trouble
    return best


def _is_line(second: np.ndarray) -> bool:
    """Whether the curvature of one surface against the other vanishes along a tangent."""
    xx, xy, xz, yy, yz, zz = second
    sizes = np.sort(np.abs(np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])))
    return bool(sizes[1] <= LINE_CONTACT * sizes[2])


def _guesses(system: System, arm: str, row: int, b: np.ndarray) -> np.ndarray:
    """Points in the guiding body's frame around both surfaces, shape (g, 3)."""
    _, contact = system.owner(row)
    assert isinstance(contact, Contact), "two surfaces are a contact's"
    frame, tip = system.frames[arm], system.arms[arm]
    i = system.arm_names.index(arm)
    link, body = system.buffers.arms[i], system.buffers.body
    on_link = contact.moved_on_arm(tip.tip_rotation, tip.tip_translation)
    centres = [
        body[9:12] + body[:9].reshape(3, 3) @ contact.object.origin,
        link[9:12] + link[:9].reshape(3, 3) @ on_link.arm.origin,
        body[9:12] + body[:9].reshape(3, 3) @ frame.on_object[:3, 3],
    ]
    sizes = [abs(s) for surface in (contact.arm, contact.object) for s in surface.sizes if s]
    reach = max([*sizes, 1e-3])
    # points spread evenly over a sphere (Fibonacci's spiral)
    k = np.arange(_GUESSES) + 0.5
    height, turn = 1.0 - 2.0 * k / _GUESSES, np.pi * (1.0 + 5.0**0.5) * k
    flat = np.sqrt(1.0 - height**2)
    around = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), height])
    world = np.vstack([np.vstack([c, c + 1e-3 * reach, c + reach * around]) for c in centres])
    return (world - b[9:12]) @ b[:9].reshape(3, 3)


def points_and_normals(system: System, rows: slice) -> tuple[np.ndarray, np.ndarray]:
    """Contact points [m] and normals into the object of some rows, world axes, shapes (k, 3).

    At the kinematics in the buffers.
    """
    plant, contacts = system.plant, system.buffers.contacts[rows]
    normals = contacts[:, NORMAL : NORMAL + 3].copy()
    codes, geometry = plant.codes[: system.layout.contacts], plant.geometry
    tips = np.isin(codes[rows, KIND], (PLANE, SPHERE, CYLINDER, CURVED))
    radius = geometry[: system.layout.contacts][rows, TIP_RADIUS] * tips
    # from the tip's centre to its contact point: along the normal if the arm has the tip
    way = np.where(codes[rows, SURFACE_BODY] == SURFACE_ON_OBJECT, 1.0, -1.0)
    return contacts[:, AT : AT + 3] + (way * radius)[:, None] * normals, normals
