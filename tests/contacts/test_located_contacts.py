"""Claims about exceptions that are raised while contacts of two surfaces are located."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest
from mechanics import ur5_pair
from tree_scenes import two_finger_scene

import multiarm as ma
from multiarm.dynamics.contact_geometry import _guesses, locate_pairs
from multiarm.scene import parse_scene

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


@pytest.mark.parametrize("order", [["hand/thumb", "hand/end"], ["hand/end", "hand/thumb"]])
def test_contacts_of_two_links_are_sought_around_both_surfaces_and_the_joint(order, tmp_path):
    """Also behind a fixed joint, by which a tip is turned and moved against the link."""
    first_centre, second_centre = np.array([0.01, 0.02, 0.03]), np.array([-0.2, 0.1, 0.05])
    arm = {"ellipsoid": {"semi_axes": [0.05, 0.04, 0.03], "center": first_centre.tolist()}}
    body = {"ellipsoid": {"semi_axes": [0.02, 0.03, 0.02], "center": second_centre.tolist()}}
    contacts = [{"arm": arm, "object": body}]
    joint_origin = np.array([0.1, -0.2, 0.3])  # in the frame of the second tip, not turned
    joint = {"between": order, "kind": "contacts", "contacts": contacts}
    joint |= {"at": {"xyz": joint_origin.tolist()}, "at_first": {}}
    path = tmp_path / "hand.urdf"
    scene = two_finger_scene(path, "0.5 0.4 0.3", "0.4 0.5 2.6", joint)
    system = ma.compile_system(parse_scene(scene), assemble=False)
    model = pinocchio.buildModelFromUrdf(str(path))
    data = model.createData()
    posture = system.initial_state().joint_positions["hand"]
    q = [posture[system.arms["hand"].joint_names.index(name)] for name in model.names[1:]]
    pinocchio.framesForwardKinematics(model, data, np.array(q))
    first, second = (data.oMf[model.getFrameId(tip.split("/")[1])] for tip in order)
    layout = system.model.layout
    row = layout.contacts_of(layout.owners.index("loop")).start
    with system.borrow() as arrays:
        locate_pairs(arrays, system.initial_state())
        points = _guesses(arrays, "loop", row, system.model.bodies_of("loop")[1])
    # the guiding body is the second link: its frame is that of the joint that moves it
    link = data.oMi[model.frames[model.getFrameId(order[1].split("/")[1])].parentJoint]
    centres = [second * (joint_origin + second_centre), first * first_centre, second * joint_origin]
    expected = [link.actInv(centre) for centre in centres]
    np.testing.assert_allclose(points[:: len(points) // 3], expected, atol=1e-14)
