"""Shared fixtures: compiled systems (compiled once; tests never change them) and randomness."""

from __future__ import annotations

import pytest
from hypothesis import settings

# The first example of a test may have to compile kernels.
settings.register_profile("multiarm", deadline=None)
settings.load_profile("multiarm")


@pytest.fixture
def rng():
    """Random numbers, the same in every run of a test."""
    import numpy as np

    return np.random.default_rng(20240607)


@pytest.fixture(scope="session")
def block_system():
    """The worked example of two arms and seven fingertips, constant torques."""
    from mechanics import two_arm_block

    import multiarm as ma

    return ma.compile_system(two_arm_block())


@pytest.fixture(scope="session")
def free_block_system():
    """The worked example without torques."""
    from mechanics import two_arm_block

    import multiarm as ma

    return ma.compile_system(two_arm_block(torques=False))


@pytest.fixture(scope="session")
def ur5_system():
    """Two UR5s hold a box: one welded to it, one by a ball joint."""
    from mechanics import ur5_pair

    import multiarm as ma

    return ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "ball"}))


@pytest.fixture(scope="session")
def welded_ur5_system():
    """Two UR5s welded to a box."""
    from mechanics import ur5_pair

    import multiarm as ma

    return ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "weld"}))
