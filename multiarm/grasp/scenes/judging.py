"""The grasp in a scene: which contacts hold the object, on which faces, and how well.

A contact that only pushes is one contact.  One that holds both ways, such as those of a weld,
counts twice, with opposite normals.  Rows that are no contacts in points (couples, slip, limits of
joints) are left out and named.  The judgement is facts in named fields, ready for a table or for
JSON.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from multiarm.dynamics.contact_geometry import contact_places
from multiarm.dynamics.evaluation import Evaluation
from multiarm.dynamics.model import require_one_object
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import GraspError
from multiarm.events.evaluation import evaluate
from multiarm.geometry.records import Contact
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.closure.balances import LEAST_MARGIN
from multiarm.grasp.closure.form_closure import FormClosure, is_form_closure
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.face_contacts import Gripper
from multiarm.grasp.forces.force_distribution import distribute_forces
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.pose.object_frame import object_frame_on_body
from multiarm.grasp.seventh_contact.contact_region import ContactRegion, region_of
from multiarm.grasp.six_contacts.independent_contacts import independence
from multiarm.grasp.stability.configuration_stability import configuration_stability
from multiarm.scene import ObjectSpec
from multiarm.scene.shapes import Box, Hull, Mesh
from multiarm.simulation.holding import Carrying, carrying_capacity
from multiarm.spatial import quaternion_to_matrix
from multiarm.terminal.progress import Progress, Report, displayed

# A contact lies on a face of the object when its point [parts of the object's size] and its normal
# are off by less.
ON_FACE = 1e-6


@dataclass(frozen=True, eq=False)
class SceneGrasp:
    """The contacts that hold the object of a scene, in the object's frame.

    Attributes
    ----------
    contacts : Contacts
        Named ``arm/contact``.
    rows : tuple of (str, int)
        Of each contact: its arm, and its number among the rows of that arm's joint.
    pulls : tuple of bool
        Whether it is the pulling side of a contact that holds both ways.
    faces : tuple of int or None
        The face of ``body`` that it lies on.
    body : Polyhedron or None
        The object, where its shape is a box or a hull, or a mesh that is closed.
    left_out : tuple of str
        Rows that are no contacts in points.
    frames : table 'arm: pose (4, 4)'
        Of the joints' frames on the object.
    """

    contacts: Contacts
    rows: tuple[tuple[str, int], ...]
    pulls: tuple[bool, ...]
    faces: tuple[int | None, ...]
    body: Polyhedron | None
    left_out: tuple[str, ...]
    frames: Mapping[str, np.ndarray]

    @property
    def only_pushes(self) -> bool:
        """Whether no contact holds both ways."""
        return not any(self.pulls)

    @cached_property
    def closure(self) -> FormClosure:
        """Whether the contacts hold the object while the arms hold still."""
        return is_form_closure(self.contacts)

    @cached_property
    def regions(self) -> tuple[ContactRegion | None, ...]:
        """Where on its face each contact closes the grasp while all others stay as they are.

        None where the face is not known, where the others leave the object more than one freedom,
        where no place on the face closes the grasp, or where a contact holds both ways.
        """
        return tuple(self._region(j) for j in range(len(self.contacts)))

    def as_grasp(self) -> Grasp:
        """The same as a grasp of a polyhedron, one gripper an arm.

        Raises
        ------
        GraspError
            When the object has no plane faces, or a contact holds both ways or is on none of them.
        """
        faces = tuple(face for face in self.faces if face is not None)
        if self.body is None or len(faces) < len(self.contacts):
            off = [n for n, k in zip(self.contacts.names, self.faces, strict=True) if k is None]
            raise GraspError(
                "this is no grasp of a polyhedron: "
                + ("the object has no plane faces" if self.body is None else "")
                + (f"on none of its faces is {', '.join(off)}" if self.body is not None else "")
            )
        grippers = tuple(
            Gripper(arm, tuple(j for j, (owner, _) in enumerate(self.rows) if owner == arm), frame)
            for arm, frame in self.frames.items()
            if any(owner == arm for owner, _ in self.rows)
        )
        return Grasp(self.body, self.contacts, faces, grippers)

    def _region(self, j: int) -> ContactRegion | None:
        face = self.faces[j]
        if self.body is None or face is None or not self.only_pushes or len(self.contacts) < 7:
            return None
        return region_of(self.contacts, j, self.body.faces[face]) or None


class _Touch(NamedTuple):
    """A contact of the object, or its pulling side."""

    row: int  # among the rows of all joints
    arm: str
    number: int  # among the rows of the arm's joint
    pulls: bool


def read_grasp(system: System, state: State | None = None) -> SceneGrasp:
    """The grasp of a scene at a state, by default at its start.

    Raises
    ------
    GraspError
        When no row of the scene's joints is a contact in a point.
    ModelError
        When there are several objects.
    """
    require_one_object(system.model, "a grasp is that of one")
    state = system.initial_state() if state is None else state
    with system.borrow() as data:
        points, normals = contact_places(data, state)
    R = quaternion_to_matrix(state.object_quaternion_xyzw.copy())
    points, normals = (points - state.object_position) @ R, normals @ R
    body = body_of(system.scene.one_object("a grasp"))
    touches: list[_Touch] = []
    left_out, holding, layout = [], _holding(system), system.model.layout
    for owner, first_row in zip(layout.owners, layout.first_contact[:-1], strict=True):
        for k, contact in enumerate(system.contacts.get(owner, ())):
            if owner not in holding or not _in_a_point(contact):
                left_out.append(f"{owner}/{contact.name}")
                continue
            touches.append(_Touch(first_row + k, owner, k, pulls=False))
            if not contact.pushes_only:
                touches.append(_Touch(first_row + k, owner, k, pulls=True))
    if not touches:
        raise GraspError("no joint of this scene holds the object by contacts in points")
    names = [
        f"{touch.arm}/{system.contacts[touch.arm][touch.number].name}"
        f"{', pulling' if touch.pulls else ''}"
        for touch in touches
    ]
    rows = [touch.row for touch in touches]
    signs = np.array([-1.0 if touch.pulls else 1.0 for touch in touches])
    contacts = Contacts(points[rows], signs[:, None] * normals[rows], names)
    faces = tuple(
        None if body is None or touch.pulls else _face_of(body, point, normal)
        for point, normal, touch in zip(contacts.points, contacts.normals, touches, strict=True)
    )
    return SceneGrasp(
        contacts=contacts,
        rows=tuple((touch.arm, touch.number) for touch in touches),
        pulls=tuple(touch.pulls for touch in touches),
        faces=faces,
        body=body,
        left_out=tuple(left_out),
        frames={name: system.frames[name].on_object for name in holding},
    )


def _holding(system: System) -> list[str]:
    """The connections of links with the object."""
    pairs = system.model.connections.values()
    return [pair.name for pair in pairs if pair.on_object and pair.first.is_link]


def body_of(spec: ObjectSpec) -> Polyhedron | None:
    """The object as a polyhedron in its own frame; None where it is round or its mesh is open."""
    match spec.shape.solid:
        case Box(edges):
            return Polyhedron.box(edges)
        case Hull(points):
            return Polyhedron.hull(np.array(points))
        case Mesh(file=file, scale=(x, y, z)) if x == y == z:
            try:
                return Polyhedron.mesh(file, x)
            except GraspError:
                return None
    return None


def _in_a_point(contact: object) -> bool:
    return isinstance(contact, Contact) and contact.tangent == 0 and contact.minus is None


def _face_of(body: Polyhedron, point: np.ndarray, normal: np.ndarray) -> int | None:
    heights = body.normals @ point - np.array([face.offset for face in body.faces])
    turned = np.linalg.norm(body.normals + normal, axis=1)
    close = (np.abs(heights) < ON_FACE * body.size) & (turned < ON_FACE)
    on = [int(k) for k in np.flatnonzero(close) if body.faces[k].contains(point)]
    return on[0] if on else None


# --- The judgement --------------------------------------------------------------------------------

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
    carrying : Carrying or None
        Whether the object can be carried within the efforts of the drives, and the largest share of
        an effort limit when holding. None without gravity, on a floor, or
        where the control does not carry it.
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
    carrying: Carrying | None
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
        As :func:`read_grasp` finds it.
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
        evaluation = evaluate(system)
        contacts = _contacts(grasp, evaluation)
        show(2, 4, "judging the grasp: how far contacts may slip")
        stability = _stability(grasp)
        show(3, 4, "judging the grasp: forces and the object's frame")
        carrying = carrying_capacity(system, evaluation)
        force, frame = _carrying_force(system, grasp, evaluation), _frame(grasp)
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
        carrying=carrying,
        carrying_force=force,
        frame_position=None if frame is None else float(frame[0]),
        frame_rotation=None if frame is None else float(frame[1]),
    )


def _contacts(grasp: SceneGrasp, evaluation: Evaluation) -> list[ContactFacts]:
    facts = []
    coefficients = grasp.closure.coefficients
    for j, ((arm, row), pulls, face) in enumerate(
        zip(grasp.rows, grasp.pulls, grasp.faces, strict=True)
    ):
        region = grasp.regions[j]
        force = float(evaluation.contact_forces[arm][row])
        facts.append(
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
    return facts


def _stability(grasp: SceneGrasp) -> StabilityFacts | None:
    contacts = grasp.contacts
    if not grasp.only_pushes or contacts.count < 7:
        return None
    try:
        stability = configuration_stability(contacts)
        six = independence(contacts.subset(stability.six))
    except GraspError:  # no six of them are independent, which the verdict says
        return None
    return StabilityFacts(
        six=[contacts.names[j] for j in stability.six],
        determinant=float(six.determinant) / contacts.length**3,
        independence_limit=stability.delta_max,
        closure_radius=stability.radius.lower
        if grasp.closure and stability.radius is not None
        else None,
        poor=stability.poor,
    )


def _carrying_force(system: System, grasp: SceneGrasp, evaluation: Evaluation) -> float | None:
    scene = system.scene
    if scene.gravity is None or not any(scene.gravity):
        return None
    R = quaternion_to_matrix(evaluation.state.object_quaternion_xyzw.copy())
    mass = scene.one_object("a grasp").mass
    weight = np.append(-mass * R.T @ np.array(scene.gravity), np.zeros(3))
    distribution = distribute_forces(grasp.contacts, weight)
    return distribution.value if distribution else None


def _frame(grasp: SceneGrasp) -> np.ndarray | None:
    """Standard deviations (2,) of position [m] and rotation [rad] of the frame from contacts."""
    faces = [face for face in grasp.faces if face is not None]
    if grasp.body is None or len(faces) < len(grasp.contacts) or not grasp.only_pushes:
        return None
    try:
        frame = object_frame_on_body(
            grasp.contacts.points, grasp.body, faces, point_covariance=MEASURED, previous=np.eye(4)
        )
    except GraspError:  # too few contacts, or not closed
        return None
    if frame.covariance is None:
        return None
    variances = np.diag(frame.covariance).reshape(2, 3).sum(axis=1)
    return np.sqrt(variances) if np.all(np.isfinite(variances)) else None


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
