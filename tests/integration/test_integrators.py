"""Claims about the integration methods: their coefficients, their orders, their error control."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from mechanics import EPS, single_arm, ur5_pair
from repository import SCENES
from scipy.integrate import DOP853 as SCIPY_DOP853
from scipy.integrate import RK45 as SCIPY_RK45
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm import tableaus
from multiarm.integration.step import coefficients
from multiarm.scene import StabilizationSpec
from multiarm.scene.settings import STABILIZATIONS
from multiarm.tableaus import EXPLICIT, HERMITE, METHODS, NESTED, POLYNOMIAL, Tableau

COEFFICIENTS = {name: coefficients(tableau, 0) for name, tableau in METHODS.items()}
RUNGE_KUTTA = [name for name, m in METHODS.items() if m.kind == EXPLICIT]


def test_every_method_and_stabilization_says_when_to_choose_it():
    assert [name for name, method in METHODS.items() if not method.purpose] == []
    kinds = get_args(StabilizationSpec.model_fields["kind"].annotation)
    assert kinds == tuple(STABILIZATIONS) and all(STABILIZATIONS.values())


# --- coefficients --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", RUNGE_KUTTA)
def test_stages_are_consistent(name):
    """Rows of A sum to c; quadrature conditions sum b c^(k-1) = 1/k up to the order; D(1)."""
    m = COEFFICIENTS[name]
    s = m.b.size
    np.testing.assert_allclose(m.A.sum(axis=1), m.c, atol=50 * EPS)
    np.testing.assert_array_equal(np.triu(m.A), 0.0)
    for k in range(1, m.order + 1):
        assert m.b @ m.c[:s] ** (k - 1) == pytest.approx(1 / k, abs=50 * EPS)
    np.testing.assert_allclose(m.b @ m.A[:s, :s], m.b * (1 - m.c[:s]), atol=200 * EPS)
    assert m.b @ m.A[:s, :s] @ m.A[:s, :s] @ m.c[:s] == pytest.approx(1 / 24, abs=50 * EPS)


@pytest.mark.parametrize("name", ["dopri5", "dop853"])
def test_error_estimates_vanish_for_polynomials(name):
    """The weights compare two quadratures: of the method's order and of a lower one."""
    m = COEFFICIENTS[name]
    nodes = np.append(m.c[: m.b.size], 1.0)
    exact_up_to = {"dopri5": [4], "dop853": [5, 3]}[name]
    for weights, order in zip(m.error, exact_up_to, strict=True):
        for k in range(order):
            assert weights @ nodes**k == pytest.approx(0.0, abs=100 * EPS)
        assert abs(weights @ nodes**order) > 1e-6


def test_dopri5_has_the_published_coefficients():
    m, stages = COEFFICIENTS["dopri5"], 6
    np.testing.assert_allclose(m.A[:stages, :5], SCIPY_RK45.A, atol=2 * EPS)
    np.testing.assert_allclose(m.b, SCIPY_RK45.B, atol=2 * EPS)
    np.testing.assert_allclose(np.abs(m.error[0]), np.abs(SCIPY_RK45.E), atol=2 * EPS)
    np.testing.assert_allclose(m.dense.T, SCIPY_RK45.P, rtol=1e-14)
    assert m.dense_kind == POLYNOMIAL


def test_dop853_has_the_published_coefficients():
    """Scipy carries Hairer's numbers; every digit counts."""
    m = COEFFICIENTS["dop853"]
    np.testing.assert_allclose(m.A[:12, :12], SCIPY_DOP853.A, rtol=1e-15, atol=0)
    np.testing.assert_allclose(m.b, SCIPY_DOP853.B, rtol=1e-15, atol=0)
    np.testing.assert_allclose(m.c[:12], SCIPY_DOP853.C, rtol=1e-15, atol=0)
    np.testing.assert_allclose(m.error, [SCIPY_DOP853.E5, SCIPY_DOP853.E3], rtol=1e-15, atol=1e-17)
    np.testing.assert_allclose(m.A[13:, :16], SCIPY_DOP853.A_EXTRA, rtol=1e-15, atol=0)
    np.testing.assert_allclose(m.c[13:], SCIPY_DOP853.C_EXTRA, rtol=1e-15, atol=0)
    np.testing.assert_allclose(m.dense, SCIPY_DOP853.D, rtol=1e-15, atol=0)
    assert m.dense_kind == NESTED and METHODS["rk4"].dense_kind == HERMITE


# --- the Rosenbrock method in its textbook form (Hairer and Wanner, IV.7) ------------------------


@dataclass(frozen=True)
class Rosenbrock:
    """``k_i = f(u + h sum alpha_ij k_j) + h J sum gamma_ij k_j``, ``u_1 = u + h sum b_i k_i``.

    The tableau has the form without products with ``J``: its stages are those of the textbook
    times ``Gamma = (gamma_ij)``.
    """

    alpha: np.ndarray
    Gamma: np.ndarray
    b: np.ndarray
    embedded: np.ndarray
    dense: np.ndarray

    @classmethod
    def of(cls, m):
        Gamma = np.linalg.inv(np.eye(m.b.size) / m.gamma - m.C)
        last = np.eye(m.b.size)[-1]  # the last stage is the error estimate
        return cls(m.A @ Gamma, Gamma, m.b @ Gamma, (m.b - last) @ Gamma, m.dense @ Gamma)

    def weights(self, theta):
        """Weights of the dense output."""
        bend = self.dense[0] + theta * (self.dense[1] + theta * self.dense[2])
        return theta * (self.b + (1 - theta) * bend)

    def elementary(self, tree):
        """What a rooted tree stands for, one number a stage.

        Where the tree branches f is differentiated twice or more, which only ``alpha`` enters.
        """
        if not tree:
            return np.ones(self.b.size)
        matrix = self.alpha + self.Gamma if len(tree) == 1 else self.alpha
        return np.prod([matrix @ self.elementary(branch) for branch in tree], axis=0)


def rooted_trees(order):
    """All rooted trees with so many vertices; a tree is the tuple of its branches."""
    forests = {0: {()}}
    for size in range(1, order):
        forests[size] = {
            tuple(sorted((*rest, tree)))
            for first in range(1, size + 1)
            for tree in rooted_trees(first)
            for rest in forests[size - first]
        }
    return sorted(forests[order - 1])


def vertices(tree):
    return 1 + sum(map(vertices, tree))


def density(tree):
    return vertices(tree) * math.prod(map(density, tree))


def missed(textbook, weights, order, theta=1.0):
    """Largest violation of an order's conditions at the fraction ``theta`` of a step."""
    return max(
        abs(weights @ textbook.elementary(tree) - theta**order / density(tree))
        for tree in rooted_trees(order)
    )


@pytest.fixture(scope="module")
def rodas():
    return Rosenbrock.of(COEFFICIENTS["rodas5p"])


def test_all_trees_are_counted():
    assert [len(rooted_trees(order)) for order in range(1, 7)] == [1, 1, 2, 4, 9, 20]


def test_rodas5p_meets_the_conditions_of_order_5_and_compares_with_order_4(rodas):
    for order in range(1, 6):
        assert missed(rodas, rodas.b, order) < 100 * EPS
    for order in range(1, 5):
        assert missed(rodas, rodas.embedded, order) < 100 * EPS
    assert missed(rodas, rodas.b, 6) > 1e-3 and missed(rodas, rodas.embedded, 5) > 1e-3


def test_dense_output_of_rodas5p_is_of_order_4_everywhere_in_the_step(rodas):
    for theta in (0.1, 0.37, 0.5, 0.9):
        for order in range(1, 5):
            assert missed(rodas, rodas.weights(theta), order, theta) < 200 * EPS
    np.testing.assert_allclose(rodas.weights(1.0), rodas.b, atol=20 * EPS)


def test_nodes_of_rodas5p_are_the_sums_of_its_rows(rodas):
    m = COEFFICIENTS["rodas5p"]
    np.testing.assert_allclose(rodas.alpha.sum(axis=1), m.c, atol=100 * EPS)
    np.testing.assert_allclose(rodas.Gamma.sum(axis=1), m.d, atol=100 * EPS)
    np.testing.assert_allclose(np.diag(rodas.Gamma), m.gamma, rtol=10 * EPS)
    np.testing.assert_array_equal(np.triu(m.A), 0.0)
    np.testing.assert_array_equal(np.triu(m.C), 0.0)


def test_rodas5p_is_stiffly_accurate_and_l_stable(rodas):
    """Its last stage is the end of the step; R(iy) stays in the unit circle and R(inf) = 0."""
    beta, ones = rodas.alpha + rodas.Gamma, np.ones(rodas.b.size)
    np.testing.assert_allclose(beta[-1], rodas.b, atol=20 * EPS)
    assert rodas.alpha[-1].sum() == pytest.approx(1.0, abs=100 * EPS)
    np.testing.assert_allclose(beta[-2], rodas.embedded, atol=20 * EPS)
    for weights in (rodas.b, rodas.embedded):
        assert 1 - weights @ np.linalg.pinv(beta) @ ones == pytest.approx(0.0, abs=1e-12)
        for y in np.logspace(-3, 6, 300):
            stages = np.linalg.solve(np.eye(ones.size) - 1j * y * beta, ones)
            assert abs(1 + 1j * y * weights @ stages) < 1 + 100 * EPS


@pytest.mark.parametrize("name", ["dopri5", "dop853"])
def test_the_limit_of_stability_is_where_decay_no_longer_dies_out(name):
    """A scene counts as stiff where steps get there; R(z) = 1 + z b (1 - z A)^-1 1."""
    m = COEFFICIENTS[name]
    A, ones = m.A[: m.b.size, : m.b.size], np.ones(m.b.size)
    grows = [
        z for z in np.arange(0.1, 10.0, 0.01)
        if abs(1 - z * m.b @ np.linalg.solve(np.eye(ones.size) + z * A, ones)) > 1
    ]  # fmt: skip
    assert 0.94 * grows[0] < m.stability < grows[0]


# --- orders, on two arms that swing a block ------------------------------------------------------

DURATION = 0.14


def end_of(trajectory):
    """Object pose and joint positions at the end, in metres and radians."""
    rotation = Rotation.from_quat(trajectory.object_quaternion_xyzw[-1]).as_rotvec()
    joints = [trajectory.joint_positions[name][-1] for name in trajectory.arm_names]
    return np.concatenate([trajectory.object_position[-1], rotation, *joints])


@pytest.fixture(scope="module")
def reference(free_block_system):
    """The end of the motion to about 1e-13."""
    run = {"integrator": "dop853", "tolerance": 1e-14, "stabilization": "projection"}
    return end_of(ma.simulate(free_block_system, duration=DURATION, **run))


STEPS = {
    "semi_implicit_euler": (1, [40, 80, 160, 320]),
    "rk4": (4, [20, 40, 80, 160]),
    "dopri5": (5, [32, 48, 64, 80]),
    "dop853": (8, [7, 8, 9, 10, 12]),
    "rodas5p": (5, [16, 24, 32, 48]),
    "variational": (2, [20, 40, 80, 160]),
}
CASES = [
    (name, stabilization)
    for name in STEPS
    for stabilization in ("none", "projection", "feedback")
    if (name, stabilization) != ("variational", "feedback")
]


def fixed_step(monkeypatch, name):
    """Let ``integrator='rk4'`` run another method's stages with the given step."""
    if METHODS[name].error_order > 0:
        monkeypatch.setitem(METHODS, "rk4", METHODS[name]._replace(error_order=0))
    return name if name in ("semi_implicit_euler", "variational") else "rk4"


@pytest.mark.parametrize(("name", "stabilization"), CASES)
def test_error_falls_with_the_order_of_the_method(
    name, stabilization, free_block_system, reference, monkeypatch
):
    order, steps = STEPS[name]
    integrator = fixed_step(monkeypatch, name)
    if stabilization == "feedback":
        stabilization = {"kind": "feedback", "alpha": 5.0, "beta": 5.0}
    errors = []
    for n in steps:
        run = {"integrator": integrator, "step": DURATION / n, "stabilization": stabilization}
        found = end_of(
            ma.simulate(free_block_system, duration=DURATION, output_step=DURATION, **run)
        )
        errors.append(np.max(np.abs(found - reference)))
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.2), errors


@pytest.mark.parametrize("kind", ["computed_torque", "object_impedance"])
def test_laws_that_move_the_object_leave_rodas5p_its_order(kind, monkeypatch):
    """Its conditions of order 5 hold for the exact matrix only."""
    control = {"kind": kind, "path": [{"time": 0.4, "xyz": [0.05, 0, 0.55], "rpy": [0.2, 0, 0.1]}]}
    if kind == "object_impedance":
        gains = {"translation": 800, "rotation": [100, 200, 300]}
        control |= {"stiffness": gains, "damping": {"translation": 100, "rotation": 20}}
    system = ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "ball"}, control=control))
    run = {"duration": 0.3, "output_step": 0.3, "stabilization": "none"}
    exact = end_of(ma.simulate(system, integrator="dop853", tolerance=1e-13, **run))
    integrator, errors, steps = fixed_step(monkeypatch, "rodas5p"), [], [12, 16, 24]
    for n in steps:
        end = ma.simulate(system, integrator=integrator, step=0.3 / n, **run)
        assert end.statistics["evaluations"] <= 10 * n + 5
        errors.append(np.max(np.abs(end_of(end) - exact)))
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(5.0, abs=0.35), errors


def test_an_explicit_method_is_a_tableau_and_nothing_else(
    free_block_system, reference, monkeypatch
):
    """Heun's method of order 2, in the place of another method of fixed step."""
    heun = Tableau("heun", 2, A=((0.0, 0.0), (1.0, 0.0)), b=(0.5, 0.5), c=(0.0, 1.0))
    monkeypatch.setitem(METHODS, "rk4", heun)
    errors, steps = [], [40, 80, 160]
    for n in steps:
        run = {"integrator": "rk4", "step": DURATION / n, "output_step": DURATION}
        found = end_of(ma.simulate(free_block_system, duration=DURATION, **run))
        errors.append(np.max(np.abs(found - reference)))
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.1), errors


HEUN = """
HEUN = Tableau(
    "heun", 2, A=((0.0, 0.0), (1.0, 0.0)), b=(0.5, 0.5), c=(0.0, 1.0), purpose="to see it listed"
)
"""
USE_OF_HEUN = """
import importlib.util, sys
import numpy as np
found = importlib.util.spec_from_file_location("multiarm.tableaus", sys.argv[1])
sys.modules["multiarm.tableaus"] = tableaus = importlib.util.module_from_spec(found)
found.loader.exec_module(tableaus)
import multiarm as ma
from typer.testing import CliRunner
from multiarm.cli import app
print(CliRunner().invoke(app, ["methods", "heun"]).output)
print(CliRunner().invoke(app, ["schema", "scene"]).output)
scene = ma.load_scene(sys.argv[2])
run = ma.simulate(ma.compile_system(scene), duration=0.01)
print("run:", run.status, run.statistics["integrator"])
try:
    scene.replace(run={"integrator": "huen"})
except ma.MultiarmError as error:
    print(error)
"""


@pytest.mark.slow
def test_a_method_is_one_record_from_which_all_lists_follow(tmp_path):
    """The tableau's text in the list of methods, as one adds it; everything else is as it was."""
    source = Path(tableaus.__file__).read_text()
    listed = source.replace("METHODS = {", f"{HEUN}\nMETHODS = {{").replace(
        "RK4, DOP", "RK4, HEUN, DOP"
    )
    (tmp_path / "tableaus.py").write_text(listed)
    scene = (SCENES / "two_ur5_box.yaml").read_text()
    run = scene[scene.index("\nrun:") :]
    scene = scene.replace(run, "\nrun: {integrator: heun, step: 1e-3}\n")
    (tmp_path / "scene.yaml").write_text(scene)
    words = [str(tmp_path / "tableaus.py"), str(tmp_path / "scene.yaml")]
    result = subprocess.run(
        [sys.executable, "-c", USE_OF_HEUN, *words], capture_output=True, text=True, check=True
    )
    assert "to see it listed" in result.stdout
    assert '"heun"' in result.stdout
    assert "run: completed heun" in result.stdout
    assert "did you mean 'heun'" in result.stdout


@pytest.mark.parametrize(
    ("name", "order"), [("rk4", 4), ("dopri5", 5), ("dop853", 8), ("rodas5p", 5)]
)
def test_samples_between_steps_keep_the_order_of_the_dense_output(
    name, order, free_block_system, monkeypatch
):
    """One step, sampled in its middle: local error h^(q+1) with q = 3, 4, 7."""
    integrator = fixed_step(monkeypatch, name)
    errors, steps = [], {"rk4": [8e-3, 4e-3, 2e-3], "dopri5": [1e-2, 7e-3, 5e-3],
                         "dop853": [3e-2, 2.4e-2, 1.9e-2],
                         "rodas5p": [1e-2, 7e-3, 5e-3]}[name]  # fmt: skip
    for h in steps:
        run = {"stabilization": "none", "output_step": 0.37 * h}
        found = ma.simulate(free_block_system, duration=h, integrator=integrator, step=h, **run)
        exact = ma.simulate(
            free_block_system, duration=0.37 * h, integrator="dop853", tolerance=1e-15, **run
        )
        q = lambda run, k: np.concatenate([run.joint_positions[a][k] for a in ("one", "two")])  # noqa: E731
        errors.append(np.max(np.abs(q(found, 1) - q(exact, -1))))
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.35), errors


def test_samples_do_not_depend_on_where_the_steps_end(free_block_system):
    """Every sample of a fine output grid is on the solution to the accuracy of the run."""
    run = {"duration": 0.2, "integrator": "dop853", "tolerance": 1e-11}
    fine = ma.simulate(free_block_system, output_step=0.2 / 97, **run)
    tight = ma.simulate(free_block_system, output_step=0.2 / 97, **{**run, "tolerance": 1e-14})
    assert fine.statistics["steps"] < 60 < len(fine)
    np.testing.assert_allclose(fine.object_position, tight.object_position, atol=1e-9)
    np.testing.assert_allclose(fine.object_twist, tight.object_twist, atol=1e-8)
    for name in fine.arm_names:
        np.testing.assert_allclose(fine.contact_forces[name], tight.contact_forces[name], atol=1e-5)


@pytest.mark.parametrize("integrator", ["dopri5", "dop853"])
def test_error_is_proportional_to_the_tolerance(integrator, free_block_system, reference):
    tolerances = np.array([1e-5, 1e-6, 1e-7, 1e-8, 1e-9])
    errors = []
    for tolerance in tolerances:
        run = {"integrator": integrator, "tolerance": tolerance, "output_step": DURATION}
        found = end_of(ma.simulate(free_block_system, duration=DURATION, **run))
        errors.append(np.max(np.abs(found - reference)))
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert 0.75 < slope < 1.25, errors
    assert np.all(np.array(errors) < 20 * tolerances)


def test_steps_adapt_and_rejected_steps_are_counted(free_block_system):
    run = ma.simulate(free_block_system, duration=0.6, integrator="dop853", tolerance=1e-9)
    s = run.statistics
    assert s["smallest_step_s"] < 0.5 * s["largest_step_s"]
    assert 11 * s["steps"] < s["evaluations"]
    loose = ma.simulate(free_block_system, duration=0.6, integrator="dop853", tolerance=1e-6)
    assert loose.statistics["steps"] < 0.7 * s["steps"]


def test_a_body_held_at_its_centre_tumbles_as_euler_says():
    """Charts of rotations over many turns: a ball joint at the centre of mass exerts no moment.

    The middle axis is unstable: the body turns over and over.
    """
    posture = [0.3, -0.6, 1.1, 0.4, 0.7, -0.2]
    held = single_arm("textbook_6r", "tool", posture, {"kind": "ball"})
    X = ma.compile_system(held).arms["arm"].tip_pose(np.array(posture))
    inertia, omega = np.diag([0.3, 0.4, 0.5]), np.array([0.02, 6.0, 0.02])
    body = {
        "shape": {"box": [0.1, 0.1, 0.1]}, "mass": 2.0, "inertia": [0.3, 0.4, 0.5],
        "pose": {"xyz": X[:3, 3].tolist()}, "twist": [0.0, 0.0, 0.0, *omega],
    }  # fmt: skip
    centre = {"arm": "arm", "kind": "ball", "at": {"xyz": [0, 0, 0]}}
    system = ma.compile_system(held.replace(object=body, joints=[centre], gravity=None))
    found = ma.simulate(
        system, duration=4.0, integrator="dop853", tolerance=1e-12, output_step=0.05
    )

    def euler(t, y):
        x, w, spin = y[:3], y[3], y[4:]
        q = 0.5 * np.concatenate([w * spin + np.cross(x, spin), [-x @ spin]])
        return np.concatenate([q, np.linalg.solve(inertia, -np.cross(spin, inertia @ spin))])

    start = [0, 0, 0, 1, *omega]
    exact = solve_ivp(euler, (0, 4), start, "DOP853", found.time, rtol=1e-13, atol=1e-14)
    difference = Rotation.from_quat(exact.y[:4].T).inv() * Rotation.from_quat(
        found.object_quaternion_xyzw
    )
    np.testing.assert_allclose(difference.magnitude(), 0.0, atol=1e-8)
    np.testing.assert_allclose(found.object_position, X[:3, 3] * np.ones((81, 1)), atol=1e-10)
    norms = np.linalg.norm(found.object_quaternion_xyzw, axis=1)
    np.testing.assert_allclose(norms, 1.0, atol=4 * EPS)
