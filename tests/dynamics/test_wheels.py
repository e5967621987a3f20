"""Claims about bases on wheels: they drive and turn, and do not slip sideways.

The oracles are the dynamics of a unicycle with its centre of mass ahead of the wheels, closed forms
of forces, and finite differences.
"""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import scene_of
from scipy.integrate import solve_ivp

import multiarm as ma
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.status import OK
from multiarm.errors import ModelError, SceneError, SolverError
from multiarm.integration.projection import project

CHASSIS = """<robot name='chassis'><link name='base'/><link name='plate'/>
<joint name='mount' type='fixed'><parent link='base'/><child link='plate'/></joint></robot>"""
BASE_MASS, BASE_INERTIA = 12.0, 0.8  # [kg, kg m^2]
LOAD_MASS, LOAD_INERTIA = 5.0, 0.3  # about its centre of mass
MASS = BASE_MASS + LOAD_MASS


@pytest.fixture(scope="module")
def chassis(tmp_path_factory):
    path = tmp_path_factory.mktemp("robots") / "chassis.urdf"
    path.write_text(CHASSIS)
    return str(path)


def robot(chassis, **changes):
    base = {
        "moves": "differential",
        "mass": BASE_MASS,
        "inertia": [BASE_INERTIA] * 3,
        **changes.pop("base", {}),
    }
    return {"urdf": chassis, "base": base, "tips": {"plate": "plate"}, **changes}


def cart_with_load(chassis, ahead, start=(0.0, 0.0, 0.0), speed=0.0, spin=0.0, **more):
    """One cart and a load that is welded to it, at a distance ahead of the wheels.

    ``start`` is x, y and yaw on the base's axes, which are turned by 0.7 rad about z.
    """
    yaw, heading = start[2], 0.7 + start[2]
    c, s = np.cos(0.7), np.sin(0.7)
    place = np.array([[c, -s], [s, c]]) @ start[:2]
    forward = np.array([np.cos(heading), np.sin(heading)])
    sideways = np.array([-np.sin(heading), np.cos(heading)])
    cart = robot(
        chassis,
        base={"rpy": [0.0, 0.0, 0.7]},
        posture=list(start),
        velocity=[speed * np.cos(yaw), speed * np.sin(yaw), spin],
    )
    box = {
        "mass": LOAD_MASS,
        "inertia": [0.2, 0.25, LOAD_INERTIA],
        "pose": {"xyz": [*(place + ahead * forward), 0.4], "rpy": [0.0, 0.0, heading]},
        "twist": [*(speed * forward + ahead * spin * sideways), 0.0, 0.0, 0.0, spin],
    }
    at = {"xyz": [-ahead, 0.0, -0.4]}
    joints = [{"arm": "cart/plate", "kind": "weld", "at": at}]
    return scene_of({}, joints, object=box, robots={"cart": cart}, gravity=[0, 0, -9.81], **more)


def lateral(q, v):
    """Velocity of the wheels sideways, of positions and rates (K, 3) of a base."""
    return np.cos(q[:, 2]) * v[:, 1] - np.sin(q[:, 2]) * v[:, 0]


# --- motion --------------------------------------------------------------------------------------


def test_without_forces_a_balanced_cart_drives_a_circle_held_by_its_wheels(chassis):
    speed, spin = 0.8, 0.5
    scene = cart_with_load(chassis, 0.0, speed=speed, spin=spin, run={"duration": 10.0})
    run = ma.simulate(ma.compile_system(scene))
    q, v, t = run.joint_positions["cart"], run.joint_velocities["cart"], run.time
    radius = speed / spin
    circle = [radius * np.sin(spin * t), radius * (1.0 - np.cos(spin * t)), spin * t]
    np.testing.assert_allclose(q, np.transpose(circle), atol=1e-7)
    assert np.max(np.abs(lateral(q, v))) < 1e-12
    np.testing.assert_allclose(run.contact_forces["cart"], MASS * speed * spin, atol=1e-6)


def unicycle(ahead, forces):
    """Rates of x, y, yaw, speed and spin, and the force of the wheels.

    With the centre of mass at ``d`` ahead of the wheels, and ``J`` about these,
    ``m (u' - d w^2) = F`` and ``J w' + m d u w = T``.
    """
    d = LOAD_MASS * ahead / MASS
    J = BASE_INERTIA + LOAD_INERTIA + LOAD_MASS * ahead**2

    def rates(_t, y):
        c, s, u, w = np.cos(y[2]), np.sin(y[2]), y[3], y[4]
        forward = c * forces[0] + s * forces[1]
        return [u * c, u * s, w, forward / MASS + d * w**2, (forces[2] - MASS * d * u * w) / J]

    def wheels(y):
        c, s, u, w = np.cos(y[2]), np.sin(y[2]), y[3], y[4]
        turning = rates(0.0, y)[4]
        return MASS * (d * turning + u * w) - (c * forces[1] - s * forces[0])

    return rates, wheels


@pytest.mark.parametrize("integrator", [None, "rodas5p"])
def test_a_driven_cart_moves_as_a_unicycle(chassis, integrator):
    forces, start, speed, spin, ahead = [4.0, -2.5, 1.5], (0.3, -0.2, 0.4), 0.6, -0.7, 0.5
    run = {"duration": 10.0}
    if integrator is not None:
        run |= {"integrator": integrator, "tolerance": 1e-9}
    scene = cart_with_load(
        chassis, ahead, start, speed, spin, run=run,
        control={"kind": "constant", "torques": {"cart": forces}},
    )  # fmt: skip
    result = ma.simulate(ma.compile_system(scene))
    q, v = result.joint_positions["cart"], result.joint_velocities["cart"]
    rates, wheels = unicycle(ahead, forces)
    path = solve_ivp(
        rates, (0.0, 10.0), [*start, speed, spin], "DOP853", result.time, rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(q, path.y[:3].T, atol=1e-5)
    assert np.max(np.abs(lateral(q, v))) < 1e-12
    expected = [wheels(y) for y in path.y.T]
    np.testing.assert_allclose(
        result.contact_forces["cart"][:, 0], expected, atol=1e-5 * np.max(np.abs(expected))
    )
    # the work of the constant forces is the change of the kinetic energy
    work = (q - q[0]) @ forces
    u, w = np.hypot(v[:, 0], v[:, 1]), v[:, 2]
    J = BASE_INERTIA + LOAD_INERTIA + LOAD_MASS * ahead**2
    energy = 0.5 * MASS * u**2 + 0.5 * J * w**2
    np.testing.assert_allclose(energy - energy[0], work, atol=1e-6 * np.max(energy))


@pytest.mark.parametrize("integrator", ["variational", "rk4", "semi_implicit_euler"])
def test_integrators_with_fixed_steps_keep_the_wheels(chassis, integrator):
    """They converge to the circle, and the end of each step is without slip."""
    speed, spin = 0.8, 0.5
    run = {"duration": 1.0, "integrator": integrator, "step": 0.01}
    scene = cart_with_load(chassis, 0.0, speed=speed, spin=spin, run=run)
    result = ma.simulate(ma.compile_system(scene))
    q, v = result.joint_positions["cart"], result.joint_velocities["cart"]
    radius = speed / spin
    circle = [radius * np.sin(spin), radius * (1.0 - np.cos(spin)), spin]
    np.testing.assert_allclose(q[-1], circle, atol=0.01)
    assert np.max(np.abs(lateral(q, v))) < 1e-12


# --- starts --------------------------------------------------------------------------------------


def test_a_start_that_slips_loses_its_sideways_velocity_and_says_so(chassis):
    """A balanced cart keeps its forward velocity and its spin."""
    scene = cart_with_load(chassis, 0.0, (0.0, 0.0, 0.3), speed=0.8, spin=0.5)
    slip = 0.25
    system = ma.compile_system(scene)
    on_base = np.array([-np.sin(0.3), np.cos(0.3)])
    heading = 0.7 + 0.3
    projected = ma.compile_system(scene_with_slip(scene, slip, on_base, heading))
    np.testing.assert_allclose(
        projected.initial_state().velocity, system.initial_state().velocity, atol=1e-12
    )
    report = projected.start_report
    assert report.gap_rates["cart"] == pytest.approx(slip)
    assert report.energy_lost == pytest.approx(0.5 * MASS * slip**2)
    assert report.gaps["cart"] == 0.0


def scene_with_slip(scene, slip, on_base, heading):
    """The scene whose cart and load have a sideways velocity besides."""
    velocity = np.array(scene.robots["cart"].velocity) + slip * np.array([*on_base, 0.0])
    twist = np.array(scene.object.twist)
    twist[:2] += slip * np.array([-np.sin(heading), np.cos(heading)])
    return scene.replace(
        {"robots.cart.velocity": velocity.tolist(), "object.twist": twist.tolist()}
    )


# --- two carts -----------------------------------------------------------------------------------


def two_carts(chassis, first, second, torques=None):
    """Two carts that head along x and hold one plate, whose centre is between them."""
    robots = {
        name: robot(chassis, base={"xyz": [*place, 0.0]}, posture=[0.0, 0.0, 0.0])
        for name, place in (("first", first), ("second", second))
    }
    joints = [
        {"arm": f"{name}/plate", "kind": "weld", "at": {"xyz": [*place, -0.4]}}
        for name, place in (("first", first), ("second", second))
    ]
    box = {"mass": 4.0, "inertia": [0.2, 0.2, 0.3], "pose": {"xyz": [0.0, 0.0, 0.4]}}
    more = {} if torques is None else {"control": {"kind": "constant", "torques": torques}}
    return ma.compile_system(scene_of({}, joints, object=box, robots=robots, **more))


def test_two_carts_one_behind_the_other_cannot_turn_a_plate(chassis):
    """The wheels resist the drives that turn; nothing yields, and the other motion is free."""
    torque, force = 1.5, 3.0
    system = two_carts(
        chassis, (0.5, 0.0), (-0.5, 0.0),
        {name: [force, 0.0, torque] for name in ("first", "second")},
    )  # fmt: skip
    ev = ma.evaluate(system)
    # twelve velocities: nine rows of the welds hold the carts on the plate, two are of wheels
    assert ev.rank == 11
    a = 2.0 * force / (2.0 * BASE_MASS + 4.0)
    np.testing.assert_allclose(ev.object_acceleration, [a, 0, 0, 0, 0, 0], atol=1e-12)
    forces = [ev.contact_forces[name][0] for name in ("first", "second")]
    np.testing.assert_allclose(forces, [-2.0 * torque, 2.0 * torque], atol=1e-10)
    assert all(ev.contact_forces_unique[name].all() for name in ("first", "second"))


def test_wheels_on_one_axle_share_a_row(chassis):
    """Carts side by side turn the plate; of their wheels' forces only the sum is determined."""
    torque = 1.5
    drives = {name: [0.0, 0.0, torque] for name in ("first", "second")}
    ev = ma.evaluate(two_carts(chassis, (0.0, 0.5), (0.0, -0.5), drives))
    assert ev.rank == 10
    J = 0.3 + 2.0 * (BASE_INERTIA + 0.25 * BASE_MASS)
    np.testing.assert_allclose(ev.object_acceleration[5], 2.0 * torque / J, rtol=1e-10)
    assert not any(ev.contact_forces_unique[name].any() for name in ("first", "second"))
    forces = [ev.contact_forces[name][0] for name in ("first", "second")]
    np.testing.assert_allclose(forces, 0.0, atol=1e-10)


def test_gaps_are_closed_sideways_where_wheels_cannot_drive(chassis):
    """Positions may move sideways: two carts side by side are a gap apart, along their axle."""
    system = two_carts(chassis, (0.0, 0.5), (0.0, -0.5))
    state = system.initial_state()
    displacement = np.zeros(state.layout.nv)
    displacement[7], displacement[10] = 1e-4, -2e-4  # base_y of both
    with system.borrow() as data:
        data.set_state(0.0, state.displaced(displacement))
        assert project(data.struct, 1e-13) == OK
        assert update_kinematics(data.struct) == OK
        assert np.max(np.abs(data.contact_rows.gap)) < 1e-13


# --- inverse dynamics ----------------------------------------------------------------------------


def test_drives_of_a_motion_that_wheels_allow_are_those_of_a_unicycle(chassis):
    """They do what wheels would: along the base's y axis, ``m (d w' + u w)``."""
    ahead, yaw, u, w = 0.5, 0.4, 0.6, -0.7
    system = ma.compile_system(cart_with_load(chassis, ahead, (0.3, -0.2, yaw), u, w))
    state, slowing, turning = system.initial_state(), -0.9, 1.3
    on_base = np.array([slowing - ahead * w**2, ahead * turning + u * w])
    heading = 0.7 + yaw
    desired = np.array([*(rotation(heading) @ on_base), 0, 0, 0, turning])
    inverse = ma.inverse_dynamics(system, state, desired)
    d, J = LOAD_MASS * ahead / MASS, BASE_INERTIA + LOAD_INERTIA + LOAD_MASS * ahead**2
    forces = rotation(yaw) @ [MASS * (slowing - d * w**2), MASS * (d * turning + u * w)]
    torque = J * turning + MASS * d * u * w
    np.testing.assert_allclose(inverse.torques["cart"], [*forces, torque], rtol=1e-10)
    slipping = desired + [*(rotation(heading) @ [0.0, 0.1]), 0, 0, 0, 0]
    with pytest.raises(SolverError, match="'cart'"):
        ma.inverse_dynamics(system, state, slipping)


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


# --- derivatives ---------------------------------------------------------------------------------


def test_derivatives_are_those_of_differences(chassis):
    """Of a cart that drives, turns and is driven, by all positions, rates and torques."""
    scene = cart_with_load(
        chassis, 0.5, (0.3, -0.2, 0.4), 0.6, -0.7,
        control={"kind": "constant", "torques": {"cart": [4.0, -2.5, 1.5]}},
    )  # fmt: skip
    system = ma.compile_system(scene)
    D, start = ma.derivatives(system), system.initial_state()
    n, h = start.layout.nv, 1e-5

    def results(by_position, by_velocity):
        state = start.displaced(by_position)
        state.velocity[:] += by_velocity
        ev = ma.evaluate(system, 0.0, state)
        return np.concatenate([ev.accelerations, *ev.contact_forces.values()])

    # errors h^2 of third derivatives, roundings of forces of some hundred newtons over h
    for columns, pick in (
        (D.layout.displacement_columns, lambda x: (x, np.zeros(n))),
        (D.layout.velocity_columns, lambda x: (np.zeros(n), x)),
    ):
        differences = [
            (results(*pick(h * e)) - results(*pick(-h * e))) / (2.0 * h) for e in np.eye(n)
        ]
        np.testing.assert_allclose(
            D.matrix[: len(differences[0]), columns], np.transpose(differences), atol=2e-6
        )


# --- events --------------------------------------------------------------------------------------


def test_wheels_stay_in_runs_with_stops(chassis):
    """A cart that meets the end of its range of yaw goes on straight, without slip."""
    scene = cart_with_load(chassis, 0.0, speed=0.8, spin=0.5, run={"duration": 2.0}).replace(
        {
            "robots.cart.base.limits": {"yaw": [-1.0, 0.6]},
            "effects": {"joint_limits": {"range": "urdf"}},
        }
    )
    run = ma.simulate(ma.compile_system(scene))
    q, v = run.joint_positions["cart"], run.joint_velocities["cart"]
    assert np.max(np.abs(lateral(q, v))) < 1e-12
    radius, stop = 0.8 / 0.5, 0.6 / 0.5
    left = 0.8 * (2.0 - stop)
    end = [
        radius * np.sin(0.6) + left * np.cos(0.6),
        radius * (1 - np.cos(0.6)) + left * np.sin(0.6),
    ]
    np.testing.assert_allclose(q[-1], [*end, 0.6], atol=1e-6)


# --- scenes --------------------------------------------------------------------------------------


def test_motions_of_a_base_on_wheels_are_said_to_be_its_joints(chassis):
    system = ma.compile_system(cart_with_load(chassis, 0.4))
    with pytest.raises(ModelError, match="'joint_positions'"):
        system.state(bases={"cart": {"position": [0, 0, 0]}})


def test_only_x_y_and_yaw_of_wheels_have_limits_and_drives(chassis):
    for key in ({"limits": {"z": [0, 1]}}, {"effort": {"z": 3.0}}):
        scene = {"cart": robot(chassis, base=key)}
        with pytest.raises(SceneError, match="'z'"):
            scene_of({}, [{"arm": "cart/plate", "kind": "weld", "at": {}}], robots=scene)
