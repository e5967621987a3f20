"""A judgement on the grasp in a scene: facts in named fields, ready for a table or for JSON."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from multiarm.dynamics.evaluation import Evaluation
from multiarm.dynamics.system import System
from multiarm.errors import GraspError
from multiarm.events.evaluation import evaluate
from multiarm.grasp.balances import LEAST_MARGIN
from multiarm.grasp.force_distribution import distribute_forces
from multiarm.grasp.independent_contacts import independence
from multiarm.grasp.object_frame import object_frame_on_body
from multiarm.grasp.scenes.reading import SceneGrasp, read_grasp
from multiarm.grasp.stability import configuration_stability
from multiarm.terminal.progress import Progress, Report, displayed

# Standard deviation of a measured contact point, for that of the pose [m].
MEASURED = 1e-4


@dataclass(frozen=True)
class ContactFacts:
    """One contact of the grasp, in the object's frame.

    Attributes
    ----------
    name, arm : str
    face : str or None
        Of the object.
    point, normal : list of float
        [m]; unit vector into the object.
    pulls : bool
        It is the pulling side of a contact that holds both ways.
    force : float
        At the start [N].
    coefficient : float or None
        Its part in the internal forces that prove closure, of sum 1.
    region_area : float or None
        Of the region in which it closes the grasp while the others stay [m^2].
    room : float or None
        How far it may slide before it leaves that region [m].
    """

    name: str
    arm: str
    face: str | None
    point: list[float]
    normal: list[float]
    pulls: bool
    force: float
    coefficient: float | None
    region_area: float | None
    room: float | None


@dataclass(frozen=True)
class StabilityFacts:
    """The effect of small displacements of contacts that only push.

    Attributes
    ----------
    six : list of str
        Six independent contacts.
    determinant : float
        Of their wrenches, lengths over the root mean square distance of all contacts.
    independence_limit : float
        Displacements of all contacts below it leave the six independent [m].
    closure_radius : float or None
        Displacements of all contacts below it leave the grasp closed [m].
    poor : bool
        Whether a measure of the seventh contact is less than twice what a hundredth of the size of
        the grasp changes in it.
    """

    six: list[str]
    determinant: float
    independence_limit: float
    closure_radius: float | None
    poor: bool


@dataclass(frozen=True)
class GraspJudgement:
    """The grasp of a scene at its start.

    Attributes
    ----------
    scene : str
    contacts : list of ContactFacts
    left_out : list of str
        Rows of joints that are no contacts in points.
    only_pushes : bool
        Whether all contacts can only push.
    closed : bool
        Whether they hold the object while the arms hold still.
    borderline : bool
        Whether roundings decide.
    verdict : str
        The same as text, with the missing condition.
    margin, distance : float or None
        The smallest coefficient at best; changes of scaled wrenches that closure survives.
    motion : list of float or None
        When open: a motion that the contacts leave, twist about the object's origin.
    immobility_order : int or None
        1: closed; 2: held to second order by the flat faces; 0: movable.
    stability : StabilityFacts or None
        For grasps by contacts that only push.
    carrying_force : float or None
        The weight carried with contact forces whose largest is as small as can be: that one [N].
        None without gravity, or where pushes alone do not carry it.
    frame_position, frame_rotation : float or None
        Standard deviation of the object's frame [m, rad] when it is computed from contact points
        that are known to 0.1 mm; None if faces are unknown or the points do not determine the pose.
    """

    scene: str
    contacts: list[ContactFacts]
    left_out: list[str]
    only_pushes: bool
    closed: bool
    borderline: bool
    verdict: str
    margin: float | None
    distance: float | None
    motion: list[float] | None
    immobility_order: int | None
    stability: StabilityFacts | None
    carrying_force: float | None
    frame_position: float | None
    frame_rotation: float | None

    def as_dict(self) -> dict[str, Any]:
        """Plain values only."""
        return asdict(self)


def judge_grasp(
    system: System, grasp: SceneGrasp | None = None, progress: bool | Report | None = None
) -> GraspJudgement:
    """Judge the grasp of a scene at its start.

    Parameters
    ----------
    system : System
    grasp : SceneGrasp, optional
        As :func:`multiarm.grasp.scenes.reading.read_grasp` finds it.
    progress : bool or callable, optional
        ``progress(done, total, words)``, in parts of the judgement; True: on stderr.

    Raises
    ------
    GraspError
        When no row of the scene's joints is a contact in a point.
    """
    with displayed(progress, Progress) as show:
        show(0, 4, "judging the grasp: closure and its margin")
        grasp = read_grasp(system) if grasp is None else grasp
        closure = grasp.closure
        show(1, 4, "judging the grasp: where each contact may be")
        contacts = _contacts(grasp, evaluate(system))
        show(2, 4, "judging the grasp: how far contacts may slip")
        stability = _stability(grasp)
        show(3, 4, "judging the grasp: forces and the object's frame")
        force, frame = _carrying_force(system, grasp), _frame(grasp)
    return GraspJudgement(
        scene=system.scene.name,
        contacts=contacts,
        left_out=list(grasp.left_out),
        only_pushes=grasp.only_pushes,
        closed=bool(closure),
        borderline=closure.borderline,
        verdict=closure.message,
        margin=closure.margin if closure.margin > LEAST_MARGIN else None,
        distance=_finite(closure.distance),
        motion=None if closure.motion is None else closure.motion.tolist(),
        immobility_order=closure.order,
        stability=stability,
        carrying_force=force,
        frame_position=None if frame is None else float(frame[0]),
        frame_rotation=None if frame is None else float(frame[1]),
    )


def _contacts(grasp: SceneGrasp, evaluation: Evaluation) -> list[ContactFacts]:
    found = []
    coefficients = grasp.closure.coefficients
    for j, ((arm, row), pulls, face) in enumerate(
        zip(grasp.rows, grasp.pulls, grasp.faces, strict=True)
    ):
        region = grasp.regions[j]
        force = float(evaluation.contact_forces[arm][row])
        found.append(
            ContactFacts(
                name=grasp.contacts.names[j],
                arm=arm,
                face=None if face is None or grasp.body is None else grasp.body.faces[face].name,
                point=grasp.contacts.points[j].tolist(),
                normal=grasp.contacts.normals[j].tolist(),
                pulls=pulls,
                force=-force if pulls else force,
                coefficient=None if coefficients is None else float(coefficients[j]),
                region_area=None if region is None else region.area,
                room=None if region is None else float(region.depth(grasp.contacts.points[j])),
            )
        )
    return found


def _stability(grasp: SceneGrasp) -> StabilityFacts | None:
    contacts = grasp.contacts
    if not grasp.only_pushes or contacts.count < 7:
        return None
    try:
        found = configuration_stability(contacts)
        six = independence(contacts.subset(found.six))
    except GraspError:  # no six of them are independent, which the verdict says
        return None
    return StabilityFacts(
        six=[contacts.names[j] for j in found.six],
        determinant=float(six.determinant) / contacts.length**3,
        independence_limit=found.delta_max,
        closure_radius=found.radius.lower if grasp.closure and found.radius is not None else None,
        poor=found.poor,
    )


def _carrying_force(system: System, grasp: SceneGrasp) -> float | None:
    scene = system.scene
    if scene.gravity is None:
        return None
    R = scene.object.pose.matrix()[:3, :3]
    weight = np.append(-scene.object.mass * R.T @ np.array(scene.gravity), np.zeros(3))
    found = distribute_forces(grasp.contacts, weight)
    return found.value if found else None


def _frame(grasp: SceneGrasp) -> np.ndarray | None:
    """Standard deviations (2,) of position [m] and rotation [rad] of the frame from contacts."""
    faces = [face for face in grasp.faces if face is not None]
    if grasp.body is None or len(faces) < len(grasp.contacts) or not grasp.only_pushes:
        return None
    try:
        found = object_frame_on_body(
            grasp.contacts.points, grasp.body, faces, point_covariance=MEASURED, previous=np.eye(4)
        )
    except GraspError:  # too few contacts, or not closed
        return None
    if found.covariance is None:
        return None
    variances = np.diag(found.covariance).reshape(2, 3).sum(axis=1)
    return np.sqrt(variances) if np.all(np.isfinite(variances)) else None


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
