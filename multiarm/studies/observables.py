"""Observables of a system at one state: torques, gap, energy, damping; torques of time alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.contacts.kernel import GAP
from multiarm.control.laws import harmonic
from multiarm.dynamics.equations import evaluate_state, update_kinematics
from multiarm.dynamics.kinematics import read_inertia
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.jit.pointers import address_of


@dataclass(frozen=True)
class Sinusoid:
    """Torques that depend on time only, ``constant + sine sin(a) + cosine cos(a)``.

    Attributes
    ----------
    rate : float
        [rad/s]; ``a = rate t``.
    constant, sine, cosine : ndarray, shape (n,)
        [N m] or [N]
    """

    rate: float
    constant: np.ndarray
    sine: np.ndarray
    cosine: np.ndarray

    @classmethod
    def none(cls, n: int) -> Sinusoid:
        """No torques at ``n`` joints."""
        return cls(0.0, np.zeros(n), np.zeros(n), np.zeros(n))

    @property
    def is_constant(self) -> bool:
        """Whether nothing swings."""
        return self.rate == 0.0 or not (np.any(self.sine) or np.any(self.cosine))

    def at(self, times: np.ndarray) -> np.ndarray:
        """Torques at times [s], shape (times, n)."""
        angle = self.rate * np.asarray(times)[:, None]
        return self.constant + self.sine * np.sin(angle) + self.cosine * np.cos(angle)


def sinusoid(system: System) -> Sinusoid | None:
    """The torques of a scene whose control looks at the clock only; None where it looks at more."""
    n = system.model.layout.joints
    if not is_controlled(system):
        return Sinusoid.none(n)
    program, parameters = system.model.constants.control, system.model.constants.parameters
    if program.shape[0] > 1 or program[0, 0] != address_of(harmonic):
        return None
    at = program[0, 1]
    constant, sine, cosine = parameters[at + 1 : at + 1 + 3 * n].reshape(n, 3).T.copy()
    return Sinusoid(2.0 * np.pi * float(parameters[at]), constant, sine, cosine)


def control_torque(system: System, t: float, state: State) -> np.ndarray:
    """Torques of the scene's control at time ``t``, shape (n,), without damping."""
    if not is_controlled(system):
        return np.zeros(system.model.layout.joints)
    with system.borrow() as data:
        data.set_state(t, state)
        evaluate_state(data.struct, 0.0, 0.0)  # torques are there whatever the solver says
        data.forgive()
        return data.arrays.torque.copy()


def is_controlled(system: System) -> bool:
    """Whether anything drives the arms."""
    return system.model.constants.control.shape[0] > 0


def largest_gap(system: System, state: State) -> float:
    """Largest gap of a contact [m]."""
    with system.borrow() as data:
        data.set_state(0.0, state)
        update_kinematics(data.struct)
        return float(np.max(np.abs(data.arrays.contacts[:, GAP]), initial=0.0))


def total_energy(system: System, state: State) -> float:
    """Kinetic and potential energy [J]."""
    with system.borrow() as data:
        data.set_state(0.0, state)
        update_kinematics(data.struct)
        twist, b = state.object_twist, data.arrays
        kinetic = twist @ b.inertia @ twist
        for i, v in enumerate(state.joint_velocities.values()):
            kinetic += v @ read_inertia(b.pointers[i], v.size) @ v
        return 0.5 * float(kinetic) + data.potential_energy()


def joint_damping(system: System) -> np.ndarray:
    """Coefficients of the joints' viscous friction, zero without that effect, shape (n,)."""
    damping = np.zeros(system.model.layout.joints)
    for kernel in system.model.effects.kernels:
        if kernel.name == "joint_damping":
            damping += kernel.arrays[0]
    return damping


def inexpressible_effects(system: System) -> list[str]:
    """Names of the scene's effects that no other program here has."""
    return sorted(set(system.scene.effects.named) - {"joint_damping"})
