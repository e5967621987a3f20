"""What all parts of a scene share: frozen, strict about keys, and honest about faults.

A part built in Python (``Pose(xyz=[0, 0, 1])``) is validated by the same rules as one read from
YAML, and refuses with the same :class:`~multiarm.errors.SceneError`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)
from typing_extensions import Self

from multiarm.errors import SceneError
from multiarm.scene.faults import explain
from multiarm.scene.values import Vec3, Vec4, fault

__all__ = ["Pose", "Spec", "absolute"]


class Spec(BaseModel):
    """Base of all parts of a scene."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)

    def __init__(self, /, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise SceneError(explain(error, type(self), type(self).__name__)) from None

    # Pydantic calls a foreign __init__ for nested parts too, where the first fault would end the
    # search for others; this mark says that ours adds nothing but the wording.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """Validate a mapping (or an instance), refusing with a SceneError."""
        try:
            return super().model_validate(obj, **options)
        except ValidationError as error:
            raise SceneError(explain(error, cls, cls.__name__)) from None

    @model_serializer(mode="wrap")
    def _kind_is_always_written(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data = handler(self)
        kind = getattr(self, "kind", None)
        return data if kind is None else {"kind": kind, **data}


def absolute(path: Path, folder: Path) -> Path:
    """Return ``path`` as an absolute path, below ``folder`` if it is relative."""
    return (folder / path.expanduser()).resolve()


class Pose(Spec):
    """A placement: where a frame's origin is and how its axes are turned.

    Attributes
    ----------
    xyz : 3 numbers
        Origin [m] in the parent frame.
    rpy : 3 numbers
        Roll, pitch, yaw [rad] about the fixed axes x, y, z in that order, as in URDF:
        R = Rz(yaw) Ry(pitch) Rx(roll).
    quaternion_xyzw : 4 numbers, optional
        Orientation as a quaternion, scalar last, instead of ``rpy``. Any length but zero.
    """

    xyz: Vec3 = (0.0, 0.0, 0.0)
    rpy: Vec3 = (0.0, 0.0, 0.0)
    quaternion_xyzw: Vec4 | None = None

    @model_validator(mode="after")
    def _one_orientation(self) -> Self:
        if self.quaternion_xyzw is None:
            return self
        if any(self.rpy):
            raise fault("gives both 'rpy' and 'quaternion_xyzw'; keep one of them")
        if not np.linalg.norm(self.quaternion_xyzw) > 1e-12:
            raise fault("'quaternion_xyzw' has length zero; the identity is [0, 0, 0, 1]")
        return self

    def rotation(self) -> np.ndarray:
        """Return the rotation matrix, shape (3, 3): child components to parent components."""
        if self.quaternion_xyzw is not None:
            return _rotation_of_quaternion(np.array(self.quaternion_xyzw))
        (cr, cp, cy), (sr, sp, sy) = np.cos(self.rpy), np.sin(self.rpy)
        return np.array(
            [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ]
        )

    def matrix(self) -> np.ndarray:
        """Return the homogeneous transform, shape (4, 4): child coordinates to parent ones."""
        X = np.eye(4)
        X[:3, :3] = self.rotation()
        X[:3, 3] = self.xyz
        return X


def _rotation_of_quaternion(quaternion_xyzw: np.ndarray) -> np.ndarray:
    x, y, z, w = quaternion_xyzw / np.linalg.norm(quaternion_xyzw)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
