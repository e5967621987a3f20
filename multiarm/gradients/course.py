"""The course of a run: what timed joints do, from one switch to the next, by its events.

Events name joints and times; :class:`~multiarm.simulation.joint_schedule.JointSchedule` says which
moment of a joint has come there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.gradients.phase import Phase
from multiarm.gradients.switches import SOON, Switched
from multiarm.results.event_kinds import EventKind
from multiarm.results.trajectory import Trajectory
from multiarm.scene.joints.times import When
from multiarm.simulation.joint_schedule import JointSchedule


def first_phase(system: System, begin: float) -> Phase:
    """What timed joints do from the start of a run at a time [s] on."""
    unilateral = system.model.unilateral
    if unilateral is None or not unilateral.timed:
        return Phase(None)
    joints = unilateral.holding_at(begin)
    for k in joints:
        joint, interval = unilateral.timed[k], unilateral.timed[k].interval_at(begin)
        assert interval is not None and isinstance(interval.begin, float)
        if joint.located and interval.begin > 0.0:
            raise SolverError(
                f"derivatives of a run from t = {begin:.9g} s: joint '{joint.connection}' has "
                f"taken hold at {interval.begin:g} s, and holds its bodies where they are in the "
                "start; begin before that, or give the joint a place, 'at'"
            )
    return Phase(joints)


def phases(
    system: System,
    run: Trajectory,
    begin: float,
    state_at: Callable[[float], State],
    like: Sequence[Phase] = (),
) -> list[Phase]:
    """The phases of a run, by the switches among its events.

    ``state_at`` has the states before the switches, at the times of the events; ``like`` are the
    phases of a run nearby, whose coordinates are to be used.

    Raises
    ------
    SolverError
        When the order of switches in nearby motions is open, or that run has others.
    """
    found, events = [first_phase(system, begin)], switch_events(run)
    if not events and len(like) <= 1:
        return found
    unilateral, joints = system.model.unilateral, found[0].joints
    assert unilateral is not None and joints is not None, "there are timed joints"
    timed, schedule = unilateral.timed, JointSchedule(unilateral, begin)
    names = [joint.connection for joint in timed]
    groups: dict[float, list[Mapping]] = {}
    for event in events:
        groups.setdefault(event["time"], []).append(event)
    before: list[Mapping] = []
    for t, group in groups.items():
        moments, functions = [], []
        for event in group:
            k, attaches = names.index(event["arm"]), event["kind"] == EventKind.ATTACHED.word
            which = schedule.pass_switch(k, t)
            moment = timed[k].moments[which]
            moments.append((k, which))
            functions.append(moment.when if isinstance(moment, When) else None)
            joints = joints | {k} if attaches else joints - {k}
        again = [name for k, name in enumerate(names) if [j for j, _ in moments].count(k) > 1]
        if again:
            raise SolverError(
                f"derivatives of a run: joint '{again[0]}' lets go and takes hold at the same time "
                f"{t:.9g} s, when its next interval has begun already, and nearby motions may do "
                "so in another order; let that begin later"
            )
        if any(function is not functions[0] for function in functions):
            raise SolverError(
                f"derivatives of a run: at t = {t:.9g} s joints take hold or let go for different "
                f"reasons ({_texts(group)}), and which comes first in nearby motions is open; let "
                "them be apart, or name the same function"
            )
        if t < found[-1].time + SOON:
            raise SolverError(
                f"derivatives of a run: joints take hold or let go at t = {found[-1].time:.9g} s "
                f"and {t - found[-1].time:.1e} s later ({_texts([*before, *group])}), too near to "
                f"each other; let them be more than {SOON:g} s apart, or at one time of the scene, "
                "or name the same function"
            )
        near = like[len(found)] if len(found) < len(like) else None
        assert near is None or isinstance(near, Switched), "only the first phase is none"
        if like and (near is None or {*near.moments} != {*moments}):
            raise unlike()
        before = group
        found.append(
            Switched(system, found[-1], joints, t, state_at(t), moments, functions[0], near)
        )
    if like and len(found) < len(like):
        raise unlike()
    return found


def switch_events(run: Trajectory) -> list[Mapping]:
    """The events of a run at which joints take hold or let go."""
    kinds = EventKind.ATTACHED.word, EventKind.DETACHED.word
    return [event for event in run.events if event["kind"] in kinds]


def unlike() -> SolverError:
    """The error that joints do otherwise in a run of another accuracy."""
    return SolverError(
        "derivatives of a run: joints take hold and let go at other moments, or another number of "
        "times, in a run of another accuracy; end the run earlier, or ask for a smaller `accuracy`"
    )


def _texts(events: Sequence[Mapping]) -> str:
    return ", ".join(event["text"] for event in events)
