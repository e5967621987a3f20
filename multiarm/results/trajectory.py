"""The result of a run: samples, outcome and provenance.

A `Trajectory` is a read-only view of arrays in memory or of a file. A channel is read from the file
on first use, so that memory holds only channels in use.

Two quantities measure the quality of a run, both 0 when it is exact: the energy balance
(:mod:`multiarm.results.energy`), and the drift, max |phi| and max |W^T v|: how far the contacts are
from closing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from multiarm.errors import SceneError, TrajectoryError
from multiarm.notation import count_of
from multiarm.public import facts_html, public_names
from multiarm.results.channels import (
    Channel,
    arm_names,
    base_names,
    channels_of,
    contact_owners,
    named_object_paths,
    object_paths,
    work_channels,
)
from multiarm.results.energy import energy_at_start, energy_balance
from multiarm.results.event_log import CLAUSE_SEPARATOR
from multiarm.results.files import atomic_file
from multiarm.results.limit_use import JointUse, joint_uses, largest_shares, percent
from multiarm.results.outcome import Outcome, RunStatus, plain
from multiarm.results.summary import summarise

if TYPE_CHECKING:
    from multiarm.scene import Scene


class Store(Protocol):
    """The samples of a trajectory, in memory or in a file."""

    samples: int
    channels: dict[str, Channel]

    @property
    def path(self) -> Path | None:
        """The file; None in memory."""

    @property
    def metadata(self) -> dict[str, Any]:
        """Provenance, and the scene's text under `scene`."""

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Samples start..stop of a channel."""

    def close_between_reads(self) -> None:
        """Open the file for each read only."""

    def close(self) -> None:
        """Release the samples; further reads are an error."""


class _MissingNameError(TrajectoryError, KeyError):
    """A KeyError whose text is a sentence."""

    def __str__(self) -> str:
        return str(self.args[0])


class ByArm(Mapping[str, np.ndarray]):
    """One quantity of every arm, or connection, and of the floor where it has contacts.

    Read on access.
    """

    def __init__(self, quantity: str, names: dict[str, str], read: Callable[[str], np.ndarray]):
        self._quantity, self._names, self._read = quantity, names, read

    def __getitem__(self, arm: str) -> np.ndarray:
        if not self._names:
            raise _MissingNameError(
                f"this result has no channels '{self._quantity}': it is that of an earlier version "
                "of multiarm; run the scene again"
            )
        if arm not in self._names:
            known = ", ".join(map(repr, self._names))
            noun = "connection" if any("/" in name for name in self._names) else "arm"
            raise _MissingNameError(f"unknown {noun} {arm!r}; {noun}s are {known}")
        return self._read(self._names[arm])

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


class FrameChannels:
    """Motion of an object, or of a robot's floating base; read on access.

    The frame of an object is at its centre of mass, that of a base is the frame of its root link.
    """

    def __init__(self, read: Callable[[str], np.ndarray], prefix: str):
        self._read, self._prefix = read, prefix

    __dir__ = public_names

    @property
    def position(self) -> np.ndarray:
        """Origin of the frame in world axes, shape (K, 3) [m]."""
        return self._read(f"{self._prefix}position")

    @property
    def quaternion_xyzw(self) -> np.ndarray:
        """Orientation of the frame, scalar last, shape (K, 4)."""
        return self._read(f"{self._prefix}quaternion_xyzw")

    @property
    def twist(self) -> np.ndarray:
        """Velocity of the origin [m/s], angular velocity [rad/s], world, shape (K, 6)."""
        return self._read(f"{self._prefix}twist")


class _ByName(dict[str, FrameChannels]):
    """Motions by the names of objects or robots."""

    def __init__(self, noun: str, motions: Mapping[str, FrameChannels]):
        super().__init__(motions)
        self._noun = noun

    def __missing__(self, name: str) -> FrameChannels:
        known = f"those are {', '.join(map(repr, self))}" if self else "there is none"
        raise _MissingNameError(f"{name!r} is no {self._noun} of this result; {known}")


class Trajectory:
    """A run: samples, outcome and provenance. Read-only.

    Arrays have the K samples as leading axis. Per-arm channels are mappings from the arm's name;
    an arm has nv joints, base to tip, and N contacts. Where robots have several tips, channels of
    joints are by robot, ``joint_positions["cart"]``, those of contacts and tips by connection,
    ``contact_forces["cart/left"]``; a robot whose joints have rows of their own, such as couplings
    and stops, has these under its name.
    """

    __slots__ = ("_cache", "_outcome", "_scene", "_simulated", "_store")

    def __init__(self, store: Store, outcome: Outcome):
        self._store, self._outcome = store, outcome
        self._cache: dict[str, np.ndarray] = {}
        self._scene: Scene | None = None
        self._simulated: Scene | None = None

    __dir__ = public_names

    def __len__(self) -> int:
        return self._store.samples

    def __repr__(self) -> str:
        span = f", t = {self.time[0]:.6g} to {self.time[-1]:.6g} s" if len(self) else ""
        return f"Trajectory({count_of(len(self), 'sample')}{span}, {self.status})"

    def _repr_html_(self) -> str:
        span = f"{self.time[0]:.6g} to {self.time[-1]:.6g} s" if len(self) else "none"
        facts = {
            "status": self.status,
            "message": self.message,
            "samples": f"{len(self)}, {span}" if len(self) else span,
            "accuracy": (self.certificate or {}).get("text", "not checked"),
            "events": len(self.events) or "",
        }
        if len(self):
            shares = {
                name: share and percent(share) for name, share in largest_shares(self).items()
            }
            facts["of joint limits"] = ", ".join(
                f"{name} {share}" for name, share in shares.items() if share
            )
            facts["largest gap"] = f"{np.max(self.position_drift):.1g} m"
            facts["energy balance"] = f"{np.max(np.abs(self.energy_balance)):.1g} J"
        return facts_html("Trajectory", facts)

    def to_pandas(self) -> Any:
        """All channels as one table.

        Returns
        -------
        pandas.DataFrame
            One row a sample, with the time [s] as index; a column for each number, named
            ``channel/label``, such as ``arms/left/joint_position/elbow_joint``. ``attrs["units"]``
            maps columns to units.
        """
        import pandas

        columns: dict[str, np.ndarray] = {}
        units: dict[str, str] = {}
        for channel in self._store.channels.values():
            names = [f"{channel.name}/{label}" for label in channel.labels] or [channel.name]
            table = self.channel(channel.name).reshape(len(self), channel.width)
            columns.update(zip(names, table.T, strict=True))
            units.update(zip(names, channel.column_units, strict=True))
        time = pandas.Index(columns.pop("time"), name="time")
        frame = pandas.DataFrame(columns, index=time)
        frame.attrs["units"] = {name: unit for name, unit in units.items() if name != "time"}
        return frame

    @property
    def limit_use(self) -> Any:
        r"""How much of its limits each joint uses: the largest shares and their times.

        The limits are those of the robot's file, whether or not the scene enforces them. The share
        is 1 at the limit: :math:`|\tau| / \hat\tau` of the effort, with the torque of the drive
        (`joint_torques`: within limits and lag of the drive if the scene has any; friction is no
        part of it), :math:`|v| / \hat v` of the speed, and
        :math:`|q - (q_- + q_+)/2| / ((q_+ - q_-)/2)` of the range. Peaks between two stored samples
        are not seen.

        Returns
        -------
        pandas.DataFrame
            One row a joint, with the columns ``joint`` (``left/shoulder_pan_joint``), ``effort``,
            ``speed``, ``range`` (shares), and ``effort_time``, ``speed_time``, ``range_time`` [s],
            of the first such sample. NaN where the robot's file names no limit (an effort or a
            speed of 0 is none), and everywhere in results of earlier versions, which do not store
            the limits.

        Raises
        ------
        TrajectoryError
            The limits in the file cannot be read.
        """
        import pandas

        columns = tuple(JointUse("", None, None, None).row())
        frame = pandas.DataFrame([use.row() for use in joint_uses(self)], columns=columns)
        return frame.astype(dict.fromkeys(columns[1:], float))

    @property
    def channels(self) -> Mapping[str, Channel]:
        """Recorded quantities: name -> Channel (shape, unit, frame, description, labels)."""
        return dict(self._store.channels)

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Names of the arms and robots, in the order of the scene."""
        return arm_names(self._store.channels)

    def channel(self, name: str) -> np.ndarray:
        """All samples of a channel: cached, contiguous, not writeable."""
        if name not in self._cache:
            values = np.ascontiguousarray(self.read(name))
            values.flags.writeable = False
            self._cache[name] = values
        return self._cache[name]

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Samples start..stop of a channel, not cached."""
        if name not in self._store.channels:
            known = ", ".join(self._store.channels)
            raise TrajectoryError(f"unknown channel {name!r}; channels are {known}")
        return self._store.read(name, start, stop)

    def blocks(self, *names: str, samples: int = 8192) -> Iterator[list[np.ndarray]]:
        """The same samples of the named channels, a bounded number at a time."""
        for start in range(0, len(self), samples):
            yield [self.read(name, start, start + samples) for name in names]

    @property
    def time(self) -> np.ndarray:
        """Times of the samples, shape (K,) [s]."""
        return self.channel("time")

    @property
    def object_position(self) -> np.ndarray:
        """Centre of mass of the object in world axes, shape (K, 3) [m].

        Of a scene with several objects, :attr:`objects` has this and the two others.
        """
        return self._of_only_object("position")

    @property
    def object_quaternion_xyzw(self) -> np.ndarray:
        """Orientation of the object, scalar last, shape (K, 4)."""
        return self._of_only_object("quaternion_xyzw")

    @property
    def object_twist(self) -> np.ndarray:
        """Velocity of the centre of mass [m/s], angular velocity [rad/s], world, (K, 6)."""
        return self._of_only_object("twist")

    @property
    def objects(self) -> Mapping[str, FrameChannels]:
        """Object -> motion of its centre of mass; the object of ``object:`` is called so."""
        paths = named_object_paths(self._store.channels, self._store.metadata)
        motions = {name: FrameChannels(self.channel, f"{path}/") for name, path in paths.items()}
        return _ByName("object", motions)

    @property
    def bases(self) -> Mapping[str, FrameChannels]:
        """Robot -> motion of its base, of robots whose base floats."""
        names = base_names(self._store.channels)
        motions = {name: FrameChannels(self.channel, f"arms/{name}/base_") for name in names}
        return _ByName("robot with a floating base", motions)

    @property
    def joint_positions(self) -> Mapping[str, np.ndarray]:
        """Arm -> joint coordinates, shape (K, nv) [rad], sliding joints [m]."""
        return self._by_arm("joint_position")

    @property
    def joint_velocities(self) -> Mapping[str, np.ndarray]:
        """Arm -> joint velocities, shape (K, nv) [rad/s], sliding joints [m/s]."""
        return self._by_arm("joint_velocity")

    @property
    def joint_torques(self) -> Mapping[str, np.ndarray]:
        """Arm -> torques of its drives, shape (K, nv) [N m], sliding joints [N].

        They are the controller's, within the limits and the lag of the drives if the scene has any.
        """
        return self._by_arm("joint_torque")

    @property
    def control_power(self) -> dict[str, np.ndarray]:
        """Arm -> power of its drives, the sum of torque times joint velocity, shape (K,) [W].

        Its integral is the work of the control.  Empty for scenes without control, and in results
        of earlier versions.
        """
        names = channels_of(self._store.channels, "control_power")
        return {arm: self.channel(name) for arm, name in names.items()}

    @property
    def contact_forces(self) -> Mapping[str, np.ndarray]:
        """Arm, connection -> forces along the contact normals, shape (K, N) [N]; positive pushes.

        ``"floor"`` has those of the object's contacts with the floor, in scenes that have one; of
        several objects each has its own, ``"floor/beam"``.
        """
        return self._by_arm("contact_force")

    @property
    def wrenches(self) -> Mapping[str, np.ndarray]:
        """Arm, connection -> resultant of its contact forces on the second body, shape (K, 6).

        With friction; force [N] and moment [N m], world axes, about the object's centre of mass, on
        another body about the origin of the joint's frame there, as in
        :attr:`multiarm.Evaluation.wrenches`; ``"floor"``, or ``"floor/beam"``, has that of the
        floor, in scenes that have one.
        """
        return self._by_arm("wrench")

    @property
    def tip_positions(self) -> Mapping[str, np.ndarray]:
        """Arm, connection -> origin of its tip frame in world axes, shape (K, 3) [m].

        Of a connection between other bodies the frame of the first one, where that is a tip or a
        link; connections of the object with the world have none.
        """
        return self._by_arm("tip_position")

    @property
    def tip_quaternions_xyzw(self) -> Mapping[str, np.ndarray]:
        """Arm, connection -> orientation of its tip frame, scalar last, shape (K, 4).

        The first has ``w >= 0``; the others continue the one before, without jumps of the sign.
        """
        return self._by_arm("tip_quaternion_xyzw")

    @property
    def tip_twists(self) -> Mapping[str, np.ndarray]:
        """Arm, connection -> velocity of the tip's origin [m/s], angular one [rad/s], (K, 6)."""
        return self._by_arm("tip_twist")

    @property
    def contact_states(self) -> Mapping[str, np.ndarray]:
        """Arm, "floor" or "floor/beam" -> what each contact does, codes of `ContactState`, (K, N).

        0 open, 1 touching, 2 sliding, 3 sticking, 4 resting: touching, carried by other contacts.
        An arm without unilateral contacts has shape (K, 0).
        """
        return self._by_arm("contact_state", optional=True)

    @property
    def relative_motion(self) -> Mapping[str, np.ndarray]:
        """Arm -> rates alpha of its joint's free motions, (K, m) [m/s, rad/s]; see the labels.

        An arm whose joint has none has shape (K, 0).
        """
        return self._by_arm("relative_rate", optional=True)

    @property
    def relative_position(self) -> Mapping[str, np.ndarray]:
        """Arm -> coordinates of its joint's free motions, (K, m) [m, rad]; angles continue past pi.

        A single free rotation is given by its angle, several by the rotation vector.
        """
        return self._by_arm("relative_position", optional=True)

    @property
    def relative_motion_labels(self) -> dict[str, tuple[str, ...]]:
        """Arm -> names of its joint's free motions, such as ("slide z", "turn z")."""
        channels = self._store.channels
        names = channels_of(channels, "relative_rate")
        return {
            owner: channels[names[owner]].labels if owner in names else ()
            for owner in contact_owners(channels)
        }

    @property
    def kinetic_energy(self) -> np.ndarray:
        """Of the arms and the object, shape (K,) [J]."""
        return self.channel("energy/kinetic")

    @property
    def potential_energy(self) -> np.ndarray:
        """In the field of gravity, shape (K,) [J]."""
        return self.channel("energy/potential")

    @property
    def work(self) -> np.ndarray:
        """Done by control and effects since the start, shape (K,) [J]."""
        return self.channel("energy/work")

    @property
    def effect_works(self) -> dict[str, np.ndarray]:
        """Effect -> its work since the start, shape (K,) [J]; of effects that do work."""
        names = work_channels(self._store.channels)
        return {effect: self.channel(name) for effect, name in names.items()}

    @property
    def energy(self) -> np.ndarray:
        """Kinetic plus potential energy, shape (K,) [J]."""
        return self.kinetic_energy + self.potential_energy

    @property
    def energy_balance(self) -> np.ndarray:
        """Energy gained since the start less the work done, shape (K,) [J]; 0 if exact."""
        energies = self.kinetic_energy, self.potential_energy, self.work
        return energy_balance(*energies, self.energy_at_start)

    @property
    def energy_at_start(self) -> float:
        """Energy less work done at the first sample [J]: the energy at the start, if exact."""
        return energy_at_start(self)

    @property
    def position_drift(self) -> np.ndarray:
        """Largest gap of a contact, ``max |phi|``, shape (K,) [m]."""
        return self.channel("drift/position")

    @property
    def velocity_drift(self) -> np.ndarray:
        """Largest rate of a gap, ``max |W^T v|``, shape (K,) [m/s]."""
        return self.channel("drift/velocity")

    @property
    def rank(self) -> np.ndarray:
        """Independent constraints, shape (K,)."""
        return self.channel("solver/rank")

    @property
    def coupled_arms(self) -> np.ndarray:
        """Arms that could not be eliminated as a whole, shape (K,); 0: linear cost in the arms."""
        return self.channel("solver/coupled_arms")

    @property
    def residual(self) -> np.ndarray:
        """Largest residual of the constraints or of the object's motion, relative, shape (K,)."""
        return self.channel("solver/residual")

    @property
    def status(self) -> RunStatus:
        """One of "completed", "interrupted", "failed"."""
        return self._outcome.status

    @property
    def message(self) -> str:
        """How the run ended and, after a failure, the remedy; then the remarks."""
        return CLAUSE_SEPARATOR.join([self._outcome.message, *self._outcome.remarks])

    @property
    def remarks(self) -> list[str]:
        """What a user should know besides, such as that the scene is stiff, a clause each."""
        return list(self._outcome.remarks)

    @property
    def statistics(self) -> dict[str, Any]:
        """Steps, evaluations, wall time and the like: see `Outcome`."""
        return dict(self._outcome.statistics)

    @property
    def events(self) -> list[dict[str, Any]]:
        """Events in order of time, see :mod:`multiarm.results.event_log`."""
        return list(self._outcome.events)

    @property
    def certificate(self) -> dict[str, Any] | None:
        """Whether the required accuracy was reached; None for an unchecked run.

        ``met``, ``text`` (one sentence: ``verdict`` and ``details``), ``reason``; ``asked`` and
        ``estimated_error`` by ``position_m``, ``rotation_rad``, ``force_N``; ``by_output`` (name ->
        error, unit, time);
        ``over_time`` (time and the three errors); ``checks`` (energy, residual, drift: value,
        bound, unit, passed); ``growth_rate_per_s``; ``attempts`` (each run: tolerance, integrator,
        evaluations, wall_time_s, compile_time_s, errors, returned). The errors are estimates, from
        a rerun with smaller tolerances.
        """
        return self._outcome.certificate

    @property
    def provenance(self) -> dict[str, Any]:
        """Versions, platform, time of the run, and the scene's text under `scene`."""
        return dict(self._store.metadata)

    @property
    def scene_text(self) -> str:
        """The scene as YAML."""
        return self._store.metadata.get("scene", "")

    @property
    def scene(self) -> Scene:
        """The scene, parsed from its stored text on first use."""
        if self._scene is None:
            from multiarm.scene import parse_scene

            try:
                self._scene = parse_scene(self.scene_text, folder=None, code=False)
            except SceneError as error:
                where = "with this run" if self._store.path is None else f"in '{self._store.path}'"
                raise SceneError(error.faults, source=f"the scene stored {where}") from None
        return self._scene

    @property
    def simulated_scene(self) -> Scene:
        """The scene of a run made by this process, with its functions; else :attr:`scene`."""
        return self._simulated or self.scene

    def of(self, scene: Scene) -> Trajectory:
        """Set :attr:`simulated_scene`; returns this trajectory."""
        self._simulated = scene
        return self

    def summary(self) -> dict[str, Any]:
        """The run in a few numbers.

        Returns
        -------
        dict
            status, message, samples, duration_s; steps, rejected_steps, evaluations,
            wall_time_s (without compilation), compile_time_s (of all runs of its check
            together), realtime_factor, error_estimate as far as the run counted them;
            position_drift_max_m, velocity_drift_max_m_per_s, energy_balance_max_J (largest
            magnitudes); final_object_position [m] and final_object_quaternion_xyzw (lists), None
            with several objects; final_poses, by object: position [m] and quaternion_xyzw;
            contact_force_max_N, the largest magnitude per arm, and of the floor; wrench_max, per
            arm, and of the floor: force_N and moment_N_m, the largest magnitudes of force and
            moment on the object, at force_time_s and moment_time_s; limit_use: the rows of
            :attr:`limit_use` as ``joints``, and as ``largest`` the joint that uses most of its
            effort, speed and range (joint, share, time, and how many joints are beyond their
            limit); rank_lowest, rank_highest and coupled_steps. Numbers are finite; unknown ones
            are None.
        """
        return summarise(self)

    def save(self, path: str | os.PathLike) -> Path:
        """Write the trajectory to a file that `load_trajectory` reads; may be its own file.

        The file appears when it is complete. Memory does not grow with the length of the run.

        Raises
        ------
        TrajectoryError
            The path cannot be written, or holds a file that multiarm did not write.
        """
        from multiarm.results.hdf5 import writable_target
        from multiarm.results.trajectory_file import TrajectoryWriter

        target, names = writable_target(path), tuple(self._store.channels)
        with atomic_file(target) as partial:
            channels = tuple(self._store.channels.values())
            writer = TrajectoryWriter(partial, channels, self.provenance)
            for values in self.blocks(*names):
                writer.append(dict(zip(names, values, strict=True)))
            writer.finish(asdict(self._outcome))
        return Path(path)

    def with_outcome(self, **changes: Any) -> Trajectory:
        """The same samples, with some entries of `Outcome` changed."""
        return Trajectory(self._store, replace(self._outcome, **plain(changes)))

    def close_between_reads(self) -> Trajectory:
        """Open the file for each read only, as open files are limited; returns the trajectory."""
        self._store.close_between_reads()
        return self

    def close(self) -> None:
        """Release the file or the arrays of samples; cached channels stay."""
        self._store.close()

    def _of_only_object(self, quantity: str) -> np.ndarray:
        """A quantity of the object, where there is one."""
        paths = object_paths(self._store.channels)
        name, path = next(iter(paths.items()))
        if len(paths) > 1:
            raise TrajectoryError(
                f"there are {len(paths)} objects, {', '.join(paths)}; read "
                f"`objects[{name!r}].{quantity}`"
            )
        return self.channel(f"{path}/{quantity}")

    def _by_arm(self, quantity: str, optional: bool = False) -> ByArm:
        """A quantity's channels; ``optional``: an owner without one has no columns of it."""
        names = channels_of(self._store.channels, quantity)
        if optional:
            names = dict.fromkeys(contact_owners(self._store.channels), "") | names

        def read(name: str) -> np.ndarray:
            return self.channel(name) if name else np.empty((len(self), 0))

        return ByArm(quantity, names, read)


def require_trajectory(trajectory: Any, call: str) -> Trajectory:
    """The trajectory itself.

    Raises
    ------
    TrajectoryError
        When it is something else: ``call`` shows what is right.
    """
    if isinstance(trajectory, Trajectory):
        return trajectory
    from multiarm.scene.faults import shown

    raise TrajectoryError(
        f"a trajectory is needed, got {shown(trajectory)}; {call} with trajectory = "
        "ma.load_trajectory('run.h5') or ma.simulate(system)"
    )


def load_trajectory(path: str | os.PathLike) -> Trajectory:
    """Open a stored run; channels are read on first use.

    A run that was killed loads up to its last checkpoint, with status "interrupted".

    Parameters
    ----------
    path : path-like
        A file written by a run or by `Trajectory.save`.

    Raises
    ------
    TrajectoryError
        The file is missing, damaged, not a trajectory, or of a newer format.
    """
    from multiarm.results.trajectory_file import TrajectoryReader

    store = TrajectoryReader(path)
    if store.outcome is not None:
        return Trajectory(store, Outcome(**store.outcome))
    last = store.read("time", store.samples - 1)[0] if store.samples else None
    where = "before its first checkpoint" if last is None else f"at t = {last:.9g} s"
    message = f"the run was cut {where}: it was killed or is still running"
    return Trajectory(store, Outcome(RunStatus.INTERRUPTED, message))


def amend_file(path: str | os.PathLike, changes: dict[str, Any]) -> None:
    """Change entries of `Outcome` in the file of a complete run.

    A kill at any moment leaves the file unchanged or completely amended.

    Raises
    ------
    TrajectoryError
        The file does not hold a complete run, or the disk is full.
    """
    from multiarm.results.trajectory_file import amend

    amend(Path(path), plain(changes))
