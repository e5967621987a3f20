r"""Where a joint is between its limits, along and about its axis.

With the joint's frames on the object and on the arm's tip, which coincide at the start and whose z
axes are the joint's axis, ``X = F_object^-1 F_tip`` is a screw about z: its translation is the
slide, its rotation the turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from multiarm.cli.guide.motions import MOTIONS

if TYPE_CHECKING:
    from multiarm.scene import JointBase

__all__ = ["Limit", "axis_travel", "limits_of"]


@dataclass(frozen=True)
class Limit:
    """The limits of one coordinate, 0 where the joint's two frames coincide.

    Attributes
    ----------
    component : int
        Place in :data:`multiarm.cli.guide.motions.MOTIONS`: a slide along the axis, or a turn about
        it.
    low, high : float
        [m] or [rad].
    """

    component: int
    low: float
    high: float

    @property
    def turns(self) -> bool:
        """Whether the coordinate is an angle."""
        return self.component >= 3

    @property
    def motion(self) -> str:
        """What the coordinate counts, in words."""
        return MOTIONS[self.component]

    @property
    def unit(self) -> str:
        """The unit of the coordinate: rad or m."""
        return "rad" if self.turns else "m"


def limits_of(joint: JointBase) -> tuple[Limit, ...]:
    """The limits of a scene's joint: none, or one for each coordinate that has them."""
    return tuple(Limit(component, *ends) for component, ends in joint.free_limits.items())


def axis_travel(on_object: np.ndarray, on_tip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn about and slide along the z axis of a joint's frames through K instants.

    Parameters
    ----------
    on_object, on_tip : ndarray, shape (K, 4, 4)
        World poses of the joint's frame on the object and of that on the tip.

    Returns
    -------
    turn, slide : ndarray, shape (K,)
        [rad], continuous from instant to instant, the first within half a turn of 0; [m].
    """
    R, p = on_object[:, :3, :3], on_object[:, :3, 3]
    slide = np.einsum("ki,ki->k", R[..., 2], on_tip[:, :3, 3] - p)
    x_tip = on_tip[:, :3, 0]
    along_x, along_y = (np.einsum("ki,ki->k", R[..., j], x_tip) for j in (0, 1))
    return np.unwrap(np.arctan2(along_y, along_x)), slide
