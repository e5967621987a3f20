r"""A run at the nodes of panels, and panels that are short enough.

The run itself is :func:`multiarm.simulate`'s, which gives samples at any times without changing its
steps.  The variational equation along it (:mod:`multiarm.gradients.variation`) is solved over
panels of its own (:mod:`multiarm.gradients.collocation`): each once as a whole, and again in two
halves.  For a method of order p, the result of the halves is wrong by

.. math:: \frac{y_{\text{whole}} - y_{\text{halves}}}{2^p - 1} ,

which is carried along with the result as its estimated error.  Panels that contribute too much are
divided, and the walk over all of them is repeated.  No panel contains a time at which control or
loads are not smooth.  At the bounds of the panels displacements are put on those that the joints
allow: errors across them would stay where damping makes all else small.

*Memory.*  The states at all nodes are kept, 13 + 2 n numbers each.  The matrices there, of
(12 + 2 n)^2 numbers, are kept for a second walk as long as they take less than ``MOST_KEPT``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from multiarm.dynamics.sensitivity import Derivatives
from multiarm.dynamics.solver.dense import SYSTEM_TOLERANCE
from multiarm.dynamics.state import Layout, State
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.events.derivatives import derivatives
from multiarm.gradients.collocation import NODES, ORDER, Collocation
from multiarm.gradients.variation import Parameter, variation
from multiarm.results.trajectory import Trajectory
from multiarm.scene.run import DEFAULT_ACCURACY
from multiarm.simulation.simulate import simulate
from multiarm.terminal.progress import Report

# Panels that a walk begins with: of about so many steps of the run, and at most so long [s].
STEPS, LONGEST = 6, 0.1
# Numbers of the matrices that are kept.
MOST_KEPT = 3e7
MOST_WALKS = 12
# Walks over shorter panels go on while they lessen the error at least so; derivatives with a larger
# relative error than the second are of no use.
LESSENED, USELESS = 0.5, 1e-2
RICHARDSON = 2.0**ORDER - 1.0
# In place of sizes that are zero.
TINY = 1e-300


class Panel(NamedTuple):
    """A piece of time [s]."""

    begin: float
    end: float

    @property
    def length(self) -> float:
        """[s]"""
        return self.end - self.begin

    @property
    def nodes(self) -> list[float]:
        """The three nodes of the collocation [s]."""
        return (self.begin + NODES * self.length).tolist()

    @property
    def halves(self) -> tuple[Panel, Panel]:
        """The panel in two."""
        middle = 0.5 * (self.begin + self.end)
        return Panel(self.begin, middle), Panel(middle, self.end)


class Bound(NamedTuple):
    """What displacements of nearby motions obey at one time.

    Attributes
    ----------
    admissible : ndarray, shape (D, D)
        Projector on those that keep the joints closed.
    across : ndarray, shape (D, P)
        The rest of a displacement that a parameter makes, where it moves the joints.
    """

    admissible: np.ndarray
    across: np.ndarray

    def forward(self, displacements: np.ndarray) -> np.ndarray:
        """Displacements by some columns, and last by the parameters, (D, k), without errors."""
        put = self.admissible @ displacements
        put[:, put.shape[1] - self.across.shape[1] :] += self.across
        return put

    def backward(self, mu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The transposed map of (D, k): what acts before, and by the parameters (P, k)."""
        before = self.admissible @ mu
        return before, self.across.T @ (mu - before)


class Walk(Protocol):
    """The result of a walk over all panels."""

    @property
    def error(self) -> float:
        """Its estimated error, relative to its size."""
        ...

    @property
    def shares(self) -> np.ndarray:
        """Of every panel, relative to the whole."""
        ...


AnyWalk = TypeVar("AnyWalk", bound=Walk)


class Along:
    """A run with its variational equation.

    Parameters
    ----------
    system : System
    begin, duration : float
        [s]
    accuracy : float or None
        Of the run; None: the scene's.
    start : State or None
        None: the scene's.
    parameters : sequence of str
        Paths of numbers of the scene.

    Attributes
    ----------
    tolerance : float
        Relative error of the derivatives.
    trajectory : Trajectory
        The run, sampled at all times that were asked for.

    Raises
    ------
    SolverError
        When the run has no derivatives of this kind, or ends early.
    SceneError
        When a parameter cannot be used.
    """

    trajectory: Trajectory

    def __init__(
        self,
        system: System,
        begin: float,
        duration: float,
        accuracy: float | None,
        start: State | None,
        parameters: Sequence[str],
    ) -> None:
        _refuse(system)
        self.system, self.begin, self.end = system, begin, begin + duration
        self._accuracy, self._start = accuracy, start
        written = system.scene.run.accuracy
        of_scene = DEFAULT_ACCURACY if written is None else written.smallest
        self.tolerance = of_scene if accuracy is None else accuracy
        self.parameters = [Parameter(system, path) for path in parameters]
        self._states: dict[float, State] = {}
        self._nodes: dict[float, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self._bounds: dict[float, Bound] = {}

    @property
    def layout(self) -> Layout:
        """That of the system."""
        return self.system.model.layout

    @property
    def size(self) -> int:
        """Number of components of a displacement."""
        return 12 + 2 * self.layout.joints

    def state(self, t: float) -> State:
        """The state at a time that was asked for."""
        return self._states[t]

    def panels(self, bounds: Iterable[float]) -> list[Panel]:
        """Panels to begin with, which end at the given times [s] among others."""
        rough = self.system.model.breakpoints
        inner = rough[(rough > self.begin) & (rough < self.end)]
        times = np.unique([self.begin, self.end, *inner, *bounds])
        panels = _divided(times, LONGEST)
        self.sample(panels, times)
        mean = (self.end - self.begin) / max(self.trajectory.statistics["steps"], 1)
        return panels if STEPS * mean >= LONGEST else _divided(times, STEPS * mean)

    def sample(self, panels: Iterable[Panel], times: Iterable[float] = ()) -> None:
        """Run to all nodes of panels, of their halves, and to further times."""
        wanted = {self.begin, self.end, *times, *self._states}
        for panel in panels:
            wanted.update((panel.begin, panel.end), panel.nodes)
            wanted.update(*(half.nodes for half in panel.halves))
        if wanted == self._states.keys():
            return
        run = self.trajectory = simulate(
            self.system,
            self.end - self.begin,
            accuracy=self._accuracy,
            state=self._start,
            start_time=self.begin,
            output_times=sorted(wanted),
            certificate=False,
        )
        if run.status != "completed":
            raise SolverError(f"the run that is differentiated did not end well: {run.message}")
        _refuse_events(run)
        names = self.layout.names
        positions = np.hstack(
            [
                run.object_position,
                run.object_quaternion_xyzw,
                *(run.joint_positions[name] for name in names),
            ]
        )
        velocities = np.hstack([run.object_twist, *(run.joint_velocities[name] for name in names)])
        self._states = {
            t: State(position, velocity, self.layout)
            for t, position, velocity in zip(sorted(wanted), positions, velocities, strict=True)
        }

    def solved(self, panel: Panel) -> tuple[Collocation, np.ndarray, np.ndarray]:
        """The collocation of a panel, and at its nodes the matrices (3, D, n) by torques and
        (3, D, P) by the parameters.
        """
        nodes = [self._node(t) for t in panel.nodes]
        A, B, beta = (np.stack(own) for own in zip(*nodes, strict=True))
        return Collocation(A, panel.length), B, beta

    def bound(self, t: float) -> Bound:
        """What displacements obey at a bound of panels."""
        found = self._bounds.get(t)
        if found is None:
            motions = self._derivatives(t).motions
            across = np.zeros((self.size, len(self.parameters)))
            for k, parameter in enumerate(self.parameters):
                gaps = parameter.at(t, self._states[t])[1]
                if np.any(gaps):
                    C = motions.constraint
                    lengths = np.maximum(np.linalg.norm(C, axis=1), TINY)
                    scaled = C / lengths[:, None]
                    across[:, k] = -np.linalg.lstsq(scaled, gaps / lengths, SYSTEM_TOLERANCE)[0]
            found = Bound(motions.admissible(), across)
            self._keep(self._bounds, t, found)
        return found

    def _node(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The variational equation at a node: matrices by state, torques and parameters."""
        found = self._nodes.get(t)
        if found is None:
            beta = np.zeros((self.size, len(self.parameters)))
            for k, parameter in enumerate(self.parameters):
                beta[:, k] = parameter.at(t, self._states[t])[0]
            found = *variation(self._derivatives(t)), beta
            self._keep(self._nodes, t, found)
        return found

    def _derivatives(self, t: float) -> Derivatives:
        try:
            return derivatives(self.system, t, self._states[t])
        except SolverError as error:
            raise SolverError(f"at t = {t:.9g} s: {error}") from None

    def _keep(self, where: dict[float, Any], t: float, found: Any) -> None:
        if (len(self._nodes) + len(self._bounds)) * self.size**2 < MOST_KEPT:
            where[t] = found

    def start_by_parameters(self) -> np.ndarray:
        """The derivatives of the start by the parameters, shape (D, P)."""
        found = np.zeros((self.size, len(self.parameters)))
        if self._start is None:
            for k, parameter in enumerate(self.parameters):
                found[:, k] = parameter.of_start()
        return found

    def to_accuracy(
        self,
        panels: list[Panel],
        walk: Callable[[list[Panel], Callable[[int], None]], AnyWalk],
        show: Report,
    ) -> AnyWalk:
        """The result of a walk over panels that are short enough, or as short as helps.

        Raises
        ------
        SolverError
            When its error is too large even so.
        """
        best: AnyWalk | None = None
        for number in range(1, MOST_WALKS + 1):
            self.sample(panels)
            words = "derivatives of the run" + (f", walk {number}" if number > 1 else "")
            total = len(panels)
            found = walk(panels, lambda done, w=words, n=total: show(done, n, w))
            if best is not None and found.error > LESSENED * best.error:  # roundings are left
                break
            best = found
            if found.error <= self.tolerance:
                return found
            large = min(self.tolerance / len(panels), found.shares.max())
            panels = [
                half
                for panel, share in zip(panels, found.shares, strict=True)
                for half in (panel.halves if share >= 0.25 * large else (panel,))
            ]
        assert best is not None, "there is a first walk"
        if best.error > USELESS:
            raise SolverError(
                f"the derivatives of the run have an error of {best.error:.1g} of their size, and "
                f"shorter pieces of time do not lessen it; look for a control that jumps, or for "
                f"motions that damping ends long before the end of the run"
            )
        return best


def _divided(times: np.ndarray, longest: float) -> list[Panel]:
    panels = []
    for begin, end in pairwise(times.tolist()):
        count = max(1, math.ceil((end - begin) / longest * (1.0 - 1e-9)))
        bounds = np.linspace(begin, end, count + 1).tolist()
        panels += [Panel(*pair) for pair in pairwise(bounds)]
    return panels


def _refuse(system: System) -> None:
    """Refuse systems whose runs have states that displacements do not contain."""
    if system.model.effects.states:
        raise SolverError(
            "derivatives of a run: an effect of this scene has states of its own, such as the "
            "torques of lagging drives, by which runs are not differentiated; leave it out"
        )
    if system.model.sampling is not None:
        raise SolverError(
            "derivatives of a run: the control is sampled, so that its torques are those of "
            "earlier states; leave `sample_time` out"
        )


def _refuse_events(run: Trajectory) -> None:
    if run.statistics.get("contact_events", 0):
        first = run.events[0]
        raise SolverError(
            f"derivatives of a run: contacts open, close or slide in it, and the motion beyond "
            f"depends on when ({first['text']} at t = {first['time']:.6g} s); end the run before, "
            f"or keep the contacts closed"
        )
