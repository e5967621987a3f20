r"""What a run must satisfy on its own, whatever another run says.

A tightened rerun cannot see an error that both runs share. Three things can be looked at in one run
alone: whether energy and work balance, whether the equations were solved, and whether the joints
stayed closed.

**Energy.** Along the exact motion the balance

.. math:: B(t) = E(q, v) - E(q_0, v_0) - W(t), \qquad E = T(q, v) + V(q)

is zero. A run that is off by :math:`\delta q, \delta v` and whose work is off by :math:`\delta W`
has, to first order,

.. math:: |B| \le \sum_i \Big|\frac{\partial E}{\partial q_i}\Big| |\delta q_i|
          + \sum_i |p_i| |\delta v_i| + |\delta W|, \qquad p = \frac{\partial T}{\partial v} = M v .

The generalised forces :math:`\partial E / \partial q` (weight and the change of the inertia with
the posture) are differences of the energy at the sample where the balance is worst, the momenta
:math:`p` those of that sample. For :math:`|\delta q_i|` stands the accuracy that was asked for (the
error estimated, where none was asked), for :math:`|\delta v_i|` and :math:`|\delta W|` the largest
differences that the two runs show. Gaps that are not closed add the work of the contact forces on
them, :math:`\sum_k |\lambda_k| |\varphi|` and :math:`\sum_k |\lambda_k| \int |\dot\varphi| dt`. The
sum, times ``BALANCE_SAFETY`` for what is of higher order, plus the rounding of the energies, is the
bound.

**Residual.** A relative error :math:`\rho` of the accelerations moves things by about :math:`\rho`
times what they move anyway, metres and radians: it must stay below the accuracy. Double precision
leaves about ``ROUNDED_ACCELERATION`` near a loss of rank, which is always allowed.

**Drift.** A gap of a contact is an error of position.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from multiarm.dynamics.arrays import OK
from multiarm.dynamics.contact_geometry import place_state
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.kinematics import read_inertia
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import State
from multiarm.errors import MultiarmError
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.certificate.comparison import POSITION, ROTATION, Comparison, state_of
from multiarm.spatial import retract

BALANCE_SAFETY = 3.0
ROUNDED_ACCELERATION = 1e-8
ENERGY_ROUNDING = 1e-13
"""Relative to the energies and the work exchanged; a sum of many steps."""
DIFFERENCE = 1e-5
"""[m, rad] Of a coordinate, for the derivative of the energy."""


@dataclass(frozen=True)
class Check:
    """A number of a run beside its bound.

    Attributes
    ----------
    value, bound : float
    unit : str
    fault : str
        What is wrong when it is exceeded, a clause.
    """

    value: float
    bound: float
    unit: str
    fault: str

    @property
    def passed(self) -> bool:
        """Whether the value is within its bound; a value that is not a number is not."""
        return bool(self.value <= self.bound)

    def as_dict(self) -> dict[str, Any]:
        """Value, bound, unit, passed."""
        return {
            "value": self.value, "bound": self.bound, "unit": self.unit, "passed": self.passed,
        }  # fmt: skip


def check_run(
    data: Data, run: Trajectory, comparison: Comparison, accuracy: dict[str, float]
) -> dict[str, Check]:
    """Energy, residual and drift of a run.

    Parameters
    ----------
    data : Data
    run : Trajectory
    comparison : Comparison
        With its tightened rerun.
    accuracy : dict
        [m] under ``position_m`` and [rad] under ``rotation_rad``: asked, or else estimated.
    """
    gap = _largest(run, "drift/position")
    residual = _largest(run, "solver/residual")
    smallest = min(accuracy[POSITION], accuracy[ROTATION])
    energy = _energy_check(data, run, comparison, accuracy)
    return {
        **({} if energy is None else {"energy": energy}),
        "residual": Check(
            residual, max(smallest, ROUNDED_ACCELERATION), "1",
            f"the equations were solved to {residual:.2g} only, relative to their largest term",
        ),
        "drift": Check(
            gap, accuracy[POSITION], "m", f"the contacts are open by up to {gap:.2g} m"
        ),
    }  # fmt: skip


def _energy_check(
    data: Data, run: Trajectory, comparison: Comparison, accuracy: dict[str, float]
) -> Check | None:
    """The energy check; None next to a posture at which there is no energy to compare with."""
    k, imbalance, exchanged = _worst_balance(run)
    slack = ENERGY_ROUNDING * exchanged + _work_on_gaps(run)
    try:
        state = state_of(data.model.layout, run, k)
        turned = np.concatenate([[1] * 3, [2] * 3, _kinds_of_joints(data)])
        off = np.where(turned == 1, accuracy[POSITION], accuracy[ROTATION])
        names = ["object/twist", *(f"arms/{arm}/joint_velocity" for arm in data.model.arm_names)]
        slow = np.concatenate([comparison.velocity[name] for name in names])
        energies = _Energies(data)
        explained = float(
            np.abs(energies.gradient(state)) @ off + np.abs(energies.momentum(state)) @ slow
        )
    except MultiarmError:
        return None
    bound = BALANCE_SAFETY * (explained + comparison.work) + slack
    return Check(
        imbalance, bound, "J",
        f"energy and work are out of balance by {imbalance:.2g} J where errors of the accuracy "
        f"asked explain {bound:.2g} J",
    )  # fmt: skip


def _worst_balance(run: Trajectory) -> tuple[int, float, float]:
    """Sample of the largest imbalance, the imbalance, and the size of the energies [J]."""
    names = ("energy/kinetic", "energy/potential", "energy/work")
    begin = sum(float(run.read(name, 0, 1)[0]) for name in names[:2])
    worst, at, size, start = -1.0, 0, abs(begin), 0
    for kinetic, potential, work in run.blocks(*names):
        balance = np.abs(kinetic + potential - begin - work)
        k = int(np.argmax(balance))
        if balance[k] > worst:
            worst, at = float(balance[k]), start + k
        size = max(size, *(float(np.abs(values).max()) for values in (kinetic, potential, work)))
        start += len(kinetic)
    return at, worst, size


def _work_on_gaps(run: Trajectory) -> float:
    """Most work that contact forces can have done on gaps that were not closed [J]."""
    forces = [f"arms/{arm}/contact_force" for arm in run.arm_names]
    largest, gap, opened, before = 0.0, 0.0, 0.0, None
    for time, gaps, rates, *blocks in run.blocks(
        "time", "drift/position", "drift/velocity", *forces
    ):
        total = sum(np.abs(values).sum(axis=1) for values in blocks)
        largest = max(largest, float(np.max(total)))
        gap = max(gap, float(gaps.max()))
        steps = np.diff(time, prepend=time[0] if before is None else before)
        opened += float(rates @ steps)
        before = time[-1]
    return largest * (gap + opened)


def _kinds_of_joints(data: Data) -> list[int]:
    """1 for each joint that slides, 2 for each that turns."""
    return [1 if unit == "m" else 2 for unit in data.model.joint_units]


class _Energies:
    """Momenta and energies of a system at any state."""

    def __init__(self, data: Data) -> None:
        self._data = data

    def momentum(self, state: State) -> np.ndarray:
        """Generalised momenta M v, shape (6 + n,)."""
        data = self._data
        place_state(data, 0.0, state)
        if update_kinematics(data.struct) != OK:
            data.reraise()
        parts = [data.arrays.inertia @ state.velocity[:6]]
        for i, (a, b) in enumerate(pairwise(data.model.layout.dofs)):
            inertia = read_inertia(data.arrays.pointers[i], b - a)
            parts.append(inertia @ state.velocity[6 + a : 6 + b])
        return np.concatenate(parts)

    def gradient(self, state: State) -> np.ndarray:
        """Rates of the energy with positions, velocities kept, shape (6 + n,) [N, N m]."""
        gradient = np.zeros(state.velocity.size)
        for i in range(gradient.size):
            above, below = (self._energy(_shifted(state, i, h)) for h in (DIFFERENCE, -DIFFERENCE))
            gradient[i] = (above - below) / (2.0 * DIFFERENCE)
        return gradient

    def _energy(self, state: State) -> float:
        kinetic = 0.5 * float(self.momentum(state) @ state.velocity)
        return kinetic + self._data.potential_energy()


def _shifted(state: State, i: int, step: float) -> State:
    """The state with its ``i``-th position moved."""
    moved = state.copy()
    if i < 3:
        moved.position[i] += step
    elif i < 6:
        moved.position[3:7] = retract(state.position[3:7], step * np.eye(3)[i - 3])
    else:
        moved.position[i + 1] += step
    return moved


def _largest(run: Trajectory, name: str) -> float:
    return max(float(np.abs(values).max()) for (values,) in run.blocks(name))
