"""The cost of one evaluation of hands that hold a cube, compared with Pinocchio's algorithms.

    python benchmarks/hands.py [--rounds N] [--figure FILE] [--json FILE]

One or two Allegro hands hold a cube with a ball joint at each of their four fingertips: 22 or 38
degrees of freedom and 12 or 24 constraints, the systems of Table II of A. Sathya and J. Carpentier,
LCABA, 2026.  In
multiarm a hand is one *robot* with four tips, or four *arms*, one a finger.  Pinocchio's ``lcaba``
takes one or three iterations; ``aba`` is the same system without its constraints.  The fastest
burst of each counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar

import numpy as np
import output
import pandas
import pinocchio as pin
from evaluations import moving_state
from matplotlib.figure import Figure
from peer_solvers import ConstraintDynamics, Lcaba, Settings
from timing import fastest, measure, python_burst, slope_burst

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.data import Data
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.events.evaluation import evaluate
from multiarm.plots.style import BLUE, GREEN, ORANGE, PINK
from multiarm.scene import Scene
from multiarm.threads import one_thread

FINGERS = {
    "index": ("link_3.0_tip", {"joint_1.0": 0.4, "joint_2.0": 0.4, "joint_3.0": 0.4}),
    "middle": ("link_7.0_tip", {"joint_5.0": 0.4, "joint_6.0": 0.4, "joint_7.0": 0.4}),
    "ring": ("link_11.0_tip", {"joint_9.0": 0.4, "joint_10.0": 0.4, "joint_11.0": 0.4}),
    "thumb": (
        "link_15.0_tip",
        {"joint_12.0": 0.9, "joint_13.0": 0.4, "joint_14.0": 0.5, "joint_15.0": 0.6},
    ),
}
"""Finger -> the link of its tip, and the positions of its joints [rad]."""
BASES = (
    {"xyz": [0.0, 0.0, 0.0]},
    {"xyz": [0.12, 0.0, 0.2], "rpy": [0.0, np.pi, 0.0]},
)
OURS = ("robots, compiled", "robots, Pinocchio", "arms, compiled", "arms, Pinocchio")
PEERS = ("lcaba, 1 iteration", "lcaba, 3 iterations", "constraintDynamics")
UNCONSTRAINED = "aba, no constraints"
METHODS = (*OURS, *PEERS, UNCONSTRAINED)
COPIES = 3
"""Of our arrays: where they lie in memory changes the time of some evaluations."""
COLOURS = dict(zip(METHODS, [PINK] * 2 + [BLUE] * 2 + [GREEN] * 2 + [ORANGE] * 2, strict=True))


class LcabaOnce(Lcaba):
    """One iteration."""

    fast: ClassVar[Settings] = (1e-15, 1e-15, 1e-6, 1)


class LcabaThrice(Lcaba):
    """Three iterations."""

    fast: ClassVar[Settings] = (1e-15, 1e-15, 1e-6, 3)


class Unconstrained(ConstraintDynamics):
    """``aba`` of hands and cube, which do not touch."""

    def call(
        self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, _settings: Settings
    ) -> Callable[[], np.ndarray]:
        """The algorithm, once."""
        return partial(pin.aba, self.model, self.data, q, v, tau)


def main(words: Sequence[str] | None = None) -> None:
    """Measure, and write the table, the figure and the numbers."""
    arguments = output.options(__doc__, "hands").parse_args(words)
    with output.Clock() as clock:
        rows = hand_costs((1, 2), arguments.rounds)
    output.save(arguments, clock, "hands", rows, figure)


def hand_costs(hands: Sequence[int], rounds: int) -> pandas.DataFrame:
    """A row for every number of hands and method.

    ``microseconds`` of an evaluation, and ``relative_error``, the largest deviation of a joint's
    acceleration from the dense solution over the largest of them; none for what has no constraints.
    """
    with one_thread():
        return pandas.DataFrame([row for count in hands for row in _measure(count, rounds)])


def figure(rows: pandas.DataFrame) -> Figure:
    """Cost by method, a panel for each number of hands."""
    counts = rows["hands"].unique()
    drawing, axes = output.panels(len(counts))
    for count, panel in zip(counts, axes, strict=True):
        of_count = rows[rows["hands"] == count].iloc[::-1]
        colours = [COLOURS[method] for method in of_count["method"]]
        panel.barh(of_count["method"], of_count["microseconds"], color=colours)
        size, constraints = of_count[["freedoms", "constraints"]].iloc[0]
        title = f"{count_of_hands(count)} and a cube {{{size}}}[{constraints}]"
        panel.set(title=title, xlabel="microseconds")
    return drawing


def count_of_hands(count: int) -> str:
    """In words."""
    return "a hand" if count == 1 else f"{count} hands"


def scene_of_hands(count: int, as_robots: bool) -> Scene:
    """So many hands that hold a cube; each one robot with four tips, or four arms."""
    tables: dict[str, dict[str, Any]] = {}
    joints = []
    for number, base in enumerate(BASES[:count]):
        hand = {"robot": "allegro_left_hand", "base": base}
        if as_robots:
            posture = {j: q for _, positions in FINGERS.values() for j, q in positions.items()}
            tips = {finger: link for finger, (link, _) in FINGERS.items()}
            tables[f"hand_{number}"] = {**hand, "tips": tips, "posture": posture}
        for finger, (link, positions) in FINGERS.items():
            if not as_robots:
                tables[f"hand_{number}_{finger}"] = {**hand, "tip": link, "posture": positions}
            name = f"hand_{number}/{finger}" if as_robots else f"hand_{number}_{finger}"
            joints.append({"arm": name, "kind": "ball"})
    cube = {"mass": 0.2, "shape": {"box": [0.07] * 3}, "pose": {"xyz": [0.06, 0.0, 0.1]}}
    return Scene.from_mapping(
        {
            "gravity": [0.0, 0.0, -9.81],
            "object": cube,
            "robots" if as_robots else "arms": tables,
            "joints": joints,
        }
    )


def _measure(count: int, rounds: int) -> list[dict[str, Any]]:
    """All methods at one random state that moves with the constraints."""
    systems = {
        f"{kind}, {'compiled' if backend == 'compiled' else 'Pinocchio'}": compile_system(
            scene_of_hands(count, kind == "robots"), arms=backend
        )
        for kind in ("robots", "arms")
        for backend in ("compiled", "pinocchio")
    }
    reference = systems["arms, Pinocchio"]
    state, names = moving_state(reference, seed=count), reference.model.joint_names
    exact = evaluate(reference.with_solver("dense"), 0.0, state).accelerations[6:]
    torque, accelerations, bursts = np.zeros(exact.size), {}, {}
    for method, system in systems.items():
        order = [names.index(_finger_joint(name)) for name in system.model.joint_names]
        placed = _in_order(system, state, order)
        solved = np.empty(exact.size)
        solved[order] = evaluate(system, 0.0, placed).accelerations[6:]
        accelerations[method] = solved
        for copy in range(COPIES):
            data = Data(system.model)
            data.set_state(0.0, placed)
            bursts[f"{method} {copy}"] = slope_burst(data)
    solvers = zip(PEERS, (LcabaOnce, LcabaThrice, ConstraintDynamics), strict=True)
    for method, solver in solvers:
        call = solver(reference).evaluation(state, torque)
        accelerations[method] = call()[: exact.size].copy()
        bursts[method] = python_burst(call)
    bursts[UNCONSTRAINED] = python_burst(Unconstrained(reference).evaluation(state, torque))
    cost = fastest(measure(bursts, 40 * rounds))
    for method in systems:
        cost[method] = min(cost[f"{method} {copy}"] for copy in range(COPIES))
    scale = np.max(np.abs(exact))
    return [
        {
            "hands": count,
            "freedoms": 6 + exact.size,
            "constraints": reference.constraint_count,
            "method": method,
            "microseconds": cost[method],
            "relative_error": np.max(np.abs(accelerations[method] - exact)) / scale
            if method in accelerations
            else None,
        }
        for method in METHODS
    ]


def _finger_joint(name: str) -> str:
    """The joint of a hand that is one robot, or of one that is four arms, as one of an arm."""
    robot, _, joint = name.partition("/")
    if robot.count("_") > 1:
        return name
    number = int(float(joint.removeprefix("joint_")))
    finger = ("index", "middle", "ring", "thumb")[number // 4]
    return f"{robot}_{finger}/{joint}"


def _in_order(system: System, state: State, order: list[int]) -> State:
    """A state of a system whose joints stand in another order."""
    placed, layout = system.initial_state(), state.layout
    placed.position[:], placed.velocity[:] = state.position, state.velocity
    placed.layout.joint_positions(placed.position)[:] = layout.joint_positions(state.position)[
        order
    ]
    placed.layout.joint_rates(placed.velocity)[:] = layout.joint_rates(state.velocity)[order]
    return placed


if __name__ == "__main__":
    main()
