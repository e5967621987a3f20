"""Form-closure grasps of polyhedra by frictionless contacts: decide, understand, design.

>>> import multiarm as ma
>>> grasp = ma.grasp.design_block_grasp([1.2, 0.8, 0.6])
>>> grasp.closure.margin, grasp.closure.coefficients
>>> scene = grasp.to_scene(arms=["panda", "panda"], mass=1.0)

The packages follow chapter 2 of the thesis and its appendices A and B (C is in
:mod:`multiarm.geometry.screws`):

===================  ========================================================  ==================
package              content                                                   thesis
===================  ========================================================  ==================
``contacts``         points, normals and wrenches of contacts                  2.1
``closure``          form closure with its proof, immobility to second order   2.1
``six_contacts``     independent wrenches, conditions, special selections      2.2, 2.2.1, A.2-A.5
``seventh_contact``  where one more contact closes, by two routes              2.2.2, A.6
``body``             polyhedra, their faces and classes                        2.2.3, A.7
``designs``          constructions for blocks, parallel faces, wider class     2.2.3
``stability``        displacements that a grasp bears                          2.3
``pose``             the body's frame from the fingertips                      2.4, B
``forces``           forces that exert a wrench, loads that they carry         3.4
``optimisation``     the placement with the largest margin, and a bound        5.1
``pickup``           picking a body up from the floor by tilting it            open there
``scenes``           a grasp as a scene with arms, the grasp in a scene
===================  ========================================================  ==================

Points are in metres, in the body's frame; a contact's normal is a unit vector *into* the body.
"""

from __future__ import annotations

from multiarm.grasp.body.body_class import BodyClass, Roundness, classify, roundness
from multiarm.grasp.body.face import Face
from multiarm.grasp.body.polyhedron import MassProperties, Polyhedron
from multiarm.grasp.closure.form_closure import (
    FormClosure,
    ManyClosures,
    closed_many,
    is_form_closure,
)
from multiarm.grasp.closure.immobility import Immobility
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.designs.blocks import BlockDesign, block_design, design_block_grasp
from multiarm.grasp.designs.construction import design_grasp
from multiarm.grasp.designs.drawn_contacts import search_grasp
from multiarm.grasp.designs.parallel_bodies import (
    ParallelDesign,
    design_parallel_grasp,
    parallel_design,
)
from multiarm.grasp.designs.wide_bodies import design_wide_grasp
from multiarm.grasp.face_contacts import Gripper
from multiarm.grasp.forces.force_distribution import ForceDistribution, distribute_forces
from multiarm.grasp.forces.load_maps import (
    LiftableMap,
    LoadCapacity,
    WorstForce,
    liftable,
    load_capacity,
    worst_force,
)
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.optimisation.optimisation import OptimisedGrasp, optimise_grasp
from multiarm.grasp.pickup.lying_body import LyingBody, PivotEdge
from multiarm.grasp.pickup.phases import PickupError, PickupPhase, PickupRefusal
from multiarm.grasp.pickup.plan import PickupPlan
from multiarm.grasp.pickup.planning import plan_pickup
from multiarm.grasp.pose.object_frame import (
    FrameCandidate,
    ObjectFrame,
    object_frame_from_contacts,
    object_frame_from_faces,
    object_frame_on_body,
)
from multiarm.grasp.seventh_contact.contact_region import ContactRegion, seventh_contact_region
from multiarm.grasp.seventh_contact.wrench_cones import WrenchCone, closes_on_surface, wrench_cone
from multiarm.grasp.six_contacts.independent_contacts import (
    BlockInverse,
    Independence,
    block_inverse,
    independence,
)
from multiarm.grasp.six_contacts.necessary_conditions import Violation, violated_conditions
from multiarm.grasp.six_contacts.special_selections import (
    ThreeMoments,
    case_I,
    case_II,
    case_III,
    three_moments,
)
from multiarm.grasp.stability.closure_radii import (
    ClosureRadius,
    closure_radius,
    independence_radius,
)
from multiarm.grasp.stability.configuration_stability import (
    ConfigurationStability,
    DrawnStability,
    configuration_stability,
    monte_carlo_stability,
    own_regions,
)

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
    "LyingBody",
    "ManyClosures",
    "MassProperties",
    "ObjectFrame",
    "OptimisedGrasp",
    "ParallelDesign",
    "PickupError",
    "PickupPhase",
    "PickupPlan",
    "PickupRefusal",
    "PivotEdge",
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
    "plan_pickup",
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
