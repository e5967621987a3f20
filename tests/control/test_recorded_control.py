"""Claims about recorded control, torques and references from a table; and about the harmonic's."""

from __future__ import annotations

import math

import h5py
import numpy as np
import pyarrow
import pytest
from loose_scenes import cart_with_box
from mechanics import ur5_pair
from pyarrow import parquet
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline, PPoly

import multiarm as ma
from multiarm.errors import SceneError, SolverError
from multiarm.scene import dump_scene, load_scene, parse_scene

MASS = 5.0  # of cart and box [kg]
TIMES = np.array([0.0, 0.1, 0.25, 0.5, 0.6, 1.0])
FORCES = np.array([2.0, -3.0, 5.0, 5.0, 0.0, 4.0])


def write_csv(path, columns):
    names, values = list(columns), np.column_stack(list(columns.values()))
    rows = [",".join(map(repr, row)) for row in values.tolist()]
    path.write_text("\n".join([",".join(names), *rows]) + "\n")
    return path


def write_hdf5(path, columns):
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file[name] = values
        file["note"] = "not a column"
    return path


def write_parquet(path, columns):
    parquet.write_table(pyarrow.table(columns), path)
    return path


WRITERS = {".csv": write_csv, ".h5": write_hdf5, ".parquet": write_parquet}


@pytest.fixture
def force_table(tmp_path):
    return write_csv(tmp_path / "force.csv", {"time": TIMES, "cart/slide": FORCES})


def recorded(path, **more):
    return {"kind": "recorded", "file": str(path), **more}


def cart(tmp_path, control, **more):
    return ma.compile_system(parse_scene(cart_with_box(tmp_path, {}, control=control, **more)))


def torques(system, times):
    return np.array(
        [np.concatenate(list(ma.evaluate(system, t).joint_torques.values())) for t in times]
    )


# --- torques -------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("interpolation", ["linear", "cubic", "hold"])
def test_torques_are_interpolated_from_every_format(tmp_path, interpolation, suffix):
    path = WRITERS[suffix](tmp_path / f"force{suffix}", {"time": TIMES, "cart/slide": FORCES})
    system = cart(tmp_path, recorded(path, interpolation=interpolation))
    t = np.sort(np.append(np.linspace(0.0, 0.999, 37), TIMES))
    expected = {
        "linear": np.interp(t, TIMES, FORCES),
        "cubic": CubicSpline(TIMES, FORCES)(t),
        "hold": FORCES[np.searchsorted(TIMES, t, side="right") - 1],
    }
    np.testing.assert_allclose(torques(system, t)[:, 0], expected[interpolation], atol=1e-13)


@pytest.mark.parametrize(("interpolation", "degree"), [("hold", 0), ("linear", 1), ("cubic", 3)])
def test_a_cart_moves_by_the_integrals_of_the_table(tmp_path, force_table, interpolation, degree):
    """Velocity and position are the integrals of polynomials, exactly; steps end at jumps."""
    if degree == 3:
        force = CubicSpline(TIMES, FORCES)
    elif degree == 1:
        force = PPoly(np.array([np.diff(FORCES) / np.diff(TIMES), FORCES[:-1]]), TIMES)
    else:
        force = PPoly(FORCES[None, :-1], TIMES)
    system = cart(tmp_path, recorded(force_table, interpolation=interpolation))
    # steps pass the knots of the spline, where its third derivative jumps
    accuracy, error = (1e-10, 1e-8) if degree == 3 else (1e-6, 1e-11)
    run = ma.simulate(system, 1.0, accuracy=accuracy, certificate=False, output_step=0.05)
    v, x = force.antiderivative(1), force.antiderivative(2)
    np.testing.assert_allclose(run.joint_velocities["cart"][:, 0], v(run.time) / MASS, atol=error)
    np.testing.assert_allclose(run.joint_positions["cart"][:, 0], x(run.time) / MASS, atol=error)
    assert degree == 3 or run.statistics["rejected_steps"] == 0
    assert (
        set(system.model.breakpoints)
        == {
            "hold": {0.0, 0.1, 0.25, 0.6, 1.0},  # at 0.5 s the force stays what it was
            "linear": set(TIMES),
            "cubic": {0.0, 1.0},
        }[interpolation]
    )


def test_a_recorded_harmonic_is_the_harmonic(tmp_path):
    """The spline through 1 kHz of samples; columns may have any names, and other ones are left."""
    amplitude = {"left": [1, 2, 3, 4, 5, 6], "right": 0.5}
    wave = {"kind": "harmonic", "frequency": 3.0, "amplitude": amplitude, "hold": False}
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"}, control=wave)
    system = ma.compile_system(scene)
    t = np.arange(0.0, 0.2005, 1e-3)
    names = [f"{a}/{j}" for a, arm in system.arms.items() for j in arm.joint_names]
    columns = {f"tau {k}": own for k, own in enumerate(torques(system, t).T)}
    asked = {"duration": 0.2, "accuracy": 1e-8, "certificate": False}

    table = {"clock": t, **columns, "temperature": np.full(len(t), 21.5)}
    path = write_csv(tmp_path / "wave.csv", table)
    mapped = {joint: f"tau {k}" for k, joint in enumerate(names)}
    control = recorded(path, columns=mapped, time="clock", interpolation="cubic")
    found = ma.compile_system(scene.replace(control=control), like=system)
    run, expected = ma.simulate(found, **asked), ma.simulate(system, **asked)
    np.testing.assert_allclose(run.object_position, expected.object_position, atol=1e-9)
    np.testing.assert_allclose(run.object_twist, expected.object_twist, atol=1e-7)
    assert run.statistics["steps"] < 3 * expected.statistics["steps"]


@pytest.mark.slow
def test_ten_seconds_at_a_kilohertz_are_looked_up_and_followed(tmp_path):
    """10,000 rows, at each of which a step ends."""
    t = np.arange(10_001) * 1e-3
    force = np.random.default_rng(5).standard_normal(t.size)
    path = write_hdf5(tmp_path / "noise.h5", {"time": t, "cart/slide": force})
    system = cart(tmp_path, recorded(path, interpolation="hold"))
    assert system.model.breakpoints.size == 10_001
    run = ma.simulate(system, 10.0, accuracy=1e-6, certificate=False, output_step=1.0)
    v = np.concatenate([[0.0], np.cumsum(force[:-1]) * 1e-3]) / MASS
    np.testing.assert_allclose(run.joint_velocities["cart"][:, 0], v[::1000], atol=1e-9)
    assert run.statistics["steps"] < 10_100


# --- references ----------------------------------------------------------------------------------


@pytest.mark.parametrize("interpolation", ["linear", "cubic", "hold"])
def test_a_position_is_what_springs_and_dampers_pull_to(tmp_path, interpolation):
    k, d = 80.0, 12.0
    path = write_csv(tmp_path / "way.csv", {"time": TIMES, "cart/slide": 0.1 * FORCES})
    control = recorded(
        path, quantity="position", stiffness=k, damping=d, interpolation=interpolation
    )
    run = ma.simulate(cart(tmp_path, control), 1.4, accuracy=1e-9, certificate=False)
    way = CubicSpline(TIMES, 0.1 * FORCES)

    def reference(t):
        if t >= 1.0:
            return 0.4, 0.0  # its last row, at rest
        if interpolation == "cubic":
            return way(t), way(t, 1)
        s = int(np.searchsorted(TIMES, t, side="right")) - 1
        slope = 0.1 * (FORCES[s + 1] - FORCES[s]) / (TIMES[s + 1] - TIMES[s])
        slope *= interpolation == "linear"
        return 0.1 * FORCES[s] + slope * (t - TIMES[s]), slope

    def rate(t, y):
        x, v = reference(t)
        return [y[1], (k * (x - y[0]) + d * (v - y[1])) / MASS]

    y = np.zeros(2)
    for a, b in zip(TIMES, np.append(TIMES[1:], 1.4), strict=True):
        inside = lambda t, y, b=b: rate(min(t, np.nextafter(b, 0.0)), y)  # noqa: E731
        y = solve_ivp(inside, (a, b), y, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    assert run.joint_positions["cart"][-1, 0] == pytest.approx(y[0], abs=1e-8)
    assert run.joint_velocities["cart"][-1, 0] == pytest.approx(y[1], abs=1e-7)
    (notice,) = [e for e in run.events if e["kind"] == "control ends"]
    assert (
        notice["time"] == 1.0 and notice["text"] == "the table way.csv ends and holds its last row"
    )


def test_joints_without_a_column_are_referred_to_the_start_and_weight_is_carried(tmp_path):
    path = write_csv(tmp_path / "q.csv", {"time": [0.0, 1.0], "left/elbow_joint": [1.0, 1.0]})
    control = recorded(path, quantity="position", stiffness=10.0, damping=1.0)
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"})
    system = ma.compile_system(scene.replace(control=control))
    carried = ma.compile_system(scene.replace(control="gravity_compensation"), like=system)
    found = torques(system, [0.5])[0] - torques(carried, [0.5])[0]
    elbow = 10.0 * (1.0 - system.initial_state().joint_positions["left"][2])
    np.testing.assert_allclose(found, elbow * (np.arange(12) == 2), atol=1e-9)


# --- outside the table ---------------------------------------------------------------------------


def test_a_run_longer_than_a_table_of_torques_is_refused_unless_told_what_then(
    tmp_path, force_table
):
    with refused(SolverError, "force.csv"):
        ma.simulate(cart(tmp_path, recorded(force_table)), 1.5)
    shape = {"interpolation": "hold"}
    for outside, last in (("hold", 4.0), ("zero", 0.0)):
        system = cart(tmp_path, recorded(force_table, outside=outside, **shape))
        run = ma.simulate(system, 1.5, accuracy=1e-8, certificate=False, output_step=0.5)
        v = np.sum(FORCES[:-1] * np.diff(TIMES)) + 0.5 * last
        assert run.joint_velocities["cart"][-1, 0] == pytest.approx(v / MASS, abs=1e-10)
        assert [e["time"] for e in run.events if e["kind"] == "control ends"] == [1.0]


def test_a_control_that_has_not_ended_yet_is_no_event(tmp_path, force_table):
    """The user stops the run before the end of the table; a stepper passes it in its third call."""

    def stop(t):
        if t > 0.2:
            raise KeyboardInterrupt

    system = cart(tmp_path, recorded(force_table, outside="zero"))
    run = ma.simulate(system, 1.5, integrator="rk4", step=1e-5, progress=stop)
    assert run.status == "interrupted" and run.time[-1] < 1.0
    assert "control ends" not in [e["kind"] for e in run.events]
    stepper, times = ma.Stepper(system, accuracy=1e-6), []
    for _ in range(4):
        stepper.advance(0.5)
        times.append([e["time"] for e in stepper.events if e["kind"] == "control ends"])
    assert times == [[], [], [1.0], [1.0]]


def test_a_table_that_begins_late_is_held_or_zero_before(tmp_path):
    path = write_csv(tmp_path / "late.csv", {"time": [0.2, 0.4], "cart/slide": [3.0, 5.0]})
    with refused(SolverError, "late.csv"):
        ma.simulate(cart(tmp_path, recorded(path)), 0.3)
    for outside, first in (("hold", 3.0), ("zero", 0.0)):
        system = cart(tmp_path, recorded(path, outside=outside))
        np.testing.assert_allclose(torques(system, [0.0, 0.1999, 0.3])[:, 0], [first, first, 4.0])


def test_a_stepper_ends_where_the_table_ends(tmp_path, force_table):
    stepper = ma.Stepper(cart(tmp_path, recorded(force_table)))
    stepper.advance(1.0)
    with refused(SolverError, "force.csv"):
        stepper.advance(1e-3)
    assert stepper.time == 1.0
    stepper.advance(1e-3, {})  # given torques need no table


# --- samples, storage ----------------------------------------------------------------------------


def test_a_table_can_be_sampled(tmp_path, force_table):
    system = cart(tmp_path, recorded(force_table, sample_time=0.2))
    run = ma.simulate(system, 1.0, certificate=False, output_step=0.2)
    v = np.cumsum([0.0, *(0.2 * np.interp(0.2 * np.arange(5), TIMES, FORCES))]) / MASS
    np.testing.assert_allclose(run.joint_velocities["cart"][:, 0], v, atol=1e-11)


def test_a_stored_run_needs_no_table_to_be_shown(tmp_path, force_table):
    system = cart(tmp_path, recorded(force_table))
    run = ma.simulate(system, 0.5, certificate=False, out=tmp_path / "run.h5")
    expected = run.joint_torques["cart"].copy()
    run.close()
    force_table.unlink()
    loaded = ma.load_trajectory(tmp_path / "run.h5")
    assert loaded.scene.control.file == force_table
    np.testing.assert_array_equal(loaded.joint_torques["cart"], expected)
    assert ma.replay(loaded, tmp_path / "run.html", open_browser=False, meshes=False) is not None
    assert (tmp_path / "run.html").stat().st_size > 10_000
    with refused(SceneError, "$.control.file"):
        ma.compile_system(loaded.scene)


def test_the_file_is_found_from_the_scene_and_a_dumped_scene_names_it_in_full(
    tmp_path, force_table
):
    scene = parse_scene(cart_with_box(tmp_path, {}, control=recorded("force.csv")), tmp_path)
    assert scene.control.file == force_table
    (tmp_path / "elsewhere").mkdir()
    copy = tmp_path / "elsewhere" / "scene.yaml"
    copy.write_text(dump_scene(scene))
    assert load_scene(copy).control == scene.control
    ma.compile_system(load_scene(copy))


# --- faults --------------------------------------------------------------------------------------

GOOD = "time,cart/slide\n0,1\n1,2\n"


@pytest.mark.parametrize(
    "text",
    [
        None,
        "",
        "cart/slide\n1\n",
        "time\n0\n1\n",
        "time,cart/slid\n0,1\n1,2\n",
        "time,a,a\n0,1,2\n",
        "time,cart/slide\n0,1\n\n1\n",
        "time,cart/slide\n0,1\n1,nan\n",
        "time,cart/slide\n0,1\n1,x\n",
        "time,cart/slide\n0,1\n,2\n",
        "time,cart/slide\n0,1\n1,2\n1,3\n",
        "time,cart/slide\n0,1\n2,2\n1,3\n",
        "time,cart/slide\n0,1\n",
    ],
)
def test_faults_of_a_table_name_file_column_and_row(tmp_path, text):
    path = tmp_path / "t.csv"
    if text is not None:
        path.write_text(text)
    with refused(SceneError, "$.control.file: ", "t.csv"):
        cart(tmp_path, recorded(path))


def test_faults_of_other_files(tmp_path):
    def fault(path, **more):
        with pytest.raises(SceneError) as caught:
            cart(tmp_path, recorded(path, **more))
        return str(caught.value)

    (tmp_path / "t.txt").write_text(GOOD)
    assert "a table is a file '.csv', '.parquet', '.h5', '.hdf5', not .txt" in fault(
        tmp_path / "t.txt"
    )
    (tmp_path / "t.h5").write_text(GOOD)
    assert "t.h5 is not an HDF5 file" in fault(tmp_path / "t.h5")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00")
    assert "is not a text file of comma-separated values" in fault(tmp_path / "b.csv")
    gap = write_hdf5(tmp_path / "gap.h5", {"time": [0.0, 1.0], "cart/slide": [1.0, math.nan]})
    assert "column 'cart/slide', row 2: must be a finite number" in fault(gap)
    short = write_hdf5(tmp_path / "s.h5", {"time": [0.0, 1.0], "cart/slide": [1.0]})
    assert "column 'cart/slide' has 1 row, 'time' has 2" in fault(short)
    (tmp_path / "good.csv").write_text(GOOD)
    assert "$.control.columns['cart/slide']" in fault(
        tmp_path / "good.csv", columns={"cart/slide": "tau"}
    )
    (tmp_path / "t.parquet").write_text(GOOD)
    assert "is not a Parquet file" in fault(tmp_path / "t.parquet")
    pairs = {"time": [0.0, 1.0], "cart/slide": [[1.0, 2.0], [3.0, 4.0]]}
    write_parquet(tmp_path / "pairs.parquet", pairs)
    words = "column 'cart/slide', row 1: must be a finite number, got [1.0, 2.0]"
    assert words in fault(tmp_path / "pairs.parquet")


@pytest.mark.parametrize(
    "more",
    [
        {"stiffness": 1.0},
        {"quantity": "position", "stiffness": 1.0},
        {"quantity": "position", "stiffness": 1.0, "damping": 1.0, "outside": "zero"},
        {"columns": {}},
        {"columns": {"slide": "a"}},
        {"columns": {"wagon/slide": "a"}},
        {"columns": {"cart/slid": "a"}},
        {"interpolation": "spline"},
        {"quantity": "position", "stiffness": {"wagon": 1}, "damping": 1.0},
    ],
)
def test_faults_of_the_keys(tmp_path, force_table, more):
    with refused(SceneError, "$.control"):
        cart(tmp_path, recorded(force_table, **more))


# --- harmonic ------------------------------------------------------------------------------------


@pytest.mark.parametrize("hold", [False, True])
def test_an_offset_is_added_to_harmonic_torques(hold):
    wave = {"kind": "harmonic", "frequency": 3.0, "amplitude": {"left": 2.0}, "hold": hold}
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"}, control=wave)
    plain = ma.compile_system(scene)
    offset = {"left": {"elbow_joint": 1.5}, "right": [1, 2, 3, 4, 5, 6]}
    shifted = ma.compile_system(scene.replace(control={**wave, "offset": offset}), like=plain)
    expected = [0, 0, 1.5, 0, 0, 0, 1, 2, 3, 4, 5, 6]
    for t in (0.0, 0.21):
        difference = torques(shifted, [t])[0] - torques(plain, [t])[0]
        np.testing.assert_allclose(difference, expected, atol=1e-12)
    with refused(SceneError, "control.offset.middle"):
        scene.replace(control={**wave, "offset": {"middle": 1.0}})
