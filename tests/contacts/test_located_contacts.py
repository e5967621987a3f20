"""Claims about exceptions that are raised while contacts of two surfaces are located."""

from __future__ import annotations

import pinocchio
import pytest
from mechanics import ur5_pair

import multiarm as ma
from multiarm.dynamics.contact_geometry import locate_pairs

RADIUS = 0.3  # [m]


class Ball:
    """Signed distance of a ball; the call of a number is interrupted."""

    calls, interrupted = 0, 0

    def __call__(self, p):
        self.calls += 1
        if self.calls == self.interrupted:
            raise KeyboardInterrupt
        return (p[0] ** 2 + p[1] ** 2 + p[2] ** 2) ** 0.5 - RADIUS


def compiled(ball: Ball) -> ma.System:
    """An arm's ellipsoid at a ball whose distance is a function of the user."""
    ellipsoid = {"ellipsoid": {"semi_axes": [0.05, 0.04, 0.03]}}
    contact = {"arm": ellipsoid, "object": {"surface": {"distance": ball, "length": RADIUS}}}
    scene = ur5_pair({"kind": "contacts", "contacts": [contact]}, {"kind": "weld"})
    return ma.compile_system(scene, assemble=False)


def test_ctrl_c_in_a_surface_ends_an_evaluation():
    ball = Ball()
    system = compiled(ball)
    state = system.initial_state()
    expected = ma.evaluate(system, 0.0, state)
    ball.interrupted = ball.calls + 1
    with pytest.raises(KeyboardInterrupt):
        ma.evaluate(system, 0.0, state)
    assert ma.evaluate(system, 0.0, state).object_acceleration == pytest.approx(
        expected.object_acceleration, rel=1e-12
    )


@pytest.mark.parametrize("call", [1, 2, 30, 1000, 100_000])
def test_ctrl_c_in_a_surface_ends_a_compilation_whenever_it_comes(call):
    """Also where the surface is called again, and fails, before the exception is looked at."""
    ball = Ball()
    ball.interrupted = call
    with pytest.raises(KeyboardInterrupt):
        compiled(ball)


def test_an_arm_that_fails_while_contacts_are_located_is_an_error(monkeypatch):
    """Else they would be located at links that are not where the state has them."""
    crba, failing = pinocchio.crba, []

    def fail(*arguments):
        if failing:
            raise LookupError(failing.pop())
        return crba(*arguments)

    monkeypatch.setattr(pinocchio, "crba", fail)
    system = compiled(Ball())
    with system.borrow() as data:
        failing.append("the arm")
        with pytest.raises(LookupError, match="the arm"):
            locate_pairs(data, system.initial_state())
