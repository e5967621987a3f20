"""The plan of a pick-up, which can be made a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from multiarm.grasp.pickup.phases import PhasedPickup

if TYPE_CHECKING:
    from multiarm.grasp.scenes.hands import Progress
    from multiarm.scene import Scene


@dataclass(frozen=True, eq=False)
class PickupPlan(PhasedPickup):
    """A planned pick-up: :class:`multiarm.grasp.pickup.phases.PhasedPickup` that can be a scene."""

    def to_scene(
        self,
        arms: Sequence[str] = ("ur5", "ur5"),
        *,
        table: str | Path,
        mass: float = 5.0,
        hand_mass: float = 0.4,
        lift: float = 0.1,
        duration: float = 4.5,
        accuracy: float = 1e-6,
        name: str | None = None,
        seed: int = 0,
        progress: bool | Progress | None = None,
    ) -> Scene:
        """A scene that runs the plan: hands on arms, joints in time, references of the drives.

        Parameters
        ----------
        arms : sequence of str
            Robots by name, one for each gripper.
        table : path
            CSV file that is written, and that the scene names: references of the joints' springs.
        mass, hand_mass : float
            Of the object, evenly spread, and of each hand [kg].
        lift : float
            Height to which the body is lifted [m]: at least that of a finger, where some are below.
        duration : float
            Of the run [s], one second at least.
        accuracy : float
            Of the run [m, rad].
        name : str, optional
            Title of the scene.
        seed : int
            Of the search for places and postures of the arms.
        progress : bool or callable, optional
            True: a bar on the terminal, elsewhere a line on stderr every few seconds.  A function
            is called with the finished fraction, 0 to 1, and the current stage.

        Raises
        ------
        GraspError
            Another number of arms; unusable numbers; a table that cannot be written; arms that are
            too weak; as `UnreachableError`, arms that do not reach the body.
        SceneError
            Robots that do not exist.
        """
        from multiarm.grasp.pickup.scene import pickup_scene

        return pickup_scene(
            self,
            arms,
            table=table,
            mass=mass,
            hand_mass=hand_mass,
            lift=lift,
            duration=duration,
            accuracy=accuracy,
            name=name,
            seed=seed,
            progress=progress,
        )
