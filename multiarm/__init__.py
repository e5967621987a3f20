"""multiarm: several robot arms hold one object.  Closed kinematic chains, exactly and fast.

>>> import multiarm as ma
>>> system = ma.compile_system(ma.load_scene("two_ur5_box.yaml"))
>>> trajectory = ma.simulate(system, duration=5.0, accuracy=1e-6)
>>> ma.replay(trajectory)
"""

from __future__ import annotations

from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any

from multiarm.errors import MultiarmError

if TYPE_CHECKING:
    from multiarm import grasp
    from multiarm.assembly.compilation import compile_system
    from multiarm.control.user_control import Control
    from multiarm.dynamics.evaluation import Evaluation
    from multiarm.dynamics.inverse import inverse_dynamics
    from multiarm.dynamics.sensitivity import Derivatives
    from multiarm.dynamics.state import State
    from multiarm.dynamics.system import System
    from multiarm.dynamics.tips import Kinematics
    from multiarm.effects.effect import Effect, Loads
    from multiarm.events.derivatives import derivatives
    from multiarm.events.evaluation import evaluate
    from multiarm.gradients.gradient import Gradient, gradient
    from multiarm.gradients.sensitivities import Sensitivities, sensitivities
    from multiarm.linear.equilibrium import Equilibrium, find_equilibrium
    from multiarm.linear.linearisation import LinearSystem, linearise
    from multiarm.reports.report import report
    from multiarm.results.trajectory import Trajectory, load_trajectory
    from multiarm.robots.terms import TipKinematics
    from multiarm.scene import (
        Joint,
        Scene,
        Surface,
        load_scene,
        register_control,
        register_effect,
        register_joint,
        register_surface,
    )
    from multiarm.simulation.many import simulate_many
    from multiarm.simulation.simulate import simulate
    from multiarm.simulation.stepper import Stepper
    from multiarm.sweeps.result import Sweep, load_sweep
    from multiarm.sweeps.sweep import sweep
    from multiarm.viewer import replay

# Packages that are public as a whole.
_PACKAGES = ("grasp",)
# Public name -> module that has it.  Imported when first used, so that `import multiarm` is light.
_HOMES = {
    "Control": "control.user_control",
    "Derivatives": "dynamics.sensitivity",
    "Effect": "effects.effect",
    "Equilibrium": "linear.equilibrium",
    "Evaluation": "dynamics.evaluation",
    "Gradient": "gradients.gradient",
    "Joint": "scene",
    "Kinematics": "dynamics.tips",
    "LinearSystem": "linear.linearisation",
    "Loads": "effects.effect",
    "Scene": "scene",
    "Sensitivities": "gradients.sensitivities",
    "State": "dynamics.state",
    "Stepper": "simulation.stepper",
    "Surface": "scene",
    "Sweep": "sweeps.result",
    "System": "dynamics.system",
    "TipKinematics": "robots.terms",
    "Trajectory": "results.trajectory",
    "compile_system": "assembly.compilation",
    "derivatives": "events.derivatives",
    "evaluate": "events.evaluation",
    "find_equilibrium": "linear.equilibrium",
    "gradient": "gradients.gradient",
    "inverse_dynamics": "dynamics.inverse",
    "linearise": "linear.linearisation",
    "load_scene": "scene",
    "load_sweep": "sweeps.result",
    "load_trajectory": "results.trajectory",
    "register_control": "scene",
    "register_effect": "scene",
    "register_joint": "scene",
    "register_surface": "scene",
    "replay": "viewer",
    "report": "reports.report",
    "sensitivities": "gradients.sensitivities",
    "simulate": "simulation.simulate",
    "simulate_many": "simulation.many",
    "sweep": "sweeps.sweep",
}

__all__ = [
    "Control",
    "Derivatives",
    "Effect",
    "Equilibrium",
    "Evaluation",
    "Gradient",
    "Joint",
    "Kinematics",
    "LinearSystem",
    "Loads",
    "MultiarmError",
    "Scene",
    "Sensitivities",
    "State",
    "Stepper",
    "Surface",
    "Sweep",
    "System",
    "TipKinematics",
    "Trajectory",
    "compile_system",
    "derivatives",
    "evaluate",
    "find_equilibrium",
    "gradient",
    "grasp",
    "inverse_dynamics",
    "linearise",
    "load_scene",
    "load_sweep",
    "load_trajectory",
    "register_control",
    "register_effect",
    "register_joint",
    "register_surface",
    "replay",
    "report",
    "sensitivities",
    "simulate",
    "simulate_many",
    "sweep",
]

try:
    __version__ = metadata.version("multiarm")
except metadata.PackageNotFoundError:  # imported from a checkout that is not installed
    __version__ = "0.0.0"


def __getattr__(name: str) -> Any:
    if name in _PACKAGES:
        return import_module(f"multiarm.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'multiarm' has no attribute {name!r}")
    value = getattr(import_module(f"multiarm.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
