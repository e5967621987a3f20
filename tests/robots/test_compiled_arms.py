"""Claims about compiled arms: their terms are those of mechanics, and of Pinocchio's model."""

from __future__ import annotations

import ctypes
import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from compiled_robots import GRAVITY, Compiled, arm_of, largest_difference, random_base
from hypothesis import given, settings
from hypothesis import strategies as st
from mechanics import PANDA_FINGERS, chain_urdf
from random_structures import link_frames, random_structure, random_tree
from refusals import refused

from multiarm.contacts.motion import BodyMotion
from multiarm.errors import ModelError
from multiarm.jit.rows import fields_of, offset_of
from multiarm.robots.chain import JOINT_WIDTH, ChainJoint
from multiarm.robots.compiled import backend as compiled_backend
from multiarm.robots.compiled.backend import CompiledBackend, compile_robots
from multiarm.robots.compiled.kernels import FAR, write_sines
from multiarm.robots.compiled.packing import make_tables
from multiarm.robots.compiled.reference import pinocchio_terms
from multiarm.robots.compiled.tables import MOST_JOINTS
from multiarm.robots.robot import Robot
from multiarm.robots.terms import LinkTerms, TreeStructure
from multiarm.scene import available_robots, find_robot, read_urdf

EPS = np.finfo(float).eps


# --- arms ----------------------------------------------------------------------------------------


def compiled(structures, gravity=GRAVITY):
    """Compiled arms in one system, their positions and velocities, and where each arm's are."""
    links = [(k, arm.masses.size) for k, arm in enumerate(structures)]
    system = Compiled(structures, links, gravity)
    return system.backend, system.angles, system.rates, system.parts


FIXED = np.zeros((1, 7))
"""In place of the poses of a floating base."""

# --- against Pinocchio ---------------------------------------------------------------------------


def usable_robots() -> list[tuple[str, str, int]]:
    """Robots of the installed data, the link behind most joints that make an arm, their number."""
    found = []
    for name in available_robots():
        outline = read_urdf(find_robot(name).urdf)
        if {joint.name for joint in outline.joints} & set(outline.links):
            continue  # Pinocchio cannot place a model in which a joint is named like a link
        best = (0, "")
        for link in outline.links:
            kinds = [joint.kind for joint in outline.chain(link) if joint.kind != "fixed"]
            usable = all(kind in ("revolute", "continuous", "prismatic") for kind in kinds)
            if usable and len(kinds) <= MOST_JOINTS:
                best = max(best, (len(kinds), link))
        if best[0]:
            found.append((name, best[1], best[0]))
    return found


ROBOTS = usable_robots()


def test_most_robots_are_usable():
    assert len(ROBOTS) >= 15 and {"ur5", "panda", "kinova"} <= {name for name, _, _ in ROBOTS}


@pytest.mark.parametrize(("robot", "tip", "joints"), ROBOTS, ids=[name for name, _, _ in ROBOTS])
def test_terms_are_pinocchios(robot, tip, joints, rng):
    urdf = find_robot(robot).urdf
    chain = {joint.name for joint in read_urdf(urdf).chain(tip)}
    model = pin.buildModelFromUrdf(str(urdf))
    beside = {n: 0.0 for n in list(model.names)[1:] if n not in chain}
    arm = arm_of(urdf, tip, random_base(rng), beside, rng.uniform(0, 2, joints))
    assert arm.dof == joints
    copies, angles, rates, (own,) = compiled([arm.structure()])
    for _ in range(3):
        angles[:], rates[:] = rng.uniform(-3, 3, joints), rng.uniform(-3, 3, joints)
        copies.update(with_coriolis=True)
        (expected,) = pinocchio_terms(
            arm, [joints], angles[None, own], rates[None, own], FIXED, GRAVITY
        )
        worst = largest_difference(copies.terms(0), expected)
        assert max(worst.values()) < 1e-13, worst


@pytest.mark.slow
@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), away=st.sampled_from([0.0, 1.0, 2000.0]))
def test_terms_of_random_chains_side_by_side_are_pinocchios(tmp_path_factory, seed, away):
    """One to nine arms of 1 to 16 joints at once, in blocks that are full or not."""
    rng = np.random.default_rng(seed)
    folder, arms = tmp_path_factory.mktemp("chains"), []
    for k in range(rng.integers(1, 10)):
        joints = int(rng.integers(1, 17))
        (folder / f"{k}.urdf").write_text(random_tree(rng, chain(joints)))
        arms.append(arm_of(folder / f"{k}.urdf", "tip", random_base(rng, away)))
    gravity = rng.uniform(-10, 10, 3)
    copies, angles, rates, own = compiled([arm.structure() for arm in arms], gravity)
    slides = np.concatenate([arm.structure().slides for arm in arms])
    far = ~slides & (rng.random(slides.size) < 0.2)
    angles[:] = rng.uniform(-3, 3, slides.size) * np.where(far, 10.0 ** rng.uniform(0, 7), 1.0)
    rates[:] = rng.uniform(-3, 3, slides.size)
    copies.update(with_coriolis=True)
    for k, (arm, part) in enumerate(zip(arms, own, strict=True)):
        (expected,) = pinocchio_terms(
            arm, [arm.dof], angles[None, part], rates[None, part], FIXED, gravity
        )
        worst = largest_difference(copies.terms(k), expected)
        assert max(worst.values()) < 1e-11, (arm, worst)


# --- against mechanics ---------------------------------------------------------------------------


def chain(joints: int) -> tuple[int, ...]:
    """Parents of the joints of a chain."""
    return tuple(range(-1, joints - 1))


def random_arm(rng, joints: int) -> TreeStructure:
    return random_structure(rng, chain(joints))


def kinetic_energy(arm: TreeStructure, q, v) -> float:
    """From poses a millisecond apart: no Jacobian, no formula of the package."""
    h = 1e-3
    frames = [link_frames(arm, q + t * v) for t in (-2 * h, -h, h, 2 * h)]
    energy = 0.5 * float(arm.armature @ v**2)
    for k, (R, _) in enumerate(link_frames(arm, q)):
        velocity = rate([f[k][1] + f[k][0] @ arm.centres[k] for f in frames], h)
        turning = rate([f[k][0] for f in frames], h) @ R.T
        spin = R.T @ np.array([turning[2, 1], turning[0, 2], turning[1, 0]])
        energy += 0.5 * arm.masses[k] * velocity @ velocity + 0.5 * spin @ arm.inertias[k] @ spin
    return energy


def rate(values, h):
    """Derivative from values at -2 h, -h, h, 2 h."""
    before, near, after, far = values
    return (before - 8 * near + 8 * after - far) / (12 * h)


def potential_energy(arm: TreeStructure, q) -> float:
    frames = link_frames(arm, q)
    places = [p + R @ c for (R, p), c in zip(frames, arm.centres, strict=True)]
    return -float(arm.masses @ (np.array(places) @ GRAVITY))


def gradient(function, x, h=1e-3):
    """Derivatives, correct to the fourth power of the step."""
    steps = h * np.eye(len(x))
    return np.array([rate([function(x + t * e) for t in (-2, -1, 1, 2)], h) for e in steps])


@pytest.mark.parametrize("parents", [*map(chain, (1, 2, 3, 6)), (-1, 0, 0, 2, -1)], ids=str)
def test_terms_are_those_of_lagrange(parents, rng):
    """Kinetic and potential energy of rigid links, differentiated; Pinocchio has no part in it."""
    arms = [random_structure(rng, parents) for _ in range(3)]
    copies, angles, rates, own = compiled(arms)
    angles[:], rates[:] = rng.uniform(-3, 3, angles.size), rng.uniform(-2, 2, rates.size)
    copies.update(with_coriolis=True)
    for k, (arm, part) in enumerate(zip(arms, own, strict=True)):
        q, v, found = angles[part].copy(), rates[part].copy(), copies.terms(k)
        assert 0.5 * v @ found.inertia @ v == pytest.approx(kinetic_energy(arm, q, v), rel=1e-9)
        assert found.energy[0] == pytest.approx(potential_energy(arm, q), abs=1e-12)
        held = gradient(lambda x, arm=arm: potential_energy(arm, x), q)
        np.testing.assert_allclose(found.gravity_torque, held, atol=1e-9)
        R, p = link_frames(arm, q)[-1]
        body = fields_of(BodyMotion, found.bodies[0])
        np.testing.assert_allclose(body.rotation, R, atol=1e-14)
        np.testing.assert_allclose(body.origin, p, atol=1e-14)

        def inertia(x, part=part, k=k):
            angles[part] = x
            copies.update()
            return copies.terms(k).inertia

        change = np.tensordot(v, gradient(inertia, q), 1)
        kinetic = gradient(lambda x, v=v, inertia=inertia: 0.5 * v @ inertia(x) @ v, q)
        angles[part] = q
        scale = np.max(np.abs(found.bias))
        bias = change @ v - kinetic + held
        np.testing.assert_allclose(found.bias, bias, atol=1e-9 * scale)
        np.testing.assert_allclose(found.coriolis + found.coriolis.T, change, atol=1e-9 * scale)
        np.testing.assert_allclose(found.coriolis @ v + held, bias, atol=1e-9 * scale)


def test_motion_of_the_last_link_is_the_derivative_of_its_pose(rng):
    arm = random_arm(rng, 6)
    copies, angles, rates, _ = compiled([arm])
    q, v = rng.uniform(-3, 3, 6), rng.uniform(-2, 2, 6)
    angles[:], rates[:] = q, v
    copies.update()
    body = fields_of(BodyMotion, copies.terms(0).bodies[0])
    h = 1e-3
    times = (-2 * h, -h, h, 2 * h)
    frames = [link_frames(arm, q + t * v)[-1] for t in times]
    turning = rate([frame[0] for frame in frames], h) @ link_frames(arm, q)[-1][0].T
    spin = [turning[2, 1], turning[0, 2], turning[1, 0]]
    np.testing.assert_allclose(body.velocity, rate([frame[1] for frame in frames], h), atol=1e-9)
    np.testing.assert_allclose(body.spin, spin, atol=1e-9)
    twists = []
    for t in times:
        angles[:] = q + t * v
        copies.update()
        moved = fields_of(BodyMotion, copies.terms(0).bodies[0])
        twists.append(np.array([moved.velocity, moved.spin]))
    accelerations = body.acceleration, body.spin_rate
    np.testing.assert_allclose(accelerations, rate(twists, h), atol=1e-8)


def test_an_arm_far_away_loses_no_digits(rng):
    """Two kilometres from the origin: what does not depend on the place is the same."""
    arm = random_arm(rng, 6)
    far = arm._replace(translations=arm.translations.copy())
    far.translations[0] += [2000.0, -1500.0, 300.0]
    copies, angles, rates, (one, two) = compiled([arm, far])
    angles[one] = angles[two] = rng.uniform(-3, 3, 6)
    rates[one] = rates[two] = rng.uniform(-3, 3, 6)
    copies.update(with_coriolis=True)
    here, there = copies.terms(0), copies.terms(1)
    for name in ("inertia", "bias", "gravity_torque", "coriolis"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name), name)
    np.testing.assert_array_equal(there.bodies[0, 12:], here.bodies[0, 12:])
    np.testing.assert_array_equal(there.jacobian[3:], here.jacobian[3:])


def test_an_arm_does_not_depend_on_its_neighbours(rng):
    """Its numbers are the same, bit for bit, alone and beside others of any length."""
    arms = [random_arm(rng, n) for n in (6, 3, 6, 6, 7, 1, 6)]
    copies, angles, rates, own = compiled(arms)
    angles[:], rates[:] = rng.uniform(-3, 3, angles.size), rng.uniform(-3, 3, rates.size)
    copies.update(with_coriolis=True)
    for k, part in enumerate(own):
        alone, q, v, _ = compiled([arms[k]])
        q[:], v[:] = angles[part], rates[part]
        alone.update(with_coriolis=True)
        for name, a, b in zip(LinkTerms._fields, alone.terms(0), copies.terms(k), strict=True):
            np.testing.assert_array_equal(a, b, name)


# --- sines ---------------------------------------------------------------------------------------


def sines(angles):
    """Sine and cosine from the kernel, and how many angles it leaves to others."""
    angles = np.array(angles, dtype=float)
    sine, cosine = np.zeros_like(angles), np.zeros_like(angles)
    far = write_sines(angles, np.ones_like(angles), sine, cosine)
    return sine, cosine, far


@pytest.mark.parametrize("size", [1e-300, 1e-8, 0.1, 1.0, 4.0, 100.0, FAR])
def test_sines_are_the_librarys_but_for_the_last_digit(size, rng):
    quarters = rng.integers(0, max(1, int(size / 1.6)) + 1, 2000) * (math.pi / 2)
    angles = np.concatenate([size * rng.uniform(-1, 1, 5000), quarters, -quarters, [0.0, size]])
    sine, cosine, far = sines(angles)
    assert far == 0
    for found, library in ((sine, math.sin), (cosine, math.cos)):
        exact = np.array([library(angle) for angle in angles])
        assert np.max(np.abs(found - exact) / np.spacing(np.abs(exact))) <= 1.0
        assert np.mean((found != exact)[:5000]) < 0.048


@given(st.floats(-FAR, FAR))
def test_sine_and_cosine_of_any_angle(angle):
    sine, cosine, _ = sines([angle])
    assert abs(sine[0] - math.sin(angle)) <= math.ulp(math.sin(angle))
    assert abs(cosine[0] - math.cos(angle)) <= math.ulp(math.cos(angle))


@pytest.mark.parametrize("angle", [1.01e5, -3e9, 1e300, math.inf, math.nan])
def test_far_angles_are_counted(angle):
    assert sines([0.3, angle, -0.2, angle])[2] == 2


def test_far_angles_are_left_to_the_library(rng):
    arm = random_arm(rng, 3)._replace(slides=np.zeros(3, dtype=bool))
    copies, angles, _, _ = compiled([arm])
    angles[:] = [3e5, -1e12, 0.7]
    copies.update()
    R, p = link_frames(arm, angles)[-1]
    found = copies.terms(0).bodies[0]
    body = fields_of(BodyMotion, found)
    assert max(np.max(np.abs(body.rotation - R)), np.max(np.abs(body.origin - p))) < 1e-3
    angles[:2] = np.arctan2(np.sin(angles[:2]), np.cos(angles[:2]))
    copies.update()
    np.testing.assert_allclose(copies.terms(0).bodies[0], found, atol=1e-15)


def test_a_position_that_is_no_number_spoils_its_arm_only(rng):
    """The arms behind it, long and short ones, are what they were but for the library's sines."""
    copies, angles, rates, own = compiled([random_arm(rng, n) for n in (6, 6, 3)])
    angles[:], rates[:] = rng.uniform(-3, 3, 15), rng.uniform(-3, 3, 15)
    copies.update()
    before = copies.terms(2)
    angles[own[0]] = angles[own[1]] = np.nan
    copies.update()
    for k in (0, 1):
        assert np.any(np.isnan(copies.terms(k).inertia))
    np.testing.assert_allclose(copies.terms(2).bias, before.bias, rtol=1e-12)
    angles[own[1]] = 1.0
    copies.update()
    assert np.all(np.isfinite(copies.terms(1).bias))


# --- which arms are compiled ---------------------------------------------------------------------


@pytest.fixture
def panda():
    return arm_of(find_robot("panda").urdf, "panda_hand_tcp", None, PANDA_FINGERS, name="panda")


def test_an_arm_that_is_compiled_is_the_arm(panda):
    found, reasons = compile_robots({"panda": panda}, GRAVITY, [(0, 7)])
    assert found.places == (0,) and reasons == {}


TURNS, ARMATURE = offset_of(ChainJoint, "turns"), offset_of(ChainJoint, "armature")


def one_constant(column: int, by: float):
    """`make_tables` with one constant of the fourth joint wrong."""

    def make(*arguments):
        tables = make_tables(*arguments)
        constants = tables.constants.reshape(-1, JOINT_WIDTH, 4).copy()
        constants[3, column, 0] += by
        wrong = tables._replace(constants=constants.ravel())
        if column == TURNS:
            wrong = wrong._replace(turns=np.ascontiguousarray(constants[:, column]).ravel())
        return wrong

    return make


@pytest.mark.parametrize("column", range(JOINT_WIDTH))
def test_a_copy_that_is_wrong_is_refused(column, panda, monkeypatch):
    """Whichever of its numbers is off, by a billionth."""
    monkeypatch.setattr(compiled_backend, "make_tables", one_constant(column, 1e-9))
    with refused(ModelError, "'panda'"):
        compile_robots({"panda": panda}, GRAVITY, [(0, 7)])


def test_the_refusal_names_arm_quantity_size_and_remedy(panda, monkeypatch):
    monkeypatch.setattr(compiled_backend, "make_tables", one_constant(ARMATURE, 0.1))
    with pytest.raises(ModelError) as caught:
        compile_robots({"panda": panda}, GRAVITY, [(0, 7)])
    for part in ("arm 'panda'", "the inertia", "e-02 of its largest", "arms: pinocchio"):
        assert part in str(caught.value)


@pytest.mark.parametrize("quantity", LinkTerms._fields)
def test_every_quantity_is_compared(quantity, panda, monkeypatch):
    """A copy whose sweep leaves one number wrong, or none at all, is refused."""
    terms = CompiledBackend.terms

    def spoiled(self, arm):
        found = terms(self, arm)
        values = getattr(found, quantity).copy()
        values.flat[-1] = np.nan
        return found._replace(**{quantity: values})

    found, _ = compile_robots({"panda": panda}, GRAVITY, [(0, 7)])
    monkeypatch.setattr(CompiledBackend, "terms", spoiled)
    with refused(ModelError, compiled_backend._WORDS[quantity]):
        compiled_backend.verify(
            found.tables, found.places, {"panda": panda}, [(0, 7)], LinkTerms._fields
        )


@pytest.mark.parametrize("kinds", ["z", "w", "zzz", "uvw", "Zw", "Z" * 16])
@pytest.mark.parametrize("gravity", [0.0, -9.81])
def test_terms_that_cancel_are_no_reason_to_refuse(kinds, gravity, tmp_path, rng):
    """Where bias, torque, energy or Coriolis forces are nothing but rounding errors.

    The arm moves in a plane through the world's origin, or across it; gravity is across it.
    """
    flat = chain_urdf(kinds).replace("rpy='0.1 0.2 -0.3'", "").replace("0.3' />", "0' />")
    (tmp_path / "chain.urdf").write_text(flat.replace("-0.02 0.15'", "-0.02 0'"))
    for _ in range(5):
        base = random_base(rng)
        base[:3, 3] = 3.0 * base[:3, 0]
        arm = arm_of(tmp_path / "chain.urdf", "tip", base)
        found, _ = compile_robots({"arm": arm}, gravity * base[:3, 2], [(0, arm.dof)])
        assert found.places == (0,)
        compiled_backend.verify(
            found.tables, found.places, {"arm": arm}, [(0, arm.dof)], compiled_backend.CORIOLIS
        )


def test_more_than_sixteen_joints_stay_with_pinocchio_and_say_so(tmp_path, panda):
    (tmp_path / "chain.urdf").write_text(chain_urdf("xyz" * 5 + "xy"))
    long = arm_of(tmp_path / "chain.urdf", "tip", name="long")
    found, reasons = compile_robots({"long": long, "panda": panda}, GRAVITY, [(0, 17), (1, 7)])
    assert found.places == (1,)
    assert reasons == {"long": "it has 17 joints between base and a link; at most 16 are compiled"}
    alone, _ = compile_robots({"long": long}, GRAVITY, [(0, 17)])
    assert alone is None


def joint_of(model: pin.Model, parent: int, joint) -> int:
    found = model.addJoint(parent, joint, pin.SE3.Random(), f"j{model.njoints}")
    model.appendBodyToJoint(found, pin.Inertia.Random(), pin.SE3.Identity())
    return found


def unusual(panda, *joints) -> Robot:
    """An arm whose model is not one that a URDF describes; pairs of parent and joint."""
    model = pin.Model()
    for parent, joint in joints:
        joint_of(model, parent, joint)
    panda.model, panda.joint_names = model, tuple(model.names[1:])
    panda.dof = model.nv
    return with_tip_on(panda, model.njoints - 1)


def with_tip_on(arm: Robot, joint: int) -> Robot:
    arm.tips = {"": replace(arm.tip, joint=joint)}
    return arm


def test_what_no_table_describes_is_said_in_words(panda):
    hinge, screw = pin.JointModelRX(), pin.JointModelHX(0.1)
    with refused(ModelError, "j2"):
        unusual(panda, (0, hinge), (1, screw)).structure()


def test_states_of_the_verification_are_the_arms_own(panda):
    draws = [compiled_backend._random_states(panda.structure()) for _ in range(2)]
    np.testing.assert_array_equal(draws[0], draws[1])
    assert np.max(np.abs(draws[0][0])) <= np.pi and np.max(np.abs(draws[0][1])) <= 3.0
    assert np.min(np.std(draws[0], axis=1)) > 0.3


def test_pose_of_the_world_is_there_too(panda):
    copies, _, _, _ = compiled([panda.structure()])
    at = copies.pose_address(0, 0)
    found = np.frombuffer((ctypes.c_double * 12).from_address(at))
    np.testing.assert_array_equal(found, [1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0])
