"""Which arms are compiled: those that can be, and why others stay with Pinocchio."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from multiarm.arms.compiled.arrays import ArmTables
from multiarm.arms.compiled.tables import MOST_JOINTS, make_tables
from multiarm.arms.compiled.verification import verify
from multiarm.arms.terms import ArmStructure
from multiarm.errors import ModelError

if TYPE_CHECKING:
    from multiarm.arms.arm import Arm


class Choice(NamedTuple):
    """Which arms are compiled.

    tables : ArmTables or None
        None where no arm can be compiled.
    places : tuple of int
        Their numbers among all arms.
    reasons : dict of str to str
        Why the others are not.
    """

    tables: ArmTables | None
    places: tuple[int, ...]
    reasons: dict[str, str]


def compile_arms(arms: Mapping[str, Arm], gravity: np.ndarray) -> Choice:
    """Tables of all arms that can be compiled, verified against Pinocchio.

    Raises
    ------
    ModelError
        When a compiled arm does not agree with Pinocchio.
    """
    found: dict[int, ArmStructure] = {}
    reasons: dict[str, str] = {}
    for place, (name, arm) in enumerate(arms.items()):
        try:
            found[place] = _structure(arm)
        except ModelError as reason:
            reasons[name] = str(reason)
    if not found:
        return Choice(None, (), reasons)
    first = np.cumsum([0, *(arm.dof for arm in arms.values())])
    places = tuple(found)
    tables = make_tables(list(found.values()), places, [int(first[k]) for k in places], gravity)
    verify(tables, places, arms)
    return Choice(tables, places, reasons)


def _structure(arm: Arm) -> ArmStructure:
    if arm.dof > MOST_JOINTS:
        raise ModelError(f"it has {arm.dof} joints; at most {MOST_JOINTS} are compiled")
    return arm.structure()
