r"""How much of their limits the joints use in a run.

The shares of a joint with the effort limit :math:`\hat\tau`, the speed limit :math:`\hat v` and the
range :math:`[q_-, q_+]` are

.. math::
    \frac{|\tau|}{\hat\tau}, \qquad \frac{|v|}{\hat v}, \qquad
    \frac{|q - (q_- + q_+) / 2|}{(q_+ - q_-) / 2},

each 1 at its limit and more beyond it. :math:`\tau` is the torque (force, if the joint slides) of
the drive: what the control commands, within the limits and the lag of the drives if the scene has
any. Friction and contacts are no part of it. The limits are those of the robot's file, whether or
not the scene enforces them; an effort or a speed of 0 there means that none is known. Shares are
taken at the stored samples: a peak between two of them is not seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from multiarm.errors import TrajectoryError
from multiarm.results.channels import arm_channel
from multiarm.results.recorded_run import RecordedRun

LIMITS = "joint_limits"
"""Entry of a run's provenance: arm -> limits of its joints, see :func:`limits_record`."""
_CHANNELS = {"effort": "joint_torque", "speed": "joint_velocity", "range": "joint_position"}
QUANTITIES = tuple(_CHANNELS)
"""What a joint has limits of."""
ROUNDED_SHARE = 1e-6
"""A share beyond 1 by less is at the limit: drives cut off there, and joints stop there."""
_REMEDIES = {
    "effort": "take a lighter object, a slower motion or a stronger robot, or let the drives give "
    "no more than they can (`effects: {torque_limits: urdf}`)",
    "speed": "take a slower motion, another posture or a faster robot",
    "range": "take another posture or base, or let the joint stop there "
    "(`effects: {joint_limits: urdf}`)",
}


@dataclass(frozen=True)
class Share:
    """The largest share of a limit, 1 at the limit, and when."""

    value: float
    time: float  # [s]


@dataclass(frozen=True)
class JointUse:
    """What a joint uses of its limits; None where the robot's file names none."""

    joint: str  # arm/joint
    effort: Share | None
    speed: Share | None
    range: Share | None

    def row(self) -> dict[str, str | float | None]:
        """The columns of `Trajectory.limit_use`."""
        shares = {quantity: getattr(self, quantity) for quantity in QUANTITIES}
        return {
            "joint": self.joint,
            **{name: None if share is None else share.value for name, share in shares.items()},
            **{
                f"{name}_time": None if share is None else share.time
                for name, share in shares.items()
            },
        }


@dataclass(frozen=True)
class Peak:
    """The joint that uses most of a limit."""

    joint: str  # arm/joint
    quantity: str  # one of QUANTITIES
    share: float  # 1 at the limit
    time: float  # [s]
    beyond: int  # joints beyond 100 %

    @property
    def warning(self) -> str:
        """What is beyond the limit, and the remedy; empty within it."""
        if not self.beyond:
            return ""
        also = f" ({self.beyond} joints are beyond 100 %)" if self.beyond > 1 else ""
        return (
            f"{self.joint} uses {percent(self.share)} of its {self.quantity} limit "
            f"at t = {self.time:.3g} s{also}, which the robot cannot do: "
            f"{_REMEDIES[self.quantity]}"
        )


def limits_record(
    efforts: np.ndarray, speeds: np.ndarray, ranges: np.ndarray
) -> dict[str, list[Any]]:
    """Limits of an arm's joints as a run stores them: (n,), (n,), (n, 2); infinite where none."""
    return {"effort": efforts.tolist(), "speed": speeds.tolist(), "range": ranges.tolist()}


def joint_uses(run: RecordedRun) -> list[JointUse]:
    """The use of the limits by each joint of a run, in the order of the arms, base to tip.

    Raises
    ------
    TrajectoryError
        The limits that are stored with the run cannot be read.
    """
    limits, channels = run.provenance.get(LIMITS, {}), run.channels
    uses = []
    for arm in run.arm_names:
        names = {quantity: arm_channel(arm, channel) for quantity, channel in _CHANNELS.items()}
        joints = next((channels[n].column_labels for n in names.values() if n in channels), ())
        shares = [
            _largest(run, name, _bounds(limits, arm, quantity, len(joints)))
            if name in channels
            else [None] * len(joints)
            for quantity, name in names.items()
        ]
        uses += [
            JointUse(f"{arm}/{joint}", *of_joint)
            for joint, *of_joint in zip(joints, *shares, strict=True)
        ]
    return uses


def peaks(uses: Sequence[JointUse]) -> dict[str, Peak | None]:
    """Of effort, speed and range, the joint that uses most; None where no limit is known."""
    largest: dict[str, Peak | None] = {}
    for quantity in QUANTITIES:
        shares = {use.joint: getattr(use, quantity) for use in uses}
        known = {joint: share for joint, share in shares.items() if share is not None}
        joint = max(known, key=lambda name: known[name].value, default="")
        beyond = sum(share.value > 1.0 + ROUNDED_SHARE for share in known.values())
        peak = known.get(joint)
        largest[quantity] = peak and Peak(joint, quantity, peak.value, peak.time, beyond)
    return largest


def percent(share: float) -> str:
    """A share in words; below a tenth of a percent it is called so."""
    return "below 0.1 %" if share < 1e-3 else f"{100.0 * share:.3g} %"


def largest_shares(run: RecordedRun) -> dict[str, float | None]:
    """The largest share of any joint of a run: of effort, speed and range; None where unknown."""
    largest = peaks(joint_uses(run))
    return {name: None if peak is None else peak.share for name, peak in largest.items()}


def limit_summary(run: RecordedRun) -> dict[str, Any]:
    """Rows of all joints, and what is largest, in types of JSON."""
    uses = joint_uses(run)
    largest = {name: peak and asdict(peak) for name, peak in peaks(uses).items()}
    return {"joints": [use.row() for use in uses], "largest": largest}


def limit_warnings(largest: Mapping[str, Peak | None]) -> list[str]:
    """A sentence for each quantity of which some joint is beyond its limit."""
    return [peak.warning for peak in largest.values() if peak is not None and peak.beyond]


def _bounds(limits: Any, arm: str, quantity: str, joints: int) -> np.ndarray:
    """Lower and upper limits, (joints, 2); infinite where none is known."""
    try:
        stored = limits.get(arm, {}).get(quantity) or [None] * joints
        bounds = np.array([_interval(entry) for entry in stored], dtype=float).reshape(-1, 2)
        if len(bounds) != joints or not np.all(bounds[:, 0] < bounds[:, 1]):
            raise ValueError("not a pair of numbers for each joint")
    except (AttributeError, TypeError, ValueError):
        raise TrajectoryError(
            f"the {quantity} limits of arm '{arm}' that are stored with the run ('{LIMITS}' of its "
            "provenance) cannot be read; repeat the run"
        ) from None
    return bounds


def _interval(entry: Any) -> tuple[float, float]:
    if entry is None:
        return -math.inf, math.inf
    lower, upper = entry if isinstance(entry, list) else (-entry, entry)
    if lower is None or upper is None:  # one end gives no share
        return -math.inf, math.inf
    return float(lower), float(upper)


def _largest(run: RecordedRun, channel: str, bounds: np.ndarray) -> list[Share | None]:
    """For each column of a channel the largest share of its bounds, the first of equal ones."""
    known = np.isfinite(bounds).all(axis=1)
    lower, upper = bounds[known].T
    columns = np.flatnonzero(known).tolist()
    best: dict[int, Share] = {}
    for time, values in run.blocks("time", channel):
        with np.errstate(over="ignore"):  # stored ranges may be as narrow as any
            shares = np.abs(values[:, known] - (lower / 2 + upper / 2)) / (upper / 2 - lower / 2)
        shares = np.minimum(shares, np.finfo(float).max)
        for column, of_joint in zip(columns, shares.T, strict=True):
            k = int(np.argmax(of_joint))
            if column not in best or of_joint[k] > best[column].value:
                best[column] = Share(float(of_joint[k]), float(time[k]))
    return [best.get(column) for column in range(len(bounds))]
