"""Events and states of contacts in words, figures, reports and the terminal: none is lost."""

from __future__ import annotations

import io
import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.patches import PathPatch
from page_reader import Page
from rich.console import Console
from sample_run import (
    CHANNELS,
    CONTACTS,
    JOINTS,
    SCENE,
    STATISTICS,
    earlier_run,
    record,
    rows_of,
    samples,
)

from multiarm import plots
from multiarm.cli.run import SHOWN_KINDS, run_figures, summary_table
from multiarm.errors import TrajectoryError
from multiarm.notation import number
from multiarm.plots.panels import DISTINCT
from multiarm.plots.run_figures import MOST_ROWS, spans
from multiarm.reports.report import SHOWN_EVENTS, render
from multiarm.results.channels import trajectory_channels
from multiarm.results.contact_states import RECORDED_STATES, ContactState
from multiarm.results.event_kinds import FAMILIES, OTHER, EventKind, family_of
from multiarm.results.event_log import RunEvent, change, counts, grouped, timed, what, who
from multiarm.results.sinks import Hdf5Sink, MemorySink
from multiarm.results.trajectory import load_trajectory

CORNERS = ("corner_1", "corner_2")
EFFECTS = ("joint_damping", "drag")
STATES = {"right": CONTACTS["right"], "floor": CORNERS}
FULL = trajectory_channels(
    JOINTS, CONTACTS, works=EFFECTS, states=STATES, environment={"floor": CORNERS}
)
OLD_KINDS = (
    "pulls", "pushes again", "leaves its patch", "is back on its patch", "passes its limit",
    "is back within its limit",
)  # fmt: skip
NEW_KINDS = (
    "touches", "lets go", "slides", "sticks", "bounces", "comes to rest", "reaches its limit",
    "leaves its limit", "joint sticks", "joint slips", "saturates", "is no longer saturated",
)  # fmt: skip


def event(time, kind, arm="floor", contact="corner_1", **more):
    text = f"{arm}: {contact} {kind}"
    names = {"arm": arm, "contact": contact}
    return {"time": time, "kind": kind, "text": text, "what": kind, **names, **more}


def bounces(count, contact="corner_1", begin=1.0, end=2.0):
    """A contact that bounces lower and lower."""
    times, down = np.linspace(begin, end, count), -(0.9 ** np.arange(count))
    return [
        event(
            float(t), "bounces", contact=contact, before={"gap_rate_m_s": float(v)},
            after={"gap_rate_m_s": float(-0.5 * v), "impulse_N_s": float(-2 * v)},
        )
        for t, v in zip(times, down, strict=True)
    ]  # fmt: skip


def eventful(events=(), channels=FULL, sink=None, step=0.01, **outcome):
    """The pendulum with a floor: contacts of the right arm open at 2 s, corners slide at 3 s."""
    sink, block = sink or MemorySink(), samples(step=step)
    late = (block["time"] >= 2.0)[:, None]
    added = {
        "arms/right/contact_state": np.where(late, ContactState.OPEN, [[1, 2, 3]]),
        "environment/contact_state": np.where(
            block["time"][:, None] >= 3.0, ContactState.SLIDING, [[3, 4]]
        ),
        "environment/contact_force": np.where(late, 70.0, [[20.0, -5.0]]),
        "environment/wrench": np.where(late, 0.0, [[0.0, 0.0, 15.0, 1.0, 0.0, 0.0]]),
        "effects/joint_damping/work": -2.0 * block["time"],
        "effects/drag/work": -0.1 * block["time"] ** 2,
    }
    sink.open(channels, {"scene": SCENE})
    sink.append(rows_of(channels, {**block, **added}))
    return sink.finish(outcome.pop("status", "completed"), "", STATISTICS, list(events), **outcome)


def marks(axes):
    """Times of the upright lines of each family."""
    patches = [patch for patch in axes.get_children() if isinstance(patch, PathPatch)]
    return {patch.get_label(): patch.get_path().vertices[::2, 0] for patch in patches}


# Channels


def test_runs_without_such_contacts_have_the_channels_they_had():
    assert trajectory_channels(JOINTS, CONTACTS, None, (), {}, {}, True) == CHANNELS
    assert not [c.name for c in CHANNELS if "state" in c.name or "environment" in c.name]


def test_states_and_floor_have_channels_with_the_names_of_the_contacts():
    added = {c.name: c for c in FULL if c not in CHANNELS}
    assert set(added) == {
        "arms/right/contact_state", "environment/contact_state", "environment/contact_force",
        "environment/wrench", "effects/joint_damping/work", "effects/drag/work",
    }  # fmt: skip
    assert added["environment/contact_force"].labels == CORNERS
    assert added["environment/contact_force"].unit == "N"
    assert added["arms/right/contact_state"].labels == tuple(CONTACTS["right"])
    described = added["environment/contact_state"].description
    assert all(f"{state.value} {state.word}" in described for state in RECORDED_STATES)


def test_trajectory_has_the_floor_beside_the_arms(tmp_path):
    eventful(sink=Hdf5Sink(tmp_path / "run.h5"))
    run = load_trajectory(tmp_path / "run.h5")
    assert list(run.contact_forces) == list(run.contact_states) == ["left", "right", "floor"]
    assert list(run.wrenches) == ["left", "right", "floor"]
    assert list(run.tip_positions) == ["left", "right"]
    assert len(run.contact_states) == 3
    assert run.contact_states["left"].shape == (len(run), 0)
    assert run.contact_states["right"][0].tolist() == [1, 2, 3]
    assert run.contact_states["floor"][-1].tolist() == [ContactState.SLIDING, ContactState.SLIDING]
    assert run.contact_forces["floor"][0].tolist() == [20.0, -5.0]
    summary = run.summary()
    assert summary["contact_force_max_N"]["floor"] == 70.0
    assert summary["wrench_max"]["floor"] == {
        "force_N": 15.0, "force_time_s": 0.0, "moment_N_m": 1.0, "moment_time_s": 0.0
    }  # fmt: skip
    assert run.arm_names == ("left", "right")


def test_without_a_floor_it_is_an_unknown_arm():
    run = record(MemorySink())
    assert list(run.contact_forces) == ["left", "right"]
    for mapping in (run.contact_forces, run.contact_states):
        with pytest.raises(TrajectoryError, match="unknown arm 'floor'; arms are 'left', 'right'"):
            mapping["floor"]


def test_an_arm_that_is_called_floor_keeps_its_own_forces():
    channels = trajectory_channels(
        {"floor": {"slide": "m"}}, {"floor": ["a"]}, environment={"floor": ["corner", "other"]}
    )
    sink = MemorySink()
    sink.open(channels, {"scene": ""})
    sink.append(np.full((2, sum(channel.width for channel in channels)), 7.0))
    run = sink.finish("completed", "", {})
    assert list(run.contact_forces) == ["floor"]
    assert run.contact_forces["floor"].tolist() == [[7.0], [7.0]]
    assert len(plots.contact_forces(run).axes) == 1


# Words


def test_every_kind_has_a_family_that_looks_like_no_other():
    assert OTHER not in {family_of(kind) for kind in (*OLD_KINDS, *NEW_KINDS)}
    assert family_of("painleve") is family_of("method changes") is OTHER
    assert len({f.sign for f in FAMILIES}) == len({f.colour for f in FAMILIES}) == len(FAMILIES)
    assert family_of("touches") is family_of("bounces") is not family_of("lets go")


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ({"gap_rate_m_s": -0.31}, {"gap_rate_m_s": 0.22, "impulse_N_s": 1.2},
         "gap rate -0.31 → 0.22 m/s, impulse 1.2 N s"),
        ({"state": "sticking"}, {"state": "sliding"}, "sticking → sliding"),
        (None, {"slip_m_s": [0.1, -0.25]}, "slip (0.1, -0.25) m/s"),
        ({"force_N": 3.0}, None, "force 3 N"),
        ({"force_N": 3.0}, {"gap_m": 0.001}, "force was 3 N, gap 0.001 m"),
        ({"angle_rad": 1.5, "torque_N_m": 0.1}, {"angle_rad": 1.5},
         "angle 1.5 → 1.5 rad, torque was 0.1 N m"),
        ({"spin_rad_s2": 2.0}, {"spin_rad_s2": 4.0}, "spin 2 → 4 rad/s²"),
        ({"count": 3}, {"count": 4}, "count 3 → 4"),
        ({"state": "open", "gap_rate_m_s": -1.0}, {"state": "open", "gap_rate_m_s": 0.5},
         "gap rate -1 → 0.5 m/s"),
        (None, None, ""),
        ("open", "touching", "open → touching"),
    ],
)  # fmt: skip
def test_before_and_after_are_told_with_units(before, after, words):
    given_sides = {"before": before, "after": after}
    sides = {key: value for key, value in given_sides.items() if value is not None}
    assert change(event(1.0, "bounces", **sides)) == words


def test_whose_event_it_is_is_told_once():
    patch = RunEvent(1.0, EventKind.LEAVES_PATCH, arm="left", contact="tip", body="object")
    assert patch.text == "left: tip leaves its patch (on the object)"
    assert patch.subject == "left: tip (on the object)"
    entry = patch.entry()
    assert (who(entry), what(entry)) == ("left: tip", "leaves its patch (on the object)")
    joint = RunEvent(1.0, EventKind.SATURATES, arm="left", joint="elbow")
    assert (joint.text, joint.subject) == ("left: elbow saturates", "left: elbow")
    assert (who(joint.entry()), what(joint.entry())) == ("left: elbow", "saturates")
    arm = RunEvent(1.0, EventKind.LOSES_DIRECTION, "little motion along z", "left")
    assert arm.text == arm.subject == "left: little motion along z"
    assert (who(arm.entry()), what(arm.entry())) == ("left", "little motion along z")
    rank = RunEvent(1.0, EventKind.RANK_FALLS, "rank falls from 9 to 8").entry()
    assert (who(rank), what(rank), rank["text"]) == ("", *["rank falls from 9 to 8"] * 2)
    earlier = {"time": 1.0, "kind": "slides", "arm": "left", "text": "left: slides a little"}
    assert what(earlier) == "slides"
    assert what({"time": 1.0, "kind": "rank falls", "text": "rank falls to 8"}) == "rank falls to 8"


def test_a_contact_that_bounces_often_is_told_once():
    both = sorted(bounces(40) + bounces(30, "corner_2", 1.01), key=lambda e: e["time"])
    ends = [event(2.1, "comes to rest"), event(2.2, "slides")]
    groups = grouped([event(0.5, "touches"), *both, *ends])
    assert [group.what() for group in groups] == [
        "touches", "bounces, 40 times", "bounces, 30 times", "comes to rest", "slides",
    ]  # fmt: skip
    assert groups[1].change() == (
        "first: gap rate -1 → 0.5 m/s, impulse 2 N s; "
        "last: gap rate -0.0164 → 0.00821 m/s, impulse 0.0328 N s"
    )


def test_two_kinds_in_turn_are_one_group_and_three_events_are_not():
    chatter = [event(0.1 * i, ("sticks", "slides")[i % 2]) for i in range(9)]
    (group,) = grouped(chatter)
    assert group.what() == "sticks and slides in turn, 9 events"
    assert [g.what() for g in grouped(chatter[:3])] == ["sticks", "slides", "sticks"]


@given(
    st.lists(
        st.tuples(st.sampled_from(("bounces", "slides", "sticks", "rank falls")),
                  st.sampled_from((None, "a", "b"))),
        max_size=40,
    )
)  # fmt: skip
def test_groups_hold_every_event_once_in_its_order(drawn):
    events = [
        event(float(i), kind, contact=contact)
        if contact
        else {"time": float(i), "kind": kind, "text": kind}
        for i, (kind, contact) in enumerate(drawn)
    ]
    groups = grouped(events)
    times = [e["time"] for group in groups for e in group.events]
    assert sorted(times) == [float(i) for i in range(len(events))]
    firsts = [group.first["time"] for group in groups]
    assert firsts == sorted(firsts)
    for group in groups:
        assert len({who(e) for e in group.events}) == 1
        assert len({e["kind"] for e in group.events}) <= 2
        assert [e["time"] for e in group.events] == sorted(e["time"] for e in group.events)


def test_kinds_are_counted_and_remarks_on_the_start_are_none_of_them():
    start = {"time": 0.0, "kind": "start", "text": "start: assembled"}
    events = [start, *bounces(5), event(1.5, "slides"), {"foreign": 1}]
    assert [(c.kind, c.count, c.first["time"]) for c in counts(events)] == [
        ("bounces", 5, 1.0), ("slides", 1, 1.5),
    ]  # fmt: skip
    assert len(timed(events)) == 6


# Figures


def test_every_time_plot_marks_the_events():
    run = eventful([event(1.25, "touches"), event(2.5, "lets go"), event(2.6, "slides")])
    drawn = plots.figures(run)
    assert "Contact states" in drawn
    for title, figure in drawn.items():
        for axes in figure.axes:
            found = marks(axes)
            assert list(found) == ["contact made", "contact lost", "slip"], title
            assert found["contact lost"].tolist() == [2.5]
        (legend,) = figure.legends
        words = [text.get_text() for text in legend.get_texts()]
        assert words == ["touches: 1 event", "lets go: 1 event", "slides: 1 event"]


def test_lines_of_many_events_are_bounded_and_cover_all_of_them():
    events = [event(6.0 * i / 4999, "bounces") for i in range(5000)]
    figure = plots.object_pose(eventful(events))
    (times,) = marks(figure.axes[0]).values()
    assert 100 < len(times) <= DISTINCT + 1
    assert np.diff(times).max() < 2.1 * 6.0 / DISTINCT
    assert figure.legends[0].get_texts()[0].get_text() == "bounces: 5,000 events"


def test_events_leave_the_axes_as_they_are():
    plain = plots.object_pose(eventful()).axes[0]
    marked = plots.object_pose(eventful([event(1.0, "touches"), event(99.0, "slides")])).axes[0]
    assert marked.get_xlim() == plain.get_xlim()
    assert marked.get_ylim() == plain.get_ylim()
    assert len(marked.lines) == len(plain.lines)
    assert list(marks(marked)) == ["contact made"]
    assert plots.object_pose(eventful()).legends == []


def test_states_are_drawn_as_spans_of_time():
    time, codes = np.arange(6.0), np.array([1, 1, 3, 3, 3, 0])
    begins, ends, states = spans(time, codes.astype(float))
    assert (begins.tolist(), ends.tolist()) == ([0, 2, 5], [2, 5, 5])
    assert states.tolist() == [1, 3, 0]


def test_strip_has_a_row_for_each_contact_that_has_states():
    axes = plots.contact_states(eventful()).axes[0]
    names = [text.get_text() for text in axes.texts]
    assert names == ["right: x", "right: y", "right: z", "floor: corner_1", "floor: corner_2"]
    drawn = set()
    for collection in axes.collections:
        for path in collection.get_paths():
            (left, low), (right, high) = path.vertices.min(axis=0), path.vertices.max(axis=0)
            drawn.add((int((low + high) / 2), round(left, 9), round(right, 9)))
    assert drawn == {
        (0, 0, 2), (0, 2, 6), (1, 0, 2), (1, 2, 6), (2, 0, 2), (2, 2, 6),
        (3, 0, 3), (3, 3, 6), (4, 0, 3), (4, 3, 6),
    }  # fmt: skip
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == [state.word for state in RECORDED_STATES]
    assert plots.contact_states(record(MemorySink())) is None


def test_strip_of_very_many_contacts_says_how_many_are_left_out():
    corners = [f"corner_{i}" for i in range(MOST_ROWS + 9)]
    states = {"floor": corners}
    channels = trajectory_channels(JOINTS, CONTACTS, states=states, environment={"floor": corners})
    sink, block = MemorySink(), samples(step=0.1)
    for name in ("contact_state", "contact_force"):
        block[f"environment/{name}"] = np.full(
            (len(block["time"]), len(corners)), ContactState.STICKING
        )
    block["environment/wrench"] = np.zeros((len(block["time"]), 6))
    sink.open(channels, {"scene": SCENE})
    sink.append(rows_of(channels, block))
    axes = plots.contact_states(sink.finish("completed", "", {})).axes[0]
    assert len(axes.texts) == MOST_ROWS
    assert "9 more contacts not shown" in axes.get_xlabel()


@pytest.mark.slow
def test_a_state_of_one_sample_in_a_long_run_is_seen():
    run = eventful(step=6.0 / 40_000)
    codes = run.contact_states["floor"].copy()
    codes[17_001, 0] = ContactState.OPEN
    sink = MemorySink()
    sink.open(FULL, {"scene": SCENE})
    block = {name: run.read(name) for name in run.channels}
    sink.append(rows_of(FULL, {**block, "environment/contact_state": codes}))
    axes = plots.contact_states(sink.finish("completed", "", {})).axes[0]
    bars = [path for c in axes.collections for path in c.get_paths()]
    assert any(
        int(path.vertices[:, 1].mean()) == 3
        and np.ptp(path.vertices[:, 0]) < 0.1
        and abs(path.vertices[:, 0].mean() - run.time[17_001]) < 0.1
        for path in bars
    )


def test_forces_of_the_floor_have_a_panel_of_their_own():
    axes = plots.contact_forces(eventful()).axes
    assert [a.get_title(loc="left") for a in axes] == ["left", "right", "floor"]
    assert [t.get_text() for t in axes[2].texts] == ["1", "2"]  # what all names share is left out
    assert axes[2].lines[-1].get_ydata()[0] == -5.0


def test_wrenches_have_panels_of_force_and_moment_for_arms_and_floor():
    run = eventful()
    axes = plots.wrenches(run).axes
    panels = [(a.get_title(loc="left"), a.get_ylabel()) for a in axes]
    quantities = ("force [N]", "moment [N m]")
    assert panels == [(who, what) for who in ("left", "right", "floor") for what in quantities]
    drawn = np.column_stack(
        [line.get_ydata() for line in axes[0].lines if len(line.get_xdata()) > 2]
    )
    np.testing.assert_allclose(drawn[0], run.wrenches["left"][0, :3])
    np.testing.assert_allclose(drawn[-1], run.wrenches["left"][-1, :3])


def test_work_of_each_effect_is_drawn_and_named():
    axes = plots.energy(eventful()).axes
    assert len(axes) == 3
    assert [text.get_text() for text in axes[2].texts] == list(EFFECTS)
    run = eventful()
    lines = {tuple(np.round(line.get_ydata()[-1:], 9)) for line in axes[2].lines[1:]}
    assert lines == {(-12.0,), (-3.6,)}
    assert run.time[-1] == 6.0


def test_the_power_of_the_control_on_each_arm_is_drawn_and_named():
    run = record(MemorySink())
    axes = plots.energy(run).axes
    assert len(axes) == 3 and axes[2].get_ylabel() == "power [W]"
    assert [text.get_text() for text in axes[2].texts] == ["left", "right"]
    lines = [line.get_ydata() for line in axes[2].lines if len(line.get_xdata()) > 2]
    ends = {float(np.round(line[-1], 9)) for line in lines}
    assert ends == {float(np.round(power[-1], 9)) for power in run.control_power.values()}
    assert len(plots.energy(earlier_run(run)).axes) == 2


# Report


def table(page):
    """Cells of the events' table, row by row."""
    section = page[page.index("<h2>Events</h2>") :].partition("</section>")[0]
    rows = re.findall(r"<tr>(.*?)</tr>", section.partition("<tbody>")[2])
    return [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in rows]


@pytest.mark.usefixtures("without_figures")
def test_report_tells_when_what_where_and_how():
    hit = event(
        1.25, "touches", where=[0.4, 0.0, -0.125], before={"gap_rate_m_s": -0.31},
        after={"gap_rate_m_s": 0.0, "impulse_N_s": 1.2},
    )  # fmt: skip
    page = render(eventful([hit, {"time": 2.0, "kind": "rank falls", "text": "rank falls to 8"}]))
    assert table(page) == [
        ["1.25 s", "touches", "floor: corner_1 at (0.4, 0, -0.125) m",
         "gap rate -0.31 → 0 m/s, impulse 1.2 N s"],
        ["2 s", "rank falls to 8", "", ""],
    ]  # fmt: skip
    Page(page)  # every tag is closed


@pytest.mark.usefixtures("without_figures")
def test_report_groups_bounces_and_counts_kinds():
    page = render(eventful([*bounces(500), event(2.5, "comes to rest")]))
    rows = table(page)
    assert [row[1] for row in rows] == ["bounces, 500 times", "comes to rest"]
    assert rows[0][0] == "1 to 2 s"
    assert "bounces: 500, comes to rest: 1" in Page(page).text


@pytest.mark.usefixtures("without_figures")
def test_report_shows_the_first_events_and_counts_the_rest():
    events = [event(0.001 * i, "slides", contact=f"c{i}") for i in range(SHOWN_EVENTS + 57)]
    page = render(eventful(events))
    assert len(table(page)) == SHOWN_EVENTS
    assert "and 57 more, in the trajectory's events" in Page(page).text


@pytest.mark.usefixtures("without_figures")
def test_report_shows_events_of_another_program_as_they_are():
    page = render(eventful([event(1.0, "touches"), {"what": "<b>odd</b>", "n": 3}]))
    assert "what: &lt;b&gt;odd&lt;/b&gt;, n: 3" in page
    assert len(table(page)) == 1


@pytest.mark.usefixtures("without_figures")
def test_report_without_events_has_no_section():
    assert "<h2>Events</h2>" not in render(eventful())


def test_report_names_the_work_of_each_effect(monkeypatch):
    monkeypatch.setattr("multiarm.plots.figures", lambda run: {"Energy": plots.energy(run)})
    run = eventful()
    text = Page(render(run)).text
    control = run.work[-1] + 12.0 + 3.6
    assert "joint_damping -12 J" in text
    assert "drag -3.6 J" in text
    assert f"control {control:.3g}" in text
    assert "Work done by" not in Page(render(record(MemorySink()))).text


@pytest.mark.slow
def test_hostile_names_of_events_and_contacts_are_text():
    attack = "<script>alert(1)</script>".replace("/", "")
    hostile = [attack, "$\\bad$"]
    events = [event(1.0, attack, attack, attack, before={attack: attack})]
    channels = trajectory_channels(
        JOINTS,
        CONTACTS,
        works=EFFECTS,
        states={**STATES, "floor": hostile},
        environment={"floor": hostile},
    )
    page = Page(render(eventful(events, channels)))
    assert "script" not in page.tags
    assert page.text.count("alert(1)") >= 6  # of the event, and of the contact


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1])
def test_runs_of_few_samples_with_events_are_drawn(count):
    run = eventful()
    sink = MemorySink()
    sink.open(FULL, {"scene": SCENE})
    sink.append(rows_of(FULL, {name: run.read(name, 0, count) for name in run.channels}))
    cut = sink.finish("failed", "it stopped", {}, [event(0.0, "touches")])
    assert "it stopped" in Page(render(cut)).text


@pytest.mark.usefixtures("without_figures")
def test_report_says_whose_the_largest_forces_are_and_when():
    run = eventful()
    force = np.linalg.norm(run.wrenches["left"][:, :3], axis=1)
    when = number(run.time[force.argmax()], "s")
    told = f"largest force {force.max():.3g} n arm left at {when}; 135 n at a contact"
    assert told in Page(render(run)).text.lower()
    block = samples(step=0.5)
    block["environment/contact_force"] = np.full((len(block["time"]), 2), 1e3)
    block["environment/wrench"] = np.outer(block["time"], [0.0, 0.0, 400.0, 0.0, 0.0, 0.0])
    sink, channels = (
        MemorySink(),
        trajectory_channels(JOINTS, CONTACTS, environment={"floor": CORNERS}),
    )
    sink.open(channels, {"scene": SCENE})
    sink.append(rows_of(channels, block))
    text = Page(render(sink.finish("completed", "", {}))).text.lower()
    assert "largest force 2400 n floor at 6 s; 1000 n at a contact" in text


# Terminal


def printed(run):
    figures = run_figures("swing", run, {}, False)
    console = Console(width=200, file=io.StringIO())
    console.print(summary_table(figures, 0.0))
    assert json.loads(json.dumps(figures))["events"] == run.events
    return [line.strip() for line in console.file.getvalue().splitlines()]


def test_terminal_counts_events_by_kind_with_their_first_times():
    lines = printed(eventful([*bounces(500), event(2.5, "comes to rest")]))
    (first,) = [i for i, line in enumerate(lines) if line.startswith("events")]
    assert lines[first].endswith("bounces, 500 times, first at 1 s (floor: corner_1)")
    assert lines[first + 1] == "comes to rest at 2.5 s (floor: corner_1)"
    assert len(lines) < 30


def test_terminal_names_a_bounded_number_of_kinds():
    lines = printed(eventful([event(0.1 * i, f"kind {i}") for i in range(SHOWN_KINDS + 3)]))
    assert "and 3 more kinds" in lines
    assert sum("kind " in line for line in lines) == SHOWN_KINDS


def test_terminal_says_nothing_where_nothing_happened():
    start = {"time": 0.0, "kind": "start", "text": "start: assembled"}
    assert not [line for line in printed(eventful([start])) if line.startswith("events")]
