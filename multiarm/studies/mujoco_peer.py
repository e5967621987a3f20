"""The same system in MuJoCo: as shipped, and with the best settings.

The model is built from the arms' own models, link by link, the object on a free joint; a weld of a
scene becomes MuJoCo's ``weld``, a ball its ``connect``, a hinge two of them on its axis.

MuJoCo's constraints are springs and dampers, soft as shipped.  Their softness is set by the largest
impedance, at most 0.9999, and ``body_invweight0``: scaled by ``HARDNESS`` it makes a weld's
accelerations right to 1e-9, at no other cost.  The best settings are these with MuJoCo's
Runge-Kutta method and a quarter of the shipped step.  (This holds for version 4: 3.3 leaves out
``dJ/dt v`` and is off by a percent in motion, however hard its constraints.)

MuJoCo requests torques by a callback, at every stage of a step.  Torques that depend on time alone
are tabulated row by row, in the order of the calls; a compiled callback copies the next row to
where MuJoCo reads it, and a whole interval between two outputs is one call.  So no Python is in
MuJoCo's loop, which saves a tenth of its time.

Two traps of ``MjSpec``: a body with its own inertia has no place for its centre of mass until
``ipos`` is set, and a run that diverges starts again at time zero unless that is switched off.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import mujoco
import numpy as np
from numba import cfunc, types

from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError
from multiarm.jit.structs import floats_at, struct_at
from multiarm.spatial import matrix_to_quaternion, quaternion_to_matrix
from multiarm.studies.peers import (
    Clock,
    Drive,
    Grid,
    Peer,
    Sample,
    Sinusoid,
    joint_ends,
    links,
    moments,
    tip_frame,
)

HARDNESS = 1e-6
_HARD = [0.9999, 0.9999, 0.001, 0.5, 2.0]
INTEGRATORS = {
    "Euler": (mujoco.mjtIntegrator.mjINT_EULER, (0.0,)),
    "implicitfast": (mujoco.mjtIntegrator.mjINT_IMPLICITFAST, (0.0,)),
    "RK4": (mujoco.mjtIntegrator.mjINT_RK4, (0.0, 0.5, 0.5, 1.0)),
}
# and the stages of a step at which MuJoCo calls for torques


class MujocoPeer(Peer):
    """A system as a MuJoCo model, with the best settings; MuJoCo integrates damping implicitly.

    Raises
    ------
    ModelError
        For a joint without an equality constraint, and what MuJoCo's compiler refuses.
    """

    methods: ClassVar = dict.fromkeys(INTEGRATORS, "step")
    hardened: ClassVar = True

    def __init__(self, system: System):
        super().__init__(system)
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.option.gravity = system.model.constants.gravity
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if self.hardened:
            spec.option.iterations, spec.option.tolerance = 100, 1e-15
        for name in system.arm_names:
            _add_arm(spec, system, name)
        _add_object(spec, system)
        for joint in system.scene.joints:
            _add_joint(spec, joint, {"solimp": _HARD} if self.hardened else {})
        try:
            self.model = spec.compile()
        except ValueError as error:
            reason = str(error).splitlines()[0]
            raise ModelError(f"MuJoCo refuses the model: {reason}") from error
        if self.hardened:
            self.model.body_invweight0[:] *= HARDNESS
        self.model.dof_damping[: system.model.layout.rate_count] = self.damping
        self.data = mujoco.MjData(self.model)

    def place(self, state: State) -> None:
        """Write a state; the object's angular velocity goes to its own axes."""
        d, n = self.data, self.system.model.layout.rate_count
        mujoco.mj_resetData(self.model, d)
        d.qpos[:n] = state.layout.joint_positions(state.position)
        d.qpos[n : n + 3] = state.object_position
        d.qpos[n + 3 :] = np.roll(state.object_quaternion_xyzw, 1)
        d.qvel[:n] = state.layout.joint_rates(state.velocity)
        d.qvel[n : n + 3] = state.object_twist[:3]
        d.qvel[n + 3 :] = self._rotation().T @ state.object_twist[3:]

    def state(self) -> State:
        """The state as it is now."""
        d, n = self.data, self.system.model.layout.rate_count
        position = [d.qpos[n : n + 3], np.roll(d.qpos[n + 3 :], -1), d.qpos[:n]]
        velocity = [d.qvel[n : n + 3], self._rotation() @ d.qvel[n + 3 :], d.qvel[:n]]
        return State(np.concatenate(position), np.concatenate(velocity), self.system.model.layout)

    def follow(
        self, clock: Clock, grid: Grid, start: State, method: str, value: float, drive: Drive
    ) -> Iterator[Sample]:
        """Step from output to output (:meth:`.peers.Peer.follow`)."""
        kind, stages = INTEGRATORS[method]
        d, n, count = self.data, self.system.model.layout.rate_count, grid.steps(value)
        self.model.opt.integrator, self.model.opt.timestep = kind, value
        self.place(start)
        yield Sample(0.0, start)
        tape = TorqueTape(d.qfrc_applied[:n])

        def control(_model: Any, data: Any) -> None:
            data.qfrc_applied[:n] = drive(data.time, self.state)

        offsets = (np.arange(count)[:, None] + np.array(stages)).ravel()
        with quiet(tape.play if isinstance(drive, Sinusoid) else control):
            for k in range(grid.intervals):
                if isinstance(drive, Sinusoid):
                    tape.load(drive.at(k * grid.interval + value * offsets))
                with clock:
                    mujoco.mj_step(self.model, d, nstep=count)
                clock.steps += count
                clock.evaluations += count * len(stages)
                yield Sample((k + 1) * grid.interval, self.state())

    def _rotation(self) -> np.ndarray:
        return quaternion_to_matrix(np.roll(self.data.qpos[-4:], -1))


class MujocoAsShipped(MujocoPeer):
    """A system as a MuJoCo model with MuJoCo's own settings."""

    hardened: ClassVar = False


@contextmanager
def quiet(control: Callable | None = None) -> Iterator[None]:
    """MuJoCo without its log file, and with a control function; both are global to it."""
    mujoco.set_mju_user_warning(lambda _text: None)
    mujoco.set_mjcb_control(control)
    try:
        yield
    finally:
        mujoco.set_mjcb_control(None)
        mujoco.set_mju_user_warning(None)


def _add_arm(spec: Any, system: System, name: str) -> None:
    """Links and joints of an arm, and the sites of its joint to the object."""
    arm, bodies = system.arms[name], [spec.worldbody]
    for link in links(arm):
        body = bodies[link.parent].add_body(
            pos=link.placement.translation, quat=_quaternion(link.placement.rotation)
        )
        _set_inertia(body, link.inertia.mass, link.inertia.lever, link.inertia.inertia)
        kind = mujoco.mjtJoint.mjJNT_HINGE if link.turns else mujoco.mjtJoint.mjJNT_SLIDE
        body.add_joint(type=kind, axis=link.axis)
        bodies.append(body)
    joint = next(joint for joint in system.scene.joints if joint.arm == name)
    _add_sites(bodies[arm.tip.joint], "arm", joint, tip_frame(system, name))


def _add_object(spec: Any, system: System) -> None:
    start = system.initial_state()
    body = spec.worldbody.add_body(
        pos=start.object_position, quat=np.roll(start.object_quaternion_xyzw, 1)
    )
    plant = system.model.constants
    _set_inertia(body, plant.object_masses[0], np.zeros(3), plant.object_inertias[0])
    body.add_freejoint()
    for joint in system.scene.joints:
        _add_sites(body, "object", joint, system.frames[joint.arm].on_object)


def _set_inertia(body: Any, mass: float, centre: np.ndarray, inertia: np.ndarray) -> None:
    body.explicitinertial, body.mass, body.ipos = True, mass, centre
    body.fullinertia = moments(inertia)


def _add_sites(body: Any, side: str, joint: Any, pose: np.ndarray) -> None:
    """Mark a joint's frame on a body; a hinge's by the two ends of its axis, z."""
    for end, shift in enumerate(_shifts(joint)):
        at = pose[:3, 3] + shift * pose[:3, 2]
        body.add_site(name=f"{joint.arm}/{side}{end}", pos=at, quat=_quaternion(pose[:3, :3]))


def _add_joint(spec: Any, joint: Any, options: dict[str, Any]) -> None:
    kind = mujoco.mjtEq.mjEQ_WELD if joint.kind == "weld" else mujoco.mjtEq.mjEQ_CONNECT
    for end in range(len(_shifts(joint))):
        spec.add_equality(
            type=kind,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=f"{joint.arm}/object{end}",
            name2=f"{joint.arm}/arm{end}",
            **options,
        )


def _shifts(joint: Any) -> tuple[float, ...]:
    return joint_ends(joint, "MuJoCo has no equality constraint")


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    return np.roll(matrix_to_quaternion(rotation), 1)


class TorqueTape:
    """Rows of torques that :attr:`play` copies to ``target``, one a call; the last one stays.

    Parameters
    ----------
    target : ndarray, shape (n,)
        Where the program reads its torques; must stay where it is.

    Attributes
    ----------
    play : ctypes function ``void (void *, void *)``
        It looks at none of its arguments.
    """

    def __init__(self, target: np.ndarray):
        assert target.flags.c_contiguous and target.dtype == np.float64
        self._target, self._rows = target, np.zeros((0, target.size))
        self._state = np.zeros(3, dtype=np.int64)  # the rows' address, the next one, the last one
        address, width, place = self._state.ctypes.data, target.size, target.ctypes.data

        @cfunc(types.void(types.intp, types.intp))
        def play(_model, _data):
            state, out = struct_at(address, 3), floats_at(place, width)
            row = floats_at(state[0] + 8 * width * state[1], width)
            for i in range(width):
                out[i] = row[i]
            state[1] = min(state[1] + 1, state[2])

        self._function = play
        self.play = play.ctypes

    def load(self, rows: np.ndarray) -> None:
        """Put rows (K, n) on the tape, and go to the first."""
        self._rows = np.ascontiguousarray(rows, dtype=float)
        self._state[:] = self._rows.ctypes.data, 0, len(rows) - 1
