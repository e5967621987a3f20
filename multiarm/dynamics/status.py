"""Status codes of compiled code, each in one place.

Kernels return them as plain integers, which have the names below; numbers from 0 on are those of
the arm whose elimination failed (the number of arms: the object's).
"""

from __future__ import annotations

from enum import IntEnum


class StatusCode(IntEnum):
    """What a kernel returns."""

    OK = -1
    # of an evaluation
    CALLBACK_FAILED = -2  # a Python function raised an exception
    PROJECTION_FAILED = -3
    NOT_FINITE = -4
    CONTRADICTION = -5  # no acceleration meets all constraints
    DEFICIENT = -6  # an arm has a pivot too small for the plain elimination
    SINGULAR = -7  # a matrix of the derivatives
    # why the time loop returned
    FINISHED = -10
    BLOCK_FULL = -11
    BUDGET_USED = -12
    STEP_TOO_SMALL = -13
    DIVERGED = -14
    SOLVER_CHANGED = -15
    LARGE_CORRECTION = -16
    STIFF = -17
    NOT_CONVERGED = -18  # the equations of an implicit step
    EVENT = -19  # lies within the step just made, which was not accepted
    STOPPED = -20  # the run reached its stop
    GUARD_FIRED = -21  # one that only reports, in the step just made


# Numba reads them as constants.
OK = int(StatusCode.OK)
CALLBACK_FAILED = int(StatusCode.CALLBACK_FAILED)
PROJECTION_FAILED = int(StatusCode.PROJECTION_FAILED)
NOT_FINITE = int(StatusCode.NOT_FINITE)
CONTRADICTION = int(StatusCode.CONTRADICTION)
DEFICIENT = int(StatusCode.DEFICIENT)
SINGULAR = int(StatusCode.SINGULAR)
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
