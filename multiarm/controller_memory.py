"""Whether a controller in Python remembers: asked again, does it give the same torques?

A rerun that checks a run calls the controller again from the beginning.  One that integrates,
counts or draws random numbers then acts otherwise, and the two runs are not the same motion.  Here
it is asked once more at some recorded samples, the last one first, which costs a few evaluations.
"""

from __future__ import annotations

import numpy as np

from multiarm.certificate.comparison import state_of
from multiarm.dynamics import evaluate
from multiarm.errors import MultiarmError
from multiarm.system import System
from multiarm.trajectory import Trajectory

SAMPLES = 8
"""At which the controller is asked again."""
SAME = 1e-9
"""Relative to the largest torque of the run's samples that are looked at."""


def remembers(system: System, run: Trajectory) -> bool:
    """Whether the Python controller of a system gives other torques than it gave in a run.

    Samples at which it cannot be asked, because the evaluation fails, are left out.
    """
    if "control" not in system.calls or not len(run):
        return False
    names = {arm: f"arms/{arm}/joint_torque" for arm in run.arm_names}
    samples = np.unique(np.linspace(0, len(run) - 1, SAMPLES).astype(int))[::-1]
    apart = largest = 0.0
    for k in samples:
        try:
            t = float(run.read("time", k, k + 1)[0])
            found = evaluate(system, t, state_of(system, run, k)).joint_torques
        except MultiarmError:
            continue
        for arm, name in names.items():
            given = run.read(name, k, k + 1)[0]
            largest = max(largest, float(np.max(np.abs(given), initial=0.0)))
            apart = max(apart, float(np.max(np.abs(found[arm] - given), initial=0.0)))
    return apart > SAME * largest
