"""Many runs of one scene, from other starts or with other values in it, over several threads.

cases -> queue -> workers, a thread and a twin of the system each -> trajectories in order
"""

from multiarm.sweeps.many.cases import Case, describe, run_case
from multiarm.sweeps.many.crew import ManyProgress, run_cases
from multiarm.sweeps.many.files import run_files
from multiarm.sweeps.many.runs import simulate_many

__all__ = [
    "Case",
    "ManyProgress",
    "describe",
    "run_case",
    "run_cases",
    "run_files",
    "simulate_many",
]
