"""From the effects that a scene names to laws of its contacts and joints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from multiarm.contacts.records import Contact
from multiarm.errors import SceneError
from multiarm.events.candidates.floor import floor_contacts
from multiarm.events.candidates.units import Candidates, JointLaw, Law, candidates
from multiarm.scene import Scene
from multiarm.scene.effects import SomeContacts
from multiarm.scene.faults import place, unknown


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

    Raises
    ------
    SceneError
        Naming contacts that do not exist, or that cannot do what the effect is about.
    """
    laws = _contact_laws(scene, contacts)
    joints = _joint_laws(scene, limits, dry)
    around = [] if scene.effects.floor is None else floor_contacts(scene)
    if not (any(laws.values()) or any(joints.values()) or around):
        return None
    return candidates(contacts, laws, joints, around)


def _contact_laws(scene: Scene, contacts: Mapping[str, list[Contact]]) -> dict[str, dict[int, Law]]:
    effects = scene.effects
    faults: list[str] = []
    apart, rough = effects.unilateral_contacts, effects.contact_friction
    soft = effects.contact_compliance
    for name, spec, pushing in (
        ("unilateral_contacts", apart, True),
        ("contact_friction", rough, True),
        ("contact_compliance", soft, False),
    ):
        if spec is not None:
            faults += _name_faults(name, spec, contacts, pushing)
    laws: dict[str, dict[int, Law]] = {arm: {} for arm in contacts}
    for arm, own in contacts.items():
        for k, contact in enumerate(own):
            law = None
            if apart is not None and contact.pushes_only and _meant(apart, arm, contact):
                law = Law(restitution=apart.restitution)
            if rough is not None and contact.pushes_only and _meant(rough, arm, contact):
                law = replace(law or Law(), mu=rough.mu)
            if soft is not None and contact.tangent == 0 and _meant(soft, arm, contact):
                if law is not None and law.mu is not None:
                    faults.append(_soft_and_rough(arm, contact))
                law = Law(stiffness=soft.stiffness, damping=soft.damping)
            if law is None:
                continue
            laws[arm][k] = law
            if k + 1 < len(own) and own[k + 1].tangent:
                faults.append(_rolls(arm, contact))
    if faults:
        raise SceneError(list(dict.fromkeys(faults)))
    return laws


def _meant(spec: SomeContacts, arm: str, contact: Contact) -> bool:
    names = spec.contacts
    return names is None or arm in names or f"{arm}/{contact.name}" in names


def _name_faults(
    effect: str, spec: SomeContacts, contacts: Mapping[str, list[Contact]], pushing: bool
) -> Iterator[str]:
    """Names of ``contacts`` that no contact has which can only push, where that is asked."""
    known = {
        f"{arm}/{contact.name}": contact.pushes_only or not pushing
        for arm, own in contacts.items()
        for contact in own
        if contact.tangent == 0
    }
    usable = [name for name, fits in known.items() if fits]
    for k, name in enumerate(spec.contacts or ()):
        where = place(("effects", effect, "contacts", k))
        if name in contacts:
            if not any(other.startswith(f"{name}/") for other in usable):
                yield f"{where}: arm {name!r} has no contact that only pushes; name others"
        elif name not in known:
            yield f"{where}: {unknown('contact', name, usable)}"
        elif not known[name]:
            yield (
                f"{where}: contact {name!r} also pulls, and cannot let go or slide; contacts that "
                f"only push are {', '.join(map(repr, usable)) or '(none)'}"
            )


def _rolls(arm: str, contact: Contact) -> str:
    return (
        f"$.effects: contact '{arm}/{contact.name}' rolls ('rolling: true'): it cannot let go, "
        f"slide or give way; leave it out of 'contacts' of the effect, or give it friction and "
        f"no 'rolling'"
    )


def _soft_and_rough(arm: str, contact: Contact) -> str:
    return (
        f"$.effects.contact_compliance: contact '{arm}/{contact.name}' is one of contact_friction, "
        f"which needs a rigid contact; name the contacts of each with 'contacts'"
    )


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
