"""The cost of one evaluation of a humanoid that holds a box, compared with Pinocchio's algorithms.

    python benchmarks/humanoids.py [--rounds N] [--figure FILE] [--json FILE]

A Unitree G1 with 29 joints and a floating base holds a box, which is welded to both hands: 41
degrees of freedom and 12 constraints; or its feet are welded to the ground too, 24 constraints.
Pinocchio has the robot on a free-flyer, as its users would; ``lcaba`` takes one or three
iterations, ``aba`` is the same system without its constraints.  Then up to 32 of these robots stand
around one box, compiled.  The fastest burst of each counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import output
import pandas
import pinocchio as pin
from evaluations import moving_state
from matplotlib.figure import Figure
from timing import fastest, measure, python_burst, slope_burst

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.data import Data
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.events.evaluation import evaluate
from multiarm.plots.style import BLUE, GREEN, ORANGE, PINK
from multiarm.scene import Scene, find_robot
from multiarm.spatial import quaternion_to_matrix
from multiarm.threads import one_thread

ROBOT = "g1_29dof_rev_1_0"
HANDS = {"left": "left_rubber_hand", "right": "right_rubber_hand"}
FEET = {"left_foot": "left_ankle_roll_link", "right_foot": "right_ankle_roll_link"}
SYSTEMS = ("box in both hands", "feet on the ground too")
COMPILED, PINOCCHIO, UNCONSTRAINED = "compiled", "Pinocchio's terms", "aba, no constraints"
ITERATIONS = {"lcaba, 1 iteration": 1, "lcaba, 3 iterations": 3}
DYNAMICS = "constraintDynamics"
METHODS = (COMPILED, PINOCCHIO, *ITERATIONS, DYNAMICS, UNCONSTRAINED)
CROWDS = (1, 2, 4, 8, 16, 32)
COPIES = 3
"""Of our arrays: where they lie in memory changes the time of some evaluations."""
COLOURS = dict(zip(METHODS, (PINK, BLUE, GREEN, GREEN, ORANGE, ORANGE), strict=True))


def main(words: Sequence[str] | None = None) -> None:
    """Measure, and write the table, the figure and the numbers."""
    arguments = output.options(__doc__, "humanoids").parse_args(words)
    with output.Clock() as clock:
        rows = humanoid_costs(arguments.rounds)
        rows = pandas.concat([rows, crowd_costs(CROWDS, arguments.rounds)], ignore_index=True)
    output.save(arguments, clock, "humanoids", rows, figure)


def humanoid_costs(rounds: int) -> pandas.DataFrame:
    """A row for both systems and every method.

    ``microseconds`` of an evaluation, and divided by the number of ``humanoids``; ``ratio`` of them
    to those of ours with compiled terms; and
    ``relative_error``, the largest deviation of an acceleration from the dense solution over the
    largest of them, none for what has no constraints.
    """
    with one_thread():
        return pandas.DataFrame([row for name in SYSTEMS for row in _measure(name, rounds)])


def crowd_costs(crowds: Sequence[int], rounds: int) -> pandas.DataFrame:
    """Rows as in :func:`humanoid_costs` of humanoids that hold one box together."""
    rows, bursts = [], {}
    with one_thread():
        for count in crowds:
            system = compile_system(scene_of_crowd(count), arms="compiled")
            state = system.initial_state()
            rows.append(
                {
                    "system": "around one box",
                    "humanoids": count,
                    "freedoms": evaluate(system, 0.0, state).accelerations.size,
                    "constraints": system.constraint_count,
                    "method": COMPILED,
                }
            )
            data = Data(system.model)
            data.set_state(0.0, state)
            bursts[str(count)] = slope_burst(data)
        cost = fastest(measure(bursts, 40 * rounds))
    table = pandas.DataFrame(rows)
    table["microseconds"] = [cost[str(count)] for count in crowds]
    table["microseconds_a_humanoid"] = table["microseconds"] / table["humanoids"]
    return table


def figure(rows: pandas.DataFrame) -> Figure:
    """Cost by method, a panel for each system."""
    drawing, axes = output.panels(len(SYSTEMS))
    for name, panel in zip(SYSTEMS, axes, strict=True):
        of_system = rows[rows["system"] == name].iloc[::-1]
        colours = [COLOURS[method] for method in of_system["method"]]
        panel.barh(of_system["method"], of_system["microseconds"], color=colours)
        size, constraints = of_system[["freedoms", "constraints"]].iloc[0]
        panel.set(title=f"G1, {name} {{{size}}}[{constraints}]", xlabel="microseconds")
    return drawing


def scene_of_humanoid(name: str) -> Scene:
    """The robot with a box in both hands; both systems have all of its joints."""
    held = [{"arm": f"g1/{tip}", "kind": "weld"} for tip in HANDS]
    ground = [{"between": [f"g1/{tip}", "world"], "kind": "weld"} for tip in FEET]
    box = {"shape": {"box": [0.2, 0.3, 0.2]}, "mass": 3.0, "pose": {"xyz": [0.3, 0.0, 1.0]}}
    base = {"moves": "free", "xyz": [0.0, 0.0, 0.79]}
    return Scene.from_mapping(
        {
            "gravity": [0.0, 0.0, -9.81],
            "object": box,
            "robots": {"g1": {"robot": ROBOT, "base": base, "tips": {**HANDS, **FEET}}},
            "joints": held if name == SYSTEMS[0] else held + ground,
        }
    )


def scene_of_crowd(count: int) -> Scene:
    """Humanoids in a circle, each with both hands on the box in its middle."""
    robots, held = {}, []
    for k in range(count):
        angle, radius = 2.0 * np.pi * k / count, 0.3 + 0.15 * count
        at = [float(-radius * np.cos(angle)), float(-radius * np.sin(angle)), 0.79]
        base = {"moves": "free", "xyz": at, "rpy": [0.0, 0.0, angle]}
        robots[f"g{k}"] = {"robot": ROBOT, "base": base, "tips": {**HANDS, **FEET}}
        held += [{"arm": f"g{k}/{tip}", "kind": "weld"} for tip in HANDS]
    box = {"shape": {"box": [0.2, 0.3, 0.2]}, "mass": 3.0 * count, "pose": {"xyz": [0.0, 0.0, 1.0]}}
    return Scene.from_mapping(
        {"gravity": [0.0, 0.0, -9.81], "object": box, "robots": robots, "joints": held}
    )


class PinocchioHumanoid:
    """The same system in Pinocchio: robot and box are free-flyers, joints rigid constraints."""

    def __init__(self, system: System, state: State) -> None:
        self.model = pin.buildModelFromUrdf(str(find_robot(ROBOT).urdf), pin.JointModelFreeFlyer())
        plant = system.model.constants
        self.model.gravity.linear = plant.gravity
        box = self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
        inertia = pin.Inertia(plant.object_masses[0], np.zeros(3), plant.object_inertias[0])
        self.model.appendBodyToJoint(box, inertia, pin.SE3.Identity())
        assert tuple(self.model.names)[2:-1] == system.arms["g1"].joint_names
        self.q, self.v = self._state(state)
        self.data = self.model.createData()
        pin.framesForwardKinematics(self.model, self.data, self.q)
        self.constraints = pin.StdVec_RigidConstraintModel()
        for connection in system.scene.joints:
            tip = connection.connection.partition("/")[2].partition("-")[0]
            body = box if tip in HANDS else 0
            self._weld({**HANDS, **FEET}[tip], body)

    def _weld(self, link: str, body: int) -> None:
        """Weld a link, as it is at the state, to a body."""
        number = self.model.getFrameId(link)
        frame = self.model.frames[number]
        at = self.data.oMi[body].actInv(self.data.oMf[number])
        weld = pin.RigidConstraintModel(
            pin.ContactType.CONTACT_6D, self.model, frame.parentJoint, frame.placement, body, at,
            pin.ReferenceFrame.LOCAL,
        )  # fmt: skip
        self.constraints.append(weld)

    def _state(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        base = state.bases["g1"]
        box = np.append(state.object_position, state.object_quaternion_xyzw)
        parts = (base.pose, base.twist), (box, state.object_twist)
        poses, twists = [], []
        for pose, twist in parts:
            R = quaternion_to_matrix(pose[3:])
            poses.append(pose)
            twists.append(np.concatenate([R.T @ twist[:3], R.T @ twist[3:]]))
        joints = state.joint_positions["g1"], state.joint_velocities["g1"]
        q = np.concatenate([poses[0], joints[0], poses[1]])
        return q, np.concatenate([twists[0], joints[1], twists[1]])

    def call(self, method: str) -> Callable[[], np.ndarray]:
        """A function without arguments that runs an algorithm once, with a Data of its own."""
        model, data, constraints = self.model, self.model.createData(), self.constraints
        loads = self.q, self.v, np.zeros(self.model.nv)
        if method == UNCONSTRAINED:
            return partial(pin.aba, model, data, *loads)
        of_constraints = pin.StdVec_RigidConstraintData()
        for constraint in constraints:
            of_constraints.append(constraint.createData())
        if method == DYNAMICS:
            pin.initConstraintDynamics(model, data, constraints, of_constraints)
            settings, run = pin.ProximalSettings(1e-10, 1e-10, 1e-10, 10), pin.constraintDynamics
        else:
            pin.computeJointMinimalOrdering(model, data, constraints)
            settings, run = pin.ProximalSettings(1e-15, 1e-15, 1e-6, ITERATIONS[method]), pin.lcaba
        return partial(run, model, data, *loads, constraints, of_constraints, settings)

    def accelerations(self, method: str) -> np.ndarray:
        """As :attr:`Evaluation.accelerations`: of the box, the base and the joints."""
        a = self.call(method)().copy()
        base, joints, box = np.split(a, [6, a.size - 6])
        of_bodies = (box, self.q[-7:], self.v[-6:]), (base, self.q[:7], self.v[:6])
        box, base = (_classical(*body) for body in of_bodies)
        return np.concatenate([box, base, joints])


def _classical(a: np.ndarray, pose: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Classical acceleration in world axes of a free-flyer's spatial one in its own axes."""
    R = quaternion_to_matrix(pose[3:])
    return np.concatenate([R @ (a[:3] + np.cross(v[3:], v[:3])), R @ a[3:]])


def _measure(name: str, rounds: int) -> list[dict[str, Any]]:
    """All methods at one random state that moves with the constraints."""
    scene = scene_of_humanoid(name)
    systems = {
        COMPILED: compile_system(scene, arms="compiled"),
        PINOCCHIO: compile_system(scene, arms="pinocchio"),
    }
    reference = systems[PINOCCHIO]
    state = moving_state(reference, seed=1)
    exact = evaluate(reference.with_solver("dense"), 0.0, state).accelerations
    accelerations, bursts = {}, {}
    for method, system in systems.items():
        accelerations[method] = evaluate(system, 0.0, state).accelerations
        for copy in range(COPIES):
            data = Data(system.model)
            data.set_state(0.0, state)
            bursts[f"{method} {copy}"] = slope_burst(data)
    peer = PinocchioHumanoid(reference, state)
    for method in METHODS[len(systems) :]:
        if method != UNCONSTRAINED:
            accelerations[method] = peer.accelerations(method)
        bursts[method] = python_burst(peer.call(method))
    cost = fastest(measure(bursts, 40 * rounds))
    for method in systems:
        cost[method] = min(cost[f"{method} {copy}"] for copy in range(COPIES))
    scale = np.max(np.abs(exact))
    return [
        {
            "system": name,
            "humanoids": 1,
            "freedoms": exact.size,
            "constraints": reference.constraint_count,
            "method": method,
            "microseconds": cost[method],
            "microseconds_a_humanoid": cost[method],
            "ratio": cost[method] / cost[COMPILED],
            "relative_error": np.max(np.abs(accelerations[method] - exact)) / scale
            if method in accelerations
            else None,
        }
        for method in METHODS
    ]


if __name__ == "__main__":
    main()
