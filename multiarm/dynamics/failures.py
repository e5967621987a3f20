"""What a failure of compiled code means, in words, and the exception that says so."""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.connections import Connection
from multiarm.dynamics.data import Data
from multiarm.dynamics.model import Model
from multiarm.dynamics.status import (
    BLOCK_INERTIA,
    BLOCK_NOT_FINITE,
    CONTRADICTION,
    KERNEL_FAILED,
    NOT_FINITE,
    OBJECT_INERTIA,
    OK,
    PROJECTION_FAILED,
    SINGULAR,
)
from multiarm.errors import SolverError
from multiarm.jit.pointers import is_at
from multiarm.scene.values import of_surroundings


def require_ok(data: Data, status: int) -> None:
    """Raise what a status of compiled code stands for; nothing for ``OK``.

    Raises
    ------
    MultiarmError
        Of a Python function that was called: its own exception.
    SolverError
        Of any other failure.
    """
    if status == OK:
        return
    data.reraise()
    raise SolverError(failure_text(data, status))


def failure_text(data: Data, status: int) -> str:
    """What a status of the compiled code means, and what to do."""
    lost = lost_contact_text(data)
    if lost:
        return lost
    if status == BLOCK_INERTIA:
        return inertia_text(data.model, data.arrays.status.block)
    if status == BLOCK_NOT_FINITE:
        return (
            f"numbers of {block_text(data.model, data.arrays.status.block)} are not finite; take "
            f"smaller steps, or check its URDF and the controller"
        )
    if status == OBJECT_INERTIA:
        return (
            "the node matrix of the objects is not positive definite; check their mass and "
            "inertia and that all numbers of the state are finite"
        )
    if status == PROJECTION_FAILED:
        return (
            "the state could not be projected back onto the joints; take smaller steps (a smaller "
            "`accuracy` or `step`), or look for a motion that the joints cannot follow"
        )
    if status == CONTRADICTION:
        return contradiction_text(data)
    if status == NOT_FINITE:
        return "the state is not finite; take smaller steps, or check the controller"
    if status == SINGULAR:
        return (
            "the equations have no derivatives at this state: a matrix in them, or of a control "
            "law, is singular; take a state beside it"
        )
    if status == KERNEL_FAILED:
        return _kernel_text(data)
    return f"the evaluation failed (status {status})"


def inertia_text(model: Model, block: int) -> str:
    """Why the inertia matrix of a block has no factors, and what to do."""
    robots, base = model.layout.robots_of_block(block), ""
    files = [model.robots[robot].files for robot in robots]
    if any(of_robot.base_joints or of_robot.base_floats for of_robot in files):
        base = ", or give the base its own with `base: {mass: ..., inertia: ...}`"
    return (
        f"the inertia matrix of {block_text(model, block)} is not positive definite: a joint moves "
        f"links without mass or inertia; give them some in the URDF, or lock the joint{base}"
    )


def is_tip_of_arm(pair: Connection) -> bool:
    """Whether a connection is that of an arm, which has one tip, with the object."""
    return pair.on_object and pair.first.is_link and not pair.first.tip


def owner_of(model: Model, name: str) -> str:
    """An owner of rows, or a robot, in words: ``arm 'left'``, ``connection 'cart/left'``."""
    if of_surroundings(name):
        return "the floor"
    if name in model.connections:
        noun = "arm" if is_tip_of_arm(model.connections[name]) else "connection"
        return f"{noun} '{name}'"
    return model.robots[name].text


def block_text(model: Model, block: int) -> str:
    """A block in words: its robots; of the surroundings the owners of their rows."""
    robots = model.layout.robots_of_block(block)
    return " and ".join(owner_of(model, name) for name in robots or [model.blocks[block]])


def joint_of(model: Model, connection: str) -> str:
    """The joint of a connection in words: ``the joint of arm 'left'``, ``joint 'cart/left'``."""
    return joint_text(model.connections[connection])


def joint_text(pair: Connection) -> str:
    """:func:`joint_of` for a connection."""
    if is_tip_of_arm(pair):
        return f"the joint of arm '{pair.name}'"
    return f"joint '{pair.name}'"


def _kernel_text(data: Data) -> str:
    """Which control law or effect returned which answer of its own."""
    model, status = data.model, data.arrays.status
    for law in model.laws:
        if is_at(law.kernel, status.kernel) and status.answer in law.answers:
            return law.answers[status.answer]
    kernels = [("effect", k) for e in model.effects.kernels for k in (e.kernel, e.derivative)]
    for law in model.laws:
        of_law = law.kernel, law.derivative, law.share_derivative
        kernels += [("control law", kernel) for kernel in of_law]
    names = (
        f"the {kind} `{kernel.py_func.__name__}`"
        for kind, kernel in kernels
        if kernel is not None and is_at(kernel, status.kernel)
    )
    return (
        f"{next(names, 'a kernel')} returned {status.answer}; a kernel returns 0 when it succeeds: "
        f"look there for what this number stands for"
    )


def contradiction_text(data: Data) -> str:
    """Why the last solution does not satisfy the equations."""
    residual = float(data.arrays.solution.residual)
    if data.arrays.solution.imbalance >= residual:
        return (
            f"the contact forces do not balance the object (relative residual {residual:.2g}): "
            f"rounding errors are too large next to a posture in which arms cannot move; start "
            f"elsewhere, or use `solver: dense`"
        )
    return (
        f"no acceleration meets all constraints (relative residual {residual:.2g}): some of them "
        f"contradict each other, or the chains are in a singular posture with a velocity that none "
        f"of their further motions has, and the motion is undetermined; take smaller steps, start "
        f"elsewhere, or remove redundant contacts"
    )


def ambiguity_text(data: Data) -> str:
    """That the last solution is one of several; empty where it is the only one."""
    if data.arrays.solution.motion_unique:
        return ""
    owners = zip(data.model.blocks, data.arrays.deficient.undetermined, strict=True)
    arms = ", ".join(dict.fromkeys(owner for owner, undetermined in owners if undetermined))
    return (
        "friction leaves the motion open: other accelerations meet the equations, too, with other "
        f"contact forces of {arms}; these are those of the least contact forces"
    )


def lost_contact_text(data: Data) -> str:
    """Message when a contact has no normal at the state in the data; else empty."""
    b = data.arrays
    lost = np.flatnonzero(~np.isfinite(b.rows.kinematics).all(axis=1))
    if not lost.size or not (
        np.isfinite(b.state.poses).all() and np.isfinite(b.state.joint_positions).all()
    ):
        return ""
    return (
        f"{lost_contact(data, int(lost[0]))}; look where the motion takes it, take smaller steps, "
        f"or choose a larger surface"
    )


def lost_contact(data: Data, row: int) -> str:
    """Message that a contact has no normal."""
    owner, contact = data.model.owner(row)
    return (
        f"contact '{contact.name}' of {owner_of(data.model, owner)} has no normal where it is: an "
        f"axis, a centre, an apex or the end of a surface was reached, or two surfaces lost each "
        "other"
    )
