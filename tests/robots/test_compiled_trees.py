"""Claims about compiled robots with branches: their terms are Pinocchio's, and they share packs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from compiled_robots import GRAVITY, Compiled, arm_of, largest_difference, random_base
from hypothesis import given, settings
from hypothesis import strategies as st
from random_structures import random_parents, random_structure, random_tree

from multiarm.errors import ModelError
from multiarm.robots.compiled import backend as compiled_backend
from multiarm.robots.compiled.backend import compile_robots, verify
from multiarm.robots.compiled.branches import branches_of, most_in_a_row
from multiarm.robots.compiled.reference import pinocchio_terms
from multiarm.robots.compiled.tables import MOST_JOINTS
from multiarm.robots.robot import Robot
from multiarm.robots.terms import LinkTerms
from multiarm.scene import find_robot

FINGERS = ("finger", "gripper")
LEGS, WHEELS, HEAD, HAND = ("leg", "hip", "knee", "ankle"), ("wheel",), ("head",), ("hand",)
# Robots, and parts of the names of joints that are locked.
ROBOTS = {
    "tiago_pro": ("tiago_pro", (*FINGERS, *WHEELS, *HEAD)),
    "tiago_pro with hands and head": ("tiago_pro", WHEELS),
    "talos' upper body": ("talos", LEGS),
    "talos": ("talos", ()),
    "baxter": ("baxter", FINGERS),
    "g1 with hands": ("g1_29dof_with_hand_rev_1_0", ()),
    "allegro": ("allegro_left_hand", ()),
    "panda": ("panda", ()),
    "pr2": ("pr2", ()),
}


def robot(key: str, base=None, rotors: float = 0.0) -> Robot:
    name, locked = ROBOTS[key]
    return real_robot(name, locked, base, rotors)


def real_robot(name, locked=(), base=None, rotors=0.0, **more) -> Robot:
    urdf = find_robot(name).urdf
    model = pin.buildModelFromUrdf(str(urdf))
    beside = {joint: 0.0 for joint in list(model.names)[1:] if any(x in joint for x in locked)}
    last = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY][-1]
    arm = arm_of(urdf, last, base, beside, name=name, **more)
    arm.model.armature = np.repeat([0.0, rotors], [arm.base_dof, len(arm.joint_names)])
    return arm


def tree_arm(folder, rng, parents, away=1.0, name="tree", **more) -> Robot:
    (folder / f"{name}.urdf").write_text(random_tree(rng, parents))
    return arm_of(folder / f"{name}.urdf", "tip", random_base(rng, away), name=name, **more)


def floating(rng) -> dict:
    """A base that floats, with a mass of its own."""
    moments = np.diag(rng.uniform(2.0, 3.0, 3)) + 0.1
    return {"base_floats": True, "base_mass": rng.uniform(1.0, 9.0), "base_inertia": moments}


def last_links(arm: Robot) -> list[int]:
    """Pinocchio's numbers of the joints after which none follows."""
    return [k for k in range(1, arm.model.njoints) if k not in list(arm.model.parents)]


def worst_difference(arms, links, compiled: Compiled, gravity=GRAVITY) -> float:
    worst = 0.0
    for k, (arm, terms) in enumerate(zip(arms, compiled.terms(), strict=True)):
        joints = [joint for place, joint in links if place == k]
        (expected,) = pinocchio_terms(arm, joints, *compiled.state_of(k), gravity)
        worst = max(worst, *largest_difference(terms, expected).values())
    return worst


# --- terms ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ROBOTS)
def test_terms_of_robots_with_branches_are_pinocchios(key, rng):
    """All in one: their last links, and one in the middle, take part in connections."""
    arm = robot(key, random_base(rng), rotors=0.3)
    links = [(0, joint) for joint in (*last_links(arm), 2)]
    compiled = Compiled([arm.structure()], links)
    for _ in range(3):
        compiled.draw(rng)
        assert worst_difference([arm], links, compiled) < 1e-12


@pytest.mark.slow
@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), away=st.sampled_from([0.0, 1.0, 2000.0]))
def test_terms_of_random_trees_side_by_side_are_pinocchios(tmp_path_factory, seed, away):
    """One to nine robots at once; any links, also of the base, take part in connections."""
    rng = np.random.default_rng(seed)
    folder, arms, links = tmp_path_factory.mktemp("trees"), [], []
    for k in range(rng.integers(1, 10)):
        joints = int(rng.integers(1, 17))
        parents = random_parents(rng, joints, rng.choice([0.0, 0.2, 0.4, 0.8]))
        base = floating(rng) if rng.random() < 0.4 else {}
        arms.append(tree_arm(folder, rng, parents, away, f"tree{k}", **base))
        ends = rng.integers(2 if base else 0, arms[k].model.njoints, rng.integers(0, 4))
        links += [(k, int(joint)) for joint in ends]
    gravity = rng.uniform(-10, 10, 3)
    compiled = Compiled([arm.structure() for arm in arms], links, gravity)
    for _ in range(2):
        compiled.draw(rng)
        assert worst_difference(arms, links, compiled, gravity) < 1e-11


@pytest.mark.parametrize("key", ["g1_29dof_rev_1_0", "talos", "anymal-kinova", "ur5"])
def test_terms_of_robots_on_floating_bases_are_pinocchios(key, rng):
    """Their last links, one in the middle, and the base take part in connections."""
    arm = real_robot(key, rotors=0.3, **floating(rng))
    links = [(0, joint) for joint in (*last_links(arm), 4, 2)]
    compiled = Compiled([arm.structure()], links)
    for _ in range(3):
        compiled.draw(rng)
        assert worst_difference([arm], links, compiled) < 1e-12


def test_robots_that_float_and_others_are_computed_side_by_side(tmp_path, rng):
    """Five robots that float, of several shapes, among arms and trees on fixed bases."""
    shapes = [(-1,), (-1, 0, 1), (-1, -1, 1, 1), (-1, 0, 0), (-1, 0, 1, 0, 3, 3, 0)] * 2
    arms = [
        tree_arm(tmp_path, rng, shape, name=f"tree{k}", **(floating(rng) if k % 2 else {}))
        for k, shape in enumerate(shapes)
    ]
    links = [(k, arm.model.njoints - 1) for k, arm in enumerate(arms)] + [(3, 2), (2, 0), (3, 2)]
    compiled = Compiled([arm.structure() for arm in arms], links)
    for _ in range(3):
        compiled.draw(rng)
        assert worst_difference(arms, links, compiled) < 1e-12


def test_a_floating_robot_far_away_loses_no_digits(rng, tmp_path):
    """Moments are about its base: what does not depend on the place is the same."""
    tree = tree_arm(tmp_path, rng, (-1, 0, -1, 2, 2), **floating(rng)).structure()
    compiled = Compiled([tree, tree], [(0, 2), (1, 2)])
    compiled.draw(rng)
    for numbers in (compiled.angles, compiled.rates):
        numbers[compiled.parts[1]] = numbers[compiled.parts[0]]
    compiled.base_poses[1] = compiled.base_poses[0]
    compiled.base_poses[1, :3] = [2000.0, -1500.0, 300.0]
    here, there = compiled.terms()
    for name in ("inertia", "bias", "gravity_torque"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name), name)
    np.testing.assert_array_equal(there.bodies[0, 12:], here.bodies[0, 12:])


def test_inertia_is_zero_between_branches(tmp_path, rng):
    """Also where scratch has the numbers of other robots."""
    arms = [tree_arm(tmp_path, rng, [-1, 0, 1, 0, -1, 4], name=f"tree{k}") for k in range(5)]
    compiled = Compiled([arm.structure() for arm in arms], [])
    compiled.draw(rng)
    for arm, terms in zip(arms, compiled.terms(), strict=True):
        parents = arm.structure().parents
        ways = [set(way(parents, k)) for k in range(parents.size)]
        for i, j in np.ndindex(terms.inertia.shape):
            on_one_way = i in ways[j] or j in ways[i]
            assert (terms.inertia[i, j] != 0.0) == on_one_way
            assert on_one_way or terms.coriolis[i, j] == 0.0


def way(parents, joint):
    """A joint and those between it and the base."""
    while joint >= 0:
        yield joint
        joint = parents[joint]


def test_a_robot_does_not_depend_on_its_neighbours(rng):
    """Its numbers are the same, bit for bit, alone and beside others of any shape."""
    shapes = [
        (-1, 0, 0, 2),
        (-1, -1),
        (-1, 0, 1, 1, 0, 4),
        (-1, 0, 1),
        (-1, 0, 0, 2),
        (-1, 0, 0, 0),
    ]
    trees = [random_structure(rng, parents) for parents in shapes]
    links = [(k, joint) for k, parents in enumerate(shapes) for joint in (1, len(parents))]
    together = Compiled(trees, links)
    together.draw(rng)
    for k, terms in enumerate(together.terms()):
        alone = Compiled([trees[k]], [(0, joint) for place, joint in links if place == k])
        alone.angles[:], alone.rates[:] = (
            together.angles[together.parts[k]],
            together.rates[together.parts[k]],
        )
        for name, a, b in zip(LinkTerms._fields, alone.terms()[0], terms, strict=True):
            np.testing.assert_array_equal(a, b, name)


def test_a_robot_far_away_loses_no_digits(rng):
    """Two kilometres from the origin: what does not depend on the place is the same."""
    tree = random_structure(rng, (-1, 0, -1, 2, 2))
    roots = tree.parents < 0
    far = tree._replace(translations=tree.translations.copy())
    # whole numbers of 2**-8, so that the base moves without rounding
    tree.translations[roots] = np.round(256 * tree.translations[roots]) / 256
    far.translations[roots] = tree.translations[roots] + [2000.0, -1500.0, 300.0]
    compiled = Compiled([tree, far], [(0, 5), (1, 5)])
    compiled.draw(rng)
    for numbers in (compiled.angles, compiled.rates):
        numbers[compiled.parts[1]] = numbers[compiled.parts[0]]
    here, there = compiled.terms()
    for name in ("inertia", "bias", "gravity_torque", "coriolis"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name), name)
    np.testing.assert_array_equal(there.bodies[0, 12:], here.bodies[0, 12:])


def test_a_position_that_is_no_number_spoils_its_way_only(rng):
    """The other branches of the robot and the other robots are what they were."""
    trees = [
        random_structure(rng, (-1, 0, 1, 0, 3))._replace(slides=np.ones(5, bool)) for _ in "ab"
    ]
    compiled = Compiled(trees, [(0, 3), (0, 5), (1, 3)])
    compiled.draw(rng)
    before = compiled.terms()
    compiled.angles[2] = np.nan  # the last joint of the first branch
    spoiled, beside = compiled.terms()
    assert np.isnan(spoiled.bias[0]) and np.isnan(spoiled.bodies[0]).any()
    np.testing.assert_array_equal(spoiled.bias[3:], before[0].bias[3:])
    np.testing.assert_array_equal(spoiled.bodies[1], before[0].bodies[1])
    for a, b in zip(beside, before[1], strict=True):
        np.testing.assert_array_equal(a, b)


# --- links that take part in connections ----------------------------------------------------------


def test_a_link_of_the_base_is_at_rest(rng):
    compiled = Compiled([random_structure(rng, (-1, 0))], [(0, 2), (0, 0)])
    np.testing.assert_array_equal(compiled.bodies[1], [*np.eye(3).ravel(), *np.zeros(15)])
    compiled.draw(rng)
    compiled.terms()
    np.testing.assert_array_equal(compiled.bodies[1], [*np.eye(3).ravel(), *np.zeros(15)])


@pytest.mark.parametrize("parents", [(-1, 0, 1), (-1, 0, 0)], ids=["chain", "tree"])
def test_rows_of_bodies_are_those_of_the_links(parents, rng):
    """In any order, more than one of a link, and none of some robots."""
    trees = [random_structure(rng, parents) for _ in range(3)]
    links = [(2, 1), (0, 3), (2, 3), (0, 3)]
    compiled = Compiled(trees, links)
    compiled.draw(rng)
    compiled.terms()
    for row, (place, joint) in enumerate(links):
        alone = Compiled([trees[place]], [(0, joint)])
        alone.angles[:], alone.rates[:] = (
            compiled.angles[compiled.parts[place]],
            compiled.rates[compiled.parts[place]],
        )
        alone.terms()
        np.testing.assert_array_equal(compiled.bodies[row], alone.bodies[0])


# --- branches -------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), joints=st.integers(1, 20))
def test_branches_are_ways_along_which_a_tree_does_not_divide(seed, joints):
    parents = np.array(random_parents(np.random.default_rng(seed), joints))
    branches = branches_of(0, parents)
    assert sorted(joint for branch in branches for joint in branch.joints) == list(range(joints))
    children = [np.flatnonzero(parents == joint) for joint in range(joints)]
    for branch in branches:
        first, last = branch.joints[0], branch.joints[-1]
        assert branch.joints[::-1] + branch.ancestors[::-1] == tuple(way(parents, last))
        assert all(len(children[joint]) == 1 for joint in branch.joints[:-1])
        assert len(children[last]) != 1
        assert parents[first] < 0 or len(children[parents[first]]) > 1
    assert most_in_a_row(parents) == max(len(list(way(parents, k))) for k in range(joints))


def steps(key: str, count: int) -> int:
    """Joints that are computed one after the other for some robots, lanes side by side."""
    arms = [robot(key) for _ in range(count)]
    links = [(k, joint) for k, arm in enumerate(arms) for joint in last_links(arm)]
    return int(np.sum(Compiled([arm.structure() for arm in arms], links).tables.blocks.joints))


def test_the_legs_of_a_humanoid_share_packs_with_its_arms(rng):
    """Base, waist, then arms of seven joints with legs of six."""
    arm = real_robot("g1_29dof_rev_1_0", **floating(rng))
    links = [(0, joint) for joint in last_links(arm)]
    blocks = Compiled([arm.structure()], links).tables.blocks
    assert blocks.joints.tolist() == [1, 3, 7] and blocks.branches.tolist() == [1, 1, 4]


@pytest.mark.parametrize(
    ("key", "alone", "four"),
    [("tiago_pro", 1 + 7, 1 + 7 + 7), ("allegro", 4, 4 * 4), ("panda", 7 + 1, 7 + 1 + 1)],
)
def test_branches_and_robots_alike_share_packs(key, alone, four):
    """Trunks are computed before arms, the arms of a robot side by side, and those of others."""
    assert steps(key, 1) == steps(key, 2 if key != "allegro" else 1) == alone
    assert steps(key, 4) == four


# --- which robots are compiled --------------------------------------------------------------------


def test_a_robot_that_is_compiled_is_the_robot():
    arm = robot("tiago_pro")
    links = [(0, joint) for joint in last_links(arm)]
    backend, reasons = compile_robots({"tiago": arm}, GRAVITY, links)
    assert backend.places == (0,) and reasons == {}
    verify(backend.tables, (0,), {"tiago": arm}, links, LinkTerms._fields)


def test_a_copy_with_a_wrong_link_is_refused(monkeypatch):
    """Whichever of its links is off by a billionth of its mass."""
    arm, make = robot("tiago_pro"), compiled_backend.make_tables
    structure = arm.structure()
    assert np.all(structure.masses > 0.0)
    for joint in range(arm.dof):
        masses = structure.masses * (1.0 + 1e-9 * (np.arange(arm.dof) == joint))

        def wrong(structures, *arguments, masses=masses):
            return make([structures[0]._replace(masses=masses)], *arguments)

        monkeypatch.setattr(compiled_backend, "make_tables", wrong)
        with pytest.raises(ModelError, match="tiago_pro"):
            compile_robots({"tiago_pro": arm}, GRAVITY, [])


def test_depth_decides_and_not_the_number_of_joints(tmp_path, rng):
    wide = tree_arm(tmp_path, rng, [-1, *[0] * 2 * MOST_JOINTS], name="wide")
    deep = tree_arm(tmp_path, rng, [-1, *range(MOST_JOINTS), 0], name="deep")
    backend, reasons = compile_robots({"wide": wide, "deep": deep}, GRAVITY, [(0, 1), (1, 2)])
    assert backend.places == (0,)
    reason = f"it has {MOST_JOINTS + 1} joints between base and a link"
    assert reasons == {"deep": f"{reason}; at most {MOST_JOINTS} are compiled"}
