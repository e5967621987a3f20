"""Motions of scenes whose robots are trees: by SciPy from dense algebra, and their momenta."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from tree_models import TreeScene, TreeState
from tree_oracle import Motions, solve_minimal

import multiarm as ma

# Relative and absolute tolerance of the reference's steps, if no other is asked for.
TOLERANCE = 1e-10


class Momenta(NamedTuple):
    """Of some bodies together, world axes.

    linear : (3,) [N s]; angular : (3,), about the world's origin [N m s]
    centre : (3,), of mass [m]
    """

    linear: np.ndarray
    angular: np.ndarray
    centre: np.ndarray


def momenta(trees: TreeScene, state: TreeState, bodies: tuple[str, ...] = ()) -> Momenta:
    """Momenta of the robots and objects of these names, of all where none are named."""
    motions, mass = Motions(trees, state), 0.0
    linear, angular, moment = np.zeros((3, 3))
    for name in bodies or motions.names:
        moved = motions.models[name]
        data = moved.model.createData()
        # without the joints' armature, which no linear momentum belongs to
        h = pin.computeCentroidalMomentum(moved.model, data, moved.position, moved.velocity)
        centre = pin.centerOfMass(moved.model, data, moved.position)
        linear, angular = linear + h.linear, angular + h.angular + np.cross(centre, h.linear)
        of_body = pin.computeTotalMass(moved.model)
        moment, mass = moment + of_body * centre, mass + of_body
    return Momenta(linear, angular, moment / mass)


def energy(trees: TreeScene, state: TreeState, bodies: tuple[str, ...] = ()) -> float:
    """Kinetic and potential energy [J] of the robots and objects of these names, or of all."""
    motions, total = Motions(trees, state), 0.0
    for name in bodies or motions.names:
        moved = motions.models[name]
        data = moved.model.createData()
        total += pin.computeKineticEnergy(moved.model, data, moved.position, moved.velocity)
        total += pin.computePotentialEnergy(moved.model, data, moved.position)
    return total


def dense_motion(
    trees: TreeScene,
    state: TreeState,
    torques: dict[str, np.ndarray],
    end: float,
    tolerance: float = TOLERANCE,
) -> TreeState:
    """The state at the end [s], by SciPy, from accelerations of dense algebra."""
    robots, frames = list(state.joint_positions), {**state.objects, **state.bases}
    sizes = [part for _ in frames for part in (3, 4, 6)]
    sizes += [state.joint_positions[name].size for name in robots for _ in range(2)]

    def stacked(now: TreeState) -> np.ndarray:
        of_frames = [
            part for f in (*now.objects.values(), *now.bases.values()) for part in _parts(f)
        ]
        of_robots = [
            part
            for name in robots
            for part in (now.joint_positions[name], now.joint_velocities[name])
        ]
        return np.concatenate([*of_frames, *of_robots])

    def state_of(y: np.ndarray) -> TreeState:
        parts = iter(np.split(y, np.cumsum(sizes)[:-1]))
        moved = {}
        for name in frames:
            position, quaternion, twist = next(parts), next(parts), next(parts)
            moved[name] = {
                "position": position,
                "quaternion_xyzw": quaternion / np.linalg.norm(quaternion),
                "twist": twist,
            }
        q, v = {}, {}
        for name in robots:
            q[name], v[name] = next(parts), next(parts)
        return TreeState(
            {name: moved[name] for name in state.objects}, q, v,
            {name: moved[name] for name in state.bases},
        )  # fmt: skip

    def slope(_, y: np.ndarray) -> np.ndarray:
        now = state_of(y)
        solution = solve_minimal(trees, now, torques)
        accelerations = {**solution.object_accelerations, **solution.base_accelerations}
        parts = []
        for name, frame in {**now.objects, **now.bases}.items():
            _, quaternion, twist = _parts(frame)
            parts += [twist[:3], _turning(quaternion, twist[3:]), accelerations[name]]
        for name in robots:
            parts += [now.joint_velocities[name], solution.joint_accelerations[name]]
        return np.concatenate(parts)

    solved = solve_ivp(
        slope, (0.0, end), stacked(state), method="DOP853", rtol=tolerance, atol=tolerance
    )
    return state_of(solved.y[:, -1])


def _parts(frame: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return frame["position"], frame["quaternion_xyzw"], frame["twist"]


def _turning(quaternion: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Rate of a quaternion xyzw at an angular velocity, world axes."""
    vector, w = quaternion[:3], quaternion[3]
    return 0.5 * np.append(w * omega + np.cross(omega, vector), -omega @ vector)


def far_apart(first: TreeState, second: TreeState) -> float:
    """The largest difference of two states [m, rad; m/s, rad/s]."""
    gaps = []
    for frames, peers in ((first.objects, second.objects), (first.bases, second.bases)):
        for name, frame in frames.items():
            (place, turn, twist), (peer_place, peer_turn, peer_twist) = map(
                _parts, (frame, peers[name])
            )
            gaps += [place - peer_place, twist - peer_twist]
            gaps.append(
                (Rotation.from_quat(turn) * Rotation.from_quat(peer_turn).inv()).as_rotvec()
            )
    for name, q in first.joint_positions.items():
        gaps.append(q - second.joint_positions[name])
        gaps.append(first.joint_velocities[name] - second.joint_velocities[name])
    return float(np.max(np.abs(np.concatenate(gaps))))


def tree_state(run: ma.Trajectory, k: int) -> TreeState:
    """Sample ``k`` of a trajectory."""
    return TreeState(
        _sampled(run.objects, k),
        {name: q[k] for name, q in run.joint_positions.items()},
        {name: v[k] for name, v in run.joint_velocities.items()},
        _sampled(run.bases, k),
    )


def as_tree_state(state: ma.State) -> TreeState:
    """A state of the package."""
    objects, bases = (
        {
            name: {
                "position": motion.position,
                "quaternion_xyzw": motion.quaternion_xyzw,
                "twist": motion.twist,
            }
            for name, motion in frames.items()
        }
        for frames in (state.objects, state.bases)
    )
    return TreeState(objects, dict(state.joint_positions), dict(state.joint_velocities), bases)


def _sampled(motions: Any, k: int) -> dict[str, dict[str, np.ndarray]]:
    """Sample ``k`` of the floating frames of a trajectory, as a :class:`TreeState` has them."""
    return {
        name: {
            "position": motion.position[k],
            "quaternion_xyzw": motion.quaternion_xyzw[k],
            "twist": motion.twist[k],
        }
        for name, motion in motions.items()
    }
