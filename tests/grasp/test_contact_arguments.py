"""Contacts as arguments: a grasp will do, what is none is refused, one rank, names in reach."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from refusals import refused

import multiarm as ma
from multiarm.errors import GraspError
from multiarm.grasp.contacts import Contacts

GRASP = ma.grasp.design_block_grasp([1.2, 1.0, 0.8])
TOP = GRASP.body.faces[GRASP.faces[6]]
WEIGHT = [0.0, 0.0, 9.81, 0.0, 0.0, 0.0]


class Held:
    """Something with contacts."""

    def __init__(self, contacts: Contacts) -> None:
        self.contacts = contacts


# Questions about contacts, and how many they are asked about.
QUESTIONS = {
    "is_form_closure": (7, lambda c: ma.grasp.is_form_closure(c).margin),
    "configuration_stability": (7, lambda c: ma.grasp.configuration_stability(c).r_star),
    "monte_carlo_stability": (
        7,
        lambda c: ma.grasp.monte_carlo_stability(c, 0.3, 200, 4).fraction,
    ),
    "distribute_forces": (7, lambda c: ma.grasp.distribute_forces(c, WEIGHT).value),
    "worst_force": (7, lambda c: ma.grasp.worst_force(c, [WEIGHT]).force),
    "load_capacity": (7, lambda c: ma.grasp.load_capacity(c, [WEIGHT], 5.0).multiples[0]),
    "liftable": (7, lambda c: ma.grasp.liftable(c, 5.0, np.zeros(6), np.eye(6)[:2]).area),
    "seventh_contact_region": (6, lambda c: ma.grasp.seventh_contact_region(c, TOP).area),
    "seventh_contact_region by moments": (
        6,
        lambda c: ma.grasp.seventh_contact_region(c, TOP, "moments").area,
    ),
    "closes_on_surface": (
        6,
        lambda c: ma.grasp.closes_on_surface(c, TOP.centre, -TOP.normal).sum(),
    ),
    "wrench_cone": (6, lambda c: ma.grasp.wrench_cone(c).facets.sum()),
    "block_inverse": (6, lambda c: ma.grasp.block_inverse(c).determinant),
    "independence": (6, lambda c: ma.grasp.independence(c).determinant),
    "independence_radius": (6, lambda c: ma.grasp.independence_radius(c).lower),
    "violated_conditions": (6, lambda c: len(ma.grasp.violated_conditions(c))),
    "three_moments": (3, lambda c: ma.grasp.three_moments(c).determinant),
}


@pytest.mark.parametrize("name", QUESTIONS)
def test_what_has_contacts_is_asked_as_its_contacts_are(name):
    count, ask = QUESTIONS[name]
    contacts = GRASP.contacts.subset(range(count))
    assert ask(Held(contacts)) == ask(contacts)
    if count == 7:
        assert ask(GRASP) == ask(contacts)


@pytest.mark.parametrize("name", QUESTIONS)
def test_what_has_no_contacts_is_refused_in_words(name):
    _, ask = QUESTIONS[name]
    for none, what in ((GRASP.contacts.points, "ndarray"), (Held([1, 2]), "Held"), (None, "None")):
        with refused(GraspError, f"not {what}"):
            ask(none)


def test_regions_of_each_contact_are_asked_of_a_grasp():
    with refused(GraspError, "not Contacts", "seventh_contact_region"):
        ma.grasp.own_regions(GRASP.contacts)


# --- some of the contacts ------------------------------------------------------------------------


def test_contacts_are_chosen_by_numbers_or_by_truth_values():
    contacts = GRASP.contacts
    for chosen in ([2, 5], np.array([2, 5]), (k for k in (2, 5))):
        assert contacts.subset(chosen).names == (contacts.names[2], contacts.names[5])
    mask = np.arange(7) % 2 == 0
    for values in (mask, mask.tolist()):
        assert np.array_equal(contacts.subset(values).points, contacts.points[::2])


@pytest.mark.parametrize(
    ("chosen", "place"),
    [
        ([9], "numbers 0 to 6; got [9]"),
        ([-1], "numbers 0 to 6; got [-1]"),
        ([True, False], "7 contacts must have as many truth values, not 2"),
        ([False] * 7, "none was chosen"),
        ([], "none was chosen"),
        ([1.0], "whole numbers"),
        (["a"], "whole numbers"),
    ],
)
def test_contacts_that_there_are_not_cannot_be_chosen(chosen, place):
    with refused(GraspError, place):
        GRASP.contacts.subset(chosen)


# --- one rank ------------------------------------------------------------------------------------


def nearly_dependent(gap):
    """Six contacts at opposite corners whose normal lines miss each other by ``gap``."""
    A, half = 0.1, np.array([0.6, 0.5, 0.4])
    three = half - np.array([[0.0, A, A], [A, 0.0, A], [A - gap, A, 0.0]])
    return Contacts(np.vstack([three, -three]), np.vstack([-np.eye(3), np.eye(3)]))


def rank_by_itself(contacts):
    s = np.linalg.svd(contacts.scaled_wrenches, compute_uv=False)
    return s[-1] / s[0]


@pytest.mark.parametrize("gap", [0.0, 1e-13, 1e-12, 1e-11, 3e-11, 2e-10, 1e-9, 3e-9, 1e-8, 1e-6])
def test_every_part_of_the_package_tells_the_same_rank(gap):
    six = nearly_dependent(gap)
    independent = rank_by_itself(six) > 1e-10
    assert (ma.grasp.is_form_closure(six).rank == 6) == independent
    assert ma.grasp.independence(six).independent == independent
    assert (ma.grasp.independence_radius(six).lower > 0.0) == independent
    asked = (
        ma.grasp.wrench_cone,
        ma.grasp.block_inverse,
        ma.grasp.configuration_stability,
        lambda c: ma.grasp.seventh_contact_region(c, TOP),
    )
    for ask in asked:
        if independent:
            ask(six)
        else:
            with refused(GraspError):
                ask(six)


def test_the_gaps_lie_on_both_sides_of_the_border():
    ratios = [rank_by_itself(nearly_dependent(gap)) for gap in (2e-10, 1e-9)]
    assert ratios[0] < 1e-10 < ratios[1]


def test_the_advice_about_a_missing_rank_holds():
    six = nearly_dependent(0.0)
    with refused(GraspError, "independence says what depends on what"):
        ma.grasp.wrench_cone(six)
    assert ma.grasp.independence(six).dependent
    seven = six.joined(six.subset([0]))
    with refused(GraspError, "is_form_closure says which motion is free"):
        ma.grasp.wrench_cone(seven)
    assert np.abs(seven.wrenches.T @ ma.grasp.is_form_closure(seven).motion).max() < 1e-12


@pytest.mark.parametrize("huge", [10**400, Fraction(10**400, 3)], ids=["int", "fraction"])
def test_a_number_beyond_all_floats_is_refused(huge):
    with pytest.raises(GraspError, match="positive factor"):
        GRASP.body.scaled(huge)
    with pytest.raises(GraspError, match="finite length"):
        ma.grasp.design_block_grasp([1.2, 1.0, 0.8], offset=huge)
    with pytest.raises(GraspError, match="lengths"):
        ma.grasp.design_block_grasp([huge, 1.0, 0.8])


# --- names ---------------------------------------------------------------------------------------


def test_every_public_name_is_the_thing_itself_whatever_was_used_before():
    assert list(ma.grasp.__all__) == sorted(ma.grasp.__all__)
    for name in ("block_design", "parallel_design", "three_moments", "wrench_cone"):
        assert name in ma.grasp.__all__
    ma.grasp.configuration_stability(GRASP)
    for name in ma.grasp.__all__:
        assert callable(getattr(ma.grasp, name)), name
