"""What tests of many runs share: starts at random, and whether two runs are one, bit for bit."""

from __future__ import annotations

import numpy as np


def random_states(system, count: int, size: float = 0.05, seed: int = 7) -> list:
    """Starts whose joints move at random."""
    rng = np.random.default_rng(seed)
    dofs = {name: arm.dof for name, arm in system.arms.items()}

    def velocities():
        return {name: size * rng.standard_normal(dof) for name, dof in dofs.items()}

    return [system.state(joint_velocities=velocities()) for _ in range(count)]


def assert_same_run(found, expected) -> None:
    """All samples bit for bit, how it ended, what happened, what was found out."""
    assert (found.status, found.message) == (expected.status, expected.message)
    assert found.channels == expected.channels
    for name in expected.channels:
        np.testing.assert_array_equal(found.read(name), expected.read(name), err_msg=name)
    assert found.events == expected.events
    assert found.scene_text == expected.scene_text
    certificates = [run.certificate or {} for run in (found, expected)]
    for certificate in certificates:
        certificate.pop("attempts", None)  # which have wall times
    assert certificates[0] == certificates[1]
    clocks = {"wall_time_s", "compile_time_s", "realtime_factor"}
    counted = [
        {k: v for k, v in r.statistics.items() if k not in clocks} for r in (found, expected)
    ]
    assert counted[0] == counted[1]
