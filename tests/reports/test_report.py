"""Figures and reports: every peak is drawn, every name is escaped, nothing is loaded."""

import re
import tracemalloc

import numpy as np
import pytest
from page_reader import Page
from refusals import refused
from repository import ROOT
from sample_run import CHANNELS, SCENE, earlier_run, record, rows_of, samples

from multiarm import plots
from multiarm.errors import TrajectoryError
from multiarm.notation import number
from multiarm.plots.decimation import RotationSinceStart, decimate
from multiarm.reports.report import render, report
from multiarm.results.channels import Channel, trajectory_channels
from multiarm.results.sinks import Hdf5Sink, MemorySink, provenance


def scalar_run(values, sink=None):
    """A run of one scalar channel, a sample per second."""
    sink = sink or MemorySink()
    sink.open([Channel("time", unit="s"), Channel("signal")], {"scene": ""})
    for start in range(0, len(values), 4096):
        part = values[start : start + 4096]
        sink.append(np.column_stack([start + np.arange(len(part)), part]))
    return sink.finish("completed", "", {})


def spinning_run(angle, axis):
    """A run in which the object turns about a fixed axis."""
    sink, time = MemorySink(), np.arange(len(angle), dtype=float)
    sink.open([Channel("time"), Channel("object/quaternion_xyzw", (4,))], {})
    start = np.array([0.5, -0.5, 0.5, 0.5])
    turn = np.column_stack([np.outer(np.sin(angle / 2), axis), np.cos(angle / 2)])
    sink.append(np.column_stack([time, _product(turn, start)]))
    return sink.finish("completed", "", {})


def _product(p, q):
    vector = p[:, 3:] * q[:3] + q[3] * p[:, :3] + np.cross(p[:, :3], q[:3])
    return np.column_stack([vector, p[:, 3] * q[3] - p[:, :3] @ q[:3]])


# Long runs in few points


def test_a_short_run_is_drawn_as_it_is():
    values = np.sin(np.arange(50.0))
    time, drawn = decimate(scalar_run(values), ["signal"])
    assert np.array_equal(time, np.arange(50.0))
    assert np.array_equal(drawn, values[:, None])


@pytest.mark.parametrize("where", [1, 54321, 99_998])
@pytest.mark.parametrize("size", [1.0, -1.0])
def test_a_peak_of_one_sample_survives_decimation(where, size):
    values = np.zeros(100_000)
    values[where] = size
    time, drawn = decimate(scalar_run(values), ["signal"], points=500)
    assert len(time) <= 502
    assert np.all(np.diff(time) >= 0)
    (hit,) = np.flatnonzero(drawn[:, 0] == size)
    assert abs(time[hit] - where) < 2 * 100_000 / 500


@pytest.mark.parametrize("count", [1601, 5000, 8193, 33_333])
def test_decimation_bounds_the_signal_and_keeps_its_ends(count):
    values = np.cumsum(np.random.default_rng(count).normal(size=count))
    time, drawn = decimate(scalar_run(values), ["signal"])
    assert (drawn.min(), drawn.max()) == (values.min(), values.max())
    assert (drawn[0, 0], drawn[-1, 0]) == (values[0], values[-1])
    assert (time[0], time[-1]) == (0.0, count - 1.0)


def test_decimating_a_long_file_needs_little_memory(tmp_path):
    count = 400_000
    run = scalar_run(np.random.default_rng(0).normal(size=count), Hdf5Sink(tmp_path / "run.h5"))
    decimate(run, ["signal"])
    tracemalloc.start()
    decimate(run, ["signal"])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.3 * 8 * count


def test_rotation_since_the_start_counts_whole_turns():
    axis, angle = np.array([2.0, -1.0, 2.0]) / 3, np.linspace(0, 5.5 * np.pi, 2000)
    run = spinning_run(angle, axis)
    since_start = RotationSinceStart(run.object_quaternion_xyzw[:1])
    rotation = decimate(run, ["object/quaternion_xyzw"], since_start, points=10_000)[1]
    assert np.allclose(rotation, np.outer(angle, axis), atol=1e-12)


def test_rotation_there_and_back_ends_where_it_began():
    angle = 3.5 * np.pi * np.sin(np.linspace(0, np.pi, 1000)) ** 2
    run = spinning_run(angle, np.array([0.0, 0.6, 0.8]))
    quaternions = run.object_quaternion_xyzw
    rotation = RotationSinceStart(quaternions[:1])(quaternions)
    assert np.allclose(np.linalg.norm(rotation, axis=1), angle, atol=1e-12)


def test_rotation_does_not_depend_on_the_blocks():
    run = spinning_run(np.linspace(0, 20, 1000), np.array([0.0, 0.0, 1.0]))
    quaternions = run.object_quaternion_xyzw
    whole, pieces = (RotationSinceStart(quaternions[:1]) for _ in range(2))
    parts = [pieces(quaternions[i : i + 70]) for i in range(0, 1000, 70)]
    assert np.array_equal(np.concatenate(parts), whole(quaternions))


# Figures


@pytest.fixture(scope="module")
def run():
    return record(MemorySink(), metadata=provenance(SCENE))


def test_every_axis_says_its_quantity_and_unit(run):
    for figure in plots.figures(run).values():
        assert all(re.search(r"\[\S.*\]$", axes.get_ylabel()) for axes in figure.axes)
        assert figure.axes[-1].get_xlabel() == "time [s]"


def test_joint_positions_are_drawn_in_degrees_and_metres(run):
    left, rail, angles = plots.joint_positions(run).axes
    lines = [line.get_ydata() for line in left.lines]
    assert np.allclose(np.array(lines).T, np.degrees(run.joint_positions["left"]))
    assert np.array_equal(rail.lines[0].get_ydata(), run.joint_positions["right"][:, 0])
    assert len(angles.lines) == 2


def test_energy_balance_is_drawn_in_its_own_unit(run):
    balance = plots.energy(run).axes[1]
    assert balance.get_ylabel() == "balance [1e-09 J]"
    assert np.allclose(balance.lines[-1].get_ydata(), 1e9 * run.energy_balance, atol=1e-4)


def test_drift_of_zero_is_drawn_on_the_logarithmic_axis(run):
    axes = plots.drift(run).axes[0]
    drawn = axes.lines[0].get_ydata()
    assert run.position_drift[0] == 0
    assert axes.get_yscale() == "log"
    assert drawn[0] > axes.get_ylim()[0] > 0
    assert drawn.max() == run.position_drift.max()


def test_figures_leave_pyplot_alone():
    """It would open windows."""
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "multiarm").rglob("*.py")]
    assert sources and not [text for text in sources if "pyplot" in text]


# The page


@pytest.fixture(scope="module")
def page(run):
    return render(run)


@pytest.mark.slow
def test_the_report_loads_nothing(page):
    tags = set(Page(page).tags)
    assert tags.isdisjoint({"script", "link", "img", "iframe", "object", "embed", "base"})
    addresses = set(re.findall(r"https?://[^\s\"'<]+", page))
    assert all(address.startswith("http://www.w3.org/") for address in addresses)
    assert "@import" not in page


@pytest.mark.slow
def test_names_inside_the_page_are_unique_and_known(page):
    ids = Page(page).ids
    used = set(re.findall(r"url\(#([^)]+)\)", page)) | set(re.findall(r'href="#([^"]+)"', page))
    assert used
    assert used <= ids


def test_the_report_shows_the_scene_and_its_name_as_text(page):
    assert "<pendulum>" not in page
    text = Page(page).text
    assert text.count("two arms & a <pendulum>") >= 3  # title, heading, scene
    assert "gravity: [0, 0, -9.81]" in text


@pytest.mark.usefixtures("without_figures")
def test_a_run_of_an_earlier_version_has_a_report_that_says_what_is_missing():
    run = earlier_run(record(MemorySink()))
    assert "wrenches were not recorded" in Page(render(run)).text
    assert plots.wrenches(run) is None


@pytest.mark.slow
def test_hostile_names_are_shown_and_not_run():
    attack = "<script>alert(1)</script>"
    channels = [
        *(c for c in CHANNELS if not c.name.startswith("arms/")),
        *trajectory_channels({"$\\bad$": {attack.replace("/", ""): "rad"}}, {"$\\bad$": []})[4:12],
    ]
    sink, block = MemorySink(), samples()
    sink.open(channels, {"scene": f"name: {attack}", "note": attack})
    many = {c.name: block.get(c.name, np.ones((len(block["time"]), *c.shape))) for c in channels}
    sink.append(rows_of(channels, many))
    run = sink.finish("failed", attack, {attack: attack}, [{attack: attack}], {attack: attack})
    page = Page(render(run))
    assert "script" not in page.tags
    assert page.text.count("alert(1)") >= 8
    assert "$\\bad$" in page.text


@pytest.mark.usefixtures("without_figures")
@pytest.mark.parametrize("status", ["completed", "interrupted", "failed"])
def test_the_status_is_said_in_words_and_shown_in_colour(status):
    page = render(record(MemorySink(), status=status, message="what to do next"))
    assert ("class", status) in Page(page).attributes
    assert f"{status} what to do next" in Page(page).text


def test_the_report_gives_the_numbers_of_the_run(page, run):
    text = Page(page).text
    summary = run.summary()
    assert number(summary["position_drift_max_m"], "m") in text
    assert number(summary["energy_balance_max_J"], "J") in text
    assert "Steps 1,234 (17 rejected), 9,876 evaluations" in text
    assert "Method dop853" in text
    assert run.provenance["python"] in text


@pytest.mark.usefixtures("without_figures")
def test_a_scene_that_cannot_be_parsed_still_has_a_report():
    run = record(MemorySink(), metadata={"scene": "name: [unclosed"})
    assert "A run without a name" in Page(render(run)).text


@pytest.mark.usefixtures("without_figures")
def test_the_report_is_written_and_its_place_returned(run, tmp_path):
    path = report(run, tmp_path / "report.html")
    assert path == tmp_path / "report.html"
    assert path.read_text(encoding="utf-8") == render(run)


@pytest.mark.usefixtures("without_figures")
def test_a_place_that_cannot_be_written_is_named(run, tmp_path):
    with refused(TrajectoryError, "r.html"):
        report(run, tmp_path / "nowhere" / "r.html")
    with refused(TrajectoryError, str(tmp_path)):
        report(run, tmp_path)
