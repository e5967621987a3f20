"""Compiled copies of the arms: what Pinocchio would compute, without leaving compiled code.

An arm's structure (:meth:`multiarm.arms.arm.Arm.structure`) is packed into tables
(:mod:`.tables`), which one kernel reads for all arms of all scenes (:mod:`.sweep`): four arms at a
time, one in each lane of the processor's vector registers (:mod:`multiarm.jit.simd`).  Nothing is
compiled for a scene.  Before a copy is used it is compared with Pinocchio (:mod:`.verification`);
arms that no table describes stay there (:mod:`.choice`).
"""
