"""Form-closure grasps of polyhedra by frictionless contacts: decide, understand, design.

>>> import multiarm as ma
>>> grasp = ma.grasp.design_block_grasp([1.2, 0.8, 0.6])
>>> grasp.closure.margin, grasp.closure.coefficients
>>> scene = grasp.to_scene(arms=["panda", "panda"])

See chapter 2 and the appendices A to C of the thesis.  Points are in metres,
in the body's frame; a contact's normal is a unit vector *into* the body.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiarm.grasp.blocks import BlockDesign, block_design, design_block_grasp
    from multiarm.grasp.body_class import BodyClass, Roundness, classify, roundness
    from multiarm.grasp.closure_radii import ClosureRadius, closure_radius, independence_radius
    from multiarm.grasp.construction import design_grasp, search_grasp
    from multiarm.grasp.contacts import Contacts
    from multiarm.grasp.face import Face
    from multiarm.grasp.face_contacts import Gripper
    from multiarm.grasp.force_distribution import ForceDistribution, distribute_forces
    from multiarm.grasp.form_closure import FormClosure, ManyClosures, closed_many, is_form_closure
    from multiarm.grasp.grasp import Grasp
    from multiarm.grasp.immobility import Immobility
    from multiarm.grasp.independent_contacts import (
        BlockInverse,
        Independence,
        Violation,
        block_inverse,
        independence,
        violated_conditions,
    )
    from multiarm.grasp.load_maps import (
        LiftableMap,
        LoadCapacity,
        WorstForce,
        liftable,
        load_capacity,
        worst_force,
    )
    from multiarm.grasp.object_frame import (
        FrameCandidate,
        ObjectFrame,
        object_frame_from_contacts,
        object_frame_from_faces,
        object_frame_on_body,
    )
    from multiarm.grasp.optimisation import OptimisedGrasp, optimise_grasp
    from multiarm.grasp.parallel_bodies import (
        ParallelDesign,
        design_parallel_grasp,
        parallel_design,
    )
    from multiarm.grasp.polyhedron import MassProperties, Polyhedron
    from multiarm.grasp.seventh_contact import ContactRegion, seventh_contact_region
    from multiarm.grasp.special_selections import (
        ThreeMoments,
        case_I,
        case_II,
        case_III,
        three_moments,
    )
    from multiarm.grasp.stability import (
        ConfigurationStability,
        DrawnStability,
        configuration_stability,
        monte_carlo_stability,
        own_regions,
    )
    from multiarm.grasp.wide_design import design_wide_grasp
    from multiarm.grasp.wrench_cones import WrenchCone, closes_on_surface, wrench_cone

# Module -> its public names.  Imported when first used.
_HOMES = {
    name: module
    for module, names in {
        "blocks": "BlockDesign block_design design_block_grasp",
        "body_class": "BodyClass Roundness classify roundness",
        "closure_radii": "ClosureRadius closure_radius independence_radius",
        "construction": "design_grasp search_grasp",
        "contacts": "Contacts",
        "face": "Face",
        "face_contacts": "Gripper",
        "force_distribution": "ForceDistribution distribute_forces",
        "form_closure": "FormClosure ManyClosures closed_many is_form_closure",
        "grasp": "Grasp",
        "immobility": "Immobility",
        "independent_contacts": "BlockInverse Independence Violation block_inverse independence "
        "violated_conditions",
        "load_maps": "LiftableMap LoadCapacity WorstForce liftable load_capacity worst_force",
        "object_frame": "FrameCandidate ObjectFrame object_frame_from_contacts "
        "object_frame_from_faces object_frame_on_body",
        "optimisation": "OptimisedGrasp optimise_grasp",
        "parallel_bodies": "ParallelDesign design_parallel_grasp parallel_design",
        "polyhedron": "MassProperties Polyhedron",
        "seventh_contact": "ContactRegion seventh_contact_region",
        "special_selections": "ThreeMoments case_I case_II case_III three_moments",
        "stability": "ConfigurationStability DrawnStability configuration_stability "
        "monte_carlo_stability own_regions",
        "wide_design": "design_wide_grasp",
        "wrench_cones": "WrenchCone closes_on_surface wrench_cone",
    }.items()
    for name in names.split()
}

__all__ = [
    "BlockDesign",
    "BlockInverse",
    "BodyClass",
    "ClosureRadius",
    "ConfigurationStability",
    "ContactRegion",
    "Contacts",
    "DrawnStability",
    "Face",
    "ForceDistribution",
    "FormClosure",
    "FrameCandidate",
    "Grasp",
    "Gripper",
    "Immobility",
    "Independence",
    "LiftableMap",
    "LoadCapacity",
    "ManyClosures",
    "MassProperties",
    "ObjectFrame",
    "OptimisedGrasp",
    "ParallelDesign",
    "Polyhedron",
    "Roundness",
    "ThreeMoments",
    "Violation",
    "WorstForce",
    "WrenchCone",
    "block_design",
    "block_inverse",
    "case_I",
    "case_II",
    "case_III",
    "classify",
    "closed_many",
    "closes_on_surface",
    "closure_radius",
    "configuration_stability",
    "design_block_grasp",
    "design_grasp",
    "design_parallel_grasp",
    "design_wide_grasp",
    "distribute_forces",
    "independence",
    "independence_radius",
    "is_form_closure",
    "liftable",
    "load_capacity",
    "monte_carlo_stability",
    "object_frame_from_contacts",
    "object_frame_from_faces",
    "object_frame_on_body",
    "optimise_grasp",
    "own_regions",
    "parallel_design",
    "roundness",
    "search_grasp",
    "seventh_contact_region",
    "three_moments",
    "violated_conditions",
    "worst_force",
    "wrench_cone",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'multiarm.grasp' has no attribute {name!r}")
    value = getattr(import_module(f"multiarm.grasp.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
