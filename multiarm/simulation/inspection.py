"""Records of what a scene compiles to: plain facts in named fields, ready for a table or for JSON.

:func:`multiarm.simulation.checking.inspect_system` fills them in.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from multiarm.dynamics.evaluation import Residuals
from multiarm.dynamics.system import StartReport
from multiarm.results.trajectory import plain

__all__ = [
    "ArmFacts",
    "Carrying",
    "EffectFacts",
    "Freedom",
    "Inspection",
    "JointFacts",
    "LimitFacts",
    "ObjectFacts",
    "RunFacts",
]


@dataclass(frozen=True)
class ObjectFacts:
    """The common object: words for its shape, mass [kg], inertia about the centre of mass in object
    axes [kg m^2], start pose in the world [m].
    """

    shape: str
    mass: float
    inertia: list[list[float]]
    position: list[float]
    quaternion_xyzw: list[float]


@dataclass(frozen=True)
class ArmFacts:
    """One arm.

    Attributes
    ----------
    robot : str
        Name of the robot, or of its URDF file.
    urdf : str
        The file itself.
    tool : str or None
        Name of the tool, or of its URDF file.
    tip : str
    base_position, base_quaternion_xyzw : list of float
        Of the root link in the world [m].
    joints : dict joint -> "rad" or "m"
        Base to tip.
    posture : list of float
        At the (assembled) start [rad, m].
    locked : dict joint -> float
        Joints that are held fixed [rad, m].
    terms : str
        Who computes its inertia, forces and motion: "compiled" code or "pinocchio".
    not_compiled : str or None
        Why it stays with Pinocchio although compiled arms were wanted.
    conditioning : float or None
        Smallest relative pivot at the start; None where the dense solver is used.
    verdict : str or None
        "good", "near singular" or "cannot follow".
    lost_motions : list of str
        What an arm that cannot follow its joint in all directions cannot do.
    """

    robot: str
    urdf: str
    tool: str | None
    tip: str
    base_position: list[float]
    base_quaternion_xyzw: list[float]
    joints: dict[str, str]
    posture: list[float]
    locked: dict[str, float]
    terms: str
    not_compiled: str | None
    conditioning: float | None
    verdict: str | None
    lost_motions: list[str]


@dataclass(frozen=True)
class LimitFacts:
    """Limits of a joint's coordinate [rad, m], and its place at the start."""

    coordinate: str
    unit: str
    low: float
    high: float
    start: float


@dataclass(frozen=True)
class JointFacts:
    """The joint of one arm to the object, by itself, at the start.

    Attributes
    ----------
    arm, kind : str
    name : str or None
    rows : list of str
        Names of its constraint rows.
    rank : int
        How many of them are independent.
    redundant_rows : list of str
        Rows that depend on each other; empty when all are independent.
    free_motions : list of str
        What the tip can do on the object, along and about the axes of the joint's frame.
    coordinates : list of str
        The components that are recorded as the joint's coordinates.
    limits : list of LimitFacts
    """

    arm: str
    kind: str
    name: str | None
    rows: list[str]
    rank: int
    redundant_rows: list[str]
    free_motions: list[str]
    coordinates: list[str]
    limits: list[LimitFacts]


@dataclass(frozen=True)
class Freedom:
    """How many ways the system can move at its start.

    Attributes
    ----------
    degrees_of_freedom : int
        Of the parts: 6 for the object, one a joint.
    constraints, rank, mobility : int
        Contacts, how many of them are independent, and what freedom is left.
    redundant_rows : list of str
        Contacts that depend on each other; empty when all are independent.
    smallest_kept, largest_dropped : float or None
        Relative singular values on both sides of the rank decision: far apart when it is clear.
    """

    degrees_of_freedom: int
    constraints: int
    rank: int
    mobility: int
    redundant_rows: list[str]
    smallest_kept: float | None
    largest_dropped: float | None


@dataclass(frozen=True)
class RunFacts:
    """The settings that a run will have: times [s], tolerance of one step [m, rad; m/s, rad/s]."""

    duration: float
    integrator: str
    accuracy: float | dict[str, float] | None
    tolerance: float | None
    step: float | None
    stabilization: str
    output_step: float
    solver: str


@dataclass(frozen=True)
class Carrying:
    """Whether the contacts can carry the object at rest.

    Attributes
    ----------
    possible : bool
    force_residual, moment_residual : float
        What the best contact forces leave of the object's weight [N] and of its moment about the
        centre of mass [N m].
    largest_force : float
        Largest of these contact forces [N].
    """

    possible: bool
    force_residual: float
    moment_residual: float
    largest_force: float


@dataclass(frozen=True)
class EffectFacts:
    """What an effect adds to an evaluation at the start.

    Attributes
    ----------
    microseconds, uncertainty_microseconds : float or None
        Time, and twice its standard error; None where it was not measured.
    bytes, states, rows, callbacks : int
        Of arrays; states of its own; constraint rows; functions in Python.
    trouble : str
        Why it was not measured.
    """

    microseconds: float | None = None
    uncertainty_microseconds: float | None = None
    bytes: int = 0
    states: int = 0
    rows: int = 0
    callbacks: int = 0
    trouble: str = ""

    @property
    def within_noise(self) -> bool:
        """Whether the time may as well be zero."""
        if self.microseconds is None or self.uncertainty_microseconds is None:
            return False
        return abs(self.microseconds) <= self.uncertainty_microseconds


@dataclass(frozen=True)
class Inspection:
    """What a scene compiles to.

    Attributes
    ----------
    scene : str
    gravity : list of float or None
        [m/s^2]; None where there is none.
    object : ObjectFacts
    arms : dict arm -> ArmFacts
    joints : list of JointFacts
    freedom : Freedom or None
        With all contacts of the joints held, and those with a floor open.
    coming_and_going : list of str
        What may let go, close, slide or stick.
    effects : dict effect -> EffectFacts or None
        Effects that are modelled, gravity among them; None where nothing was measured.
    control : str
    run : RunFacts
    start : StartReport or None
        How far the written start was off, and what was corrected.
    position_residual, velocity_residual : float or None
        Largest gap [m] and gap rate [m/s] of the assembled start.
    residuals : Residuals or None
        Of the equations of motion at the start.
    carrying : Carrying or None
        None where the control does not carry the object, or nothing has weight.
    warnings : list of str
    not_looked_at : list of str
        What was left out, since it needs code that was not loaded.  Where contacts are, what is
        above by "or None" is None, ``joints`` are the others, and postures are as written.
    """

    scene: str
    gravity: list[float] | None
    object: ObjectFacts
    arms: dict[str, ArmFacts]
    joints: list[JointFacts]
    freedom: Freedom | None
    coming_and_going: list[str]
    effects: dict[str, EffectFacts | None]
    control: str
    run: RunFacts
    start: StartReport | None
    position_residual: float | None
    velocity_residual: float | None
    residuals: Residuals | None
    carrying: Carrying | None
    warnings: list[str]
    not_looked_at: list[str]

    def as_dict(self) -> dict[str, Any]:
        """Plain dictionaries and lists under the names above; what is not finite is None."""
        return plain(asdict(self))
