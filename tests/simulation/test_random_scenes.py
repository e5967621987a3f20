"""Claims about random scenes of all families: a sample of those that are judged every night."""

from __future__ import annotations

import numpy as np
import pytest
from judge_trees import AGREEMENT, certified_error, evaluation_figures
from random_trees import ALL_FAMILIES, draw_moving_trees, draw_trees

SEED = 100  # the nightly run begins with it too
CERTIFIED = ("hand_shakes", "several_objects", "planar_arms", "floating_bases")


@pytest.mark.slow
@pytest.mark.parametrize("family", ALL_FAMILIES)
def test_both_solvers_are_those_of_dense_algebra(family, tmp_path):
    figures = evaluation_figures(draw_trees(family, np.random.default_rng(SEED), tmp_path))
    assert max(figures.values()) < AGREEMENT, figures


@pytest.mark.slow
@pytest.mark.parametrize("family", CERTIFIED)
def test_no_certificate_is_false(family, tmp_path):
    drawn = draw_moving_trees(family, np.random.default_rng(SEED), tmp_path)
    certified = certified_error(drawn, duration=0.1)
    assert certified.met is not None
    assert not certified.false, str(certified)
