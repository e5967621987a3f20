"""Claims about the file of a sweep: nothing is lost, nothing is made up, whoever is killed."""

from __future__ import annotations

import csv
import json
import random
import resource
import subprocess
import sys
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sweep_stand_in import FAILING, NAMES, StandInPlan, row_of

from multiarm.errors import MultiarmError, SweepError, TrajectoryError
from multiarm.results.trajectory_file import TrajectoryReader
from multiarm.sweeps import row_file
from multiarm.sweeps.result import Sweep, load_sweep
from multiarm.sweeps.store import RunSet, SweepFile
from multiarm.sweeps.summary import quantiles
from multiarm.sweeps.table import BLOCK

PROGRAM = Path(__file__).parent / "sweep_stand_in.py"
MEASURED = ("wall_time", "worker")


def written(path: Path, count: int, runs=None, rows=row_of) -> Path:
    """The file of a sweep with some of its runs, in an order of their own."""
    runs = list(range(1, count + 1) if runs is None else runs)
    random.Random(count).shuffle(runs)
    with SweepFile.open(path, StandInPlan(count)) as file:
        for start in range(0, len(runs), 50):
            file.append([rows(run) for run in runs[start : start + 50]])
    return path


def started(path: Path, count: int, order: int) -> subprocess.Popen:
    """A process that goes on with the file, and says what is safe."""
    command = [sys.executable, str(PROGRAM), str(path), str(count), str(order)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def killed(process: subprocess.Popen, lines: int, pause: float) -> int:
    """Kill it some time after it has said so many lines; returns the runs it said to be safe."""
    assert process.stdout is not None
    said = [process.stdout.readline() for _ in range(lines)]
    time.sleep(pause)
    process.kill()
    said += process.stdout.read().splitlines(keepends=True)
    process.communicate()
    return max(
        (int(line) for line in said if line.strip().isdigit() and line[-1] == "\n"), default=0
    )


def same_but_measured(row, expected) -> bool:
    return replace(row, wall_time=0.0, worker="") == replace(expected, wall_time=0.0, worker="")


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """A whole sweep of more rows than are read at once."""
    found = load_sweep(written(tmp_path_factory.mktemp("sweep") / "s.h5", 2 * BLOCK + 100))
    yield found
    found.close()


# What is put in comes out


def test_rows_come_out_as_they_were_put_in_and_in_the_order_of_the_runs(sweep):
    rows = list(sweep.rows())
    assert [row.run for row in rows] == list(range(1, sweep.count + 1))
    assert rows == [row_of(run) for run in range(1, sweep.count + 1)]
    types = {type(row.values["effects.joint_damping"]) for row in rows}
    assert types == {int, float, type(None), bool}, "5 and 5.0 are not one value"


def test_a_run_that_failed_is_a_row_with_a_reason_and_without_numbers(sweep):
    row = sweep.row(FAILING)
    assert (row.status, row.message) == ("failed", f"the step of run {FAILING} is too small")
    assert set(row.quantities.values()) == {None}
    assert np.isnan(sweep.table["gap"][FAILING - 1])
    failed = sweep.count // FAILING
    assert sweep.status_counts == {"completed": sweep.count - failed, "failed": failed}


def test_a_column_whose_name_is_taken_is_told_apart(sweep):
    assert sweep.table["run"][2] == 3
    assert sweep.table["$.run"][2] == row_of(3).values["run"]


def test_the_file_can_be_read_without_this_program(sweep):
    with h5py.File(sweep.path) as file:
        rows = file["rows"][:]
        assert file["progress"][0] == len(rows) == sweep.count
        first = rows[rows["run"] == 3][0]
        assert first["values"]["object.mass"] == row_of(3).values["object.mass"]
        assert first["quantities"]["gap"] == row_of(3).quantities["gap"]
        header = json.loads(file["header"].asstr()[()])
        assert [own["unit"] for own in header["quantities"]] == ["m", "N", "J"]
        nan = np.isnan(rows["quantities"]["gap"])
        assert set(rows["status"][nan]) == {b"failed"}


def test_selecting_gives_the_columns_of_the_runs_that_fit(sweep):
    found = sweep.select(["run", "gap"], status="completed", where={"object.mass": (10.0, 20.0)})
    expected = [
        row
        for row in map(row_of, range(1, sweep.count + 1))
        if row.status == "completed" and 10.0 <= row.values["object.mass"] <= 20.0
    ]
    assert list(found) == ["run", "gap"]
    assert found["run"].tolist() == [row.run for row in expected]
    assert found["gap"].tolist() == [row.quantities["gap"] for row in expected]
    with pytest.raises(SweepError, match=r"unknown column 'gab'; did you mean 'gap'\?"):
        sweep.select(["gab"])


def test_a_sweep_that_is_not_complete_says_which_runs_it_has(tmp_path):
    found = load_sweep(written(tmp_path / "s.h5", 40, runs=[7, 3, 40]))
    assert (found.runs.tolist(), found.complete) == ([3, 7, 40], False)
    assert repr(found) == "Sweep(3 of 40 runs: 3 completed)"
    assert found.row(7) == row_of(7)
    with pytest.raises(SweepError, match="run 8 has not been made yet; resume"):
        found.row(8)
    with pytest.raises(SweepError, match="there is no run 41; runs are 1 to 40"):
        found.row(41)
    found.close()


def test_the_set_of_done_runs_is_a_set():
    runs, members = RunSet(1000), random.Random(3).sample(range(1, 1001), 300)
    for run in [*members, *members]:
        runs.add(run)
    assert len(runs) == 300
    assert [run for run in range(-5, 1010) if run in runs] == sorted(members)
    assert list(runs.missing()) == sorted(set(range(1, 1001)) - set(members))


# Killed, and resumed


def test_a_sweep_killed_twenty_times_ends_with_the_same_table(tmp_path):
    path, count, rng = tmp_path / "s.h5", 4000, random.Random(11)
    safe = 0  # far from all after twenty pieces of at most some 60 blocks, see PAUSE
    for order in range(20):
        # before the first row, while rows are put into the new file, or among new rows
        lines = rng.choice([1, 2, rng.randint(2, 30)])
        said = killed(started(path, count, order), lines, rng.uniform(0.0, 0.03))
        assert said == 0 or said >= safe, "what was safe is there after resuming"
        if path.exists():
            found = load_sweep(path)
            assert len(found) >= said, "what it said to be safe is safe"
            assert all(same_but_measured(row, row_of(row.run)) for row in found.rows())
            assert len(found) >= safe
            safe = len(found)
            found.close()
    assert 0 < safe < count
    process = started(path, count, 99)
    assert process.communicate()[0].endswith("end\n")
    found, whole = load_sweep(path), load_sweep(written(tmp_path / "whole.h5", count))
    for name, column in whole.table.items():
        if name not in MEASURED:
            np.testing.assert_array_equal(found.table[name], column, err_msg=name)
    assert len(set(found.table["worker"])) > 5, "rows of processes that were killed are kept"
    assert found.summary() == replace(whole.summary(), wall_time=found.summary().wall_time)
    found.close()
    whole.close()
    assert {p.name for p in tmp_path.iterdir()} == {"s.h5", "whole.h5"}


def test_a_file_that_is_being_written_shows_what_is_safe(tmp_path):
    with SweepFile.open(tmp_path / "s.h5", StandInPlan(100)) as file:
        for end in (10, 60, 100):
            file.append([row_of(run) for run in range(len(file.done) + 1, end + 1)])
            found = load_sweep(tmp_path / "s.h5")
            assert list(found.rows()) == [row_of(run) for run in range(1, end + 1)]
            found.close()


def test_a_file_cut_anywhere_has_whole_rows_or_is_refused(tmp_path):
    path = tmp_path / "s.h5"
    process = started(path, 400, 1)
    killed(process, 40, 0.0)
    data = path.read_bytes()
    assert len(load_sweep(path)) > 50
    read = 0
    for size in random.Random(5).sample(range(len(data)), 24):
        path.write_bytes(data[:size])
        try:
            found = load_sweep(path)
        except SweepError as error:
            assert any(word in str(error) for word in ("cut short", "not an HDF5 file"))
            continue
        read += 1
        assert all(same_but_measured(row, row_of(row.run)) for row in found.rows())
        found.close()
    assert read < 24


def test_a_row_that_comes_twice_is_there_once_and_rows_cut_short_by_the_user_are_done_again(
    tmp_path,
):
    path, plan = tmp_path / "s.h5", StandInPlan(9)
    with SweepFile.open(path, plan) as file:
        file.append([row_of(1), row_of(1), row_of(2)])
        file.append([replace(row_of(2), worker="another")])
        file.append([replace(row_of(4), status="interrupted", quantities={})])
        assert len(file.done) == 3
    with SweepFile.open(path, plan) as file:
        assert list(file.done.missing()) == [3, 4, 5, 6, 7, 8, 9]
        file.append([row_of(4)])
        with pytest.raises(SweepError, match="there is no run 10; runs are 1 to 9"):
            file.append([row_of(3), row_of(10)])
    found = load_sweep(path)
    assert list(found.rows()) == [row_of(1), row_of(2), row_of(4)]
    found.close()


def test_resuming_again_and_again_does_not_let_the_file_grow(tmp_path):
    path, sizes = written(tmp_path / "s.h5", 200), []
    for _ in range(3):
        with SweepFile.open(path, StandInPlan(200)) as file:
            assert len(file.done) == 200
        sizes.append(path.stat().st_size)
    assert len(set(sizes)) == 1


def test_rows_are_on_the_disk_before_they_count(tmp_path, monkeypatch):
    path, counted = tmp_path / "s.h5", []

    def synced(descriptor: int) -> None:
        found = load_sweep(path)
        counted.append(len(found))
        found.close()

    monkeypatch.setattr(row_file.os, "fsync", synced)
    monkeypatch.setattr(row_file, "SYNC", 0.0)
    with SweepFile.open(path, StandInPlan(9)) as file:
        for run in range(1, 10):
            file.append([row_of(run)])
    assert counted == list(range(9))


# Refused


def test_a_second_writer_is_refused_in_words_until_the_first_is_gone(tmp_path):
    path = tmp_path / "s.h5"
    process = started(path, 100_000, 1)
    for _ in range(4):
        process.stdout.readline()
    try:
        with pytest.raises(SweepError) as caught:
            SweepFile.open(path, StandInPlan(100_000))
        with pytest.raises(SweepError):
            SweepFile.open(path, StandInPlan(100_000), fresh=True)
    finally:
        process.kill()
        process.communicate()
    assert f"is being written by another process ({process.pid} on " in str(caught.value)
    with SweepFile.open(path, StandInPlan(100_000)) as file, pytest.raises(SweepError):
        SweepFile.open(path, StandInPlan(100_000))
    assert len(file.done) > 0


def test_the_file_of_another_sweep_is_refused_with_what_differs(tmp_path):
    path, plan = written(tmp_path / "s.h5", 20), StandInPlan(20)
    before = path.read_bytes()
    other = replace(plan, fingerprint="other", text=plan.text.replace("50", "60"))
    with pytest.raises(SweepError) as caught:
        SweepFile.open(path, other)
    lines = str(caught.value).splitlines()
    assert lines[0].startswith(f"'{path}' holds another sweep; choose another file")
    assert lines[1:] == [f"  sweep: -{plan.text.strip()}", f"  sweep: +{other.text.strip()}"]
    light = replace(plan, fingerprint="other", scene_text="gravity: [0, 0, -1.5]\n")
    with pytest.raises(SweepError, match=r"scene: \+gravity: \[0, 0, -1.5\]"):
        SweepFile.open(path, light)
    with pytest.raises(SweepError, match="the text of a function that gives a quantity"):
        SweepFile.open(path, replace(plan, fingerprint="other"))
    assert path.read_bytes() == before
    with SweepFile.open(path, other, fresh=True) as file:
        assert len(file.done) == 0


def test_what_is_no_sweep_is_neither_read_nor_replaced(tmp_path):
    text, foreign, folder = tmp_path / "t.h5", tmp_path / "f.h5", tmp_path / "none" / "s.h5"
    text.write_text("no HDF5")
    with h5py.File(foreign, "w") as file:
        file.attrs["format"] = "multiarm trajectory"
    for path, words in [
        (text, "is not an HDF5 file; a sweep is written by multiarm sweep"),
        (foreign, "is an HDF5 file, but not a sweep of multiarm"),
        (tmp_path, "it is a folder"),
        (folder, "there is no such file"),
    ]:
        with pytest.raises(SweepError, match=words):
            load_sweep(path)
        with pytest.raises(SweepError, match=r"not a sweep that may be replaced|folder"):
            SweepFile.open(path, StandInPlan(3), fresh=True)
    sweep = written(tmp_path / "s.h5", 3)
    with pytest.raises(TrajectoryError, match="it is something else, damaged or write"):
        TrajectoryReader.writable_target(sweep)
    with h5py.File(sweep, "r+") as file:
        file.attrs["format_version"] = 2
    with pytest.raises(SweepError, match="has format version 2; this program reads up to 1"):
        load_sweep(sweep)


def test_a_full_disk_ends_the_writing_in_words_and_keeps_the_rows(tmp_path):
    path = tmp_path / "s.h5"
    plan = StandInPlan(100_000)
    file = SweepFile.open(path, plan)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 500_000, before[1]))
    try:
        with pytest.raises(SweepError, match=r"cannot write to .*free some space on the disk"):
            for start in range(1, plan.count, 100):
                file.append([row_of(run) for run in range(start, start + 100)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    safe = len(file.done)
    file.close()
    with SweepFile.open(path, plan) as file:
        assert len(file.done) == safe > 100
    found = load_sweep(path)
    assert list(found.rows()) == [row_of(run) for run in range(1, safe + 1)]
    found.close()


# As a whole


def test_the_summary_is_what_numpy_says_of_the_table(sweep):
    found = sweep.summary()
    gap, runs = sweep.table["gap"], sweep.table["run"]
    there = ~np.isnan(gap)
    own = next(spread for spread in found.spreads if spread.name == "gap")
    assert (own.count, own.smallest, own.largest) == (there.sum(), np.nanmin(gap), np.nanmax(gap))
    assert own.smallest_run == runs[np.nanargmin(gap)]
    assert own.largest_run == runs[np.nanargmax(gap)]
    assert own.mean == pytest.approx(np.nanmean(gap), rel=1e-12)
    for level, value in own.quantiles.items():
        assert value == pytest.approx(np.quantile(gap[there], level), rel=1e-14)
    never = next(spread for spread in found.spreads if spread.name == "never")
    assert (never.count, never.mean, never.largest_run) == (0, None, None)
    assert [(f.runs, f.first_run) for f in found.failures] == [(sweep.count // FAILING, FAILING)]
    json.dumps(found.figures(), allow_nan=False)


def test_the_summary_does_not_depend_on_the_order_in_which_runs_ended(tmp_path):
    count, summaries = 300, []
    for seed in range(3):
        path, runs = tmp_path / f"{seed}.h5", list(range(1, count + 1))
        random.Random(seed).shuffle(runs)
        with SweepFile.open(path, StandInPlan(count)) as file:
            file.append(map(row_of, runs))
        found = load_sweep(path)
        summaries.append(found.summary())
        found.close()
    assert summaries[0] == summaries[1] == summaries[2]


@given(st.lists(st.floats(-1e6, 1e6), min_size=1), st.lists(st.floats(0.0, 1.0), min_size=1))
def test_quantiles_are_numpys(numbers, levels):
    found = quantiles(np.array(numbers), levels)
    scale = max(map(abs, numbers))
    np.testing.assert_allclose(found, np.quantile(numbers, levels), atol=1e-14 * scale + 1e-300)


def test_csv_and_parquet_hold_the_table(sweep, tmp_path):
    with sweep.to_csv(tmp_path / "s.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    table = pyarrow.parquet.read_table(sweep.to_parquet(tmp_path / "s.parquet"))
    assert list(rows[0]) == table.column_names == [column.name for column in sweep.columns]
    assert len(rows) == table.num_rows == sweep.count
    columns = table.to_pydict()
    for k, row in enumerate(sweep.rows()):
        assert int(rows[k]["run"]) == columns["run"][k] == row.run
        assert rows[k]["name"] == columns["name"][k] == row.values["name"]
        for name in NAMES:
            cell = rows[k][name]
            assert (float(cell) if cell else None) == columns[name][k] == row.quantities[name]
        damping = columns["effects.joint_damping"][k]
        assert (json.loads(damping) if damping else None) == row.values["effects.joint_damping"]
        assert json.loads(columns["$.run"][k]) == json.loads(rows[k]["$.run"]) == row.values["run"]
    assert table.schema.field("force").metadata[b"unit"] == b"N"
    assert table.schema.metadata[b"sweep"].decode() == sweep.text
    assert {p.name for p in tmp_path.iterdir()} == {"s.csv", "s.parquet"}
    for write in (sweep.to_csv, sweep.to_parquet):
        with pytest.raises(MultiarmError, match=r"(CSV|Parquet): cannot write .*No such file"):
            write(tmp_path / "none" / "s.csv")


def test_parquet_without_pyarrow_says_what_to_do(sweep, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(SweepError, match="pip install pyarrow; or write CSV"):
        sweep.to_parquet(tmp_path / "s.parquet")


def test_ten_thousand_runs_are_written_and_reported_in_the_memory_of_two_thousand(tmp_path):
    some = [row_of(run) for run in range(1, 101)]  # made beforehand: they are not what is meant

    def peak(count: int) -> int:
        path = tmp_path / f"{count}.h5"
        tracemalloc.start()
        with SweepFile.open(path, StandInPlan(count)) as file:
            for start in range(0, count, 100):
                file.append(replace(row, run=start + row.run) for row in some)
        with SweepFile.open(path, StandInPlan(count)) as file:
            assert len(file.done) == count
        found = Sweep(path)
        found.summary()
        found.to_csv(path.with_suffix(".csv"))
        found.close()
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    peak(200)
    few, many = peak(2100), peak(10_000)  # two whole blocks, nine
    index = 3 * 8 * 10_000  # [B] runs, places, and a copy while they are sorted
    assert many < few + 2 * index + 200_000
