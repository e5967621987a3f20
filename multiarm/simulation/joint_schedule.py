"""The schedule of a run's timed joints: which hold, and which moments are awaited."""

from __future__ import annotations

import math
from collections.abc import Iterable

from multiarm.contacts.unilateral import CONTACT, UnilateralConstraints
from multiarm.events.mode_guards import MomentNumber
from multiarm.integration.step_control import shortest_step
from multiarm.scene.joints.times import Moment, Touching, When


class JointSchedule:
    """Goes through the moments of all timed joints, each its own, one after the other.

    A command (:meth:`pass_moment`) acts as if the next moment of a joint had come.

    Parameters
    ----------
    unilateral : UnilateralConstraints
    begin : float
        Of the run [s].

    Attributes
    ----------
    due : set of int
        Joints whose moment has come by an event, and that have not been switched yet.
    """

    def __init__(self, unilateral: UnilateralConstraints, begin: float) -> None:
        self._joints, self._constraints = unilateral.timed, unilateral.constraints
        self._moments = [joint.moments for joint in self._joints]
        self._passed = [0 for _ in self._joints]  # moments of each joint
        self.due: set[int] = set()
        for k in range(len(self._joints)):
            while self._due_time(k) <= begin:
                self._passed[k] += self._next(k) <= begin
                self._skip(k, begin)

    @property
    def holding(self) -> frozenset[int]:
        """Numbers of the joints that hold."""
        return frozenset(k for k, passed in enumerate(self._passed) if passed % 2)

    def foreseen(self) -> set[frozenset[int]]:
        """Which joints hold between all times, and after the next event or command of each."""
        times = [m for joint in self._moments for m in joint if isinstance(m, float)]
        sets = {
            frozenset(k for k, joint in enumerate(self._joints) if joint.interval_at(t))
            for t in times
        }
        return sets | {self.holding ^ {k} for k in range(len(self._joints))}

    @property
    def awaited(self) -> frozenset[MomentNumber]:
        """The next moments of all joints that functions tell."""
        return frozenset(
            (k, passed)
            for k, passed in enumerate(self._passed)
            if isinstance(self._moment(k), When)
        )

    def next_time(self, t: float) -> float:
        """When the next joint is to be switched [s]: now, where one is due."""
        if self.due:
            return t
        return min(map(self._due_time, range(len(self._joints))), default=math.inf)

    def joints_due(self, t: float) -> list[int]:
        """The joints to be switched at a time [s]."""
        now = _as_good_as(t)
        return [k for k in range(len(self._joints)) if k in self.due or self._due_time(k) <= now]

    def pass_moment(self, k: int, t: float) -> None:
        """Let a joint that holds let go, and one that does not take hold, at a time [s].

        One whose interval ends before its beginning has come waits for the next one.
        """
        now = _as_good_as(t)
        if k in self.due or self._next(k) <= now:
            self._passed[k] += 1
        self.due.discard(k)
        self._skip(k, now)

    def pass_switch(self, k: int, t: float) -> int:
        """Let a joint be switched at a time [s] at which a run without commands has switched it.

        Returns which of its moments has come.
        """
        self._skip(k, t - 2.0 * shortest_step(t))
        which = self._passed[k]
        self.due.add(k)
        self.pass_moment(k, t)
        return which

    def touched(self, closed: Iterable[int]) -> None:
        """Let the moments come that wait for one of these constraints to close."""
        names = set()
        for u in closed:
            contact = self._constraints[u]
            if contact.kind == CONTACT:  # stops of joints and joints at rest are of arms, too
                names |= {contact.owner, f"{contact.owner}/{contact.name}"}
        for k in range(len(self._joints)):
            moment = self._moment(k)
            if isinstance(moment, Touching) and moment.touching in names:
                self.due.add(k)

    def _moment(self, k: int) -> Moment:
        moments, passed = self._moments[k], self._passed[k]
        return moments[passed] if passed < len(moments) else math.inf

    def _next(self, k: int) -> float:
        moment = self._moment(k)
        return moment if isinstance(moment, float) else math.inf

    def _due_time(self, k: int) -> float:
        """When a joint's next moment comes, or its interval ends before that, as times say [s]."""
        moments, passed = self._moments[k], self._passed[k]
        waits = passed % 2 == 0 and isinstance(self._moment(k), When | Touching)
        end = moments[passed + 1] if waits else math.inf
        return min(self._next(k), end if isinstance(end, float) else math.inf)

    def _skip(self, k: int, t: float) -> None:
        """Pass over intervals that have ended before their beginning came."""
        moments, passed = self._moments[k], self._passed[k]
        while passed % 2 == 0 and passed + 1 < len(moments):
            end = moments[passed + 1]
            if not (isinstance(end, float) and end <= t):
                break
            passed += 2
        self._passed[k] = passed


def _as_good_as(t: float) -> float:
    """A time up to which no step leads from ``t`` [s]."""
    return t + 2.0 * shortest_step(t)
