"""Results of several objects: each by its name, and those of one object as they always were."""

import h5py
import numpy as np
import pytest
from refusals import refused
from sample_run import (
    CHANNELS,
    CHANNELS_OF_TWO,
    CONTACTS,
    CORNERS,
    JOINTS,
    OBJECTS,
    SCENE,
    record,
    record_two,
    rows_of,
    samples_of_two,
)

from multiarm import plots
from multiarm.cli.run import run_figures, summary_table
from multiarm.errors import TrajectoryError
from multiarm.reports.report import render
from multiarm.reports.run_facts import figures_of, motion_facts
from multiarm.results.channels import (
    NAMES_OF_OBJECTS,
    RowOwner,
    channels_of,
    trajectory_channels,
)
from multiarm.results.sinks import Hdf5Sink, MemorySink
from multiarm.results.trajectory import load_trajectory
from multiarm.scene import parse_scene
from multiarm.simulation.comparison import compare, object_poses, pose_differences
from multiarm.studies.differences import Quantity, largest_differences
from multiarm.sweeps.quantities import measure

MOTION = ("position", "quaternion_xyzw", "twist")

both_sinks = pytest.mark.parametrize(
    "sink_in", [lambda folder: MemorySink(), lambda folder: Hdf5Sink(folder / "run.h5")]
)


# Channels


def test_one_object_has_the_channels_it_had_whatever_its_name():
    assert [c.name for c in CHANNELS[:4]] == ["time", *(f"object/{part}" for part in MOTION)]
    assert trajectory_channels(JOINTS, CONTACTS, controlled=True, objects=["beam"]) == CHANNELS
    around = trajectory_channels(JOINTS, CONTACTS, environment={"floor": ["corner"]})
    assert [c.name for c in around if c.owner.group == "environment"] == [
        "environment/contact_force", "environment/wrench",
    ]  # fmt: skip


def test_channels_of_several_objects_follow_each_other():
    names = [channel.name for channel in CHANNELS_OF_TWO]
    assert names[:7] == [
        "time",
        *(f"objects/beam/{part}" for part in MOTION),
        *(f"objects/plate/{part}" for part in MOTION),
    ]
    first = names.index("environment/beam/contact_force")
    assert names[first : first + 4] == [
        "environment/beam/contact_force", "environment/beam/wrench",
        "environment/plate/contact_force", "environment/plate/wrench",
    ]  # fmt: skip
    assert names[7:first] == [c.name for c in CHANNELS[4 : 4 + first - 7]]


def test_descriptions_name_the_object():
    described = {channel.name: channel for channel in CHANNELS_OF_TWO}
    assert described["objects/plate/position"].description == "centre of mass of the plate"
    assert "pushes the beam" in described["environment/beam/contact_force"].description
    assert "the beam's centre of mass" in described["environment/beam/wrench"].description


def test_a_wrench_is_about_the_centre_of_mass_of_an_object_with_any_name():
    owners = {
        "hinge": RowOwner("", "plate", first_is_link=False, on_object=True),
        "hold": RowOwner("left", "right/hand", first_is_link=True, on_object=False),
    }
    channels = trajectory_channels(
        {"left": {"slide": "m"}}, {"hinge": ["a"], "hold": ["b"]}, {"hinge": {"turn z": "rad"}},
        owners=owners, objects=OBJECTS,
    )  # fmt: skip
    described = {channel.name: channel.description for channel in channels}
    assert "about the plate's centre of mass" in described["arms/hinge/wrench"]
    assert "about the origin of the joint's frame" in described["arms/hold/wrench"]
    # neither body of the hinge is the link of an arm
    assert "arm's" not in described["arms/hinge/relative_rate"]
    assert "arms/hinge/tip_position" not in described and "arms/hold/tip_position" in described


# Trajectories


@both_sinks
def test_objects_of_a_result_go_by_their_names(tmp_path, sink_in):
    block = samples_of_two()
    run = record_two(sink_in(tmp_path), block)
    assert tuple(run.objects) == OBJECTS
    for name in OBJECTS:
        for part in MOTION:
            stored = getattr(run.objects[name], part)
            np.testing.assert_array_equal(stored, block[f"objects/{name}/{part}"])
    assert list(run.contact_forces) == list(run.wrenches) == ["left", "right", *CORNERS]
    assert run.contact_forces["floor/beam"].shape == (len(run), 2)
    np.testing.assert_array_equal(run.wrenches["floor/plate"], block["environment/plate/wrench"])
    assert channels_of(run.channels, "wrench")["floor/beam"] == "environment/beam/wrench"


def test_a_stored_run_with_several_objects_loads_as_it_was(tmp_path):
    block = samples_of_two()
    record_two(Hdf5Sink(tmp_path / "run.h5"), block)
    again = load_trajectory(load_trajectory(tmp_path / "run.h5").save(tmp_path / "again.h5"))
    assert tuple(again.channels.values()) == CHANNELS_OF_TWO
    for channel in CHANNELS_OF_TWO:
        np.testing.assert_array_equal(
            rows_of([channel], {channel.name: again.channel(channel.name)}),
            rows_of([channel], block),
        )


@pytest.mark.parametrize("part", MOTION)
def test_the_object_of_several_is_refused_by_name(part):
    run = record_two(MemorySink())
    with refused(TrajectoryError, "there are 2 objects, beam, plate"):
        getattr(run, f"object_{part}")


def test_an_unknown_object_is_refused_with_the_names_that_there_are():
    run = record_two(MemorySink())
    for error in (TrajectoryError, KeyError):
        with refused(error, "'bem'"):
            run.objects["bem"]
    with refused(KeyError, "there is none"):
        run.bases["cart"]
    assert run.objects.get("bem") is None and "plate" in run.objects


@both_sinks
def test_one_object_has_the_name_that_its_run_knows(tmp_path, sink_in):
    metadata = {"scene": SCENE, NAMES_OF_OBJECTS: ["beam"]}
    run = record(sink_in(tmp_path), metadata=metadata)
    assert list(run.objects) == ["beam"]
    np.testing.assert_array_equal(run.objects["beam"].position, run.object_position)
    assert list(run.summary()["final_poses"]) == ["beam"]
    # a result of an earlier version, or of another program
    for names in (None, [], ["a", "b"], [3], "beam"):
        strange = {"scene": SCENE} | ({} if names is None else {NAMES_OF_OBJECTS: names})
        assert list(record(MemorySink(), metadata=strange).objects) == ["object"]


@pytest.mark.parametrize("name", ["objects/plate/twist", "environment/beam/wrench"])
def test_an_object_of_a_file_with_another_shape_is_refused(tmp_path, name):
    record_two(Hdf5Sink(tmp_path / "run.h5"))
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        values, attributes = file[name][:], dict(file[name].attrs)
        del file[name]
        file[name] = values[:, 1:]
        attributes["columns"] = attributes["columns"][1:]
        file[name].attrs.update(attributes)
    with refused(TrajectoryError, f"'{name}'"):
        load_trajectory(tmp_path / "run.h5")


def test_numbers_of_all_objects_are_in_one_table():
    run = record_two(MemorySink())
    table = run.to_pandas()
    assert (
        table["objects/plate/position/y"].tolist() == run.objects["plate"].position[:, 1].tolist()
    )
    assert table.attrs["units"]["objects/beam/twist/wz"] == "rad/s"
    assert table.filter(like="environment/beam/contact_force").shape == (len(run), 2)


# Summaries


def test_a_summary_has_the_last_pose_of_every_object():
    run = record_two(MemorySink())
    summary = run.summary()
    assert summary["final_object_position"] is summary["final_object_quaternion_xyzw"] is None
    assert summary["final_poses"] == {
        name: {
            "position": run.objects[name].position[-1].tolist(),
            "quaternion_xyzw": run.objects[name].quaternion_xyzw[-1].tolist(),
        }
        for name in OBJECTS
    }
    assert summary["contact_force_max_N"]["floor/beam"] == 2.0 * run.time[-1]
    assert summary["wrench_max"]["floor/beam"]["force_N"] == 2.0 * run.time[-1]
    alone = record(MemorySink()).summary()
    assert alone["final_poses"] == {
        "object": {
            "position": alone["final_object_position"],
            "quaternion_xyzw": alone["final_object_quaternion_xyzw"],
        }
    }


def test_the_end_of_every_object_is_written(capsys):
    run = record_two(MemorySink())
    rows = motion_facts(figures_of(run))
    assert list(rows)[:2] == ["beam at the end", "plate at the end"]
    assert "on the object" not in rows["largest forces, left"]
    assert "on the object" in motion_facts(figures_of(record(MemorySink())))["largest forces, left"]
    summary_table(run_figures("two", run, {}, False), 0.0)
    page = render(run)
    assert "Orientation of plate at the end" in page and "Beam at the end" in page


def test_a_run_without_samples_has_no_poses():
    summary = record_two(MemorySink(), {k: v[:0] for k, v in samples_of_two().items()}).summary()
    assert summary["final_poses"]["plate"] == {"position": None, "quaternion_xyzw": None}


# Figures


def test_the_figure_of_the_motion_has_all_objects_with_their_names():
    run = record_two(MemorySink())
    figure = plots.object_pose(run)
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.get_visible()]
    assert titles == [
        f"{name}: {what}"
        for name in OBJECTS
        for what in (
            "Position of the centre of mass",
            "Rotation since the start, as a rotation vector",
        )
    ]
    drawn = [[line.get_ydata()[-1] for line in axes.lines] for axes in figure.axes[::2]]
    for values, name in zip(drawn, OBJECTS, strict=True):
        np.testing.assert_allclose(values, run.objects[name].position[-1])
    alone = plots.object_pose(record(MemorySink()))
    assert alone.axes[0].get_title(loc="left") == "Position of the centre of mass"


# Comparisons


def test_errors_are_the_largest_over_the_objects():
    run = record_two(MemorySink())
    other = record_two(MemorySink(), samples_of_two(shift=(0.003, 0.0, -0.004), turn=0.02))
    comparison = compare(run, other)
    differences = {name: d.worst for name, d in comparison.outputs.items() if d.worst}
    assert differences == {
        "plate: object position": pytest.approx(0.005, rel=1e-12),
        "plate: object rotation": pytest.approx(0.02, rel=1e-12),
    }
    assert comparison.worst("position_m") == pytest.approx(0.005, rel=1e-12)
    assert comparison.worst("rotation_rad") == pytest.approx(0.02, rel=1e-12)
    assert comparison.outputs["beam: object position"].worst == 0.0
    moved, turned = pose_differences(object_poses(run), object_poses(other))
    assert (moved, turned) == (pytest.approx(0.005, rel=1e-12), pytest.approx(0.02, rel=1e-12))
    path = {"path": Quantity("object's path", "m", ("object position",))}
    worst = largest_differences(run, other, {}, path)["path"]
    assert worst.arm == "plate" and worst.worst == pytest.approx(0.005, rel=1e-12)


def test_the_object_alone_is_compared_as_before():
    run = record(MemorySink())
    names = list(compare(run, run).outputs)
    assert names[:2] == ["object position", "object rotation"]
    assert object_poses(run).shape == (len(run), 1, 7)


def test_floating_bases_are_compared_as_points_and_turns():
    channels = trajectory_channels({"sat": {"elbow": "rad"}}, {"sat": ["a"]}, bases=["sat"])
    runs = []
    for shift, angle in ((0.0, 0.0), (1.0, 0.3)):
        block = {channel.name: np.zeros((3, *channel.shape)) for channel in channels}
        block["time"] = np.arange(3.0)
        block["object/quaternion_xyzw"][:, 3] = 1.0
        block["arms/sat/base_position"][:] = shift * np.array([0.02, -0.01, 0.02])
        axis = np.array([2.0, -1.0, 2.0]) / 3.0
        turned = [*np.sin(angle / 2) * axis, np.cos(angle / 2)]
        block["arms/sat/base_quaternion_xyzw"][:] = turned
        sink = MemorySink()
        sink.open(channels, {"scene": SCENE})
        sink.append(rows_of(channels, block))
        runs.append(sink.finish("completed", "", {}))
    outputs = compare(*runs).outputs
    assert outputs["sat: base position"].worst == pytest.approx(0.03, rel=1e-12)
    assert outputs["sat: base rotation"].worst == pytest.approx(0.3, rel=1e-12)


# Sweeps


def test_quantities_of_a_sweep_are_the_largest_over_the_objects():
    run = record_two(MemorySink())
    speeds = [np.linalg.norm(run.objects[name].twist[:, :3], axis=1).max() for name in OBJECTS]
    turns = [np.linalg.norm(run.objects[name].twist[:, 3:], axis=1).max() for name in OBJECTS]
    measured, faults = measure(["largest_speed", "largest_turn_rate"], run)
    assert faults == ""
    assert measured == {"largest_speed": max(speeds), "largest_turn_rate": max(turns)}
    assert speeds[0] > speeds[1] > 0.0
    way = run.objects["beam"].position
    assert pose_differences(object_poses(run)[-1], object_poses(run)[0])[0] == pytest.approx(
        np.linalg.norm(way[-1] - way[0])
    )


def test_the_final_error_is_that_of_the_object_that_a_path_leads():
    goal = [0.1, 0.2, 0.3]
    control = {
        "kind": "object_impedance", "object": "plate", "path": [{"time": 1.0, "xyz": goal}],
        "stiffness": {"translation": 100, "rotation": 10},
        "damping": {"translation": 10, "rotation": 1},
    }  # fmt: skip
    scene = parse_scene(
        {
            "objects": {
                "beam": {"shape": {"sphere": 0.1}, "mass": 1.0},
                "plate": {"shape": {"sphere": 0.1}, "mass": 1.0},
            },
            "arms": {"left": {"robot": "textbook_6r", "tip": "tool"}},
            "joints": [{"arm": "left", "object": "plate", "kind": "weld"}],
            "control": control,
        }
    )
    run = record_two(MemorySink()).of(scene)
    run._scene = scene
    numbers, fault = measure(["final_position_error"], run)
    away = np.linalg.norm(run.objects["plate"].position[-1] - goal)
    assert fault == "" and numbers["final_position_error"] == pytest.approx(away, rel=1e-12)
