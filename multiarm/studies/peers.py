"""Other programs behind one interface: their model of a system, and its motion.

Each peer has its best settings: models are built and torques tabulated outside the measured time,
and no Python is in a loop that can do without.  Torques of time alone are a :class:`Sinusoid`, a
motion is samples on a :class:`Grid`; what is compared of two programs' states is measured here.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, NamedTuple

import numpy as np

from multiarm.control.harmonic import harmonic
from multiarm.dynamics.equations import evaluate_state, update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.model import require_one_object
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.effects.joint_damping import JointDamping
from multiarm.errors import ModelError
from multiarm.geometry.poses import pose_matrix
from multiarm.robots.robot import Robot
from multiarm.scene import RunSpec
from multiarm.studies.timing import OutOfTime

PEERS = {
    "MuJoCo": "multiarm.studies.mujoco_peer:MujocoPeer",
    "MuJoCo as shipped": "multiarm.studies.mujoco_peer:MujocoAsShipped",
    "Pinocchio": "multiarm.studies.pinocchio_peer:PinocchioPeer",
}
"""Name -> module, which need not be importable here, and class of the peer."""
EXPRESSIBLE = ("weld", "ball", "revolute")
"""Kinds of joint that the peers have constraints for."""
NOT_INSTALLED = "not installed: pip install mujoco"
INSTALLED_BY = {"mujoco": NOT_INSTALLED}
"""Missing package -> why its peers cannot run."""


@dataclass(frozen=True)
class Sinusoid:
    """Torques that depend on time only, ``constant + sine sin(a) + cosine cos(a)``."""

    rate: float  # [rad/s]; ``a = rate t``
    constant: np.ndarray  # (n,) [N m] or [N], as the others
    sine: np.ndarray
    cosine: np.ndarray

    @classmethod
    def none(cls, n: int) -> Sinusoid:
        """No torques at ``n`` joints."""
        return cls(0.0, np.zeros(n), np.zeros(n), np.zeros(n))

    def __call__(self, t: float, _state: object = None) -> np.ndarray:
        """Torques at a time [s], shape (n,)."""
        angle = self.rate * t
        return self.constant + math.sin(angle) * self.sine + math.cos(angle) * self.cosine

    def at(self, times: np.ndarray) -> np.ndarray:
        """Torques at times [s], shape (times, n)."""
        angle = self.rate * np.asarray(times)[:, None]
        return self.constant + self.sine * np.sin(angle) + self.cosine * np.cos(angle)


Drive = Callable[[float, Callable[[], State]], np.ndarray]
"""Torques of the control at a time [s] and a state, which is computed when it is called for."""


@dataclass(frozen=True)
class Grid:
    """The times at which motions are compared: 0, interval, 2 interval, ..."""

    interval: float  # [s]
    intervals: int

    @classmethod
    def of(cls, run: RunSpec) -> Grid:
        """The output times of a run, without its end where no whole output step leads to it."""
        interval = min(run.output_step, run.duration)
        return cls(interval, math.floor(run.duration / interval * (1 + 1e-12)))

    @property
    def times(self) -> np.ndarray:
        """Shape (intervals + 1,) [s]."""
        return self.interval * np.arange(self.intervals + 1)

    def steps(self, step: float) -> int:
        """How many steps of a length make an interval; the length must divide it."""
        count = round(self.interval / step)
        assert count >= 1 and abs(count * step - self.interval) < 1e-9 * self.interval
        return count


class Sample(NamedTuple):
    """A motion at one time."""

    time: float  # [s]
    state: State

    @property
    def is_finite(self) -> bool:
        """Whether the motion has not diverged."""
        return bool(np.isfinite(self.state.position).all() & np.isfinite(self.state.velocity).all())


@dataclass
class Clock:
    """Wall time of a run, ``with clock: take_steps()``, and how many steps there were."""

    limit_s: float = math.inf  # the run ends with OutOfTime when it has taken longer, off it too
    wall_time_s: float = 0.0
    steps: int = 0
    evaluations: int = 0
    _first: float | None = None
    _begin: float = 0.0

    def __enter__(self) -> None:
        self._begin = time.perf_counter()
        self._first = self._first or self._begin

    def __exit__(self, kind: object, *_: object) -> None:
        self.wall_time_s += time.perf_counter() - self._begin
        if kind is None:
            self.check()

    def check(self) -> None:
        """Raise :class:`OutOfTime` when the limit is over."""
        if self._first is not None and time.perf_counter() - self._first > self.limit_s:
            raise OutOfTime

    def off_the_clock(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function whose own time does not count."""

        def call(*arguments: Any) -> Any:
            begin = time.perf_counter()
            result = function(*arguments)
            self.wall_time_s -= time.perf_counter() - begin
            return result

        return call


class Peer(ABC):
    """A program's model of a system; it adds the damping of the joints to all torques itself.

    A peer has two methods: one that builds its model, and :meth:`follow`.

    Parameters
    ----------
    system : System
        Welds, balls and hinges only.

    Attributes
    ----------
    methods : mapping of str to str
        Integrator -> what sets its accuracy, ``step`` or ``tolerance``.

    Raises
    ------
    ModelError
        The program cannot express the system.
    ImportError
        It is not installed.
    """

    methods: ClassVar[Mapping[str, str]]

    def __init__(self, system: System):
        require_one_object(system.model, "another program's model of a scene has one")
        self.system, self.damping = system, joint_damping(system)

    @abstractmethod
    def follow(
        self, clock: Clock, grid: Grid, start: State, method: str, value: float, drive: Drive
    ) -> Iterator[Sample]:
        """The motion from a state by a method and its step [s] or tolerance, as it is computed.

        Only the steps are on the clock, which counts them.  The samples are at the times of the
        grid; they go on when the state is no longer finite.
        """


def make_peers(
    system: System, peers: Mapping[str, str] = PEERS
) -> tuple[dict[str, Peer], dict[str, str]]:
    """The programs that can run a system by name, and why the others cannot.

    ``peers`` maps names to ``module:Class``, as ``PEERS`` does.
    """
    able: dict[str, Peer] = {}
    refusals: dict[str, str] = {}
    # no other program here has another effect
    strange = sorted(set(system.scene.effects.named) - {"joint_damping"})
    for name, place in peers.items():
        module, _, kind = place.partition(":")
        try:
            if strange:
                refusals[name] = f"cannot express {', '.join(strange)}"
            elif system.scene.robots:
                refusals[name] = "cannot express robots with tips by name, only arms"
            elif system.model.timed_joints:
                refusals[name] = "is run here with joints that hold all the time only"
            else:
                able[name] = getattr(import_module(module), kind)(system)
        except ModelError as error:
            refusals[name] = f"cannot express it: {error}"
        except ImportError as error:
            refusals[name] = INSTALLED_BY.get(error.name or "", f"cannot be loaded: {error}")
    return able, refusals


@dataclass(frozen=True)
class Link:
    """A link of an arm, moved by one joint."""

    parent: int  # number of the link before it; 0 is the world
    placement: Any  # pinocchio.SE3 of the joint on the parent
    inertia: Any  # pinocchio.Inertia
    turns: bool  # the joint turns about its axis; else it slides along it
    axis: np.ndarray  # (3,), in the link's axes


def links(arm: Robot) -> Iterator[Link]:
    """The links of an arm, from its base on; their numbers begin with 1."""
    model = arm.model
    q = arm.configuration(np.zeros(arm.dof))
    for i in range(1, model.njoints):
        data = model.joints[i].createData()
        model.joints[i].calc(data, q)
        slide, turn = np.split(np.array(data.S).reshape(6), 2)
        turns = bool(np.any(turn))
        axis = turn if turns else slide
        yield Link(model.parents[i], model.jointPlacements[i], model.inertias[i], turns, axis)


def tip_frame(system: System, name: str) -> np.ndarray:
    """The frame of an arm's joint to the object on the link of its tip, shape (4, 4)."""
    tip = system.arms[name].tip
    return pose_matrix(tip.rotation, tip.translation) @ system.frames[name].on_tip


def joint_ends(joint: Any, lacks: str) -> tuple[float, ...]:
    """Places on a joint's z axis where a program constrains it: a hinge is two balls on its axis.

    Raises
    ------
    ModelError
        For another kind of joint; the message begins with what the program ``lacks``.
    """
    if joint.kind not in EXPRESSIBLE:
        raise ModelError(f"{lacks} for {joint.kind}; only {', '.join(EXPRESSIBLE)}")
    return (-joint.size / 2.0, joint.size / 2.0) if joint.kind == "revolute" else (0.0,)


def moments(inertia: np.ndarray) -> list[float]:
    """``[xx, yy, zz, xy, xz, yz]`` of an inertia matrix."""
    xx, xy, xz, yy, yz, zz = inertia[np.triu_indices(3)]
    return [xx, yy, zz, xy, xz, yz]


# --- observables of a system at one state ---------------------------------------------------------


def sinusoid(system: System) -> Sinusoid | None:
    """The torques of a scene whose control looks at the clock only; None where it looks at more."""
    n = system.model.layout.rate_count
    if not is_controlled(system):
        return Sinusoid.none(n)
    laws, sampled = system.model.laws, system.model.sampling is not None
    if sampled or len(laws) != 1 or laws[0].kernel is not harmonic:
        return None
    torques = laws[0].numbers
    return Sinusoid(2.0 * np.pi * torques.frequency, torques.constant, torques.sine, torques.cosine)


def control_torque(system: System, t: float, state: State) -> np.ndarray:
    """Torques of the scene's control at time ``t``, shape (n,), without damping."""
    if not is_controlled(system):
        return np.zeros(system.model.layout.rate_count)
    with system.borrow() as data:
        data.set_state(t, state)
        evaluate_state(data.struct, 0.0, 0.0)  # torques are there whatever the solver says
        data.forgive()
        return data.arrays.control.torque.copy()


def is_controlled(system: System) -> bool:
    """Whether anything drives the arms."""
    return system.model.constants.control.shape[0] > 0


def largest_gap(system: System, state: State) -> float:
    """Largest gap of a contact [m]."""
    with system.borrow() as data:
        data.set_state(0.0, state)
        require_ok(data, update_kinematics(data.struct))
        return float(np.max(np.abs(data.contact_rows.gap), initial=0.0))


def joint_damping(system: System) -> np.ndarray:
    """Coefficients of the joints' viscous friction, zero without that effect, shape (n,)."""
    for kernel in system.model.effects.kernels:
        if isinstance(kernel.arrays, JointDamping):
            return kernel.arrays.coefficients.copy()
    return np.zeros(system.model.layout.rate_count)
