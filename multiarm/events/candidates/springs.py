"""Contacts that give way: what their kernel reads and writes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.dynamics.state import Layout
from multiarm.events.candidates.units import Candidates, Law


@dataclass(frozen=True, eq=False)
class Springs:
    """The compliant contacts of a scene.

    Attributes
    ----------
    rows : int64 (s,)
        Their rows among the candidates.
    owners : int64 (s,)
        Numbers of their arms.
    stiffness, damping : ndarray, shape (s,)
        [N/m, N s/m]
    always : int64 (s,)
        1 for those that also pull; one that only pushes acts while it is pressed in.
    """

    rows: np.ndarray
    owners: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    always: np.ndarray

    def number(self, row: int) -> int:
        """Number of the spring in a row."""
        return int(np.searchsorted(self.rows, row))

    @property
    def lags(self) -> np.ndarray:
        """Damping over stiffness [s], shape (s,)."""
        return self.damping / self.stiffness


def make_springs(found: Candidates, layout: Layout) -> Springs | None:
    """The compliant contacts among the candidates; None without any."""
    rows, owners, laws, always = [], [], [], []
    for i, (owner, kinds) in enumerate(found.laws.items()):
        for k, law in enumerate(kinds):
            if isinstance(law, Law) and law.stiffness > 0.0:
                rows.append(layout.rows[i] + k)
                owners.append(i)
                laws.append(law)
                always.append(not found.records[owner][k].pushes_only)
    if not rows:
        return None
    return Springs(
        rows=np.array(rows, dtype=np.int64),
        owners=np.array(owners, dtype=np.int64),
        stiffness=np.array([law.stiffness for law in laws]),
        damping=np.array([law.damping for law in laws]),
        always=np.array(always, dtype=np.int64),
    )
