"""Why a start is refused, in words: what is wrong, by how much, and what to correct."""

from __future__ import annotations

import numpy as np

from multiarm.assembly.linkage import (
    Linkage,
    gaps_by_arm,
    joints_at_limit,
    projection_tolerance,
)
from multiarm.assembly.loop_closure import FARTHEST, MOST_STEPS, Closing, Outcome
from multiarm.contacts.table import JointRow
from multiarm.contacts.unilateral import LIMIT, Constraint
from multiarm.dynamics.contact_geometry import wrench_rows
from multiarm.dynamics.data import Data
from multiarm.dynamics.failures import is_tip_of_arm, joint_of, owner_of
from multiarm.scene import Scene
from multiarm.scene.faults import counted
from multiarm.scene.values import SURROUNDINGS


def inside(data: Data, constraint: Constraint, depth: float) -> str:
    """The fault of a contact or joint that is beyond what it may reach, by ``depth`` [m, rad]."""
    if constraint.arm == SURROUNDINGS:
        return (
            f"at the start '{constraint.name}' of the object is below the floor by {depth:.3g} m; "
            "correct 'object.pose', or the surfaces"
        )
    if constraint.kind != LIMIT:
        where = f"'{constraint.arm}/{constraint.name}' is inside the arm's surface"
        remedy = "the posture"
        if not is_tip_of_arm(data.model.connections[constraint.arm]):
            where = f"'{constraint.arm}/{constraint.name}' is inside the surface of the first body"
        return f"at the start {where} by {depth:.3g} m; correct {remedy}, or the surfaces"
    first = data.model.layout.first_joint[data.model.arm_names.index(constraint.arm)]
    limit = data.model.records[constraint.row]
    assert isinstance(limit, JointRow) and limit.bound is not None, "a limit is a joint's"
    at = data.arrays.state.joint_positions[first + limit.joint]
    end = "below its lower end" if limit.side > 0.0 else "above its upper end"
    name = f"{constraint.arm}/{data.model.joint_name(constraint.joint)}"
    return (
        f"$.effects.joint_limits: '{name}' starts at {at:.6g}, {end} {limit.bound:.6g}; "
        f"correct the posture, or the range"
    )


def too_far(
    data: Data, scene: Scene, name: str, gaps: dict[str, float], limits: dict[str, float]
) -> list[str]:
    """One fault for every owner of rows whose gap in the data exceeds its limit [m; rad]."""
    kinds = {joint.connection: joint.kind for joint in scene.joints}
    phi = data.model.layout.split_contacts(np.abs(data.contact_rows.gap))
    faults, near = [], {}
    for owner, gap in gaps.items():
        limit = limits[owner]
        if gap <= limit:
            near[owner] = gap
            continue
        row = data.model.contacts[owner][int(np.argmax(phi[owner]))]
        if owner not in data.model.connections:
            faults.append(
                f"{name} does not satisfy the couplings of the joints of "
                f"{owner_of(data.model, owner)}: '{row.name}' is off by {gap:.4g} rad or m, up to "
                f"{limit:.3g} is assembled; correct the posture"
            )
            continue
        remedy = "or `at` (or leave `at` out to join the object where the tip is)"
        if kinds[owner] == "contacts":
            remedy = (
                "or the contact's geometry (of the arm in the tip's frame, of the object in its)"
            )
        elif not is_tip_of_arm(data.model.connections[owner]):
            remedy = "or `at` and `at_first`"
        faults.append(
            f"{name} does not satisfy {joint_of(data.model, owner)}: a gap of {gap:.4g} m is left "
            f"at '{row.name}', up to {limit:.3g} m is assembled; correct the posture, the base "
            f"{remedy}"
        )
    if near:
        faults[-1] += f" (gaps of the other joints: {_listed(near)})"
    return faults


def cannot_close(
    data: Data, name: str, gaps: dict[str, float], linkage: Linkage, end: Closing
) -> list[str]:
    """Why the linkage of object and all robots could not be closed, from ``gaps`` as written [m].

    The posture that was reached is in the data.
    """
    faults = _contradictions(data, name, linkage)
    if faults:
        return faults
    if end.outcome is Outcome.FAR:
        names = [*["the object"] * 6, *(f"joint '{name}'" for name in data.model.joint_names)]
        worst = int(np.argmax(end.changes))
        why = f"{names[worst]} would have to move by more than "
        why += f"{FARTHEST * linkage.unit[worst]:.3g} rad or m for it, which is no correction"
    else:
        gaps_left = ", ".join(
            f"{arm}: {gap:.3g} m at '{_worst_contact(data, arm)}'"
            for arm, gap in gaps_by_arm(data).items()
        )
        if end.outcome is Outcome.TOO_SLOW:
            why = f"{MOST_STEPS} steps were too few, {gaps_left} is left"
        else:
            noun = data.model.layout.noun
            why = (
                f"no motion of the {noun} and the object lessens what then is left, {gaps_left}; "
                f"the {noun} are at the end of their reach, or have too few joints for these "
                "contacts"
            )
        stopped = joints_at_limit(data)
        if stopped:
            why += f"; at a limit: {', '.join(stopped)}"
    return [
        f"{name} does not satisfy the joints and could not be closed from there (gaps "
        f"{_listed(gaps)}): {why}; move the postures or `at` closer together, "
        "or leave out `at` to join the object where the tip is"
    ]


def _contradictions(data: Data, name: str, linkage: Linkage) -> list[str]:
    """Joints whose own contacts cannot all be closed, wherever their bodies are."""
    faults, tolerance = [], projection_tolerance(data)
    wrenches, gaps = wrench_rows(data) * linkage.unit[:6], data.contact_rows.gap
    layout = data.model.layout
    for c, owner in enumerate(layout.owners):
        rows = linkage.rows[
            np.isin(linkage.rows, np.arange(layout.contacts)[layout.contacts_of(c)])
        ]
        if owner not in data.model.connections or not rows.size:
            continue
        phi = gaps[rows]
        U, s, _ = np.linalg.svd(wrenches[rows])
        dependent = U[:, int(np.sum(s > 1e-9 * s[0])) :] if s.size else U
        opposed = dependent @ (dependent.T @ phi)
        worst = float(np.max(np.abs(opposed), initial=0.0))
        # at least a tenth of the joint's largest gap; contacts with less than a tenth of the worst
        # part are not named
        if not worst > max(0.1 * float(np.max(np.abs(phi), initial=0.0)), tolerance):
            continue
        opposed_rows = rows[np.abs(opposed) > 0.1 * worst]
        names = [f"'{data.model.owner(int(row))[1].name}'" for row in opposed_rows]
        faults.append(
            f"the contacts {counted(names, 6)} of {owner_of(data.model, owner)} contradict each "
            f"other at {name.removeprefix('the ')}: as surfaces of two rigid bodies they cannot "
            f"all touch, gaps of {worst:.3g} m stay between them; leave one of them out, or "
            f"correct its geometry"
        )
    return faults


def _listed(gaps: dict[str, float]) -> str:
    """Gaps of owners of rows [m] in one line."""
    return ", ".join(f"{arm}: {gap:.3g} m" for arm, gap in gaps.items())


def _worst_contact(data: Data, arm: str) -> str:
    phi = data.model.layout.split_contacts(data.contact_rows.gap)[arm]
    return data.model.contacts[arm][int(np.argmax(np.abs(phi)))].name
