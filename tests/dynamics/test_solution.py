"""What the solvers find out beside accelerations and forces: each writes all, and it is true."""

from __future__ import annotations

import numpy as np
import pytest
from event_scenes import box, on_floor
from mechanics import UR5_WRIST_SINGULAR, data_of, two_arm_block_twice, ur5_pair
from scipy.linalg import block_diag

import multiarm as ma
from multiarm.dynamics.contact_geometry import block_inertias, constraint_matrix
from multiarm.dynamics.equations import evaluate_state, solve_frictionless
from multiarm.dynamics.momenta import write_momenta
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.solver.solution import Elimination, Solution
from multiarm.dynamics.solver_monitor import accept_solution
from multiarm.dynamics.status import NOT_FINITE, OK
from multiarm.events.evaluation import enter_mode_at
from multiarm.jit.pointers import function_at

# The monitor of a step writes these, not the solver.
OF_MONITOR = {"least_margin", "residual"}


def welded_and_ball():
    return ur5_pair({"kind": "weld"}, {"kind": "ball"})


def sliding_box():
    """Four corners slide in different directions: how they share the weight changes the motion."""
    return on_floor(box(twist=[1.0, 0.3, 0, 0, 0, 0.2]), mu=0.3)


SCENES = {
    "regular": welded_and_ball,
    "wrist aligned": welded_and_ball,
    "contacts that repeat": two_arm_block_twice,
    "sliding": sliding_box,
}
BY_NODE = {
    "regular": Elimination.WHOLE,
    "wrist aligned": Elimination.SPLIT,
    "contacts that repeat": Elimination.SPLIT,
    "sliding": Elimination.FRICTION,
}
CASES = [(scene, solver) for scene in SCENES for solver in ("node", "dense")]


def data_at_start(scene: str, solver: str):
    system = ma.compile_system(SCENES[scene]()).with_solver(solver)
    state = system.initial_state()
    if scene == "wrist aligned":
        state = system.state(joint_positions={"left": UR5_WRIST_SINGULAR})
    ma.evaluate(system, 0.0, state)
    data = data_of(system)
    return enter_mode_at(data, 0.0, state).data if scene == "sliding" else data


def written_after(data, solve, before: int) -> dict[str, float]:
    """What a solver has written over a record of nonsense."""
    solution = data.arrays.solution
    solution.struct[:] = before
    assert solve(data.struct) == OK
    return {name: getattr(solution, name) for name in Solution._fields if name not in OF_MONITOR}


def test_numbers_that_are_not_finite_are_a_status_of_the_dense_solver():
    """No exception of Python: a method with variable steps tries a shorter one."""
    data = data_at_start("regular", "dense")
    data.arrays.state.joint_rates[0] = np.inf
    assert evaluate_state(data.struct, 0.0, 0.0) == NOT_FINITE


@pytest.mark.parametrize(("scene", "solver"), CASES)
def test_every_solver_writes_the_whole_record(scene, solver):
    data = data_at_start(scene, solver)
    solvers = (
        lambda struct: evaluate_state(struct, 0.0, 0.0),
        lambda struct: solve_frictionless(struct, 0.0),
    )
    for solve in solvers:
        first, second = (written_after(data, solve, before) for before in (0, 12345))
        assert first == second
        assert first["rank"] + first["dependent"] == data.model.layout.contacts
        assert first["margin"] > 0.0


@pytest.mark.parametrize(("scene", "solver"), CASES)
def test_the_record_is_that_of_the_system(scene, solver):
    data = data_at_start(scene, solver)
    assert evaluate_state(data.struct, 0.0, 0.0) == OK
    b, solution = data.arrays, data.arrays.solution
    dense = solver == "dense"
    assert solution.elimination == (Elimination.DENSE if dense else BY_NODE[scene])
    assert solution.rank == null_space(constraint_matrix(data)).rank
    assert (solution.coupled_blocks > 0) == (not dense and scene != "regular")
    if scene == "wrist aligned" and not dense:
        assert b.deficient.coupled.tolist() == [1, 0]
    assert solution.motion_unique == (scene != "sliding")


def test_a_step_counts_what_has_changed_and_answers_that_it_succeeded():
    """The first solution of a run is a change; the same one again is none."""
    data = data_at_start("regular", "node")
    compare = function_at(data.arrays.functions.compare)
    for changes in (1, 0):
        assert compare(data.struct.ctypes.data, data.struct.size, 0.0, 0.0) == OK
        assert data.arrays.this_step.solution.changes == changes
        accept_solution(data.arrays)


def test_both_solvers_name_the_contacts_that_leave_the_motion_open():
    arms = {s: data_at_start("sliding", s).arrays.deficient for s in ("node", "dense")}
    node, dense = (arms[s].undetermined.tolist() for s in arms)
    assert node == dense == [0] * (len(node) - 1) + [1]
    ev = ma.evaluate(ma.compile_system(sliding_box()))
    assert "contact forces of floor" in ev.message


def test_momenta_are_inertias_times_velocities(rng):
    system = ma.compile_system(welded_and_ball())
    state = system.initial_state()
    state.velocity[:] = rng.normal(size=state.velocity.size)
    ma.evaluate(system, 0.0, state)
    data = data_of(system)
    arms = block_inertias(data)
    momenta = np.empty_like(state.velocity)
    write_momenta(data.struct, momenta)
    inertia = block_diag(data.arrays.bodies.object_inertia, *arms)
    np.testing.assert_allclose(momenta, inertia @ state.velocity, rtol=1e-12, atol=1e-12)
