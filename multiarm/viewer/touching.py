"""From the contacts of a run to those of a film: places from the system, the rest as recorded.

A channel of forces has a column for each row of W. Rows that belong to a joint of an arm have no
place and are not shown; rows of friction are arrows only, at their contact's point.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from multiarm.contacts.records import Contact
from multiarm.dynamics.contact_geometry import contact_places
from multiarm.results.channels import TOUCHING, channels_of
from multiarm.viewer.film import ContactTracks

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory

FLOOR_COLOR = np.array([0.36, 0.40, 0.46])


def contacts_of(
    system: System, trajectory: Trajectory, rows: np.ndarray, colors: dict[str, np.ndarray]
) -> list[ContactTracks]:
    """Return the contacts of each arm, and of the floor, at some samples (`rows`) of a run."""
    places = [_places(system, trajectory, row) for row in rows]
    points, normals = (np.array(side) for side in zip(*places, strict=True))  # (K, N, 3)
    tracks = []
    for owner, channel in channels_of(trajectory.channels, "contact_force").items():
        own = rows_of(system, owner)
        shown = {k: r for k in own if isinstance(r := system.model.records[k], Contact)}
        if not shown:
            continue
        k, records = list(shown), list(shown.values())
        columns = np.array(k) - own.start
        labels = trajectory.channels[channel].labels
        if len(labels) != len(own):  # contacts are left out: see `filming`
            columns = np.array([labels.index(record.name) for record in records])
        tracks.append(
            ContactTracks(
                arm=owner,
                color=colors.get(owner, FLOOR_COLOR),
                point=points[:, k],
                normal=normals[:, k],
                force=trajectory.read(channel)[rows][:, columns],
                state=row_states(trajectory, owner, records, rows),
                names=tuple(record.name for record in records),
                friction=tuple(_is_friction(trajectory, owner, record) for record in records),
            )
        )
    return tracks


def row_states(
    trajectory: Trajectory, owner: str, records: Sequence[Contact], rows: np.ndarray
) -> np.ndarray | None:
    """Return what the contact of each record does at some samples, codes (K, N); None: it holds.

    A row of friction has the state of its contact; a contact without a state touches always.
    """
    labels = _labels(trajectory, owner)
    if not labels:
        return None
    states = trajectory.contact_states[owner][rows]
    codes = np.full((len(rows), len(records)), TOUCHING)
    for k, record in enumerate(records):
        name = record.name if record.name in labels else _rubbing(record)
        if name in labels:
            codes[:, k] = np.round(states[:, labels.index(name)])
    return codes


def rows_of(system: System, owner: str) -> range:
    """Rows of W of an arm, or of the object's own contacts."""
    if owner not in system.arm_names:
        around = system.model.layout.surroundings
        return range(around.start, around.stop)
    i = system.arm_names.index(owner)
    return range(system.model.layout.rows[i], system.model.layout.rows[i + 1])


def _is_friction(trajectory: Trajectory, owner: str, record: Contact) -> bool:
    return bool(record.tangent) and _rubbing(record) in _labels(trajectory, owner)


def _rubbing(record: Contact) -> str:
    """Name of the contact to which a row of friction belongs."""
    return record.name.rpartition(", ")[0]


def _labels(trajectory: Trajectory, owner: str) -> tuple[str, ...]:
    """Names of the contacts that have states."""
    channel = channels_of(trajectory.channels, "contact_state").get(owner)
    return () if channel is None else trajectory.channels[channel].labels


def _places(system: System, trajectory: Trajectory, row: int) -> tuple[np.ndarray, np.ndarray]:
    state = system.state(
        object_position=trajectory.object_position[row],
        object_quaternion_xyzw=trajectory.object_quaternion_xyzw[row],
        joint_positions={name: trajectory.joint_positions[name][row] for name in system.arm_names},
    )
    with system.borrow() as data:
        return contact_places(data, state)
