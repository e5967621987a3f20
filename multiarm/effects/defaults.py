r"""Typical parameters of each effect, to estimate its influence on a scene.

They are first guesses: the values of the robots' URDF files, air drag of the object's size, a floor
just below the object.  They do not replace measured parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from multiarm.scene import EFFECTS, Scene, Shape


def defaults(scene: Scene) -> dict[str, Any]:
    """Name -> parameters, as in a scene, of all effects that have typical ones.

    Of user-defined effects, those with a class attribute ``default``.
    """
    own = {name: getattr(EFFECTS.find(name), "default", None) for name in EFFECTS.names()}
    known = type(scene.effects).model_fields
    found = {name: make(scene) for name, make in _TYPICAL.items() if name in known}
    return {name: value for name, value in {**found, **own}.items() if value is not None}


def _air(scene: Scene) -> Mapping[str, Any] | None:
    """Drag in air, of a blunt body with the faces of the box around the object."""
    half = _half_size(scene.object.shape)
    if half is None:
        return None
    x, y, z = (2.0 * half).tolist()
    return {"area": [y * z, z * x, x * y], "coefficient": 1.0}


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


_TYPICAL: dict[str, Callable[[Scene], Any]] = {
    "joint_damping": lambda _: "urdf",
    "joint_friction": lambda _: "urdf",
    "rotor_inertia": lambda _: 0.1,  # at the joint [kg m^2, kg]
    "torque_limits": lambda _: "urdf",
    "actuator_lag": lambda _: 0.01,  # time constant of a drive [s]
    "drag": _air,
    "unilateral_contacts": lambda _: {},
    "contact_friction": lambda _: 0.3,  # Coulomb's coefficient of dry metal
    "joint_limits": lambda _: "urdf",
    "floor": _below,
}
# External wrenches have no typical parameters.
