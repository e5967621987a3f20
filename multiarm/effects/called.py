"""Forces that a Python function computes at every evaluation.

What it returns, a wrench on the object and torques of the joints, is checked and added by a kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.effect_kernels import APPLIED, POWER, Arrays, EffectKernel
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import Layout, State
from multiarm.dynamics.user_callback import UserCallback
from multiarm.effects.effect import Loads
from multiarm.errors import ControlError
from multiarm.jit.kernels import cfunc
from multiarm.jit.pointers import call_python
from multiarm.jit.structs import floats1, ints1, struct_at


@cfunc
def add_called_loads(address, size, at, _t):
    """Own arrays: address of the function, and what it answers: wrench, then torques."""
    struct = struct_at(address, size)
    _, data, _ = open_system(struct)
    slots, function = ints1(struct, int(at)), ints1(struct, int(at) + 1)
    loads, power = floats1(struct, int(at) + 2), 0.0
    if data.status.failed:
        return 0  # another function failed
    call_python(function[0])
    for k in range(6):
        data.h_o[k] += loads[k]
        power += loads[k] * data.twist[k]
    for j in range(data.h.size):
        data.h[j] += loads[6 + j]
        power += loads[6 + j] * data.v[j]
    data.power[slots[POWER]] = power
    return 0


def called_kernel(
    name: str, make: Callable[[], Callable[[float, State], Loads]], layout: Layout
) -> EffectKernel:
    """The kernel of an effect whose forces a Python function computes.

    ``make`` gives the function; it is called for every Data.
    """
    address, loads = np.zeros(1, dtype=np.int64), np.zeros(6 + layout.joints)

    def connect(data: Data, arrays: Arrays) -> dict[str, UserCallback]:
        def read(answer: object, t: float) -> np.ndarray:
            return _stacked(name, answer, layout, t)

        own_address, own_loads = arrays
        who, variables = f"the effect {name!r}", data.arrays
        call = UserCallback(make(), who, read, own_loads, layout, variables, owner=make)
        own_address[0] = call.address
        return {f"effects/{name}": call}

    return EffectKernel(
        name, add_called_loads, APPLIED, (address, loads), connect=connect, calls_user=True
    )


def _stacked(name: str, found: object, layout: Layout, t: float) -> np.ndarray:
    """Wrench and torques of all joints, shape (6 + n,)."""
    who = f"the effect {name!r}"
    if not isinstance(found, Loads):
        raise ControlError(f"{who} returned {type(found).__name__}; return multiarm.Loads(...)")
    loads = np.zeros(6 + layout.joints)
    loads[:6] = _numbers(f"{who}: object_wrench", found.object_wrench, 6, t)
    if not isinstance(found.joint_torques, Mapping):
        raise ControlError(f"{who}: joint_torques must be a dict arm -> torques")
    views = layout.split_joints(loads[6:])
    for arm, torques in found.joint_torques.items():
        if arm not in views:
            raise ControlError(
                f"{who}: joint_torques names an unknown arm {arm!r}; arms are {', '.join(views)}"
            )
        views[arm][:] = _numbers(f"{who}: joint_torques[{arm!r}]", torques, views[arm].size, t)
    return loads


def _numbers(what: str, values: object, size: int, t: float) -> np.ndarray:
    """A vector of the right size of finite numbers, or an error that says ``what``."""
    try:
        vector = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ControlError(f"{what} must be {size} numbers, got {values!r}") from None
    if vector.shape != (size,):
        raise ControlError(f"{what} must have shape ({size},), got {vector.shape}")
    if not np.all(np.isfinite(vector)):
        raise ControlError(f"{what} is not finite at t = {t:.6g} s: {vector.tolist()}")
    return vector
