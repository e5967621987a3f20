"""Batched RNEA and CRBA of robots in compiled code.

A robot's structure (:meth:`multiarm.robots.robot.Robot.structure`) is divided into
branches (:mod:`.branches`), and packed into tables (:mod:`.tables`, :mod:`.packing`), which the
kernels (:mod:`.kernels`, :mod:`.coriolis`) read for all robots of all scenes, four branches in one
SIMD pack.  Nothing is compiled for a scene.  Robots that no table describes stay with Pinocchio.
"""
