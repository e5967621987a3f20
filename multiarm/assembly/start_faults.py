"""Why a start is refused, in words: what is wrong, by how much, and what to correct."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.assembly.linkage import (
    Linkage,
    joints_at_limit,
    projection_tolerance,
    rows_of_joints,
)
from multiarm.assembly.loop_closure import FARTHEST, MOST_STEPS, Closing, Outcome
from multiarm.contacts.table import JointRow
from multiarm.contacts.unilateral import LIMIT, Constraint
from multiarm.dynamics.contact_geometry import wrench_rows
from multiarm.dynamics.data import Data
from multiarm.dynamics.failures import is_tip_of_arm, joint_of, owner_of
from multiarm.dynamics.layout import TWIST
from multiarm.geometry.records import SURFACE_ON_OBJECT, Contact
from multiarm.scene import JointSpec, Scene
from multiarm.scene.faults import counted
from multiarm.scene.joint_values import SOLVE
from multiarm.scene.values import of_surroundings


def inside(data: Data, constraint: Constraint, depth: float) -> str:
    """The fault of a contact or joint that is beyond what it may reach, by ``depth`` [m, rad]."""
    if of_surroundings(constraint.owner):
        _, _, name = constraint.owner.partition("/")
        body, key = (f"object '{name}'", f"objects.{name}") if name else ("the object", "object")
        return (
            f"at the start '{constraint.name}' of {body} is below the floor by {depth:.3g} m; "
            f"correct '{key}.pose', or the surfaces"
        )
    if constraint.kind != LIMIT:
        where = f"'{constraint.owner}/{constraint.name}' is inside the arm's surface"
        remedy = "the posture"
        pair, record = data.model.connections[constraint.owner], data.model.records[constraint.row]
        if not is_tip_of_arm(pair):
            assert isinstance(record, Contact), "what has a surface is a contact"
            carrier = pair.second if record.surface_body == SURFACE_ON_OBJECT else pair.first
            place = f"'{constraint.owner}/{constraint.name}'"
            where, remedy = f"{place} is inside the surface of {carrier}", "the poses"
        return f"at the start {where} by {depth:.3g} m; correct {remedy}, or the surfaces"
    first = data.model.layout.first_joint[data.model.arm_names.index(constraint.owner)]
    limit = data.model.records[constraint.row]
    assert isinstance(limit, JointRow) and limit.bound is not None, "a limit is a joint's"
    at = data.arrays.state.joint_positions[first + limit.joint]
    end = "below its lower end" if limit.side > 0.0 else "above its upper end"
    name = f"{constraint.owner}/{data.model.joint_name(constraint.joint)}"
    return (
        f"$.effects.joint_limits: '{name}' starts at {at:.6g}, {end} {limit.bound:.6g}; "
        f"correct the posture, or the range"
    )


class LargestGap(NamedTuple):
    """The row with the largest gap among an owner's contacts, or among its couplings of joints."""

    owner: str  # of couplings the robot
    row: Contact | JointRow
    gap: float  # magnitude [m]; of couplings [rad, m]

    @property
    def of_joints(self) -> bool:
        """Whether it is a coupling's."""
        return isinstance(self.row, JointRow)

    def __str__(self) -> str:
        if self.of_joints:
            return f"couplings of {self.owner}: {self.gap:.3g} rad or m"
        return f"{self.owner}: {self.gap:.3g} m"


def largest_gaps(data: Data) -> list[LargestGap]:
    """The largest gaps in the data, of the contacts and of the couplings of every owner."""
    layout, largest = data.model.layout, []
    for c, (owner, gaps) in enumerate(layout.split_contacts(data.contact_rows.gap).items()):
        records, magnitudes = data.model.contacts[owner], np.abs(gaps)
        for kind in (Contact, JointRow):
            rows = [row for row, record in enumerate(records) if isinstance(record, kind)]
            if not rows:
                continue
            worst = rows[int(np.argmax(magnitudes[rows]))]
            name = owner
            if kind is JointRow:
                name = (
                    owner
                    if owner in layout.names
                    else layout.robots_of_block(layout.block_of[c])[0]
                )
            largest.append(LargestGap(name, records[worst], float(magnitudes[worst])))
    return largest


def listed_gaps(data: Data) -> str:
    """The largest gaps in the data, in one line."""
    return ", ".join(map(str, largest_gaps(data)))


def too_far(data: Data, scene: Scene, name: str, size: float, of_scene: bool) -> list[str]:
    """Faults of gaps in the data that are too large to be closed in a scene of a ``size`` [m].

    ``of_scene`` says that the state is the start of the scene.
    Contacts are closed from a tenth of the size; couplings from as far as joints may move.
    """
    joints = {joint.connection: joint for joint in scene.joints}
    limit, limit_of_joints = 0.1 * size, FARTHEST * max(1.0, size)
    faults, near = [], []
    for largest in largest_gaps(data):
        owner, row, gap = largest
        if gap <= (limit_of_joints if largest.of_joints else limit):
            near.append(str(largest))
            continue
        if largest.of_joints:
            faults.append(
                f"{name} does not satisfy the couplings of the joints of "
                f"{owner_of(data.model, owner)}: '{row.name}' is off by {gap:.4g} rad or m, up to "
                f"{limit_of_joints:.3g} is assembled; correct the posture"
            )
            continue
        remedy = "or `at` (or leave `at` out to join the object where the tip is)"
        if joints[owner].kind == "contacts":
            remedy = (
                "or the contact's geometry (of the arm in the tip's frame, of the object in its)"
            )
        elif not is_tip_of_arm(data.model.connections[owner]):
            remedy = "or `at` and `at_first`"
        search = _whether_a_posture_is_sought(scene, joints[owner]) if of_scene else ""
        faults.append(
            f"{name} does not satisfy {joint_of(data.model, owner)}: a gap of {gap:.4g} m is left "
            f"at '{row.name}', up to {limit:.3g} m is assembled; correct the posture, the base "
            f"{remedy}{search}"
        )
    if faults and near:
        faults[-1] += f" (gaps of the other joints: {', '.join(near)})"
    return faults


def _whether_a_posture_is_sought(scene: Scene, joint: JointSpec) -> str:
    """What to say of ``posture: solve`` where a joint of a robot is far from closed."""
    robot = scene.robots.get(joint.first.robot)
    spec = robot or scene.arms.get(joint.first.robot)
    if spec is None or spec.posture == SOLVE or joint.at is None or joint.as_listed:
        return ""
    if robot is not None and robot.base.floats:  # it is not sought unasked
        return "; or let `posture: solve` find a posture, with the base where it is written"
    return "" if spec.posture is None else "; or let `posture: solve` find a posture"


def cannot_close(data: Data, name: str, gaps: str, linkage: Linkage, end: Closing) -> list[str]:
    """Why the linkage of object and all robots could not be closed, from ``gaps`` as written.

    The posture that was reached is in the data.
    """
    faults = _contradictions(data, name, linkage)
    if faults:
        return faults
    if end.outcome is Outcome.FAR:
        objects = data.model.layout.objects
        bodies = ["the object"] if len(objects) == 1 else [f"object '{name}'" for name in objects]
        names = [body for body in bodies for _ in range(TWIST)]
        names += [f"joint '{name}'" for name in data.model.joint_names]
        worst = int(np.argmax(end.changes))
        why = f"{names[worst]} would have to move by more than "
        why += f"{FARTHEST * linkage.unit[worst]:.3g} rad or m for it, which is no correction"
    else:
        gaps_left = ", ".join(f"{gap} at '{gap.row.name}'" for gap in largest_gaps(data))
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
        f"{gaps}): {why}; move the postures or `at` closer together, "
        "or leave out `at` to join the object where the tip is"
    ]


def _contradictions(data: Data, name: str, linkage: Linkage) -> list[str]:
    """Joints whose own contacts cannot all be closed, wherever their bodies are."""
    faults, tolerance = [], projection_tolerance(data)
    wrenches, gaps = wrench_rows(data) * linkage.unit[:6], data.contact_rows.gap
    layout, with_places = data.model.layout, ~rows_of_joints(data.model)
    for c, owner in enumerate(layout.owners):
        of_owner = np.arange(layout.contacts)[layout.contacts_of(c)]
        rows = np.intersect1d(linkage.rows, of_owner[with_places[of_owner]])
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
