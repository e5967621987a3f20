"""Why a start cannot be assembled: gaps, contacts that contradict each other, and the remedies."""

from __future__ import annotations

import numpy as np

from multiarm.assembly.closing import FAR, FARTHEST, Closing
from multiarm.assembly.linkage import Linkage, projection_tolerance
from multiarm.contacts.kernel import GAP
from multiarm.dynamics.model import Data, Model
from multiarm.scene import Scene

# A joint this near to a limit is at it [rad, m].
AT_LIMIT = 1e-9
# Rows are dependent below this relative singular value.
DEPENDENT = 1e-9
# A contradiction takes at least this part of a joint's largest gap; a contact that takes less than
# this part in it is not named.
PART = 0.1
# So many contacts are named one by one.
_NAMED = 6


def gaps_by_arm(data: Data, column: int = GAP) -> dict[str, float]:
    """Largest magnitude of one column of the contact kinematics, by arm."""
    parts = data.model.layout.split_contacts(np.abs(data.arrays.contacts[:, column]))
    return {arm: float(np.max(values, initial=0.0)) for arm, values in parts.items()}


def joint_names(model: Model) -> list[str]:
    """All joints as ``arm/joint``, in the order of the stacked vectors."""
    return [f"{arm}/{joint}" for arm, a in model.arms.items() for joint in a.joint_names]


def joints_at_limit(data: Data) -> tuple[str, ...]:
    """Joints that are at one of their limits in the data."""
    limits = np.vstack([arm.position_limits for arm in data.model.arms.values()])
    near = np.min(np.abs(limits - data.arrays.angles[:, None]), axis=1) <= AT_LIMIT
    return tuple(name for name, at in zip(joint_names(data.model), near, strict=True) if at)


def too_far(data: Data, scene: Scene, what: str, gaps: dict[str, float], limit: float) -> list[str]:
    """One fault for every joint whose gap in the data is not below the limit [m]."""
    kinds = {joint.arm: joint.kind for joint in scene.joints}
    phi = data.model.layout.split_contacts(np.abs(data.arrays.contacts[:, GAP]))
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
            f"{what} does not satisfy the joint of arm '{arm}': a gap of {gap:.4g} m is left "
            f"at '{contact.name}', up to {limit:.3g} m is assembled; mend the posture, the base "
            f"{remedy}"
        )
    if near:
        faults[-1] += f" (gaps of the other joints: {listed(near)})"
    return faults


def cannot_close(
    data: Data, what: str, gaps: dict[str, float], whole: Linkage, end: Closing
) -> list[str]:
    """Why the gaps of a start could not be closed; the place that was reached is in the data.

    Parameters
    ----------
    gaps : dict arm -> float
        As written [m].
    whole : Linkage
        Object and all arms, which was to be closed.
    end : Closing
        How that ended.
    """
    faults = _contradictions(data, what, whole)
    if faults:
        return faults
    if end.status == FAR:
        names = [*["the object"] * 6, *(f"joint '{name}'" for name in joint_names(data.model))]
        worst = int(np.argmax(end.changes))
        why = f"{names[worst]} would have to move by more than "
        why += f"{FARTHEST * whole.unit[worst]:.3g} rad or m for it, which is no correction"
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
        f"{what} does not satisfy the joints and could not be closed from there (gaps "
        f"{listed(gaps)}): {why}; move the postures or `at` closer together, "
        "or leave out `at` to join the object where the tip is"
    ]


def listed(gaps: dict[str, float]) -> str:
    """Gaps of the arms [m] in one line."""
    return ", ".join(f"{arm}: {gap:.3g} m" for arm, gap in gaps.items())


def _worst_contact(data: Data, arm: str) -> str:
    phi = data.model.layout.split_contacts(data.arrays.contacts[:, GAP])[arm]
    return data.model.contacts[arm][int(np.argmax(np.abs(phi)))].name


def _contradictions(data: Data, what: str, whole: Linkage) -> list[str]:
    """Joints whose own contacts cannot all be closed, wherever the arm is."""
    b, faults, tolerance = data.arrays, [], projection_tolerance(data)
    wrenches = b.Wo[whole.rows] * whole.unit[:6]
    phi = b.contacts[whole.rows, GAP]
    for arm, (own, _) in zip(data.model.arm_names, whole.blocks, strict=True):
        U, s, _ = np.linalg.svd(wrenches[own])
        dependent = U[:, int(np.sum(s > DEPENDENT * s[0])) :] if s.size else U
        opposed = dependent @ (dependent.T @ phi[own])
        worst = float(np.max(np.abs(opposed), initial=0.0))
        if not worst > max(PART * float(np.max(np.abs(phi[own]), initial=0.0)), tolerance):
            continue
        rows = whole.rows[own][np.abs(opposed) > PART * worst]
        names = [f"'{data.model.owner(int(row))[1].name}'" for row in rows]
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        faults.append(
            f"the contacts {', '.join(names[:_NAMED])}{more} of arm '{arm}' contradict each other "
            f"at {what.removeprefix('the ')}: as surfaces of two rigid bodies they cannot all "
            f"touch, gaps of {worst:.3g} m stay between them; leave one of them out, or mend its "
            f"geometry"
        )
    return faults
