r"""A planned pick-up as a scene that runs: arms, joints in time, references of their drives.

Each hand is rigid and moves with the body.  Its contacts on free faces are a joint of its arm that
holds all the time; those on the face that is freed are another one, which holds from a time on.
All contacts only push, and so does the floor.

**The drives** are springs and dampers about references from a table.  With the contact forces f of
:mod:`multiarm.grasp.pickup.course`, a hand exerts the wrench F on the body, which takes the torques

.. math:: u = M \ddot q + b + J^T F,

and the springs exert these on the way itself, :math:`q_r = q`, when the reference is ahead by

.. math:: q_r = q + \delta, \qquad K \delta + D \dot\delta = u .

So hands press as planned as long as they are where they should be, and springs draw them back.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.assembly.bases import POOREST, Stand, StandSearch, farthest
from multiarm.assembly.inverse_kinematics import InverseKinematics
from multiarm.assembly.robots import robot_files
from multiarm.errors import GraspError, MultiarmError
from multiarm.grasp.arguments import generator_of, number_of
from multiarm.grasp.face_contacts import FaceContacts, Gripper
from multiarm.grasp.pickup.course import CLOSED, HELD, LIFTED, RESTED, TILTED, PickupCourse
from multiarm.grasp.pickup.from_above import DESCENTS, approach_from_above
from multiarm.grasp.pickup.lying_body import DOWN
from multiarm.grasp.scenes import GRAVITY, arm_table, object_table
from multiarm.grasp.scenes.hands import (
    PEDESTAL_COST,
    SIDEWAYS,
    TURNS,
    Progress,
    UnreachableError,
    base_facing,
    clear_of_body,
    contacts,
    mount_pose,
    pose_table,
    require_room,
    robot_alone,
)
from multiarm.notation import count_of
from multiarm.results.files import atomic_output, resolved, target_fault
from multiarm.robots.robot import Robot
from multiarm.scene import ArmSpec, Scene, find_robot, resolve_arm
from multiarm.spatial import difference, matrix_to_quaternion
from multiarm.terminal.progress import PartProgress, displayed

# Distances of a base from the contacts of its hand, and heights of pedestals, in reaches of an arm.
DISTANCES, PEDESTALS = (0.35, 0.45, 0.6), (0.0, 0.2)
# Springs and dampers of the drives [N m/rad, N m s/rad].
STIFFNESS, DAMPING = 1000.0, 50.0
# Fingertips that take hold late are this much smaller, so that they close without having overlapped
# their face by an error of the way [m].
LATE_GAP = 2e-6
# Rows of the table of references are this far apart [s].
PERIOD = 0.02
# Shortest run [s]: its rests, too, have a row.
SHORTEST = PERIOD / RESTED
# A tip is where it should be within this [m, rad], after so many of Newton's steps at most.
REACHED, STEPS = 1e-11, 20


def pickup_scene(
    course: PickupCourse,
    arms: Sequence[str],
    *,
    late: Collection[int],
    finger: float,
    tip_radius: float,
    table: str | Path,
    hand_mass: float,
    accuracy: float,
    name: str | None,
    seed: int,
    progress: bool | Progress | None,
) -> Scene:
    """:meth:`multiarm.grasp.PickupPlan.to_scene`, which describes the numbers.

    Parameters
    ----------
    course : PickupCourse
    arms : sequence of str
    late : collection of int
        Contacts that take hold when the body is tilted.
    finger, tip_radius : float
        Height that a contact needs above the floor, and radius of fingertips [m].
    table, hand_mass, accuracy, name, seed, progress
    """
    duration, lift = course.duration, course.lift
    numbers = {"mass": course.mass, "hand_mass": hand_mass, "lift": lift, "accuracy": accuracy}
    for what, value in numbers.items():
        number_of(value, f"{what} is greater than 0", above=0.0)
    number_of(duration, f"duration is at least {SHORTEST:g} s", at_least=SHORTEST)
    if late:  # both ends of the way are high enough, and so is what lies between
        needed = f"lift is at least {finger:g} m, which the fingers below the body need"
        number_of(lift, needed, at_least=finger)
    specs = _specs(arms, len(course.grasp.grippers))
    path = _path_of(table)
    rng = generator_of(seed, "seed")
    centre = np.eye(4)
    centre[:3, 3] = course.grasp.body.centre  # an object's frame is at its centre of mass
    grasp = course.grasp.placed(np.linalg.inv(centre))
    require_room(grasp, tip_radius)
    times = np.linspace(0.0, duration, 1 + round(duration / PERIOD))
    poses = [course.at(t).pose @ centre for t in times]
    forces = np.array([course.forces(t) for t in times])
    written: dict[str, dict[str, Any]] = {}
    references: dict[str, np.ndarray] = {}
    with displayed(progress, PartProgress) as show:
        for number, (spec, gripper) in enumerate(zip(specs, grasp.grippers, strict=True)):
            show(number / len(specs), f"postures of '{gripper.name}'")
            early = _early_part(gripper, late)
            stand = _stand(course, grasp, early, spec, tip_radius, centre, rng)
            arm = arm_table(grasp, early, spec, stand, tip_radius, hand_mass)
            hand = _Hand(grasp, gripper, ArmSpec(**arm))
            postures = hand.postures(stand.reach.postures[0], poses)
            written[gripper.arm_name] = {**arm, "posture": postures[0].tolist()}
            references |= hand.references(times, postures, poses, forces)
    scene = Scene(
        name=name or f"{len(specs)} arms pick a body of {len(grasp.body.faces)} faces up",
        gravity=GRAVITY,
        object={**object_table(grasp.body, course.mass, None), "pose": pose_table(poses[0])},
        arms=written,
        joints=list(_joints(grasp, late, tip_radius, HELD * duration)),
        control={
            "kind": "recorded",
            "file": str(path),
            "quantity": "position",
            "interpolation": "cubic",
            "stiffness": STIFFNESS,
            "damping": DAMPING,
            "gravity_compensation": False,
        },
        effects={"unilateral_contacts": {}, "floor": {}},
        run={"duration": duration, "accuracy": accuracy},
    )
    rows = np.column_stack([times, *references.values()])
    header = ",".join(["time", *references])
    with atomic_output(path, error=GraspError) as partial:  # last: it may replace a file
        np.savetxt(partial, rows, fmt="%.10g", delimiter=",", header=header, comments="")
    return scene


def _path_of(table: Any) -> Path:
    """The absolute path of a table that can be written."""
    try:
        path = resolved(table)
    except MultiarmError as error:
        raise GraspError(f"table: {error}") from error
    fault = target_fault(path)
    if fault:
        raise GraspError(f"the table '{table}' cannot be written: {fault}")
    return path


def _specs(arms: Sequence[str], count: int) -> list[ArmSpec]:
    """The robots, one for each gripper.

    Raises
    ------
    GraspError
        No robots by name, or another number of them.
    SceneError
        Robots that do not exist.
    """
    if isinstance(arms, str) or not isinstance(arms, Sequence):
        raise GraspError(f"arms is a list of robots by name, such as ['ur5', 'ur5'], not {arms!r}")
    for k, robot in enumerate(arms):
        if not isinstance(robot, str):
            raise GraspError(f"arms[{k}] is the name of a robot, such as 'ur5', not {robot!r}")
    if len(arms) != count:
        raise GraspError(f"the plan takes {count_of(count, 'arm')}, not {len(arms)}")
    return [ArmSpec(robot=robot, tip=find_robot(robot).tip) for robot in arms]


def _early_part(gripper: Gripper, late: Collection[int]) -> Gripper:
    """A gripper with those of its contacts that hold all the time."""
    return replace(gripper, contacts=tuple(j for j in gripper.contacts if j not in late))


def _late_part(gripper: Gripper, late: Collection[int]) -> Gripper:
    """A gripper with those of its contacts that take hold late."""
    return replace(gripper, contacts=tuple(j for j in gripper.contacts if j in late))


def _joints(
    grasp: FaceContacts, late: Collection[int], tip_radius: float, begin: float
) -> Iterator[dict[str, Any]]:
    """The joints of all grippers: contacts on free faces, and those that hold from a time on."""
    for gripper in grasp.grippers:
        below = _late_part(gripper, late)
        tips = contacts(grasp, below, tip_radius)
        for tip in tips:
            tip["arm"]["sphere"]["radius"] -= LATE_GAP
        of_both = {"kind": "contacts", "at": pose_table(gripper.frame)}
        yield {
            "arm": gripper.arm_name,
            **of_both,
            "contacts": contacts(grasp, _early_part(gripper, late), tip_radius),
        }
        if below.contacts:
            yield {
                "between": [gripper.arm_name, "object"],
                "name": f"{gripper.arm_name}_below",
                **of_both,
                "from": round(begin, 6),
                "contacts": tips,
            }


# --- Where arms stand -----------------------------------------------------------------------------


def _stand(
    course: PickupCourse,
    grasp: FaceContacts,
    early: Gripper,
    spec: ArmSpec,
    tip_radius: float,
    centre: np.ndarray,
    rng: np.random.Generator,
) -> Stand:
    """The best place of an arm that holds some contacts on the whole way.

    Raises
    ------
    UnreachableError
        There is none.
    """
    robot = InverseKinematics(robot_alone(spec))
    parts = (0.0, TILTED, 0.5 * (CLOSED + LIFTED), LIFTED)
    poses = [course.at(part * course.duration).pose @ centre for part in parts]
    search = StandSearch(robot, poses, clear_of_body(grasp.body), rng)
    reach = farthest(robot.arm, rng)
    stand = search.best(_places(grasp, early, poses[0], reach, tip_radius))
    if stand is None or stand.reach.quality < POOREST:
        raise UnreachableError(
            f"the arm of '{early.name}' reaches its contacts from nowhere nearby on the whole way; "
            "choose a longer arm, a lower lift or another seed of the plan"
        )
    return stand


def _places(
    grasp: FaceContacts, gripper: Gripper, start: np.ndarray, reach: float, tip_radius: float
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Bases, mounts of the hand in the object's frame, and what the bases are worth."""
    aim = grasp.contacts.points[list(gripper.contacts)].mean(axis=0)
    place = start[:3, :3] @ aim + start[:3, 3]
    beyond = float(np.arctan2(place[1] - start[1, 3], place[0] - start[0, 3]))
    for descent in DESCENTS:
        inward = grasp.contacts.normals[list(gripper.contacts)]
        direction = approach_from_above(inward, start[:3, :3].T @ DOWN, descent)
        if direction is None:
            continue
        for turn, distance, aside, pedestal in product(TURNS, DISTANCES, SIDEWAYS, PEDESTALS):
            mount = mount_pose(grasp, gripper, direction, aim, turn, tip_radius)
            base = base_facing(place, beyond + aside, distance * reach, pedestal * reach)
            yield base, mount, PEDESTAL_COST if base[2, 3] > 0.0 else 1.0


# --- What the drives do ---------------------------------------------------------------------------


class _Hand:
    """An arm with the hand of a gripper, which moves with the object."""

    def __init__(self, grasp: FaceContacts, gripper: Gripper, spec: ArmSpec) -> None:
        self.grasp, self.gripper = grasp, gripper
        self.robot = Robot(gripper.arm_name, robot_files(spec, resolve_arm(spec)))

    def postures(self, start: np.ndarray, poses: Sequence[np.ndarray]) -> np.ndarray:
        """Postures (K, n) that hold the object at poses (4, 4), the first one near a start (n,)."""
        posture, course = start, []
        for pose in poses:
            posture = self._reached(posture, pose @ self.gripper.frame)
            course.append(posture)
        return np.array(course)

    def _reached(self, posture: np.ndarray, place: np.ndarray) -> np.ndarray:
        """The posture (n,) near another one at which the tip is at a place (4, 4)."""
        aim, rest = matrix_to_quaternion(place[:3, :3]), np.zeros(len(posture))
        for _ in range(STEPS):
            tip = self.robot.tip_kinematics(posture, rest)
            turn = difference(matrix_to_quaternion(tip.rotation), aim)
            off = np.concatenate([place[:3, 3] - tip.position, turn])
            if np.abs(off).max() < REACHED:
                return posture
            posture = posture + np.linalg.lstsq(tip.jacobian, off, rcond=None)[0]
        raise UnreachableError(
            f"the arm of '{self.gripper.name}' does not follow the object: it misses by "
            f"{np.abs(off).max():.3g} m or rad; choose another seed or a lower lift"
        )

    def references(
        self,
        times: np.ndarray,
        postures: np.ndarray,
        poses: Sequence[np.ndarray],
        forces: np.ndarray,
    ) -> dict[str, np.ndarray]:
        """References (K,) of the springs, by the columns of the table.

        Parameters
        ----------
        times : ndarray, shape (K,)
            Evenly spaced [s].
        postures : ndarray, shape (K, n)
        poses : sequence of ndarray, shape (4, 4)
            Of the object.
        forces : ndarray, shape (K, N)
            Of the grasp's contacts [N].
        """
        from scipy.interpolate import CubicSpline

        course = CubicSpline(times, postures, bc_type="clamped")
        torques = np.array(
            [
                self._torques(*motion)
                for motion in zip(
                    postures, course(times, 1), course(times, 2), poses, forces, strict=True
                )
            ]
        )
        self._require_strength(np.abs(torques).max(axis=0))
        ahead = [torques[0] / STIFFNESS]
        spring, damper = 0.5 * STIFFNESS, DAMPING / (times[1] - times[0])
        for before, after in pairwise(torques):
            mean = 0.5 * (before + after)
            ahead.append(((damper - spring) * ahead[-1] + mean) / (damper + spring))
        columns = [f"{self.gripper.arm_name}/{joint}" for joint in self.robot.joint_names]
        return dict(zip(columns, (postures + np.array(ahead)).T, strict=True))

    def _torques(
        self,
        posture: np.ndarray,
        velocity: np.ndarray,
        acceleration: np.ndarray,
        pose: np.ndarray,
        forces: np.ndarray,
    ) -> np.ndarray:
        """Torques (n,) that move the arm while its contacts press [N m]."""
        terms, own = self.robot.terms(posture, velocity), list(self.gripper.contacts)
        R, held = pose[:3, :3], self.grasp.contacts
        pushes = forces[own, None] * held.normals[own] @ R.T
        arms = held.points[own] @ R.T + pose[:3, 3] - terms.tip_position
        wrench = np.concatenate([pushes.sum(axis=0), np.cross(arms, pushes).sum(axis=0)])
        return terms.M @ acceleration + terms.bias + terms.J.T @ wrench

    def _require_strength(self, largest: np.ndarray) -> None:
        """Refuse an arm that is too weak."""
        shares = largest / self.robot.effort_limits
        j = int(np.argmax(shares))
        if shares[j] > 1.0:
            raise GraspError(
                f"{self.robot.joint_names[j]} of the arm of '{self.gripper.name}' needs "
                f"{largest[j]:.3g} N m, and has {self.robot.effort_limits[j]:g} N m; choose a "
                "stronger arm, a lighter object or a longer duration"
            )
