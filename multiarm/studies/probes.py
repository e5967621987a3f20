"""What benchmarks ask of a system: torques, gap and energy at one state, damping, a drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.assembly.system import System
from multiarm.contacts.kernel import GAP
from multiarm.control.torques import harmonic
from multiarm.dynamics.dense_callback import read_inertia
from multiarm.dynamics.equations import evaluate_buffers, update_kinematics
from multiarm.dynamics.state import State
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
    n = system.layout.joints
    if not is_controlled(system):
        return Sinusoid.none(n)
    program, parameters = system.plant.control, system.plant.parameters
    if program.shape[0] > 1 or program[0, 0] != address_of(harmonic):
        return None
    at = program[0, 1]
    constant, sine, cosine = parameters[at + 1 : at + 1 + 3 * n].reshape(n, 3).T.copy()
    return Sinusoid(2.0 * np.pi * float(parameters[at]), constant, sine, cosine)


def control_torque(system: System, t: float, state: State) -> np.ndarray:
    """Torques of the scene's control at time ``t``, shape (n,), without damping."""
    if not is_controlled(system):
        return np.zeros(system.layout.joints)
    system.set_state(t, state)
    evaluate_buffers(system.struct(), 0.0, 0.0)  # torques are there whatever the solver says
    system.forgive()
    return system.buffers.torque.copy()


def is_controlled(system: System) -> bool:
    """Whether anything drives the arms."""
    return system.plant.control.shape[0] > 0


def largest_gap(system: System, state: State) -> float:
    """Largest gap of a contact [m]."""
    system.set_state(0.0, state)
    update_kinematics(system.struct())
    return float(np.max(np.abs(system.buffers.contacts[:, GAP]), initial=0.0))


def total_energy(system: System, state: State) -> float:
    """Kinetic and potential energy [J]."""
    system.set_state(0.0, state)
    update_kinematics(system.struct())
    twist, buffers = state.object_twist, system.buffers
    kinetic = twist @ buffers.inertia @ twist
    for i, v in enumerate(state.joint_velocities.values()):
        kinetic += v @ read_inertia(system.plant.pointers[i], v.size) @ v
    return 0.5 * float(kinetic) + system.potential_energy()


def joint_damping(system: System) -> np.ndarray:
    """Coefficients of the joints' viscous friction, zero without that effect, shape (n,)."""
    damping = np.zeros(system.layout.joints)
    for piece in system.pieces.every:
        if piece.name == "joint_damping":
            damping += piece.arrays[0]
    return damping


def inexpressible_effects(system: System) -> list[str]:
    """Names of the scene's effects that no other program here has."""
    return sorted(set(system.scene.effects.named) - {"joint_damping"})
