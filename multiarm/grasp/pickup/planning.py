r"""Planning a pick-up: without tilting if that can be, else about the edge of least force.

For each edge, the first of these that fails is the reason why not:

1. Some pushes on the faces that are free, with the floor at the edge, carry the weight.
2. Tilted as far as the edge allows, the face that the body lies on has the height that a finger
   needs.
3. Contacts anywhere on the free faces, and on the part of this face that the largest tilt frees,
   close the body.
4. So do contacts where fingertips reach both as the body lies and tilted by some angle.
5. Two grippers at corners of the body, each from one side, reach such contacts.
6. A search finds seven contacts that hold the body in all phases with bounded forces.

The first three are proofs.  Pushes at the corners of the parts that can be reached stand for all,
and no tilt frees more of any face: contacts on other faces press from the start, and of the face
that the body lies on, the largest tilt frees most.

The fourth is one, too, where it says so.  While the body is tilted, the height of a point over the
edge is a sine, concave above the floor: what is high enough before and after a tilt is so on the
way.  So larger tilts leave less of the other faces, and free more of the face below.  In a range of
tilts nothing closes the body where all that the smallest leaves, with all that the largest frees,
does not; ranges are halved until this decides.

The others are no proofs: a few tilts are tried, the usual one, the largest, and the one of many at
which what can be reached closes the body most firmly; and the search draws at random.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import generator_of, number_of
from multiarm.grasp.body.body_class import as_polyhedron
from multiarm.grasp.body.face import across, frame_of
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.closure.form_closure import is_form_closure
from multiarm.grasp.closure.motions import motion_in_words
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.face_contacts import Gripper
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.optimisation.placements import FaceChoices, face_choices, touch_regions
from multiarm.grasp.pickup.contact_search import ContactSearch, Placement
from multiarm.grasp.pickup.from_above import approach_from_above
from multiarm.grasp.pickup.lying_body import (
    DOWN,
    STILL,
    LyingBody,
    PivotEdge,
    laid_on_face,
    reached_part,
)
from multiarm.grasp.pickup.phases import (
    GRIP,
    LIFT,
    TAKE_HOLD,
    TILT,
    PickupError,
    PickupPhase,
    PickupRefusal,
)
from multiarm.grasp.pickup.plan import PickupPlan
from multiarm.grasp.pickup.tilting import UP, all_pushes, carried, floor_contacts, weakest_force

# Parts of the size of a body that a gripper's contacts keep within, by default: the first with
# which all choices of faces can be looked at.
GRIPPER_SIZES = (0.4, 0.3, 0.2, 0.15)
# A body is tilted no farther than this where that is enough [rad].
USUAL_TILT = np.radians(30.0)
# Contacts of the two grippers, and those on the face that the body lies on, at most: three fix the
# body against it.
FINGERS, MOST_BELOW = (4, 3), 3
# Fingertips are this many radii apart.
SPACING = 4.0
# Forces of hands that are larger than so many weights are not used.
LARGEST = 10.0
# A tilt by one radian costs as much as all forces again.  One in which hands and floor do not close
# the body, so that only its weight holds it, costs so many times as much.
ONLY_BY_WEIGHT = 2.0
NOTHING_BETTER = "no better contacts were found"
NOT_CLOSED = "contacts on the free faces were not found to close it"
NEVER_CLOSED = (
    "no tilt lets contacts on the free faces close it: larger ones free more of the face below, "
    "and leave less of the others"
)
# Tilts that are looked at where the first ones are in vain, and the narrowest range of them [rad].
SCANNED, NARROWEST = 40, np.radians(0.05)
WORSE = (
    "its contacts are worse: they take larger forces or a larger tilt, or the body is held by its "
    "weight alone"
)
# Parts of the angle at which equilibrium is looked at, by the search and in the plan.
JUDGED, SAMPLES = (0.0, 1.0), (0.0, 0.25, 0.5, 0.75, 1.0)
# Smallest singular value of scaled wrenches that hold a body.
FULL_RANK = 1e-3


def plan_pickup(
    body: Polyhedron,
    *,
    face: int | str | None = None,
    gripper_size: float | None = None,
    finger: float = 0.03,
    tip_radius: float = 0.01,
    least: float = 0.1,
    rng: np.random.Generator | int | None = 0,
) -> PickupPlan:
    """Plan how two grippers without friction pick a body up from the floor, tilting it if need be.

    Parameters
    ----------
    body : Polyhedron
        Convex.
    face : int or str, optional
        On which it lies, by number or name; left out: of those that it can lie on, the one that
        looks down most steeply.
    gripper_size : float, optional
        All contacts of a gripper are within this distance of a corner of the body [m]; left out:
        two fifths of the size of the body, less where it has very many faces.
    finger : float
        Height above the floor that a contact needs [m].
    tip_radius : float
        Of the fingertips [m]: contacts keep it from the edges of their faces.
    least : float
        Every contact that presses does so with this part of the weight at least.
    rng : Generator or int
        Of the search for contacts; the same seed gives the same plan.

    Raises
    ------
    PickupError
        Nothing picks the body up, or no contacts were found: why, for each edge.
    GraspError
        Unusable numbers; a body that is not convex, or does not lie on the face.
    """
    body = as_polyhedron(body)
    sizes = (
        tuple(part * body.size for part in GRIPPER_SIZES)
        if gripper_size is None
        else (gripper_size,)
    )
    lengths = {"finger": finger, "tip_radius": tip_radius, "least": least, "gripper_size": sizes[0]}
    for name, value in lengths.items():
        number_of(value, f"{name} is greater than 0", above=0.0)
    generator = generator_of(rng, "rng")
    return _Planner(laid_on_face(body, face), sizes, finger, tip_radius, least, generator).plan()


class _NotHeldError(Exception):
    """Contacts do not hold the body in some phase; by a force over the weight, or not at all."""

    def __init__(self, lacking: float = np.inf) -> None:
        super().__init__()
        self.lacking = lacking


class _Planner:
    """The search for a plan, one edge after the other."""

    def __init__(
        self,
        lies: LyingBody,
        gripper_sizes: tuple[float, ...],
        finger: float,
        tip_radius: float,
        least: float,
        rng: np.random.Generator,
    ) -> None:
        self.lies, self.body = lies, lies.body
        self.gripper_sizes, self.finger, self.tip_radius = gripper_sizes, finger, tip_radius
        self.least, self.rng = least, rng
        self.free = self._parts([STILL])
        self.most = LARGEST
        self.reached: dict[frozenset[int], bool] = {}

    def plan(self) -> PickupPlan:
        """The plan."""
        self._require_free_faces()
        refused: list[PickupRefusal] = []
        best: tuple[PivotEdge | None, Placement] | None = None
        for edge in (None, *self.lies.edges()):
            outcome = self._placement(edge)
            if isinstance(outcome, PickupRefusal):
                refused.append(outcome)
            else:
                if best is not None:
                    refused.append(PickupRefusal(best[0], WORSE))
                best, self.most = (edge, outcome), outcome.cost
                if edge is None:
                    break
        if best is None:
            lines = "".join(f"\n- {refusal}" for refusal in refused)
            raise PickupError(
                f"the body is not picked up from {self.body.names[self.lies.face]}:{lines}", refused
            )
        return self._finished(*best, tuple(refused))

    def _require_free_faces(self) -> None:
        """Refuse a body of which a finger reaches nothing."""
        if self.free:
            return
        height = self.lies.at(self.body.vertices)[:, 2].max()
        reason = (
            f"no face is free: the body is {height:.3g} m high, and a finger needs "
            f"{self.finger:g} m; choose a smaller finger"
        )
        name = self.body.names[self.lies.face]
        raise PickupError(
            f"the body is not picked up from {name}: {reason}",
            [PickupRefusal(edge, reason) for edge in (None, *self.lies.edges())],
        )

    # --- what can be --------------------------------------------------------------------------

    def _placement(self, edge: PivotEdge | None) -> Placement | PickupRefusal:
        """The cheapest contacts for tilting about an edge, or why there are none."""
        obstacle = self._not_closed(None, self.free) if edge is None else self._obstacle(edge)
        if obstacle is not None:
            return obstacle
        if edge is None:
            outcome = self._placement_at(None, 0.0)
            return outcome if isinstance(outcome, Placement) else PickupRefusal(None, outcome)
        reasons: dict[str, list[str]] = {}
        for tilt in self._tilts(edge):
            outcome = self._placement_at(edge, tilt)
            if isinstance(outcome, Placement):
                return outcome
            if self.most < LARGEST and outcome != NOT_CLOSED:  # another tilt would not be cheaper
                return PickupRefusal(edge, NOTHING_BETTER)
            reasons.setdefault(outcome, []).append(f"{np.degrees(tilt):.3g} deg")
        if [*reasons] == [NOT_CLOSED] and self._never_closed(edge):
            return PickupRefusal(edge, NEVER_CLOSED)
        words = [f"at {' and at '.join(tilts)}, {reason}" for reason, tilts in reasons.items()]
        return PickupRefusal(edge, "; ".join(words))

    def _tilts(self, edge: PivotEdge) -> Iterator[float]:
        """Tilts that are tried: the usual one, the largest, and the one that closes most firmly."""
        tried = sorted({min(USUAL_TILT, edge.limit), edge.limit})
        yield from tried
        between = np.linspace(self._least_tilt(edge), edge.limit, SCANNED)
        margins = [self._margin(edge, tilt, tilt) for tilt in (*tried, *between)]
        firmest = int(np.argmax(margins)) - len(tried)
        if firmest >= 0 and margins[firmest + len(tried)] > 0.0:
            yield float(between[firmest])

    def _least_tilt(self, edge: PivotEdge) -> float:
        """The tilt at which a finger begins to fit below the body [rad]."""
        away = edge.distance(self.lies.at(self.body.faces[self.lies.face].vertices)).max()
        return float(np.arcsin(min(self.finger / away, 1.0)))

    def _margin(self, edge: PivotEdge, free: float, freed: float) -> float:
        """How firmly pushes close the body, 0 where they do not.

        On free faces where one tilt reaches them, and on the face below where another one does.
        """
        parts, below = self._parts([STILL, edge.turned(free)]), self._freed(edge, freed)
        parts.pop(self.lies.face, None)
        if below is not None:
            parts[self.lies.face] = below
        closure = is_form_closure(all_pushes(self.body, parts)) if parts else None
        return closure.margin if closure else 0.0

    def _never_closed(self, edge: PivotEdge) -> bool:
        """Whether it is certain that no tilt closes the body, range by range."""
        ranges = [(self._least_tilt(edge), edge.limit)]
        while ranges:
            low, high = ranges.pop()
            if not self._margin(edge, low, high):
                continue
            middle = 0.5 * (low + high)
            if high - low < NARROWEST or self._margin(edge, middle, middle):
                return False
            ranges += [(low, middle), (middle, high)]
        return True

    def _obstacle(self, edge: PivotEdge) -> PickupRefusal | None:
        """Why no contacts pick the body up about an edge, with proof."""
        return self._not_tilted(edge) or self._too_low(edge) or self._not_freed(edge)

    def _not_tilted(self, edge: PivotEdge) -> PickupRefusal | None:
        """Why no pushes carry the body with the floor at an edge alone."""
        floor = floor_contacts(self.body, self.lies.pose, edge.vertices)
        contacts = all_pushes(self.body, self.free).joined(floor)
        lifted = carried(self.body, self.lies.pose, contacts, 0.0)
        if lifted:
            return None
        tilting = edge.twist(self.lies.pose)
        if np.all(contacts.wrenches.T @ tilting <= 1e-9 * self.body.size):
            reason = "every push on its free faces turns it down onto the floor"
            return PickupRefusal(edge, reason, tilting)
        assert lifted.motion is not None
        words = motion_in_words(contacts, lifted.motion)
        return PickupRefusal(
            edge,
            f"pushes on its free faces do not lift it: none does work when it can {words}, which "
            "lifts its weight",
            lifted.motion,
        )

    def _freed(self, edge: PivotEdge, tilt: float) -> np.ndarray | None:
        """The part of the face that the body lies on which a tilt frees, None for no part."""
        return reached_part(self.lies, self.lies.face, [edge.turned(tilt)], self.finger)

    def _too_low(self, edge: PivotEdge) -> PickupRefusal | None:
        """Why the largest tilt lets no finger below the body."""
        if self._freed(edge, edge.limit) is not None:
            return None
        away = edge.distance(self.lies.at(self.body.faces[self.lies.face].vertices))
        return PickupRefusal(
            edge,
            f"{self.body.names[self.lies.face]} gets {away.max() * np.sin(edge.limit):.3g} m above "
            f"the floor at most, at {np.degrees(edge.limit):.0f} deg, and a finger needs "
            f"{self.finger:g} m",
        )

    def _not_freed(self, edge: PivotEdge) -> PickupRefusal | None:
        """Why no tilt frees enough: no part of a face is larger than one of these."""
        freed = self._freed(edge, edge.limit)
        assert freed is not None  # it is not too low
        return self._not_closed(edge, {**self.free, self.lies.face: freed})

    def _not_closed(
        self, edge: PivotEdge | None, parts: dict[int, np.ndarray]
    ) -> PickupRefusal | None:
        """Why contacts on parts that hold all that can be reached do not close the body."""
        pushes = all_pushes(self.body, parts)
        motion = is_form_closure(pushes).motion
        if motion is None:
            return None
        tilted = "" if edge is None else ", however far it is tilted"
        words = motion_in_words(pushes, motion)
        reason = f"contacts on the free faces do not close it{tilted}: it can {words}"
        return PickupRefusal(edge, reason, motion)

    def _placement_at(self, edge: PivotEdge | None, tilt: float) -> Placement | str:
        """The cheapest contacts for tilting by an angle at most, or why none were found."""
        parts = self.free
        if edge is not None:
            freed = self._freed(edge, tilt)
            if freed is None:
                return f"{self.body.names[self.lies.face]} is too low for a finger"
            parts = {**self._parts([STILL, edge.turned(tilt)]), self.lies.face: freed}
            if not is_form_closure(all_pushes(self.body, parts)):
                return NOT_CLOSED
        return self._found(edge, tilt, parts)

    def _found(
        self, edge: PivotEdge | None, tilt: float, parts: dict[int, np.ndarray]
    ) -> Placement | str:
        """The cheapest contacts on parts of faces that were found, or why none were."""
        try:
            size, choices = self._choices(edge, parts)
        except GraspError as error:
            return str(error)
        if not len(choices):
            return (
                f"no two grippers of {size:.3g} m reach faces that close it, each from one side "
                "and from above; choose larger ones"
            )
        motions = [STILL] if edge is None else [STILL, edge.turned(tilt)]
        forces = [(motion @ self.lies.pose)[:3, :3].T @ UP for motion in motions]
        search = ContactSearch(
            choices=choices,
            middle=np.asarray(self.body.centre),
            size=self.body.size,
            loads=[np.concatenate([force, np.zeros(3)]) for force in forces],
            least=self.least,
            spacing=SPACING * self.tip_radius,
            judge=lambda contacts, faces, most: self._cost(edge, contacts, faces, most),
            most=self.most,
            impossible=LARGEST,
            rng=self.rng,
        )
        best = search.best()
        if best is not None and self._holds(edge, best):
            return best
        return (
            f"no contacts were found that hold it with less than {LARGEST:g} weights in all "
            "phases; choose larger grippers, a smaller finger or another seed"
        )

    def _holds(self, edge: PivotEdge | None, placement: Placement) -> bool:
        """Whether contacts hold the body in all phases, at more angles than the search looks at."""
        try:
            self._phases(edge, placement.contacts, placement.faces, SAMPLES)
        except _NotHeldError:
            return False
        return True

    def _choices(
        self, edge: PivotEdge | None, parts: dict[int, np.ndarray]
    ) -> tuple[float, FaceChoices]:
        """The size of grippers [m], and their choices with contacts on the face that is freed."""
        for size in self.gripper_sizes:
            regions = touch_regions(
                self.body, self.body.vertices, size, clearance=self.tip_radius, faces=parts
            )
            try:
                choices = face_choices(regions, FINGERS)
                break
            except GraspError:  # there are too many
                if size == self.gripper_sizes[-1]:
                    raise
        below = np.array([region.face == self.lies.face for region in choices.regions], dtype=int)
        counts = below[choices.numbers].sum(axis=1)
        usable = (counts >= (edge is not None)) & (counts <= MOST_BELOW)
        numbers = choices.numbers[usable]
        hands = np.split(numbers, [FINGERS[0]], axis=1)
        reached = np.array(
            [
                all(self._comes_from_above(choices, hand[k]) for hand in hands)
                for k in range(len(numbers))
            ],
            dtype=bool,
        )
        return size, FaceChoices(choices.regions, numbers[reached])

    def _comes_from_above(self, choices: FaceChoices, hand: np.ndarray) -> bool:
        """Whether a hand reaches those of its regions that are free as the body lies."""
        faces = {choices.regions[k].face for k in hand.tolist()} - {self.lies.face}
        key = frozenset(faces)
        if key not in self.reached:
            down = self.lies.pose[:3, :3].T @ DOWN
            inward = -self.body.normals[sorted(faces)]
            self.reached[key] = bool(faces) and approach_from_above(inward, down) is not None
        return self.reached[key]

    def _parts(self, motions: list[np.ndarray]) -> dict[int, np.ndarray]:
        """What fingertips reach of the faces after every one of some motions, by face."""
        numbers = range(len(self.body.faces))
        parts = {k: reached_part(self.lies, k, motions, self.finger) for k in numbers}
        return {k: part for k, part in parts.items() if part is not None}

    # --- phases -------------------------------------------------------------------------------

    def _late(self, faces: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(j for j, face in enumerate(faces) if face == self.lies.face)

    def _angle(self, edge: PivotEdge | None, contacts: Contacts, late: tuple[int, ...]) -> float:
        """The tilt at which the lowest of the late contacts has the height of a finger [rad]."""
        if edge is None:
            return 0.0
        away = edge.distance(self.lies.at(contacts.points[list(late)]))
        return float(np.arcsin(self.finger / away.min()))

    def _cost(
        self, edge: PivotEdge | None, contacts: Contacts, faces: tuple[int, ...], most: float
    ) -> float:
        """The largest force of the hands in all phases, over the weight, and more for the tilt.

        Above ``LARGEST`` by what is lacking where they do not hold the body.
        """
        try:
            phases = self._phases(edge, contacts, faces, JUDGED, most)
        except _NotHeldError as error:
            return LARGEST + error.lacking
        cost = max(phase.largest for phase in phases)
        closed = all(phase.closure for phase in phases if phase.name == TILT)
        cost *= 1.0 + self._angle(edge, contacts, self._late(faces))
        return cost if closed else ONLY_BY_WEIGHT * cost

    def _phases(
        self,
        edge: PivotEdge | None,
        contacts: Contacts,
        faces: tuple[int, ...],
        samples: tuple[float, ...],
        most: float = np.inf,
    ) -> tuple[PickupPhase, ...]:
        late, everyone = self._late(faces), tuple(range(len(contacts)))
        early = tuple(j for j in everyone if j not in late)
        angle = self._angle(edge, contacts, late)
        start, end = np.zeros(1), np.array([angle])
        phases: list[tuple[str, tuple[int, ...], tuple[int, ...], np.ndarray]] = []
        if edge is not None:  # what takes most force comes first
            phases.append((TILT, early, edge.vertices, np.array(samples) * angle))
        phases.append((LIFT, everyone, (), end))
        phases.append((GRIP, early, self.lies.corners, start))
        if edge is not None:
            phases.append((TAKE_HOLD, everyone, edge.vertices, end))
        done = {phase[0]: self._phase(edge, contacts, *phase, most) for phase in phases}
        return tuple(done[name] for name in (GRIP, TILT, TAKE_HOLD, LIFT) if name in done)

    def _phase(
        self,
        edge: PivotEdge | None,
        contacts: Contacts,
        name: str,
        pressing: tuple[int, ...],
        floor: tuple[int, ...],
        angles: np.ndarray,
        most: float,
    ) -> PickupPhase:
        forces, hands = [], contacts.subset(pressing)
        pushes = hands
        for angle in angles:
            motion = STILL if edge is None else edge.turned(float(angle))
            pose = motion @ self.lies.pose
            if floor:
                pushes = hands.joined(floor_contacts(self.body, pose, floor))
            lowest = np.linalg.svd(pushes.scaled_wrenches, compute_uv=False)[-1]
            if len(pushes) < 6 or lowest < FULL_RANK:
                raise _NotHeldError
            carrying = carried(self.body, pose, pushes, self.least)
            if carrying.forces is None:
                raise _NotHeldError(self.least - weakest_force(self.body, pose, pushes))
            if carrying.forces[: len(hands)].max() > most:
                raise _NotHeldError
            forces.append(carrying.forces)
        return PickupPhase(name, pressing, floor, angles, np.array(forces), pushes)

    def _finished(
        self, edge: PivotEdge | None, placement: Placement, refused: tuple[PickupRefusal, ...]
    ) -> PickupPlan:
        normals = [region.normal for region in placement.regions]
        carried_by = (tuple(range(FINGERS[0])), tuple(range(FINGERS[0], sum(FINGERS))))
        names = [
            f"gripper {g + 1} tip {k + 1}" for g, count in enumerate(FINGERS) for k in range(count)
        ]
        contacts, faces = Contacts(placement.points, normals, names), placement.faces
        grippers = []
        for number, carries in enumerate(carried_by, start=1):
            inward = contacts.normals[list(carries)].mean(axis=0)
            inward /= np.linalg.norm(inward)
            corner = self.body.vertices[placement.regions[carries[0]].place]
            frame = frame_of(inward, across(inward), corner)
            grippers.append(Gripper(f"gripper {number}", carries, frame))
        late = self._late(faces)
        return PickupPlan(
            lies=self.lies,
            free_faces=tuple(self.free),
            edge=edge,
            angle=self._angle(edge, contacts, late),
            grasp=Grasp(self.body, contacts, faces, tuple(grippers)),
            late=late,
            phases=self._phases(edge, contacts, faces, SAMPLES),
            finger=self.finger,
            tip_radius=self.tip_radius,
            least=self.least,
            refused=refused,
        )
