"""A run with known physics for tests of results: a driven, damped pendulum carried by two arms.

The object (mass m on a massless rod of length L) swings in the x-z plane,

    theta'' = -(g/L) sin(theta) - d theta' + u cos(w t),

and drive and damper do the work W' = m L^2 theta' (u cos(w t) - d theta'). Integrated with RK4,
energy balance is small but not zero, as in a real run.
"""

import importlib
import resource
import sys

import numpy as np

from multiarm.errors import TrajectoryError
from multiarm.results.channels import trajectory_channels
from multiarm.results.sinks import Hdf5Sink, MemorySink

MASS, LENGTH, GRAVITY, DAMPING = 20.0, 0.9, 9.81, 0.25  # [kg], [m], [m/s^2], [1/s]
JOINTS = {
    "left": {
        f"{name}_joint": "rad"
        for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    },
    "right": {"rail": "m", "swivel": "rad", "tilt": "rad"},
}
CONTACTS = {
    "left": ["face_x", "face_y", "face_z", "turn_x", "turn_y", "turn_z"],
    "right": ["x", "y", "z"],
}
CHANNELS = trajectory_channels(JOINTS, CONTACTS, controlled=True)
SCENE = "name: two arms & a <pendulum>\ngravity: [0, 0, -9.81]\n"
STATISTICS = {
    "steps": 1234, "rejected_steps": 17, "evaluations": 9876, "wall_time_s": 0.42,
    "realtime_factor": 14.3, "error_estimate": 3.2e-8, "integrator": "dop853",
}  # fmt: skip


def samples(duration=6.0, step=0.01):
    """All channels of the pendulum as one block."""
    time = np.arange(0, duration + step / 2, step)
    theta, omega, work = _pendulum(time).T
    sine, cosine, zero = np.sin(theta), np.cos(theta), np.zeros_like(theta)
    tension = MASS * (LENGTH * omega**2 + GRAVITY * cosine)
    block = {
        "time": time,
        "object/position": LENGTH * np.column_stack([sine, zero, -cosine]) + [0, 0, 1.4],
        "object/quaternion_xyzw": np.column_stack(
            [zero, -np.sin(theta / 2), zero, np.cos(theta / 2)]
        ),
        "object/twist": np.column_stack(
            [LENGTH * omega * cosine, zero, LENGTH * omega * sine, zero, -omega, zero]
        ),
        "energy/kinetic": 0.5 * MASS * (LENGTH * omega) ** 2,
        "energy/potential": MASS * GRAVITY * LENGTH * (1 - cosine) - 123.0,
        "energy/work": work,
        "drift/position": 2e-9 * np.abs(np.sin(3 * time)) * time,
        "drift/velocity": 4e-8 * np.abs(np.cos(5 * time)) * (time > 0),
        "solver/rank": np.full_like(time, 12.0),
        "solver/coupled_arms": np.zeros_like(time),
        "solver/residual": 3e-15 * np.abs(np.sin(7 * time)),
    }
    for arm, share in (("left", 0.6), ("right", 0.4)):
        rod = np.column_stack([-sine, zero, cosine, zero, zero, zero])
        block[f"arms/{arm}/wrench"] = share * tension[:, None] * rod
        for quantity in ("position", "quaternion_xyzw", "twist"):
            block[f"arms/{arm}/tip_{quantity}"] = block[f"object/{quantity}"]
        joint = np.arange(len(JOINTS[arm]))
        block[f"arms/{arm}/joint_position"] = np.outer(theta, 0.9**joint) + 0.3 * joint
        block[f"arms/{arm}/joint_velocity"] = np.outer(omega, 0.9**joint)
        block[f"arms/{arm}/joint_torque"] = np.outer(share * tension, 0.25 * 0.6**joint)
        drives = block[f"arms/{arm}/joint_torque"] * block[f"arms/{arm}/joint_velocity"]
        block[f"arms/{arm}/control_power"] = drives.sum(axis=1)
        row = np.arange(len(CONTACTS[arm]))
        block[f"arms/{arm}/contact_force"] = share * np.cos(row) * tension[:, None]
    return block


def rows_of(channels, block):
    """A block of samples as rows, in which the channels follow each other."""
    columns = [np.asarray(block[channel.name], dtype=float) for channel in channels]
    return np.column_stack([v.reshape(len(columns[0]), -1) if v.size else v for v in columns])


def record(sink, blocks=None, status="completed", message="", metadata=None, **results):
    """Pour blocks of samples into a sink, with a checkpoint after each."""
    sink.open(CHANNELS, {"scene": SCENE} if metadata is None else metadata)
    for block in [samples()] if blocks is None else blocks:
        sink.append(rows_of(CHANNELS, block))
        sink.checkpoint()
    return sink.finish(status, message, results.pop("statistics", STATISTICS), **results)


OBJECTS = ("beam", "plate")
CORNERS = {"floor/beam": ["corner_1", "corner_2"], "floor/plate": ["corner_1"]}
CHANNELS_OF_TWO = trajectory_channels(
    JOINTS, CONTACTS, environment=CORNERS, controlled=True, objects=OBJECTS
)


def samples_of_two(shift=(0.0, 0.0, 0.0), turn=0.0):
    """The pendulum as `beam`, and a plate that goes half as far, moved and turned about z."""
    block = samples()
    position = block.pop("object/position")
    quaternion, twist = block.pop("object/quaternion_xyzw"), block.pop("object/twist")
    rest = np.tile([0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)], (len(position), 1))
    block |= {
        "objects/beam/position": position,
        "objects/beam/quaternion_xyzw": quaternion,
        "objects/beam/twist": twist,
        "objects/plate/position": 0.5 * position + shift,
        "objects/plate/quaternion_xyzw": rest,
        "objects/plate/twist": 0.5 * twist * [1, 1, 1, 0, 0, 0],
    }
    time = block["time"]
    for owner, names in CORNERS.items():
        path = owner.replace("floor", "environment")
        block[f"{path}/contact_force"] = np.outer(time, np.arange(1.0, len(names) + 1))
        block[f"{path}/wrench"] = np.outer(time, [0.0, 0.0, len(names), 0.0, 0.0, 0.0])
    return block


def record_two(sink, block=None, **results):
    """A run with two objects."""
    sink.open(CHANNELS_OF_TWO, {"scene": SCENE})
    sink.append(rows_of(CHANNELS_OF_TWO, samples_of_two() if block is None else block))
    return sink.finish("completed", "", STATISTICS, **results)


def earlier_run(run):
    """The run as a version has it that did not record wrenches, tips and powers."""
    later = ("wrench", "tip_position", "tip_quaternion_xyzw", "tip_twist", "control_power")
    channels = [c for c in run.channels.values() if c.name.rpartition("/")[2] not in later]
    sink = MemorySink()
    sink.open(channels, run.provenance)
    sink.append(rows_of(channels, {c.name: run.channel(c.name) for c in channels}))
    return sink.finish(run.status, run.message, run.statistics)


def _pendulum(time):
    def rate(t, state):
        theta, omega, _ = state
        drive = 3.0 * np.cos(2.2 * t) - DAMPING * omega
        inertia = MASS * LENGTH**2
        return np.array([omega, -GRAVITY / LENGTH * np.sin(theta) + drive, inertia * omega * drive])

    states = [np.array([0.6, 0.0, 0.0])]
    for t, h in zip(time[:-1], np.diff(time), strict=True):
        s = states[-1]
        k1 = rate(t, s)
        k2 = rate(t + h / 2, s + h / 2 * k1)
        k3 = rate(t + h / 2, s + h / 2 * k2)
        k4 = rate(t + h, s + h * k3)
        states.append(s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return np.array(states)


def numbered_block(start, stop):
    """Samples start..stop whose numbers tell where they belong: sample + column / 100."""
    index = np.arange(start, stop, dtype=float)
    return {
        channel.name: index.reshape(-1, *[1] * len(channel.shape))
        + np.arange(np.prod(channel.shape, dtype=int)).reshape(channel.shape) / 100
        for channel in CHANNELS
    }


def write_for_long(path, size):
    """Write many blocks of `size` samples, and say on stdout how many samples are safe."""
    sink = Hdf5Sink(path)
    sink.open(CHANNELS, {"scene": SCENE})
    for start in range(0, 20_000 * size, size):
        sink.append(rows_of(CHANNELS, numbered_block(start, start + size)))
        sink.checkpoint()
        print(start + size, flush=True)


def write_until_the_disk_is_full(path, limit):
    """Write to a file that must not exceed `limit` bytes, and print how the run ended."""
    # else its bytecode would be cut short too
    importlib.import_module("multiarm.results.trajectory_file")
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    sink = Hdf5Sink(path)
    sink.open(CHANNELS, {"scene": SCENE})
    status, message = "completed", ""
    try:
        for start in range(0, 100_000, 100):
            sink.append(rows_of(CHANNELS, numbered_block(start, start + 100)))
            sink.checkpoint()
    except TrajectoryError as error:
        status, message = "failed", str(error)
    trajectory = sink.finish(status, message, {})
    print(len(trajectory), trajectory.status, trajectory.message, flush=True)
