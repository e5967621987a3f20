"""Guards at any time inside the step just made, from its dense output."""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.arrays import OK, open_system
from multiarm.dynamics.equations import evaluate_state
from multiarm.events.kernels import write_guards
from multiarm.integration.stepper import interpolate, load, open_step
from multiarm.jit.kernels import kernel
from multiarm.jit.pointers import address_of, call_cfunc


@kernel
def probe(struct, arrays, entry, t, h, theta):
    """Evaluate the mode with this struct at the fraction ``theta`` of a step; returns a status.

    ``entry`` is the address of :func:`multiarm.events.kernels.write_guards`, which leaves the
    values in the mode's arrays.
    """
    method, step = open_step(arrays)
    _, data, _ = open_system(struct)
    interpolate(method, step, theta, step.z_stage)
    load(step.z_stage, step.base_old, data)
    data.time.now = min(t + theta * h, data.time.latest)
    status = evaluate_state(struct, 0.0, 0.0)
    if status != OK:
        return status
    return call_cfunc(entry, struct, 0.0, 0.0)


class Probe:
    """Values of all guards as a function of the fraction of a step."""

    def __init__(self, struct, arrays, mode, begin: float, end: float):
        self._call = struct, arrays, address_of(write_guards), begin, end - begin
        self._mode = mode
        self._known: dict[float, np.ndarray] = {}

    def __call__(self, theta: float) -> np.ndarray:
        """Values of all guards; NaN where the state cannot be evaluated."""
        if theta not in self._known:
            status = probe(*self._call, theta)
            values = self._mode.arrays.values.copy()
            self._known[theta] = values if status == OK else np.full_like(values, np.nan)
        return self._known[theta]
