"""From the effects that a scene names to laws of its contacts and joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from multiarm.candidates.units import Candidates, JointLaw, Law, candidates
from multiarm.contacts.records import Contact, Patch, plane, sphere
from multiarm.errors import ModelError
from multiarm.scene import Scene

COME_AND_GO = ("unilateral_contacts", "contact_friction", "joint_limits", "floor")
"""Effects by which contacts and joints come and go; they have no force of their own."""


def scene_candidates(
    scene: Scene,
    contacts: Mapping[str, list[Contact]],
    limits: Mapping[str, Mapping[str, tuple[float, float]]],
    dry: Mapping[str, np.ndarray] | None,
) -> Candidates | None:
    """The rows of a scene in which something comes and goes; None where nothing does.

    Parameters
    ----------
    scene : Scene
    contacts : mapping arm -> list of Contact
    limits : mapping arm -> joint -> (lower, upper)
        Of the robots, in chain order [rad, m].
    dry : mapping arm -> (n,), optional
        Dry friction of the joints [N m, N].
    """
    laws = _contact_laws(scene, contacts)
    joints = _joint_laws(scene, limits, dry)
    around = [] if scene.effects.floor is None else floor_contacts(scene)
    if not (any(laws.values()) or any(joints.values()) or around):
        return None
    return candidates(contacts, laws, joints, around)


def _contact_laws(scene: Scene, contacts: Mapping[str, list[Contact]]) -> dict[str, dict[int, Law]]:
    apart, rough = scene.effects.unilateral_contacts, scene.effects.contact_friction
    laws: dict[str, dict[int, Law]] = {arm: {} for arm in contacts}
    for arm, own in contacts.items():
        for k, contact in enumerate(own):
            if not contact.pushes_only:
                continue
            law = None
            if apart is not None and _meant(apart.contacts, arm, contact):
                law = Law(restitution=apart.restitution)
            if rough is not None and _meant(rough.contacts, arm, contact):
                law = replace(law or Law(), mu=rough.mu)
            if law is not None:
                laws[arm][k] = law
    return laws


def _meant(names: tuple[str, ...] | None, arm: str, contact: Contact) -> bool:
    return names is None or arm in names or f"{arm}/{contact.name}" in names


def _joint_laws(
    scene: Scene,
    limits: Mapping[str, Mapping[str, tuple[float, float]]],
    dry: Mapping[str, np.ndarray] | None,
) -> dict[str, dict[int, tuple[str, JointLaw]]]:
    spec = scene.effects.joint_limits
    found: dict[str, dict[int, tuple[str, JointLaw]]] = {}
    for arm, joints in limits.items():
        own = found.setdefault(arm, {})
        for number, (name, (lower, upper)) in enumerate(joints.items()):
            law = JointLaw()
            if spec is not None:
                ends = (lower, upper) if spec.range == "urdf" else spec.range.get(arm, {}).get(name)
                if ends is not None:
                    low, high = (None if np.isinf(end) else float(end) for end in ends)
                    law = JointLaw(low, high, spec.restitution)
            if dry is not None and dry[arm][number] > 0.0:
                law = replace(law, friction=float(dry[arm][number]))
            if law != JointLaw(restitution=law.restitution):
                own[number] = (name, law)
    return found


def floor_contacts(scene: Scene) -> list[tuple[Contact, Law]]:
    """Contacts of the object with the floor, and their law."""
    spec = scene.effects.floor
    assert spec is not None, "a scene with a floor"
    pose, law = spec.at.matrix(), Law(spec.mu, spec.restitution)
    ground = plane(pose[:3, 3], pose[:3, 2])
    if spec.size is not None:
        half = 0.5 * np.array([*spec.size, np.inf])
        ground = replace(ground, patch=Patch(-half, half, pose))
    return [
        (Contact(name, ground, sphere(point, radius), pushes_only=True), law)
        for name, point, radius in _touching_points(scene)
    ]


def _touching_points(scene: Scene) -> list[tuple[str, np.ndarray, float]]:
    """Name, place in the object frame and radius of what can touch the floor."""
    assert scene.effects.floor is not None
    given, shape = scene.effects.floor.points, scene.object.shape
    if given is not None:
        return [(f"point {k + 1}", np.array(point), 0.0) for k, point in enumerate(given)]
    if shape.sphere is not None:
        return [("ball", np.zeros(3), float(shape.sphere))]
    if shape.box is not None:
        half = 0.5 * np.array(shape.box)
        corners = [np.array(signs) * half for signs in product((-1.0, 1.0), repeat=3)]
        return [(f"corner {k + 1}", corner, 0.0) for k, corner in enumerate(corners)]
    raise ModelError(
        "effects.floor: the corners of the object's shape are not known; name the points that can "
        "touch the floor with 'points', in the object frame"
    )
