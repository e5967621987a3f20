"""The same system in Drake: a discrete ``MultibodyPlant``, its solver SAP.

    python benchmarks/drake_peer.py [SCENE] [--steps 2e-3,1e-3] [--json FILE]

The plant is built from the arms' own models, body by body, the object a free body; a weld of a
scene becomes Drake's weld constraint, a ball its ball constraint, a hinge two balls on its axis.
The constraints are those of the discrete solver, compliant to a degree that follows from the time
step; the method is of order 1.  (Drake's continuous plants have no such constraints.)

Torques depend on time alone and are made by Drake's own ``Sine``: no Python is in its loop.  Drake
need not be there: it is imported when a plant is built.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import output
import pandas
from matplotlib.figure import Figure

import multiarm as ma
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError
from multiarm.plots.style import BLUE
from multiarm.studies.peers import (
    Grid,
    Sinusoid,
    joint_damping,
    joint_ends,
    links,
    moments,
    sinusoid,
    tip_frame,
)
from multiarm.studies.reference import Motion, motion_error

RING = Path(__file__).parents[1] / "examples" / "scenes" / "ring_weld.yaml"
STEPS = (5e-3, 2e-3, 1e-3, 5e-4)
"""Steps of the plant [s]."""
REFERENCE_ACCURACY = 1e-9
"""Of our run with which Drake's motion is compared [m, rad]."""


def main(words: Sequence[str] | None = None) -> None:
    """Run a scene in Drake with several steps, and write the table, the figure and the numbers."""
    parser = output.options(__doc__, "drake_peer", rounds=3)
    parser.add_argument("scene", nargs="?", type=Path, default=RING, help="default: %(default)s")
    parser.add_argument("--steps", type=_steps, default=STEPS, metavar="H,H,...",
                        help="steps [s] that divide the output step")  # fmt: skip
    arguments = parser.parse_args(words)
    system = ma.compile_system(ma.load_scene(arguments.scene, code=False))
    interval = Grid.of(system.scene.run).interval
    for step in arguments.steps:
        if abs(interval / step - round(interval / step)) > 1e-9:
            parser.error(f"--steps: {step:g} s does not divide the output step of {interval:g} s")
    with output.Clock() as clock:
        rows = motions(system, arguments.steps, arguments.rounds)
    output.save(arguments, clock, "drake", pandas.DataFrame(rows), figure)


def _steps(text: str) -> tuple[float, ...]:
    try:
        steps = tuple(float(part) for part in text.split(","))
    except ValueError:
        steps = ()
    if not steps or min(steps) <= 0.0:
        raise argparse.ArgumentTypeError(f"{text!r}: write positive steps [s], as 2e-3,1e-3")
    return steps


def motions(system: System, steps: Sequence[float], rounds: int) -> list[dict[str, float | None]]:
    """Fastest wall time of the steps alone, and largest error of a coordinate, for each step.

    There is no error where the plant diverges before the end.

    Raises
    ------
    ModelError
        For torques that depend on more than time, a joint without a constraint, and what Drake
        refuses.
    ImportError
        Where Drake is not installed.
    """
    drive = sinusoid(system)
    if drive is None:
        raise ModelError("the scene's torques depend on more than time: choose 'harmonic' or none")
    exact = ma.simulate(system, accuracy=REFERENCE_ACCURACY)
    if exact.status != "completed":
        raise ModelError(f"the scene has no reference to compare with: {exact.message}")
    times = Grid.of(system.scene.run).times
    rows = []
    for step in steps:
        print(f"step {step:g} s", flush=True)
        plant = DrakePlant(system, step, drive)
        runs = [plant.motion(system.initial_state(), times) for _ in range(rounds)]
        wall, states = min(seconds for seconds, _ in runs), runs[0][1]
        error = None  # of a plant that diverged
        if len(states) == len(times):
            error = motion_error(Motion(np.array([s.position for s in states])).errors(exact))
        rows.append({"step": step, "wall_time_s": wall, "error": error})
    return rows


def figure(rows: pandas.DataFrame) -> Figure:
    """Wall time over the error."""
    drawing, (axes,) = output.panels(1)
    axes.plot(rows["error"], rows["wall_time_s"], "o-", color=BLUE)
    axes.set(xscale="log", yscale="log", xlabel="largest error [m, rad]",
             ylabel="wall time [s]", title="One scene in Drake")  # fmt: skip
    return drawing


class DrakePlant:
    """A system in Drake with a time step [s] and torques; Drake integrates damping implicitly."""

    def __init__(self, system: System, step: float, drive: Sinusoid):
        from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
        from pydrake.systems.analysis import Simulator
        from pydrake.systems.framework import DiagramBuilder

        self.system, damping = system, joint_damping(system)
        self._joints: list[Any] = []
        builder = DiagramBuilder()
        plant: Any = builder.AddSystem(MultibodyPlant(step))
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        constants = system.model.constants
        plant.mutable_gravity_field().set_gravity_vector(constants.gravity)
        try:
            inertia = _inertia(
                constants.object_masses[0], np.zeros(3), constants.object_inertias[0]
            )
            body = plant.AddRigidBody("object", inertia)
            joints = {joint.arm: joint for joint in system.scene.joints}
            for name, first in zip(system.arm_names, system.model.layout.first_joint, strict=False):
                tip = self._add_arm(plant, name, damping[first:])
                _constrain(plant, body, system.frames[name].on_object, *tip, joints[name])
            plant.Finalize()
        except (RuntimeError, ValueError) as error:
            raise ModelError(f"Drake refuses the model: {str(error).splitlines()[0]}") from error
        self.plant = plant
        # a free body: quaternion wxyz and place, angular and linear velocity
        self._free = body.floating_positions_start(), body.floating_velocities_start_in_v()
        # where Drake has the joints' velocities, and the torques
        self.velocity_places = np.array([joint.velocity_start() for joint in self._joints])
        self._drive(builder, drive)
        diagram = builder.Build()
        self._simulator = Simulator(diagram)
        self._context = self._simulator.get_mutable_context()
        self._plant_context = plant.GetMyMutableContextFromRoot(self._context)

    def motion(self, start: State, times: np.ndarray) -> tuple[float, list[State]]:
        """Wall time [s] of the steps alone, and the states at the times while they are finite."""
        self._context.SetTime(times[0])
        self.place(start)
        self._simulator.Initialize()
        states, wall = [start], 0.0
        for t in times[1:]:
            begin = time.perf_counter()
            self._simulator.AdvanceTo(t)
            wall += time.perf_counter() - begin
            state = self.state()
            if not np.isfinite([*state.position, *state.velocity]).all():
                break
            states.append(state)
        return wall, states

    def _add_arm(self, plant: Any, name: str, damping: np.ndarray) -> tuple[Any, np.ndarray]:
        """Links and joints of an arm; returns its last body and the joint's frame on it."""
        from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint, RevoluteJoint

        arm, bodies = self.system.arms[name], [plant.world_body()]
        for i, link in enumerate(links(arm), start=1):
            inertia = link.inertia
            body = plant.AddRigidBody(
                f"{name}/{i}", _inertia(inertia.mass, inertia.lever, inertia.inertia)
            )
            base = plant.AddFrame(
                FixedOffsetFrame(
                    f"{name}/base{i}",
                    bodies[link.parent].body_frame(),
                    _pose(link.placement.homogeneous),
                )
            )
            kind = RevoluteJoint if link.turns else PrismaticJoint
            self._joints.append(
                plant.AddJoint(
                    kind(f"{name}/j{i}", base, body.body_frame(), link.axis, damping=damping[i - 1])
                )
            )
            bodies.append(body)
        return bodies[arm.tip.joint], tip_frame(self.system, name)

    def _drive(self, builder: Any, drive: Sinusoid) -> None:
        """Connect the torques: Drake's own sines."""
        from pydrake.systems.primitives import Adder, ConstantVectorSource, Sine

        plant, size = self.plant, self.plant.num_velocities()
        target = plant.get_applied_generalized_force_input_port()
        spread = np.zeros((3, size))
        spread[:, self.velocity_places] = drive.constant, drive.sine, drive.cosine
        constant = builder.AddSystem(ConstantVectorSource(spread[0]))
        amplitude, phase = np.hypot(spread[1], spread[2]), np.arctan2(spread[2], spread[1])
        sine = builder.AddSystem(Sine(amplitude, np.full(size, drive.rate), phase, True))
        adder = builder.AddSystem(Adder(2, size))
        builder.Connect(constant.get_output_port(), adder.get_input_port(0))
        builder.Connect(sine.get_output_port(0), adder.get_input_port(1))
        builder.Connect(adder.get_output_port(), target)

    def place(self, state: State) -> None:
        """Write a state."""
        plant, context = self.plant, self._plant_context
        q, v = np.zeros(plant.num_positions()), np.zeros(plant.num_velocities())
        for joint, angle, rate in zip(
            self._joints, state.position[7:], state.velocity[6:], strict=True
        ):
            q[joint.position_start()], v[joint.velocity_start()] = angle, rate
        at, rate_at = self._free
        q[at : at + 4] = np.roll(state.object_quaternion_xyzw, 1)
        q[at + 4 : at + 7] = state.object_position
        v[rate_at : rate_at + 6] = np.roll(state.object_twist, 3)
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)

    def state(self) -> State:
        """The state as it is now."""
        plant, context = self.plant, self._plant_context
        q, v = plant.GetPositions(context), plant.GetVelocities(context)
        at, rate_at = self._free
        quaternion = np.roll(q[at : at + 4], -1)
        angles = q[[joint.position_start() for joint in self._joints]]
        return State(
            np.concatenate([q[at + 4 : at + 7], quaternion / np.linalg.norm(quaternion), angles]),
            np.concatenate([np.roll(v[rate_at : rate_at + 6], 3), v[self.velocity_places]]),
            self.system.model.layout,
        )


def _constrain(
    plant: Any, body: Any, on_object: np.ndarray, tip: Any, on_tip: np.ndarray, joint: Any
) -> None:
    """Close an arm's joint to the object."""
    ends = joint_ends(joint, "Drake has no constraint")
    if joint.kind == "weld":
        plant.AddWeldConstraint(body, _pose(on_object), tip, _pose(on_tip))
        return
    for end in ends:
        plant.AddBallConstraint(
            body,
            on_object[:3, 3] + end * on_object[:3, 2],
            tip,
            on_tip[:3, 3] + end * on_tip[:3, 2],
        )


def _inertia(mass: float, centre: np.ndarray, about_centre: np.ndarray) -> Any:
    from pydrake.multibody.tree import RotationalInertia, SpatialInertia, UnitInertia

    own = RotationalInertia(*moments(about_centre))
    unit = UnitInertia().SetFromRotationalInertia(own, mass)
    return SpatialInertia(mass, centre, unit.ShiftFromCenterOfMass(-np.asarray(centre)))


def _pose(matrix: np.ndarray) -> Any:
    from pydrake.math import RigidTransform, RotationMatrix

    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(matrix[:3, :3]), matrix[:3, 3])


if __name__ == "__main__":
    main()
