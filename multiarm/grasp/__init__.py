"""Form-closure grasps of polyhedra by frictionless contacts: decide, understand, design.

>>> import multiarm as ma
>>> grasp = ma.grasp.design_block_grasp([1.2, 0.8, 0.6])
>>> grasp.closure.margin, grasp.closure.coefficients
>>> scene = grasp.to_scene(arms=["panda", "panda"], mass=1.0)

See chapter 2 and the appendices A to C of the thesis.  Points are in metres,
in the body's frame; a contact's normal is a unit vector *into* the body.
"""

from __future__ import annotations

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


def __dir__() -> list[str]:
    return list(__all__)
