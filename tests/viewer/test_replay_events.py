"""Events and states of contacts in the replay: what opens fades, what happens flashes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from mechanics import ur5_pair
from replay_pages import SCENE, SEEK, opened
from sample_run import rows_of

import multiarm as ma
from multiarm.results.channels import Channel
from multiarm.results.contact_states import ContactState
from multiarm.results.event_kinds import LOST, MADE, SLIP, family_of
from multiarm.results.sinks import MemorySink
from multiarm.scene import parse_scene
from multiarm.scene.joints.contacts import ContactsJoint
from multiarm.viewer import replay
from multiarm.viewer.animate import animate
from multiarm.viewer.animation import EventPlace, rotations
from multiarm.viewer.contact_tracks import contacts_of, event_places, row_states
from multiarm.viewer.drawing import draw
from multiarm.viewer.glyphs import AT_ONCE, DURATION, LEAST, event_tracks
from multiarm.viewer.page import MOST_ROWS, MOST_TICKS, time_line

RIGHT = ("SLIDING", "STICKING", "RESTING", "TOUCHING", "OPEN", "TOUCHING")
OPENS, CLOSES = 0.2, 0.3  # [s]: the left contact is away in between
WHERE = (-0.6, 0.1, 0.9)
SIZE = """(path) => {
  const node = viewer.scene_tree.find(path).object;
  return node.getWorldScale(node.scale.clone()).x;
}"""
FRAMES = np.linspace(0.0, 1.0, 31)


def event(time, kind, **more):
    named = {"arm": "left", "contact": "contact 1", **more}
    text = f"{named['arm']}: {named['contact']} {kind}"
    return {"time": time, "kind": kind, "text": text, **named}


EVENTS = [
    {"time": 0.0, "kind": "start", "text": "start: assembled"},
    event(OPENS, "lets go", where=list(WHERE), after={"gap_rate_m_s": 0.02}),
    event(0.25, "slides", arm="right", contact="weld 1"),
    event(CLOSES, "touches", where=list(WHERE), before={"gap_rate_m_s": -0.3}),
]


@pytest.fixture(scope="module")
def plain():
    """A fingertip on a face, and a weld."""
    pad = {"ellipsoid": {"center": [0, 0, -0.05], "semi_axes": [0.09, 0.06, 0.05]}}
    face = {"plane": {"point": [-0.6, 0, 0], "normal": [-1, 0, 0]}}
    finger = {"kind": "contacts", "contacts": [{"arm": pad, "object": face}]}
    system = ma.compile_system(ur5_pair(finger, {"kind": "weld"}))
    run = ma.simulate(system, 0.5, accuracy=1e-5, output_step=0.01)
    return run.with_outcome(events=[])


def with_states(plain, events):
    """The run with states: the fingertip is away for a while, the weld's rows do all there is."""
    time = plain.time
    labels = {arm: plain.channels[f"arms/{arm}/contact_force"].labels for arm in plain.arm_names}
    away = (time >= OPENS) & (time < CLOSES)
    states = {
        "left": np.where(away, ContactState.OPEN, ContactState.TOUCHING)[:, None],
        "right": np.tile([ContactState[name] for name in RIGHT], (len(time), 1)),
    }
    added = [
        Channel(f"arms/{arm}/contact_state", (len(labels[arm]),), labels=labels[arm])
        for arm in states
    ]
    sink, channels = MemorySink(), [*plain.channels.values(), *added]
    sink.open(channels, plain.provenance)
    block = {name: plain.read(name) for name in plain.channels}
    block |= {f"arms/{arm}/contact_state": states[arm] for arm in states}
    sink.append(rows_of(channels, block))
    return sink.finish("completed", "", {}, events)


@pytest.fixture(scope="module")
def run(plain):
    return with_states(plain, EVENTS)


@pytest.fixture(scope="module")
def animation(run):
    return animate(run, fps=100, speed=1, meshes=False)


@pytest.fixture(scope="module")
def exported(run, tmp_path_factory):
    return replay(run, tmp_path_factory.mktemp("events") / "run.html", meshes=False)


# What the animation says


@pytest.mark.slow
def test_open_contact_has_no_arrow_whatever_force_was_recorded(animation):
    (left, right) = animation.contacts
    lengths = animation.arrow_lengths(left)[:, 0]
    away = (animation.time >= OPENS) & (animation.time < CLOSES)
    assert np.abs(left.force[away]).min() > 0
    assert not lengths[away].any()
    assert lengths[~away].all()
    assert not animation.arrow_lengths(right)[:, 4].any()


@pytest.mark.slow
def test_animation_of_a_run_without_states_is_as_before(plain):
    animation = animate(plain, fps=10, speed=1, meshes=False)
    assert [contacts.state for contacts in animation.contacts] == [None, None]
    assert {body.touched is None for body in animation.bodies} == {True}
    assert (animation.event_places, animation.events) == ([], [])


@pytest.mark.slow
def test_surfaces_know_when_they_are_touched(animation):
    away = (animation.time >= OPENS) & (animation.time < CLOSES)
    surfaces = {body.name: body for body in animation.bodies if body.name.startswith("surfaces/")}
    assert set(surfaces) == {"surfaces/left/1_arm", "surfaces/left/1_object"}
    for body in surfaces.values():
        np.testing.assert_array_equal(body.touched, ~away)


def test_event_without_a_place_flashes_at_its_contact(animation, run):
    lost, slip, made = animation.event_places
    assert (lost.family, slip.family, made.family) == (LOST, SLIP, MADE)
    np.testing.assert_array_equal(lost.where, WHERE)
    right = animation.contacts[1]
    frame = int(np.abs(animation.time - 0.25).argmin())
    np.testing.assert_array_equal(slip.where, right.point[frame, 0])


@pytest.mark.parametrize(
    "odd",
    [{"where": [1.0, 2.0]}, {"where": [float("nan"), 0.0, 0.0]}, {"contact": "nobody"},
     {"arm": "floor"}],
)  # fmt: skip
def test_event_without_a_known_place_does_not_flash(run, animation, odd):
    changed = run.with_outcome(events=[event(0.1, "touches", **odd)])
    assert event_places(changed, animation.time, animation.contacts) == []


@pytest.fixture(scope="module")
def above_a_floor():
    """Two arms swing a beam above a rough floor that it does not reach."""
    floor = "effects: {floor: {at: {xyz: [0, 0, -1]}, mu: 0.3}}"
    scene = parse_scene(SCENE.replace("run: {", f"{floor}\nrun: {{"), folder=None)
    return ma.simulate(ma.compile_system(scene), 0.04, accuracy=1e-4, certificate=False)


def test_corners_above_a_floor_are_where_the_object_has_them(above_a_floor):
    animation = animate(above_a_floor, fps=100, speed=1, meshes=False)
    floor = animation.contacts[-1]
    assert [contacts.arm for contacts in animation.contacts] == ["left", "right", "floor"]
    assert floor.friction == (False, True, True) * 8
    assert set(floor.state.flat) == {ContactState.OPEN}
    corners = animation.bodies[0].mesh.bounds()
    R = rotations(above_a_floor.object_quaternion_xyzw[-1:])[0]
    expected = corners @ R.T + above_a_floor.object_position[-1]
    places = floor.point[-1, ::3]
    gaps = np.linalg.norm(places[:, None] - expected, axis=2)
    assert gaps.min(axis=0).max() < 1e-9  # every corner has its contact
    np.testing.assert_allclose(
        floor.normal[:, ::3], np.tile([0, 0, 1.0], (len(animation.time), 8, 1))
    )


def test_rows_of_friction_have_no_mark_of_their_own(above_a_floor):
    animation = animate(above_a_floor, fps=100, speed=1, meshes=False)
    paths = {command["path"] for command in draw(animation) if command["type"] == "set_object"}
    marked = {path for path in paths if path.startswith("/world/contacts/floor/")}
    assert marked == {f"/world/contacts/floor/{3 * k + 1}/open" for k in range(8)}


def test_rows_of_friction_have_the_state_of_their_contact(above_a_floor):
    system = ma.compile_system(above_a_floor.scene)
    block = {name: above_a_floor.read(name) for name in above_a_floor.channels}
    states = np.tile(np.arange(8.0) % 5, (len(above_a_floor), 1))
    sink, channels = MemorySink(), [*above_a_floor.channels.values()]
    sink.open(channels, above_a_floor.provenance)
    sink.append(rows_of(channels, {**block, "environment/contact_state": states}))
    run = sink.finish("completed", "", {})
    colors = {arm: np.zeros(3) for arm in run.arm_names}
    floor = contacts_of(system, run, np.array([0]), colors)[-1]
    assert floor.state[0].tolist() == np.repeat(np.arange(8) % 5, 3).tolist()


def test_a_contact_with_a_comma_in_its_name_has_no_state_of_another():
    """Only "finger" has states; "finger, left" and its rows without slip stay closed."""
    pair = {"arm": {"sphere": {"radius": 0.01}}, "object": {"plane": {"normal": [0, 0, 1]}}}
    joint = ContactsJoint(
        arm="left",
        contacts=[{"name": "finger", **pair}, {"name": "finger, left", "rolling": True, **pair}],
    )
    channel = Channel("arms/left/contact_state", (1,), labels=("finger",))
    run = SimpleNamespace(
        channels={channel.name: channel},
        contact_states={"left": np.array([[ContactState.OPEN]])},
        scene=SimpleNamespace(joints=()),
    )
    states = row_states(run, "left", joint.records(), np.array([0]))
    assert states.tolist() == [[ContactState.OPEN] + 3 * [ContactState.TOUCHING]]


# Flashes


def places_of(times, family=MADE, where=WHERE):
    return [EventPlace(t, family, np.array(where, float)) for t in times]


def test_flash_is_full_in_the_first_frame_after_its_event_and_then_shrinks():
    ((position, scale),) = event_tracks(places_of([0.31]), FRAMES)
    begin = int(np.searchsorted(FRAMES, 0.31))
    assert scale[:begin].max() < 1e-3
    assert scale[begin] > 0.9
    lit = scale > 1e-3
    assert np.all(np.diff(scale[lit]) < 0)
    assert FRAMES[lit].max() < 0.31 + DURATION
    np.testing.assert_array_equal(position[begin], WHERE)


def test_event_between_coarse_frames_or_after_the_last_is_seen():
    coarse = np.array([0.0, 10.0, 20.0])
    for time, frame in ((3.0, 1), (25.0, 2)):
        ((_, scale),) = event_tracks(places_of([time]), coarse)
        assert scale[frame] >= LEAST
        assert np.delete(scale, frame).max() < 1e-3


def test_thousands_of_impacts_need_a_few_flashes():
    many = places_of(np.linspace(0, 1, 5000))
    found = event_tracks(many, FRAMES)
    assert 0 < len(found) <= AT_ONCE
    lit = np.max([scale for _, scale in found], axis=0) > 1e-3
    assert lit[1:].all()  # something is seen all the time


def test_flashes_at_two_places_do_not_wander():
    coarse = np.arange(10.0)
    for time, begins in ((FRAMES, (0.2, 0.21)), (coarse, (2.5, 3.5))):  # overlap; are neighbours
        there = [
            *places_of(begins[:1], where=(1, 0, 0)),
            *places_of(begins[1:], where=(0, 1, 0)),
        ]
        both = event_tracks(there, time)
        assert len(both) == 2
        for position, scale in both:
            assert np.ptp(position[scale > 1e-3], axis=0).max() == 0.0


def test_flash_that_is_used_again_is_where_each_event_was():
    there = [*places_of([0.1], where=(1, 0, 0)), *places_of([0.7], where=(0, 1, 0))]
    ((position, scale),) = event_tracks(there, FRAMES)
    lit = scale > 1e-3
    early = FRAMES < 0.6
    np.testing.assert_array_equal(position[lit & early], [[1, 0, 0]] * int((lit & early).sum()))
    np.testing.assert_array_equal(position[lit & ~early], [[0, 1, 0]] * int((lit & ~early).sum()))
    assert (lit & early).sum() > 5 < (lit & ~early).sum()


# The time line


def test_ticks_and_rows_are_bounded_and_count_everything():
    events = [event(i / 5000, "slides", contact=f"c{i % 1000}") for i in range(5000)]
    line = time_line(events, FRAMES, 1.0)
    assert line["count"] == 5000
    assert 20 < len(line["ticks"]) <= MOST_TICKS
    assert len(line["rows"]) == MOST_ROWS
    assert line["unlisted"] == 5000 - 5 * MOST_ROWS
    assert line["ticks"][0]["words"].startswith("0 s, ")


def test_ticks_stand_at_the_frame_that_shows_the_event():
    line = time_line(EVENTS, FRAMES, 0.5)
    assert [tick["at"] for tick in line["ticks"]] == pytest.approx(
        [2 * FRAMES[np.searchsorted(FRAMES, e["time"])] for e in EVENTS[1:]]
    )
    assert line["rows"][0]["words"] == ["0.2 s", "left: contact 1 lets go", "gap rate 0.02 m/s"]
    names = [line["families"][tick["families"][0]][0] for tick in line["ticks"]]
    assert names == [family_of(e["kind"]).name for e in EVENTS[1:]]


def test_single_frame_has_a_time_line():
    line = time_line(EVENTS, np.array([0.0]), 1.0)
    assert [tick["at"] for tick in line["ticks"]] == [0.0]


# In the browser


def size_of(page, *path):
    return page.evaluate(SIZE, ["world", *path])


@pytest.mark.slow
def test_marks_and_surfaces_follow_the_states(view, exported):
    page = opened(view, exported)
    mark = ("contacts", "left", "1")
    for time, now, other in ((0.1, "touching", "open"), (0.25, "open", "touching")):
        page.evaluate(SEEK, time)
        assert size_of(page, *mark, now) == pytest.approx(1.0)
        assert size_of(page, *mark, other) < 1e-3
        surface = {"touching": "touched", "open": "open"}
        assert size_of(page, "surfaces", "left", "1_arm", surface[now]) == pytest.approx(1.0)
        assert size_of(page, "surfaces", "left", "1_arm", surface[other]) < 1e-3
    kinds = """(row) => Object.keys(
      viewer.scene_tree.find(["world", "contacts", "right", String(row)]).children)"""
    assert [page.evaluate(kinds, row)[0] for row in range(1, 6)] == [
        "sliding", "sticking", "resting", "touching", "open",
    ]  # fmt: skip
    assert page.inner_text("#states").split() == [
        "◌open", "●touching", "◎sliding", "■sticking", "○resting",
    ]  # fmt: skip
    assert view.complaints == []


@pytest.mark.slow
def test_what_happens_flashes_where_it_happens(view, exported):
    page = opened(view, exported)
    page.click("#events summary")
    page.click("#events button >> nth=0")
    flash = "1_0"  # of the family of what is lost
    assert size_of(page, "events", flash) > 0.5
    place = page.evaluate(
        "(path) => viewer.scene_tree.find(path).object.position.toArray()",
        ["world", "events", flash],
    )
    assert place == pytest.approx(WHERE, abs=1e-6)
    page.evaluate(SEEK, 0.1)
    assert size_of(page, "events", flash) < 1e-3
    page.uncheck("text=flashes of events")
    assert page.evaluate("viewer.scene_tree.find(['world', 'events']).object.visible") is False


@pytest.mark.slow
def test_list_and_ticks_lead_to_the_events(view, exported):
    page = opened(view, exported)
    assert page.inner_text("#events summary") == "events (3)"
    page.click("#events summary")
    page.click("#events button >> nth=2")
    page.wait_for_function("document.querySelector('#clock').textContent.startsWith('0.30')")
    page.wait_for_function("document.querySelectorAll('#events button.now').length === 1")
    assert "touches" in page.inner_text("#events button.now")
    assert page.inner_text("#happening") == "▼ left: contact 1 touches"
    assert page.evaluate("viewer.animator.playing") is False
    box = page.locator("#ticks").bounding_box()
    page.mouse.click(box["x"] + box["width"] * 0.41, box["y"] + 4)  # at 0.2 of 0.5 s, nearly
    page.wait_for_function("document.querySelector('#clock').textContent.startsWith('0.20')")
    assert page.locator("#ticks i").count() == 3
    assert "lets go" in page.get_attribute("#ticks", "title")


@pytest.mark.slow
def test_thousands_of_events_leave_the_page_light(view, plain, tmp_path):
    events = [event(0.5 * i / 8000, "slides", contact=f"c{i % 2000}") for i in range(8000)]
    page = opened(view, replay(with_states(plain, events), tmp_path / "many.html", meshes=False))
    assert page.inner_text("#events summary") == "events (8000)"
    assert page.locator("#events button").count() == MOST_ROWS
    assert page.locator("#ticks i").count() <= MOST_TICKS
    assert "more, in the trajectory's events" in page.inner_html("#events")
    page.wait_for_function("viewer.animator.time > 0.05", timeout=60_000)  # and it plays
    assert view.complaints == []


@pytest.mark.slow
def test_run_without_events_has_no_list_and_no_ticks(view, plain, tmp_path):
    page = opened(view, replay(plain, tmp_path / "none.html", meshes=False))
    assert not page.is_visible("#events")
    assert not page.is_visible("#ticks")
    assert not page.is_visible("#happening")
    assert page.inner_text("#states") == ""
    assert view.complaints == []
