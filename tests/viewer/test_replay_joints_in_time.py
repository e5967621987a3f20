"""Claims about replays of runs in which joints take hold and let go."""

from __future__ import annotations

import numpy as np
import pytest
from box_between_arms import from_, two_arms
from event_scenes import arm

import multiarm as ma
from multiarm.results.contact_states import ContactState
from multiarm.scene import parse_scene
from multiarm.scene.values import rotation_matrix
from multiarm.viewer.animate import animate

SPEED = 0.5  # [m/s], of the right hand along x


def sliding_hand(spin=0.0, **joint):
    """A run of a hand that slides past a box and holds it for two stretches of time.

    It turns about z at a rate ``spin`` [rad/s], too.
    """
    right = arm("xyzXYZ", posture=[0, 0, 0.1, 0, 0, 0], velocity=[SPEED, 0, 0, 0, 0, spin])
    data = two_arms(control="none", right=right, **from_([[0.1, 0.2], [0.4, 0.5]]))
    data |= {"gravity": None, "effects": {}}
    data["joints"][1] |= joint
    system = ma.compile_system(parse_scene(data))
    return ma.simulate(system, 0.6, accuracy=1e-6, output_step=0.01, certificate=False)


def animation_of(run):
    return animate(run, fps=100.0, speed=1.0, meshes=False)


@pytest.fixture(scope="module")
def animation():
    """The hand slides on a rail while it holds the box."""
    return animation_of(sliding_hand(kind="prismatic", axis=[1, 0, 0]))


def held(time):
    return ((time >= 0.1) & (time < 0.2)) | ((time >= 0.4) & (time < 0.5))


def away_from_events(time):
    return np.abs(time[:, None] - [0.1, 0.2, 0.4, 0.5]).min(axis=1) > 1e-6


def test_contacts_are_shown_open_while_their_joint_does_not_hold(animation):
    (track,) = [track for track in animation.contacts if track.arm == "right"]
    sure = away_from_events(animation.time)
    expected = np.where(held(animation.time), ContactState.TOUCHING, ContactState.OPEN)
    assert (track.state[sure] == expected[sure, None]).all()
    (other,) = [track for track in animation.contacts if track.arm == "left"]
    assert other.state is None


def test_joints_are_shown_while_they_hold(animation):
    (hinge,) = [hinge for hinge in animation.hinges if hinge.arm == "right"]
    sure = away_from_events(animation.time)
    assert (hinge.shown == held(animation.time))[sure].all()


def test_joints_are_shown_where_they_have_taken_hold(animation):
    """The rail stays on the box where the hand was when it took hold."""
    (hinge,) = [hinge for hinge in animation.hinges if hinge.arm == "right"]
    for begin, end in ((0.1, 0.2), (0.4, 0.5)):
        frames = (animation.time > begin + 1e-6) & (animation.time < end - 1e-6)
        place = [SPEED * begin, 0, 0.1]
        np.testing.assert_allclose(
            hinge.position[frames], np.tile(place, (frames.sum(), 1)), atol=1e-8
        )


def test_contact_normals_turn_with_the_hand_from_where_it_has_taken_hold():
    """Those of a weld have the same directions in the hand's axes, however it holds the box."""
    run = sliding_hand(spin=3.0)
    animation = animation_of(run)
    (track,) = [track for track in animation.contacts if track.arm == "right"]
    frames = held(animation.time) & away_from_events(animation.time)
    rows = np.searchsorted(run.time, animation.time[frames])
    hands = [rotation_matrix((), q) for q in run.tip_quaternions_xyzw["right"][rows]]
    normals = track.normal[frames] @ np.array(hands)
    np.testing.assert_allclose(normals, np.tile(normals[0], (len(normals), 1, 1)), atol=1e-8)


def test_events_flash_where_joints_take_hold(animation):
    places = {round(event.time, 6): event.where for event in animation.event_places}
    assert sorted(places) == [0.1, 0.2, 0.4, 0.5]
    np.testing.assert_allclose(places[0.4], [SPEED * 0.4, 0, 0.1], atol=1e-8)


def test_surfaces_are_shown_where_their_joint_has_taken_hold():
    """The plane on the box, which the hand slides along, is moved as far as the hand was."""
    run = sliding_hand(kind="point_on_plane")
    animation = animation_of(run)
    (plane,) = [body for body in animation.bodies if body.name == "surfaces/right/1_object"]
    for begin, end in ((0.1, 0.2), (0.4, 0.5)):
        frames = (animation.time > begin + 1e-6) & (animation.time < end - 1e-6)
        place = [SPEED * begin, 0, 0.1]
        np.testing.assert_allclose(
            plane.position[frames], np.tile(place, (frames.sum(), 1)), atol=1e-8
        )
