"""The plan of a pick-up, which can be made a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from multiarm.grasp.pickup.phases import PhasedPickup

if TYPE_CHECKING:
    from multiarm.scene import Scene


@dataclass(frozen=True, eq=False)
class PickupPlan(PhasedPickup):
    """A planned pick-up: :class:`multiarm.grasp.pickup.phases.PhasedPickup` that can be a scene."""

    def to_scene(
        self, arms: Sequence[str] = ("ur5", "ur5"), *, table: str | Path, **options: Any
    ) -> Scene:
        """A scene that runs the plan: hands on arms, joints in time, references of the drives.

        Parameters
        ----------
        arms : sequence of str
            Robots by name, one for each gripper.
        table : path
            CSV file that is written, and that the scene names: references of the joints' springs.
        **options
            Those of :func:`multiarm.grasp.pickup.scene.pickup_scene`: mass, duration, lift, ...
        """
        from multiarm.grasp.pickup.scene import pickup_scene

        return pickup_scene(self, arms, table=table, **options)
