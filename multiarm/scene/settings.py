"""The settings of a run: their choices and their meanings, for scenes and for the command line.

The commands know their options without what reads scenes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

from multiarm.tableaus import ADAPTIVE_INTEGRATORS, FIXED_STEP_INTEGRATORS, METHODS

STABILIZATIONS = {
    "projection": "returns position and velocity to the constraints after each step",
    "feedback": "adds -2 alpha W^T v - beta^2 phi to the constraint accelerations, as Baumgarte",
    "none": "lets the joints drift apart as the errors of the steps add up, to see how fast",
}
"""How the joints are kept closed, by name."""
if TYPE_CHECKING:
    Integrator = str
    Stabilization = str
else:
    Integrator = Literal[tuple(METHODS)]
    Stabilization = Literal[tuple(STABILIZATIONS)]
SolverName = Literal["node", "dense"]
Painleve = Literal["impact", "stop"]
ArmTerms = Literal["pinocchio", "compiled"]
ARM_TERMS: tuple[str, ...] = get_args(ArmTerms)
"""Backends of the arms' inertia, forces and motion."""

MEANINGS = {
    "duration": "Simulated time [s].",
    "accuracy": "Largest error of the whole run at the worst output time: a number [m and rad]. "
    "The program chooses method and steps, checks the result against a tightened rerun and repeats "
    "the run with smaller tolerances if need be. 1e-6 by default.",
    "integrator": f"{', '.join(FIXED_STEP_INTEGRATORS)} have a fixed 'step'; "
    f"{', '.join(ADAPTIVE_INTEGRATORS)} choose their steps by 'accuracy' or 'tolerance'. "
    "Absent: dopri5 or dop853 by the accuracy, and rodas5p where the scene turns out to be stiff.",
    "step": "Fixed step [s].",
    "tolerance": "Error of one step of an adaptive integrator [m, rad, m/s, rad/s].",
    "stabilization": "How the joints are kept closed although integration errors add up.",
    "output_step": "Time between stored samples [s].",
    "most_steps": "Steps for one second of simulated time (for the whole run, if that is shorter): "
    "a run that needs more at the pace of its last thousands of steps, rejected ones and events "
    "counted, fails instead of running for hours.",
    "painleve": "Where friction leaves no accelerations that obey the contact laws (Painleve's "
    "paradox): an impulse without a collision carries the run on, or it stops.",
    "solver": "The node algorithm, or the whole linear system at once, an independent reference to "
    "compare with.",
    "arms": "Backend of the arms' inertia, forces and motion: Pinocchio, or compiled code, which "
    "is several times as fast and verified against Pinocchio whenever the scene is compiled. An "
    "arm that cannot be compiled stays with Pinocchio and says so.",
}
"""By the setting's key."""
