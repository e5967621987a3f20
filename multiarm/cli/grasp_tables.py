"""Grasps as tables on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.text import Text

from multiarm.terminal.console import columns, facts, number, vector

if TYPE_CHECKING:
    from multiarm.grasp.grasp import Grasp
    from multiarm.grasp.scenes.judging import ContactFacts, GraspJudgement

__all__ = ["design_facts", "judgement_tables"]


def design_facts(grasp: Grasp) -> dict[str, RenderableType]:
    """What there is to know of a designed grasp."""
    closure = grasp.closure
    rows: dict[str, RenderableType] = {
        "body": f"{len(grasp.body.faces)} faces, size {number(grasp.body.size, 'm')}",
        "verdict": _verdict(bool(closure), closure.message),
        "margin": f"{number(closure.margin)} (of 1, shared by {len(grasp.contacts)} contacts)",
    }
    for gripper in grasp.grippers:
        names = ", ".join(
            f"{grasp.contacts.names[j]} on {grasp.body.faces[grasp.faces[j]].name}"
            for j in gripper.contacts
        )
        size = number(grasp.gripper_size(gripper.name), "m")
        rows[gripper.name] = f"{names}; {size} across"
    for k, note in enumerate(grasp.notes):
        rows["notes" if k == 0 else " " * k] = note
    return rows


def judgement_tables(found: GraspJudgement) -> list[RenderableType]:
    """The contacts of a scene's grasp, and what they make."""
    return [
        columns(
            "Contacts, in the object's frame, at the start",
            ("arm", "contact", "face", "at, m", "force", "may slide by", "share"),
            [_contact(contact, found) for contact in found.contacts if not contact.pulls],
        ),
        facts("Grasp", _grasp_facts(found)),
    ]


def _contact(contact: ContactFacts, found: GraspJudgement) -> tuple[RenderableType, ...]:
    pulled = contact.force < 0.0 and found.only_pushes
    force = Text(number(contact.force, "N"), "yellow" if pulled else "")
    return (
        contact.arm,
        contact.name.removeprefix(f"{contact.arm}/"),
        contact.face or "-",
        vector(contact.point, digits=3),
        force,
        number(contact.room, "m") if contact.room is not None else "-",
        number(contact.coefficient),
    )


def _grasp_facts(found: GraspJudgement) -> dict[str, RenderableType]:
    rows: dict[str, RenderableType] = {
        "verdict": _verdict(found.closed, found.verdict),
        "contacts": "all can only push"
        if found.only_pushes
        else "some hold both ways, as joints do",
    }
    if found.borderline:
        rows["borderline"] = Text("roundings decide; move the contacts apart", "yellow")
    if found.left_out:
        rows["left out"] = f"no contacts in points: {', '.join(found.left_out)}"
    if found.closed:
        rows["margin"] = f"smallest share {number(found.margin)} of 1 at best"
    elif found.immobility_order == 2:
        rows["to second order"] = "held, by what turning does to the flat faces"
    if found.carrying_force is not None:
        rows["weight"] = f"carried with at most {number(found.carrying_force, 'N')} a contact"
    stability = found.stability
    if stability is not None:
        if stability.closure_radius is not None:
            rows["all may slide by"] = (
                f"{number(stability.closure_radius, 'm')} at once, in any direction"
            )
        rows["six independent"] = (
            f"{', '.join(stability.six)}; they stay so within "
            f"{number(stability.independence_limit, 'm')}"
        )
    if found.frame_position is not None and found.frame_rotation is not None:
        rows["object's frame"] = (
            f"from contact points known to 0.1 mm: within {number(1e3 * found.frame_position)} mm "
            f"and {number(1e3 * found.frame_rotation)} mrad (standard deviations)"
        )
    return rows


def _verdict(closed: bool, words: str) -> Text:
    return Text(words, "bold green" if closed else "bold yellow")
