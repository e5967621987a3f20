"""Geometry of the contacts at a state: where they are, their normals, wrenches and matrices.

Contacts of two surfaces are located by Newton's method from where they were last.  At a start, and
where that fails, the method is started from many points.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.contacts.kernel import (
    LINE_CONTACT,
    ContactRow,
    bodies_of,
    distance_of,
    locate_pair,
    tip_offset,
)
from multiarm.contacts.matrices import (
    ContactTerms,
    RelativeMotion,
    contact_matrices,
    seen_from_object,
)
from multiarm.contacts.motion import BodyMotion, open_body, open_relative, write_relative_motion
from multiarm.contacts.table import PAIR, Code, ContactGeometry, open_code
from multiarm.contacts.unilateral import Constraint
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.data import Data, Evaluated
from multiarm.dynamics.equations import update_kinematics, write_inertias
from multiarm.dynamics.failures import is_tip_of_arm, owner_of, require_ok
from multiarm.dynamics.guard_functions import depth_on_body, packed_patch
from multiarm.dynamics.kinematics import inertias_in
from multiarm.dynamics.model import Model
from multiarm.dynamics.solver.dense import null_space, reciprocal_lengths
from multiarm.dynamics.state import State
from multiarm.dynamics.status import OK
from multiarm.errors import ModelError, SceneError
from multiarm.geometry.records import (
    SURFACE_ON_ARM,
    SURFACE_ON_OBJECT,
    Contact,
    Patch,
)
from multiarm.geometry.screws import first_largest
from multiarm.jit.kernels import INT, INTS, NUMBERS, kernel
from multiarm.jit.rows import as_row, fields_of
from multiarm.jit.vectors import add_symmetric, put, rotate, sub, vec
from multiarm.robots.robot import Tip
from multiarm.scene.bodies import BodyName
from multiarm.scene.values import of_surroundings
from multiarm.spatial import quaternion_to_matrix


def place_state(data: Data, t: float, state: State) -> None:
    """Write a state into the arrays, and locate its contacts of two surfaces.

    Newton's method starts from the contacts of the start, and where that fails from many points.
    """
    data.set_state(t, state)
    table = data.model.constants.contacts
    if not len(table.shapes) or not (fields_of(Code, table.codes).kind == PAIR).any():
        return
    status = update_kinematics(data.struct)
    if status == OK and np.all(np.isfinite(data.arrays.rows.kinematics)):
        return
    data.forgive()
    places = locate_pairs(data, state)
    data.set_state(t, state)
    data.arrays.last_step.points[:] = places


def locate_pairs(data: Data, start: State) -> np.ndarray:
    """Where two surfaces touch, for every such contact: ``places`` of the kernel, (S, 3).

    Newton's method is started from many points.  Of the solutions, the one with the smallest gap
    counts, since surfaces touch at the start.

    Raises
    ------
    SceneError
        When two surfaces have no common normal near each other, or touch along a line.
    """
    places = np.zeros_like(data.arrays.search.points)
    codes = fields_of(Code, data.model.constants.contacts.codes)
    pairs = np.flatnonzero(codes.kind == PAIR)
    if not pairs.size:
        return places
    data.set_state(0.0, start)
    status, surface = update_kinematics(data.struct), data.callbacks.get("surface")
    if surface is None or surface.error is None:
        require_ok(data, status)
    data.forgive()  # surfaces of contacts that are not located yet may have failed
    faults = []
    for row in map(int, pairs):
        owner, contact = data.model.owner(row)
        place = _locate(data, row, owner)
        if place is None:
            faults.append(
                f"{owner_of(data.model, owner)}: the two surfaces of '{contact.name}' "
                f"have no common normal line, or touch along a line and not in a point; correct "
                f"their placement, or use several contacts with spherical tips"
            )
        else:
            places[codes.shape[row]] = place
    if faults:
        raise SceneError(faults)
    return places


def contact_places(data: Data, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and normals into the second bodies of all rows, world axes, shapes (N, 3).

    Rows of all owners: see ``Layout``.  Nothing is solved.

    Raises
    ------
    SolverError
        When a user-defined surface fails.
    """
    place_state(data, 0.0, state)
    require_ok(data, update_kinematics(data.struct))
    return points_and_normals(data, slice(None))


def points_and_normals(data: Evaluated, rows: slice) -> tuple[np.ndarray, np.ndarray]:
    """Contact points [m], normals into the second bodies, of some rows, world axes, (k, 3) each.

    At the kinematics in the data.
    """
    table, count = data.model.constants.contacts, data.model.layout.contacts
    contacts = fields_of(ContactRow, data.arrays.rows.kinematics[rows])
    codes = fields_of(Code, table.codes[:count][rows])
    radii = fields_of(ContactGeometry, table.geometry[:count][rows]).tip_radius
    tips = zip(codes.kind, codes.surface_body, radii, strict=True)
    offsets = np.array([tip_offset(*tip) for tip in tips]).reshape(-1, 1)
    return contacts.point + offsets * contacts.normal, contacts.normal.copy()


def contact_terms(data: Evaluated) -> dict[str, ContactTerms]:
    """Contact matrices of every connection at the kinematics in the data."""
    b, table = data.arrays, data.model.constants.contacts
    every_row = np.vstack([b.rows.kinematics, b.rows.parts])
    terms = {}
    for name in data.model.connections:
        rows = data.model.layout.contacts_of(data.model.layout.owners.index(name))
        first, second = (b.bodies.motion[body] for body in data.model.bodies_of(name))
        matrices = contact_matrices(
            table, every_row, np.arange(rows.start, rows.stop), first, second,
            _tip_kinematics(data.model.tip_of(name), first),
        )  # fmt: skip
        contacts = fields_of(ContactRow, b.rows.kinematics[rows])
        points, normals = points_and_normals(data, rows)
        terms[name] = ContactTerms(
            *matrices,
            c=-contacts.gap_bias,
            phi=contacts.gap.copy(),
            phi_dot=contacts.gap_rate.copy(),
            points=points,
            normals=normals,
        )
    return terms


def constraint_matrix(data: Evaluated) -> np.ndarray:
    """Stacked constraint matrix ``[W_o; W]`` at the kinematics in the data, (6 F + n, N).

    It is scaled so that its singular values can be compared: joint and object coordinates by the
    square root of their inertia, contacts to unit length.
    """
    return of_unit_length(scaled_force_directions(data))


def of_unit_length(columns: np.ndarray) -> np.ndarray:
    """Columns of length 1 with the same directions; those that are roundings stay so."""
    return columns * reciprocal_lengths(np.linalg.norm(columns, axis=0))


def scaled_force_directions(data: Evaluated) -> np.ndarray:
    """:func:`force_directions`, coordinates scaled by the square root of their inertia.

    Of all inertias in ``work.M`` (:func:`multiarm.dynamics.equations.write_inertias`).
    """
    layout, scale = data.model.layout, np.empty(data.model.layout.nv)
    scale[layout.of_frames] = np.sqrt(np.diag(data.arrays.bodies.object_inertia))
    for i in layout.blocks_of_robots:
        joints = layout.of_block(i)
        scale[joints] = np.sqrt(np.diag(data.work.M[i])[: joints.stop - joints.start])
    return force_directions(data) / scale[:, None]


def block_inertias(data: Data) -> list[np.ndarray]:
    """Inertias of all blocks at the last terms of the robots, symmetric, shape (n, n) each."""
    write_inertias(data.struct)
    return inertias_in(data.work)


def robot_matrix(data: Evaluated, i: int) -> np.ndarray:
    """What unit forces of the rows of a robot's blocks do to its joints, shape (n_i, N_i)."""
    layout = data.model.layout
    return force_directions(data)[layout.of_robot(i), layout.contacts_of_blocks_of(i)]


def force_directions(data: Evaluated) -> np.ndarray:
    """What unit contact forces do to objects and joints, ``[W_o; W]``, shape (6 F + n, N)."""
    layout, work = data.model.layout, data.work
    directions = np.zeros((layout.nv, layout.contacts))
    directions[layout.of_frames] = data.arrays.rows.W_o.T
    for i in layout.blocks_of_robots:
        joints, rows = layout.of_block(i), layout.contacts_of_block(i)
        directions[joints, rows] = work.W[i, : joints.stop - joints.start, : rows.stop - rows.start]
    return directions


def relative_motion(model: Model, state: State, connection: str) -> RelativeMotion:
    """Pose and twist of a connection's first frame relative to its second body, in its axes.

    Raises
    ------
    ModelError
        For an unknown connection.
    """
    if connection not in model.connections:
        known = ", ".join(model.connections)
        noun = "arm" if all(map(is_tip_of_arm, model.connections.values())) else "connection"
        raise ModelError(f"unknown {noun} {connection!r}; {noun}s are {known}")
    pair = model.connections[connection]
    (X_WB, twist_B), (X_WA, twist_A) = (
        pose_and_twist(model, state, body) for body in (pair.second, pair.first)
    )
    return seen_from_object(X_WB, twist_B, X_WA, twist_A)


def pose_and_twist(model: Model, state: State, body: BodyName) -> tuple[np.ndarray, np.ndarray]:
    """Pose (4, 4) and twist (6,) of a body's frame, of a link that of its tip, world axes."""
    X, twist = np.eye(4), np.zeros(6)
    if body.is_object:
        moving = state.objects[body.tip]
        X[:3, :3] = quaternion_to_matrix(moving.quaternion_xyzw.copy())
        X[:3, 3], twist = moving.position, moving.twist
    if body.is_link:
        robot, positions, rates = body.robot, state.joint_positions, state.joint_velocities
        base, arm = state.bases.get(robot), model.robots[robot]
        tip = arm.tip_kinematics(positions[robot], rates[robot], body.tip, base)
        X[:3, :3], X[:3, 3], twist = tip.rotation, tip.position, tip.twist
    return X, twist


def wrench_rows(data: Evaluated) -> np.ndarray:
    """Wrenches ``[e; (P - x) x e]`` of unit forces on the second bodies, world axes, shape (N, 6).

    At the kinematics in the data.  ``x`` is the object's centre of mass; of another body the origin
    of the joint's frame on it.
    """
    model, rows = data.model, np.zeros((data.model.layout.contacts, 6))
    for c, owner in enumerate(model.layout.owners):
        own, o = model.layout.contacts_of(c), _object_pushed(model, owner)
        if o is not None:
            rows[own] = data.arrays.rows.W_o[own, 6 * o : 6 * o + 6]
        elif owner in model.connections:
            x = _reference_point(data, owner)
            contacts = fields_of(ContactRow, data.arrays.rows.kinematics[own])
            moment = np.cross(contacts.point - x, contacts.normal) + contacts.couple
            rows[own] = np.hstack([contacts.normal, moment])
    return rows


def _object_pushed(model: Model, owner: str) -> int | None:
    """The object that is the second body of an owner of rows; None for another body."""
    second = int(model.constants.connections.second[model.layout.owners.index(owner)])
    o = second - len(model.backends.links)
    return o if 0 <= o < model.layout.frames else None


def _reference_point(data: Evaluated, connection: str) -> np.ndarray:
    """The point about which :func:`wrench_rows` has the moments of a connection, shape (3,) [m]."""
    body = fields_of(BodyMotion, data.arrays.bodies.motion[data.model.bodies_of(connection)[1]])
    if data.model.connections[connection].on_object:
        return body.origin
    return body.origin + body.rotation @ data.model.frames_on_bodies(connection).origin_on_object


def joint_wrenches(data: Evaluated, connection: str) -> np.ndarray:
    """Rows ``[e; (p - x) x e / size]`` of a connection at the kinematics in the data.

    Shape (N, 6), in the axes of the second body's joint frame about the first one's, each of unit
    length; moments are measured at the longest lever arm [m].  Rows that belong to joints have
    none, and are left out.
    """
    model = data.model
    body = fields_of(BodyMotion, data.arrays.bodies.motion[model.bodies_of(connection)[1]])
    R = body.rotation @ model.frames_on_bodies(connection).on_object
    rows = wrenches_about(data, connection, joint_origin(data, connection))
    rows = rows[np.any(rows != 0.0, axis=1)]
    force, moment = rows[:, :3], rows[:, 3:]
    size = float(np.max(np.linalg.norm(moment, axis=1), initial=0.0)) or 1.0
    wrenches = np.hstack([force @ R, moment @ R / size])
    return wrenches / np.linalg.norm(wrenches, axis=1)[:, None]


def wrenches_about(data: Evaluated, connection: str, place: np.ndarray) -> np.ndarray:
    """Wrenches of unit forces on a connection's second body about a place (3,) [m], shape (N, 6).

    World axes; at the kinematics in the data.  Rows that belong to joints have none: zeros.
    """
    layout = data.model.layout
    rows = wrench_rows(data)[layout.contacts_of(layout.owners.index(connection))]
    moment = rows[:, 3:] - np.cross(place - _reference_point(data, connection), rows[:, :3])
    return np.hstack([rows[:, :3], moment])


def joint_origin(data: Evaluated, connection: str) -> np.ndarray:
    """Origin of a connection's frame on its first body, world axes, shape (3,) [m]."""
    link = fields_of(BodyMotion, data.arrays.bodies.motion[data.model.bodies_of(connection)[0]])
    return link.origin + link.rotation @ data.model.frames_on_bodies(connection).origin_on_link


def free_components(data: Data, connection: str, start: State) -> tuple[int, ...]:
    """Components of the relative twist that a connection leaves free, at the start.

    They are the components of the joint frame with the largest parts in the null space of the
    joint's rows (with pivoting); rotations are scaled by the joint's size.
    """
    data.set_state(0.0, start)
    require_ok(data, update_kinematics(data.struct))
    wrenches = joint_wrenches(data, connection)
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


def patch_of(model: Model, constraint: Constraint) -> np.ndarray | None:
    """Frame and corners of the patch of the surroundings that a contact must be on, (18,)."""
    record = model.records[constraint.row]
    if not of_surroundings(constraint.owner) or not isinstance(record, Contact):
        return None
    patch: Patch | None = record.arm.patch
    if patch is None or record.surface_body != SURFACE_ON_ARM:
        return None
    return packed_patch(patch)


def patch_margin(data: Data, constraint: Constraint) -> float:
    """How far inside its patch a contact is at the kinematics in the data [m].

    Infinite where there is no patch.
    """
    patch = patch_of(data.model, constraint)
    if patch is None:
        return np.inf
    return depth_of_contact(data.struct, patch, data.model.world_number, constraint.row)


@kernel
def depth_of_contact(struct: INTS, patch: NUMBERS, body: INT, row: INT):
    """:func:`multiarm.dynamics.guard_functions.depth_on_body`, for Python."""
    model, data, _ = open_system(struct)
    return depth_on_body(patch, body, row, model, data)


def _locate(data: Data, row: int, connection: str) -> np.ndarray | None:
    """Point of the guiding surface, in its body, where two surfaces touch, shape (3,)."""
    code = Code(*data.model.constants.contacts.codes[row].tolist())
    bodies = np.array(data.model.bodies_of(connection))
    guiding = int(bodies[1 if code.surface_body == SURFACE_ON_OBJECT else 0])
    best, smallest, trouble, second = None, np.inf, None, np.zeros(6)
    for guess in _guesses(data, connection, row, guiding):
        place = guess.copy()
        gap = abs(locate_contact(data.struct, row, bodies, place, second))
        if data.arrays.status.failed:  # a user function has no answer there
            trouble = data.callbacks["surface"].error
            data.forgive()
        elif gap < smallest and not _is_line(second):
            best, smallest = place, gap
    if best is None and trouble is not None:
        raise trouble
    return best


@kernel
def locate_contact(struct: INTS, row: INT, bodies: INTS, place: NUMBERS, second: NUMBERS):
    """Locate the contact of two surfaces of a row near ``place``, and move this there, for Python.

    ``place`` (3,) is in the guiding body's frame.  Writes the second derivatives (6,) of the gap
    there [1/m]; returns the gap [m], NaN where there is no contact.
    """
    model, data, _ = open_system(struct)
    table, search, code = model.contacts, data.search, open_code(model.contacts.codes[row])
    motion = data.bodies.motion
    a, b, _ = bodies_of(code, motion[bodies[0]], motion[bodies[1]])
    write_relative_motion(a, b, search.relative)
    if not locate_pair(code.shape, a, b, table, search, place):
        return math.nan
    z = rotate(open_body(b).rotation, vec(place, 0))
    d = sub(z, open_relative(search.relative).shift)
    s_A, _, H_A = distance_of(code.shape + 1, a, d, table, search)
    s_B, _, H_B = distance_of(code.shape, b, z, table, search)
    H = add_symmetric(H_A, H_B)
    put(second, 0, H[0:3])
    put(second, 3, H[3:6])
    return s_A + s_B


def _is_line(second: np.ndarray) -> bool:
    """Whether the curvature of one surface against the other vanishes along a tangent."""
    xx, xy, xz, yy, yz, zz = second
    sizes = np.sort(np.abs(np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])))
    return bool(sizes[1] <= LINE_CONTACT * sizes[2])


def _guesses(data: Data, connection: str, row: int, guiding: int) -> np.ndarray:
    """Points in the guiding body's frame around both surfaces, shape (g, 3)."""
    _, contact = data.model.owner(row)
    assert isinstance(contact, Contact), "two surfaces are a contact's"
    frames, motion = data.model.frames_on_bodies(connection), data.arrays.bodies.motion
    link, body, guide = (
        fields_of(BodyMotion, motion[k]) for k in (*data.model.bodies_of(connection), guiding)
    )
    centres = [
        body.origin + body.rotation @ contact.object.origin,
        link.origin + link.rotation @ contact.arm.origin,
        body.origin + body.rotation @ frames.origin_on_object,
    ]
    sizes = [abs(s) for surface in (contact.arm, contact.object) for s in surface.sizes if s]
    reach = max([*sizes, 1e-3])
    # points evenly distributed over a sphere (Fibonacci's spiral)
    count = 60
    k = np.arange(count) + 0.5
    height, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + 5.0**0.5) * k
    flat = np.sqrt(1.0 - height**2)
    around = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), height])
    world = np.vstack([np.vstack([c, c + 1e-3 * reach, c + reach * around]) for c in centres])
    return (world - guide.origin) @ guide.rotation


def _tip_kinematics(tip: Tip, link: np.ndarray) -> np.ndarray:
    """Kinematics of a tip's frame from those of the link it is fixed to, a row of 24."""
    motion = fields_of(BodyMotion, link)
    offset, omega, alpha = motion.rotation @ tip.translation, motion.spin, motion.spin_rate
    turning = np.cross(alpha, offset) + np.cross(omega, np.cross(omega, offset))
    frame = BodyMotion(
        rotation=motion.rotation @ tip.rotation,
        origin=motion.origin + offset,
        velocity=motion.velocity + np.cross(omega, offset),
        spin=omega,
        acceleration=motion.acceleration + turning,
        spin_rate=alpha,
    )
    return as_row(frame)
