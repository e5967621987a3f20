"""Optimal control with Crocoddyl: its FDDP swings a box that two arms hold.

An action model for Crocoddyl is an evaluation and its derivatives: accelerations of the closed
chains, of object and joints, at any joint and rank.  Crocoddyl is no dependency of multiarm; it is
added by ``pip install --no-deps crocoddyl libcrocoddyl``, as it lists older robots than ours.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import pinocchio as pin

import multiarm as ma

try:
    import crocoddyl
except ModuleNotFoundError:
    raise SystemExit(
        "this example needs Crocoddyl: pip install --no-deps crocoddyl libcrocoddyl"
    ) from None

SCENE = Path(__file__).parent / "scenes" / "two_ur5_box.yaml"
SHIFT = np.array([0.0, 0.12, 0.08])  # [m] to the target
NODES, STEP = 40, 0.025  # [s]
# weights of the distance [1/m^2] and of velocities at the end, of torques and velocities on the way
PLACE, REST, EFFORT, MOTION = 1e4, 1e2, 1e-4, 1e-2


def manifold(joints: int) -> crocoddyl.StateMultibody:
    """The object's pose as a free-flyer, all joints beside it, and their velocities."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "object")
    for k in range(joints):
        model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), f"joint {k}")
    return crocoddyl.StateMultibody(model)


class ClosedChains(crocoddyl.DifferentialActionModelAbstract):
    """Accelerations of a system under joint torques, with a quadratic cost.

    Crocoddyl's twist of the object, and its displacements, are in the object's axes.
    """

    def __init__(self, system: ma.System, rest: np.ndarray, place: float, still: float) -> None:
        self.joints = system.model.layout.rate_count
        super().__init__(manifold(self.joints), self.joints, 0)
        self.torque = rest.copy()
        self.system = system.with_control(self._torques)
        self.rest, self.target = rest, system.initial_state().object_position + SHIFT
        self.place, self.still = place, still

    def _torques(self, _t: float, _state: ma.State) -> dict[str, np.ndarray]:
        return self.system.model.layout.split_joints(self.torque)

    def to_ours(self, x: np.ndarray) -> tuple[ma.State, np.ndarray]:
        """A state, and the rotation of its object."""
        n = self.joints
        R = pin.Quaternion(x[3:7]).toRotationMatrix()
        velocity = np.concatenate([R @ x[7 + n : 10 + n], R @ x[10 + n : 13 + n], x[13 + n :]])
        return ma.State(x[: 7 + n].copy(), velocity, self.system.model.layout), R

    def from_ours(self, state: ma.State) -> np.ndarray:
        """The same the other way round."""
        R = pin.Quaternion(state.object_quaternion_xyzw).toRotationMatrix()
        own = R.T @ state.object_twist[:3], R.T @ state.object_twist[3:]
        return np.concatenate([state.position, *own, state.velocity[6:]])

    def calc(self, data, x, u=None):
        """Accelerations and cost."""
        self.torque = self.rest if u is None else np.array(u)
        state, R = self.to_ours(x)
        found = ma.evaluate(self.system, 0.0, state).accelerations
        v, omega = np.split(x[7 + self.joints : 13 + self.joints], 2)
        linear = R.T @ found[:3] - np.cross(omega, v)
        data.xout = np.concatenate([linear, R.T @ found[3:6], found[6:]])
        error, effort = state.object_position - self.target, self.torque - self.rest
        data.cost = 0.5 * self.place * error @ error + 0.5 * EFFORT * effort @ effort
        data.cost += 0.5 * self.still * state.velocity @ state.velocity

    def calcDiff(self, data, x, u=None):
        """Their derivatives; the cost's Hessian is that of Gauss and Newton."""
        self.torque = self.rest if u is None else np.array(u)
        n, (state, R) = self.joints, self.to_ours(x)
        D = ma.derivatives(self.system, 0.0, state, closed_loop=False)
        v, omega = np.split(x[7 + n : 13 + n], 2)
        # their displacement -> ours: pose, twist, joints, joint velocities
        to_ours = np.zeros((12 + 2 * n, 12 + 2 * n))
        to_ours[:3, :3] = to_ours[3:6, 3:6] = R
        to_ours[6:9, 6 + n : 9 + n] = to_ours[9:12, 9 + n : 12 + n] = R
        to_ours[6:9, 3:6], to_ours[9:12, 3:6] = -R @ pin.skew(v), -R @ pin.skew(omega)
        to_ours[12 : 12 + n, 6 : 6 + n] = to_ours[12 + n :, 12 + n :] = np.eye(n)
        rows = 6 + n
        columns = np.r_[tuple(D.columns[name] for name in list(D.columns)[:4])]
        by_state = D.matrix[:rows, columns] @ to_ours
        by_torque = D.matrix[:rows, D.columns["torques"]]
        Fx, Fu = by_state.copy(), by_torque.copy()
        for part, acceleration in ((slice(0, 3), 0), (slice(3, 6), 3)):
            own = R.T @ D.evaluation.accelerations[acceleration : acceleration + 3]
            Fx[part], Fu[part] = R.T @ by_state[part], R.T @ by_torque[part]
            Fx[part, 3:6] += pin.skew(own)
        Fx[:3, 6 + n : 9 + n] -= pin.skew(omega)
        Fx[:3, 9 + n : 12 + n] += pin.skew(v)
        data.Fx, data.Fu = Fx, Fu
        moves = np.zeros((3, 12 + 2 * n))
        moves[:, :3] = R
        rates = to_ours[np.r_[6:12, 12 + n : 12 + 2 * n]]
        error = state.object_position - self.target
        data.Lx = self.place * moves.T @ error + self.still * rates.T @ state.velocity
        data.Lxx = self.place * moves.T @ moves + self.still * rates.T @ rates
        data.Lu, data.Luu = EFFORT * (self.torque - self.rest), EFFORT * np.eye(n)
        data.Lxu = np.zeros((12 + 2 * n, n))


def main() -> None:
    """Solve the problem, and simulate the torques that were found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=30, help="at most, of the solver")
    options = parser.parse_args()
    scene = ma.load_scene(SCENE)
    system = ma.compile_system(scene.replace(control={"kind": "none"}))
    held = ma.inverse_dynamics(system, system.initial_state(), np.zeros(6)).torques
    rest = np.concatenate(list(held.values()))
    way = ClosedChains(system, rest, 0.0, MOTION)
    start = way.from_ours(system.initial_state())
    running = crocoddyl.IntegratedActionModelRK(way, crocoddyl.RKType.four, STEP)
    last = crocoddyl.IntegratedActionModelEuler(ClosedChains(system, rest, PLACE, REST), 0.0)
    solver = crocoddyl.SolverFDDP(crocoddyl.ShootingProblem(start, [running] * NODES, last))
    began = time.perf_counter()
    solved = solver.solve([start] * (NODES + 1), [rest] * NODES, options.rounds)
    print(f"solved: {solved}, {solver.iter} rounds in {time.perf_counter() - began:.1f} s")
    planned = np.linalg.norm(solver.xs[-1][:3] - start[:3] - SHIFT)
    away = np.linalg.norm(SHIFT)
    print(f"target {1e3 * away:.0f} mm away, planned to miss {1e3 * planned:.1f} mm")

    def table(t: float, _state: ma.State) -> dict[str, np.ndarray]:
        torque = np.array(solver.us[min(int(t / STEP + 1e-6), NODES - 1)])
        return system.model.layout.split_joints(torque)

    run = ma.simulate(
        system, NODES * STEP, control=table, sample_time=STEP, accuracy=1e-6, certificate=False
    )
    moved = run.object_position[-1] - run.object_position[0]
    print(f"simulated, it misses {1e3 * np.linalg.norm(moved - SHIFT):.1f} mm")
    print(f"speed at the end {1e3 * np.linalg.norm(run.object_twist[-1, :3]):.1f} mm/s")


if __name__ == "__main__":
    main()
