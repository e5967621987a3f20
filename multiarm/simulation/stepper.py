"""`Stepper`: a simulation that is advanced from outside, as a control loop or a learner does.

A stepper holds one run (:mod:`multiarm.simulation.run`) and moves its end on with every call.  It
has the steps, events and numbers of a run whose control is sampled where the calls begin.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NoReturn

import numpy as np

from multiarm.dynamics.data import Data
from multiarm.dynamics.state import State, fill_by_arm
from multiarm.dynamics.status import OK
from multiarm.dynamics.system import System, require_system
from multiarm.errors import ControlError, ModelError, SolverError
from multiarm.integration.step_control import shortest_step
from multiarm.public import public_names
from multiarm.results.channels import channels_of, in_sequence
from multiarm.results.outcome import RunStatus
from multiarm.results.sinks import MemorySink
from multiarm.results.trajectory import Trajectory
from multiarm.scene import AccuracySpec
from multiarm.scene.faults import shown, unknown
from multiarm.scene.values import is_finite
from multiarm.simulation.driver import Driver, End, Ending, failure_of, state_of, where_of
from multiarm.simulation.record import open_sink, run_statistics
from multiarm.simulation.run import begin
from multiarm.simulation.setup import Run, Task, check_control_span, run_spec

Torques = Mapping[str, np.ndarray]
# Durations are equal, and times are those of samples, up to this part of them.
SAME_TIME = 1e-9


class Stepper:
    """A system that is advanced by pieces of time, with torques that are held over each.

    The state between two calls is on the constraints.  What is not given is taken from the scene's
    ``run``, as in :func:`multiarm.simulate`; there is no certificate.

    Parameters
    ----------
    system : System
    state : State, optional
        Where it begins, at t = 0; the scene's start by default.
    accuracy : float or dict, optional
        Chooses method and tolerances, as for an unchecked run of this accuracy [m, rad].
    integrator, step, tolerance, stabilization, solver, max_step
        As in :func:`multiarm.simulate`.
    record : bool
        Keep samples for :meth:`trajectory`.
    output_step : float, optional
        Time between recorded samples [s].

    Raises
    ------
    SceneError
        When the settings contradict each other.
    SolverError, ControlError
        When the start cannot be evaluated.
    """

    def __init__(
        self,
        system: System,
        state: State | None = None,
        accuracy: float | Mapping[str, float] | AccuracySpec | None = None,
        *,
        integrator: str | None = None,
        step: float | None = None,
        tolerance: float | None = None,
        stabilization: str | dict | None = None,
        solver: str | None = None,
        max_step: float | None = None,
        record: bool = False,
        output_step: float | None = None,
    ) -> None:
        system = require_system(system, "ma.Stepper(system)")
        state = None if state is None else system.checked(state)
        spec = run_spec(
            system.scene.run,
            {
                "accuracy": accuracy,
                "integrator": integrator,
                "step": step,
                "tolerance": tolerance,
                "stabilization": stabilization,
                "output_step": output_step,
                "solver": solver,
            },
        )
        system = system.with_solver(spec.solver)
        if max_step is None:
            max_step = spec.output_step if system.model.calls_user else math.inf
        held = replace(system, model=system.model.with_held_control())
        self._task = Task(held, Data(held.model), spec, state, max_step)
        self._records = record
        self._layout, self._channels = system.model.layout, held.channels
        self._places: dict[str, dict[str, slice]] = {}  # quantity -> arm -> columns of samples
        self._torques = np.zeros(self._layout.rate_count)
        self.reset()

    __dir__ = public_names

    def __repr__(self) -> str:
        return f"Stepper(t = {self.time:.6g} s: {self._layout})"

    # --- what it shows ------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Where it is [s]."""
        return self._run.clock.t

    @property
    def state(self) -> State:
        """The state there, a copy."""
        return state_of(self._run, self._layout)

    @property
    def contact_forces(self) -> dict[str, np.ndarray]:
        """Contact forces of each arm's joint [N] there, under the torques of the last call.

        As in :attr:`multiarm.Trajectory.contact_forces`; those of open contacts are zero.
        """
        return self._present("contact_force")

    @property
    def wrenches(self) -> dict[str, np.ndarray]:
        """Wrench of each arm on the object there, as in :attr:`multiarm.Trajectory.wrenches`."""
        return self._present("wrench")

    @property
    def tip_positions(self) -> dict[str, np.ndarray]:
        """Origin of each arm's tip frame there, world axes, shape (3,) [m]."""
        return self._present("tip_position")

    @property
    def tip_quaternions_xyzw(self) -> dict[str, np.ndarray]:
        """Orientation of each arm's tip frame there, scalar last, shape (4,)."""
        return self._present("tip_quaternion_xyzw")

    @property
    def tip_twists(self) -> dict[str, np.ndarray]:
        """Velocity of each tip's origin [m/s] and angular velocity [rad/s] there, world, (6,)."""
        return self._present("tip_twist")

    @property
    def events(self) -> list[dict]:
        """Events since the start, as in :attr:`multiarm.Trajectory.events`."""
        return self._run.log.entries()

    def trajectory(self) -> Trajectory:
        """The recorded samples up to now, and the present, as the result of a run.

        Raises
        ------
        SolverError
            When nothing was recorded.
        """
        if not self._records:
            raise SolverError("trajectory: nothing was recorded; make it `Stepper(record=True)`")
        driver, task, sink = self._driver, self._task, MemorySink()
        # the scene's run is as long as this one is now
        spec = task.spec.model_copy(update={"duration": self.time or task.spec.duration})
        about = {"control": "torques given to a stepper"} if self._driven else {}
        open_sink(sink, task.system, spec, task.state is not None, **about)
        driver.flush()
        for block in self._samples.blocks:
            sink.append(block)
        if not self._is_at_sample(self._run.clock.sample - 1):  # the last one that was recorded
            sink.append(self._observe()[None])
        message = f"advanced to t = {self.time:.9g} s"
        statistics, events = run_statistics(driver).as_dict(), driver.run.log.entries()
        return sink.finish(RunStatus.COMPLETED, message, statistics, events).of(task.system.scene)

    # --- what it does -------------------------------------------------------------------------

    def reset(self, state: State | None = None) -> None:
        """Go back to t = 0, to ``state``; by default to where it began last.

        Raises
        ------
        ModelError
            When ``state`` is none of this system.
        SolverError, ControlError
            When the start cannot be evaluated.
        """
        task = self._task
        if state is not None:
            task = replace(task, state=task.system.checked(state))
        self._dead_end: Ending | None = Ending(End.FAILED, "the start could not be evaluated")
        # times are multiples of equal durations, so that they do not add up roundings
        self._from, self._count, self._duration = 0.0, 0, 0.0
        self._begin(task, None)
        self._dead_end = None

    def advance(self, duration: float, torques: Torques | None = None) -> State:
        """Advance by a duration [s]; returns the state at its end.

        Parameters
        ----------
        duration : float
            [s]
        torques : dict, optional
            Arm -> joint torques [N m] or forces [N], which are held over the call; arms that are
            not named get none.  None: the control of the system goes on, evaluated all the time or
            at its samples, which are the multiples of its ``sample_time``; after other torques
            it takes one at once.

        Raises
        ------
        ControlError
            For torques that do not fit the arms.
        SolverError
            When the motion cannot go on, with the place and a remedy; the stepper stays at the end
            of the last good step.  It can be advanced with other torques from there, or be reset;
            after an event that cannot be handled it has to be reset.
        """
        if not is_finite(duration) or not duration > 0.0:
            raise SolverError(
                f"advance: the duration must be finite and greater than 0 s, got {shown(duration)}"
            )
        if self._dead_end:
            raise SolverError(f"{self._dead_end.message}; `reset` it")
        t, end = self.time, self._end_after(duration)
        if not end - t > shortest_step(t):
            raise SolverError(
                f"advance: {duration:.2g} s are lost in the roundings of t = {t:.9g} s; advance by "
                f"more than {shortest_step(t):.1g} s"
            )
        if torques is None:
            check_control_span(self._task.data.model, 0.0, end)
        self._control(torques)
        self._extend(end)
        ending = self._driver.drive()
        if ending.end is End.UNDECIDED:
            self._dead_end = ending
        if ending.end is not End.COMPLETED:
            self._fail(ending)
        return state_of(self._run, self._layout)

    def attach(self, joint: str) -> None:
        """Let a joint take hold now, by its name: the arm, or as results have it.

        A joint that holds for some of the time only can be commanded: one with `from`, or with
        `until: never`.  The command takes the place of its next time or event.  Taking hold is an
        impact without restitution, see the event "attached" in :attr:`events`.

        Raises
        ------
        ModelError
            When there is no such joint, or it holds already.
        SolverError
            When its bodies are too far apart or move too fast: it stays as it is.  When the motion
            cannot go on: it has to be reset.
        """
        self._switch(joint, True)

    def detach(self, joint: str) -> None:
        """Let a joint let go now; all velocities stay, forces jump.  See :meth:`attach`.

        Raises
        ------
        ModelError
            When there is no such joint, or it does not hold.
        SolverError
            When the motion cannot go on.
        """
        self._switch(joint, False)

    @property
    def attached(self) -> tuple[str, ...]:
        """The joints that hold, in the scene's order."""
        events, holding = self._driver.events, set()
        timed = self._timed
        if events is not None:
            holding = {timed[k] for k in events.modes.holding}
        joints = self._task.system.model.connections
        return tuple(name for name in joints if name not in timed or name in holding)

    @property
    def _timed(self) -> list[str]:
        """Names of the joints that can be commanded."""
        return [joint.connection for joint in self._task.system.model.timed_joints]

    def _switch(self, joint: str, holds: bool) -> None:
        timed, verb = self._timed, "attach" if holds else "detach"
        if self._dead_end:
            raise SolverError(f"{self._dead_end.message}; `reset` it")
        if joint not in timed:
            if joint in self._task.system.model.connections:
                raise ModelError(
                    f"{verb}: joint {joint!r} holds all the time; write `until: never` in the "
                    "scene for one that is let go by command, `from: never` for one that takes hold"
                )
            raise ModelError(f"{verb}: {unknown('joint', joint, timed)}")
        if (joint in self.attached) == holds:
            raise ModelError(f"{verb}: joint {joint!r} {'holds already' if holds else 'is open'}")
        events, run = self._driver.events, self._run
        assert events is not None, "it has timed joints"
        fault = events.command(run, timed.index(joint))
        self._commanded = True
        if fault:
            self._dead_end = Ending(End.UNDECIDED, f"{where_of(run)}: {fault}")
            raise SolverError(self._dead_end.message)

    def _begin(self, task: Task, torques: np.ndarray | None) -> None:
        """Bring a task to its start, where ``torques`` are held, or those of its own control."""
        samples = MemorySink()
        self._commanded = False
        task.data.hold(torques)
        self._held = torques is not None
        driver = begin(task, samples)
        open_sink(samples, task.system, task.spec, task.state is not None)
        run = driver.run
        if torques is not None:
            run.clock.hold_control()
        self._task = task
        self._driver: Driver = driver
        self._run: Run = run
        self._samples, self._driven = samples, self._held
        self._row = np.zeros(run.block.shape[1])

    def _end_after(self, duration: float) -> float:
        t = self._run.clock.t
        count = self._count + 1
        if duration != self._duration or self._from + self._count * duration != t:
            self._from, self._duration, count = t, duration, 1
        self._count = count
        return self._from + count * duration

    def _control(self, torques: Torques | None) -> None:
        """Let the torques act from now on; None: those of the system's control."""
        run = self._run
        if torques is None:
            if self._held:
                run.data.hold(None)
                self._held = False
                sampling = self._task.data.model.sampling
                run.clock.sample_control(math.inf if sampling is None else sampling.time)
            return
        self._torques[:] = 0.0
        fill_by_arm("torques", self._layout, self._torques, torques, ControlError)
        if run.clock.t == run.settings.begin and not self._commanded:
            # the start, and the first step, are those under these torques
            self._begin(self._task, self._torques)
            return
        run.data.hold(self._torques)
        self._held = self._driven = True
        run.clock.sample_control()

    def _extend(self, end: float) -> None:
        """Move the end of the run on; samples at its new end belong to the next call."""
        count = 0
        if self._records:
            self._record_present()
            count = math.ceil(end / self._run.settings.sample_step - SAME_TIME)
        self._run.clock.extend(end, count)
        if self._driver.events is not None:
            self._driver.events.stop_at_switch(self._run)

    def _record_present(self) -> None:
        """Record the present if a sample is due, with the torques that act from now on."""
        if self._is_at_sample(self._run.clock.sample):
            self._driver.write_sample(self._observe())

    def _is_at_sample(self, k: int) -> bool:
        """Whether the present is the time of sample ``k``."""
        step = self._run.settings.sample_step
        return abs(k * step - self._run.clock.t) <= SAME_TIME * step

    def _fail(self, ending: Ending) -> NoReturn:
        """Raise why the run cannot go on; the next call begins with a usual step again."""
        run, events = self._run, self._driver.events
        run.clock.begin_after_failure()
        if events is not None:
            events.forget_pending(run)
        run.data.forgive()
        if ending.end is End.INTERRUPTED:
            raise KeyboardInterrupt
        raise SolverError(ending.message)

    def _present(self, quantity: str) -> dict[str, np.ndarray]:
        """A quantity of each arm, and of the floor where it has one, there; copies."""
        if quantity not in self._places:
            names = channels_of({channel.name: channel for channel in self._channels}, quantity)
            columns = in_sequence(self._channels)
            self._places[quantity] = {arm: columns[name] for arm, name in names.items()}
        row = self._observe()
        return {arm: row[place].copy() for arm, place in self._places[quantity].items()}

    def _observe(self) -> np.ndarray:
        """The present as a row of samples."""
        status = self._driver.observe(self._row)
        if status != OK:
            self._fail(failure_of(self._run, status))
        return self._row
