r"""Usual parameters of each effect, for whoever wonders what it would change.

They are guesses that anybody would make first: what the robots' URDF files say, the object's own
size in air, a floor right below it.  A scene of one's own needs numbers of one's own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from multiarm.scene import Scene, Shape
from multiarm.scene.registry import find_effect, own_effect_names

BLUNT = 1.0
"""Drag coefficient of a blunt body."""
MOTOR_INERTIA = 0.1
"""Of a rotor behind its gear, at the joint [kg m^2, kg]."""
FRICTION = 0.3
"""Coulomb's coefficient, of dry metal."""
LAG = 0.01
"""Time constant of a drive [s]."""


def defaults(scene: Scene) -> dict[str, Any]:
    """Name -> parameters, as a scene has them, of all effects that have usual ones.

    Effects of one's own are among them that have a class attribute ``default``.
    """
    own = {name: getattr(find_effect(name), "default", None) for name in own_effect_names()}
    known = type(scene.effects).model_fields
    found = {name: make(scene) for name, make in _USUAL.items() if name in known}
    return {name: value for name, value in {**found, **own}.items() if value is not None}


def _air(scene: Scene) -> Mapping[str, Any] | None:
    """Drag in air, of a blunt body with the faces of the box around the object."""
    half = _half_size(scene.object.shape)
    if half is None:
        return None
    x, y, z = (2.0 * half).tolist()
    return {"area": [y * z, z * x, x * y], "coefficient": BLUNT}


def _below(scene: Scene) -> Mapping[str, Any] | None:
    """A floor that a box, a hull or a sphere just touches at its start."""
    shape, pose = scene.object.shape, scene.object.pose.matrix()
    if shape.sphere is not None:
        reach = shape.sphere
    elif shape.box is not None:
        reach = float(np.abs(pose[2, :3]) @ (0.5 * np.array(shape.box)))
    elif shape.hull is not None:
        reach = -float(np.min(np.array(shape.hull) @ pose[2, :3]))
    else:
        return None
    return {"at": {"xyz": [0.0, 0.0, float(pose[2, 3]) - reach]}}


def _half_size(shape: Shape) -> np.ndarray | None:
    """Half the edges of the box around the object, in its axes, shape (3,) [m]; None for a mesh."""
    if shape.box is not None:
        return 0.5 * np.array(shape.box)
    if shape.sphere is not None:
        return np.full(3, shape.sphere)
    if shape.hull is not None:
        return np.max(np.abs(np.array(shape.hull)), axis=0)
    if shape.cylinder is not None:
        return np.array([shape.cylinder.radius] * 2 + [0.5 * shape.cylinder.height])
    return None


_USUAL: dict[str, Callable[[Scene], Any]] = {
    "joint_damping": lambda _: "urdf",
    "joint_friction": lambda _: "urdf",
    "rotor_inertia": lambda _: MOTOR_INERTIA,
    "torque_limits": lambda _: "urdf",
    "actuator_lag": lambda _: LAG,
    "drag": _air,
    "unilateral_contacts": lambda _: {},
    "contact_friction": lambda _: FRICTION,
    "joint_limits": lambda _: "urdf",
    "floor": _below,
}
# Wrenches from outside have no usual parameters.
