r"""Assembling a start: it is put on the constraints with the least change, which is reported.

*Positions.*  The arms move onto the joints with the object held, each on its own; where one cannot,
or only by a large swing for a small gap, the object moves too.  The joints stay within their limits
and on the branch of the written start (:mod:`multiarm.assembly.loop_closure`).  A start that is too
far off, or whose contacts contradict each other, is refused with its residuals.

*Velocities.*  The least change in the metric of the inertia,

.. math:: \min_{\delta v} \tfrac12\, \delta v^T M\, \delta v \ \text{ with }\ W^T(v + \delta v) = 0,

which is an inelastic impact that closes all gap rates; ``W`` may have dependent columns.  With
:math:`M = L L^T` and :math:`A = W^T L^{-T}` the velocities :math:`w = L^T v` are projected on the
null space of ``A``, from its singular value decomposition:

.. math:: w^+ = w - V_r V_r^T w, \qquad
    \tfrac12 |w|^2 - \tfrac12 |w^+|^2 = \tfrac12 |V_r^T w|^2 .

Nothing is divided by a singular value: dependent rows and singular arms need no special treatment.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.assembly.loop_closure import (
    CLOSED,
    FAR,
    FARTHEST,
    Closing,
    Linkage,
    close_gaps,
    projection_tolerance,
    scene_size,
)
from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.contacts.table import JointRow
from multiarm.contacts.unilateral import LIMIT, Constraint
from multiarm.dynamics.contact_geometry import patch_margin, place_state
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import lost_contact, require_ok
from multiarm.dynamics.model import Data, Model
from multiarm.dynamics.state import State
from multiarm.dynamics.status import OK
from multiarm.dynamics.system import StartReport, System
from multiarm.errors import ModelError, SceneError
from multiarm.integration.projection import project_velocities
from multiarm.integration.reporting_guards import contacts_off_patch
from multiarm.scene import Scene
from multiarm.scene.faults import counted
from multiarm.scene.values import SURROUNDINGS

# Gaps below this part of the scene's size count as touching.
TOUCHING = 1e-9


def assemble(data: Data, scene: Scene, name: str = "the start") -> tuple[State, StartReport]:
    """Put the state in the data on the constraints; ``name`` is its name in messages.

    A state that satisfies the joints to within :func:`projection_tolerance` is not changed.

    Raises
    ------
    SceneError
        When a gap is too large or cannot be closed, with the residuals of the joints.
    SolverError
        When an arm's inertia is not positive definite.
    """
    written, layout = data.get_state(), data.model.layout
    require_ok(data, update_kinematics(data.struct))
    lost = np.flatnonzero(~np.isfinite(data.arrays.rows.kinematics).all(axis=1))
    if lost.size:
        raise SceneError(
            [f"{lost_contact(data, int(row))}; correct its placement at the start" for row in lost]
        )
    gaps, rates = gaps_by_arm(data), gaps_by_arm(data, GAP_RATE)
    size = scene_size(data)
    limit = 0.1 * size
    if not all(gap <= limit for gap in gaps.values()):
        raise SceneError(_too_far(data, scene, name, gaps, limit))
    limits, outside = _limits(data, written)
    held = _close(data, name, gaps, limits, size)
    _check_way_round(data, scene, name)
    energy_lost = _close_rates(data, size)
    start = data.get_state()
    displacement = np.abs(written.displacement_to(start))
    moved, shift = layout.joint_rates(displacement), layout.twists(displacement)[0]
    faster = np.abs(start.velocity - written.velocity)
    of_object = layout.twists(faster)[0]
    return start, StartReport(
        gaps=gaps,
        gap_rates=rates,
        gaps_left=gaps_by_arm(data),
        joint_change=float(np.max(moved)),
        joint_changes={
            arm: float(np.max(change)) for arm, change in layout.split_joints(moved).items()
        },
        object_held=held,
        object_shift=float(np.linalg.norm(shift[:3])),
        object_turn=float(np.linalg.norm(shift[3:])),
        at_limit=joints_at_limit(data),
        outside_limits=outside,
        velocity_change=float(np.max(faster)),
        object_velocity_change=float(np.linalg.norm(of_object[:3])),
        object_spin_change=float(np.linalg.norm(of_object[3:])),
        joint_velocity_change=float(np.max(layout.joint_rates(faster))),
        energy_lost=energy_lost,
    )


def unassembled(data: Data) -> StartReport:
    """The report of a start that is left as it is in the data."""
    require_ok(data, update_kinematics(data.struct))
    gaps = gaps_by_arm(data)
    rates = gaps_by_arm(data, GAP_RATE)
    return StartReport(gaps=gaps, gap_rates=rates, gaps_left=gaps, assembled=False)


def project_start(data: Data, scene: Scene, state: State) -> tuple[State, StartReport]:
    """Put a copy of a given state on the constraints, as a scene's start.

    The copy is equal bit for bit where the state satisfies the joints to within
    :func:`projection_tolerance` and its gap rates are roundings.

    Raises
    ------
    ModelError
        When the state belongs to another system, is not finite, or is too far off.
    SolverError
        When an arm's inertia is not positive definite.
    """
    described = "the given state"
    if not (np.all(np.isfinite(state.position)) and np.all(np.isfinite(state.velocity))):
        raise ModelError(f"{described} is not finite; make it with `system.state(...)`")
    try:
        place_state(data, 0.0, state)
        return assemble(data, scene, described)
    except SceneError as error:
        raise ModelError(
            f"{described} cannot be the beginning of a run:\n"
            + "\n".join(f"  {fault}" for fault in error.faults)
            + "\n`system.initial_state()` satisfies the joints; begin near it"
        ) from error


def project_velocity(system: System, state: State) -> State:
    """Project the velocities of a state on the constraints, in the inertia metric (thesis, 4.2).

    The correction is the one that loses the least kinetic energy: an inelastic impact that closes
    all gap rates.  Positions stay.
    """
    with system.borrow() as data:
        place_state(data, 0.0, state)
        status = update_kinematics(data.struct)
        if status == OK:
            status = project_velocities(data.struct)
        require_ok(data, status)
        return data.get_state()


def check_patches(data: Data, start: State) -> None:
    """Check that the contacts of the assembled start are on their patches.

    Raises
    ------
    SceneError
        Names the contacts that are not.
    """
    data.set_state(0.0, start)
    require_ok(data, update_kinematics(data.struct))
    faults = [
        f"arm '{arm}': '{contact}' touches {excess:.3g} m outside the patch of its surface; "
        f"correct the posture, or the patch's 'min' and 'max'"
        for arm, contact, excess in contacts_off_patch(data)
    ]
    if faults:
        raise SceneError(faults)


def check_unilateral(data: Data, start: State) -> None:
    """Check that unilateral contacts are not closed already, and joints within their ranges.

    Raises
    ------
    SceneError
        Naming all contacts and joints that are.
    """
    assert data.model.unilateral is not None
    data.set_state(0.0, start)
    require_ok(data, update_kinematics(data.struct))
    allowed, gaps = TOUCHING * scene_size(data), data.arrays.rows.kinematics[:, GAP]
    faults = []
    for constraint in data.model.unilateral.constraints:
        gap = float(gaps[constraint.row])
        if constraint.compliant or constraint.bilateral:
            continue
        if gap < -allowed and patch_margin(data, constraint) >= 0.0:
            faults.append(_inside(data, constraint, -gap))
    if faults:
        raise SceneError(faults)


def gaps_by_arm(data: Data, column: int = GAP) -> dict[str, float]:
    """Largest magnitude of one column of the contact kinematics, by arm."""
    parts = data.model.layout.split_contacts(np.abs(data.arrays.rows.kinematics[:, column]))
    return {arm: float(np.max(values, initial=0.0)) for arm, values in parts.items()}


def joint_names(model: Model) -> list[str]:
    """All joints as ``arm/joint``, in the order of the stacked vectors."""
    return [f"{arm}/{joint}" for arm, a in model.arms.items() for joint in a.joint_names]


def joints_at_limit(data: Data) -> tuple[str, ...]:
    """Joints at one of their limits in the data."""
    limits = np.vstack([arm.position_limits for arm in data.model.arms.values()])
    near = np.min(np.abs(limits - data.arrays.state.joint_positions[:, None]), axis=1) <= 1e-9
    return tuple(name for name, at in zip(joint_names(data.model), near, strict=True) if at)


def _close(data: Data, name: str, gaps: dict[str, float], limits: np.ndarray, size: float) -> bool:
    """Close the gaps of the state in the data; returns whether the object was held."""
    tolerance = projection_tolerance(data, size)
    if max(gaps.values()) <= tolerance:
        return True
    everything = list(range(len(data.model.arm_names)))
    linkage = Linkage(data, everything, True, limits)
    begin = linkage.here()
    closed, swings = True, False
    for i, gap in enumerate(gaps.values()):
        if gap > tolerance:
            arm = Linkage(data, [i], False, limits)
            # a larger motion than this for its gap is a swing past a singular posture
            far = 20.0 * arm.here().least_turn
            end = close_gaps(arm, tolerance)
            closed, swings = closed and end.status == CLOSED, swings or not end.change <= far
    if closed and not swings:
        return True
    arms_alone = linkage.here()
    linkage.place(begin)
    end = close_gaps(linkage, tolerance)
    if end.status == CLOSED:
        return False
    if closed:
        linkage.place(arms_alone)
        return True
    raise SceneError(_cannot_close(data, name, gaps, linkage, end))


def _check_way_round(data: Data, scene: Scene, name: str) -> None:
    """Raise where a joint is closed upside down.

    Contacts are rows of distances, and those of a weld or a slide vanish too where the joint's
    frames on arm and object differ by half a turn.
    """
    faults, R_O = [], data.arrays.bodies.object[:9].reshape(3, 3)
    links = dict(zip(data.model.arm_names, data.arrays.bodies.links[:, :9], strict=False))
    for joint in scene.joints:
        turns = None if joint.free is None else [k - 3 for k in joint.free if k >= 3]
        if turns is None or len(turns) > 1:
            continue
        frame, arm = data.model.frames[joint.arm], data.model.arms[joint.arm]
        R_T = links[joint.arm].reshape(3, 3) @ arm.tip_rotation
        R = (R_O @ frame.on_object[:3, :3]).T @ R_T @ frame.on_tip[:3, :3]
        # the cosine of the turn between both frames, or between the axes about which they may turn
        cosine = R[turns[0], turns[0]] if turns else 0.5 * (np.trace(R) - 1.0)
        if cosine < 0.0:
            angle = math.degrees(math.acos(max(cosine, -1.0)))
            faults.append(
                f"{name} closes the joint of arm '{joint.arm}' the wrong way round: its frame on "
                f"the arm is turned by {angle:.0f} degrees against that on the object; correct the "
                "posture or `at`, or let `posture: solve` find it"
            )
    if faults:
        raise SceneError(faults)


def _limits(data: Data, written: State) -> tuple[np.ndarray, tuple[str, ...]]:
    """Limits (n, 2) of all joints, and the names of joints outside theirs, which get no limits."""
    limits = np.vstack([arm.position_limits for arm in data.model.arms.values()])
    angles = data.model.layout.joint_positions(written.position)
    out = (angles < limits[:, 0]) | (angles > limits[:, 1])
    limits[out] = -np.inf, np.inf
    return limits, tuple(np.array(joint_names(data.model))[out])


def _close_rates(data: Data, size: float) -> float:
    """Project the velocities in the data, with its kinematics; returns the energy lost [J].

    Velocities whose gap rates are roundings are not changed.
    """
    b, joints = data.arrays, data.model.layout.joints
    free = np.full((joints, 2), [-np.inf, np.inf])
    linkage = Linkage(data, list(range(len(data.model.arm_names))), True, free, True, size)
    place, lost = linkage.here(), 0.0
    v = b.state.velocity / linkage.unit
    # 100 roundings of the terms that cancel in a rate
    terms = float(np.max(np.abs(place.rows) @ np.abs(v), initial=0.0))
    closed = 100 * np.finfo(float).eps * terms
    for _ in range(3):
        if not np.max(np.abs(b.rows.kinematics[:, GAP_RATE]), initial=0.0) > closed:
            break
        A = np.linalg.solve(place.factor, place.rows.T).T  # (N, 6 + n)
        _, s, Vt = np.linalg.svd(A, full_matrices=False)
        Vt = Vt[s > 1e-10 * s[0]]
        taken = Vt @ (place.factor.T @ v)
        v -= np.linalg.solve(place.factor.T, Vt.T @ taken)
        lost += 0.5 * float(taken @ taken)
        b.state.velocity[:] = linkage.unit * v
        require_ok(data, update_kinematics(data.struct))
    return lost


def _inside(data: Data, constraint: Constraint, depth: float) -> str:
    if constraint.kind != LIMIT:
        where = f"'{constraint.arm}/{constraint.name}' is inside the arm's surface"
        remedy = "the posture"
        if constraint.arm == SURROUNDINGS:
            where, remedy = f"'{constraint.name}' of the object is below the floor", "'object.pose'"
        return f"at the start {where} by {depth:.3g} m; correct {remedy}, or the surfaces"
    first = data.model.layout.dofs[data.model.arm_names.index(constraint.arm)]
    limit = data.model.records[constraint.row]
    assert isinstance(limit, JointRow) and limit.bound is not None, "a limit is a joint's"
    at = data.arrays.state.joint_positions[first + limit.joint]
    end = "below its lower end" if limit.side > 0.0 else "above its upper end"
    name = f"{constraint.arm}/{data.model.joint_name(constraint.joint)}"
    return (
        f"$.effects.joint_limits: '{name}' starts at {at:.6g}, {end} {limit.bound:.6g}; "
        f"correct the posture, or the range"
    )


def _too_far(
    data: Data, scene: Scene, name: str, gaps: dict[str, float], limit: float
) -> list[str]:
    """One fault for every joint whose gap in the data exceeds the limit [m]."""
    kinds = {joint.arm: joint.kind for joint in scene.joints}
    phi = data.model.layout.split_contacts(np.abs(data.arrays.rows.kinematics[:, GAP]))
    faults, near = [], {}
    for arm, gap in gaps.items():
        if gap <= limit:
            near[arm] = gap
            continue
        contact = data.model.contacts[arm][int(np.argmax(phi[arm]))]
        remedy = "or `at` (or leave `at` out to join the object where the tip is)"
        if kinds[arm] == "contacts":
            remedy = (
                "or the contact's geometry (of the arm in the tip's frame, of the object in its)"
            )
        faults.append(
            f"{name} does not satisfy the joint of arm '{arm}': a gap of {gap:.4g} m is left "
            f"at '{contact.name}', up to {limit:.3g} m is assembled; correct the posture, the base "
            f"{remedy}"
        )
    if near:
        faults[-1] += f" (gaps of the other joints: {_listed(near)})"
    return faults


def _cannot_close(
    data: Data, name: str, gaps: dict[str, float], linkage: Linkage, end: Closing
) -> list[str]:
    """Why the linkage of object and all arms could not be closed, from ``gaps`` as written [m].

    The posture that was reached is in the data.
    """
    faults = _contradictions(data, name, linkage)
    if faults:
        return faults
    if end.status == FAR:
        names = [*["the object"] * 6, *(f"joint '{name}'" for name in joint_names(data.model))]
        worst = int(np.argmax(end.changes))
        why = f"{names[worst]} would have to move by more than "
        why += f"{FARTHEST * linkage.unit[worst]:.3g} rad or m for it, which is no correction"
    else:
        left = {
            arm: f"{gap:.3g} m at '{_worst_contact(data, arm)}'"
            for arm, gap in gaps_by_arm(data).items()
        }
        why = "no motion of the arms and the object lessens what then is left, "
        why += ", ".join(f"{arm}: {text}" for arm, text in left.items())
        why += "; the arms are at the end of their reach, or have too few joints for these contacts"
        stopped = joints_at_limit(data)
        if stopped:
            why += f"; at a limit: {', '.join(stopped)}"
    return [
        f"{name} does not satisfy the joints and could not be closed from there (gaps "
        f"{_listed(gaps)}): {why}; move the postures or `at` closer together, "
        "or leave out `at` to join the object where the tip is"
    ]


def _listed(gaps: dict[str, float]) -> str:
    """Gaps of the arms [m] in one line."""
    return ", ".join(f"{arm}: {gap:.3g} m" for arm, gap in gaps.items())


def _worst_contact(data: Data, arm: str) -> str:
    phi = data.model.layout.split_contacts(data.arrays.rows.kinematics[:, GAP])[arm]
    return data.model.contacts[arm][int(np.argmax(np.abs(phi)))].name


def _contradictions(data: Data, name: str, linkage: Linkage) -> list[str]:
    """Joints whose own contacts cannot all be closed, wherever the arm is."""
    b, faults, tolerance = data.arrays, [], projection_tolerance(data)
    wrenches = b.rows.Wo[linkage.rows] * linkage.unit[:6]
    phi = b.rows.kinematics[linkage.rows, GAP]
    for arm, (of_arm, _) in zip(data.model.arm_names, linkage.blocks, strict=True):
        U, s, _ = np.linalg.svd(wrenches[of_arm])
        dependent = U[:, int(np.sum(s > 1e-9 * s[0])) :] if s.size else U
        opposed = dependent @ (dependent.T @ phi[of_arm])
        worst = float(np.max(np.abs(opposed), initial=0.0))
        # at least a tenth of the joint's largest gap; contacts with less than a tenth of the worst
        # part are not named
        if not worst > max(0.1 * float(np.max(np.abs(phi[of_arm]), initial=0.0)), tolerance):
            continue
        rows = linkage.rows[of_arm][np.abs(opposed) > 0.1 * worst]
        names = [f"'{data.model.owner(int(row))[1].name}'" for row in rows]
        faults.append(
            f"the contacts {counted(names, 6)} of arm '{arm}' contradict each other "
            f"at {name.removeprefix('the ')}: as surfaces of two rigid bodies they cannot all "
            f"touch, gaps of {worst:.3g} m stay between them; leave one of them out, or correct "
            f"its geometry"
        )
    return faults
