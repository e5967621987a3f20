"""The plan of a pick-up, which can be made a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.pickup.lying_body import LyingBody, PivotEdge
from multiarm.grasp.pickup.phases import PickupPhase, PickupRefusal

if TYPE_CHECKING:
    from multiarm.grasp.pickup.course import PickupCourse
    from multiarm.grasp.scenes.hands import Progress
    from multiarm.scene import Scene


@dataclass(frozen=True, eq=False)
class PickupPlan:
    """How two grippers pick a body up from the floor: contacts, an edge, phases.

    Attributes
    ----------
    lies : LyingBody
        The body, and how it lies.
    free_faces : tuple of int
        Faces that fingertips reach while it lies.
    edge : PivotEdge or None
        About which it is tilted; None: it is picked up as it lies.
    angle : float
        Of the tilt [rad].
    grasp : Grasp
        Seven contacts in form closure, in the body's frame.
    late : tuple of int
        Contacts of the grasp that take hold when the body is tilted.
    phases : tuple of PickupPhase
        In turn.
    finger, tip_radius : float
        Height that a contact needs above the floor, and radius of fingertips [m].
    least : float
        Part of the weight with which every contact presses.
    refused : tuple of PickupRefusal
        Why the other ways were not taken: with proof, because no contacts or no better ones were
        found, or because theirs are worse.
    """

    lies: LyingBody
    free_faces: tuple[int, ...]
    edge: PivotEdge | None
    angle: float
    grasp: Grasp
    late: tuple[int, ...]
    phases: tuple[PickupPhase, ...]
    finger: float
    tip_radius: float
    least: float
    refused: tuple[PickupRefusal, ...] = ()

    @property
    def largest(self) -> float:
        """The largest force of a hand's contact in any phase, over the weight."""
        return max(phase.largest for phase in self.phases)

    def phase(self, name: str) -> PickupPhase:
        """A phase by its name.

        Raises
        ------
        GraspError
            The plan has no such phase.
        """
        for phase in self.phases:
            if phase.name == name:
                return phase
        names = ", ".join(phase.name for phase in self.phases)
        raise GraspError(f"the plan has no phase {name!r}; phases are {names}")

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
            self.course(mass, lift, duration),
            arms,
            late=self.late,
            finger=self.finger,
            tip_radius=self.tip_radius,
            table=table,
            hand_mass=hand_mass,
            accuracy=accuracy,
            name=name,
            seed=seed,
            progress=progress,
        )

    def course(self, mass: float, lift: float, duration: float) -> PickupCourse:
        """The body's motion in a run of a duration [s], with a mass [kg], up to a height [m]."""
        from multiarm.grasp.pickup.course import PickupCourse

        return PickupCourse(
            lies=self.lies,
            edge=self.edge,
            angle=self.angle,
            grasp=self.grasp,
            phases=self.phases,
            least=self.least,
            mass=mass,
            lift=lift,
            duration=duration,
        )

    def __str__(self) -> str:
        body = self.lies.body
        free = ", ".join(body.names[k] for k in self.free_faces)
        lines = [f"the body lies on {body.names[self.lies.face]}; free are {free}"]
        if self.edge is None:
            lines.append("it is picked up as it lies")
        else:
            late = ", ".join(self.grasp.contacts.names[j] for j in self.late)
            lines.append(
                f"it is tilted about {self.edge.name} by {np.degrees(self.angle):.1f} deg, then "
                f"{body.names[self.lies.face]} is free for {late}"
            )
        lines += [str(phase) for phase in self.phases]
        lines += [f"not {refusal}" for refusal in self.refused]
        return "\n".join(lines)
