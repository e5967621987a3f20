"""Claims about contacts that cannot be: each is told once, with arm, contact and remedy."""

from __future__ import annotations

import re

import numpy as np
import pytest
from mechanics import single_arm
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.errors import MultiarmError, SceneError

POSTURE = [0.3, -0.6, 1.1, 0.4, 0.7, -0.2]
FLOOR = {"plane": {"normal": [0, 0, 1]}}


@pytest.fixture(scope="module")
def tip_pose():
    """Where the tip is in the object's frame."""
    system = ma.compile_system(single_arm("textbook_6r", "tool", POSTURE, {"kind": "ball"}))
    return system.arms["arm"].tip_pose(np.array(POSTURE))


@pytest.fixture
def compiled(tip_pose):
    """Compile a scene with listed contacts, in the frame of the arm's tip at the start."""
    at = {
        "xyz": tip_pose[:3, 3].tolist(),
        "quaternion_xyzw": Rotation.from_matrix(tip_pose[:3, :3]).as_quat().tolist(),
    }

    def compile_it(*contacts, **more):
        joint = {"kind": "contacts", "contacts": list(contacts), "at": at}
        return ma.compile_system(single_arm("textbook_6r", "tool", POSTURE, joint, **more))

    return compile_it


def contact(name, arm, body, **more):
    return {"name": name, "arm": arm, "object": body, **more}


def point(*at):
    return {"point": list(at)}


def told_once(error: pytest.ExceptionInfo, *words: str) -> None:
    """One fault, with all of the words and no number that is none."""
    text = str(error.value)
    if isinstance(error.value, SceneError):
        assert len(error.value.faults) == 1, text
    for word in words:
        assert word in text, text
    assert not re.search(r"\b(nan|inf|array|dtype)\b", text.lower()), text


# --- surfaces that do not touch in a point --------------------------------------------------------


def test_contacts_that_do_not_touch_are_refused_with_their_gap(compiled):
    with pytest.raises(SceneError) as caught:
        compiled(contact("far", point(0, 0, 0.6), FLOOR))
    told_once(caught, "'arm'", "gap of 0.6", "at")


@pytest.mark.slow
def test_surfaces_that_do_not_touch_are_refused_with_their_gap(compiled):
    """Two ellipsoids 0.7 m apart."""
    egg = {"ellipsoid": {"semi_axes": [0.1, 0.12, 0.14]}}
    away = {"ellipsoid": {"center": [0.93, 0, 0], "semi_axes": [0.13, 0.1, 0.1]}}
    with pytest.raises(SceneError) as caught:
        compiled(contact("eggs", egg, away))
    told_once(caught, "'arm'", "gap of 0.7", "at")


def test_a_plane_on_a_cylinder_is_refused_as_it_is_read(compiled):
    with pytest.raises(SceneError) as caught:
        compiled(contact("roll", {"cylinder": {"radius": 0.1}}, FLOOR))
    told_once(caught, "contacts[0]", "cylinder", "plane", "along a line", "use a sphere")


def test_parallel_cylinders_are_refused_where_they_touch_along_a_line(compiled):
    """Cylinders may touch, but not side by side."""
    beside = {"cylinder": {"point": [0.3, 0, 0], "radius": 0.2}}
    with pytest.raises(SceneError) as caught:
        compiled(contact("rollers", {"cylinder": {"radius": 0.1}}, beside))
    told_once(caught, "'arm'", "'rollers'", "along a line", "spherical tips")


@pytest.mark.parametrize("effects", [{}, {"joint_limits": "urdf"}], ids=["closed", "with stops"])
def test_crossed_cylinders_are_welcome(compiled, effects):
    """With rows that can open, the joints are closed on a selection of them."""
    across = {"cylinder": {"point": [0.3, 0, 0], "axis": [0, 1, 0.2], "radius": 0.2}}
    crossed = contact("crossed", {"cylinder": {"radius": 0.1}}, across)
    system = compiled(crossed, effects=effects)
    assert ma.evaluate(system).position_residual < 1e-12


def test_an_ellipsoid_that_is_too_blunt_for_its_bowl_is_refused(compiled):
    """At the place where it would touch, it bends less than the bowl: it cannot rest there."""
    egg = {"ellipsoid": {"semi_axes": [0.5, 0.5, 0.5]}}
    bowl = {"sphere": {"radius": 0.3, "inside": True}}
    with pytest.raises(SceneError) as caught:
        compiled(contact("stuck", egg, bowl))
    told_once(caught, "contacts[0]", "does not fit", "smaller")


# --- rows that say the same twice -----------------------------------------------------------------


def test_a_contact_given_twice_is_welcome_and_named(compiled):
    system = compiled(
        contact("first", point(0, 0, 0), FLOOR), contact("again", point(0, 0, 0), FLOOR)
    )
    found = ma.evaluate(system)
    assert found.rank == 1 and system.model.layout.contacts == 2
    assert found.lost_motions["arm"] == ("1 of 2 contacts too many",)


def test_only_the_contacts_that_depend_on_each_other_are_named(compiled):
    """Four points on one face are one too many; a point on another face is not to blame."""
    corners = [(0.1, 0.1, 0), (0.1, -0.1, 0), (-0.1, 0.1, 0), (-0.1, -0.1, 0)]
    feet = [contact(f"foot {k}", point(*at), FLOOR) for k, at in enumerate(corners)]
    side = contact("side", point(0, 0, 0.05), {"plane": {"normal": [1, 0, 0]}})
    found = ma.evaluate(compiled(*feet, side))
    assert found.rank == 4
    assert found.contact_forces_unique["arm"].tolist() == [False] * 4 + [True]
    assert not any("'side'" in words for words in found.lost_motions["arm"])


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_the_result_says_which_forces_the_equations_determine(compiled, solver):
    system = compiled(
        contact("first", point(0, 0, 0), FLOOR),
        contact("again", point(0, 0, 0), FLOOR),
        contact("side", point(0, 0, 0.05), {"plane": {"normal": [1, 0, 0]}}),
        run={"solver": solver},
    )
    found = ma.evaluate(system)
    assert found.contact_forces_unique["arm"].tolist() == [False, False, True]
    assert found.residuals.constraint < 1e-9


# --- patches --------------------------------------------------------------------------------------


def test_a_tip_outside_its_patch_is_refused(compiled):
    tile = {"plane": {"normal": [0, 0, 1], "patch": {"min": [0.02, None, None]}}}
    with pytest.raises(SceneError) as caught:
        compiled(contact("on the tile", point(0, 0, 0), tile))
    told_once(caught, "arm 'arm'", "'on the tile'", "0.02 m outside", "patch", "'min' and 'max'")


def test_a_tip_inside_its_patch_is_welcome(compiled):
    tile = {"plane": {"normal": [0, 0, 1], "patch": {"min": [-0.02, None, None]}}}
    assert compiled(contact("on the tile", point(0, 0, 0), tile)).model.layout.contacts == 1


def test_the_patch_of_the_arms_own_surface_counts_too(compiled):
    cap = {"sphere": {"radius": 0.1, "center": [0, 0, 0.1], "patch": {"min": [None, None, 0.1]}}}
    with pytest.raises(SceneError) as caught:
        compiled(contact("cap", cap, FLOOR))
    told_once(caught, "arm 'arm'", "'cap'", "outside", "patch")


# --- surfaces of the user that contradict themselves ----------------------------------------------


def twice_the_distance(p):
    """Vanishes on the floor, but is no distance."""
    return 2.0 * p[2]


def height(p):
    return p[2]


def sideways(p):
    return np.array([1.0, 0.0, 0.0])


def pinched(u, v):
    """All v are the same point at u = 0, where the tip is: there is no normal."""
    return np.array([u, u * v, 0.0])


def nowhere(p):
    return np.sqrt(-1.0 - p[2] ** 2) if not np.iscomplexobj(p) else p[2] * np.nan


@pytest.mark.parametrize(
    ("surface", "words"),
    [
        ({"distance": twice_the_distance}, ("twice_the_distance", "not a signed distance", "= 2")),
        (
            {"distance": height, "gradient": sideways},
            ("gradient", "height", "disagrees", "correct"),
        ),
        (
            {"parametrisation": pinched, "u": [-1, 1], "v": [-1, 1]},
            ("pinched", "parameters", "choose others"),
        ),
    ],
    ids=["no distance", "wrong normals", "no normal"],
)
def test_a_surface_whose_normals_are_not_its_own_is_refused(compiled, surface, words):
    with pytest.raises(MultiarmError) as caught:
        compiled(contact("own", point(0, 0, 0), {"surface": surface}))
    told_once(caught, *words)


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_a_surface_that_is_not_a_number_is_refused(compiled):
    with pytest.raises(MultiarmError, match=r"nowhere.*not finite"):
        compiled(contact("own", point(0, 0, 0), {"surface": {"distance": nowhere}}))
