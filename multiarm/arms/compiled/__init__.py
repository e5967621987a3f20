"""Batched RNEA and CRBA of serial arms in compiled code.

An arm's structure (:meth:`multiarm.arms.arm.Arm.structure`) is packed into tables
(:mod:`.tables`), which the kernels (:mod:`.kernels`, :mod:`.coriolis`) read for all arms of all
scenes, four arms in one SIMD pack.  Nothing is compiled for a scene.  Arms that no table describes
stay with Pinocchio.
"""
