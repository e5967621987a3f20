"""``multiarm joints``, ``shapes``, ``controls``, ``methods``: what scenes may name."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import typer

from multiarm.cli.catalogue import Card, KindName, Section, show
from multiarm.cli.options import JsonFile
from multiarm.scene.parameters import parameters_of


def joints(
    kind: Annotated[
        str | None,
        typer.Argument(
            help="One kind of joint or surface, shown in full; or 'surfaces'.",
            show_default="all kinds",
            metavar="[KIND]",
        ),
    ] = None,
    json: JsonFile = None,
) -> None:
    """List the joints between an arm and the object with their free motions and parameters.

    A joint is a set of frictionless contacts, each of which takes away one motion; rows are their
    number. Names of kinds are those of 'kind:' in a scene.

    The JSON has the keys joints, surfaces: each a table by name, with what is shown here.
    """
    from multiarm.cli.joint_cards import joint_section, surface_section

    show("joints", {"joints": joint_section(), "surfaces": surface_section()}, kind, json)


def shapes(name: KindName = None, json: JsonFile = None) -> None:
    """List the shapes of the object with their parameters: 'shape:' below 'object:' in a scene.

    The JSON has the key shapes: a table by name, with what is shown here.
    """
    from multiarm.scene import Shape

    cards = {
        name: Card.of_key(Shape, name, Shape.example_text(name)) for name in Shape.model_fields
    }
    section = Section(
        "Shapes of the object", "shape", "shapes", cards, heads=("shape", "what it is")
    )
    show("shapes", {"shapes": section}, name, json)


def controls(name: KindName = None, json: JsonFile = None) -> None:
    """List the kinds of control with their parameters; 'kind:' below 'control:' in a scene.

    The JSON has the key controls: a table by name, with what is shown here.
    """
    from multiarm.scene.control import BUILT_IN, CONTROLS

    section = Section.of_kinds("Controls", BUILT_IN, CONTROLS, heads=("name", "what it is"))
    show("controls", {"controls": section}, name, json)


def effect_section() -> Section:
    """The effects that a scene may name."""
    from multiarm.scene.effects import BUILT_IN, EFFECTS, EffectsSpec
    from multiarm.scene.effects.drives import JointNumbers

    section = Section.of_kinds("Effects", BUILT_IN, EFFECTS, heads=("name", "what it is"))
    numbers = {  # some effects are numbers without a table around them
        parameter.name: replace(section.cards[parameter.name], parameters=[parameter])
        for parameter in parameters_of(EffectsSpec)
        if issubclass(BUILT_IN[parameter.name], JointNumbers)
    }
    return replace(section, cards={**section.cards, **numbers})


def methods(name: KindName = None, json: JsonFile = None) -> None:
    """List the integrators with their order and when to choose them, and the stabilizations.

    A scene names them below 'run:'; without names the program chooses by the accuracy.

    The JSON has the keys integrators, stabilizations: each a table by name, with what is shown
    here.
    """
    from multiarm.scene.run import StabilizationSpec
    from multiarm.scene.settings import STABILIZATIONS
    from multiarm.tableaus import KINDS, METHODS

    integrators = {}
    for key, method in METHODS.items():
        kind, order = KINDS[method.kind], str(method.order)
        steps = "tolerance: 1e-8" if method.adaptive else "step: 0.001"
        chosen = {"steps": "adaptive" if method.adaptive else "all as long as 'step' says"}
        integrators[key] = Card(
            key,
            method.purpose,
            [],
            f"run:\n  integrator: {key}\n  {steps}",
            count=order,
            facts={"kind": kind, "order": order, **chosen},
            listed=chosen,
            further={"kind": kind, "order": method.order, "adaptive": method.adaptive},
        )
    gains = parameters_of(StabilizationSpec)
    stabilizations = {
        key: Card(key, text, gains if key == "feedback" else [], f"run:\n  stabilization: {key}")
        for key, text in STABILIZATIONS.items()
    }
    sections = {
        "integrators": Section(
            "Integrators",
            "method",
            "methods",
            integrators,
            heads=("method", "order", "when to choose it"),
        ),
        "stabilizations": Section(
            "Stabilizations: how the joints are kept closed",
            "stabilization",
            "stabilizations",
            stabilizations,
            heads=("stabilization", "what it does"),
        ),
    }
    show("methods", sections, name, json)
