"""Patches of the surroundings: the part of a surface that is there to be touched."""

from __future__ import annotations

import numpy as np

from multiarm.assembly.system import System
from multiarm.contacts.kernel import AT
from multiarm.contacts.records import SURFACE_ON_ARM, Contact, Patch
from multiarm.contacts.unilateral import Constraint


def patch_of(full: System, constraint: Constraint) -> np.ndarray | None:
    """Frame and corners of the patch of the surroundings that a contact must be on, (18,)."""
    record = full.records[constraint.row]
    if constraint.arm in full.arms or not isinstance(record, Contact):
        return None
    patch: Patch | None = record.arm.patch
    if patch is None or record.surface_body != SURFACE_ON_ARM:
        return None
    lower, upper = (np.clip(c, -1e300, 1e300) for c in (patch.lower, patch.upper))
    return np.concatenate([patch.pose[:3, :3].ravel(), patch.pose[:3, 3], lower, upper])


def patch_margin(full: System, constraint: Constraint) -> float:
    """How far inside its patch a contact is at the kinematics in the buffers [m].

    Infinite where there is no patch.
    """
    patch = patch_of(full, constraint)
    if patch is None:
        return np.inf
    at = full.buffers.contacts[constraint.row, AT : AT + 3]
    place = (at - patch[9:12]) @ patch[:9].reshape(3, 3)
    return float(min(np.min(place - patch[12:15]), np.min(patch[15:] - place)))
