"""Contacts that give way: what their kernel reads and writes."""

from __future__ import annotations

from dataclasses import dataclass, field

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
    active : int64 (s,)
        1 where the spring acts now; one that only pushes acts in some modes.
    force : ndarray, shape (s,)
        Contact forces at the state evaluated last [N].
    links : int64 (2,)
        Address and size of the struct of a system with these rows.
    kept : list
        What is reached by these addresses.
    """

    rows: np.ndarray
    owners: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    active: np.ndarray
    force: np.ndarray
    links: np.ndarray = field(default_factory=lambda: np.zeros(2, dtype=np.int64))
    kept: list[object] = field(default_factory=list)

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
        active=np.array(always, dtype=np.int64),
        force=np.zeros(len(rows)),
    )
