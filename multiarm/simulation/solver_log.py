"""Events of the solver: directions that arms lose or regain, and changes of rank."""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.contact_geometry import block_inertias
from multiarm.dynamics.data import Data
from multiarm.dynamics.diagnosis import describe, is_serial_arm, lost_motions
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.state import State
from multiarm.dynamics.status import OK
from multiarm.notation import count_of
from multiarm.results.event_kinds import EventKind
from multiarm.results.event_log import EventLog, RunEvent

SOLVER_EVENTS = frozenset(
    kind.word
    for kind in (
        EventKind.LOSES_DIRECTION,
        EventKind.REGAINS_DIRECTION,
        EventKind.PASSES_SINGULAR_POSTURE,
        EventKind.RANK_FALLS,
        EventKind.RANK_RISES,
    )
)
"""Kinds of the events of the solver, by the words of results."""


class SolverLog:
    """Adds the events of the solver to a run's log; their times are those of the steps' ends."""

    def __init__(self, data: Data, log: EventLog) -> None:
        self._log, self._added = log, 0
        self._lost = np.zeros(len(data.model.layout.blocks_of_robots), dtype=np.int64)
        self._rank = data.arrays.last_step.solution.rank

    def collect(self, data: Data, t: float, state: State) -> None:
        """Log the changes in the step that ended at ``t``, in this state."""
        step, count = data.arrays.last_step, len(data.model.layout.blocks_of_robots)
        lost, passed = step.lost_directions[:count].copy(), step.sign_changes[:count].copy()
        rank = step.solution.rank
        events = self._of_rank(float(t), rank)
        changed = np.flatnonzero((lost != self._lost) | (passed != 0))
        if changed.size:
            in_words = self._added < 100  # a description takes as long as many steps
            if in_words:
                data.move_to(state)  # the kinematics in the data may be those of another state
                # a callback that fails here ends the run at the next step
                in_words = update_kinematics(data.struct) == OK
            for i in map(int, changed):
                arm = data.model.blocks[i]
                if lost[i] != self._lost[i]:
                    now, before = int(lost[i]), int(self._lost[i])
                    robots = data.model.layout.robots_of_block(i) if in_words else ()
                    words = lost_motions(data, robots).values()
                    what = tuple(dict.fromkeys(word for of_robot in words for word in of_robot))
                    what = what or _in_numbers(data, arm, now)
                    events.append(_of_arm(float(t), arm, now, before, what))
                else:
                    nearest = f", {_nearest(data, i)}" if in_words else ""
                    told = f"passed a singular posture{nearest}"
                    kind = EventKind.PASSES_SINGULAR_POSTURE
                    events.append(RunEvent(float(t), kind, told, arm))
        self._lost, self._rank = lost, rank
        self._added += len(events)
        self._log.add(*events)

    def reset(self, data: Data) -> None:
        """Compare later solutions with the last one, without logging anything."""
        self._lost = data.arrays.last_step.lost_directions[: self._lost.size].copy()
        self._rank = data.arrays.last_step.solution.rank

    def _of_rank(self, t: float, rank: int) -> list[RunEvent]:
        if rank == self._rank:
            return []
        kind = EventKind.RANK_FALLS if rank < self._rank else EventKind.RANK_RISES
        text = f"{kind.word} from {self._rank} to {rank} independent constraints"
        if rank < self._rank:
            text += ": more than one way to move on"
        return [RunEvent(t, kind, text)]


def _in_numbers(data: Data, arm: str, lost: int) -> tuple[str]:
    if is_serial_arm(data, arm):
        return (f"directions of its joint lost: {lost}",)
    return (f"its connections repeat each other in {count_of(lost, 'direction')}",)


def _of_arm(t: float, arm: str, now: int, before: int, words: tuple[str, ...]) -> RunEvent:
    if now > before:
        return RunEvent(t, EventKind.LOSES_DIRECTION, "; ".join(words), arm)
    left = f", {now} still lost" if now else ""
    what = f"can move along its joint's directions again{left}"
    return RunEvent(t, EventKind.REGAINS_DIRECTION, what, arm)


def _nearest(data: Data, i: int) -> str:
    """Text for the direction in which a block moves least."""
    work, layout = data.work, data.model.layout
    d, m = layout.joint_counts[i], layout.contact_counts[i]
    inertias = block_inertias(data)
    Y = np.linalg.solve(np.linalg.cholesky(inertias[i]), work.W[i, :d, :m])
    _, _, directions = np.linalg.svd(Y)
    robot, of_block = layout.robots_of_block(i)[0], layout.contacts_of_block(i)
    rows = layout.contacts_of_blocks_of(layout.names.index(robot))
    of_robot = np.zeros((rows.stop - rows.start, 1))
    of_robot[of_block.start - rows.start : of_block.stop - rows.start, 0] = directions[-1]
    return "; ".join(describe(data, robot, of_robot))
