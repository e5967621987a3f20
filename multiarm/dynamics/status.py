"""Status codes of compiled code, each in one place.

Kernels return them as plain integers, which have the names below.  Which block, control law or
effect failed is in :class:`multiarm.dynamics.variables.Status`.
"""

from __future__ import annotations

from enum import IntEnum


class StatusCode(IntEnum):
    """What a kernel returns."""

    OK = 0
    # of an evaluation
    CALLBACK_FAILED = -2  # a Python function raised an exception
    PROJECTION_FAILED = -3
    NOT_FINITE = -4
    CONTRADICTION = -5  # no acceleration meets all constraints
    DEFICIENT = -6  # a block has a pivot too small for the plain elimination
    SINGULAR = -7  # a matrix of the derivatives
    BLOCK_INERTIA = -8  # that of a block is not positive definite
    BLOCK_NOT_FINITE = -9  # numbers of a block
    OBJECT_INERTIA = -10  # the object's, or its node matrix, is not positive definite
    KERNEL_FAILED = -11  # a control law or an effect returned an answer of its own
    # why the time loop returned
    FINISHED = -20
    BLOCK_FULL = -21
    BUDGET_USED = -22
    STEP_TOO_SMALL = -23
    DIVERGED = -24
    SOLVER_CHANGED = -25
    LARGE_CORRECTION = -26
    STIFF = -27
    NOT_CONVERGED = -28  # the equations of an implicit step
    EVENT = -29  # lies within the step just made, which was not accepted
    STOPPED = -30  # the run reached its stop
    GUARD_FIRED = -31  # one that only reports, in the step just made


# Numba reads them as constants.
OK = int(StatusCode.OK)
CALLBACK_FAILED = int(StatusCode.CALLBACK_FAILED)
PROJECTION_FAILED = int(StatusCode.PROJECTION_FAILED)
NOT_FINITE = int(StatusCode.NOT_FINITE)
CONTRADICTION = int(StatusCode.CONTRADICTION)
DEFICIENT = int(StatusCode.DEFICIENT)
SINGULAR = int(StatusCode.SINGULAR)
BLOCK_INERTIA = int(StatusCode.BLOCK_INERTIA)
BLOCK_NOT_FINITE = int(StatusCode.BLOCK_NOT_FINITE)
OBJECT_INERTIA = int(StatusCode.OBJECT_INERTIA)
KERNEL_FAILED = int(StatusCode.KERNEL_FAILED)
FINISHED = int(StatusCode.FINISHED)
BLOCK_FULL = int(StatusCode.BLOCK_FULL)
BUDGET_USED = int(StatusCode.BUDGET_USED)
STEP_TOO_SMALL = int(StatusCode.STEP_TOO_SMALL)
DIVERGED = int(StatusCode.DIVERGED)
SOLVER_CHANGED = int(StatusCode.SOLVER_CHANGED)
LARGE_CORRECTION = int(StatusCode.LARGE_CORRECTION)
STIFF = int(StatusCode.STIFF)
NOT_CONVERGED = int(StatusCode.NOT_CONVERGED)
EVENT = int(StatusCode.EVENT)
STOPPED = int(StatusCode.STOPPED)
GUARD_FIRED = int(StatusCode.GUARD_FIRED)
