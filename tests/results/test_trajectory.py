"""Trajectories and their files: nothing is lost, nothing is altered, every trouble is named."""

import itertools
import json
import pickle
import random
import subprocess
import sys
import tracemalloc
import types

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from repository import ROOT, SUPPORT
from sample_run import (
    CHANNELS,
    CONTACTS,
    JOINTS,
    SCENE,
    STATISTICS,
    earlier_run,
    numbered_block,
    record,
    rows_of,
    samples,
)

from multiarm.errors import SceneError, TrajectoryError
from multiarm.results.channels import Channel
from multiarm.results.hdf5 import lookup3
from multiarm.results.outcome import RunStatus
from multiarm.results.sinks import Hdf5Sink, MemorySink, provenance
from multiarm.results.trajectory import load_trajectory

EVENTS = [{"time": 1.5, "kind": "projection", "size": 1e-9}]
CERTIFICATE = {"requested_accuracy": 1e-6, "estimated_error": 3.2e-8}


def memory_sink(folder):
    return MemorySink()


def file_sink(folder):
    return Hdf5Sink(folder / "run.h5")


both_sinks = pytest.mark.parametrize("sink_in", [memory_sink, file_sink])


def child(call, **options):
    """A process that calls a function of sample_run."""
    code = f"import sample_run; sample_run.{call}"
    return subprocess.Popen(
        [sys.executable, "-c", code], cwd=SUPPORT, text=True,
        env={"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options,
    )  # fmt: skip


def assert_same(one, other):
    for channel in CHANNELS:
        a, b = one.read(channel.name), other.read(channel.name)
        assert a.dtype == b.dtype == np.float64
        assert a.shape == b.shape
        assert a.tobytes() == b.tobytes(), channel.name
    assert one.channels == other.channels
    assert one.provenance == other.provenance
    assert (one.status, one.message, one.statistics) == (
        other.status, other.message, other.statistics,
    )  # fmt: skip
    assert (one.events, one.certificate) == (other.events, other.certificate)


# What a trajectory shows


@both_sinks
def test_attributes_have_the_promised_shapes(tmp_path, sink_in):
    run = record(sink_in(tmp_path))
    count = len(run)
    assert run.time.shape == (count,)
    assert run.object_position.shape == (count, 3)
    assert run.object_quaternion_xyzw.shape == (count, 4)
    assert run.object_twist.shape == (count, 6)
    assert run.arm_names == tuple(JOINTS)
    for arm in JOINTS:
        for quantity in (run.joint_positions, run.joint_velocities, run.joint_torques):
            assert quantity[arm].shape == (count, len(JOINTS[arm]))
        assert run.contact_forces[arm].shape == (count, len(CONTACTS[arm]))
    for values in (run.kinetic_energy, run.potential_energy, run.work, run.energy,
                   run.energy_balance, run.position_drift, run.velocity_drift):  # fmt: skip
        assert values.shape == (count,)


def test_energy_balance_is_energy_gained_less_work_done():
    block = numbered_block(0, 3)
    block["energy/kinetic"] = np.array([1.0, 4.0, 9.0])
    block["energy/potential"] = np.array([-10.0, -12.0, -14.0])
    block["energy/work"] = np.array([0.0, 0.5, 5.0])
    run = record(MemorySink(), [block])
    assert run.energy.tolist() == [-9.0, -8.0, -5.0]
    assert run.energy_balance.tolist() == [0.0, 0.5, -1.0]
    assert run.summary()["energy_balance_max_J"] == 1.0


def test_unknown_arm_names_the_arms():
    run = record(MemorySink())
    with refused(TrajectoryError, "'rigth'"):
        run.joint_positions["rigth"]
    assert run.joint_positions.get("rigth") is None
    assert list(run.joint_positions) == ["left", "right"]


def test_unknown_channel_names_the_channels():
    with refused(TrajectoryError, "'speed'"):
        record(MemorySink()).channel("speed")


@both_sinks
def test_a_trajectory_cannot_be_altered(tmp_path, sink_in):
    run = record(sink_in(tmp_path))
    with pytest.raises(ValueError, match="read-only"):
        run.time[0] = 1.0
    with pytest.raises(AttributeError):
        run.time = np.zeros(3)
    run.statistics["steps"] = -1
    assert run.statistics == STATISTICS


def test_samples_do_not_change_when_the_caller_reuses_its_arrays():
    block, sink = samples(), MemorySink()
    rows = rows_of(CHANNELS, block)
    sink.open(CHANNELS, {})
    sink.append(rows)
    rows[:] = 0.0
    run = sink.finish("completed", "", {})
    assert np.array_equal(run.object_twist, block["object/twist"])


def test_scene_is_parsed_once_from_the_stored_text(monkeypatch):
    calls = []
    scene_module = types.ModuleType("multiarm.scene")
    scene_module.parse_scene = lambda text, folder, code: calls.append((text, folder)) or object()
    monkeypatch.setitem(sys.modules, "multiarm.scene", scene_module)
    run = record(MemorySink())
    assert calls == []
    assert run.scene is run.scene
    assert calls == [(SCENE, None)]


# Summary


def test_summary_reports_extremes_and_the_end():
    run = record(MemorySink())
    summary = run.summary()
    assert summary["duration_s"] == run.time[-1] - run.time[0]
    assert summary["samples"] == len(run.time)
    assert summary["steps"] == STATISTICS["steps"]
    assert summary["position_drift_max_m"] == run.position_drift.max()
    assert summary["velocity_drift_max_m_per_s"] == run.velocity_drift.max()
    assert summary["energy_balance_max_J"] == np.abs(run.energy_balance).max()
    assert summary["final_object_position"] == run.object_position[-1].tolist()
    assert summary["contact_force_max_N"]["left"] == np.abs(run.contact_forces["left"]).max()
    force = np.linalg.norm(run.wrenches["left"][:, :3], axis=1)
    largest = summary["wrench_max"]["left"]
    assert largest["force_N"] == pytest.approx(force.max(), rel=1e-15)
    assert largest["force_time_s"] == run.time[force.argmax()]
    assert largest["moment_N_m"] == 0.0


def test_largest_wrenches_are_found_in_any_block_and_do_not_overflow():
    block = numbered_block(0, 20_000)  # longer than what is read at a time
    wrench = np.zeros((20_000, 6))
    wrench[17, :3], wrench[9_000, :3], wrench[19_999, 3:] = [3, 0, 4], [0, -1e150, 0], [1, 2, 2]
    block["arms/left/wrench"] = wrench
    largest = record(MemorySink(), [block]).summary()["wrench_max"]["left"]
    assert largest == {
        "force_N": 1e150, "force_time_s": block["time"][9_000],
        "moment_N_m": 3.0, "moment_time_s": block["time"][19_999],
    }  # fmt: skip


def test_a_run_of_an_earlier_version_says_what_it_has_not(tmp_path):
    run = load_trajectory(earlier_run(record(MemorySink())).save(tmp_path / "old.h5"))
    for mapping in (run.wrenches, run.tip_positions, run.tip_quaternions_xyzw, run.tip_twists):
        assert dict(mapping) == {}
        for error in (TrajectoryError, KeyError):
            with pytest.raises(error, match="earlier version"):
                mapping["left"]
    assert run.summary()["wrench_max"] == {} and run.control_power == {}
    assert not run.to_pandas().filter(like="wrench").size


def test_a_power_for_each_joint_is_refused(tmp_path):
    record(file_sink(tmp_path))
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        power = file["arms/left/control_power"]
        values, attributes = power[:], dict(power.attrs)
        del file["arms/left/control_power"]
        file["arms/left/control_power"] = np.outer(values, np.ones(6))
        file["arms/left/control_power"].attrs.update(attributes)
    with refused(TrajectoryError, "'arms/left/control_power'"):
        load_trajectory(tmp_path / "run.h5")


@pytest.mark.parametrize("name", ["wrench", "tip_position", "tip_quaternion_xyzw", "tip_twist"])
def test_a_file_whose_wrench_or_tip_has_another_shape_is_refused(tmp_path, name):
    record(file_sink(tmp_path))
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        values = file[f"arms/left/{name}"][:]
        attributes = dict(file[f"arms/left/{name}"].attrs)
        del file[f"arms/left/{name}"]
        file[f"arms/left/{name}"] = values[:, 1:]
        attributes["columns"] = attributes["columns"][1:]
        file[f"arms/left/{name}"].attrs.update(attributes)
    with refused(TrajectoryError, f"'arms/left/{name}'"):
        load_trajectory(tmp_path / "run.h5")


@both_sinks
def test_summary_holds_finite_numbers_or_none(tmp_path, sink_in):
    wild = {"steps": np.int64(3), "realtime_factor": np.inf, "error_estimate": float("nan")}
    summary = record(sink_in(tmp_path), statistics=wild).summary()
    assert summary["steps"] == 3
    assert summary["realtime_factor"] is summary["error_estimate"] is summary["wall_time_s"] is None
    json.dumps(summary, allow_nan=False)


@both_sinks
def test_a_run_without_samples_has_a_summary(tmp_path, sink_in):
    summary = record(sink_in(tmp_path), [], status="failed", message="no start").summary()
    assert summary["samples"] == 0
    assert summary["status"] == "failed"
    assert summary["duration_s"] is summary["final_object_position"] is None
    assert summary["contact_force_max_N"] == {"left": None, "right": None}
    assert set(summary["wrench_max"]["left"].values()) == {None}


# Nothing is lost, nothing is altered


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(cuts=st.lists(st.integers(0, 1500), max_size=5))
def test_a_file_returns_every_bit_however_the_run_was_cut_into_blocks(tmp_path_factory, cuts):
    edges = [0, *sorted(cuts), 1500]
    blocks = [numbered_block(a, b) for a, b in itertools.pairwise(edges)]
    folder = tmp_path_factory.mktemp("cut")
    in_memory = record(MemorySink(), blocks, events=EVENTS, certificate=CERTIFICATE)
    in_file = record(Hdf5Sink(folder / "a.h5"), blocks, events=EVENTS, certificate=CERTIFICATE)
    whole = record(MemorySink(), [numbered_block(0, 1500)], events=EVENTS, certificate=CERTIFICATE)
    assert_same(in_memory, whole)
    assert_same(in_file, whole)
    assert_same(load_trajectory(in_memory.save(folder / "b.h5")), whole)
    assert_same(load_trajectory(in_file.save(folder / "c.h5")), whole)


def test_awkward_numbers_survive_bit_for_bit(tmp_path):
    block = numbered_block(0, 4)
    awkward = np.array([5e-324, -0.0, 1.2345678901234567e149, 0.1])
    block["drift/position"] = awkward
    run = load_trajectory(record(MemorySink(), [block]).save(tmp_path / "run.h5"))
    assert run.position_drift.tobytes() == awkward.tobytes()


def test_save_onto_its_own_file_keeps_everything(tmp_path):
    run = record(file_sink(tmp_path), events=EVENTS)
    run.save(tmp_path / "run.h5")
    assert_same(load_trajectory(tmp_path / "run.h5"), record(MemorySink(), events=EVENTS))
    assert [file.name for file in tmp_path.iterdir()] == ["run.h5"]


def test_a_new_run_at_the_same_place_leaves_an_open_trajectory_as_it_was(tmp_path):
    old = record(file_sink(tmp_path))
    new = record(file_sink(tmp_path), [numbered_block(0, 5)])
    assert_same(old, record(MemorySink()))
    assert len(new) == len(load_trajectory(tmp_path / "run.h5")) == 5


def test_names_in_any_script_survive(tmp_path):
    channels = [Channel("time", unit="s"), Channel("arms/左/joint_torque", (1,), "N m")]
    sink = file_sink(tmp_path)
    sink.open(channels, {"scene": "name: 二本の腕\n"})
    sink.append(np.array([[0.0, 1.0]]))
    run = sink.finish("failed", "zu groß: μ → ∞", {})
    assert (run.arm_names, run.scene_text, run.message) == (
        ("左",), "name: 二本の腕\n", "zu groß: μ → ∞",
    )  # fmt: skip


def test_a_file_explains_itself(tmp_path):
    record(file_sink(tmp_path), metadata=provenance(SCENE))
    with h5py.File(tmp_path / "run.h5") as file:
        assert file.attrs["format"] == "multiarm trajectory"
        assert json.loads(file.attrs["provenance"])["program"] == "multiarm"
        assert file["scene"].asstr()[()] == SCENE
        for channel in CHANNELS:
            attributes = file[channel.name].attrs
            assert attributes["unit"]
            assert attributes["description"]
        assert file["arms/right/joint_position"].attrs["unit"] == "m, rad, rad"
        assert file["arms/right/joint_torque"].attrs["unit"] == "N, N m, N m"
        assert list(file["arms/right/joint_torque"].attrs["columns"]) == list(JOINTS["right"])


@pytest.mark.slow
def test_loading_a_long_file_needs_memory_for_what_is_asked_only(tmp_path):
    count, size = 60, 1000
    blocks = (numbered_block(k * size, (k + 1) * size) for k in range(count))
    record(file_sink(tmp_path), blocks)
    columns = sum(int(np.prod(channel.shape)) for channel in CHANNELS)
    load_trajectory(tmp_path / "run.h5").summary()  # modules are imported by now
    tracemalloc.start()
    run = load_trajectory(tmp_path / "run.h5")
    run.summary()
    unread = tracemalloc.get_traced_memory()[1]
    assert run.time is run.time
    after_time = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert unread < 0.1 * 8 * columns * count * size
    assert after_time >= 8 * count * size


# Bad numbers and bad blocks


@both_sinks
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e151])
def test_a_number_that_is_not_finite_or_too_large_is_refused_by_name_and_time(
    tmp_path, sink_in, bad
):
    sink, block = sink_in(tmp_path), samples()
    sink.open(CHANNELS, {})
    block["arms/left/joint_torque"][7, 2] = bad
    block["energy/work"][9] = np.nan
    with refused(TrajectoryError, "'arms/left/joint_torque' (elbow_joint)", "at t = 0.07 s"):
        sink.append(rows_of(CHANNELS, block))
    run = sink.finish("failed", "not finite", {})
    assert np.array_equal(run.time, block["time"][:7])
    assert np.array_equal(run.joint_torques["left"], block["arms/left/joint_torque"][:7])
    assert run.status == "failed"


def test_a_time_that_is_not_finite_is_refused():
    sink, block = MemorySink(), samples()
    sink.open(CHANNELS, {})
    block["time"][3] = np.nan
    with refused(TrajectoryError, "'time'"):
        sink.append(rows_of(CHANNELS, block))


@both_sinks
def test_a_block_of_the_wrong_shape_is_refused(tmp_path, sink_in):
    sink, rows = sink_in(tmp_path), rows_of(CHANNELS, samples())
    sink.open(CHANNELS, {})
    for wrong in (rows[:, 1:], np.hstack([rows, rows[:, :1]]), rows[0]):
        with refused(TrajectoryError, "block"):
            sink.append(wrong)
    assert len(sink.finish("failed", "", {})) == 0


def test_what_a_run_in_memory_does_not_show_is_not_made():
    calls, sink = [], MemorySink()
    sink.open(CHANNELS, lambda: calls.append("metadata") or {"scene": SCENE})
    sink.append(rows_of(CHANNELS, samples()))
    run = sink.finish("completed", "", {})
    assert (len(run), run.status, calls) == (601, "completed", [])
    assert (run.time[-1], run.scene_text, run.scene_text) == (6.0, SCENE, SCENE)
    assert calls == ["metadata"]


def test_a_run_in_memory_is_pickled_with_its_origin():
    run = record(MemorySink(), metadata=lambda: provenance(SCENE))
    again = pickle.loads(pickle.dumps(run))
    assert_same(again, run)
    with pytest.raises(ValueError, match="read-only"):
        again.read("time")[0] = 1.0


def test_a_status_is_one_of_the_words_also_when_it_comes_from_a_file(tmp_path):
    record(Hdf5Sink(tmp_path / "run.h5"), status="failed")
    assert load_trajectory(tmp_path / "run.h5").status is RunStatus.FAILED


def test_an_unknown_status_is_refused():
    with refused(TrajectoryError, "'done'"):
        record(MemorySink(), status="done")


@pytest.mark.parametrize("arm", ["", ".", "..", "a//b"])
def test_an_arm_name_that_is_no_path_is_refused(arm):
    with refused(TrajectoryError, "'arms/"):
        Channel(f"arms/{arm}/joint_position", (1,))


# Places that cannot be written


@pytest.mark.parametrize("place", ["nowhere/run.h5", ".", "/dev/null"])
def test_a_place_that_holds_no_run_is_named_before_the_run_starts(tmp_path, place):
    with refused(TrajectoryError):
        Hdf5Sink(tmp_path / place).open(CHANNELS, {})


@pytest.mark.parametrize("hdf5", [True, False])
def test_somebody_elses_file_is_not_touched(tmp_path, hdf5):
    path = tmp_path / "run.h5"
    if hdf5:
        h5py.File(path, "w").close()
    else:
        path.write_text("my thesis")
    before = path.read_bytes()
    for write in (
        lambda: Hdf5Sink(path).open(CHANNELS, {}),
        lambda: record(MemorySink()).save(path),
    ):
        with refused(TrajectoryError, "run.h5"):
            write()
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
def test_a_full_disk_fails_the_run_and_keeps_its_samples(tmp_path):
    path = tmp_path / "run.h5"
    process = child(f"write_until_the_disk_is_full({str(path)!r}, 2_000_000)")
    said, errors = process.communicate()
    assert (process.returncode, errors) == (0, "")
    count, status, message = said.split(maxsplit=2)
    assert (status, "free some space on the disk" in message) == ("failed", True)
    run = load_trajectory(path)
    assert (run.status, run.message) == ("failed", message.strip())
    assert len(run) == int(count) > 0
    expected = numbered_block(0, len(run))
    assert all(np.array_equal(run.read(c.name), expected[c.name]) for c in CHANNELS)


@pytest.mark.slow
def test_a_disk_full_from_the_start_is_named_before_the_run(tmp_path):
    process = child(f"write_until_the_disk_is_full({str(tmp_path / 'run.h5')!r}, 5000)")
    errors = process.communicate()[1].strip().splitlines()
    assert errors[-1].startswith("multiarm.errors.TrajectoryError: cannot write to")
    assert list(tmp_path.iterdir()) == []


# Runs that were killed


@pytest.fixture(scope="module")
def killed_runs(tmp_path_factory):
    """Files of processes killed at random moments, with the samples known to be safe."""
    rng, folder = random.Random(7), tmp_path_factory.mktemp("killed")
    paths = [folder / f"{number}.h5" for number in range(5)]
    writers = [
        child(f"write_for_long({str(path)!r}, {rng.choice([1, 30, 700])})") for path in paths
    ]
    try:
        return [
            (p, _kill_after(w, rng.randint(1, 60))) for p, w in zip(paths, writers, strict=True)
        ]
    finally:
        for writer in writers:
            writer.kill()
            writer.communicate()


def _kill_after(process, lines):
    said = [process.stdout.readline() for _ in range(lines)]
    process.kill()
    said += process.stdout.read().splitlines(keepends=True)
    return int([line for line in said if line.endswith("\n")][-1])


@pytest.mark.slow
def test_a_killed_run_loads_up_to_its_last_checkpoint(killed_runs):
    for path, safe in killed_runs:
        run = load_trajectory(path)
        assert len(run) >= safe
        assert run.status == "interrupted"
        assert f"cut at t = {len(run) - 1} s" in run.message
        expected = numbered_block(0, len(run))
        for channel in CHANNELS:
            assert np.array_equal(run.read(channel.name), expected[channel.name])


@pytest.mark.slow
def test_a_killed_run_can_be_saved_and_replaced(killed_runs, tmp_path):
    path, _ = killed_runs[0]
    run = load_trajectory(path)
    assert_same(load_trajectory(run.save(tmp_path / "kept.h5")), run)
    copy = tmp_path / "copy.h5"
    copy.write_bytes(path.read_bytes())
    assert len(record(Hdf5Sink(copy))) == len(samples()["time"])


def test_a_running_file_shows_what_is_safe_so_far(tmp_path):
    sink = file_sink(tmp_path)
    sink.open(CHANNELS, {"scene": SCENE})
    empty = load_trajectory(tmp_path / "run.h5")
    assert (len(empty), "before its first checkpoint" in empty.message) == (0, True)
    sink.append(rows_of(CHANNELS, numbered_block(0, 10)))
    sink.checkpoint()
    sink.append(rows_of(CHANNELS, numbered_block(10, 20)))
    sink._writer.file.flush()  # as HDF5 does when its buffers are full
    running = load_trajectory(tmp_path / "run.h5")
    assert len(running) == 10
    np.testing.assert_array_equal(running.read("time", -2), running.time[-2:])
    assert len(sink.finish("completed", "", {})) == 20


def test_lookup3_agrees_with_its_author():
    """Jenkins's self-test prints this value, in lookup3.c, driver5."""
    assert lookup3(b"Four score and seven years ago") == 0x17770551


# Files that cannot be read


def another_file(path):
    with h5py.File(path, "w") as file:
        file["time"] = np.arange(3)


def newer_file(path):
    record(Hdf5Sink(path))
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = 99


def misshapen_file(path):
    record(Hdf5Sink(path))
    with h5py.File(path, "r+") as file:
        del file["energy/work"]
        file["energy/work"] = np.zeros((len(file["time"]), 2))
        file["energy/work"].attrs.update(file["energy/kinetic"].attrs)
        file["energy/work"].attrs["columns"] = ["x", "y"]


@pytest.mark.parametrize(
    "make",
    [
        lambda path: None,
        lambda path: path.mkdir(),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_text("name: a scene\n"),
        lambda path: path.write_bytes(b"\x89HDF\r\n\x1a\n" + b"\x03" * 90),
        another_file,
        misshapen_file,
        newer_file,
    ],
)
def test_what_is_no_run_that_can_be_read_is_refused_with_the_reason(tmp_path, make):
    make(tmp_path / "run.h5")
    with refused(TrajectoryError, "run.h5"):
        load_trajectory(tmp_path / "run.h5")


@pytest.mark.parametrize(
    ("channel", "value"), [("object/position", 1e308), ("object/position", np.inf), ("time", 1e10)]
)
def test_numbers_that_no_run_writes_are_refused_with_channel_and_file(tmp_path, channel, value):
    record(Hdf5Sink(tmp_path / "run.h5"))
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file[channel][-1] = value
    with refused(TrajectoryError, "run.h5"):
        load_trajectory(tmp_path / "run.h5").read(channel)


def test_faults_of_a_stored_scene_name_its_file(tmp_path):
    sink = Hdf5Sink(tmp_path / "run.h5")
    sink.open(CHANNELS, {"scene": "object: {mass: -3}"})
    sink.finish("completed", "", {})
    with pytest.raises(SceneError) as caught:
        _ = load_trajectory(tmp_path / "run.h5").scene
    assert str(tmp_path / "run.h5") in caught.value.source
    assert any(fault.startswith("$.object.mass: ") for fault in caught.value.faults)


@pytest.mark.parametrize("closed", [True, False])
def test_a_file_cut_short_never_passes_for_a_whole_one(tmp_path, closed):
    sink, whole, cut = file_sink(tmp_path), tmp_path / "run.h5", tmp_path / "cut.h5"
    sink.open(CHANNELS, {"scene": SCENE})
    sink.append(rows_of(CHANNELS, numbered_block(0, 2000)))
    sink.checkpoint()
    if closed:
        sink.finish("completed", "", {})
    run, content = load_trajectory(whole), whole.read_bytes()
    refused = 0
    for share in np.linspace(0.0, 0.999, 60):
        cut.write_bytes(content[: int(share * len(content))])
        try:
            loaded = load_trajectory(cut)
        except TrajectoryError as error:
            assert "cut.h5" in str(error)
            refused += 1
        else:  # an unclosed file ends in room that was reserved and not yet used
            assert not closed
            assert_same(loaded, run)
    assert refused > 20
