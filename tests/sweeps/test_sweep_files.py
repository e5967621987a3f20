"""Claims about the folder of a sweep: nothing is lost, nothing is made up, whoever is killed."""

from __future__ import annotations

import json
import random
import resource
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pyarrow.parquet
import pytest
from refusals import refused
from repository import SUPPORT
from sweep_runs import MEASURED, same
from sweep_stand_in import FAILING, NAMES, STEPS, opened, row_of, stand_in_plan

from multiarm.errors import SceneError, SweepError
from multiarm.sweeps import folder as folders
from multiarm.sweeps.folder import PART_ROWS, create, without_mixed_types
from multiarm.sweeps.result import load_sweep
from multiarm.sweeps.run import Row
from multiarm.sweeps.sweep import _folder

PROGRAM = SUPPORT / "sweep_stand_in.py"


def written(path: Path, count: int, runs=None) -> Path:
    """The folder of a sweep with some of its runs, in an order of their own."""
    runs = list(range(1, count + 1) if runs is None else runs)
    random.Random(count).shuffle(runs)
    writer, _ = opened(path, stand_in_plan(count))
    for start in range(0, len(runs), 50):
        writer.append([row_of(run) for run in runs[start : start + 50]])
    return path


@pytest.fixture
def write_on():
    """Let a process go on with a folder, and die after some steps; its words and exit code."""
    command, pipes = (
        [sys.executable, PROGRAM],
        {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE},
    )
    with subprocess.Popen(command, text=True, **pipes) as server:

        def write(path: Path, count: int, order: int, *steps: int) -> tuple[list[str], int]:
            print(path, count, order, *steps, file=server.stdin, flush=True)
            words = []
            for line in server.stdout:
                if line.startswith("exit "):
                    return words, int(line.split()[1])
                words.append(line.strip())
            raise EOFError(words)

        yield write
        server.stdin.close()


def rows_of(sweep) -> list[Row]:
    """Rows as a worker gives them: a missing entry is None."""
    table = sweep.table.astype(object)
    table = table.drop(columns=list(sweep.paths))
    return table.where(table.notna(), None).to_dict("records")


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """A whole sweep of more rows than a part has."""
    count = 2 * PART_ROWS + 100
    return load_sweep(written(tmp_path_factory.mktemp("sweep") / "s.sweep", count))


# What is put in comes out


def test_rows_come_out_as_they_were_put_in_and_in_the_order_of_the_runs(sweep):
    assert rows_of(sweep) == [row_of(run) for run in range(1, sweep.count + 1)]
    for path, name in zip(sweep.paths, ("object.mass", "effects.joint_damping"), strict=False):
        assert sweep.table[name].tolist() == sweep.plan.spec.table[path].tolist()
    types = {type(value) for value in sweep.table["effects.joint_damping"]}
    assert types == {int, float, type(None), bool}, "1 and True are not one value"


def test_what_is_missing_is_missing_and_no_nan(sweep):
    failed = sweep.table[sweep.table["status"] == "failed"]
    assert failed["run"].tolist() == list(range(FAILING, sweep.count + 1, FAILING))
    assert failed["message"].iloc[0] == f"the step of run {FAILING} is too small"
    for name in NAMES:
        assert set(failed[name]) == {pandas.NA}
        assert not np.isnan(sweep.table[name].dropna().astype(float)).any()
    assert sweep.status_counts == {"completed": sweep.count - len(failed), "failed": len(failed)}


def test_a_column_whose_name_is_taken_is_told_apart(sweep):
    assert sweep.table["run"][2] == 3
    assert sweep.table["$.run"][2] == sweep.values_of(3)["$.run"]


def test_a_table_is_readable_where_the_robots_of_the_scene_are_not(tmp_path):
    folder = written(tmp_path / "s.sweep", 3)
    (scene,) = folder.glob("scene*")
    text = scene.read_text(encoding="utf-8")
    assert text.count("robot: ur5") == 2
    scene.write_text(text.replace("robot: ur5", "urdf: /nowhere/ur5.urdf"), encoding="utf-8")
    sweep = load_sweep(folder)
    assert rows_of(sweep) == [row_of(run) for run in (1, 2, 3)]
    assert sweep.values_of(2)["object.mass"] == sweep.table["object.mass"][1]
    for run in (0, 4):
        with refused(SweepError, f"no run {run}"):
            sweep.values_of(run)
    with refused(SceneError, "/nowhere/ur5.urdf"):
        sweep.scene_of(2)


def test_the_parts_can_be_read_without_this_program(sweep):
    table = pandas.read_parquet(sweep.path / "parts").set_index("run").sort_index()
    assert table.index.tolist() == list(range(1, sweep.count + 1))
    assert table["object.mass"][3] == sweep.values_of(3)["object.mass"]
    assert table["gap"][3] == row_of(3)["gap"]
    assert table["effects.joint_damping"][3] == str(sweep.values_of(3)["effects.joint_damping"])
    first = next((sweep.path / "parts").glob("*.parquet"))
    schema = pyarrow.parquet.read_schema(first)
    assert [schema.field(name).metadata[b"unit"] for name in NAMES] == [b"m", b"N", b"J"]
    assert sweep.table.attrs["units"] == dict(zip((*NAMES, "wall_time"), "mNJs", strict=True))


def test_a_sweep_that_is_not_complete_says_which_runs_it_has(tmp_path):
    sweep = load_sweep(written(tmp_path / "s.sweep", 40, runs=[7, 3, 40]))
    assert (sweep.runs.tolist(), sweep.complete) == ([3, 7, 40], False)
    assert repr(sweep) == "Sweep(3 of 40 runs: 3 completed)"
    assert sweep.values_of(8) == sweep.plan.spec.values(8)
    with refused(SweepError, "run 41"):
        sweep.values_of(41)


# Killed, and resumed


@pytest.mark.slow
def test_a_sweep_killed_again_and_again_ends_with_the_same_table(tmp_path, write_on):
    path, count, rng = tmp_path / "s.sweep", 200, random.Random(11)
    safe = 0  # a block has 7 runs and 3 steps: far from all after so few
    for order in range(5):
        # while the folder begins, or among new rows
        steps = rng.choice([rng.randint(0, 3), rng.randint(9, 60)])
        words, code = write_on(path, count, order, steps)
        assert code == -signal.SIGKILL
        said = max(map(int, filter(str.isdigit, words)), default=0)
        assert said == 0 or said >= safe, "what was safe is there after resuming"
        if path.exists():
            rows = rows_of(load_sweep(path))
            assert len(rows) >= max(said, safe), "what it said to be safe is safe"
            assert all(same(row) == same(row_of(row["run"])) for row in rows)
            safe = len(rows)
    assert 0 < safe < count
    words, code = write_on(path, count, 99)
    assert words[-1] == "end" and code == 0
    sweep, whole = load_sweep(path), load_sweep(written(tmp_path / "whole.sweep", count))
    pandas.testing.assert_frame_equal(
        sweep.table.drop(columns=MEASURED), whole.table.drop(columns=MEASURED)
    )
    assert sweep.table["worker"].nunique() > 2, "rows of processes that were killed are kept"
    assert sweep.summary() == replace(whole.summary(), wall_time=sweep.summary().wall_time)


class Killed(BaseException):
    """Stands for the end of the process."""


@pytest.mark.slow
def test_a_kill_before_any_step_of_writing_costs_at_most_what_was_appended(tmp_path, monkeypatch):
    """Before every call by which the writer changes the disk."""
    monkeypatch.setattr(folders, "PART_ROWS", 4)
    originals = {place: getattr(*place) for place in STEPS}
    plan = stand_in_plan(10)

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
        safe = 0
        try:
            writer, made = opened(path, plan)
            safe = len(made)
            missing = sorted({*range(1, 11)} - {*made})
            for pair in (missing[k : k + 2] for k in range(0, len(missing), 2)):
                writer.append([row_of(run) for run in pair])
                safe += len(pair)
        except Killed:
            pass
        for place in STEPS:
            monkeypatch.setattr(*place, originals[place])
        return safe

    ended = 0
    for first in range(40):
        path = tmp_path / f"{first}.sweep"
        safe = life(path, first)
        if path.exists():
            rows = rows_of(load_sweep(path))
            assert len(rows) in (safe, safe + 2)
            assert rows == [row_of(row["run"]) for row in rows]
        life(path, (7 * first) % 5)  # and again while it resumes
        life(path, None)
        assert rows_of(load_sweep(path)) == [row_of(run) for run in range(1, 11)]
        ended += safe == 10
    assert 0 < ended < 40


def test_a_folder_that_is_being_written_shows_what_is_safe(tmp_path):
    path = tmp_path / "s.sweep"
    writer, made = opened(path, stand_in_plan(100))
    assert made == []
    begin = 1
    for end in (10, 60, 100):
        writer.append([row_of(run) for run in range(begin, end + 1)])
        assert rows_of(load_sweep(path)) == [row_of(run) for run in range(1, end + 1)]
        begin = end + 1


def test_a_part_cut_anywhere_is_refused_and_may_be_removed(tmp_path):
    path = written(tmp_path / "s.sweep", 60)
    (part,) = (path / "parts").glob("*.parquet")
    data = part.read_bytes()
    for size in random.Random(5).sample(range(len(data)), 4):
        part.write_bytes(data[:size])
        with pytest.raises(SweepError, match=r"\.parquet"):
            load_sweep(path)
    part.unlink()  # as the message says
    assert len(load_sweep(path)) == 0


def test_a_row_that_comes_twice_is_there_once_so_that_writers_do_no_harm_to_each_other(tmp_path):
    path, plan = tmp_path / "s.sweep", stand_in_plan(9)
    first, _ = opened(path, plan)
    first.append([row_of(1), row_of(2)])
    second, made = opened(path, plan)
    assert made == [1, 2]
    for run in (3, 4, 5):
        second.append([row_of(run, "second")])
        first.append([row_of(run, "first")])
    assert [same(row) for row in rows_of(load_sweep(path))] == [
        same(row_of(run)) for run in range(1, 6)
    ]


def test_rows_are_on_the_disk_before_they_count(tmp_path, monkeypatch):
    path, seen = tmp_path / "s.sweep", []
    writer, _ = opened(path, stand_in_plan(9))
    monkeypatch.setattr(folders.os, "fsync", lambda _: seen.append(len(load_sweep(path))))
    for run in range(1, 10):
        writer.append([row_of(run)])
    # the part before it is renamed, its folder afterwards
    assert seen == [count for run in range(9) for count in (run, run + 1)]


# Refused


def test_the_folder_of_another_sweep_is_refused_with_what_differs(tmp_path, monkeypatch):
    path = written(tmp_path / "s.sweep", 20)
    before = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    with pytest.raises(SweepError) as caught:
        _folder(path, stand_in_plan(20, seed=4), True)
    lines = str(caught.value).splitlines()
    assert lines[0].startswith(f"'{path}' holds another sweep; choose another folder")
    assert lines[1:] == ["  sweep: -seed: 3", "  sweep: +seed: 4"]
    plan = stand_in_plan(20)
    light = replace(plan, scene=plan.scene.replace(gravity=[0, 0, -1.5]))
    with refused(SweepError, "scene: +gravity"):
        _folder(path, light, True)
    edited = stand_in_plan(20)
    monkeypatch.setattr(type(edited), "functions", ["another text"])
    with refused(SweepError, "a function that gives a quantity"):
        _folder(path, edited, True)
    assert before == {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    _folder(path, stand_in_plan(20, seed=4), False)
    assert len(load_sweep(path)) == 0


def test_what_is_no_sweep_is_neither_read_nor_replaced(tmp_path):
    old, foreign = tmp_path / "t.h5", tmp_path / "foreign"
    old.write_bytes(b"\x89HDF\r\n\x1a\n")
    foreign.mkdir()
    (foreign / "precious").touch()
    for path in (old, foreign, tmp_path / "nothing"):
        with refused(SweepError, str(path)):
            load_sweep(path)
    for path in (old, foreign):
        with refused(SweepError, str(path)):
            create(path, stand_in_plan(3))
    assert (foreign / "precious").exists() and old.read_bytes()


@pytest.mark.parametrize(
    "change",
    [
        {"version": 3},
        {"files": None},
        {"functions": "none"},
    ],
)
def test_a_header_that_is_none_of_a_sweep_is_refused_with_the_entry(tmp_path, change):
    path = written(tmp_path / "s.sweep", 3)
    about = json.loads((path / "about.json").read_text()) | change
    (path / "about.json").write_text(json.dumps(about))
    with refused(SweepError, str(path)):
        load_sweep(path)


def test_a_full_disk_ends_the_writing_in_words_and_keeps_the_rows(tmp_path):
    path, plan = tmp_path / "s.sweep", stand_in_plan(2000)
    writer, _ = opened(path, plan)
    before, safe = resource.getrlimit(resource.RLIMIT_FSIZE), 0
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, before[1]))
    try:
        with refused(SweepError, "s.sweep"):
            for start in range(1, plan.spec.count, 100):
                writer.append([row_of(run) for run in range(start, start + 100)])
                safe += 100
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert safe > 100
    assert rows_of(load_sweep(path)) == [row_of(run) for run in range(1, safe + 1)]


# As a whole


def test_the_summary_is_what_numpy_says_of_the_table(sweep):
    summary = sweep.summary()
    gap = sweep.table["gap"].to_numpy(float, na_value=np.nan)
    runs, there = sweep.table["run"].to_numpy(), ~np.isnan(gap)
    spread = next(spread for spread in summary.spreads if spread.name == "gap")
    assert (spread.count, spread.smallest) == (there.sum(), np.nanmin(gap))
    assert spread.largest == np.nanmax(gap)
    assert spread.smallest_run == runs[np.nanargmin(gap)]
    assert spread.largest_run == runs[np.nanargmax(gap)]
    assert spread.mean == pytest.approx(np.nanmean(gap), rel=1e-12)
    for level, value in spread.quantiles.items():
        assert value == pytest.approx(np.quantile(gap[there], level), rel=1e-14)
    never = next(spread for spread in summary.spreads if spread.name == "never")
    assert (never.count, never.mean, never.largest_run) == (0, None, None)
    assert [(f.runs, f.first_run) for f in summary.failures] == [(sweep.count // FAILING, FAILING)]
    json.dumps(summary.figures(), allow_nan=False)


def test_a_table_for_parquet_has_texts_where_values_are_of_several_types(sweep, tmp_path):
    without_mixed_types(sweep.table).to_parquet(tmp_path / "s.parquet", index=False)
    table = pandas.read_parquet(tmp_path / "s.parquet")
    assert list(table) == [column.name for column in sweep.columns]
    assert table["effects.joint_damping"].tolist() == [
        str(value) for value in sweep.table["effects.joint_damping"]
    ]
    np.testing.assert_array_equal(table["object.mass"], sweep.table["object.mass"])
