"""Claims about the file of a sweep: nothing is lost, nothing is made up, whoever is killed."""

from __future__ import annotations

import csv
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from repository import SUPPORT
from sweep_stand_in import FAILING, NAMES, STEPS, StandInPlan, row_of

from multiarm.errors import MultiarmError, SweepError, TrajectoryError
from multiarm.results.trajectory_file import TrajectoryReader
from multiarm.sweeps import store
from multiarm.sweeps.result import load_sweep
from multiarm.sweeps.store import SHARD_ROWS, SweepFile
from multiarm.sweeps.table import type_of

PROGRAM = SUPPORT / "sweep_stand_in.py"
MEASURED = ("wall_time", "worker")


def written(path: Path, count: int, runs=None, rows=row_of) -> Path:
    """The file of a sweep with some of its runs, in an order of their own."""
    runs = list(range(1, count + 1) if runs is None else runs)
    random.Random(count).shuffle(runs)
    with SweepFile(path, StandInPlan(count)) as file:
        for start in range(0, len(runs), 50):
            file.append([rows(run) for run in runs[start : start + 50]])
    return path


def started(path: Path, count: int, order: int, *steps: int) -> subprocess.Popen:
    """A process that goes on with the file, and is killed after so many steps of writing."""
    words = map(str, (sys.executable, PROGRAM, path, count, order, *steps))
    return subprocess.Popen([*words], stdout=subprocess.PIPE, text=True)


def killed(path: Path, count: int, order: int, steps: int) -> int:
    """Let a process write so many steps, and die; returns the runs it said to be safe."""
    process = started(path, count, order, steps)
    said = process.communicate()[0].split()
    assert process.returncode == -signal.SIGKILL
    return max(map(int, filter(str.isdigit, said)), default=0)


def same_but_measured(row, expected) -> bool:
    return replace(row, wall_time=0.0, worker="") == replace(expected, wall_time=0.0, worker="")


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """A whole sweep of more rows than a shard has."""
    return load_sweep(written(tmp_path_factory.mktemp("sweep") / "s.h5", 2 * SHARD_ROWS + 100))


# What is put in comes out


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("values", "type_"),
    [
        ([1, 2], "int64"), ([1.0, 2], "float64"), ([0.5, None], "float64"), ([True, False], "bool"),
        (["a", "b"], "string"), (["a", None], "json"), ([1, True], "json"), ([1, 2**60], "json"),
        ([[1]], "json"), (["\x1b"], "json"), ([None], "json"), ([], "json"),
    ],
)  # fmt: skip
def test_a_column_has_the_type_that_leaves_its_values_equal(values, type_):
    assert type_of(values) == type_


def test_the_file_can_be_read_without_this_program(sweep):
    with h5py.File(sweep.path) as file:
        columns = file["columns"]
        assert {len(column) for column in columns.values()} == {sweep.count}
        assert columns["run"][2] == 3
        assert columns["object.mass"][2] == row_of(3).values["object.mass"]
        assert columns["gap"][2] == row_of(3).quantities["gap"]
        assert [columns[name].attrs["unit"] for name in NAMES] == ["m", "N", "J"]
        nan = np.isnan(columns["gap"])
        assert set(columns["status"].asstr()[nan]) == {"failed"}
        assert json.loads(columns["$.run"].asstr()[2]) == row_of(3).values["run"]


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


# Killed, and resumed


@pytest.mark.slow
def test_a_sweep_killed_again_and_again_ends_with_the_same_table(tmp_path):
    path, count, rng = tmp_path / "s.h5", 1500, random.Random(11)
    safe = 0  # a block has 7 runs and 3 steps: far from all after so few
    for order in range(10):
        # while the file begins, or among new rows
        said = killed(path, count, order, rng.choice([rng.randint(0, 3), rng.randint(4, 60)]))
        assert said == 0 or said >= safe, "what was safe is there after resuming"
        if path.exists():
            found = load_sweep(path)
            assert len(found) >= max(said, safe), "what it said to be safe is safe"
            assert all(same_but_measured(row, row_of(row.run)) for row in found.rows())
            safe = len(found)
    assert 0 < safe < count
    process = started(path, count, 99)
    assert process.communicate()[0].endswith("end\n")
    found, whole = load_sweep(path), load_sweep(written(tmp_path / "whole.h5", count))
    for name, column in whole.table.items():
        if name not in MEASURED:
            np.testing.assert_array_equal(found.table[name], column, err_msg=name)
    assert len(set(found.table["worker"])) > 5, "rows of processes that were killed are kept"
    assert found.summary() == replace(whole.summary(), wall_time=found.summary().wall_time)
    assert {p.name for p in tmp_path.iterdir()} == {"s.h5", "whole.h5"}


class Killed(BaseException):
    """Stands for the end of the process."""


@pytest.mark.slow
def test_a_kill_before_any_step_of_writing_costs_at_most_what_was_appended(tmp_path, monkeypatch):
    """Before every call by which the writer changes the disk, also while it moves the rows."""
    monkeypatch.setattr(store, "SHARD_ROWS", 4)
    originals = {place: getattr(*place) for place in STEPS}

    def life(path: Path, calls: int | None) -> int:
        """Write until so many steps are made; returns the rows that were safe."""
        left = [calls]

        def step(place):
            def stepped(*arguments, **options):
                if left[0] is not None:
                    if left[0] == 0:
                        raise Killed
                    left[0] -= 1
                return originals[place](*arguments, **options)

            return stepped

        for place in STEPS:
            monkeypatch.setattr(*place, step(place))
        file, safe = None, 0
        try:
            file = SweepFile(path, StandInPlan(10))
            safe = file.made
            missing = list(file.missing())
            for pair in (missing[k : k + 2] for k in range(0, len(missing), 2)):
                file.append(map(row_of, pair))
                safe = file.made
            file.close()
        except Killed:
            if file is not None:
                file._lock.release()
        for place in STEPS:
            monkeypatch.setattr(*place, originals[place])
        return safe

    ended = 0
    for first in range(40):
        path = tmp_path / f"{first}.h5"
        safe = life(path, first)
        if path.exists():
            rows = list(load_sweep(path).rows())
            assert len(rows) in (safe, safe + 2) and rows == [row_of(row.run) for row in rows]
        life(path, (7 * first) % 5)  # and again while it resumes
        life(path, None)
        assert list(load_sweep(path).rows()) == [row_of(run) for run in range(1, 11)]
        assert not path.with_name(f"{path.name}.rows").exists()
        ended += safe == 10
    assert 0 < ended < 40


def test_a_file_that_is_being_written_shows_what_is_safe(tmp_path):
    with SweepFile(tmp_path / "s.h5", StandInPlan(100)) as file:
        for end in (10, 60, 100):
            file.append([row_of(run) for run in range(file.made + 1, end + 1)])
            found = load_sweep(tmp_path / "s.h5")
            assert list(found.rows()) == [row_of(run) for run in range(1, end + 1)]


@pytest.mark.slow
@pytest.mark.parametrize("which", ["s.h5", "s.h5.rows/000001.parquet"])
def test_a_file_cut_anywhere_is_refused(tmp_path, which):
    path = tmp_path / "s.h5"
    killed(path, 400, 1, 120)
    assert len(load_sweep(path)) > 50
    part = tmp_path / which
    data = part.read_bytes()
    for size in random.Random(5).sample(range(len(data)), 12):
        part.write_bytes(data[:size])
        with pytest.raises(SweepError, match=r"cut short|not an HDF5 file"):
            load_sweep(path)
    if part != path:  # as the message says
        part.unlink()
        assert len(load_sweep(path)) == 0


def test_a_row_that_comes_twice_is_there_once(tmp_path):
    path, plan = tmp_path / "s.h5", StandInPlan(9)
    with SweepFile(path, plan) as file:
        file.append([row_of(1), row_of(1), row_of(2)])
        file.append([replace(row_of(2), worker="another")])
        assert file.made == 2
    with SweepFile(path, plan) as file:
        assert list(file.missing()) == [3, 4, 5, 6, 7, 8, 9]
        file.append([row_of(4)])
        with pytest.raises(SweepError, match="there is no run 10; runs are 1 to 9"):
            file.append([row_of(3), row_of(10)])
    found = load_sweep(path)
    assert list(found.rows()) == [row_of(1), row_of(2), row_of(4)]


def test_resuming_again_and_again_does_not_let_the_file_grow(tmp_path):
    path, sizes = written(tmp_path / "s.h5", 200), []
    for _ in range(3):
        with SweepFile(path, StandInPlan(200)) as file:
            assert file.made == 200
        sizes.append(path.stat().st_size)
    assert len(set(sizes)) == 1


def test_rows_are_on_the_disk_before_they_count(tmp_path, monkeypatch):
    path, seen = tmp_path / "s.h5", []
    with SweepFile(path, StandInPlan(9)) as file:
        monkeypatch.setattr(
            store.os, "fsync", lambda _: seen.append((len(load_sweep(path)), file.made))
        )
        for run in range(1, 10):
            file.append([row_of(run)])
        # the shard before it is renamed, its folder afterwards
        assert seen == [pair for k in range(9) for pair in ((k, k), (k + 1, k))]


@pytest.mark.slow
def test_the_shards_of_a_file_that_was_removed_are_not_taken_for_those_of_the_next(tmp_path):
    path = tmp_path / "s.h5"
    killed(path, 400, 1, 60)
    kept = path.with_name("s.h5.rows")
    shutil.copytree(kept, tmp_path / "copy")
    path.unlink()
    with SweepFile(path, StandInPlan(400)) as file:
        assert file.made == 0
    shutil.copytree(tmp_path / "copy", kept)
    other = replace(StandInPlan(400), fingerprint="other")
    written_by_other = SweepFile(path, other, fresh=True)
    shutil.copytree(tmp_path / "copy", kept)
    assert len(load_sweep(path)) == 0
    written_by_other.close()


@pytest.mark.slow
def test_a_writer_holds_no_more_than_its_youngest_shard(tmp_path):
    some = [row_of(run) for run in range(1, 101)]
    held = {}
    with SweepFile(tmp_path / "s.h5", StandInPlan(6000)) as file:
        for start in range(0, 6000, 100):
            file.append(replace(row, run=start + row.run) for row in some)
            held[file.made] = pa.total_allocated_bytes()
    assert held[6000] < 1.5 * held[1000]


# Refused


@pytest.mark.slow
def test_a_second_writer_is_refused_in_words_until_the_first_is_gone(tmp_path):
    path = tmp_path / "s.h5"
    process = started(path, 100_000, 1)
    for _ in range(4):
        process.stdout.readline()
    try:
        with pytest.raises(SweepError) as caught:
            SweepFile(path, StandInPlan(100_000))
        with pytest.raises(SweepError):
            SweepFile(path, StandInPlan(100_000), fresh=True)
    finally:
        process.kill()
        process.communicate()
    assert f"is being written by another process ({process.pid} on " in str(caught.value)
    with SweepFile(path, StandInPlan(100_000)) as file, pytest.raises(SweepError):
        SweepFile(path, StandInPlan(100_000))
    assert file.made > 0


def test_the_file_of_another_sweep_is_refused_with_what_differs(tmp_path):
    path, plan = written(tmp_path / "s.h5", 20), StandInPlan(20)
    before = path.read_bytes()
    other = replace(plan, fingerprint="other", text=plan.text.replace("50", "60"))
    with pytest.raises(SweepError) as caught:
        SweepFile(path, other)
    lines = str(caught.value).splitlines()
    assert lines[0].startswith(f"'{path}' holds another sweep; choose another file")
    assert lines[1:] == [f"  sweep: -{plan.text.strip()}", f"  sweep: +{other.text.strip()}"]
    light = replace(plan, fingerprint="other", scene_text="gravity: [0, 0, -1.5]\n")
    with pytest.raises(SweepError, match=r"scene: \+gravity: \[0, 0, -1.5\]"):
        SweepFile(path, light)
    with pytest.raises(SweepError, match="the text of a function that gives a quantity"):
        SweepFile(path, replace(plan, fingerprint="other"))
    assert path.read_bytes() == before
    with SweepFile(path, other, fresh=True) as file:
        assert file.made == 0


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
            SweepFile(path, StandInPlan(3), fresh=True)
    sweep = written(tmp_path / "s.h5", 3)
    with pytest.raises(TrajectoryError, match="it is something else, damaged or write"):
        TrajectoryReader.writable_target(sweep)
    for version, words in [
        (1, r"written by an earlier multiarm, .*: make the sweep again in another file, or over"),
        (3, "has format version 3; this program reads up to 2"),
    ]:
        with h5py.File(sweep, "r+") as file:
            file.attrs["format_version"] = version
        with pytest.raises(SweepError, match=words):
            load_sweep(sweep)
        with pytest.raises(SweepError, match=words):
            SweepFile(sweep, StandInPlan(3))
    with SweepFile(sweep, StandInPlan(3), fresh=True) as file:
        assert file.made == 0
    (tmp_path / "l.h5.rows").symlink_to(tmp_path)
    with pytest.raises(SweepError, match=r"l\.h5\.rows' is a link, which is not followed"):
        SweepFile(tmp_path / "l.h5", StandInPlan(3))


def test_a_folder_whose_name_is_no_unicode_is_stored(tmp_path):
    folder = os.fsdecode(b"/data/\xff")
    with SweepFile(tmp_path / "s.h5", StandInPlan(2, folder=folder, files={folder: "0"})) as file:
        file.append([row_of(1)])
    assert list(load_sweep(tmp_path / "s.h5").rows()) == [row_of(1)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"count": -1}, r"header\.count: Input should be greater than or equal to 0"),
        ({"count": 3.0}, r"header\.count: Input should be a valid integer"),
        ({"files": None}, r"header\.files: Input should be a valid dictionary"),
        ({"columns": [{"name": "run"}]}, r"header\.columns\[0\]\.group: Field required"),
        ({"columns": []}, r"its columns are not those of a sweep"),
    ],
)
def test_a_header_that_is_none_of_a_sweep_is_refused_with_the_entry(tmp_path, change, words):
    path = written(tmp_path / "s.h5", 3)
    with h5py.File(path, "r+") as file:
        header = json.loads(file["header"].asstr()[()]) | change
        file["header"][()] = json.dumps(header)
    with pytest.raises(SweepError, match=rf"cannot be used: {words}; copy it again"):
        load_sweep(path)


def test_a_full_disk_ends_the_writing_in_words_and_keeps_the_rows(tmp_path):
    path = tmp_path / "s.h5"
    plan = StandInPlan(100_000)
    file = SweepFile(path, plan)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, before[1]))
    try:
        with pytest.raises(SweepError, match=r"cannot write to .*free some space on the disk"):
            for start in range(1, plan.count, 100):
                file.append([row_of(run) for run in range(start, start + 100)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    safe = file.made
    file.close()
    with SweepFile(path, plan) as file:
        assert file.made == safe > 100
    found = load_sweep(path)
    assert list(found.rows()) == [row_of(run) for run in range(1, safe + 1)]


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
        with SweepFile(path, StandInPlan(count)) as file:
            file.append(map(row_of, runs))
        found = load_sweep(path)
        summaries.append(found.summary())
    assert summaries[0] == summaries[1] == summaries[2]


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
