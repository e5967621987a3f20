"""Form-closure grasps of polyhedra by frictionless contacts: decide, understand, design.

>>> import multiarm as ma
>>> grasp = ma.grasp.design_block_grasp([1.2, 0.8, 0.6])
>>> grasp.closure.margin, grasp.closure.coefficients
>>> scene = grasp.to_scene(arms=["panda", "panda"])

One question a file; see chapter 2 and the appendices A to C of the thesis.  Points are in metres,
in the body's frame; a contact's normal is a unit vector *into* the body.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiarm.grasp.blocks import BlockDesign, block_design, design_block_grasp
    from multiarm.grasp.body_class import BodyClass, Roundness, classify, roundness
    from multiarm.grasp.closure_radii import ClosureRadius, closure_radius, independence_radius
    from multiarm.grasp.closure_search import search_grasp
    from multiarm.grasp.construction import design_grasp
    from multiarm.grasp.contacts import Contacts
    from multiarm.grasp.drawn_stability import DrawnStability, monte_carlo_stability
    from multiarm.grasp.face import Face
    from multiarm.grasp.face_contacts import Gripper
    from multiarm.grasp.force_distribution import ForceDistribution, distribute_forces
    from multiarm.grasp.form_closure import FormClosure, is_form_closure
    from multiarm.grasp.grasp import Grasp
    from multiarm.grasp.immobility import Immobility
    from multiarm.grasp.independent_contacts import (
        BlockInverse,
        Independence,
        block_inverse,
        independence,
    )
    from multiarm.grasp.liftable_map import LiftableMap
    from multiarm.grasp.load_maps import (
        LoadCapacity,
        WorstForce,
        liftable,
        load_capacity,
        worst_force,
    )
    from multiarm.grasp.many_closures import ManyClosures, closed_many
    from multiarm.grasp.moment_rules import ThreeMoments, three_moments
    from multiarm.grasp.necessary_conditions import Violation, violated_conditions
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
    from multiarm.grasp.special_selections import case_I, case_II, case_III
    from multiarm.grasp.stability import (
        ConfigurationStability,
        configuration_stability,
        own_regions,
    )
    from multiarm.grasp.wide_design import design_wide_grasp
    from multiarm.grasp.wrench_cones import WrenchCone, closes_on_surface, wrench_cone

# Public name -> module of this package that has it.  Imported when first used.
_HOMES = {
    "BlockDesign": "blocks",
    "BlockInverse": "independent_contacts",
    "BodyClass": "body_class",
    "ClosureRadius": "closure_radii",
    "ConfigurationStability": "stability",
    "ContactRegion": "seventh_contact",
    "Contacts": "contacts",
    "DrawnStability": "drawn_stability",
    "Face": "face",
    "ForceDistribution": "force_distribution",
    "FormClosure": "form_closure",
    "FrameCandidate": "object_frame",
    "Grasp": "grasp",
    "Gripper": "face_contacts",
    "Immobility": "immobility",
    "Independence": "independent_contacts",
    "LiftableMap": "liftable_map",
    "LoadCapacity": "load_maps",
    "ManyClosures": "many_closures",
    "MassProperties": "polyhedron",
    "ObjectFrame": "object_frame",
    "OptimisedGrasp": "optimisation",
    "ParallelDesign": "parallel_bodies",
    "Polyhedron": "polyhedron",
    "Roundness": "body_class",
    "ThreeMoments": "moment_rules",
    "Violation": "necessary_conditions",
    "WorstForce": "load_maps",
    "WrenchCone": "wrench_cones",
    "block_design": "blocks",
    "block_inverse": "independent_contacts",
    "case_I": "special_selections",
    "case_II": "special_selections",
    "case_III": "special_selections",
    "classify": "body_class",
    "closed_many": "many_closures",
    "closes_on_surface": "wrench_cones",
    "closure_radius": "closure_radii",
    "configuration_stability": "stability",
    "design_block_grasp": "blocks",
    "design_grasp": "construction",
    "design_parallel_grasp": "parallel_bodies",
    "design_wide_grasp": "wide_design",
    "distribute_forces": "force_distribution",
    "independence": "independent_contacts",
    "independence_radius": "closure_radii",
    "is_form_closure": "form_closure",
    "liftable": "load_maps",
    "load_capacity": "load_maps",
    "monte_carlo_stability": "drawn_stability",
    "object_frame_from_contacts": "object_frame",
    "object_frame_from_faces": "object_frame",
    "object_frame_on_body": "object_frame",
    "optimise_grasp": "optimisation",
    "own_regions": "stability",
    "parallel_design": "parallel_bodies",
    "roundness": "body_class",
    "search_grasp": "closure_search",
    "seventh_contact_region": "seventh_contact",
    "three_moments": "moment_rules",
    "violated_conditions": "necessary_conditions",
    "worst_force": "load_maps",
    "wrench_cone": "wrench_cones",
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
    return sorted([*globals(), *_HOMES])
