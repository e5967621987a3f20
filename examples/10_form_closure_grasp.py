"""Two small grippers without friction hold a block: design, understand, simulate.

The grasp is that of section 2.2.3.1 of S.Y. Ho's thesis: the same two grippers hold a block of any
size at two opposite corners.  A block of 1.2 x 0.8 x 0.6 m is then carried by two Pandas for 10 s;
from the places of the seven fingertips alone its pose is found again.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "grasped_block.yaml"
SIZE = [1.2, 0.8, 0.6]  # [m]


def understand(grasp: ma.grasp.Grasp) -> None:
    """Tell what makes the grasp closed, and how much of it could be lost."""
    print(grasp.closure.message)
    print("in balance: pushes of", *grasp.closure.coefficients.round(3))
    six, top = grasp.contacts.subset(range(6)), grasp.body.faces[2]
    region = ma.grasp.seventh_contact_region(six, top)
    print(f"the seventh contact may be anywhere in {region.area:.4f} m^2 of the top")
    stable = ma.grasp.configuration_stability(grasp.contacts)
    print(f"all contacts may slip by {1e3 * stable.radius.lower:.2f} mm at once")
    weight = [0.0, 0.0, 5.0 * 9.81, 0.0, 0.0, 0.0]
    forces = ma.grasp.distribute_forces(grasp.contacts, weight, minimum=1.0).forces
    print("5 kg are carried, all pressing, by", *forces.round(1), "N")


def simulate() -> None:
    """Run the scene that ``multiarm grasp design`` wrote, and find the block by touch."""
    system = ma.compile_system(ma.load_scene(SCENE))
    run = ma.simulate(system)
    weakest = min(forces.min() for forces in run.contact_forces.values())
    print(
        f"{run.status} after {run.time[-1]:g} s; the weakest contact presses with {weakest:.2f} N"
    )
    end = system.state(
        object_position=run.object_position[-1],
        object_quaternion_xyzw=run.object_quaternion_xyzw[-1],
        joint_positions={arm: run.joint_positions[arm][-1] for arm in system.arm_names},
    )
    ev = ma.evaluate(system, run.time[-1], end)
    first, second = (ev.contact_points[arm] for arm in ("gripper_1", "gripper_2"))
    # faces of contacts 1, 2, 3 and 7 of the first gripper, then 4, 5 and 6 of the second
    found = ma.grasp.object_frame_from_contacts(
        np.vstack([first, second]), np.eye(3), SIZE, faces=(1, 2, 3, 3, -1, -2, -3)
    )
    off = np.linalg.norm(found.position - run.object_position[-1])
    print("the block's frame, from its contact points, is off by less than 1e-9 m:", off < 1e-9)


def main() -> None:
    """Design, understand, simulate."""
    understand(ma.grasp.design_block_grasp(SIZE, offset=0.1, seventh=0.05))
    simulate()


if __name__ == "__main__":
    main()
