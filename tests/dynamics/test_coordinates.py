"""The configuration manifold and the integrator's chart, for several floating frames."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multiarm.dynamics.coordinates import (
    chart_places,
    difference,
    equation_columns,
    floating_bases,
    load_chart,
    read_chart,
    retract,
    write_chart_slope,
    write_new_chart,
)
from multiarm.dynamics.layout import STATE, Layout
from multiarm.dynamics.state import State
from multiarm.dynamics.variables import stacked_vectors
from multiarm.errors import ModelError

LAYOUTS = [
    Layout(("arm",), (0, 3), (0, 3), ("arm",), (0, 2), (0,)),
    Layout(
        ("left", "right"),
        (0, 3, 5),
        (0, 3, 5),
        ("left", "right"),
        (0, 2, 4),
        (0, 1),
        ("a", "b", "c"),
    ),
    Layout((), (0,), (0,), (), (0,), (), ("a", "b")),
    Layout(
        ("fixed", "a", "b"),
        (0, 2, 9, 15),
        (0, 2, 9, 15),
        ("a",),
        (0, 1),
        (1,),
        floating_robots=(1, 2),
    ),
]
ROUNDING = 1e-14
layouts = pytest.mark.parametrize(
    "layout",
    LAYOUTS,
    ids=lambda layout: f"{layout.frames} frames, {len(layout.floating_robots)} bases",
)


def random_configuration(layout, rng):
    q = rng.normal(size=layout.nq)
    for pose in every_pose(layout, q):
        pose[3:] = Rotation.random(random_state=rng).as_quat()
    for first in layout.first_of_bases:
        layout.joint_positions(q)[first : first + 6] = 0.0
    return q


def every_pose(layout, q):
    """Of the frames and the bases."""
    return [*layout.poses(q), *layout.base_poses(q)]


def every_twist(layout, v):
    return [*layout.twists(v), *layout.base_twists(v)]


def random_data(layout, rng, states=2, works=3):
    state, forces, accelerations = stacked_vectors(layout)
    for vector in (state.velocity, accelerations.a, forces.f):
        vector[:] = rng.normal(size=layout.nv)
    state.configuration[:] = random_configuration(layout, rng)
    sizes = {"states": states, "state_rates": states, "power": works}
    effects = SimpleNamespace(**{name: rng.normal(size=n) for name, n in sizes.items()})
    return SimpleNamespace(state=state, forces=forces, accelerations=accelerations, effects=effects)


@layouts
def test_retraction_turns_each_frame_by_the_exponential_and_shifts_all_else(layout):
    rng = np.random.default_rng(1)
    start, u = random_configuration(layout, rng), rng.normal(size=layout.nv)
    end = retract(layout, start, u)
    poses = every_pose(layout, start), every_pose(layout, end)
    for before, after, twist in zip(*poses, every_twist(layout, u), strict=True):
        expected = Rotation.from_rotvec(twist[3:]) * Rotation.from_quat(before[3:])
        assert np.allclose(after[:3], before[:3] + twist[:3], atol=ROUNDING)
        turned = Rotation.from_quat(after[3:]) * expected.inv()
        assert turned.magnitude() < ROUNDING
    for twist in layout.base_twists(u):
        twist[:] = 0.0  # the numbers of a base stay: its pose moves
    joints = layout.joint_positions(start) + layout.joint_rates(u)
    assert np.allclose(layout.joint_positions(end), joints, atol=ROUNDING)


@layouts
def test_difference_is_the_inverse_of_retraction(layout):
    rng = np.random.default_rng(2)
    start, u = random_configuration(layout, rng), rng.uniform(-1.5, 1.5, size=layout.nv)
    assert np.allclose(difference(layout, start, retract(layout, start, u)), u, atol=ROUNDING)


def test_displacements_of_another_length_or_system_are_refused(rng):
    first, second = (
        State(random_configuration(layout, rng), np.zeros(layout.nv), layout)
        for layout in LAYOUTS[:2]
    )
    for size in (5, 12):
        with pytest.raises(ModelError, match=r"displacement: expected shape \(9,\)"):
            first.displaced(np.zeros(size))
    with pytest.raises(ModelError, match="belongs to a system with arms left, right"):
        first.displacement_to(second)


@layouts
def test_parts_are_views_of_the_stacked_vectors(layout):
    q, v = np.arange(layout.nq, dtype=float), np.arange(layout.nv, dtype=float)
    layout.poses(q)[...] = layout.base_poses(q)[...] = -1.0
    layout.twists(v)[...] = -1.0
    poses = 7 * (layout.frames + len(layout.floating_robots))
    assert np.all(q[:poses] == -1.0) and np.all(v[: 6 * layout.frames] == -1.0)
    assert np.array_equal(layout.joint_positions(q), np.arange(poses, layout.nq))
    for i in range(len(layout.names)):
        first, last = layout.first_joint[i : i + 2]
        assert np.array_equal(v[layout.of_robot(i)], layout.joint_rates(v)[first:last])


@layouts
def test_columns_of_the_state_have_every_displacement_and_velocity_once(layout):
    columns = layout.columns
    assert list(columns) == list(STATE)
    both = np.concatenate([layout.displacement_columns, layout.velocity_columns])
    assert np.array_equal(np.sort(both), np.arange(2 * layout.nv))
    of_kernels = equation_columns(random_data(layout, np.random.default_rng(3)))
    forces = [2 * layout.nv, 2 * layout.nv + layout.rate_count, 3 * layout.nv]
    assert list(of_kernels) == [*[columns[name].start for name in STATE[1:]], *forces]


@layouts
def test_a_chart_begins_at_the_state_and_leads_back_to_it(layout):
    rng = np.random.default_rng(4)
    data, other = random_data(layout, rng), random_data(layout, rng)
    z = rng.normal(size=chart_places(data).works + data.effects.power.size)
    works, base = z[chart_places(data).works :].copy(), np.zeros(layout.nq)
    write_new_chart.py_func(data, base, z)
    load_chart.py_func(z, base, other)
    assert np.allclose(other.state.configuration, data.state.configuration, atol=ROUNDING)
    assert np.array_equal(other.state.velocity, data.state.velocity)
    assert np.array_equal(other.effects.states, data.effects.states)
    assert np.array_equal(z[chart_places(data).works :], works)


@layouts
def test_the_slope_is_the_derivative_of_the_chart_along_the_motion(layout):
    """A motion with constant twists passes through the chart's state; differences of order two."""
    rng, h = np.random.default_rng(5), 1e-5
    data = random_data(layout, rng)
    places = chart_places(data)
    z = 0.4 * rng.normal(size=places.works + data.effects.power.size)
    base = np.zeros(layout.nq)
    for pose in every_pose(layout, base):
        pose[3:] = Rotation.random(random_state=rng).as_quat()
    load_chart.py_func(z, base, data)
    slope = np.zeros_like(z)
    write_chart_slope.py_func(z, data, slope)

    def positions(t):
        q = retract(layout, data.state.configuration, t * data.state.velocity)
        origin = np.zeros(layout.nq)
        read_chart(layout.frames, floating_bases(layout), np.zeros_like(z), base, origin)
        return difference(layout, origin, q)

    numeric = (positions(h) - positions(-h)) / (2.0 * h)
    assert np.allclose(slope[: layout.nv], numeric, atol=1e-8)
    assert np.array_equal(slope[places.velocity : places.states], data.accelerations.a)
    assert np.array_equal(slope[places.states : places.works], data.effects.state_rates)
    assert np.array_equal(slope[places.works :], data.effects.power)
